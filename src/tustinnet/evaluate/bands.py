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

KEY = "bands"  # in headers of model files
_FLOOR = 0.2  # of the errors' root mean square
_GRID = np.arange(1, 1000) / 1000  # levels that factors are kept for
_FEWEST = 2  # samples of every record for a part of its own
_LEAST = 1e-12  # floor of records without any error [rad or m]
_ROUNDING = 1e-9
Of = Literal["time", "record"]


@dataclass(frozen=True)
class Guess:
    """What a model says of a record, and how its alternatives differ.

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
        unit: a spread of which the root is as wide as itself [rad or m]; None in files from before
            roots were taken.
    """

    floor: float
    factors: tuple[float, ...]
    records: tuple[float, ...]
    unit: float | None = None

    def width(self, spread: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The root of the spread, or the floor [rad or m]; smooth between."""
        return np.sqrt((spread if self.unit is None else self.unit) * spread + self.floor**2)

    def factor(self, level: float, of: Of) -> float:
        """What a band of a level is times the width.

        Raises:
            InputError: too few records for this level.
        """
        require_level(level, len(self.records))
        if of == "record":
            return self.records[math.ceil(level * (len(self.records) + 1) - _ROUNDING) - 1]
        return self.of_time(level)

    def knows(self, level: float) -> bool:
        """Whether its records say what holds a share of the time."""
        return _place(level) < len(self.factors)

    def of_time(self, level: float) -> float:
        """Times of the width that hold a share of the time, or as much as is known."""
        return self.factors[min(_place(level), len(self.factors) - 1)]


@dataclass(frozen=True)
class BandAsked:
    """Which band.

    Attributes:
        level: the share that is to lie inside.
        of: of what: `time` or `record`.
    """

    level: float
    of: Of = "time"


@dataclass(frozen=True)
class Band:
    """A band around a free run.

    Attributes:
        level: the share that is to lie inside.
        of: of what it is a share: the time, or whole records.
        low: lower end, (n, n_q) [rad or m].
        high: upper end, (n, n_q).
        guess: the free run.
        calibration: what the band was made of.
    """

    level: float
    of: Of
    low: Float[np.ndarray, "n n_q"]
    high: Float[np.ndarray, "n n_q"]
    guess: Guess
    calibration: "Calibration"

    def holds(self, q: Float[np.ndarray, "n n_q"]) -> Bool[np.ndarray, "n n_q"]:
        """Where positions lie inside, (n, n_q)."""
        return (self.low <= q) & (q <= self.high)


@dataclass(frozen=True)
class Calibration:
    """What bands are made of; kept in the model's file.

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
    def most(self) -> float:
        """The highest level that so many calibration records can promise."""
        return most_of(len(self.records))

    def half(self, guess: Guess, level: float, of: Of = "time") -> Float[np.ndarray, "n n_q"]:
        """Half the width of the band of a free run, (n, n_q) [rad or m].

        Args:
            guess: the free run.
            level: the share that is to lie inside, 0..1: of the time, or of whole records.
            of: `time`: at every time the truth lies inside with this probability, averaged over
                a record; `record`: all of a record lies inside with this probability.

        Raises:
            InputError: a level for which there are too few calibration records.
        """
        half = np.empty_like(guess.simulated)
        for j, (moving, resting) in enumerate(zip(self.moving, self.resting, strict=True)):
            still = resting if of == "record" or resting.knows(level) else moving
            for part, where in ((moving, guess.moving), (still, ~guess.moving)):
                half[where, j] = part.factor(level, of) * part.width(guess.spread[where, j])
        return half

    def require(self, level: float, start: str, horizon: float | None) -> None:
        """Raises unless bands of a level are known for free runs of this start and horizon."""
        require_level(level, len(self.records))
        if (self.start, self.horizon) != (start, horizon):
            raise InputError(
                "--band", f"start '{start}'{_over(horizon)}",
                f"'{self.start}'{_over(self.horizon)}, as the model was calibrated",
                "name these, or calibrate anew",
            )  # fmt: skip

    def as_header(self) -> dict[str, Any]:
        """The same as plain values, as model files have it."""
        return asdict(self)

    @classmethod
    def from_header(cls, header: Mapping[str, Any], where: object) -> "Calibration":
        """What the header of a model's file says.

        Raises:
            InputError: the model was not calibrated.
        """
        told = header.get(KEY)
        if told is None:
            raise InputError(
                where, "a model without bands", "one that was calibrated", "tustinnet calibrate"
            )
        parts = {
            key: tuple(
                Part(p["floor"], tuple(p["factors"]), tuple(p["records"]), p.get("unit"))
                for p in told[key]
            )
            for key in ("moving", "resting")
        }
        return cls(told["start"], told["horizon"], tuple(told["records"]), **parts)


def _place(level: float) -> int:
    """Which of a part's factors is that of a level."""
    return math.ceil(level * (len(_GRID) + 1) - _ROUNDING) - 1


def _over(horizon: float | None) -> str:
    return ", whole records" if horizon is None else f", horizon {horizon:g} s"


def most_of(records: int) -> float:
    """The highest level that so many calibration records can promise: n of them n / (n + 1)."""
    return records / (records + 1)


def require_share(level: float) -> None:
    """Raises unless a level is a share."""
    if not 0 < level < 1:
        raise InputError("--band", f"{level:g}", "a share between 0 and 1")


def require_level(level: float, records: int) -> None:
    """Raises unless so many calibration records can promise a level."""
    require_share(level)
    if level > most_of(records) + _ROUNDING:
        needed = math.ceil(level / (1 - level) - _ROUNDING)
        raise InputError(
            f"a band of {100 * level:g} %", f"{records} calibration records, which cannot promise "
            f"more than {100 * most_of(records):.1f} %", f"{needed} records or more",
            "calibrate with more records, or ask for less",
        )  # fmt: skip


def band_of(of: Calibration, guess: Guess, level: float, share: Of = "time") -> Band:
    """The band around a free run, see `Calibration.half`."""
    half = of.half(guess, level, share)
    low, high = guess.simulated - half, guess.simulated + half
    return Band(level, share, low, high, guess, of)


def alternatives_of(model: Model, header: Mapping[str, Any], where: object) -> Sequence[Model]:
    """Models that the records of a model would allow as well.

    Args:
        model: the model.
        header: what its file says.
        where: what errors name.

    Raises:
        InputError: a model that does not know its own errors.
    """
    found = family_of(model).alternatives(model, dict(header))
    if not found:
        raise InputError(
            where, "a model without members or errors of its parameters: nothing says how sure it "
            "is", "a committee, or an identified system",
            "put several seeds or folds together (tustinnet committee)",
        )  # fmt: skip
    return found


def bands_around(
    calibration: Calibration,
    asked: BandAsked,
    model: Model,
    alternatives: Sequence[Model],
    experiments: Sequence[Experiment],
    scores: Sequence[Score],
) -> list[Band]:
    """The bands around free runs that are known.

    Args:
        calibration: what bands are made of.
        asked: which ones.
        model: the model.
        alternatives: see `alternatives_of`.
        experiments: the records.
        scores: their free runs.

    Raises:
        InputError: a level for which there are too few calibration records, another start or
            horizon than those calibrated.
    """
    start, horizon = scores[0].start, scores[0].horizon
    calibration.require(asked.level, start, horizon)
    own = [score.simulated for score in scores]
    made = guesses(model, alternatives, experiments, start, horizon=horizon, own=own)
    return [band_of(calibration, guess, asked.level, asked.of) for guess in made]


def guesses(
    model: Model,
    alternatives: Sequence[Model],
    experiments: Sequence[Experiment],
    start: str,
    *,
    horizon: float | None = None,
    own: Sequence[Float[np.ndarray, "_ n_x"]] | None = None,
) -> list[Guess]:
    """Free runs with the spread of a model's alternatives.

    Args:
        model: the model.
        alternatives: models that its records would allow as well, see `Family.alternatives`.
        experiments: the records.
        start: where the free runs start.
        horizon: how long they last at most [s], None for whole records.
        own: the model's free runs, where they are known.

    Raises:
        InputError: see `free_run`.
    """

    def runs(of: Model) -> Sequence[np.ndarray]:
        return free_run(of, experiments, start, horizon=horizon)

    every, first = [own or runs(model), *map(runs, alternatives)], start_named(start).first
    found = []
    for e, x, *others in zip(experiments, *every, strict=True):
        q = x[:, e.channels.position]
        with np.errstate(over="ignore", invalid="ignore"):
            away = np.stack([other[:, e.channels.position] - q for other in others])
            spread = np.sqrt(np.mean(away**2, axis=0))
        found.append(Guess(e.name, q, spread, _moving(q, x[:, e.channels.velocity], e), first))
    return found


def _moving(
    q: Float[np.ndarray, "n n_q"], v: Float[np.ndarray, "n n_q"], e: Experiment
) -> Bool[np.ndarray, " n"]:
    """Where a free run moves: before it has come to rest."""
    if not (np.isfinite(q).all() and np.isfinite(v).all()):
        return np.ones(len(q), bool)
    settled = settling_index(q, v, rest_thresholds(q, v, e.channels.resolution, e.dt))
    return np.arange(len(q)) < settled


def calibrated(
    made: Sequence[Guess],
    experiments: Sequence[Experiment],
    start: str,
    horizon: float | None = None,
) -> Calibration:
    """Bands that hold what happened on records that the model was not made from.

    Args:
        made: what the model says of them.
        experiments: the records.
        start: where the free runs started.
        horizon: how long they lasted at most [s].

    Raises:
        InputError: fewer than two records, or a free run that is not finite.
    """
    if len(made) < 2:
        raise InputError("calibrate", f"{len(made)} records", "at least 2")
    for guess in made:
        if not (np.isfinite(guess.simulated).all() and np.isfinite(guess.spread).all()):
            raise InputError(
                guess.record, "a free run that leaves the range of floating-point numbers",
                "finite ones", "calibrate over a horizon",
            )  # fmt: skip
    each = [
        _of_coordinate(made, [e.q[:, j] for e in experiments], j)
        for j in range(experiments[0].channels.n_q)
    ]
    moving, resting = zip(*each, strict=True)
    return Calibration(start, horizon, tuple(g.record for g in made), moving, resting)


def _of_coordinate(
    made: Sequence[Guess], measured: Sequence[np.ndarray], j: int
) -> tuple[Part, Part]:
    """The band of a coordinate while something moves, and after that."""
    errors = [np.abs(g.simulated[:, j] - q) for g, q in zip(made, measured, strict=True)]
    spreads = [g.spread[:, j] for g in made]
    after = [np.arange(len(g.moving)) >= g.first for g in made]
    parts = []
    for rest in (False, True):
        where = [w & (g.moving != rest) for g, w in zip(made, after, strict=True)]
        there = [i for i, w in enumerate(where) if w.sum() >= _FEWEST]
        if len(there) < (2 if rest else len(made)):
            where, there = after, range(len(made))  # too little: no part of its own
        parts.append(_part(*([of[i][where[i]] for i in there] for of in (errors, spreads))))
    # a record is either inside as a whole or not: one factor for both parts
    whole = []
    for g, w, error, spread in zip(made, after, errors, spreads, strict=True):
        width = np.where(g.moving, parts[0].width(spread), parts[1].width(spread))
        whole.append(float(np.max((error / width)[w])))
    moving, resting = (replace(part, records=tuple(sorted(whole))) for part in parts)
    return moving, resting


def _part(errors: Sequence[np.ndarray], spreads: Sequence[np.ndarray]) -> Part:
    """The widths, and times of these that hold 0.1, 0.2, ... % of the time."""
    scale = math.sqrt(np.mean([np.mean(e**2) for e in errors])) or _LEAST
    bare, n = Part(_FLOOR * scale, (), (), scale), len(errors)
    ratios = [e / bare.width(s) for e, s in zip(errors, spreads, strict=True)]
    every = np.concatenate(ratios)
    # each record counts the same, however long; one more is taken to lie outside
    weights = np.concatenate([np.full(len(r), 1 / len(r)) for r in ratios])
    order = np.argsort(every)
    reached = np.cumsum(weights[order]) / (n + 1)
    levels = _GRID[: math.floor(n / (n + 1) * (len(_GRID) + 1) + _ROUNDING)]
    places = np.minimum(np.searchsorted(reached, levels - _ROUNDING), len(every) - 1)
    return replace(bare, factors=tuple(every[order][places].tolist()))
