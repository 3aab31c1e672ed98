"""Relations between columns: derivatives, copies, set points that are followed, causes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.drafting.names import NameReading
from tustinnet.data.drafting.numbers import Values
from tustinnet.data.units import ANGLE

_OWN_LAGS = 12  # at most, of which an order selection takes as many as a column needs

Pairs = Float[np.ndarray, "c c"]
Table = Float[np.ndarray, "_ c"]  # the columns of a record, of any length


class RelationLevels(NamedTuple):
    """Levels that decide on relations of columns.

    All are set by hand, not measured.

    Attributes:
        copy: share of the variance in which copies differ, rounding aside.
        sum: share of the smaller deviation, in which a sum may differ: columns are rounded.
        exact: share of the variance in which copies differ, as programs compute them.
        rounded: the same of copies that are rounded to coarse steps, at most.
        one: squared correlation of columns that are one signal: their sums say nothing.
        circle: size of a value, above which a column is no cosine.
        on_circle: deviation of cosine^2 + sine^2 from 1.
        of_angle: range of a cosine or sine, at least.
    """

    copy: float = 2e-5
    sum: float = 0.02
    exact: float = 1e-9
    rounded: float = 5e-3
    one: float = 0.98
    circle: float = 1.05
    on_circle: float = 0.02
    of_angle: float = 0.3


RELATION = RelationLevels()


@dataclass(frozen=True)
class Slopes:
    """Comparison of every column's change with the integral of every other one.

    Attributes:
        names: the columns.
        correlation: of the change of column i with the integral of column j, [i, j].
        factor: column j over the slope of column i, [i, j].
        dt: the usual interval between samples [s].
    """

    names: tuple[str, ...]
    correlation: Pairs
    factor: Pairs
    dt: float

    def between(self, position: str, velocity: str) -> tuple[float, float]:
        """Correlation and factor of a velocity with the slope of a position."""
        i, j = self.names.index(position), self.names.index(velocity)
        return float(self.correlation[i, j]), float(self.factor[i, j])

    def for_columns(self, names: Iterable[str]) -> "Slopes":
        """The comparison of some of the columns."""
        chosen = [self.names.index(name) for name in names]
        pick = np.ix_(chosen, chosen)
        return Slopes(tuple(names), self.correlation[pick], self.factor[pick], self.dt)


@np.errstate(all="ignore")  # constants have no correlation; it is set to 0
def compare_slopes(columns: Mapping[str, Sequence[Values]], times: Sequence[Values]) -> Slopes:
    """Compares changes over some samples with integrals over them; the best width counts.

    Over several samples the quantisation of an encoder, the noise of a sensor and the delay of a
    filter weigh less than in a difference between neighbours.

    Args:
        columns: samples of each column, record by record, without wraps.
        times: times of each record [s].
    """
    names = tuple(columns)
    size = len(names)
    dt = float(np.median(np.concatenate([np.diff(t) for t in times])))
    best = Slopes(names, np.zeros((size, size)), np.zeros((size, size)), dt)
    stacks = [np.stack([columns[name][k] for name in names], axis=1) for k in range(len(times))]
    stacks = [np.where(np.isfinite(stack), stack, 0.0) for stack in stacks]
    # samples over which columns are integrated
    for width in (1, 2, 4, 8, 16, 32, 64):
        changes, integrals = [], []
        stride = max(1, width // 2, sum(map(len, times)) // 20_000)
        for t, stack in zip(times, stacks, strict=True):
            if len(t) < 4 * width + 4:
                continue
            middle = (stack[1:] + stack[:-1]) / 2 * np.diff(t)[:, None]
            integral = np.concatenate([np.zeros((1, size)), np.cumsum(middle, axis=0)])
            span = (t[width:] - t[:-width])[::stride, None]
            changes.append((stack[width:] - stack[:-width])[::stride] / span)
            integrals.append((integral[width:] - integral[:-width])[::stride] / span)
        if sum(map(len, changes)) < 30:
            continue
        change, integral = np.concatenate(changes), np.concatenate(integrals)
        change, integral = (x - x.mean(axis=0) for x in (_limit(change), _limit(integral)))
        spread, spreads = change.std(axis=0), integral.std(axis=0)
        product = change.T @ integral / len(change)
        correlation = np.nan_to_num(product / np.outer(spread, spreads))
        factor = np.nan_to_num(np.sign(product) * spreads[None, :] / spread[:, None])
        better = np.abs(correlation) > np.abs(best.correlation)
        best = Slopes(
            names,
            np.where(better, correlation, best.correlation),
            np.where(better, factor, best.factor),
            dt,
        )
    return best


def _limit(columns: Table) -> Table:
    """Columns within what they usually are: a stale sample or a wrap is no motion."""
    largest = 4 * np.quantile(np.abs(columns), 0.98, axis=0)
    return np.clip(columns, -largest, largest)


@np.errstate(all="ignore")  # constants follow nothing
def find_followers(records: Sequence[Table]) -> tuple[Pairs, Pairs]:
    """The share in which columns repeat the values of others a little later, and the lag.

    Args:
        records: the columns of each record.

    Returns:
        The share of the variance of column j that earlier values of column i explain one to one,
        [i, j], at most 1; and that lag.
    """
    size = records[0].shape[1]
    best, lags = np.full((size, size), -np.inf), np.zeros((size, size))
    # samples by which a position may follow its set point
    for late in (0, 1, 2, 3, 5, 8, 12, 18, 27, 40):
        differences, spreads = np.zeros((size, size)), np.zeros(size)
        for record in records:
            if len(record) > 4 * late + 20:
                first, later = record[: len(record) - late], record[late:]
                squares = (first**2).sum(axis=0)[:, None] + (later**2).sum(axis=0)
                differences += squares - 2 * first.T @ later
                spreads += ((later - later.mean(axis=0)) ** 2).sum(axis=0)
        fit = np.nan_to_num(1 - differences / spreads, nan=-np.inf)
        better = 1 - fit < 0.9 * (1 - best)
        best, lags = np.where(better, fit, best), np.where(better, late, lags)
    return best, lags


@np.errstate(all="ignore")  # of values whose squares are too large
def find_sums(records: Sequence[Table]) -> list[tuple[int, int, int | None]]:
    """Columns that add up with another one to a third, or to a constant.

    Args:
        records: the columns of each record.

    Returns:
        Both columns, and that of their sum, None of one that is constant.
    """
    deviations = np.concatenate([record - record.mean(axis=0) for record in records])
    products = deviations.T @ deviations / len(deviations)
    squares = np.diag(products)
    sums: list[tuple[int, int, int | None]] = []
    for i, j in combinations(range(len(squares)), 2):
        limit = RELATION.sum**2 * min(squares[i], squares[j])
        are_one = products[i, j] ** 2 > RELATION.one * squares[i] * squares[j]
        total = squares[i] + squares[j] + 2 * products[i, j]
        # mean squares of the sum of both less each other column
        residual = total + squares - 2 * (products[i] + products[j])
        residual[[i, j]] = np.inf
        third = int(np.argmin(residual))
        # differences of larger squares are rounded
        is_resolved = limit > 1e-12 * max(squares[i], squares[j], squares[third])
        if total < limit and is_resolved:
            sums.append((i, j, None))
        elif residual[third] < limit and is_resolved and not are_one:
            sums.append((i, j, third))
    return sums


@np.errstate(all="ignore")  # constants repeat nothing
def find_copies(
    records: Sequence[Table], steps: Sequence[float], exact: float = RELATION.exact
) -> Pairs:
    """The factors of columns that repeat one another in another unit or from another zero.

    Args:
        records: the columns of each record.
        steps: the step of the values of each column, 0 where it has none.
        exact: share of the variance in which they may differ besides.

    Returns:
        The factor of column j, which repeats column i, [i, j]; 0 where it does not.
    """
    covariance = np.atleast_2d(np.cov(np.concatenate(records).T))
    squares = np.diag(covariance)
    slope = covariance / squares[:, None]  # of column j by column i, [i, j]
    residual = squares - slope * covariance
    rounding = np.square(steps)
    # both are rounded, by a twelfth of the square of their steps, and once more by a program
    limit = (rounding + slope**2 * rounding[:, None]) / 6 + exact * squares
    is_copy = (residual < limit) & (residual < RELATION.rounded * squares)
    return np.where(is_copy & is_copy.T & ~np.eye(len(squares), dtype=bool), slope, 0.0)


@np.errstate(all="ignore")  # constants are like nothing
def find_alike(records: Sequence[Table]) -> Bool[np.ndarray, "c c"]:
    """Marks pairs of columns that rise and fall together."""
    return np.atleast_2d(np.corrcoef(np.concatenate(records).T)) > RELATION.one


@np.errstate(all="ignore")  # constants repeat nothing
def find_other_units(records: Sequence[Table]) -> Bool[np.ndarray, "c c"]:
    """Marks pairs of columns that are one angle or its rate in two units, as two filters see it.

    Args:
        records: the columns of each record.
    """
    table = np.concatenate(records)
    ratios = table.std(axis=0) / table.std(axis=0)[:, None]
    units = [a / b for a, b in permutations(ANGLE.values(), 2)]
    is_unit = np.any([np.abs(ratios / unit - 1) < RELATION.sum for unit in units], axis=0)
    return is_unit & find_alike(records)


@np.errstate(all="ignore")  # of what stands still
def find_distances(records: Sequence[Table]) -> Bool[np.ndarray, "c c"]:
    """Marks columns j that are the distances which columns i have travelled, [i, j]."""
    steps = np.concatenate([np.diff(record, axis=0) for record in records])
    rises = np.asarray((steps >= 0).all(axis=0))
    if len(steps) < 2:
        return np.zeros((rises.size, rises.size), bool)
    alike = np.atleast_2d(np.corrcoef(np.abs(steps).T)) > RELATION.one
    return alike & rises & ~rises[:, None]


def find_copy(first: Sequence[Values], second: Sequence[Values]) -> float:
    """The factor of a column that repeats another one, nearly; 0 where it does not.

    Args:
        first: samples of a column, record by record; where they are finite they count.
        second: those of another one.
    """
    table = np.column_stack([np.concatenate(first), np.concatenate(second)])
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 3:
        return 0.0
    return float(find_copies([table], [0.0, 0.0], RELATION.copy)[0, 1])


@np.errstate(all="ignore")
def find_causes(records: Sequence[Table]) -> Pairs:
    """The help of each column's past to foresee each other one beyond its own past.

    The own past has as many samples as the Bayesian information criterion takes, so that a smooth
    column is not "caused" by whatever else is smooth. Averages over some samples show what a slow
    or noisy machine does.

    Args:
        records: the columns of each record.

    Returns:
        The logarithm of the ratio of the variances of the forecasts of column j without and with
        column i, [i, j]; 0 where it is not significant.
    """
    size = records[0].shape[1]
    gains = np.zeros((size, size))
    # samples over which causes are averaged: fast ones, and slow ones in noise
    for width in (1, 4, 12):
        blocks = [
            r[: len(r) // width * width].reshape(-1, width, size).mean(axis=1) for r in records
        ]
        blocks = [block for block in blocks if len(block) >= 25]
        if not blocks:
            continue
        spread = np.concatenate(blocks).std(axis=0)
        scale = np.where(spread > 0, spread, 1.0)
        lagged = [
            np.concatenate([(b / scale)[_OWN_LAGS - lag : len(b) - lag] for b in blocks])
            for lag in range(_OWN_LAGS + 1)
        ]
        for j in range(size):
            gains[:, j] = np.maximum(gains[:, j], _gains_of(lagged, j))
    return gains


def _gains_of(lagged: Sequence[Table], j: int) -> Values:
    """The gains of all columns for the forecast of column j, given all columns by their lag."""
    target, n = lagged[0][:, j], len(lagged[0])
    own = np.column_stack([np.ones(n), *(table[:, j] for table in lagged[1:])])
    basis = np.linalg.qr(own)[0]
    products = basis.T @ target
    noise = 1e-18 * n
    left = np.maximum(target @ target - np.cumsum(products**2), 0.0) + noise
    orders = np.arange(1, len(left) + 1)
    order = int(np.argmin((n * np.log(left) + orders * np.log(n))[2:])) + 3
    basis = basis[:, :order]
    rest = target - basis @ products[:order]
    news = [table - basis @ (basis.T @ table) for table in lagged[1:3]]
    explained = np.zeros(lagged[0].shape[1])
    for k, part in enumerate(news):
        squares = (part**2).sum(axis=0)
        squares = np.where(squares > 1e-10 * n, squares, np.inf)
        explained += (part.T @ rest) ** 2 / squares
        for later in news[k + 1 :]:
            later -= part * ((part * later).sum(axis=0) / squares)
    unexplained = float(rest @ rest) + noise
    gain = np.log(unexplained / np.maximum(unexplained - explained, noise))
    gain[j] = 0.0
    return np.where(gain > 2 * np.log(n) / n, gain, 0.0)


def find_sines(
    readings: Mapping[str, NameReading],
    samples: Mapping[str, Sequence[Values]],
    times: Sequence[Values],
) -> dict[str, str]:
    """The column of the sine of each column that is the cosine of an angle.

    Where no name says which is which, a column that then is the slope of the angle decides, else
    the cosine comes first.

    Args:
        readings: the meaning of the names.
        samples: samples of every column, record by record.
        times: times of each record [s].
    """
    sines: dict[str, str] = {}
    # accelerations of a turning sensor and voltages of a motor's phases are on circles, too
    names = [
        n
        for n, s in samples.items()
        if np.abs(np.concatenate(s)).max(initial=0.0) < RELATION.circle
        and not {*readings[n].stated(readings[n].quantities)} - {"position"}
        and readings[n].kind != "linear"
        and not readings[n].unit
    ]
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            if {first, second} & {*sines, *sines.values()}:
                continue
            if not are_of_one_angle(samples[first], samples[second]):
                continue
            pair = first, second
            pairs = zip(samples[first], samples[second], strict=True)
            angle = [np.unwrap(np.arctan2(b, a)) for a, b in pairs]
            others = {n: s for n, s in samples.items() if n not in pair}
            if any(find_copy(angle, s) for s in others.values()):
                continue  # the angle itself is there, too
            if {"sin", "sine", "sinus"} & {*readings[first].words}:
                pair = second, first
            elif not {"cos", "cosine", "cosinus"} & {*readings[first].words}:
                slopes = compare_slopes({first: angle, **others}, times)
                correlations = [slopes.between(first, n)[0] for n in others]
                is_reversed = -min(correlations, default=0.0) > max(correlations, default=0.0) + 0.5
                if is_reversed:
                    pair = second, first
            sines[pair[0]] = pair[1]
    return sines


def are_of_one_angle(first: Sequence[Values], second: Sequence[Values]) -> bool:
    """Whether two columns are cosine and sine of one angle: their squares add up to 1.

    Args:
        first: samples of a column, record by record.
        second: those of another one.
    """
    a, b = np.concatenate(first), np.concatenate(second)
    radius = a * a + b * b
    moves = min(float(np.ptp(a)), float(np.ptp(b))) > RELATION.of_angle
    return moves and bool((np.abs(radius - 1) < RELATION.on_circle).all())
