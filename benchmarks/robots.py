"""Robots against Pinocchio and MuJoCo: mass matrices, bias forces, energies, and time to compile.

    python benchmarks/robots.py [CHAINS]      (default: 50 random chains of up to 7 joints)

Needs the extras `bench` and `robots`. Each chain is compared at three states; differences are
relative to the largest number of each quantity, and the worst of all chains is printed.
"""

import jax

jax.config.update("jax_enable_x64", True)

import sys
import tempfile
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.engine.equations import Equations, Formula
from tustinnet.engine.runs import Runs, evaluate, simulate
from tustinnet.models.lagrangian import LagrangianSystem

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from robot_files import random_urdf  # pyright: ignore[reportMissingImports]

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
        {"mass": row[: n * n].reshape(n, n), "bias": row[n * n : -2],
         "kinetic": row[-2], "potential": row[-1]}
        for row in evaluate(Formula(terms, 2 * n), states)
    ]  # fmt: skip


def pinocchio_terms(text: str, names: list[str], states: np.ndarray) -> list[dict[str, Any]]:
    """The terms by Pinocchio."""
    pin = import_module("pinocchio")
    model = pin.buildModelFromXML(text)
    data, results = model.createData(), []
    joints = [model.joints[model.getJointId(name)] for name in names]
    places = [joint.idx_v for joint in joints]
    for q, v in (np.split(state, 2) for state in states):
        position, velocity = pin.neutral(model), np.zeros(model.nv)
        velocity[places] = v
        for joint, x in zip(joints, q, strict=True):
            # a continuous joint is a point of a circle
            both = [np.cos(x), np.sin(x)] if joint.nq == 2 else [x]
            position[joint.idx_q : joint.idx_q + joint.nq] = both
        upper = np.triu(pin.crba(model, data, position))
        mass = upper + np.triu(upper, 1).T
        results.append({
            "mass": mass[np.ix_(places, places)],
            "bias": pin.nonLinearEffects(model, data, position, velocity)[places],
            "kinetic": pin.computeKineticEnergy(model, data, position, velocity),
            "potential": pin.computePotentialEnergy(model, data, position),
        })  # fmt: skip
    return results


def mujoco_terms(text: str, names: list[str], states: np.ndarray) -> list[dict[str, Any]]:
    """Mass matrix and bias forces by MuJoCo."""
    mujoco = import_module("mujoco")
    spec = mujoco.MjSpec.from_string(text)
    for element in [*spec.geoms, *spec.meshes]:
        spec.delete(element)
    model = spec.compile()
    data, results = mujoco.MjData(model), []
    places = [model.joint(name).dofadr[0] for name in names]
    for q, v in (np.split(state, 2) for state in states):
        data.qpos[places], data.qvel[places] = q, v
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        results.append({"mass": mass[np.ix_(places, places)], "bias": data.qfrc_bias[places]})
    return results


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
            file.write_text(text := random_urdf(seed))
            system = tn.load_system(file)
            names = [c.name for c in system.coordinates]
            states = 2 * np.random.default_rng(seed).normal(size=(3, 2 * len(names)))
            own = own_terms(system, states)
            for tool, terms in (("Pinocchio", pinocchio_terms), ("MuJoCo", mujoco_terms)):
                others = terms(text, names, states)
                for mine, other in zip(own, others, strict=True):
                    for what, value in other.items():
                        difference = mine[what] - value
                        if what == "potential":  # up to a constant: of links fixed to the base
                            difference -= own[0][what] - others[0][what]
                        error = np.abs(difference).max() / max(1.0, np.abs(value).max())
                        key = f"{what} against {tool}"
                        worst[key] = max(worst.get(key, 0.0), float(error))
    for key, error in worst.items():
        print(f"{key:32s} {error:.1e}")
    operations, seconds = compile_seconds(tn.load_system(ARM))
    print(f"arm of 7 joints: {operations} operations, compiled in {seconds:.1f} s")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
