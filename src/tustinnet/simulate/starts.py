"""States in which free runs start, see `start_rules` for the rules that find them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import coordinate_timescales
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.batches import map_in_batches
from tustinnet.simulate.start_names import DERIVED, FITTED, STORED
from tustinnet.simulate.start_rules import (
    FIT_SAMPLES,
    MeasuredStart,
    Start,
    WarmUpStart,
    start_named,
)


def default_start(experiments: Sequence[Experiment], *models: Model) -> str:
    """The start that is used where none is named, the same for all of some models.

    A warm-up where a model needs one; `model-20` where internal states are to be searched for, as
    those of a controller; else `file` where a sensor measured the velocities of every record; else
    `derived-6`, or `model-20` where a coordinate swings with few samples in a period: a parabola
    through 6 samples is then far from the motion.
    """
    warm_up = max((model.warm_up for model in models), default=0)
    if warm_up:
        return WarmUpStart(warm_up).name
    is_long = min(map(len, experiments)) >= 2 * FIT_SAMPLES
    if is_long and any(model.searched_internal.any() for model in models):
        return FITTED.usual
    if all(e.sensor_velocities is not None for e in experiments):
        return STORED.usual
    is_fast = is_long and any(
        scales.is_fast for scales in coordinate_timescales(experiments).values()
    )
    return (FITTED if is_fast else DERIVED).usual


def default_and_fitted_starts(experiments: Sequence[Experiment], *models: Model) -> tuple[str, ...]:
    """The default start and the usual start that is fitted through the model, each once."""
    return tuple(dict.fromkeys((default_start(experiments, *models), FITTED.usual)))


def start_states(
    model: Model, experiments: Sequence[Experiment], start: str | Start
) -> Float[np.ndarray, "records n_x"]:
    """States in which the free runs of records start, (records, n_x).

    Args:
        model: the model.
        experiments: the records.
        start: a start, or the name of one.

    Raises:
        InputError: an unknown start, or records too short for it.
    """
    rule = start_named(start) if isinstance(start, str) else start

    def batch_states(model: Model, batch: Sequence[Experiment]) -> Float[np.ndarray, "records n_x"]:
        return rule.numeric_states(model, rule.start_data(model, batch))

    return np.stack(map_in_batches(model, experiments, batch_states))


def initial_state(experiment: Experiment, start: str) -> Float[np.ndarray, " n_x"]:
    """The initial state of a record's free run without a model, [q, v], (2 n_q,).

    Args:
        experiment: the record.
        start: `file`, the first row as it is stored, velocities included; or `derived-N`, the
            least-squares parabola through the first N samples (6 is usual).

    Raises:
        InputError: an unknown start, no velocities for `file`, too few samples for `derived-N`.
    """
    rule = start_named(start)
    if not isinstance(rule, MeasuredStart):
        raise InputError(
            "start",
            f"'{start}' without a model",
            "'file', 'derived-N' such as derived-6",
            "use start_states",
        )
    return rule.measured_state(experiment)
