"""A pendulum without a motor, and free swings of it: records without inputs."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from swinging import DT, SWING, TRUTH

import tustinnet as tn
from tustinnet.simulate.rollout import rollout

FREE = replace(
    SWING,
    name="free swing",
    inputs=(),
    input_map=None,
    parameters=tuple(p for p in SWING.parameters if p.name != "gain"),
)


def free(values=TRUTH) -> tn.Model:
    """The swing without a motor."""
    known = {name: jnp.asarray(values[name]) for name in FREE.nominal()}
    return tn.discretise(FREE.model(known), DT, 4)


def free_swings(splits: tuple[str | None, ...]) -> tn.DataSet:
    """A record for each split, as an encoder reads it."""
    made = []
    for i, split in enumerate(splits):
        x = rollout(free(), np.array([0.8 + 0.4 * i, 0.5 - i]), np.zeros((119 + 10 * i, 0)))
        q = np.round(np.asarray(x)[:, 0] / 1e-3) * 1e-3
        made.append(
            tn.from_arrays(
                q,
                dt=DT,
                name=f"fall{i}",
                split=split,
                coordinates=[replace(FREE.coordinates[0], resolution=1e-3)],
            )
        )
    return tn.DataSet("free", tuple(made))
