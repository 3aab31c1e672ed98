"""Properties of a column's numbers over all records: steps, levels, wraps, resolution."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.signals.encoder import encoder_count

Values = Float[np.ndarray, " _"]  # one column, of any length

_LEAST_LEVEL = 1 / 50  # of the range; usual change between levels

# counts of encoders in a turn that are sold, and four times as many where edges are counted
_TURNS = sorted(
    {
        *(
            edges * n
            for n in (
                100,
                120,
                125,
                128,
                144,
                180,
                200,
                250,
                256,
                300,
                360,
                400,
                500,
                512,
                600,
                720,
                800,
                900,
                1000,
                1024,
                1200,
                1250,
                1440,
                1500,
                1600,
                1800,
                2000,
                2048,
                2500,
                3000,
                3600,
                4000,
                4096,
                5000,
            )
            for edges in (1, 4)
        ),
        *(2**k for k in range(8, 25)),
    }
)


class ColumnLevels(NamedTuple):
    """Levels that decide on the kind of a column's numbers.

    All are set by hand, not measured.

    Attributes:
        changes: share of the samples; a column that changes less often is held at levels.
        smooth: change in a sample by the spread, up to which a column is smooth.
        white: change in a sample by the spread, from which on it is noise; that of white
            noise is the root of 2.
        often: share of the samples; a column that jumps more often does not wrap.
        supply: range over largest value, of a supply under load.
        fewest: values of a column that wraps.
    """

    changes: float = 0.2
    smooth: float = 0.3
    white: float = 0.9
    often: float = 0.2
    supply: float = 0.1
    fewest: int = 20


COLUMN = ColumnLevels()


@dataclass(frozen=True)
class Numbers:
    """Properties of the numbers in a column.

    Attributes:
        range: smallest and largest finite value, None without one.
        distinct: number of different values.
        lost: number of values that are not finite.
        whole: whether all values are integers.
        changes: share of the samples that differ from the one before.
        roughness: root mean square of the steps over the standard deviation.
        levels: whether it is constant most of the time and then changes far.
        wrap: length of a turn in the column's unit, where it jumps by turns.
        count: the step of which all its changes are multiples, None without one.
        largest_step: the largest change from one sample to the next.
    """

    range: tuple[float, float] | None
    distinct: int
    lost: int
    whole: bool = False
    changes: float = 0.0
    roughness: float = 0.0
    levels: bool = False
    wrap: float | None = None
    count: float | None = None
    largest_step: float = 0.0

    @property
    def constant(self) -> bool:
        """Whether the column never changes in a record."""
        return not self.changes

    @property
    def binary(self) -> bool:
        """Whether the column has two values only."""
        return self.distinct == 2

    @property
    def is_nearly_constant(self) -> bool:
        """Whether it stays within a tenth of its value, far from zero."""
        return (
            self.range is not None and self.range[1] - self.range[0] < COLUMN.supply * self.largest
        )

    @property
    def smooth(self) -> bool:
        """Whether it changes little from sample to sample, apart from wraps."""
        return not self.levels and (self.roughness <= COLUMN.smooth or self.wrap is not None)

    @property
    def is_white(self) -> bool:
        """Whether its steps are as large as those of white noise, nearly."""
        return not self.levels and self.wrap is None and self.roughness > COLUMN.white

    @property
    def largest(self) -> float:
        """Largest absolute value."""
        return max(map(abs, self.range)) if self.range else 0.0


@np.errstate(all="ignore")  # what is not finite or too large is counted and left out
def examine(pieces: Sequence[Values]) -> Numbers:
    """Examines the numbers of a column.

    Args:
        pieces: its samples, record by record.
    """
    everything = np.concatenate(pieces)
    finite = everything[np.isfinite(everything)]
    lost = len(everything) - len(finite)
    levels = np.unique(finite)
    extent = (float(levels[0]), float(levels[-1])) if len(levels) else None
    if len(levels) < 2:
        return Numbers(extent, len(levels), lost)
    steps = np.concatenate([np.diff(piece) for piece in pieces])
    steps = steps[np.isfinite(steps)]
    moving = np.abs(steps[steps != 0])
    if not len(moving):  # constant in every record
        return Numbers(extent, len(levels), lost, bool((levels == np.round(levels)).all()))
    changes = float(np.mean(steps != 0))
    has_levels = changes < COLUMN.changes and bool(
        np.median(moving) > _LEAST_LEVEL * np.ptp(levels)
    )
    return Numbers(
        range=extent,
        distinct=len(levels),
        lost=lost,
        whole=bool((levels == np.round(levels)).all()),
        changes=changes,
        roughness=float(np.sqrt(np.mean(steps**2)) / np.std(finite)),
        levels=has_levels,
        wrap=None if has_levels else _find_turn(steps, levels),
        count=encoder_count(finite),
        largest_step=float(moving.max()),
    )


def _find_turn(steps: Values, levels: Values) -> float | None:
    """The length of a turn, where a column jumps by nearly its range and else moves little."""
    extent = float(levels[-1] - levels[0])
    jumps = np.abs(steps) > extent / 2
    if not jumps.any() or jumps.mean() > COLUMN.often or len(levels) < COLUMN.fewest:
        return None
    others = np.abs(steps[~jumps]).max(initial=0.0)
    sizes = np.abs(steps[jumps])
    if others > 0.3 * extent:
        return None
    is_whole = bool((levels == np.round(levels)).all())
    counts = [*_TURNS, 2.0**32] if is_whole else [2 * np.pi, 1.0]
    for turn in (360.0, *counts):
        near = extent <= turn * (1 + 2e-3) and extent > 0.8 * turn
        # but for jumps over which samples are lost
        if near and np.quantile(np.abs(sizes - turn), 0.9) <= 1.5 * others + 1e-3 * turn:
            return float(turn)
    return None


def unwrap(piece: Values, turn: float | None) -> Values:
    """A record's column without the jumps by turns."""
    if turn is None:
        return piece
    turns = np.round(np.diff(piece, prepend=piece[:1]) / turn)
    return piece - turn * np.cumsum(turns)


def counts_in_turn(count: float, turn: float, tolerance: float = 2e-4) -> int | None:
    """Counts of an encoder in a turn, from the step of a column; None if no encoder has such.

    Args:
        count: the step.
        turn: a turn in the column's unit, 360 for degrees.
        tolerance: relative deviation.
    """
    counts = turn / count
    nearest = min(_TURNS, key=lambda n: abs(n - counts))
    return nearest if abs(counts / nearest - 1) < tolerance else None


def is_decimal(count: float) -> bool:
    """Whether a step is a power of ten, or twice or five times one: that of a rounded number."""
    power = 10.0 ** np.floor(np.log10(count) + 1e-9)
    return any(abs(count / (power * digit) - 1) < 1e-6 for digit in (1, 2, 2.5, 5, 10))


def is_power_of_ten(count: float) -> bool:
    """Whether a step is a power of ten: that to which a file rounds. Sensors have any others."""
    power = round(float(np.log10(count)))
    return abs(count / 10.0**power - 1) < 1e-6
