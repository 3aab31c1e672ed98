"""How far identified parameters can be trusted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.special
from jaxtyping import Bool, Float

from tustinnet.fitting.shooting.least_squares import eliminated
from tustinnet.fitting.shooting.normal import Normal
from tustinnet.fitting.shooting.segments import Segments

FEWEST_RECORDS = 4  # fewer say too little about how records differ
CONFIDENCE = 0.95
_ENDLESS = 1e100  # residuals that cannot be squared and summed


@dataclass(frozen=True)
class Uncertainty:
    """Covariances in the coordinates of the search, of the parameters that are not at a bound.

    Attributes:
        naive: from `J'J`, right only where residuals are independent and no structure is missing.
        clustered: from how the records disagree, None where there are too few.
        quantiles: standard errors that make half a 95 % interval: of `naive`, of `clustered`.
        condition: ratio of the best to the worst determined direction.
        worst: the worst determined direction, (n_p,), its largest entry 1.
    """

    naive: Float[np.ndarray, "n_p n_p"]
    clustered: Float[np.ndarray, "n_p n_p"] | None
    quantiles: tuple[float, float]
    condition: float
    worst: Float[np.ndarray, " n_p"]

    @property
    def trusted(self) -> Float[np.ndarray, "n_p n_p"]:
        """The covariance to believe: that of the records where there are enough of them."""
        return self.naive if self.clustered is None else self.clustered

    @property
    def trusted_quantile(self) -> float:
        """Standard errors of `trusted` that make half a 95 % interval."""
        return self.quantiles[0 if self.clustered is None else 1]

    def quantile_of(self, records: int) -> float:
        """The same for a parameter that only so many of the records say something of."""
        if self.clustered is None:
            return self.quantiles[0]
        return float(scipy.special.stdtrit(max(records - 1, 1), (1 + CONFIDENCE) / 2))


def uncertainty(
    normal: Normal,
    segments: Segments,
    curvature: Float[np.ndarray, " n_p"],
    moving: Bool[np.ndarray, " n_p"],
) -> Uncertainty:
    """Covariances of an estimate, the segments of a record taken together.

    The clustered covariance leaves out one record at a time, to first order:
    `(n - 1) / n sum d_i d_i'` with `d_i = (H - H_i)^-1 g_i`, `H_i` and `g_i` being a record's
    share of the reduced normal equations. It holds whatever correlation a record has in itself.

    Args:
        normal: the products at the estimate.
        segments: the records' segments.
        curvature: what priors add to the diagonal of `H`, (n_p,).
        moving: parameters that are not at the end of their range, (n_p,).

    References:
        MacKinnon, White (1985), Some heteroskedasticity-consistent covariance matrix estimators
        with improved finite sample properties (HC3, the jackknife).
        Cameron, Gelbach, Miller (2008), Bootstrap-based improvements for inference with clustered
        errors.
    """
    if not np.isfinite(normal.cost).all():
        unknown = np.full((len(moving), len(moving)), np.nan)
        return Uncertainty(unknown, None, (np.nan, np.nan), np.inf, np.zeros(len(moving)))
    begins = segments.begins
    matrices, gradients = (np.add.reduceat(of, begins) for of in eliminated(normal)[:2])
    matrices, gradients = matrices[:, moving][:, :, moving], gradients[:, moving]
    whole = matrices.sum(axis=0) + np.diag(curvature[moving])
    inverse = _inverse(whole)
    # every residual weighs 1/T: the records' gradients have variance sigma^2 / T times their matrix
    samples = 1 / segments.share[begins]
    channels = np.count_nonzero(segments.weight.any(axis=0))
    used = np.count_nonzero(segments.searched) + int(moving.sum())
    freedom = max(float(samples.sum() * channels - used), 1.0)
    variance = float(normal.cost @ (1 / segments.share)) / freedom
    known = variance * len(samples) / samples.sum() * np.diag(curvature[moving])
    spread = np.tensordot(variance / samples, matrices, 1) + known
    naive = inverse @ spread @ inverse
    clustered, n = None, len(matrices)
    if n >= FEWEST_RECORDS:
        clustered = _clustered(whole, matrices, gradients) + inverse @ known @ inverse
    unit = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    values, vectors = np.linalg.eigh(whole / np.outer(unit, unit))
    worst = vectors[:, 0] / unit if len(unit) else np.zeros(0)
    tail = (1 + CONFIDENCE) / 2
    return Uncertainty(
        naive=_embedded(naive, moving),
        clustered=None if clustered is None else _embedded(clustered, moving),
        quantiles=(
            float(scipy.special.stdtrit(freedom, tail)),
            float(scipy.special.stdtrit(max(n - 1, 1), tail)),
        ),
        condition=float(np.sqrt(values[-1] / max(values[0], 1e-300))) if len(unit) else 1.0,
        worst=_filled(worst / np.abs(worst).max(initial=1e-300), moving),
    )


def bounded(errors: Sequence[Float[np.ndarray, "_ n_y"]]) -> list[Float[np.ndarray, "_ n_y"]]:
    """Residuals; where a simulation ran away, so far that squares overflow, they are 0."""
    return [np.where(np.abs(x) < _ENDLESS, x, 0.0) for x in errors]


def lag_correlation(errors: Sequence[Float[np.ndarray, "_ n_y"]]) -> Float[np.ndarray, " n_y"]:
    """Correlation of residuals from one sample to the next, pooled over records, not centred."""
    known = bounded(errors)
    before, after = (
        np.concatenate([x[part] for x in known]) for part in (slice(-1), slice(1, None))
    )
    power = np.sum(before**2, axis=0)
    return np.divide(
        np.sum(before * after, axis=0), power, out=np.zeros_like(power), where=power > 0
    )


def _clustered(whole: np.ndarray, matrices: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """The covariance by leaving out one record at a time, to first order."""
    n = len(matrices)
    away = np.stack([_inverse(whole - m) @ g for m, g in zip(matrices, gradients, strict=True)])
    away -= away.mean(axis=0)
    return (n - 1) / n * away.T @ away


def _inverse(matrix: np.ndarray) -> np.ndarray:
    unit = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.pinv(matrix / np.outer(unit, unit), hermitian=True) / np.outer(unit, unit)


def _embedded(matrix: np.ndarray, moving: np.ndarray) -> np.ndarray:
    whole = np.full((len(moving), len(moving)), np.nan)
    whole[np.ix_(moving, moving)] = matrix
    return whole


def _filled(values: np.ndarray, moving: np.ndarray) -> np.ndarray:
    whole = np.zeros(len(moving))
    whole[moving] = values
    return whole
