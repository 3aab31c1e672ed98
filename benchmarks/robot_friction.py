"""Friction of robots that nobody wrote down: by name, as a curve over the speed, as a network.

    python benchmarks/robot_friction.py [SEEDS]        (default: 3)

Records of a simulated SCARA with Stribeck friction in the loop of a PD controller: six of 5 s at
200 Hz, encoders of 16 bits, torque noise of 0.5 %. Identified by inverse dynamics with viscous and
Coulomb friction, with Stribeck friction, with friction curves, each as an option of the robot and
as a force of the recipe (`model.forces`); and a hybrid on top of the first. Printed are the missing
forces and the errors of free runs on the record that was held out.
"""

import jax

jax.config.update("jax_enable_x64", True)

import json
import sys
import time
from pathlib import Path

import numpy as np

import tustinnet as tn

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from robot_twins import record_in_loop, true_values  # pyright: ignore[reportMissingImports]

SCARA = ROOT / "examples" / "robots" / "scara.urdf"
HORIZONS = (0.25, 5.0)


def errors_of(model: tn.Model, data: tn.DataSet) -> list[float]:
    """Mean RMSE of free runs of the validation records over horizons [rad and m]."""
    held_out = data.split("validation")
    return [
        float(np.mean([s.rmse for s in tn.evaluate(model, held_out, "model-20", horizon=h)]))
        for h in HORIZONS
    ]


def main(seeds: int) -> None:
    """Prints a row for each seed and each way."""
    system = tn.load_robot(SCARA, friction=["stribeck"])
    print("| seed | friction | missing force, mean of joints [%] | RMSE over 0.25 s | 5 s | s |")
    for seed in range(seeds):
        data = record_in_loop(system, true_values(system, seed), 6, 5.0, noise=0.005, seed=seed)
        for name, friction, forces in (
            ("viscous, Coulomb", (), ()),
            ("and Stribeck", ("stribeck",), ()),
            ("and curve", ("curve",), ()),
            ("and Stribeck, by the recipe", (), ("stribeck",)),
            ("and curve, by the recipe", (), ("curve",)),
        ):
            start_time = time.perf_counter()
            recipe = tn.read_recipe("inverse-dynamics", [f"model.forces={json.dumps(forces)}"])
            result = tn.identify(data, tn.load_robot(SCARA, friction=friction), recipe)
            seconds = time.perf_counter() - start_time
            model = result.model
            if not (friction or forces):
                plain = model
            missing = np.mean([100 * e.share for e in result.force_errors])
            short, whole = errors_of(model, data)
            errors = f"{missing:.2f} | {short:.2g} | {whole:.2g}"
            print(f"| {seed} | {name} | {errors} | {seconds:.0f} |", flush=True)
        start_time = time.perf_counter()
        hybrid = tn.fit(data, "hybrid", physics=plain).model
        short, whole = errors_of(hybrid, data)
        print(
            f"| {seed} | hybrid on the first | | {short:.2g} | {whole:.2g} | "
            f"{time.perf_counter() - start_time:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
