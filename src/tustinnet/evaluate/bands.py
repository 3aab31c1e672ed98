"""Bands around free runs: how far the truth may be, learnt from records that trained nothing.

A band is as wide as the root of how far the alternatives of a model differ, or at least as a floor
says, times a factor. The root, because alternatives differ more from record to record, and from
time to time, than errors do. The factor is what it takes to hold the errors on the calibration
records (split conformal prediction): of each coordinate apart, and apart of motion and of rest.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score, free_run
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.signals.transients import rest_thresholds, settling_index
from tustinnet.simulate.starts import start_named
from tustinnet.wording import counted

KEY = "bands"  # in headers of model files
_GRID = np.arange(1, 1000) / 1000  # levels that factors are kept for
_ROUNDING = 1e-9
BandScope = Literal["time", "record"]


@dataclass(frozen=True)
class Prediction:
    """The free run of a model over a record, and how its alternatives differ.

    Attributes:
        record: the record's name.
        simulated: positions of the free run, (n, n_q).
        spread: root mean square difference of the alternatives' free runs from it, (n, n_q).
        moving: where it moves; a band is calibrated apart where it has come to rest, (n,).
        first: sample at which the free run begins.
    """

    record: str
    simulated: Float[np.ndarray, "n n_q"]
    spread: Float[np.ndarray, "n n_q"]
    moving: Bool[np.ndarray, " n"]
    first: int


@dataclass(frozen=True)
class Part:
    """The band of one coordinate, of one part of the records.

    Attributes:
        floor: the least that stands for a spread [rad or m].
        factors: times of the width at levels 0.001, 0.002, ... that hold that share of the time;
            as far as the number of records allows.
        records: times of the width that hold all of each calibration record, in rising order.
        unit: a spread of which the root is as wide as itself [rad or m].
    """

    floor: float
    factors: tuple[float, ...]
    records: tuple[float, ...]
    unit: float

    def width(self, spread: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The root of the spread, or the floor [rad or m]; smooth between."""
        return np.sqrt(self.unit * spread + self.floor**2)

    def factor(self, level: float, scope: BandScope) -> float:
        """Times of the width that hold a share of the time, or of whole records.

        Raises:
            InputError: too few records for this level.
        """
        require_level(level, len(self.records))
        if scope == "record":
            return self.records[math.ceil(level * (len(self.records) + 1) - _ROUNDING) - 1]
        # where the level is beyond them, the largest share available
        return self.factors[min(_factor_index(level), len(self.factors) - 1)]

    def has_level(self, level: float) -> bool:
        """Whether its records are enough for a share of the time."""
        return _factor_index(level) < len(self.factors)


@dataclass(frozen=True)
class BandOptions:
    """Level and scope of a band.

    Attributes:
        level: the share that is to lie inside.
        scope: a share of the `time`, or of whole records (`record`).
    """

    level: float
    scope: BandScope = "time"


@dataclass(frozen=True)
class Band:
    """A band around a free run.

    Attributes:
        level: the share that is to lie inside.
        scope: what it is a share of: the time, or whole records.
        low: lower end, (n, n_q) [rad or m].
        high: upper end, (n, n_q).
        prediction: the free run.
        calibration: what the band was made of.
    """

    level: float
    scope: BandScope
    low: Float[np.ndarray, "n n_q"]
    high: Float[np.ndarray, "n n_q"]
    prediction: Prediction
    calibration: "Calibration"

    def contains(self, q: Float[np.ndarray, "n n_q"]) -> Bool[np.ndarray, "n n_q"]:
        """Whether positions lie inside, (n, n_q)."""
        return (self.low <= q) & (q <= self.high)


@dataclass(frozen=True)
class Calibration:
    """Widths and factors that bands are made of; kept in the model's file.

    Attributes:
        start: where the free runs started.
        horizon: how long they lasted at most [s], None for whole records.
        records: the calibration records.
        moving: of each coordinate, while something moves.
        resting: of each coordinate, after that, from the records that come to rest. Where these
            are too few for a level, what holds for motion holds for rest.
    """

    start: str
    horizon: float | None
    records: tuple[str, ...]
    moving: tuple[Part, ...]
    resting: tuple[Part, ...]

    @property
    def highest_level(self) -> float:
        """The highest level that so many calibration records can promise."""
        return highest_level(len(self.records))

    def half_width(
        self, prediction: Prediction, level: float, scope: BandScope = "time"
    ) -> Float[np.ndarray, "n n_q"]:
        """Half the width of the band of a free run, (n, n_q) [rad or m].

        Args:
            prediction: the free run.
            level: the share that is to lie inside, 0..1: of the time, or of whole records.
            scope: `time`: at every time the truth lies inside with this probability, averaged over
                a record; `record`: all of a record lies inside with this probability.

        Raises:
            InputError: a level for which there are too few calibration records.
        """
        half = np.empty_like(prediction.simulated)
        for j, (moving, resting) in enumerate(zip(self.moving, self.resting, strict=True)):
            still = resting if scope == "record" or resting.has_level(level) else moving
            for part, where in ((moving, prediction.moving), (still, ~prediction.moving)):
                width = part.width(prediction.spread[where, j])
                half[where, j] = part.factor(level, scope) * width
        return half

    def require(self, level: float, start: str, horizon: float | None) -> None:
        """Raises unless bands of a level are calibrated for free runs of this start and horizon."""
        require_level(level, len(self.records))
        if (self.start, self.horizon) != (start, horizon):
            raise InputError(
                "`band=`",
                f"start '{start}'{_over(horizon)}",
                f"'{self.start}'{_over(self.horizon)}, as the model was calibrated",
                "omit `start=` and `horizon=`, or calibrate the model for these (tn.calibrate): "
                "errors grow with the length of runs",
            )

    def as_header(self) -> dict[str, Any]:
        """The calibration as plain values, as model files have it."""
        return asdict(self)

    @classmethod
    def from_header(cls, header: Mapping[str, Any], where: object) -> "Calibration":
        """The calibration in the header of a model's file.

        Raises:
            InputError: the model was not calibrated.
        """
        content = header.get(KEY)
        if content is None:
            raise InputError(
                where, "a model without bands", "one that was calibrated", "in Python: tn.calibrate"
            )
        parts = {
            key: tuple(
                Part(p["floor"], tuple(p["factors"]), tuple(p["records"]), p["unit"])
                for p in content[key]
            )
            for key in ("moving", "resting")
        }
        return cls(content["start"], content["horizon"], tuple(content["records"]), **parts)


def _factor_index(level: float) -> int:
    return math.ceil(level * (len(_GRID) + 1) - _ROUNDING) - 1


def _over(horizon: float | None) -> str:
    return ", whole records" if horizon is None else f", horizon {horizon:g} s"


def highest_level(records: int) -> float:
    """The highest level that so many calibration records can promise: n of them n / (n + 1)."""
    return records / (records + 1)


def require_share(level: float) -> None:
    """Raises unless a level is a share."""
    if not 0 < level < 1:
        raise InputError("`band=`", f"{level:g}", "a share between 0 and 1")


def require_level(level: float, records: int) -> None:
    """Raises unless so many calibration records can promise a level."""
    require_share(level)
    if level > highest_level(records) + _ROUNDING:
        needed = math.ceil(level / (1 - level) - _ROUNDING)
        raise InputError(
            f"a band of {100 * level:g} %",
            f"{records} calibration records, which cannot promise "
            f"more than {100 * highest_level(records):.1f} %",
            f"{needed} records or more",
            "calibrate with more records, or request a lower level",
        )


def find_alternatives(model: Model, header: Mapping[str, Any], where: object) -> Sequence[Model]:
    """Models that the records of a model would allow as well.

    Args:
        model: the model.
        header: the header of its file.
        where: what errors name.

    Raises:
        InputError: a model without members or errors of its parameters.
    """
    alternatives = family_of(model).alternatives(model, dict(header))
    if not alternatives:
        raise InputError(
            where,
            "a model without members or errors of its parameters: nothing says how sure it is",
            "a committee, or an identified system",
            "combine several seeds or folds, in Python: tn.save_committee",
        )
    return alternatives


def make_band(
    calibration: Calibration, prediction: Prediction, level: float, scope: BandScope = "time"
) -> Band:
    """The band around a free run, see `Calibration.half_width`."""
    half = calibration.half_width(prediction, level, scope)
    low, high = prediction.simulated - half, prediction.simulated + half
    return Band(level, scope, low, high, prediction, calibration)


def make_bands(
    calibration: Calibration,
    options: BandOptions,
    model: Model,
    alternatives: Sequence[Model],
    experiments: Sequence[Experiment],
    scores: Sequence[Score],
) -> list[Band]:
    """The bands around free runs that were scored.

    Args:
        calibration: what bands are made of.
        options: their level and scope.
        model: the model.
        alternatives: see `find_alternatives`.
        experiments: the records.
        scores: their free runs.

    Raises:
        InputError: a level for which there are too few calibration records, another start or
            horizon than those calibrated.
    """
    start, horizon = scores[0].start, scores[0].horizon
    calibration.require(options.level, start, horizon)
    runs = [score.simulated for score in scores]
    predictions = predict(model, alternatives, experiments, start, horizon=horizon, runs=runs)
    return [make_band(calibration, p, options.level, options.scope) for p in predictions]


def predict(
    model: Model,
    alternatives: Sequence[Model],
    experiments: Sequence[Experiment],
    start: str,
    *,
    horizon: float | None = None,
    runs: Sequence[Float[np.ndarray, "_ n_x"]] | None = None,
) -> list[Prediction]:
    """Free runs of records, and how the alternatives of the model differ from them.

    Args:
        model: the model.
        alternatives: models that its records would allow as well, see `Family.alternatives`.
        experiments: the records.
        start: where the free runs start.
        horizon: how long they last at most [s], None for whole records.
        runs: the model's free runs, if they were computed before.

    Raises:
        InputError: see `free_run`.
    """

    def simulate(simulator: Model) -> Sequence[np.ndarray]:
        return free_run(simulator, experiments, start, horizon=horizon)

    all_runs, first = [runs or simulate(model), *map(simulate, alternatives)], start_named(start)
    predictions = []
    for e, x, *others in zip(experiments, *all_runs, strict=True):
        q, v = x[:, e.channels.position], x[:, e.channels.velocity]
        with np.errstate(over="ignore", invalid="ignore"):
            away = np.stack([other[:, e.channels.position] - q for other in others])
            spread = np.sqrt(np.mean(away**2, axis=0))
        moving = np.ones(len(q), bool)
        if np.isfinite(q).all() and np.isfinite(v).all():
            thresholds = rest_thresholds(q, v, e.channels.resolution, e.dt)
            moving = np.arange(len(q)) < settling_index(q, v, thresholds)
        predictions.append(Prediction(e.name, q, spread, moving, first.first))
    return predictions


def calibrate_bands(
    predictions: Sequence[Prediction],
    experiments: Sequence[Experiment],
    start: str,
    horizon: float | None = None,
) -> Calibration:
    """Bands that hold what happened on records that the model was not made from.

    Args:
        predictions: the model's free runs of the records.
        experiments: the records.
        start: where the free runs started.
        horizon: how long they lasted at most [s].

    Raises:
        InputError: fewer than two records, or a free run that is not finite.
    """
    if len(predictions) < 2:
        raise InputError("calibrate", counted(len(predictions), "record"), "at least 2")
    for prediction in predictions:
        if not (np.isfinite(prediction.simulated).all() and np.isfinite(prediction.spread).all()):
            raise InputError(
                prediction.record,
                "a free run that diverges",
                "finite ones",
                "calibrate over a horizon",
            )
    parts = [
        _calibrate_coordinate(predictions, [e.q[:, j] for e in experiments], j)
        for j in range(experiments[0].channels.n_q)
    ]
    moving, resting = zip(*parts, strict=True)
    return Calibration(start, horizon, tuple(p.record for p in predictions), moving, resting)


def _calibrate_coordinate(
    predictions: Sequence[Prediction], measured: Sequence[np.ndarray], j: int
) -> tuple[Part, Part]:
    """The bands of a coordinate while something moves, and after that."""
    errors = [np.abs(p.simulated[:, j] - q) for p, q in zip(predictions, measured, strict=True)]
    spreads = [p.spread[:, j] for p in predictions]
    after = [np.arange(len(p.moving)) >= p.first for p in predictions]
    parts = []
    for rest in (False, True):
        where = [w & (p.moving != rest) for p, w in zip(predictions, after, strict=True)]
        # a record has a part of its own where it has two samples in it
        usable = [i for i, w in enumerate(where) if w.sum() >= 2]
        if len(usable) < (2 if rest else len(predictions)):
            where, usable = after, range(len(predictions))  # too little: no part of its own
        parts.append(
            _make_part(*([rows[i][where[i]] for i in usable] for rows in (errors, spreads)))
        )
    # a record is either inside as a whole or not: one factor for both parts
    whole = []
    for p, w, error, spread in zip(predictions, after, errors, spreads, strict=True):
        width = np.where(p.moving, parts[0].width(spread), parts[1].width(spread))
        whole.append(float(np.max((error / width)[w])))
    moving, resting = (replace(part, records=tuple(sorted(whole))) for part in parts)
    return moving, resting


def _make_part(errors: Sequence[np.ndarray], spreads: Sequence[np.ndarray]) -> Part:
    """The widths, and times of these that hold 0.1, 0.2, ... % of the time."""
    # not 0 where records have no error [rad or m]
    scale = math.sqrt(np.mean([np.mean(e**2) for e in errors])) or 1e-12
    bare, n = Part(0.2 * scale, (), (), scale), len(errors)
    ratios = [e / bare.width(s) for e, s in zip(errors, spreads, strict=True)]
    pooled = np.concatenate(ratios)
    # each record counts the same, however long; one more is taken to lie outside
    weights = np.concatenate([np.full(len(r), 1 / len(r)) for r in ratios])
    order = np.argsort(pooled)
    reached = np.cumsum(weights[order]) / (n + 1)
    levels = _GRID[: math.floor(n / (n + 1) * (len(_GRID) + 1) + _ROUNDING)]
    places = np.minimum(np.searchsorted(reached, levels - _ROUNDING), len(pooled) - 1)
    return replace(bare, factors=tuple(pooled[order][places].tolist()))
