"""States in which free runs start, see `start_rules` for the rules that find them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
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


def measured_start(experiments: Sequence[Experiment]) -> str:
    """The usual start without a model: `file` where a sensor measured all velocities."""
    is_stored = all(e.sensor_velocities is not None for e in experiments)
    return (STORED if is_stored else DERIVED).usual


def default_start(experiments: Sequence[Experiment], *models: Model) -> str:
    """The start that is used where none is named, the same for all of some models.

    A warm-up where a model needs one; else `file` where a sensor measured the velocities of every
    record, and no internal states are to be searched for, as those of a controller; else
    `model-20`, or `derived-6` of records with fewer than 40 samples.
    """
    warm_up = max((model.warm_up for model in models), default=0)
    if warm_up:
        return WarmUpStart(warm_up).name
    measured = measured_start(experiments)
    is_searched = any(model.searched_internal.any() for model in models)
    is_long = min(map(len, experiments)) >= 2 * FIT_SAMPLES
    return FITTED.usual if is_long and (is_searched or measured != STORED.usual) else measured


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
