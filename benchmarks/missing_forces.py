"""Which force the equations of motion of the rotary pendulum lack, without any simulation.

    python benchmarks/missing_forces.py FOLDER

The arm's equation is multiplied by smooth windows and integrated by parts, as for first values, and
is linear in its coefficients. Records of each kind are taken by themselves: a force that is there
lessens what is left in both, with coefficients that agree. What is left is of records left out in
turn; coefficients are in units of the pendulum's moment of the arm (arm length, mass, centre).
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np

import tustinnet as tn
from tustinnet.report.tables import Table

WINDOW = 16  # samples, a quarter of a swing
SLOW = 0.1  # rad/s, width of the smoothed sign
RELAXATION = 3.0  # 1/s
LEFT = "a3"  # the term that all others are to explain

Terms = dict[str, np.ndarray]


def signals(e: tn.Experiment) -> tuple[Terms, Terms, Terms]:
    """Momenta and forces of the arm's equation, and forces that it may lack, at every sample."""
    (theta, alpha), (w, s) = e.q.T, e.velocities("kalman").T
    dry = np.tanh(w / SLOW)
    z = relaxed(w, e.dt)
    momenta = {LEFT: np.cos(alpha) * s, "inertia": w, "sin^2": np.sin(alpha) ** 2 * w}
    forces = {"viscous": w, "dry": dry, "k": theta, "k2": theta**2, "k3": theta**3, "relaxing": z}
    if e.u.any():
        forces["u"] = np.concatenate([e.u[:1, 0], (e.u[1:, 0] + e.u[:-1, 0]) / 2])
    lacking = {
        "dry * size of theta": dry * np.abs(theta),
        "viscous * size of theta": w * np.abs(theta),
        "viscous * theta^2": w * theta**2,
        "relaxing * theta^2": z * theta**2,
        "relaxing * size of z": z * np.abs(z),
        "relaxing at 0.3/s": relaxed(w, e.dt, 0.3),
        "relaxing at 20/s": relaxed(w, e.dt, 20.0),
        "viscous * size of w": w * np.abs(w),
        "Stribeck, 0.5 rad/s": dry * np.exp(-((w / 0.5) ** 2)),
        "dry, width 1 rad/s": np.tanh(w),
        "theta^5": theta**5,
        "constant": np.ones_like(w),
        "sin alpha": np.sin(alpha),
        "sin 2 alpha": np.sin(2 * alpha),
    }
    return momenta, forces, lacking


def relaxed(w: np.ndarray, dt: float, rate: float = RELAXATION) -> np.ndarray:
    """The deflection of a spring that relaxes, (n,)."""
    z, kept = np.zeros_like(w), np.exp(-rate * dt)
    for k in range(1, len(w)):
        z[k] = kept * z[k - 1] + dt * (w[k] + w[k - 1]) / 2
    return z


def windowed(e: tn.Experiment) -> tuple[Terms, Terms]:
    """All terms of the equation, and those that it may lack, window by window."""
    s = np.linspace(-1, 1, WINDOW)
    bump = (1 - s**2) ** 3
    slope = -6 * s * (1 - s**2) ** 2 * 2 / ((WINDOW - 1) * e.dt)
    begins = np.arange(3, len(e) - WINDOW - 2, WINDOW // 2)
    rows = begins[:, None] + np.arange(WINDOW)
    momenta, forces, lacking = signals(e)
    known = {name: -x[rows] @ slope for name, x in momenta.items()}
    known |= {name: x[rows] @ bump for name, x in forces.items()}
    return known, {name: x[rows] @ bump for name, x in lacking.items()}


def left(columns: list[np.ndarray], y: np.ndarray, record: np.ndarray) -> tuple[float, float]:
    """What least squares leaves of records left out in turn, and the last coefficient of all."""
    a = np.stack(columns, axis=1)
    missed = 0.0
    for i in np.unique(record):
        out = record == i
        c = np.linalg.lstsq(a[~out], y[~out], rcond=None)[0]
        missed += float(np.sum((y[out] - a[out] @ c) ** 2))
    return missed, float(np.linalg.lstsq(a, y, rcond=None)[0][-1])


def lessened(experiments: list[tn.Experiment]) -> Mapping[str, tuple[float, float]]:
    """By force that may be lacking: the part of what is left that stays, and its coefficient."""
    each = [windowed(e) for e in experiments]
    known, lacking = (
        {name: np.concatenate([of[k][name] for of in each]) for name in each[0][k]} for k in (0, 1)
    )
    record = np.repeat(np.arange(len(each)), [len(of[0][LEFT]) for of in each])
    # what is measured best stands alone: the voltage where there is one
    alone = "u" if "u" in known else LEFT
    y, columns = known[alone], [x for name, x in known.items() if name != alone]
    base, _ = left(columns, y, record)
    unit = 1.0 if alone == LEFT else -np.linalg.lstsq(np.stack(columns, 1), y, rcond=None)[0][0]
    found = {}
    for name, x in lacking.items():
        stays, coefficient = left([*columns, x], y, record)
        found[name] = stays / base, coefficient / unit
    return found


def main() -> None:
    """Reads the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    data = tn.load(parser.parse_args().folder)
    kinds = [[e for e in data if bool(e.u.any()) is driven] for driven in (False, True)]
    falls, noise = (lessened(of) for of in kinds)
    rows = [
        [name, *(f"{x:.3g}" for of in (falls, noise) for x in of[name])]
        for name in sorted(falls, key=lambda name: falls[name][0] * noise[name][0])
    ]
    head = ["added", "falls: left", "coefficient", "white noise: left", "coefficient"]
    print(Table(head, rows).markdown())


if __name__ == "__main__":
    main()
