"""Deadlines: when computations have to end, and whether a training stops in time for that."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from tustinnet.fitting.gradient.state import Progress


@dataclass(frozen=True)
class Deadline:
    """A moment when computations have to end.

    Attributes:
        end: `time.monotonic()` of that moment; None for never.
    """

    end: float | None = None

    @property
    def remaining(self) -> float:
        """Seconds until then; infinite without an end."""
        return float("inf") if self.end is None else self.end - time.monotonic()

    def at_most(self, seconds: float) -> "Deadline":
        """The earlier of this deadline and one some seconds from now."""
        return min(self, Deadline.after(seconds), key=lambda deadline: deadline.remaining)

    def earlier_by(self, seconds: float) -> "Deadline":
        """The moment some seconds before this one."""
        return self if self.end is None else Deadline(self.end - seconds)

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """A deadline some seconds from now; infinitely many for none."""
        return cls(None if seconds == float("inf") else time.monotonic() + seconds)

    def has_passed(self) -> bool:
        """Whether it is over: the `should_stop` of an identification."""
        return self.remaining < 0


NEVER = Deadline()
OVER = Deadline(0.0)


class Stopwatch:
    """The time that each part of a run takes.

    Args:
        begin: `time.monotonic()` of the beginning.

    Attributes:
        seconds: of each part, in the order in which they came.
    """

    def __init__(self, begin: float) -> None:
        self._last = begin
        self.seconds: dict[str, float] = {}

    def end(self, part: str) -> None:
        """Adds the time since the last part ended to a part."""
        now = time.monotonic()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - self._last
        self._last = now


class StopCheck:
    """Decides after every compiled call whether a training stops: before one that ends too late.

    The first call of a stage compiles and says nothing of the time that the next ones take.

    Args:
        deadline: when the training has to end.
    """

    def __init__(self, deadline: Deadline) -> None:
        self._deadline = deadline
        self._last: tuple[int, float] | None = None  # stage, and when the last call ended

    def __call__(self, progress: Sequence[Progress]) -> bool:
        """Whether to stop, given every member's progress after a call."""
        stage, now, before = min(p.stage for p in progress), time.monotonic(), self._last
        self._last = stage, now
        call = 0.0 if before is None or before[0] != stage else now - before[1]
        return self._deadline.remaining < call
