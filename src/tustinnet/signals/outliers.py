"""Noise of signals, and samples that do not belong to them: jumps of positions, spikes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tustinnet.signals.encoder import encoder_count

_THIRD_DIFFERENCE = np.sqrt(20.0)  # standard deviation of that of white noise of 1
TO_DEVIATION = 1.4826  # of the median size of normal numbers


class JumpLevels(NamedTuple):
    """Levels from which on a change of a position is a jump, see `find_jumps`.

    All are set by hand, not measured.

    Attributes:
        near: samples nearby among which motion is as fast.
        around: samples nearby among which changes deviate as much.
        usual_rank: samples of these that deviate less than is usual: six may be jumps
            themselves.
        large: deviation of a jump, by the usual one nearby.
        fast: this deviation by the largest change nearby that does not stick out.
        counts: this deviation in encoder counts.
        rounding: this deviation as a share of the largest position.
        reach: samples around a jump, which are bent by it.
        many: jumps, of which more are usual in a log that is faster than its sensor.
        many_share: the same as a share of all changes.
    """

    near: int = 11
    around: int = 31
    usual_rank: int = 24
    large: float = 8.0
    fast: float = 2.0
    counts: float = 5.0
    rounding: float = 1e-9
    reach: int = 3
    many: int = 10
    many_share: float = 0.05


JUMP = JumpLevels()


def white_noise(q: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " c"]:
    """Standard deviation of the white part of each signal, (c,), which outliers do not change."""
    if len(q) < 4:
        return np.zeros(q.shape[1])
    size = np.median(np.abs(np.diff(q, 3, axis=0)), axis=0)
    return size * TO_DEVIATION / _THIRD_DIFFERENCE


def sensor_noise(
    q: Float[np.ndarray, "n c"], counts: Float[np.ndarray, " c"]
) -> Float[np.ndarray, " c"]:
    """Standard deviation of the noise of sensors, (c,): at least that of rounding to counts.

    Args:
        q: their signals.
        counts: steps in which each counts, 0 where it does not.
    """
    return np.maximum(white_noise(q), counts / np.sqrt(12))


def find_jumps(
    t: Float[np.ndarray, " n"], q: Float[np.ndarray, " n"], count: float
) -> Int[np.ndarray, " jumps"]:
    """Samples that a position reaches by a jump: bad rows (there and back), lost counts.

    Changes from sample to sample are compared with the median of five of them, which follows
    smooth motion, turning points, quantised rest and the changes of speed of impacts alike. What
    sticks out is a jump where it is large compared with what else sticks out nearby, with how
    fast the position moves there, with how much it bends anywhere else, and with the encoder's
    count.

    Args:
        t: timestamps [s].
        q: positions, angles not wrapped [rad or m].
        count: encoder count, 0 where unknown [rad or m].
    """
    interval = np.diff(t)
    change = np.diff(q) * (np.median(interval) / interval)  # a gap is no jump
    if len(change) < 5:
        return np.zeros(0, int)
    usual = _rank_filter(change, 5, 2)
    deviation = np.abs(change - usual)
    fast = _rank_filter(np.abs(usual), JUMP.near, JUMP.near - 1)
    others = _rank_filter(deviation, JUMP.around, JUMP.usual_rank)
    least = max(JUMP.counts * count, JUMP.rounding * float(np.abs(q).max()))
    threshold = np.maximum(np.maximum(JUMP.large * others, JUMP.fast * fast), least)
    jumps = np.flatnonzero(deviation > threshold) + 1
    jumps = jumps[deviation[jumps - 1] > _largest_bend(change, jumps)]
    # a log that is faster than its sensor moves by jumps alone
    is_usual = len(jumps) > JUMP.many and len(jumps) > JUMP.many_share * np.count_nonzero(change)
    return jumps[:0] if is_usual else jumps


def find_outliers(v: Float[np.ndarray, " n"]) -> Int[np.ndarray, " rows"]:
    """Samples of a velocity that stick out of their neighbours, as jumps of its integral would."""
    integral = np.concatenate([[0.0], np.cumsum(v)])
    return find_jumps(np.arange(len(integral), dtype=float), integral, encoder_count(v) or 0.0) - 1


def _largest_bend(change: Float[np.ndarray, " m"], jumps: Int[np.ndarray, " jumps"]) -> float:
    """The largest change of the speed, a sample, away from jumps.

    A mechanism that is driven to and fro, or runs through a dead band, bends its motion as much.
    """
    bend = np.abs(np.diff(change))
    near = (jumps[:, None] + np.arange(-JUMP.reach - 2, JUMP.reach)).ravel()
    bend[near[(near >= 0) & (near < len(bend))]] = 0.0
    return float(bend.max(initial=0.0))


def _rank_filter(x: Float[np.ndarray, " n"], width: int, rank: int) -> Float[np.ndarray, " n"]:
    """Rank filter: the value of a rank, from 0, among those in a window around each sample.

    The signal is mirrored at its ends.
    """
    # written out, for scipy.ndimage takes longer to load than records take to be inspected
    padded = np.pad(x, width // 2, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, width)
    # few windows are copied at a time, so that long records need little memory
    parts = np.array_split(windows, 1 + len(x) // 10_000)
    return np.concatenate([np.partition(part, rank, axis=1)[:, rank] for part in parts])


def find_spikes(u: Float[np.ndarray, " n"]) -> Int[np.ndarray, " spikes"]:
    """Samples of an input that are huge compared with all others, one or two in a row.

    Steps, pulses from rest and noise have none.
    """
    size = np.abs(u - np.median(u))
    ordered = np.sort(size)
    # a twentieth of the samples may be spikes
    first = len(u) - int(0.05 * len(u))
    below = ordered[first - 1 : -1]
    # a spike is a sample or two, this many times as far from the median as all that are none
    wide = np.flatnonzero((ordered[first:] > 30.0 * below) & (below > 0))
    if not len(wide):
        return np.zeros(0, int)
    spikes = np.flatnonzero(size >= ordered[first + wide[0]])
    runs = np.split(spikes, np.flatnonzero(np.diff(spikes) > 1) + 1)
    return spikes if max(map(len, runs)) <= 2 else np.zeros(0, int)
