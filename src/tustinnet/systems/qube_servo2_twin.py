"""The twin of the Qube-Servo 2, whose records `tustinnet demo` uses."""

from collections.abc import Mapping

import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.systems.qube_servo2 import WITH_MEMORY
from tustinnet.systems.twin import AS_LOGGED, Logger, TwinRun, simulate_twin

COUNT = 0.00306640625  # rad, 6.28 / 2048: the published logs take pi as 3.14
TWIN_NAME = "qube-servo2-twin"
# identified from the published training records with WITH_MEMORY, rounded
TWIN_VALUES = WITH_MEMORY.nominal() | {
    "arm_mass": 0.063,
    "arm_length": 0.0863,
    "pendulum_centre": 0.0737,
    "pendulum_inertia": 1.1e-5,
    "arm_damping": 5e-5,
    "pendulum_damping": 1e-5,
    "cable_stiffness": 1.56e-3,
    "cable_quadratic": 3e-5,
    "cable_cubic": 3.7e-4,
    "arm_friction": 3.7e-4,
    "cable_memory": 1.56e-3,
    "cable_relaxation": 3.6,
}
_TWIN_RUNS = {"train": (10, 5), "validation": (4, 2), "test": (4, 4)}
_AMPLITUDES = (2.0, 2.5, 3.0, 3.5, 4.0)  # V


def twin(
    seed: int = 0, logger: Logger = AS_LOGGED, values: Mapping[str, float] = TWIN_VALUES
) -> DataSet:
    """Records of a simulated Qube-Servo 2: free falls and white-noise voltage, in three splits.

    Numbers, lengths and starts are like those of the published records. The twin is a Lagrangian
    system, so it favours Lagrangian models: scores on it say nothing about scores on the apparatus.

    Args:
        seed: everything random follows from it.
        logger: the sampling.
        values: values of its parameters, by name; others make another device.
    """
    generator = np.random.default_rng(seed)
    runs = []
    for split, (falls, noises) in _TWIN_RUNS.items():
        label = "" if split == "train" else f"_{split}"
        runs += [_fall(f"twin_fall{label}{i + 1}", split, generator) for i in range(falls)]
        for i in range(noises):  # uniform white noise as the voltage, from rest, hanging
            x0 = np.array([generator.uniform(-0.05, 0.05), np.pi, 0.0, 0.0, 0.0])
            u = generator.uniform(-_AMPLITUDES[i], _AMPLITUDES[i], (1500, 1))
            runs.append(TwinRun(f"twin_noise{label}{i + 1}", split, x0, u))
    return simulate_twin(WITH_MEMORY, values, (COUNT, COUNT), runs, logger, generator, TWIN_NAME)


def _fall(name: str, split: str, generator: np.random.Generator) -> TwinRun:
    """A fall from near upright, to either side, most often almost from rest."""
    samples = int(generator.integers(716, 800))
    side = generator.choice([-1.0, 1.0])
    tilt = side * generator.uniform(0.25, 0.76)
    alpha = tilt if side > 0 else 2 * np.pi + tilt
    speeds = 3.0 * generator.uniform(0, 1, 2) ** 3 * np.array([generator.choice([-1.0, 1.0]), side])
    x0 = np.array([generator.uniform(-1.7, 1.0), alpha, *speeds, 0.0])
    return TwinRun(name, split, x0, np.zeros((samples, 1)))
