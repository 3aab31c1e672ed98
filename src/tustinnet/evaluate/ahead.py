"""k-step-ahead errors of a model."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.models.contract import Model, require_fit, require_float64, with_dtype
from tustinnet.simulate.along import states_along
from tustinnet.simulate.input_signal import InputSignal, input_signal
from tustinnet.simulate.simulation import simulate_runs

_STEPS_AT_ONCE = 2_000_000  # bounds the RAM of k-step-ahead predictions


def rmse_ahead(
    model: Model,
    experiments: Sequence[Experiment],
    horizon: int,
    velocity: VelocitySource = "auto",
    every: int = 1,
) -> Float[np.ndarray, " horizon"]:
    """k-step-ahead RMSE against k, for every k from every sample that has k samples after it.

    A part of the samples, evenly spread, gives nearly the same in a part of the time.

    Internal states begin as the record up to the sample led to them; samples that a model's
    warm-up needs are not started from.

    Args:
        model: the model.
        experiments: the records.
        horizon: largest k, less than the longest record's length.
        velocity: where the velocities at the starting samples come from.
        every: of how many samples one is started from.

    Returns:
        RMSE of the positions' 2-norm for k = 1..horizon [rad or m].

    Raises:
        InputError: a horizon that no record has; see also `free_run`.
    """
    return joint_rmse(coordinate_rmse_ahead(model, experiments, horizon, velocity, every))


def joint_rmse(errors: Float[np.ndarray, "horizon n_q"]) -> Float[np.ndarray, " horizon"]:
    """k-step-ahead RMSE of the 2-norm over all coordinates, by that of each."""
    return np.sqrt(np.sum(errors**2, axis=1))


def rmse_ahead_by_unit(
    errors: Float[np.ndarray, "horizon n_q"], channels: Channels
) -> Float[np.ndarray, "horizon n_units"]:
    """k-step-ahead RMSE of the 2-norm over the coordinates of each of `channels.units`."""
    by_unit = channels.places_by_unit.values()
    return np.stack([joint_rmse(errors[:, places]) for places in by_unit], axis=1)


def coordinate_rmse_ahead(
    model: Model,
    experiments: Sequence[Experiment],
    horizon: int,
    velocity: VelocitySource = "auto",
    every: int = 1,
) -> Float[np.ndarray, "horizon n_q"]:
    """k-step-ahead RMSE of each coordinate for k = 1..horizon [rad or m], see `rmse_ahead`."""
    require_float64("rmse_ahead")
    evaluated = with_dtype(model, np.float64).simplify()
    longest = max(len(e) for e in experiments) - evaluated.warm_up
    if not 1 <= horizon < longest:
        raise InputError("horizon", f"{horizon} steps", f"1 to {longest - 1}")
    if every < 1:
        raise InputError("every", f"{every}", "1 or more samples")
    for e in experiments:
        require_fit(model, e)
    squares = np.zeros((horizon, model.channels.n_q))
    count = np.zeros(horizon)
    along = states_along(evaluated, experiments, velocity)
    start_indices = [np.arange(evaluated.warm_up, len(e) - 1, every) for e in experiments]
    # as many at once everywhere, so that one compiled program serves records of all lengths
    size = max(1, min(_STEPS_AT_ONCE // horizon, max(map(len, start_indices))))
    for e, states, indices in zip(experiments, along, start_indices, strict=True):
        simulator = evaluated.for_record(e)
        inputs = np.asarray(input_signal(simulator, e).u)
        for first in range(0, len(indices), size):
            begin = indices[first : first + size]
            index = np.resize(begin, size)[:, None] + np.arange(horizon)
            inside = (index < len(e) - 1) & (np.arange(size) < len(begin))[:, None]
            index = np.minimum(index, len(e) - 2)  # beyond the end any input will do
            drive = InputSignal(inputs[index])
            runs = np.asarray(simulate_runs(simulator, states[index[:, 0]], drive))
            error = (runs[:, 1:, e.channels.position] - e.q[index + 1]) ** 2
            squares += np.sum(np.where(inside[:, :, None], error, 0.0), axis=0)
            count += np.sum(inside, axis=0)
    return np.sqrt(squares / count[:, None])
