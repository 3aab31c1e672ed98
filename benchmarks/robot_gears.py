"""Elastic gears with encoders at the motors: free runs, stiffnesses, and whether intervals hold.

    python benchmarks/robot_gears.py models [SEEDS]          (default: 3)
    python benchmarks/robot_gears.py intervals [SEEDS]       (default: 12)

Records of a simulated arm of three joints that a PD controller moves by its motors' encoders: four
of 5 s at 250 Hz, the robot moves before they begin. Two gears are elastic; the search begins at
stiffnesses that are off by a third.

`models` identifies three models on the same records: with rigid gears, with elastic gears whose
encoders are taken to be at the links, and with those at the motors. Printed are errors of free
runs on the record that was held out; for comparison those of the arm's own values, which are what
encoders and noise of the torques leave.

`intervals` counts how many true stiffnesses, dampings and armatures are within 95 % intervals,
on an arm of two joints: with encoders of several resolutions, torques with and without noise, few
and more records, driven by the recorded torques or with the controller in the loop.
"""

import jax

jax.config.update("jax_enable_x64", True)

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np

import tustinnet as tn

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from robot_twins import record_in_loop, true_values  # pyright: ignore[reportMissingImports]

ARM = ROOT / "examples" / "robots" / "arm7.urdf"
LOCKED = {"joint3": 0.0, "joint5": 0.0, "joint6": 0.0, "joint7": 0.0}
TRUE_GEARS = {"joint2": 4000.0, "joint4": 2000.0}
GEARS = {"joint2": 3000.0, "joint4": 2600.0}
DAMPING = {"joint2": 4.0, "joint4": 2.0}
HORIZONS = (0.1, 0.25, 0.5)
DT = 0.004
RECIPE = {"name": "gears", "model": {"kind": "euler-lagrange"}, "search": {"horizon": 0.5}}


def load_arm(
    encoders: str, *, is_elastic: bool = True, locked: Mapping[str, float] = MappingProxyType({})
) -> tn.LagrangianSystem:
    """The arm with three joints, or less where more of them are locked."""
    locked = {**LOCKED, **locked}
    if not is_elastic:
        return tn.load_robot(ARM, locked=locked)
    return tn.load_robot(ARM, locked=locked, elastic=GEARS, encoders=encoders)


def make_records(
    seed: int,
    noise: float,
    resolution: float,
    *,
    locked: Mapping[str, float] = MappingProxyType({}),
    count: int = 4,
    knows_controller: bool = False,
) -> tuple[tn.LagrangianSystem, dict[str, float], tn.DataSet]:
    """The arm with encoders at the motors, its true values, and records of it."""
    system = load_arm("motor", locked=locked)
    truth = true_values(system, seed)
    for joint, stiffness in TRUE_GEARS.items():
        truth[f"{joint}.gear_stiffness"] = stiffness
        truth[f"{joint}.gear_damping"] = DAMPING[joint]
    data = record_in_loop(
        system,
        truth,
        count,
        5.0,
        dt=DT,
        noise=noise,
        seed=seed,
        substeps=8,
        begins_moving=True,
        resolution=resolution,
        knows_controller=knows_controller,
    )
    return system, truth, data


def errors_of(model: tn.Model, data: tn.DataSet) -> list[float]:
    """Mean RMSE of free runs of the validation record over horizons [rad]."""
    held_out = list(data.split("validation"))
    return [tn.mean_rmse(tn.evaluate(model, held_out, "model-20", horizon=h)) for h in HORIZONS]


def compare_models(seeds: int) -> None:
    """Prints a row for each arm and model."""
    columns = " | ".join(f"RMSE over {h:g} s [rad]" for h in HORIZONS)
    print(f"| seed | model | {columns} | stiffness of joint2, joint4 [N m/rad] | s |")
    for seed in range(seeds):
        system, truth, data = make_records(seed, 0.002, 2 * np.pi / 2**16)
        for name, own in (
            ("rigid gears", load_arm("motor", is_elastic=False)),
            ("encoders at the links", load_arm("link")),
            ("encoders at the motors", system),
        ):
            result = tn.identify(data, own, RECIPE)
            shown = [f"{e:.2e}" for e in errors_of(result.model, data)]
            gears = [e for e in result.estimates if e.name.endswith("gear_stiffness")]
            listed = ", ".join(f"{e.value:.0f} ± {2 * (e.error or np.nan):.0f}" for e in gears)
            print(
                f"| {seed} | {name} | {' | '.join(shown)} | {listed} | {result.seconds:.0f} |",
                flush=True,
            )
        values = {name: jnp.asarray(truth[name]) for name in system.nominal()}
        model = replace(result.model, continuous=system.model(values))
        shown = [f"{e:.2e}" for e in errors_of(model, data)]
        listed = ", ".join(f"{x:.0f}" for x in TRUE_GEARS.values())
        print(f"| {seed} | its own values | {' | '.join(shown)} | {listed} | |", flush=True)


def count_intervals(seeds: int) -> None:
    """Prints a row for each kind of records: how often true values are within their intervals."""
    kinds = ("gear_stiffness", "gear_damping", "armature")
    print(
        f"| driven by | encoder | torque noise | records | {' | '.join(kinds)} "
        "| errors of stiffness and damping by stated ones |"
    )
    for in_loop, bits, noise, count in (
        (False, 16, 0.002, 4),
        (False, 13, 0.0, 4),
        (True, 13, 0.002, 4),
        (False, 16, 0.0, 4),
        (False, 16, 0.002, 9),
    ):
        inside: dict[str, list[bool]] = {kind: [] for kind in kinds}
        deviations = []
        for seed in range(seeds):
            _, truth, data = make_records(
                seed,
                noise,
                2 * np.pi / 2**bits,
                locked={"joint1": 0.0},
                count=count,
                knows_controller=in_loop,
            )
            system = load_arm("motor", locked={"joint1": 0.0})
            result = tn.identify(data, system, "grey" if in_loop else RECIPE)
            for e in result.estimates:
                if (kind := e.name.rpartition(".")[2]) in kinds and e.interval and e.error:
                    inside[kind].append(e.interval[0] <= truth[e.name] <= e.interval[1])
                    if kind != "armature":
                        deviations.append((e.value - truth[e.name]) / e.error)
        shown = [f"{sum(own)} of {len(own)}" for own in inside.values()]
        by = "set points" if in_loop else "torques"
        print(
            f"| {by} | {bits} bits | {100 * noise:g} % | {count - 1} | {' | '.join(shown)} "
            f"| {np.sqrt(np.mean(np.square(deviations))):.2f} |",
            flush=True,
        )


if __name__ == "__main__":
    verb, *words = sys.argv[1:] or ["models"]
    if verb == "intervals":
        count_intervals(*map(int, words or ["12"]))
    else:
        compare_models(*map(int, words or ["3"]))
