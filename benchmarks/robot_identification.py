"""Identification of a simulated arm by this package, by least squares and by mujoco.sysid.

    python benchmarks/robot_identification.py ols [COUNT [FRICTION ...]]
    python benchmarks/robot_identification.py mujoco [COUNT [ITERATIONS [STEPS]]]

`ols`: 10 records of 10 s and one that is held out, of an arm of 7 joints with the friction of these
names beside the viscous and the Coulomb one (`stribeck`, `load`; see `tn.load_robot`). Missing
torques on the held-out record by least squares in base parameters (friction viscous and Coulomb),
ordinary and weighted by what each joint leaves, as in Gautier, Khalil (1990), on records that are
filtered and thinned out as this package does it; and by `inverse-dynamics` with viscous and Coulomb
friction, with the names, and with a friction curve. Of all joints the mean is printed.

`mujoco`: an arm that MuJoCo simulates with its own friction in the loop of a PD controller: three
records of 5 s and one that is held out, with this number of steps by sample (default 10: a machine
moves between samples; with 1 the records are those of the model that `mujoco.sysid` integrates,
errors of its steps included). `mujoco.sysid` gets them in pieces of 0.5 s with positions
and velocities, log-Cholesky inertias, armature, damping and frictionloss of all joints, in the
ranges of this package, and stops as its defaults say (200 iterations at most), or after fewer. This
package identifies by inverse dynamics (`forces`), and from there by simulation over pieces as long
(`simulated`, seconds of both together). All results are judged by MuJoCo: torques along the
held-out record against those that it has and those of the true parameters, and motion over pieces
of 0.25 s. Needs the extras `bench` and `robots`.
"""

import jax

jax.config.update("jax_enable_x64", True)

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.fitting.inverse_dynamics.along import filter_record
from tustinnet.fitting.inverse_dynamics.cutoff import cutoff_for
from tustinnet.models.chains import BodyInertia, body_inertia
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.signals.low_pass import low_pass, occupied_band
from tustinnet.systems.robot_equations import RobotEquations

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from robot_twins import record_in_loop, true_values  # pyright: ignore[reportMissingImports]

ARM = ROOT / "examples" / "robots" / "arm7.urdf"
_TRUNCATED = 1e-8  # singular values by the largest one that count as none
_ENCODER = 2 * np.pi / 2**16  # [rad]
_NOISE = 0.02  # of torques, by their root mean square
_STEP = 0.002  # of MuJoCo and its records [s]
_PIECE, _HORIZON = 250, 125  # samples of a piece that is fitted, and of one that is judged
_SIMULATED = {
    "name": "pieces",
    "model": {"kind": "euler-lagrange"},
    "search": {"horizon": _PIECE * _STEP},
}


def regressor(system: LagrangianSystem, part: Any) -> np.ndarray:
    """Forces by linear parameters along a filtered record, (n, n_q, n_p).

    Ten of each body; then of each joint armature, viscous and Coulomb friction, and an offset.
    """
    # the kinetic energy of a robot is a method of its equations, which a system does not name
    equations = system.kinetic.__self__  # pyright: ignore[reportFunctionMemberAccess]
    assert isinstance(equations, RobotEquations)
    chain = equations.chain
    n, bodies = len(system.coordinates), len(chain.bodies)
    upper = np.triu_indices(3)

    def forces(numbers: Any, q: Any, v: Any, a: Any) -> Any:
        inertias: list[BodyInertia | None] = []
        for own in numbers.reshape(bodies, 10):
            half = jnp.zeros((3, 3)).at[upper].set(own[4:])
            inertias.append(BodyInertia(own[0], own[1:4], half + half.T - jnp.diag(jnp.diag(half))))
        return chain.inertial_forces(q, v, a, inertias, chain.gravity)

    slopes = jax.jit(jax.vmap(jax.jacfwd(forces), (None, 0, 0, 0)))
    q, v, a = part.q, part.v, part.a
    inertial = np.asarray(slopes(jnp.zeros(10 * bodies), q, v, a))
    joints = [a, v, np.sign(v), np.ones_like(v)]
    own = np.concatenate([x[:, :, None] * np.eye(n) for x in joints], axis=2)
    whole = np.concatenate([inertial, own], axis=2)
    return part.compare(whole.reshape(len(whole), -1)).reshape(-1, n, whole.shape[2])


def least_squares(rows: np.ndarray, torques: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Linear parameters by truncated least squares, each joint weighted, (n_p,)."""
    a = (rows * weights[:, None]).reshape(-1, rows.shape[2])
    size = np.linalg.norm(a, axis=0)
    size[size == 0] = 1.0
    return np.linalg.lstsq(a / size, (torques * weights).ravel(), _TRUNCATED)[0] / size


def missing_by_least_squares(
    system: LagrangianSystem, data: tn.DataSet, is_weighted: bool
) -> np.ndarray:
    """Missing torques on the held-out record by those that it has, (n_q,)."""
    n = len(system.coordinates)
    train, held_out = data.split("train"), data.split("validation")
    cutoff = cutoff_for(max(occupied_band(e.q, e.dt) for e in train), train[0].dt)
    regressions = []
    for records in (train, held_out):
        parts = [filter_record(e, cutoff) for e in records]
        rows = np.concatenate([regressor(system, part) for part in parts])
        regressions.append((rows, np.concatenate([p.compare(p.u) for p in parts])))
    (rows, torques), (held_rows, held_torques) = regressions
    weights = np.ones(n)
    parameters = least_squares(rows, torques, weights)
    if is_weighted:
        weights = 1 / np.std(torques - rows @ parameters, axis=0)
        parameters = least_squares(rows, torques, weights)
    missing = held_torques - held_rows @ parameters
    return np.sqrt(np.mean(missing**2, axis=0) / np.mean(held_torques**2, axis=0))


def missing_by_inverse_dynamics(system: LagrangianSystem, data: tn.DataSet) -> np.ndarray:
    """Missing torques on the held-out record by those that it has, (n_q,)."""
    result = tn.identify(data, system, "inverse-dynamics")
    return np.array([e.share for e in result.force_errors])


def compare_to_least_squares(count: int, friction: Sequence[str]) -> None:
    """Prints missing torques of arms, and by how much they are less than those of least squares."""
    plain = tn.load_robot(ARM)
    # without names the arm has the friction of the regressor, and any robot file will do
    twin = tn.load_robot(ARM, friction=friction) if friction else plain
    ways: dict[str, Callable[[tn.DataSet], np.ndarray]] = {
        "least squares": lambda data: missing_by_least_squares(plain, data, is_weighted=False),
        "weighted": lambda data: missing_by_least_squares(plain, data, is_weighted=True),
        "viscous, Coulomb": lambda data: missing_by_inverse_dynamics(plain, data),
    }
    if friction:
        ways[" and ".join(friction)] = lambda data: missing_by_inverse_dynamics(twin, data)
        curve = tn.load_robot(ARM, friction=["curve"])
        ways["curve"] = lambda data: missing_by_inverse_dynamics(curve, data)
    print(f"missing torque, mean of joints [%]\n| arm | {' | '.join(ways)} |", flush=True)
    rows = []
    for seed in range(count):
        data = record_in_loop(twin, true_values(twin, seed), 11, 10.0, seed=seed, noise=_NOISE)
        rows.append([100 * float(np.mean(way(data))) for way in ways.values()])
        print(f"| {seed} | {' | '.join(f'{x:.2f}' for x in rows[-1])} |", flush=True)
    medians = np.median(rows, axis=0)
    print(f"| median | {' | '.join(f'{x:.2f}' for x in medians)} |")
    for name, share in zip(ways, medians / medians[0], strict=True):
        print(f"{name}: {share:.0%} of ordinary least squares")


def arm_for_mujoco(mujoco: Any, values: Mapping[str, float], steps: int = 1) -> Any:
    """The arm in MuJoCo with values of parameters, motors and sensors; steps by sample."""
    spec = mujoco.MjSpec.from_string(ARM.read_text())
    for geom in spec.geoms:
        spec.delete(geom)
    spec.delete(spec.body("tool"))  # a part of the flange here
    spec.option.timestep = _STEP / steps
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    for joint in spec.joints:
        joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        joint.armature = values[f"{joint.name}.armature"]
        joint.damping[0] = values[f"{joint.name}.viscous"]
        joint.frictionloss = values[f"{joint.name}.coulomb"]
        motor = spec.add_actuator(
            name=f"{joint.name}_motor", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.set_to_motor()
        for kind in ("POS", "VEL"):
            spec.add_sensor(
                name=f"{joint.name}_{kind.lower()}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_JOINT{kind}"),
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=joint.name,
            )
    for body in spec.bodies:
        if f"{body.name}.mass" not in values:
            continue
        # of a body only name and anchor count
        own = body_inertia(SimpleNamespace(name=body.name, anchor=np.zeros(3)), values)  # pyright: ignore[reportArgumentType]
        set_inertia(body, float(own.mass), np.asarray(own.moment), np.asarray(own.tensor))
    return spec


def set_inertia(body: Any, mass: float, moment: np.ndarray, tensor: np.ndarray) -> None:
    """Writes the inertia about the origin of its frame to a body of MuJoCo."""
    center = moment / mass
    tensor = tensor - mass * (center @ center * np.eye(3) - np.outer(center, center))
    body.explicitinertial = True
    body.mass, body.ipos = mass, center
    body.fullinertia = [*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]]


def record_by_mujoco(
    mujoco: Any, model: Any, count: int, seconds: float, seed: int, steps: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Positions by encoders, (n, n_q), and noisy torques, (n, n_q), in the loop of a PD controller.

    Set points are sums of sines, as those of the twins of `robot_twins`. Torques end at the effort
    of the joints, as MuJoCo has it, too.
    """
    rng, t, n = np.random.default_rng(seed), np.arange(0, seconds, _STEP), model.nv
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    stiffness = np.diag(mass) * 20.0**2 + 10.0 * model.dof_frictionloss / 0.6
    damping = 2 * 0.8 * np.sqrt(np.diag(mass) * stiffness)
    records = []
    for _ in range(count):
        omega = 2 * np.pi * rng.uniform(0.1, 1.2, (5, n))
        size, phase = 0.6 * rng.uniform(0.2, 0.5, (5, n)), rng.uniform(0, 2 * np.pi, (5, n))
        angle = omega * t[:, None, None] + phase
        set_points = rng.uniform(-0.5, 0.5, n) + np.sum(size * np.sin(angle), axis=1)
        speed = np.sum(size * omega * np.cos(angle), axis=1)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = set_points[0], speed[0]
        positions, torques = np.empty((len(t), n)), np.empty((len(t), n))
        for i in range(len(t)):
            positions[i] = data.qpos
            asked = stiffness * (set_points[i] - data.qpos) + damping * (speed[i] - data.qvel)
            torques[i] = np.clip(asked, *model.jnt_actfrcrange.T)
            data.ctrl[:] = torques[i]
            mujoco.mj_step(model, data, steps)
        noisy = torques + _NOISE * torques.std(axis=0) * rng.normal(size=torques.shape)
        records.append((np.round(positions / _ENCODER) * _ENCODER, noisy))
    return records


def pieces(positions: np.ndarray, torques: np.ndarray, length: int) -> list[tuple[np.ndarray, ...]]:
    """Positions, velocities and torques of pieces of a record, each (length, n_q)."""
    cutoff = 6 * occupied_band(positions, _STEP)
    speeds = low_pass(positions, _STEP, cutoff, 1)
    edge = round(1 / (cutoff * _STEP))
    starts = range(edge, len(positions) - edge - length + 1, length)
    return [tuple(x[k : k + length] for x in (positions, speeds, torques)) for k in starts]


def fit_by_mujoco(
    mujoco: Any,
    system: LagrangianSystem,
    records: Sequence[tuple[np.ndarray, np.ndarray]],
    iterations: int | None,
) -> Any:
    """The model that `mujoco.sysid` identifies: from the file's values, in the system's ranges."""
    sysid = import_module("mujoco.sysid")
    spec = arm_for_mujoco(mujoco, system.nominal())
    model, by_name = spec.compile(), {p.name: p for p in system.parameters}
    parameters = sysid.ParameterDict()
    for body in [b.name for b in spec.bodies if f"{b.name}.mass" in by_name]:

        def write_inertia(s: Any, own: Any, body: str = body) -> None:
            mass, *others = sysid.model_modifier.pi_from_theta(own.value)
            moment, tensor = np.array(others[:3]), np.reshape(others[3:], (3, 3))
            set_inertia(s.body(body), mass, moment, tensor)

        parameters.add(
            sysid.body_inertia_param(
                spec.copy(),
                model,
                body,
                sysid.InertiaType.Pseudo,
                mass_bound_mult=np.array([0.2, 5.0]),
                stretch_bound_mult=np.array([0.2, 5.0]),
                # its own compiles the model for each body, and 4.0 refuses what it writes
                modifier=write_inertia,
            )
        )
    for joint in [j.name for j in spec.joints]:
        for ours, theirs in (
            ("armature", "armature"),
            ("viscous", "damping"),
            ("coulomb", "frictionloss"),
        ):
            p = by_name[f"{joint}.{ours}"]

            def write(s: Any, own: Any, joint: str = joint, theirs: str = theirs) -> None:
                if theirs == "damping":
                    s.joint(joint).damping[0] = own.value[0]
                else:
                    setattr(s.joint(joint), theirs, own.value[0])

            parameters.add(
                sysid.Parameter(f"{joint}.{ours}", p.nominal, p.lower, p.upper, modifier=write)
            )
    # its own advice: no parameter begins at a bound
    parameters.move_off_bounds()
    states, controls, sensors = [], [], []
    names = [model.sensor(k).name for k in range(model.nsensor)]
    for record in records:
        for positions, speeds, torques in pieces(*record, _PIECE):
            times = _STEP * np.arange(len(positions))
            states.append(sysid.create_initial_state(model, positions[0], speeds[0]))
            controls.append(sysid.TimeSeries(times, torques))
            measured = np.stack([positions, speeds], axis=2).reshape(len(times), -1)
            sensors.append(sysid.TimeSeries.from_names(times, measured, model, names))
    sequences = sysid.ModelSequences(
        "arm", spec, [str(k) for k in range(len(states))], states, controls, sensors
    )
    compiled: dict[bytes, Any] = {}

    def build(changed: Any, base: Any) -> Any:
        """The model of parameters, compiled once for all pieces."""
        key = changed.as_vector().tobytes()
        if key not in compiled:
            if len(compiled) > 2 * parameters.size:
                compiled.clear()
            compiled[key] = sysid.apply_param_modifiers(changed, base)
        return compiled[key]

    residuals = sysid.build_residual_fn(models_sequences=[sequences], build_model=build)
    limit = {} if iterations is None else {"max_iters": iterations}
    optimum, _ = sysid.optimize(parameters, residuals, verbose=False, **limit)
    return sysid.apply_param_modifiers(optimum, spec.copy())


def torques_along(mujoco: Any, model: Any, motion: Sequence[np.ndarray]) -> np.ndarray:
    """Torques that a motion needs by MuJoCo, its own dry friction included, (n, n_q)."""
    data, torques = mujoco.MjData(model), np.empty_like(motion[0])
    for i, (q, v, a) in enumerate(zip(*motion, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(model, data)
        torques[i] = data.qfrc_inverse
    return torques


def motion_error(
    mujoco: Any, model: Any, record: tuple[np.ndarray, np.ndarray], steps: int
) -> float:
    """Root mean square error of positions over pieces of a record [rad]."""
    data, squares = mujoco.MjData(model), []
    for positions, speeds, torques in pieces(*record, _HORIZON):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = positions[0], speeds[0]
        for torque, position in zip(torques[:-1], positions[1:], strict=True):
            data.ctrl[:] = torque
            mujoco.mj_step(model, data, steps)
            squares.append((data.qpos - position) ** 2)
    return float(np.sqrt(np.mean(squares)))


def compare_to_mujoco(count: int, iterations: int | None = None, steps: int = 10) -> None:
    """Prints errors and seconds of both for each arm, and medians.

    Args:
        count: number of arms.
        iterations: of `mujoco.sysid` at most; None for its default.
        steps: of the simulation by sample.
    """
    mujoco = import_module("mujoco")
    system = tn.load_robot(ARM)
    offsets = {f"{c.name}.offset": 0.0 for c in system.coordinates}  # MuJoCo has none
    print("| arm | by | torques that are missing [%] | off the true ones [%] | motion [mrad] | s |")
    rows: dict[str, list[list[float]]] = {name: [] for name in ("forces", "simulated", "sysid")}
    for seed in range(count):
        truth = true_values(system, seed) | offsets
        true_model = arm_for_mujoco(mujoco, truth, steps).compile()
        *records, held_out = record_by_mujoco(mujoco, true_model, 4, 5.0, seed, steps)
        data = tn.DataSet(
            "arm",
            tuple(
                tn.from_arrays(
                    q,
                    u,
                    dt=_STEP,
                    coordinates=[
                        tn.Coordinate(c.name, c.kind, _ENCODER) for c in system.coordinates
                    ],
                    inputs=[
                        tn.Input(i.name, i.unit, "zero-order", is_delay_declared=True)
                        for i in system.inputs
                    ],
                    name=f"run{k}",
                    split="train",
                )
                for k, (q, u) in enumerate(records)
            ),
        )
        cutoff = cutoff_for(occupied_band(held_out[0], _STEP), _STEP)
        motion = [low_pass(held_out[0], _STEP, 3 * cutoff, k) for k in range(3)]
        measured, true = held_out[1], torques_along(mujoco, true_model, motion)
        edge = slice(round(1 / (cutoff * _STEP)), -round(1 / (cutoff * _STEP)))
        size = np.sqrt(np.mean(measured**2, axis=0))
        values, seconds = offsets, 0.0
        for name in rows:
            start_time = time.perf_counter()
            if name == "sysid":
                model, seconds = fit_by_mujoco(mujoco, system, records, iterations), 0.0
            else:
                recipe = "inverse-dynamics" if name == "forces" else _SIMULATED
                values = tn.identify(data, system, recipe, begin=values, fixed=offsets).values
                model = arm_for_mujoco(mujoco, values).compile()
            # it has integrated with a step by sample; all are judged with those of the truth
            model.opt.timestep = _STEP / steps
            seconds += time.perf_counter() - start_time
            own = torques_along(mujoco, model, motion)
            missing, off = (
                100 * np.sqrt(np.mean(low_pass(own - x, _STEP, cutoff)[edge] ** 2, axis=0)) / size
                for x in (measured, true)
            )
            error = 1000 * motion_error(mujoco, model, held_out, steps)
            row = [float(missing.mean()), float(off.mean()), error, seconds]
            rows[name].append(row)
            print(
                f"| {seed} | {name} | {row[0]:.2f} | {row[1]:.2f} | {row[2]:.3f} | {row[3]:.0f} |",
                flush=True,
            )
    medians = {name: np.median(measured, axis=0) for name, measured in rows.items()}
    for name, (a, b, c, d) in medians.items():
        print(f"| median | {name} | {a:.2f} | {b:.2f} | {c:.3f} | {d:.0f} |")
    times = [medians["sysid"][3] / medians[name][3] for name in ("forces", "simulated")]
    print("{:.0f} and {:.0f} times as fast".format(*times))


if __name__ == "__main__":
    verb, *words = sys.argv[1:] or ["ols"]
    if verb == "mujoco":
        compare_to_mujoco(*map(int, words or ["3"]))
    else:
        number, *names = words or ["10", "stribeck", "load"]
        compare_to_least_squares(int(number), names)
