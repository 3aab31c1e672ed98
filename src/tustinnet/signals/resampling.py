"""The time base of a record: its regularity, a regular grid, unwrapped angles."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from tustinnet.errors import InputError

Times = Float[np.ndarray, " n"]

LONGEST_INTERVAL = 2.5  # periods; a longer one is a gap: two or more samples are missing
_TURN = 2 * np.pi * (1 + 1e-3)  # rad, with the rounding of a file
JITTER = 0.05  # of a period, by which intervals may differ from it
_LONGEST_GRID = 10  # times the samples of a record; a wild timestamp would need any number


@dataclass(frozen=True)
class Regularity:
    """Deviation of a record's timestamps from a regular grid.

    Attributes:
        median_dt: median interval [s].
        jitter: root mean square of interval minus period, outside gaps [s].
        worst: largest |interval - period| [s].
        worst_row: index of the sample that ends that interval.
        gaps: indices of the samples before an interval of more than 2.5 periods.
    """

    median_dt: float
    jitter: float
    worst: float
    worst_row: int
    gaps: tuple[int, ...]


def regularity(t: Times, dt: float) -> Regularity:
    """Compares timestamps [s] with the nominal period `dt` [s]."""
    intervals = np.diff(t)
    deviation = np.abs(intervals - dt)
    inside = intervals <= LONGEST_INTERVAL * dt
    return Regularity(
        median_dt=float(np.median(intervals)),
        jitter=float(np.sqrt(np.mean(deviation[inside] ** 2))) if inside.any() else float("nan"),
        worst=float(deviation.max()),
        worst_row=int(deviation.argmax()) + 1,
        gaps=tuple(int(k) for k in np.flatnonzero(~inside)),
    )


def describe_worst(t: Times, times: Regularity) -> str:
    """The interval between timestamps [s] that differs most from the period, in words."""
    row = times.worst_row
    return (
        f"interval of {t[row] - t[row - 1]:.4g} s before sample {row} "
        f"(usually {times.median_dt:.4g} s)"
    )


def require_short_grid(t: Times, dt: float, place: Callable[[int], object]) -> None:
    """Raises unless the grid of period `dt` [s] is at most 10 times as long as the record.

    Args:
        t: timestamps [s].
        dt: period of the grid [s].
        place: name of a sample in the message, by its index.

    Raises:
        InputError: a longer grid; the message names the longest interval.
    """
    samples = (t[-1] - t[0]) / dt
    if samples > _LONGEST_GRID * len(t):
        intervals = np.diff(t)
        row = int(intervals.argmax()) + 1
        raise InputError(
            place(row),
            f"a grid of {dt:g} s makes {samples:.3g} samples of {len(t)}, "
            f"most of them before this one (interval of {intervals[row - 1]:.4g} s)",
            f"at most {_LONGEST_GRID} times as many",
            "correct the timestamp, split the record there, or take a longer period",
        )


def regular_grid(t: Times, dt: float) -> Float[np.ndarray, " m"]:
    """The grid `t[0] + k dt` [s] inside the record."""
    # the small allowance keeps the last sample of a record that is regular up to rounding
    return t[0] + dt * np.arange(int(np.floor((t[-1] - t[0]) / dt + 1e-6)) + 1)


def resample_positions(
    t: Times, q: Float[np.ndarray, "n n_q"], grid: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m n_q"]:
    """Positions on a grid by cubic spline; angles must be unwrapped before."""
    import scipy.interpolate  # takes half a second, and regular records need none of it

    degree = min(3, len(t) - 1)
    return scipy.interpolate.make_interp_spline(t, q, k=degree)(np.clip(grid, t[0], t[-1]))


def resample_linear(
    t: Times, signal: Float[np.ndarray, "n c"], grid: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m c"]:
    """Linear interpolation, for noisy signals (measured velocities, first-order-held inputs)."""
    columns = [np.interp(grid, t, column) for column in signal.T]
    return np.stack(columns, axis=1) if columns else np.zeros((len(grid), 0))


def resample_held(
    t: Times, u: Float[np.ndarray, "n n_u"], grid: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m n_u"]:
    """Held inputs on a grid: each grid interval gets the mean of the values applied during it.

    The mean keeps the impulse that the system received, which picking the value at the grid
    point would not. After the last sample its value is held.
    """
    if len(grid) == 1:
        return u[:1].copy()
    impulse = np.concatenate(
        [np.zeros((1, u.shape[1])), np.cumsum(u[:-1] * np.diff(t)[:, None], 0)]
    )
    edges = np.append(grid, 2 * grid[-1] - grid[-2])
    inside = resample_linear(t, impulse, np.minimum(edges, t[-1]))
    inside += np.maximum(edges - t[-1], 0.0)[:, None] * u[-1]
    return np.diff(inside, axis=0) / np.diff(edges)[:, None]


# inputs of a hold
BY_HOLD = {
    "zero-order": resample_held,
    "first-order": resample_linear,
    "band-limited": resample_positions,
}


def unwrap_angle(
    angle: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " w"]]:
    """Angle [rad] without the jumps of a wrapped encoder, and the indices where it had jumped.

    A step of more than half a turn between samples is taken for a wrap. Whole turns are counted
    and added at once, so that a reading in a turn is always the same angle to the last digit.
    A single reading that is whole turns away from all others is no wrap and stays as it is.
    """
    steps = np.diff(angle)
    jumps = np.flatnonzero(np.abs(steps) > np.pi) + 1
    if not len(jumps):
        return angle, jumps
    turns = np.round(steps / (2 * np.pi))
    for i in _spikes(angle, turns):
        around = turns[max(i - 1, 0) : i + 1]
        wrap = around.sum() if len(around) == 2 else 0.0  # one that comes with the reading
        around[:], around[-1] = 0.0, wrap
        jumps = np.flatnonzero(turns) + 1
    total = -np.cumsum(np.concatenate([[0.0], turns]))
    return angle + 2 * np.pi * total, jumps


def _spikes(angle: Float[np.ndarray, " n"], turns: Float[np.ndarray, " m"]) -> list[int]:
    """Indices of single readings that jump by turns which the other readings do not span.

    Apart from these turns they jump farther than any others. Where they do not, they are like
    their neighbours, as at the seam of a counter of several turns.

    Args:
        angle: the readings [rad].
        turns: whole turns in each step between them.
    """
    before, after = np.append(0.0, turns), np.append(turns, 0.0)
    ends = (np.arange(len(angle)) == 0) | (np.arange(len(angle)) == len(angle) - 1)
    size = np.maximum(np.abs(before), np.abs(after))
    alone = np.flatnonzero((size >= 2) & ((np.abs(before + after) <= 1) | ends))
    rest = np.delete(angle, alone)
    if not len(rest):
        return []
    moves = np.abs(np.diff(angle) - 2 * np.pi * turns)
    beside = np.zeros(len(angle) + 1, bool)
    beside[alone] = beside[alone + 1] = True  # steps into and out of these readings
    usual = moves[~beside[1:-1]].max(initial=0.0)
    farthest = np.maximum(np.append(0.0, moves), np.append(moves, 0.0))
    return [int(i) for i in alone if np.ptp(rest) < _TURN * (size[i] - 1) and farthest[i] > usual]


def wraps_within_turn(angle: Float[np.ndarray, " n"]) -> bool:
    """Whether an angle [rad], before it is unwrapped, is that of an encoder that wraps each turn.

    It then jumps, all its values lie within a turn, and apart from the turn it moves by less than
    a quarter turn where it jumps, else a bad row is more likely.
    """
    step = np.diff(angle)
    turns = np.round(step / (2 * np.pi))
    moves = np.abs(step - 2 * np.pi * turns)[turns != 0]
    return bool(len(moves) and np.ptp(angle) < _TURN and moves.max() < np.pi / 2)


def turns_to_beginning(angle: float) -> int:
    """Whole turns to add to a wrapped angle [rad] at which a record begins.

    It then lies above -3/8 and at most at 5/8 of a turn. The seam is where records rarely begin:
    at rest an arm hangs, stands or lies at a multiple of a quarter turn, and must not begin now
    on one side, now on the other.
    """
    return int(np.floor(5 / 8 - angle / (2 * np.pi)))
