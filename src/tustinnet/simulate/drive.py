"""What drives a simulation."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.signals.stacking import stacked


class Drive(eqx.Module):
    """The inputs from sample to sample, and how long each period is.

    Attributes:
        ends: inputs at both ends of every period, (steps, 2, n_u); alike where they are held.
        periods: time from each sample to the next [s], (steps,), for models that can step by any;
            None for the model's sampling period.
    """

    ends: Float[Array | np.ndarray, "*batch steps 2 n_u"]
    periods: Float[Array | np.ndarray, "*batch steps"] | None = None

    def __getitem__(self, part: slice) -> "Drive":
        """A part of it in time, of a single one."""
        return Drive(self.ends[part], None if self.periods is None else self.periods[part])


def drive_of(experiment: Experiment, *, timestamps: bool = False) -> Drive:
    """What drives the free run of a record.

    Args:
        experiment: the record.
        timestamps: whether to step from timestamp to timestamp instead of by the sampling period.
    """
    return Drive(experiment.input_ends, np.diff(experiment.t) if timestamps else None)


def drives_of(experiments: Sequence[Experiment], *, timestamps: bool = False) -> Drive:
    """The same of several records side by side, zeros after the end of shorter ones."""
    each = [drive_of(e, timestamps=timestamps) for e in experiments]
    periods = [d.periods for d in each if d.periods is not None]
    return Drive(
        stacked([np.asarray(d.ends) for d in each]),
        stacked([np.asarray(p) for p in periods]) if periods else None,
    )


def as_drive(u: "Drive | Float[Array | np.ndarray, '...']") -> Drive:
    """Inputs that are held, (..., steps, n_u), as a drive; ends and drives stay as they are."""
    if isinstance(u, Drive):
        return u
    array = jnp.asarray(u)
    return Drive(jnp.stack([array, array], axis=-2))
