"""Results of candidates, and how they compare."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tustinnet.evaluate.metrics import mean_and_error, mean_by_key
from tustinnet.selection.jobs import FitScore, JobResult

LEVEL = 0.02  # of an error, a difference that nobody minds
FEW = 3  # records that say something of a difference
_DOUBT_OF_TWO = 6.3  # standard errors of two records, as one of many: Student's t, 90 %
_PLAIN = 1 / 3  # of an error, on each of one or two records a difference that is no chance
CLEAR = 2.0  # standard errors of a clear difference


@dataclass(frozen=True)
class PairedDifference:
    """The excess error of a candidate over another one, record by record.

    Attributes:
        mean: mean of the differences of RMSE [rad or m].
        standard_error: of that mean; NaN of a single record.
        records: on how many records both were scored.
    """

    mean: float
    standard_error: float
    records: int


@dataclass(frozen=True)
class CandidateResult:
    """The fits of a candidate and their scores.

    Attributes:
        name: its name.
        fits_by_fold: the fits of every fold that was done, one for each seed.
        seconds: time of its jobs.
        lost: from this error on a free run is lost, and counts as much where candidates are
            compared [rad or m].
        why: the reason why a job of it failed, or why it has no fits; empty where neither is so.
    """

    name: str
    fits_by_fold: Mapping[int, tuple[FitScore, ...]] = field(default_factory=dict)
    seconds: float = 0.0
    lost: float = math.inf
    why: str = ""

    def with_job(self, result: JobResult) -> "CandidateResult":
        """The result with one more job."""
        seconds = self.seconds + result.seconds
        if result.scores:
            fits_by_fold = {**self.fits_by_fold, result.fold: result.scores}
            return replace(self, fits_by_fold=fits_by_fold, seconds=seconds)
        why = result.why if result.ended == "failed" or not self.fits_by_fold else self.why
        return replace(self, seconds=seconds, why=why)

    @property
    def fits(self) -> tuple[FitScore, ...]:
        """The fits of all folds."""
        return tuple(fit for fold in sorted(self.fits_by_fold) for fit in self.fits_by_fold[fold])

    @property
    def start(self) -> str:
        """The start of its free runs that judges."""
        return next(iter(self.fits[0].rmse))

    def rmse(self, folds: Iterable[int] | None = None) -> dict[str, float]:
        """Mean over the seeds of every record's RMSE [rad or m].

        Args:
            folds: of which folds; all that were done by default.
        """
        return mean_by_key(
            pair
            for fold in (self.fits_by_fold if folds is None else folds)
            for fit in self.fits_by_fold[fold]
            for pair in fit.rmse[self.start].items()
        )

    @property
    def mean(self) -> float:
        """Mean over the records of their RMSE [rad or m]."""
        return _mean(self.rmse())

    def compared(self, folds: Iterable[int] | None = None) -> dict[str, float]:
        """The RMSE by record that candidates are compared by: of a lost free run that of `lost`.

        How far a run is off that has left its record says nothing. One that is not finite counts.
        """
        rmse = self.rmse(folds)
        return {r: min(x, self.lost) if np.isfinite(x) else np.inf for r, x in rmse.items()}

    @property
    def follows_some(self) -> bool:
        """Whether it follows a record: free runs of it that are not lost."""
        return min(self.compared().values(), default=math.inf) < self.lost

    @property
    def unexplained(self) -> dict[str, float]:
        """Share of the force at each coordinate that equations of motion do not explain.

        Mean over the fits that have one, on the records that each was not fitted to.
        """
        return mean_by_key(pair for fit in self.fits for pair in fit.unexplained.items())


def _mean(rmse: Mapping[str, float]) -> float:
    """Mean over the records."""
    return mean_and_error(rmse.values())[0]


def paired_difference(one: CandidateResult, other: CandidateResult) -> PairedDifference:
    """The excess error of one candidate over another on their shared records."""
    ours, theirs = one.compared(), other.compared()
    shared = [record for record in ours if record in theirs]
    with np.errstate(invalid="ignore"):
        mean, error = mean_and_error(
            np.subtract([ours[r] for r in shared], [theirs[r] for r in shared])
        )
    return PairedDifference(mean, error, len(shared))


def is_ahead(one: CandidateResult, other: CandidateResult) -> bool:
    """Whether a candidate is better than another on their shared records, by a fiftieth or more."""
    level = LEVEL * _mean(other.compared())
    return bool(paired_difference(one, other).mean < -level)


def may_overtake(one: CandidateResult, best: CandidateResult) -> bool:
    """Whether the best is lost on records that a candidate, lost on none, was not scored on."""
    ours, theirs = one.compared(), best.compared()
    is_lost_alone = any(error >= best.lost for r, error in theirs.items() if r not in ours)
    return is_lost_alone and max(ours.values(), default=math.inf) < one.lost


def rank(results: Iterable[CandidateResult]) -> list[CandidateResult]:
    """The candidates that were scored, the best first.

    Those that were scored on the most folds, by the folds that all of them have. The best of these
    is what the others are compared with, each on the records that both have: one that was soon
    left does not take records away from the others. It comes before the best only where it is
    better by more than a standard error of the difference; on one or two records by several, or
    less than a third as far off on each; and where none that was scored on more is better than it
    on their shared records. Those before it are ranked among themselves by this rule.
    """
    scored = [r for r in results if r.fits_by_fold]
    most = max((len(r.fits_by_fold) for r in scored), default=0)
    longest = [r for r in scored if len(r.fits_by_fold) == most]
    shared = set.intersection(*(set(r.fits_by_fold) for r in longest)) if longest else None
    means = {r.name: _mean(r.compared(shared or None)) for r in longest}
    finite = [r for r in longest if np.isfinite(means[r.name])]
    best = min(finite, key=lambda r: (means[r.name], r.mean), default=None)

    def error(result: CandidateResult) -> float:
        if result.name in means:
            value = means[result.name]
        elif best is None:
            value = _mean(result.compared())
        else:
            difference = paired_difference(result, best)
            doubt = difference.standard_error
            if difference.records < FEW:
                ours, theirs = result.compared(), best.compared()
                both = ours.keys() & theirs.keys()
                is_plain = bool(both) and all(ours[r] < _PLAIN * theirs[r] for r in both)
                # the standard error of a single record is NaN, which comes last
                doubt = 0.0 if is_plain else _DOUBT_OF_TWO * doubt
            value = means[best.name] + difference.mean + doubt
            more = (r for r in scored if len(r.fits_by_fold) > len(result.fits_by_fold))
            if any(is_ahead(r, result) for r in more):
                value = max(value, np.nextafter(means[best.name], np.inf))
        return value if np.isfinite(value) else np.inf

    # of those that are all lost the one that is least far off
    ordered = sorted(scored, key=lambda r: (error(r), r.mean))
    before = ordered[: ordered.index(best)] if best else []
    return [*rank(before), *ordered[len(before) :]] if len(before) > 1 else ordered


def find_simplest(results: Sequence[CandidateResult], best: CandidateResult) -> CandidateResult:
    """The first of some candidates that is as good as the best.

    That is: worse by no more than a standard error of the difference, or by a fiftieth. What is
    lost on every record is as good as nothing.

    Args:
        results: from the simplest to the most complex.
        best: the best of them.
    """
    level = LEVEL * _mean(best.compared())
    for result in results:
        difference = paired_difference(result, best)
        as_good = difference.mean <= max(difference.standard_error, level) and result.follows_some
        if result is best or (difference.records > 1 and as_good):
            return result
    return best
