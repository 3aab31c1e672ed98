"""What drives a simulation."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import Model
from tustinnet.signals.stacking import stacked


class Drive(eqx.Module):
    """What acts from sample to sample, and how long each period is.

    Attributes:
        u: what the model is given in every period, as its `seen` makes it of a record's inputs,
            (steps, ...); for models that are driven by held inputs (steps, n_u).
        periods: time from each sample to the next [s], (steps,), for models that can step by any;
            None for the model's sampling period.
    """

    u: Float[Array | np.ndarray, "..."]
    periods: Float[Array | np.ndarray, "..."] | None = None

    def __getitem__(self, part: slice) -> "Drive":
        """A part of it in time, of a single one."""
        return Drive(self.u[part], None if self.periods is None else self.periods[part])


def drive_of(model: Model, experiment: Experiment, *, timestamps: bool = False) -> Drive:
    """What a model is given at every step of a record's free run.

    Args:
        model: the model to be simulated. Its holds and delays are used where the record does not
            say them.
        experiment: the record.
        timestamps: whether to step from timestamp to timestamp instead of by the sampling period.

    Returns:
        The inputs as the steps of the model take them.

    Raises:
        InputError: an input whose hold or delay is unknown; a record too short for its hold.
    """
    seen = model.step_inputs(experiment.excitation(model.channels.inputs))
    return Drive(seen, np.diff(experiment.t) if timestamps else None)


def drives_of(
    model: Model, experiments: Sequence[Experiment], samples: slice = slice(None)
) -> Drive:
    """The same of several records side by side, zeros after the end of shorter ones.

    Args:
        model: who is to simulate them.
        experiments: the records.
        samples: from which sample to which; what neighbours a period stays as in the record.
    """
    each = [np.asarray(drive_of(model, e).u) for e in experiments]
    parts = [
        u[first : max(last - 1, first)]
        for u, (first, last, _) in zip(
            each, (samples.indices(len(e)) for e in experiments), strict=True
        )
    ]
    return Drive(stacked(parts))
