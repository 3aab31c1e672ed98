"""Robots: equations against Pinocchio and MuJoCo, and identification of simulated arms.

    python benchmarks/robots.py [CHAINS]      (default: 50 random chains of up to 7 joints)
    python benchmarks/robots.py descriptions FOLDER...   all robot files below folders
    python benchmarks/robots.py twins OUT [COUNT [FIRST]]     (default: 50 arms of 7 joints)
    python benchmarks/robots.py halves OUT [COUNT [FIRST]]    two halves of an arm's records
    python benchmarks/robots.py payload [COUNT]       2.5 kg at the flange, weighed
    python benchmarks/robots.py design [COUNT]        a designed record against random ones
    python benchmarks/robots.py loop [COUNT [RECORDS]]    the controller simulated (default: 5 arms)

Needs the extras `bench` and `robots`. Each chain and each robot is compared at three states;
differences of mass matrices, bias forces and energies are relative to the largest number of each
quantity, and the worst of all is printed, with the time to compile 7 joints. Joints that follow
others are moved as they do, and their forces brought to the joints that lead.

A twin is an arm whose masses, centres and inertias are off by up to a third of their priors, with
armature, friction and offsets: 10 records of 10 s at 200 Hz in the loop of a PD controller,
encoders of 16 bits, torque noise of 2 %. The command identifies it by inverse dynamics.

`loop` has the set points in the records, not the gains. After inverse dynamics each arm is
identified by simulation, over horizons of 0.25 s driven by recorded torques, and over whole records
in the loop. Scored is the motion of the held-out record, simulated in the loop as a whole.
"""

import jax

jax.config.update("jax_enable_x64", True)

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.engine.engines import evaluate, simulate
from tustinnet.engine.equations import Equations, Formula
from tustinnet.engine.runs import Runs
from tustinnet.evaluate.record_design import DesignOptions, design_record, gather_limits
from tustinnet.fitting.inverse_dynamics.along import filter_record, missing_forces
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.models.chains import INERTIAL, body_inertia
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.systems.files import find_system
from tustinnet.systems.robot import Lead, find_lead
from tustinnet.systems.robot_reading import read_robot

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from robot_files import random_urdf  # pyright: ignore[reportMissingImports]
from robot_twins import record_in_loop, true_values, with_payload  # pyright: ignore[reportMissingImports]

_DECIDED = 0.5  # share of a prior's standard deviation below which records decide
ARM = ROOT / "examples" / "robots" / "arm7.urdf"


def own_terms(system: LagrangianSystem, states: np.ndarray) -> list[dict[str, np.ndarray]]:
    """Mass matrix, bias forces and energies at states [q, v], (n, 2 n_q)."""
    n = len(system.coordinates)
    values = {name: jnp.asarray(x) for name, x in system.nominal().items()}
    model, potential = system.model(values), system.potential
    assert potential is not None

    def terms(x: Any) -> Any:
        q, v = x[:n], x[n:]
        energies = jnp.stack([system.kinetic(q, v, values), potential(q, values)])
        bias = -model.conservative(q, v)
        return jnp.concatenate([model.mass_matrix(q).ravel(), bias, energies])

    return [
        {
            "mass": row[: n * n].reshape(n, n),
            "bias": row[n * n : -2],
            "kinetic": row[-2],
            "potential": row[-1],
        }
        for row in evaluate(Formula(terms, 2 * n), states)
    ]


def pinocchio_terms(text: str, lead: Lead, states: np.ndarray) -> list[dict[str, Any]]:
    """The terms of a URDF by Pinocchio."""
    pin = import_module("pinocchio")
    model = pin.buildModelFromXML(text)
    data, results = model.createData(), []
    joints = [model.joints[model.getJointId(name)] for name in lead.joints]
    places = [joint.idx_v for joint in joints]
    for q, v in (np.split(state, 2) for state in states):
        position, velocity = pin.neutral(model), np.zeros(model.nv)
        velocity[places] = lead.ratios @ v
        for joint, x in zip(joints, lead.ratios @ q + lead.offsets, strict=True):
            # a continuous joint is a point of a circle
            both = [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            position[joint.idx_q : joint.idx_q + joint.nq] = both
        upper = np.triu(pin.crba(model, data, position))
        mass = upper + np.triu(upper, 1).T
        results.append(
            {
                "mass": lead.ratios.T @ mass[np.ix_(places, places)] @ lead.ratios,
                "bias": lead.ratios.T
                @ pin.nonLinearEffects(model, data, position, velocity)[places],
                "kinetic": pin.computeKineticEnergy(model, data, position, velocity),
                "potential": pin.computePotentialEnergy(model, data, position),
            }
        )
    return results


def mujoco_terms(text: str, lead: Lead, states: np.ndarray) -> list[dict[str, Any]]:
    """The terms of a URDF or MJCF by MuJoCo.

    Shapes of a URDF, where a link without an inertia has no mass, are left out.
    """
    mujoco = import_module("mujoco")
    spec = mujoco.MjSpec.from_string(text)
    files = (mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)
    for geom in spec.geoms:
        geom.material = ""
        if "<robot" in text or geom.type in files or geom.meshname:
            spec.delete(geom)
    for site in spec.sites:
        site.material = ""
    for assets in (spec.meshes, spec.hfields, spec.materials, spec.textures, spec.skins, spec.keys):
        for asset in assets:
            spec.delete(asset)
    model = spec.compile()
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, results = mujoco.MjData(model), []
    places = [model.joint(name).dofadr[0] for name in lead.joints]
    for q, v in (np.split(state, 2) for state in states):
        data.qpos[places], data.qvel[places] = lead.ratios @ q + lead.offsets, lead.ratios @ v
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        potential, kinetic = data.energy
        results.append(
            {
                "mass": lead.ratios.T @ mass[np.ix_(places, places)] @ lead.ratios,
                "bias": lead.ratios.T @ (data.qfrc_bias - data.qfrc_spring)[places],
                "kinetic": kinetic,
                "potential": potential,
            }
        )
    return results


def differences(path: Path, states: int = 3) -> tuple[LagrangianSystem, dict[str, float]]:
    """A robot's system, and its largest differences of terms to other tools.

    Tools that cannot read the file are left out.
    """
    system, file = tn.load_system(path), find_system(path)
    assert not isinstance(file, str)
    is_urdf = path.suffix == ".urdf"
    names = [c.name for c in system.coordinates]
    lead = find_lead(read_robot(file.text, path), names)
    points = 2 * np.random.default_rng(0).normal(size=(states, 2 * len(names)))
    own, worst = own_terms(system, points), dict[str, float]()
    tools = {"Pinocchio": pinocchio_terms} if is_urdf else {}
    for tool, terms in (tools | {"MuJoCo": mujoco_terms}).items():
        try:
            others = terms(file.text, lead, points)
        except (ValueError, RuntimeError, KeyError):
            continue
        for mine, other in zip(own, others, strict=True):
            for what, value in other.items():
                difference = mine[what] - value
                if what == "potential":  # up to a constant: of links fixed to the base
                    difference -= own[0][what] - others[0][what]
                error = np.abs(difference).max() / max(1.0, np.abs(value).max())
                key = f"{what} against {tool}"
                worst[key] = max(worst.get(key, 0.0), float(error))
    return system, worst


def compile_seconds(system: LagrangianSystem) -> tuple[int, float]:
    """Operations of the equations of motion by all parameters, and seconds to compile them."""
    names, n = list(system.nominal()), len(system.coordinates)

    def derivative(x: Any, u: Any, p: Any, c: Any) -> Any:
        return system.model({name: p[i] for i, name in enumerate(names)}).derivative(x, u)

    start = time.perf_counter()
    equations = Equations(derivative, 2 * n, len(system.inputs), len(names))
    parameters = np.array([list(system.nominal().values())])
    one = np.ones(1, int)
    drive = np.zeros((2, 1, len(system.inputs)))
    simulate(
        equations, Runs(np.zeros((1, 2 * n)), parameters, one, 0 * one, drive, np.full(2, 1e-3))
    )
    return len(equations.program.nodes), time.perf_counter() - start


def main(count: int) -> None:
    """Compares random chains and prints the worst differences."""
    worst: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as place:
        for seed in range(count):
            file = Path(place, f"chain{seed}.urdf")
            file.write_text(random_urdf(seed))
            for key, error in differences(file)[1].items():
                worst[key] = max(worst.get(key, 0.0), error)
    for key, error in worst.items():
        print(f"{key:32s} {error:.1e}")
    operations, seconds = compile_seconds(tn.load_system(ARM))
    print(f"arm of 7 joints: {operations} operations, compiled in {seconds:.1f} s")


def descriptions(folders: Sequence[str]) -> None:
    """Compares all robots below folders, and counts the sentences by which files are refused."""
    files = sorted(
        file
        for folder in folders
        for file in [*Path(folder).rglob("*.urdf"), *Path(folder).rglob("*.xml")]
        if file.suffix == ".urdf" or "<mujoco" in file.read_text(errors="replace")
    )
    errors: dict[str, list[float]] = {}
    refused: dict[str, list[str]] = {}
    loaded = alone = 0
    for file in files:
        try:
            system, worst = differences(file)
        except tn.InputError as error:
            words = re.sub(r"'[^']*'|<[^>]*>", "...", str(error).replace(str(file), "FILE"))
            refused.setdefault(re.sub(r"[-+.\w/]*\d[-+.\w/]*", "#", words), []).append(str(error))
            continue
        loaded, alone = loaded + 1, alone + (not worst)
        for key, error in worst.items():
            errors.setdefault(key, []).append(error)
        largest = f"{max(worst.values()):.1e}" if worst else "read by no other tool"
        print(f"| {file.name} | {len(system.coordinates)} | {largest} |", flush=True)
    print(f"{len(files)} files, {loaded} read, {alone} of them by no other tool")
    for key, sizes in errors.items():
        print(
            f"{key:32s} {len(sizes)} robots, median {np.median(sizes):.1e}, worst {max(sizes):.1e}"
        )
    for sentences in sorted(refused.values(), key=len, reverse=True):
        print(f"{len(sentences)} times: {sentences[0]}")


def fit(folder: Path, data: tn.DataSet) -> tuple[dict[str, Any], float, float]:
    """Identifies an arm by the command: header of its model, seconds, GiB at the peak."""
    logs, run = folder / "logs", folder / "run"
    write_data_set(tn.DataSet("arm", tuple(data)), logs, "Simulated arm", overwrite=True)
    words = [
        "fit",
        str(logs),
        "--recipe",
        "inverse-dynamics",
        "--system",
        str(ARM),
        "--out",
        str(run),
        "--no-report",
        "--overwrite",
        "-q",
    ]
    start_time = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "tustinnet", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = status
    if status:
        sys.exit(f"{folder}: the fit ended with {status}")
    seconds = time.perf_counter() - start_time
    return tn.read_header(run / "model.safetensors"), seconds, usage.ru_maxrss / 2**20


def estimates(header: dict[str, Any]) -> tuple[list[str], np.ndarray, np.ndarray, float]:
    """Names, values and covariance of the free parameters, and the 95 % factor of the errors."""
    identification = header["identification"]
    rows = identification["estimates"]
    errors = np.array([row["error"] or 0.0 for row in rows])
    factors = [
        (row["interval"][1] - row["value"]) / row["error"]
        for row in rows
        if row["error"] and row["interval"] and row["lower"] < 0
    ]
    correlation = np.nan_to_num(np.array(identification["correlation"], float))
    covariance = correlation * np.outer(errors, errors)
    np.fill_diagonal(covariance, errors**2)
    values = np.array([row["value"] for row in rows])
    return [row["name"] for row in rows], values, covariance, float(np.median(factors))


def linear_parameters(system: LagrangianSystem, names: Sequence[str], vector: Any) -> Any:
    """Parameters in which forces are linear: of each link mass, moments, inertia at its frame."""
    values = system.nominal() | dict(zip(names, vector, strict=True))
    links = [name.removesuffix(".mass") for name in values if name.endswith(".mass")]
    inertias = []
    for link in links:
        body = body_inertia(SimpleNamespace(name=link, anchor=(0.0, 0.0, 0.0)), values)  # pyright: ignore[reportArgumentType]
        tensor = jnp.asarray(body.tensor)[np.triu_indices(3)]
        inertias += [jnp.atleast_1d(body.mass), jnp.asarray(body.moment), tensor]
    inertial = {f"{link}.{name}" for link in links for name in INERTIAL}
    others = [
        jnp.atleast_1d(x) for name, x in zip(names, vector, strict=True) if name not in inertial
    ]
    return jnp.concatenate([*inertias, *others])


def deviations(
    system: LagrangianSystem,
    names: Sequence[str],
    values: np.ndarray,
    others: np.ndarray,
    covariance: np.ndarray,
) -> np.ndarray:
    """Differences of two sets of base parameters in standard errors.

    Base parameters are the combinations of linear parameters of which the records say more than
    the file: those whose variance is less than a quarter of that of the priors.

    Args:
        system: the arm.
        names: names of the free parameters.
        values: their values.
        others: other values, or the true ones.
        covariance: of the difference, (n, n).
    """
    slopes = np.asarray(jax.jacobian(lambda v: linear_parameters(system, names, v))(values))
    prior = slopes @ np.diag(spreads(names, system) ** 2) @ slopes.T
    combined = slopes @ covariance @ slopes.T
    # in units in which all priors are 1; those that no record moves have none
    sizes, axes = np.linalg.eigh(prior)
    kept = sizes > 1e-12 * sizes.max()
    unit = axes[:, kept] / np.sqrt(sizes[kept])
    shares, turned = np.linalg.eigh(unit.T @ combined @ unit)
    base = (shares > 0) & (shares < _DECIDED**2)
    difference = linear_parameters(system, names, values) - linear_parameters(system, names, others)
    return (turned.T @ unit.T @ np.asarray(difference))[base] / np.sqrt(shares[base])


def spreads(names: Sequence[str], system: LagrangianSystem) -> np.ndarray:
    """Standard deviations of the priors of parameters."""
    by_name = {p.name: p for p in system.parameters}
    return np.array(
        [min(by_name[n].prior or np.inf, (by_name[n].upper - by_name[n].lower) / 2) for n in names]
    )


def twins(out: Path, count: int, first: int = 0) -> None:
    """Torques that are missing on held-out records, and how often intervals hold the truth."""
    system = tn.load_system(ARM)
    inside = combinations = single = singles = 0
    rows: list[list[float]] = []  # missing torque, mean of joints; seconds; memory
    print("| arm | missing torque, held out [%] | base parameters within 95 % | values | s | GiB |")
    for seed in range(first, first + count):
        truth = true_values(system, seed)
        data = record_in_loop(system, truth, 10, 10.0, seed=seed)
        header, seconds, memory = fit(out / f"twin{seed}", data)
        names, values, covariance, factor = estimates(header)
        true = np.array([truth[name] for name in names])
        spread = spreads(names, system)
        z = deviations(system, names, values, true, covariance)
        own = np.sqrt(np.diag(covariance))
        decided = (own > 0) & (own < _DECIDED * spread)
        near = np.abs(values - true)[decided] < factor * own[decided]
        inside, combinations = inside + int((np.abs(z) < factor).sum()), combinations + len(z)
        single, singles = single + int(near.sum()), singles + int(decided.sum())
        missing = [
            100 * row["missing"] / row["size"]
            for row in header["identification"]["force_errors"]
            if row["split"] == "validation"
        ]
        rows.append([float(np.mean(missing)), seconds, memory])
        print(
            f"| {seed} | {min(missing):.2f} to {max(missing):.2f} | {(np.abs(z) < factor).sum()} "
            f"of {len(z)} | {near.sum()} of {decided.sum()} | {seconds:.0f} | {memory:.2f} |",
            flush=True,
        )
    middle, seconds, memory = np.median(rows, axis=0)
    print(
        f"median: missing torque {middle:.2f} % in the mean of joints, {seconds:.0f} s, "
        f"{memory:.2f} GiB"
    )
    print(
        f"base parameters {inside} of {combinations} ({inside / combinations:.1%}), "
        f"values {single} of {singles} ({single / singles:.1%})"
    )


def halves(out: Path, count: int, first: int = 0) -> None:
    """How often two disjoint halves of an arm's records agree within their stated errors."""
    system = tn.load_system(ARM)
    agreed = compared = 0
    shares: list[float] = []
    for seed in range(first, first + count):
        records = list(record_in_loop(system, true_values(system, seed), 11, 10.0, seed=seed))
        held_out = records.pop()
        halves = []
        for half in (records[::2], records[1::2]):
            part = tn.DataSet("arm", (*(replace(e, split="train") for e in half), held_out))
            header, _, _ = fit(out / f"half{seed}-{len(halves)}", part)
            halves.append(estimates(header))
        (names, first, one, factor), (_, second, other, _) = halves
        # of what both know: priors draw both to the same values, which would agree too well
        z = deviations(system, names, first, second, one + other)
        agreed, compared = agreed + int((np.abs(z) < factor).sum()), compared + len(z)
        shares.append(float(np.mean(np.abs(z) < factor)))
        print(f"{seed}: {(np.abs(z) < factor).sum()} of {len(z)}", flush=True)
    print(
        f"base parameters that agree: {agreed} of {compared} ({agreed / compared:.1%}), "
        f"median of arms {np.median(shares):.1%}"
    )


def payload(count: int) -> None:
    """A ball of 2.5 kg at the flange: four records without it and four with it, and one more."""
    system, center = tn.load_system(ARM), np.array([0.05, 0.02, 0.1])
    robot = tn.load_robot(ARM, per={"flange": "payload"})
    for seed in range(count):
        empty = true_values(system, seed)
        records = [
            replace(e, name=f"{e.name}-{group}", groups=(("payload", group),))
            for group, values, more in (
                ("none", empty, 0),
                ("ball", with_payload(empty, "flange", 2.5, center), 1000),
            )
            for e in record_in_loop(system, values, 5, 10.0, seed=seed + more)
        ]
        start_time = time.perf_counter()
        result = tn.identify(tn.DataSet("arm", tuple(records)), robot, "inverse-dynamics")
        (sentence,) = [f.text for f in result.findings if f.code == "carries"]
        print(f"{seed}: {sentence}; {time.perf_counter() - start_time:.0f} s", flush=True)


def torque_errors(
    system: LagrangianSystem, values: dict[str, float], truth: dict[str, float], points: np.ndarray
) -> float:
    """Torques that values miss at positions, velocities and accelerations [%], mean over joints."""
    equations, n = system_equations(system), len(system.coordinates)
    formula = missing_forces(equations)
    none = np.zeros((len(points), len(system.inputs)))

    def torques(of: dict[str, float]) -> np.ndarray:
        rows = equations.parameter_rows(of, np.zeros((len(points), 0), int))
        return evaluate(formula, np.concatenate([points[:, : 3 * n], none, rows], axis=1))

    true = torques(truth)
    error = np.sqrt(np.mean((torques(values) - true) ** 2, axis=0))
    return float(np.mean(100 * error / np.sqrt(np.mean(true**2, axis=0))))


def stated_errors(system: LagrangianSystem, result: tn.Identification, count: int) -> np.ndarray:
    """Stated errors of the best determined combinations, in those of the priors, sorted."""
    names = [e.name for e in result.estimates]
    own = np.array([e.error or 0.0 for e in result.estimates]) / spreads(names, system)
    covariance = np.nan_to_num(result.correlation) * np.outer(own, own)
    sizes = np.linalg.eigvalsh(covariance)
    return np.sqrt(sizes[sizes > 0][:count])


def design(count: int) -> None:
    """A record of 10 s along a designed motion, a random one within limits, and sums of sines.

    The torques' noise is either that of one sensor, 2 % of the torques of random motions, or 2 % of
    the torques of each record.
    """
    system = tn.load_system(ARM)
    limits = gather_limits(system, {}, {}, system.channels)
    ends = np.array([own.position for own in limits.motion])
    speed = np.array([own.velocity for own in limits.motion])
    rng, options = np.random.default_rng(0), DesignOptions(budget=None)
    reach = np.concatenate([ends[:, 1], speed, 2 * np.pi * options.highest * speed])
    states = rng.uniform(-1, 1, (1000, len(reach))) * reach
    print(
        "| arm | noise | record | velocity of the limit | stated errors | torque missing at "
        "random states [%] | along other motions [%] |"
    )
    for seed in range(count):
        truth = true_values(system, seed)
        start_time = time.perf_counter()
        design = design_record(system, options=replace(options, seed=seed))
        print(
            f"designed in {time.perf_counter() - start_time:.0f} s, errors by random motions "
            f"{design.by_random:.2f} times as large",
            flush=True,
        )
        start = replace(options, seed=seed, iterations=0, starts=1)
        other = design_record(system, options=start)
        for law, noise in (("one sensor", design.noise), ("by record", 0.02)):
            others = [
                replace(e, split="validation", name=f"other{k}")
                for k, e in enumerate(
                    record_in_loop(system, truth, 4, 5.0, noise=noise, seed=500 + seed)
                )
            ]
            parts = [filter_record(e, 5.0) for e in others]
            along = np.concatenate([np.hstack([part.q, part.v, part.a]) for part in parts])
            stated: dict[str, np.ndarray] = {}
            for name, motions in (
                ("designed", [(design.q, design.v)]),
                ("random", [(other.q, other.v)]),
                ("sines", []),
            ):
                record = record_in_loop(
                    system, truth, 2, 10.0, noise=noise, seed=seed, motions=motions
                )[0]
                result = tn.identify(
                    tn.DataSet("arm", (record, others[0])), system, "inverse-dynamics"
                )
                stated[name] = stated_errors(system, result, 69)
                n = min(map(len, stated.values()))
                ratio = np.exp(np.mean(np.log(stated[name][:n] / stated["designed"][:n])))
                missing = [torque_errors(system, result.values, truth, x) for x in (states, along)]
                fastest = float(np.max(np.abs(record.velocities()) / speed))
                print(
                    f"| {seed} | {law} | {name} | {fastest:.2f} | {ratio:.2f} | {missing[0]:.3f} "
                    f"| {missing[1]:.3f} |",
                    flush=True,
                )


def score_in_loop(
    result: tn.Identification, values: Mapping[str, float], records: Sequence[tn.Experiment]
) -> float:
    """Mean RMSE of whole records [rad], the loop of a result with other values of the arm."""
    arrays = {name: jnp.asarray(values.get(name, x)) for name, x in result.values.items()}
    model = replace(result.model, continuous=result.system.model(arrays))
    return tn.mean_rmse(tn.evaluate(model, list(records), "derived-6"))


def loop(count: int, records: int) -> None:
    """Motion of whole held-out records: after inverse dynamics, short horizons, and in the loop."""
    system = tn.load_system(ARM)
    short = {"name": "short", "model": {"kind": "euler-lagrange"}, "search": {"horizon": 0.25}}
    print(
        "| arm | inverse dynamics [rad] | short horizons [rad] | in the loop [rad] "
        "| short, torques as recorded [rad] | s | s | s |"
    )
    for seed in range(count):
        truth = true_values(system, seed)
        in_loop, driven = (
            record_in_loop(
                system, truth, records, 10.0, seed=seed, knows_controller=knows, knows_gains=False
            )
            for knows in (True, False)
        )
        held_out = list(in_loop.split("validation"))
        first = tn.identify(in_loop, system, "inverse-dynamics")
        begin = {name: first.values[name] for name in system.nominal() if name in first.values}
        by_horizons = tn.identify(driven, system, short, begin=begin)
        closed = tn.identify(in_loop, system, "grey", begin=begin)
        scores = [
            score_in_loop(closed, result.values, held_out)
            for result in (first, by_horizons, closed)
        ]
        as_recorded = tn.evaluate(by_horizons.model, list(driven.split("validation")), "derived-6")
        times = [result.seconds for result in (first, by_horizons, closed)]
        print(
            f"| {seed} | {' | '.join(f'{x:.2e}' for x in scores)} "
            f"| {tn.mean_rmse(as_recorded):.2g} | {' | '.join(f'{x:.0f}' for x in times)} |",
            flush=True,
        )


if __name__ == "__main__":
    verb, *words = sys.argv[1:] or ["50"]
    if verb == "descriptions":
        descriptions(words)
    elif verb == "design":
        design(*map(int, words or ["3"]))
    elif verb == "loop":
        loop(*map(int, (words + ["5", "10"][len(words) :])))
    elif verb == "payload":
        payload(*map(int, words or ["10"]))
    elif verb in ("twins", "halves"):
        run = twins if verb == "twins" else halves
        run(Path(words[0]), *map(int, words[1:] or ["50"]))
    else:
        main(int(verb))
