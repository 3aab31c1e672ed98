"""Uncertainty of identified parameters: covariances, condition, correlation of the residuals.

`estimate_uncertainty` takes the normal equations at the estimate, segment by segment, and returns
two covariances: from `J'J`, and from how the records disagree (clustered).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
from jaxtyping import Bool, Float

from tustinnet.fitting.shooting.normal import NormalProducts, eliminate_initial_states
from tustinnet.fitting.shooting.segments import Segments

FEWEST_RECORDS = 4  # for an estimate of how records differ
CONFIDENCE = 0.95
_LARGEST = 1e100  # residuals above it cannot be squared and summed


@dataclass(frozen=True)
class Uncertainty:
    """Covariances in the coordinates of the search, of the parameters that are not at a bound.

    Attributes:
        naive: covariance from `J'J`, right only where residuals are independent and no structure
            is missing.
        clustered: covariance from how the records disagree, None where there are too few.
        naive_quantile: standard errors of `naive` that make half a 95 % interval.
        condition: ratio of the best to the worst determined direction.
        worst_direction: the worst determined direction, (n_p,), its largest entry 1.
    """

    naive: Float[np.ndarray, "n_p n_p"]
    clustered: Float[np.ndarray, "n_p n_p"] | None
    naive_quantile: float
    condition: float
    worst_direction: Float[np.ndarray, " n_p"]

    @property
    def trusted(self) -> Float[np.ndarray, "n_p n_p"]:
        """Covariance to trust: that of the records where there are enough of them."""
        return self.naive if self.clustered is None else self.clustered

    def quantile_for_records(self, records: int) -> float:
        """Standard errors that make half a 95 % interval of a parameter of only so many records."""
        if self.clustered is None:
            return self.naive_quantile
        return float(scipy.special.stdtrit(max(records - 1, 1), (1 + CONFIDENCE) / 2))


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
        return Uncertainty(naive, None, np.nan, np.inf, np.zeros(n_p))
    first = segments.first_of_records
    reduced = eliminate_initial_states(products)
    matrices = np.add.reduceat(reduced.matrices, first)[:, inside][:, :, inside]
    gradients = np.add.reduceat(reduced.gradients, first)[:, inside]
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
    clustered, n = None, len(matrices)
    if n >= FEWEST_RECORDS:
        steps = np.stack(
            [_inverse(whole - m) @ g for m, g in zip(matrices, gradients, strict=True)]
        )
        steps -= steps.mean(axis=0)
        clustered = np.full((n_p, n_p), np.nan)
        # without bounds where a record alone tells a parameter, and of a search far from its end
        with np.errstate(over="ignore", invalid="ignore"):
            jackknife = (n - 1) / n * steps.T @ steps
            clustered[np.ix_(inside, inside)] = jackknife + inverse @ by_prior @ inverse
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
    errors: Sequence[Float[np.ndarray, "_ n_y"]],
) -> list[Float[np.ndarray, "_ n_y"]]:
    """Residuals, 0 where a simulation diverged so far that their squares overflow."""
    return [np.where(np.abs(x) < _LARGEST, x, 0.0) for x in errors]


def lag_correlation(errors: Sequence[Float[np.ndarray, "_ n_y"]]) -> Float[np.ndarray, " n_y"]:
    """Correlation of residuals from one sample to the next, pooled over records, not centred."""
    finite = without_overflow(errors)
    before = np.concatenate([x[:-1] for x in finite])
    after = np.concatenate([x[1:] for x in finite])
    power = np.sum(before**2, axis=0)
    return np.divide(
        np.sum(before * after, axis=0), power, out=np.zeros_like(power), where=power > 0
    )
