"""Controllers for four of the twelve machines, played on the machines with all their effects.

    python benchmarks/machines.py write MACHINES
    python benchmarks/control_machines.py MACHINES OUT

Each machine is identified by the recipe `mechanism` from its records, without a system file; the
controller is designed on that model as `tustinnet control` does, and played from 20 starts on the
machine: dead zones, friction that depends on direction and warmth, delay, encoders.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
from simulated.machines import ball_on_beam, cart_pole, gantry_crane, unbalanced_disc
from simulated.measurement import Machine

import tustinnet as tn
from tustinnet.control.design import ControlTask, design_controller, find_rest
from tustinnet.control.sampled_plant import PlantOptions, SampledPlant
from tustinnet.control.trial import try_design
from tustinnet.data.units import convert_to_si
from tustinnet.simulate.range import Range
from tustinnet.store.header import read_header

TASKS = {  # the machine, where it is held, where a motion begins, limits of the input
    "cart-pole": (cart_pole, {"cart": 0.0, "pole": 0.0}, None, 10.0),
    "unbalanced-disc": (unbalanced_disc, {"disc": np.pi}, "rest", 3.0),
    "gantry-crane": (gantry_crane, {"trolley": 0.5, "load": 0.0}, {"trolley": 0.0}, 8.0),
    "ball-on-beam": (ball_on_beam, {"ball": 0.0, "beam": 0.0}, None, 10.0),
}
STARTS = 20


class MachinePlant(SampledPlant):
    """A simulated machine as a plant, with all that its system file does not have."""

    def __init__(self, machine: Machine, channels: tn.Channels, options: PlantOptions) -> None:
        super().__init__(channels, options, machine.name)
        self._machine, self._warmth = machine, np.array(0.5)

    def restart(self, q: np.ndarray) -> np.ndarray:
        """The state at rest."""
        return np.concatenate([q, np.zeros(len(q))])

    def advance(self, u: np.ndarray) -> np.ndarray:
        """The state a period later, by Runge and Kutta."""
        h = self._machine.dt / self._machine.substeps
        x = self.state[:, None]
        for _ in range(self._machine.substeps):
            k1 = self._rate(x, u)
            k2 = self._rate(x + h / 2 * k1, u)
            k3 = self._rate(x + h / 2 * k2, u)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + self._rate(x + h * k3, u))
        return x[:, 0]

    def _rate(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(self._machine.rate(0.0, x, u[:, None], self._warmth))


def play(machines: Path, out: Path, name: str) -> str:
    """A row of the table."""
    make, at, start, limit = TASKS[name]
    machine, logs, run = make(), machines / name / "logs", out / name
    file = run / "model.safetensors"
    if not file.is_file():
        words = ["fit", str(logs), "--recipe", "mechanism", "--out", str(run), "--no-report", "-q"]
        subprocess.run(
            [sys.executable, "-m", "tustinnet", *words], check=True, stdout=subprocess.DEVNULL
        )
    model, header, data = tn.load_model(file), read_header(file), tn.load(logs)
    limits = {"voltage": (-limit, limit)}
    begin = find_rest(model, at, limits) if start == "rest" else start
    task = ControlTask(at, begin, limits=limits, trust_beyond=True)
    design = design_controller(
        model, task, range=Range.from_header(header, model), records=[*data][:4]
    )
    counts = [
        2 * np.pi / s.counts if s.counts else s.step * convert_to_si(s.unit)[0]
        for s in machine.sensors
    ]
    options = PlantOptions(counts=counts, delay=machine.delay, limits=[[-limit, limit]])
    plant = MachinePlant(machine, model.channels, options)
    trial = try_design(design, header, plants={"machine": plant}, count=STARTS)
    successes = {row.kind: row.successes for row in trial.robustness.rows}
    row = trial.robustness.rows[-1]
    worst = ", ".join(f"{name} {value:.3g}" for name, value in row.worst.items())
    return (
        f"{name:<16} on its model {successes['nominal']:>2}, on the machine {row.successes:>2} of "
        f"{STARTS}; worst {worst}; {row.failures or 'none fails'}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for which in arguments.names or TASKS:
        print(play(arguments.machines, arguments.out, which), flush=True)
