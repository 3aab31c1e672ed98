"""Input signals of simulations: what acts on a model from sample to sample."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import Model
from tustinnet.signals.stacking import stack_padded


class InputSignal(eqx.Module):
    """Inputs that act from sample to sample, and how long each period is.

    Attributes:
        u: what the model is given in every period, as its `step_layout` arranges a record's
            inputs, (steps, ...); for models that are driven by held inputs (steps, n_u).
        periods: time from each sample to the next [s], (steps,), for models that can step by any;
            None for the model's sampling period.
    """

    u: Float[Array | np.ndarray, "..."]
    periods: Float[Array | np.ndarray, "..."] | None = None

    def __getitem__(self, part: slice) -> "InputSignal":
        """A part of it in time, of a single one."""
        return InputSignal(self.u[part], None if self.periods is None else self.periods[part])


def input_signal(model: Model, experiment: Experiment, *, timestamps: bool = False) -> InputSignal:
    """The input signal of a record's free run, as the steps of a model take it.

    Args:
        model: the model to be simulated. Its holds and delays are used where the record does not
            say them.
        experiment: the record.
        timestamps: whether to step from timestamp to timestamp instead of by the sampling period.

    Returns:
        The inputs of every step, and its period.

    Raises:
        InputError: an input whose hold or delay is unknown; a record too short for its hold.
    """
    u = model.step_inputs(experiment.excitation(model.channels.inputs))
    return InputSignal(u, np.diff(experiment.t) if timestamps else None)


def input_signals(
    model: Model, experiments: Sequence[Experiment], samples: slice = slice(None)
) -> InputSignal:
    """Input signals of several records side by side, zeros after the end of shorter ones.

    Args:
        model: the model to be simulated.
        experiments: the records.
        samples: from which sample to which; what neighbours a period stays as in the record.
    """
    parts = []
    for e in experiments:
        first, last, _ = samples.indices(len(e))
        parts.append(np.asarray(input_signal(model, e).u)[first : max(last - 1, first)])
    return InputSignal(stack_padded(parts))


def initial_inputs(
    model: Model, signal: InputSignal
) -> Float[Array | np.ndarray, "runs n_u"] | None:
    """Inputs at the beginning of runs side by side, for a model that needs them, else None.

    See `Stateful.initial_needs_inputs`. Such a model has equations of motion, and so its steps take
    the coefficients of the polynomials over the period first, the first of which is the value.

    Args:
        model: the model.
        signal: what acts between the samples, (runs, steps, ...).
    """
    if not model.initial_needs_inputs:
        return None
    first = signal.u[:, 0]
    return first if first.ndim == 2 else first[:, 0]
