"""What has been found of candidates, and how they compare."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.selection.jobs import JobResult, SeedScore

_LEVEL = 0.02  # of an error, a difference that nobody minds
_FEW = 3  # records that say something of a difference
CLEAR = 2.0  # standard errors of a clear difference


@dataclass(frozen=True)
class Paired:
    """How much worse a candidate is than another one, record by record.

    Attributes:
        mean: mean of the differences of RMSE [rad or m].
        standard_error: of that mean; NaN of a single record.
        records: on how many records both were scored.
    """

    mean: float
    standard_error: float
    records: int


@dataclass(frozen=True)
class Standing:
    """What has been found of a candidate.

    Attributes:
        name: its name.
        folds: the models of every fold that was done, one a seed.
        seconds: time of its jobs.
        why: why it was left out, empty where it was not.
    """

    name: str
    folds: Mapping[int, tuple[SeedScore, ...]] = field(default_factory=dict)
    seconds: float = 0.0
    why: str = ""

    def after(self, result: JobResult) -> "Standing":
        """The same after one more job."""
        seconds = self.seconds + result.seconds
        if result.ended == "done":
            models = (*self.folds.get(result.fold, ()), *result.scores)
            folds = {**self.folds, result.fold: models}
            return Standing(self.name, folds, seconds, self.why)
        why = result.why if result.ended == "failed" or not self.folds else self.why
        return Standing(self.name, self.folds, seconds, why)

    @property
    def models(self) -> tuple[SeedScore, ...]:
        """All of its models."""
        return tuple(model for fold in sorted(self.folds) for model in self.folds[fold])

    @property
    def starts(self) -> tuple[str, ...]:
        """The starts that its models were scored from, first the one that judges."""
        return tuple(dict.fromkeys(start for model in self.models for start in model.rmse))

    def rmse(self, folds: Iterable[int] | None = None, start: int | str = 0) -> dict[str, float]:
        """Mean over the seeds of every record's RMSE [rad or m].

        Args:
            folds: of which folds; all that were done by default.
            start: of the free runs, by name, or by its place: 0 is the one that judges.
        """
        by_record: dict[str, list[float]] = {}
        for fold in self.folds if folds is None else folds:
            for model in self.folds[fold]:
                named = list(model.rmse)[start] if isinstance(start, int) else start
                for record, value in model.rmse.get(named, {}).items():
                    by_record.setdefault(record, []).append(value)
        return {record: float(np.mean(values)) for record, values in by_record.items()}


def paired(one: Standing, other: Standing, without: str = "") -> Paired:
    """How much worse one is than another on the records that both were scored on, but for one."""
    ours, theirs = one.rmse(), other.rmse()
    both = [record for record in ours if record in theirs and record != without]
    with np.errstate(invalid="ignore"):
        mean, error = mean_and_error(
            np.subtract([ours[r] for r in both], [theirs[r] for r in both])
        )
    return Paired(mean, error, len(both))


def hanging(best: Standing, others: Sequence[Standing]) -> tuple[str, Standing, Paired] | None:
    """The record without which another one would be clearly better than the best.

    Returns:
        The record, the other one, and how much worse that is without the record, a negative mean;
        None where no single record decides.
    """
    found = []
    for other in others:
        if not paired(other, best).mean > 0:
            continue
        theirs = other.rmse()
        for record in [r for r in best.rmse() if r in theirs]:
            than = paired(other, best, without=record)
            if than.records >= _FEW and than.mean < -CLEAR * than.standard_error:
                found.append((record, other, than))
    return min(found, key=lambda of: of[2].mean, default=None)


def shared_folds(standings: Sequence[Standing]) -> set[int] | None:
    """The folds that all of some candidates were scored on; None where there are none."""
    return set.intersection(*(set(s.folds) for s in standings)) or None if standings else None


def ranked(standings: Sequence[Standing]) -> list[Standing]:
    """The candidates that were scored, the best first.

    Those that were scored on the most folds, by the folds that all of them have. The best of these
    is what the others are compared with, each on the records that both have: one that was soon
    left does not take records away from the others. It comes before the best only where it is
    better by more than a standard error of the difference.
    """
    scored = [s for s in standings if s.folds]
    most = max((len(s.folds) for s in scored), default=0)
    longest = [s for s in scored if len(s.folds) == most]
    shared = shared_folds(longest)
    means = {s.name: mean_and_error(s.rmse(shared).values())[0] for s in longest}
    finite = [s for s in longest if np.isfinite(means[s.name])]
    best = min(finite, key=lambda s: means[s.name], default=None)

    def error(of: Standing) -> float:
        if of.name in means:
            value = means[of.name]
        elif best is None:
            value = mean_and_error(of.rmse().values())[0]
        else:
            than = paired(of, best)
            value = means[best.name] + than.mean + than.standard_error  # none of a single record
        return value if np.isfinite(value) else np.inf

    return sorted(scored, key=error)


def simplest(standings: Sequence[Standing], best: Standing) -> Standing:
    """The first of some candidates that is as good as the best.

    That is: worse by no more than a standard error of the difference, or by a fiftieth.

    Args:
        standings: from the simplest to the most complex.
        best: the best of them.
    """
    for standing in standings:
        than = paired(standing, best)
        level = _LEVEL * mean_and_error(best.rmse().values())[0]
        if standing is best or (than.records > 1 and than.mean <= max(than.standard_error, level)):
            return standing
    return best
