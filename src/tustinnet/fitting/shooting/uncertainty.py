"""Uncertainty of identified parameters: covariances, condition, correlation of the residuals.

`estimate_uncertainty` takes the normal equations at the estimate, segment by segment, and returns
two covariances: from `J'J`, and from how the records disagree (clustered), or where these are few
their segments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
from jaxtyping import Bool, Float

from tustinnet.data.experiment import LARGEST
from tustinnet.fitting.shooting.normal import NormalProducts, eliminate_initial_states
from tustinnet.fitting.shooting.segments import Segments

FEWEST_RECORDS = 4  # for an estimate of how records differ
FEWEST_SEGMENTS = 12  # for an estimate of how segments differ, where there are not enough records
CONFIDENCE = 0.95
INFORMED = 0.5  # share of a prior's standard deviation below which records decide
NO_INFORMATION = 1e-9  # of that on a parameter, which remains where nothing else tells of it


@dataclass(frozen=True)
class Uncertainty:
    """Covariances in the coordinates of the search, of the parameters that are not at a bound.

    Attributes:
        naive: covariance from `J'J`, right only where residuals are independent and no structure
            is missing.
        clustered: covariance from how the records disagree, None where there are too few.
        by_segments: covariance from how the segments of too few records disagree, None where these
            are too few as well. Segments of a record may all lack the same, which it does not see.
        segments: number of segments.
        naive_quantile: standard errors of `naive` that make half a 95 % interval.
        condition: ratio of the best to the worst determined direction.
        worst_direction: the worst determined direction, (n_p,), its largest entry 1.
    """

    naive: Float[np.ndarray, "n_p n_p"]
    clustered: Float[np.ndarray, "n_p n_p"] | None
    by_segments: Float[np.ndarray, "n_p n_p"] | None
    segments: int
    naive_quantile: float
    condition: float
    worst_direction: Float[np.ndarray, " n_p"]

    @property
    def trusted(self) -> Float[np.ndarray, "n_p n_p"]:
        """Covariance to trust: that of the records, or segments, where there are enough of them."""
        covariances = (x for x in (self.clustered, self.by_segments) if x is not None)
        return next(covariances, self.naive)

    @property
    def source(self) -> str:
        """The source of the covariance to trust: `records`, `segments` or `residuals`."""
        if self.clustered is not None:
            return "records"
        return "residuals" if self.by_segments is None else "segments"

    def quantile_for_records(self, records: int) -> float:
        """Standard errors that make half a 95 % interval of a parameter of only so many records."""
        if self.source == "residuals":
            return self.naive_quantile
        count = records if self.source == "records" else self.segments
        return float(scipy.special.stdtrit(max(count - 1, 1), (1 + CONFIDENCE) / 2))


def estimate_uncertainty(
    products: NormalProducts,
    segments: Segments,
    prior_curvature: Float[np.ndarray, " n_p"],
    inside: Bool[np.ndarray, " n_p"],
) -> Uncertainty:
    """Estimates the covariances of parameters, the segments of a record taken together.

    The clustered covariance leaves out one record at a time, to first order:
    `(n - 1) / n sum d_i d_i'` with `d_i = (H - H_i)^-1 g_i`, `H_i` and `g_i` being a record's
    share of the reduced normal equations. It holds whatever correlation a record has in itself.
    A record without which nothing is known of some parameter, as the only one of a group, is not
    left out, and that parameter's error is at least that of `J'J`. Where there are too few records
    it leaves out segments: noise of an input is alike from sample to sample of what follows it, not
    from segment to segment.

    Args:
        products: the products at the estimate.
        segments: the records' segments.
        prior_curvature: what priors add to the diagonal of `H`, (n_p,).
        inside: parameters that are not at a bound, (n_p,).

    References:
        MacKinnon, White (1985), Some heteroskedasticity-consistent covariance matrix estimators
        with improved finite sample properties (HC3, the jackknife).
        Cameron, Gelbach, Miller (2008), Bootstrap-based improvements for inference with clustered
        errors.
    """
    n_p = len(inside)
    naive = np.full((n_p, n_p), np.nan)
    if not np.isfinite(products.cost).all():
        return Uncertainty(naive, None, None, len(segments.steps), np.nan, np.inf, np.zeros(n_p))
    first, count = segments.first_of_records, len(segments.steps)
    reduced = eliminate_initial_states(products)
    matrices = np.add.reduceat(reduced.matrices, first)[:, inside][:, :, inside]
    whole = matrices.sum(axis=0) + np.diag(prior_curvature[inside])
    inverse = _inverse(whole)
    # every residual weighs 1/T: the records' gradients have variance sigma^2 / T times their matrix
    samples = 1 / segments.share[first]
    channels = np.count_nonzero(segments.weights.any(axis=0))
    n_free = np.count_nonzero(segments.is_free) + int(inside.sum())
    freedom = max(float(samples.sum() * channels - n_free), 1.0)
    variance = float(products.cost @ (1 / segments.share)) / freedom
    by_prior = variance * len(samples) / samples.sum() * np.diag(prior_curvature[inside])
    spread = np.tensordot(variance / samples, matrices, 1) + by_prior
    naive[np.ix_(inside, inside)] = inverse @ spread @ inverse
    clustered = by_segments = None

    def leave_out(first: np.ndarray) -> Float[np.ndarray, "n_p n_p"] | None:
        """Covariance by leaving out parts that begin with these segments, one at a time.

        None where too few can be left out.
        """
        parts = np.add.reduceat(reduced.matrices, first)[:, inside][:, :, inside]
        gradients = np.add.reduceat(reduced.gradients, first)[:, inside]
        # parameters of which the other parts say nothing, by the part that is left out
        is_alone = np.diag(whole) - np.einsum("rii->ri", parts) < NO_INFORMATION * np.diag(whole)
        left_out = np.flatnonzero(~is_alone.any(axis=1))
        n = len(left_out)
        if n < FEWEST_RECORDS:
            return None
        steps = np.stack([_inverse(whole - parts[k]) @ gradients[k] for k in left_out])
        steps -= steps.mean(axis=0)
        jackknife = (n - 1) / n * steps.T @ steps + inverse @ by_prior @ inverse
        # no other record contradicts the only one of a group, so its residuals have to say it
        lifts, alone = np.ones(len(jackknife)), is_alone.any(axis=0)
        by_residuals = np.diag(naive)[inside][alone]
        ratios = by_residuals / np.maximum(np.diag(jackknife)[alone], 1e-300)
        lifts[alone] = np.sqrt(np.maximum(ratios, 1.0))
        covariance = np.full((n_p, n_p), np.nan)
        covariance[np.ix_(inside, inside)] = jackknife * np.outer(lifts, lifts)
        return covariance

    if len(first) >= FEWEST_RECORDS:
        clustered = leave_out(first)
    elif count >= FEWEST_SEGMENTS:
        by_segments = leave_out(np.arange(count))
    unit = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    values, vectors = np.linalg.eigh(whole / np.outer(unit, unit))
    worst_direction, condition = np.zeros(n_p), 1.0
    if len(unit):
        worst = vectors[:, 0] / unit
        worst_direction[inside] = worst / np.abs(worst).max(initial=1e-300)
        condition = float(np.sqrt(values[-1] / max(values[0], 1e-300)))
    return Uncertainty(
        naive=naive,
        clustered=clustered,
        by_segments=by_segments,
        segments=count,
        naive_quantile=float(scipy.special.stdtrit(freedom, (1 + CONFIDENCE) / 2)),
        condition=condition,
        worst_direction=worst_direction,
    )


def shift_of_estimate(
    products: NormalProducts,
    other: NormalProducts,
    prior_curvature: Float[np.ndarray, " n_p"],
    inside: Bool[np.ndarray, " n_p"],
) -> Float[np.ndarray, " n_inside"]:
    """Shift of an estimate by residuals that are slightly different, to first order.

    Args:
        products: the products at the estimate.
        other: the products there with the other residuals.
        prior_curvature: what priors add to the diagonal of `J'J`, (n_p,).
        inside: parameters that are not at a bound, (n_p,).
    """
    difference = replace(products, gp=other.gp - products.gp, gx=other.gx - products.gx)
    reduced = eliminate_initial_states(difference)
    matrix = reduced.matrices.sum(axis=0) + np.diag(prior_curvature)
    return -_inverse(matrix[np.ix_(inside, inside)]) @ reduced.gradients.sum(axis=0)[inside]


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of a symmetric matrix, scaled to a unit diagonal before it."""
    unit = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix / np.outer(unit, unit), hermitian=True) / np.outer(unit, unit)


def without_overflow(
    errors: Sequence[Float[np.ndarray, "_ n_q"]],
) -> list[Float[np.ndarray, "_ n_q"]]:
    """Residuals, 0 where a simulation diverged so far that their squares overflow."""
    return [np.where(np.abs(x) < LARGEST, x, 0.0) for x in errors]


def lag_correlation(errors: Sequence[Float[np.ndarray, "_ n_q"]]) -> Float[np.ndarray, " n_q"]:
    """Correlation of residuals from one sample to the next, pooled over records, not centred."""
    finite = without_overflow(errors)
    before = np.concatenate([x[:-1] for x in finite])
    after = np.concatenate([x[1:] for x in finite])
    power = np.linalg.norm(before, axis=0) * np.linalg.norm(after, axis=0)
    return np.divide(
        np.sum(before * after, axis=0), power, out=np.zeros_like(power), where=power > 0
    )
