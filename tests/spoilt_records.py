"""Records of the small pendulum, some of which spoil a fit: a hand's force, another inertia."""

from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import numpy as np
from conftest import CARD, COUNT, DT

import tustinnet as tn

SAMPLES = 400
HAND = slice(150, 225)  # 3 to 4.5 s
BEGIN, END = 3.0, 4.5
FRICTION = 1.5  # N m, twice as much at the onset of motion
SLOW = 4  # seed of the record with another motion


def simulate(
    name: str,
    seed: int,
    *,
    inertia: float = 1.0,
    hand: bool = False,
    friction: float = 0.0,
    weak: bool = False,
    split: str | None = None,
) -> tn.Experiment:
    """A record of the pendulum under steps of torque, with a hand's force or another inertia.

    With dry friction, one record has another motion for a while: it turns around slowly. A weak
    actuator gives no more than a torque of 3, and is asked for more in every other record.
    """
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-3, 3, SAMPLES // 10), 10)
    if friction and seed == SLOW:
        u[100:300] = 4.0 * np.sin(np.linspace(0, 5 * np.pi, 200))
    if weak and seed % 2:
        first = 60 if seed == 1 else 200
        u[first : first + (160 if seed == 1 else 20)] *= 5.0
    force = np.zeros(SAMPLES)
    if hand:
        force[HAND] = 12 * np.sin(np.linspace(0, 3 * np.pi, HAND.stop - HAND.start))
    x, angles, h = np.array([rng.uniform(-0.5, 0.5), 0.0]), np.empty(SAMPLES), DT / 10

    def rate(x: np.ndarray, k: int) -> np.ndarray:
        torque = (
            -20 * np.sin(x[0])
            - 0.8 * x[1]
            + 4 * (np.clip(u[k], -3, 3) if weak else u[k])
            + force[k]
        )
        torque -= friction * (1 + np.exp(-((x[1] / 0.3) ** 2))) * np.tanh(x[1] / 0.02)
        return np.array([x[1], torque / inertia])

    for k in range(SAMPLES):
        angles[k] = x[0]
        for _ in range(10):
            x = x + h * rate(x + h / 2 * rate(x, k), k)
    return tn.from_arrays(
        np.round(angles / COUNT) * COUNT,
        u,
        dt=DT,
        coordinates=[tn.Coordinate("angle", "angular", COUNT)],
        inputs=[tn.Input("torque", "N m", "zero-order", is_delay_declared=True)],
        name=name,
        split=split,
    )


@lru_cache
def records(spoilt: str = "") -> tuple[tn.Experiment, ...]:
    """Six records, the third with a hand's force, the second and the third with more inertia.

    Spoilt by "friction", all have dry friction; by "both", the third has the hand's force, too.
    """
    return tuple(
        simulate(
            f"run{i}",
            i,
            hand=spoilt in ("hand", "both") and i == 2,
            weak=spoilt == "weak",
            friction=FRICTION if spoilt in ("friction", "both") else 0.0,
            inertia=1.4 if spoilt == "payload" and i in (1, 2) else 1.0,
            split="train",
        )
        for i in range(6)
    )


def write(folder: Path, experiments: Iterable[tn.Experiment]) -> None:
    """Writes records as CSV files with a card without splits."""
    folder.mkdir()
    for e in experiments:
        rows = np.column_stack([e.t, np.rad2deg(e.q[:, 0]), e.u[:, 0]])
        np.savetxt(
            folder / f"{e.name}.csv", rows, "%.9g", ",", header="time,angle,torque", comments=""
        )
    (folder / "dataset.toml").write_text(CARD.split("[splits]")[0])
