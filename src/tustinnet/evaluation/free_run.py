"""Free runs of a model over records, and their scores."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.evaluation import metrics
from tustinnet.models.base import DiscreteModel, require_fit, with_dtype
from tustinnet.signals.stacking import stacked
from tustinnet.simulation.initial_state import samples_fitted
from tustinnet.simulation.model_start import start_states
from tustinnet.simulation.rollout import rollouts

_STATES_AT_ONCE = 2_000_000  # bounds the memory of k-step-ahead predictions


@dataclass(frozen=True)
class Score:
    """How one record was simulated.

    Attributes:
        experiment: the record.
        start: where the free run started.
        rmse: root mean square of the position error's 2-norm [rad or m].
        rmse_after: the same without the N samples that a start `model-N` was fitted to.
        coordinate_rmse: per coordinate [rad or m].
        nrmse: per coordinate, over the standard deviation of the measurement.
        fit_percent: per coordinate, 100 (1 - NRMSE).
        simulated: the free run's states, (n, n_x).
    """

    experiment: str
    start: str
    rmse: float
    rmse_after: float
    coordinate_rmse: tuple[float, ...]
    nrmse: tuple[float, ...]
    fit_percent: tuple[float, ...]
    simulated: Float[np.ndarray, "n n_x"]


def require_float64(what: str) -> None:
    """Raises unless JAX computes in double precision."""
    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            what,
            "JAX computes in single precision",
            "float64",
            "call jax.config.update('jax_enable_x64', True) before anything else",
        )


def free_run(
    model: DiscreteModel, experiments: Sequence[Experiment] | Experiment, start: str
) -> list[Float[np.ndarray, "n n_x"]]:
    """Simulates records in double precision, each from its start with only its input.

    Args:
        model: the model.
        experiments: records of any lengths, or one.
        start: a name that `start_states` knows.

    Returns:
        Per record the states [q, v, z], (n, n_x).

    Raises:
        InputError: other coordinates, inputs or period than the model's; float64 is off.
    """
    require_float64("free_run")
    experiments = _listed(experiments)
    for experiment in experiments:
        require_fit(model, experiment)
    simulator = with_dtype(model, np.float64).folded()
    x0 = jnp.asarray(start_states(simulator, experiments, start))
    u = jnp.asarray(stack_drives(simulator, experiments))
    runs = np.asarray(_rollouts(simulator, x0, u))
    return [run[: len(e)] for run, e in zip(runs, experiments, strict=True)]


def _listed(experiments: Sequence[Experiment] | Experiment) -> Sequence[Experiment]:
    return [experiments] if isinstance(experiments, Experiment) else experiments


def stack_drives(
    model: DiscreteModel, experiments: Sequence[Experiment]
) -> Float[np.ndarray, "records steps *drive"]:
    """What drives the free runs of records, zeros after the end of shorter ones."""
    return stacked([model.drive(e) for e in experiments])


@eqx.filter_jit
def _rollouts(
    model: DiscreteModel, x0: Float[Array, "records n_x"], u: Float[Array, "records steps *drive"]
) -> Float[Array, "records samples n_x"]:
    return rollouts(model, x0, u)


def evaluate(
    model: DiscreteModel, experiments: Sequence[Experiment] | Experiment, start: str
) -> list[Score]:
    """Scores the free runs of records.

    Args:
        model: the model.
        experiments: records of any lengths, or one.
        start: where the free runs start, a name that `start_states` knows.

    Returns:
        Per record RMSE, per-coordinate figures and the simulation. A free run that leaves the
        range of floating-point numbers scores infinity.

    Raises:
        InputError: other coordinates, inputs or period than the model's; float64 is off.
    """
    experiments = _listed(experiments)
    fitted, scores = samples_fitted(start), []
    for e, x in zip(experiments, free_run(model, experiments, start), strict=True):
        q = x[:, : e.q.shape[1]]
        with np.errstate(over="ignore", invalid="ignore"):
            q = np.where(np.isfinite(q), q, np.inf)
            scores.append(
                Score(
                    experiment=e.name,
                    start=start,
                    rmse=metrics.rmse(q, e.q),
                    rmse_after=metrics.rmse(q[fitted:], e.q[fitted:]),
                    coordinate_rmse=tuple(metrics.coordinate_rmse(q, e.q).tolist()),
                    nrmse=tuple(metrics.nrmse(q, e.q).tolist()),
                    fit_percent=tuple(metrics.fit_percent(q, e.q).tolist()),
                    simulated=x,
                )
            )
    return scores


def mean_rmse(scores: Sequence[Score]) -> float:
    """Mean RMSE over records, the figure that models are compared by.

    Args:
        scores: what `evaluate` returned.

    Returns:
        The mean of the records' RMSE [rad or m].
    """
    return float(np.mean([score.rmse for score in scores]))


def rmse_ahead(
    model: DiscreteModel,
    experiments: Sequence[Experiment],
    horizon: int,
    velocity: VelocitySource = "auto",
) -> Float[np.ndarray, " horizon"]:
    """k-step-ahead RMSE against k, for every k from every sample that has k samples after it.

    Args:
        model: the model.
        experiments: the records.
        horizon: largest k, less than the longest record's length.
        velocity: where the velocities at the starting samples come from.

    Returns:
        RMSE of the positions' 2-norm for k = 1..horizon [rad or m].
    """
    require_float64("rmse_ahead")
    longest = max(len(e) for e in experiments)
    if not 1 <= horizon < longest:
        raise InputError("horizon", f"{horizon} steps", f"1 to {longest - 1}")
    squares, count = np.zeros(horizon), np.zeros(horizon)
    evaluated = with_dtype(model, np.float64).folded()
    for e in experiments:
        require_fit(model, e)
        reach = min(horizon, len(e) - 1)
        drive = model.drive(e)
        known = np.concatenate([e.q, e.velocities(velocity)], axis=1)
        states = np.pad(known, ((0, 0), (0, model.state_size - known.shape[1])))
        for begin in np.array_split(np.arange(len(e) - 1), 1 + len(e) * reach // _STATES_AT_ONCE):
            index = begin[:, None] + np.arange(reach)
            inside = index < len(e) - 1
            index = np.minimum(index, len(e) - 2)  # beyond the end any input will do
            u = jnp.asarray(drive[index])
            runs = np.asarray(_rollouts(evaluated, jnp.asarray(states[begin]), u))
            error = np.sum((runs[:, 1:, : e.q.shape[1]] - e.q[index + 1]) ** 2, axis=2)
            squares[:reach] += np.sum(np.where(inside, error, 0.0), axis=0)
            count[:reach] += np.sum(inside, axis=0)
    return np.sqrt(squares / count)
