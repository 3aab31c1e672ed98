"""The share of measured motion that lies inside bands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import Band

_TENTHS = np.arange(1, 10) / 10  # levels whose bands' ends are the quantiles of a score


@dataclass(frozen=True)
class Coverage:
    """The share of some records that lies inside bands, of one coordinate.

    Attributes:
        coordinate: its name.
        part: `moving`, or `rest`.
        inside: share of the time inside, the mean of the records.
        interval: 95 % binomial interval of that, one trial a record: times of one record are alike.
        records: how many records have this part.
        whole: of how many of them all lies inside.
        width: mean width [rad or m].
        rmse: of the free runs [rad or m].
        crps: continuous ranked probability score [rad or m].
    """

    coordinate: str
    part: str
    inside: float
    interval: tuple[float, float]
    records: int
    whole: int
    width: float
    rmse: float
    crps: float


def compute_coverage(experiments: Sequence[Experiment], bands: Sequence[Band]) -> list[Coverage]:
    """The share of some records that lies inside their bands, by coordinate, motion and rest apart.

    Args:
        experiments: the records.
        bands: around their free runs.
    """
    result = []
    crps = [compute_crps(e, band) for e, band in zip(experiments, bands, strict=True)]
    for j, c in enumerate(experiments[0].coordinates):
        for part in ("moving", "rest"):
            rows = []
            for e, band, score in zip(experiments, bands, crps, strict=True):
                moving = band.prediction.moving
                where = moving if part == "moving" else ~moving
                where = where & (np.arange(len(moving)) >= band.prediction.first)
                if not where.any():
                    continue
                inside = band.contains(e.q)[where, j]
                middle = (band.low + band.high)[where, j] / 2
                width = (band.high - band.low)[where, j].mean()
                square = np.mean((middle - e.q[where, j]) ** 2)
                row = (inside.mean(), inside.all(), width, square, score[where, j].mean())
                rows.append([float(x) for x in row])
            if not rows:
                continue
            inside, whole, width, square, score = np.array(rows).T
            result.append(
                Coverage(
                    c.name,
                    part,
                    inside=float(inside.mean()),
                    interval=_binomial_interval(float(inside.sum()), len(rows)),
                    records=len(rows),
                    whole=int(whole.sum()),
                    width=float(width.mean()),
                    rmse=float(np.sqrt(square).mean()),
                    crps=float(score.mean()),
                )
            )
    return result


def compute_crps(experiment: Experiment, band: Band) -> Float[np.ndarray, "n n_q"]:
    """Continuous ranked probability score at every time, (n, n_q) [rad or m].

    From the ends of bands of 10, 20, ... % around the same free run, as far as there are enough
    calibration records, taken as quantiles (the mean pinball loss). The level of the band itself
    does not matter.
    """
    calibration, prediction = band.calibration, band.prediction
    levels = [level for level in _TENTHS.tolist() if level <= calibration.highest_level]
    halves = np.stack([calibration.half_width(prediction, level) for level in levels], axis=-1)
    middle = prediction.simulated[..., None]
    quantiles = np.concatenate([middle - halves[..., ::-1], middle, middle + halves], axis=-1)
    tails = (1 - np.array(levels)) / 2
    shares = np.concatenate([tails[::-1], [0.5], 1 - tails])
    error = experiment.q[..., None] - quantiles
    return 2 * np.mean(np.maximum(shares * error, (shares - 1) * error), axis=-1)


def _binomial_interval(successes: float, trials: int) -> tuple[float, float]:
    """The exact 95 % binomial interval (Clopper, Pearson 1934), also of a broken number."""
    import scipy.special  # only bands need it

    tail, quantile = (1 - 0.95) / 2, scipy.special.betaincinv
    low = quantile(successes, trials - successes + 1, tail) if successes > 0 else 0.0
    high = quantile(successes + 1, trials - successes, 1 - tail) if successes < trials else 1.0
    return float(low), float(high)
