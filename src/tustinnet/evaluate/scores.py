"""Free runs of a model over records, and their scores."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate import metrics
from tustinnet.models.contract import Model, require_fit, require_float64, with_dtype
from tustinnet.shown import Plotted
from tustinnet.simulate.along import states_along
from tustinnet.simulate.batches import map_in_batches
from tustinnet.simulate.horizon import horizon_samples, pieces
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.simulation import simulate_runs
from tustinnet.simulate.starts import Start, default_start, start_named, start_states


@dataclass(frozen=True, repr=False)
class Score(Plotted):
    """The simulation of one record and its errors.

    Attributes:
        experiment: the record.
        start: where the free run started.
        rmse: root mean square of the position error's 2-norm, from where the free run begins
            [rad or m].
        rmse_after: that RMSE without the samples that the start was fitted to.
        coordinate_rmse: per coordinate [rad or m].
        nrmse: per coordinate, over the standard deviation of the measurement.
        fit_percent: per coordinate, 100 (1 - NRMSE).
        simulated: the free run's states, (n, n_x); before it begins, those along the record.
        horizon: how long a free run lasted at most [s]; None for the whole record at once.
        coordinate_rmse_after: per coordinate, without the samples that the start was fitted to.
        reference: what a trivial predictor has instead of `rmse`, standing still or constant speed,
            whichever is the better one over all records that are scored together, see
            `find_reference`; a model that is no better is worthless. None where it was not
            asked for, or records are too short for it.
        record: the record itself, None where only its name is known.
    """

    experiment: str
    start: str
    rmse: float
    rmse_after: float
    coordinate_rmse: tuple[float, ...]
    nrmse: tuple[float, ...]
    fit_percent: tuple[float, ...]
    simulated: Float[np.ndarray, "n n_x"]
    horizon: float | None = None
    coordinate_rmse_after: tuple[float, ...] = ()
    reference: float | None = None
    record: Experiment | None = None

    def rmse_by_unit(self, channels: Channels) -> dict[str, float]:
        """RMSE of the 2-norm over the coordinates of each unit, by unit."""
        return _norm_by_unit(self.coordinate_rmse, self.rmse, channels)

    def rmse_after_by_unit(self, channels: Channels) -> dict[str, float]:
        """RMSE by unit without the samples that the start was fitted to."""
        return _norm_by_unit(self.coordinate_rmse_after, self.rmse_after, channels)

    @property
    def mean_nrmse(self) -> float:
        """Mean NRMSE of the coordinates that move: one number where their units differ."""
        finite = [x for x in self.nrmse if not np.isnan(x)]
        return float(np.mean(finite)) if finite else np.nan


def free_run(
    model: Model,
    experiments: Iterable[Experiment] | Experiment,
    start: str | Start | None = None,
    *,
    horizon: float | None = None,
) -> list[Float[np.ndarray, "n n_x"]]:
    """Simulates records in double precision, each from its start with only its input.

    Args:
        model: the model.
        experiments: records of any lengths, a data set of them, or one.
        start: where the free runs start, as `start_states` takes it; that of a fit is its `start`.
            By default a warm-up or `model-20` where internal states ask for it, else `file` where
            a sensor measured all velocities, else `model-20`, or `derived-6` of short records.
        horizon: how long a free run lasts at most [s]; the state is estimated anew at the
            beginning of every such segment. None for whole records.

    Returns:
        Per record the states [q, v, z], (n, n_x). Of a start in the middle of a record, the rows
        before it are the measured states.

    Raises:
        InputError: other coordinates, inputs or period than the model's; a group of records that
            it does not know; a horizon that no record has or that is too short for the start;
            float64 is off.
    """
    require_float64("free_run")
    experiments = [experiments] if isinstance(experiments, Experiment) else [*experiments]
    for experiment in experiments:
        require_fit(model, experiment)
    rule = _find_start(start, experiments, model)
    simulator = with_dtype(model, np.float64).simplify()
    samples = horizon_samples(horizon, experiments, rule)

    def run_batch(folded: Model, batch: Sequence[Experiment]) -> list[np.ndarray]:
        segments = [pieces(e, samples, rule) for e in batch]
        flat = [piece for record in segments for piece in record]
        x0 = start_states(folded, flat, rule)
        drive = input_signals(folded, flat, slice(rule.first, None))
        states = iter(simulate_runs(folded, x0, drive))
        runs = [
            np.concatenate([next(states)[: len(piece) - rule.first] for piece in record])
            for record in segments
        ]
        if not rule.first:
            return runs
        heads = states_along(folded, [e[: rule.first + 1] for e in batch], "stencil")
        return [np.concatenate([head[:-1], run]) for head, run in zip(heads, runs, strict=True)]

    return map_in_batches(simulator, experiments, run_batch)


def score_runs(
    model: Model,
    experiments: Sequence[Experiment],
    start: str | Start | None,
    *,
    horizon: float | None,
) -> list[Score]:
    """Scores the free runs of records as `evaluate` does, without their reference."""
    rule, scores = _find_start(start, experiments, model), []
    samples = horizon_samples(horizon, experiments, rule)
    runs = free_run(model, experiments, rule, horizon=horizon)
    for e, x in zip(experiments, runs, strict=True):
        q, measured = x[rule.first :, e.channels.position], e.q[rule.first :]
        lengths = [len(piece) - rule.first for piece in pieces(e, samples, rule)]
        place = np.concatenate([np.arange(n) for n in lengths])  # in the segment
        after = place >= rule.seen_samples - rule.first
        with np.errstate(over="ignore", invalid="ignore"):
            q = np.where(np.isfinite(q), q, np.inf)
            scores.append(
                Score(
                    experiment=e.name,
                    start=rule.name,
                    rmse=metrics.rmse(q, measured),
                    rmse_after=metrics.rmse(q[after], measured[after]),
                    coordinate_rmse=tuple(metrics.coordinate_rmse(q, measured).tolist()),
                    nrmse=tuple(metrics.nrmse(q, measured).tolist()),
                    fit_percent=tuple(metrics.fit_percent(q, measured).tolist()),
                    simulated=x,
                    horizon=horizon,
                    coordinate_rmse_after=tuple(
                        metrics.coordinate_rmse(q[after], measured[after]).tolist()
                    ),
                    record=e,
                )
            )
    return scores


def _find_start(
    start: str | Start | None, experiments: Sequence[Experiment], model: Model
) -> Start:
    """A start as a rule: of a name, or the default one."""
    if start is None:
        start = default_start(experiments, model)
    return start_named(start) if isinstance(start, str) else start


def mean_rmse(scores: Sequence[Score]) -> float:
    """Mean RMSE over records, the figure that models are compared by.

    Args:
        scores: what `evaluate` returned.

    Returns:
        The mean of the records' RMSE [rad or m].

    Raises:
        InputError: no scores.
    """
    if not scores:
        raise InputError("mean_rmse", "no scores", "those of a record at least")
    return metrics.mean_and_error(score.rmse for score in scores)[0]


def mean_rmse_by_unit(scores: Sequence[Score], channels: Channels) -> dict[str, float]:
    """Mean over records of the RMSE over the coordinates of each unit, by unit.

    Errors of different units are not added up, as in `mean_rmse`.
    """
    by_record = [score.rmse_by_unit(channels) for score in scores]
    return {
        unit: metrics.mean_and_error(rmse[unit] for rmse in by_record)[0] for unit in channels.units
    }


def _norm_by_unit(
    coordinate_rmse: Sequence[float], rmse: float, channels: Channels
) -> dict[str, float]:
    """RMSE over the coordinates of each unit, by unit.

    Args:
        coordinate_rmse: RMSE of each coordinate, (n_q,).
        rmse: that over all coordinates, for those of one unit.
        channels: the coordinates.
    """
    if len(channels.units) == 1:
        return {channels.unit: rmse}
    with np.errstate(over="ignore"):
        return {
            unit: float(np.sqrt(sum(coordinate_rmse[j] ** 2 for j in places)))
            for unit, places in channels.places_by_unit.items()
        }


def rmse_by_record(scores: Sequence[Score]) -> dict[str, float]:
    """RMSE of each record by name."""
    return {score.experiment: score.rmse for score in scores}


def scores_header(
    split: str,
    start: str,
    channels: Channels,
    horizon: float | None,
    rmse: Mapping[str, float],
    mean_by_unit: Mapping[str, float] | None = None,
    reference: Mapping[str, str | float] | None = None,
) -> Mapping[str, Any]:
    """The scores of a model on a split of the records, as files have them.

    Args:
        split: the split.
        start: where the free runs started.
        channels: the coordinates.
        horizon: how long a free run lasted at most [s], None for whole records.
        rmse: over all coordinates, by record.
        mean_by_unit: means over the records for coordinates of each unit; None where unknown.
        reference: what a trivial predictor is beside it, see `Reference.as_header`, or None.
    """
    return {
        "split": split,
        "start": start,
        "horizon": horizon,
        "unit": channels.unit,
        "rmse": dict(rmse),
        "mean": metrics.mean_and_error(rmse.values())[0],
        **({} if mean_by_unit is None else {"mean_by_unit": dict(mean_by_unit)}),
        **({} if reference is None else {"reference": dict(reference)}),
    }
