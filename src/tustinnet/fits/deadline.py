"""Deadlines: when computations have to end, and the time that they take."""

import time
from dataclasses import dataclass


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

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """A deadline some seconds from now; infinitely many for none."""
        return cls(None if seconds == float("inf") else time.monotonic() + seconds)

    def has_passed(self) -> bool:
        """Whether it is over."""
        return self.comes_within(0.0)

    def comes_within(self, seconds: float) -> bool:
        """Whether fewer seconds remain: the `should_stop` of a `Listener`."""
        return self.remaining < seconds


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
