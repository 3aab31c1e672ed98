"""How much of what happened lies inside bands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import Band

_CONFIDENCE = 0.95
_TENTHS = np.arange(1, 10) / 10  # levels whose bands' ends are the quantiles of a score


@dataclass(frozen=True)
class Covered:
    """How much of some records lies inside bands, of one coordinate.

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


def covered(experiments: Sequence[Experiment], bands: Sequence[Band]) -> list[Covered]:
    """How much of some records lies inside their bands, by coordinate, motion and rest apart.

    Args:
        experiments: the records.
        bands: around their free runs.
    """
    found = []
    crps = [crps_of(e, band) for e, band in zip(experiments, bands, strict=True)]
    for j, c in enumerate(experiments[0].coordinates):
        for part in ("moving", "rest"):
            rows = [
                _one(e, band, score, where, j)
                for e, band, score in zip(experiments, bands, crps, strict=True)
                if (where := _where(band, part)).any()
            ]
            if rows:
                found.append(_mean(c.name, part, np.array(rows)))
    return found


def crps_of(experiment: Experiment, band: Band) -> Float[np.ndarray, "n n_q"]:
    """Continuous ranked probability score at every time, (n, n_q) [rad or m].

    From the ends of bands of 10, 20, ... % around the same free run, as far as there are enough
    calibration records, taken as quantiles (the mean pinball loss). The level of the band itself
    does not matter.
    """
    import scoringrules  # takes long to load, and only bands need it

    calibration, guess = band.calibration, band.guess
    levels = [level for level in _TENTHS.tolist() if level <= calibration.most]
    halves = np.stack([calibration.half(guess, level) for level in levels], axis=-1)
    middle = guess.simulated[..., None]
    quantiles = np.concatenate([middle - halves[..., ::-1], middle, middle + halves], axis=-1)
    tails = (1 - np.array(levels)) / 2
    shares = np.concatenate([tails[::-1], [0.5], 1 - tails])
    return np.asarray(scoringrules.crps_quantile(experiment.q, quantiles, shares))


def _where(band: Band, part: str) -> Bool[np.ndarray, " n"]:
    moving = band.guess.moving
    after = np.arange(len(moving)) >= band.guess.first
    return after & (moving if part == "moving" else ~moving)


def _one(
    e: Experiment, band: Band, crps: np.ndarray, where: np.ndarray, j: int
) -> tuple[float, ...]:
    """Share inside, whether all is, mean width, mean square error, score; of one record."""
    inside = band.holds(e.q)[where, j]
    middle = (band.low + band.high)[where, j] / 2
    width = (band.high - band.low)[where, j]
    square = np.mean((middle - e.q[where, j]) ** 2)
    parts = (inside.mean(), inside.all(), width.mean(), square, crps[where, j].mean())
    return tuple(float(x) for x in parts)


def _mean(coordinate: str, part: str, rows: np.ndarray) -> Covered:
    inside, whole, width, square, crps = rows.T
    n = len(rows)
    return Covered(
        coordinate, part,
        inside=float(inside.mean()), interval=_interval(float(inside.sum()), n),
        records=n, whole=int(whole.sum()),
        width=float(width.mean()), rmse=float(np.sqrt(square).mean()), crps=float(crps.mean()),
    )  # fmt: skip


def _interval(successes: float, trials: int) -> tuple[float, float]:
    """The exact binomial interval (Clopper, Pearson 1934), also of a broken number of successes."""
    import scipy.special  # only bands need it

    tail, quantile = (1 - _CONFIDENCE) / 2, scipy.special.betaincinv
    low = quantile(successes, trials - successes + 1, tail) if successes > 0 else 0.0
    high = quantile(successes + 1, trials - successes, 1 - tail) if successes < trials else 1.0
    return float(low), float(high)
