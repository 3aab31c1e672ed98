"""Records of a pendulum on a motor that a PD controller holds about upright, and their card."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import jax.numpy as jnp
import numpy as np
import polars as pl
from swinging import COUNT, DT, SWING, TILT, TRUTH

import tustinnet as tn
from tustinnet.data.loading import from_frame

KP, KD = 40.0, 4.0
LIMIT = 12.0  # V


def card(kind: str = "pd", **loop: Any) -> dict[str, Any]:
    """The data card of `table`, with keys of its loop added; a key of None is left out."""
    keys = {
        "input": "voltage",
        "coordinate": "angle",
        "position": "wanted",
        "velocity": "wanted_rate",
        "feedforward": "extra",
        "kp": KP,
        "kd": KD,
    } | loop
    return {
        "name": "held",
        "dt": DT,
        "coordinates": [
            {"name": "angle", "kind": "angular", "column": "read", "resolution": COUNT}
        ],
        "inputs": [{"name": "voltage", "column": "volts", "unit": "V", "limits": [-LIMIT, LIMIT]}],
        "controller": {"kind": kind, "loops": [{k: x for k, x in keys.items() if x is not None}]},
    }


def table(
    seconds: float = 6.0,
    seed: int = 0,
    noise: float = 0.05,
    ki: float = 0.0,
    velocity_filter: float = 0.0,
    delay: int = 0,
) -> dict[str, np.ndarray]:
    """Columns of a log: the angle as read, the voltage with noise, and set points.

    Args:
        seconds: length [s].
        seed: of set points and noise.
        noise: standard deviation of the recorded voltage [V].
        ki: gain of the integral of deviations [V/rad/s].
        velocity_filter: time constant of the filter of the velocity [s].
        delay: samples after which a voltage acts.
    """
    rng, t = np.random.default_rng(seed), np.arange(0, seconds, DT)
    omega, phase = 2 * np.pi * rng.uniform(0.1, 0.8, 3), rng.uniform(0, 2 * np.pi, 3)
    sines = omega * t[:, None] + phase
    upright = np.pi + TILT
    wanted = upright + 0.2 * np.sin(sines).sum(axis=1)
    rate, extra = 0.2 * (omega * np.cos(sines)).sum(axis=1), 0.5 * np.sin(7 * t)
    step = tn.compiled_step(
        tn.discretise(SWING.model({k: jnp.asarray(x) for k, x in TRUTH.items()}), DT, 4)
    )
    x, angles, volts = np.array([wanted[0], rate[0]]), [], []
    share = 1.0 - np.exp(-DT / velocity_filter) if velocity_filter else 1.0
    integral, speed, coming = 0.0, rate[0], [0.0] * delay
    for k in range(len(t)):
        speed = speed + share * (x[1] - speed)
        u = KP * (wanted[k] - x[0]) + KD * (rate[k] - speed) + integral + extra[k]
        growth = ki * (wanted[k] - x[0])
        if abs(u) < LIMIT or growth * u < 0:
            integral += DT * growth
        coming.append(float(np.clip(u, -LIMIT, LIMIT)))
        u = coming.pop(0)
        angles.append(x[0])
        volts.append(u)
        x = step(x, np.array([u]))
    return {
        "read": np.round(np.array(angles) / COUNT) * COUNT,
        "volts": np.array(volts) + noise * rng.normal(size=len(t)),
        "wanted": wanted,
        "wanted_rate": rate,
        "extra": extra,
    }


def held_swings(
    count: int = 4, law: Mapping[str, Any] = MappingProxyType({}), **loop: Any
) -> tn.DataSet:
    """Records, the last for validation.

    Args:
        count: how many.
        law: what the controller has beside gains of position and velocity, see `table`.
        loop: keys of the loop of their card, see `card`.
    """
    return tn.DataSet(
        "held",
        tuple(
            from_frame(
                pl.DataFrame(table(seed=k, **law)),
                card(**loop),
                name=f"run{k}",
                split="train" if k < count - 1 else "validation",
            )
            for k in range(count)
        ),
    )
