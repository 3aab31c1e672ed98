"""Relations between columns: derivatives, copies in other units, commands that are followed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.data.drafting.names import NameReading
from tustinnet.data.drafting.numbers import Values

_WIDTHS = (1, 2, 4, 8, 16, 32, 64)  # samples over which a column is integrated
_MOST_ROWS = 20_000  # displacements that are compared
_FEWER_ROWS = 5_000  # accelerations that are explained
_WITHOUT = [0, 1, 2, 4]  # the regression without the column that explains
_LAGS = (1, 2, 3, 5, 8, 13, 21, 34, 55)  # samples by which a command may lead
_COPY = 2e-5  # share of the variance in which copies differ, rounding aside

_CIRCLE = 1.05  # no cosine is larger
_ON_CIRCLE = 0.02  # deviation of cosine^2 + sine^2 from 1
_OF_ANGLE = 0.3  # range of a cosine or sine, at least
_SPANS = (1, 2, 4, 8, 16, 32)  # samples over which an acceleration is averaged

Pairs = Float[np.ndarray, "c c"]


@dataclass(frozen=True)
class Slopes:
    """Comparison of every column's change with the integral of every other one.

    Attributes:
        names: the columns.
        correlation: of the change of column i with the integral of column j, [i, j].
        factor: column j over the slope of column i, [i, j].
    """

    names: tuple[str, ...]
    correlation: Pairs
    factor: Pairs

    def between(self, position: str, velocity: str) -> tuple[float, float]:
        """Correlation and factor of a velocity with the slope of a position."""
        i, j = self.names.index(position), self.names.index(velocity)
        return float(self.correlation[i, j]), float(self.factor[i, j])


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
    best = Slopes(names, *(np.zeros((size, size)) for _ in range(2)))
    stacks = [np.stack([columns[name][k] for name in names], axis=1) for k in range(len(times))]
    stacks = [np.where(np.isfinite(stack), stack, 0.0) for stack in stacks]
    for width in _WIDTHS:
        changes, integrals = [], []
        stride = max(1, width // 2, sum(map(len, times)) // _MOST_ROWS)
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
        change, integral = change - change.mean(axis=0), integral - integral.mean(axis=0)
        spread, spreads = change.std(axis=0), integral.std(axis=0)
        product = change.T @ integral / len(change)
        correlation = np.nan_to_num(product / np.outer(spread, spreads))
        factor = np.nan_to_num(np.sign(product) * spreads[None, :] / spread[:, None])
        better = np.abs(correlation) > np.abs(best.correlation)
        best = Slopes(
            names,
            np.where(better, correlation, best.correlation),
            np.where(better, factor, best.factor),
        )
    return best


@dataclass(frozen=True)
class Following:
    """The course of one column against that of another one.

    Attributes:
        correlation: of both at the best lag.
        factor: the second over the first.
        lead: samples by which the first precedes the second.
    """

    correlation: float
    factor: float
    lead: int


@np.errstate(all="ignore")
def compare_courses(first: Sequence[Values], second: Sequence[Values]) -> Following:
    """Compares two columns at several lags, the best of which counts.

    Args:
        first: samples of a column, record by record.
        second: those of another one.
    """
    best = Following(0.0, 0.0, 0)
    for lag in (0, *_LAGS, *(-lag for lag in _LAGS)):
        before = [
            a[: len(a) - lag] if lag >= 0 else a[-lag:] for a in first if len(a) > 4 * abs(lag)
        ]
        after = [b[lag:] if lag >= 0 else b[:lag] for b in second if len(b) > 4 * abs(lag)]
        if not before:
            continue
        a, b = np.concatenate(before), np.concatenate(after)
        usable = np.isfinite(a) & np.isfinite(b)
        a, b = a[usable] - a[usable].mean(), b[usable] - b[usable].mean()
        correlation = float(np.nan_to_num(a @ b / np.sqrt((a @ a) * (b @ b))))
        if abs(correlation) > abs(best.correlation) + 1e-6:
            best = Following(correlation, float(np.nan_to_num((a @ b) / (a @ a))), lag)
    return best


@np.errstate(all="ignore")
def find_copy(first: Sequence[Values], second: Sequence[Values]) -> float | None:
    """The factor of a column that is another one in another unit, None where it is none.

    Args:
        first: samples of a column, record by record.
        second: those of another one.
    """
    a, b = np.concatenate(first), np.concatenate(second)
    usable = np.isfinite(a) & np.isfinite(b)
    a, b = a[usable], b[usable]
    if len(a) < 3 or not np.ptp(a) or not np.ptp(b):
        return None
    a, b = a - a.mean(), b - b.mean()
    correlation = a @ b / np.sqrt((a @ a) * (b @ b))
    return float((a @ b) / (a @ a)) if 1 - correlation**2 < _COPY else None


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
        if np.abs(np.concatenate(s)).max(initial=0.0) < _CIRCLE
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
            if {"sin", "sine", "sinus"} & {*readings[first].words}:
                pair = second, first
            elif not {"cos", "cosine", "cosinus"} & {*readings[first].words}:
                pairs = zip(samples[first], samples[second], strict=True)
                angle = [np.unwrap(np.arctan2(b, a)) for a, b in pairs]
                others = {n: s for n, s in samples.items() if n not in pair}
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
    moves = min(float(np.ptp(a)), float(np.ptp(b))) > _OF_ANGLE
    return moves and bool((np.abs(radius - 1) < _ON_CIRCLE).all())


@np.errstate(all="ignore")
def explained_acceleration(
    first: Sequence[Values], second: Sequence[Values], times: Sequence[Values]
) -> float:
    """The share of the acceleration of a column that another one explains, 0 to 1.

    It is the share of what position, velocity and direction of motion leave unexplained in a linear
    regression, over the span of samples at which it is largest. An input explains much of the
    acceleration of a position, and a position little of that of an input.

    Args:
        first: samples of the column that explains, record by record.
        second: samples of the column that accelerates.
        times: times of each record [s].
    """
    best = 0.0
    for span in _SPANS:
        rows, targets = [], []
        weights = np.convolve(np.ones(span), np.ones(span)) / span**2
        for u, q, t in zip(first, second, times, strict=True):
            if len(t) < 6 * span + 10:
                continue
            width = span * float(np.median(np.diff(t)))
            stride = max(1, span // 2, sum(map(len, times)) // _FEWER_ROWS)
            v = (q[2 * span :] - q[: -2 * span]) / (2 * width)
            a = (q[2 * span :] - 2 * q[span:-span] + q[: -2 * span]) / width**2
            # the second difference is the acceleration weighted by a triangle around the sample
            average = np.convolve(u, weights, "valid")[1 : 1 + len(a)]
            direction = np.sign(np.where(np.abs(v) > 0.02 * np.abs(v).max(), v, 0.0))
            rows.append(np.column_stack([q[span:-span], v, direction, average])[::stride])
            targets.append(a[::stride])
        if sum(map(len, rows)) < 30:
            continue
        table = np.column_stack([np.concatenate(rows), np.concatenate(targets)])
        table = table - table.mean(axis=0)
        table = table / np.where(table.std(axis=0) > 0, table.std(axis=0), 1.0)
        if not np.isfinite(table).all():
            continue
        products = table.T @ table / len(table)
        before = _unexplained(products[np.ix_(_WITHOUT, _WITHOUT)])
        after = _unexplained(products)
        best = max(best, 1 - after / before if before > 0 else 0.0)
    return best


def _unexplained(products: Pairs) -> float:
    """The share of the last column that the others leave unexplained, by correlations of all."""
    inner, outer = products[:-1, :-1], products[:-1, -1]
    slopes = np.linalg.lstsq(inner, outer, rcond=1e-10)[0]
    return max(float(products[-1, -1] - outer @ slopes), 0.0)
