"""The deadline of a selection, and the decision to stop a training for it."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.state import Progress

_ENDS_EARLY = 0.5  # share of its epochs that a stage with `patience` is expected to take


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

    @classmethod
    def after(cls, seconds: float) -> "Deadline":
        """A deadline some seconds from now; infinitely many for none."""
        return cls(None if seconds == float("inf") else time.monotonic() + seconds)

    def has_passed(self) -> bool:
        """Whether it is over: the `should_stop` of an identification."""
        return self.remaining < 0


NEVER = Deadline()


class StopCheck:
    """Decides after every compiled call whether a training stops, from the pace of its epochs.

    It stops before a call that would end after the deadline. The first call of a stage compiles
    and says nothing of the time that the next ones take.

    Args:
        deadline: when the training has to end.
        plan: the training.

    Attributes:
        needed: seconds that the rest would have taken, None where the training was not stopped,
            or the pace is not known.
    """

    def __init__(self, deadline: Deadline, plan: TrainingPlan) -> None:
        self.needed: float | None = None
        self._deadline, self._stages = deadline, plan.stages
        self._last: tuple[int, int, float] | None = None  # stage, epochs, when the last call ended

    def __call__(self, progress: Sequence[Progress]) -> bool:
        """Whether to stop, given every member's progress after a call."""
        slowest = min(progress, key=lambda p: (p.stage, p.epoch))
        now, before = time.monotonic(), self._last
        self._last = slowest.stage, slowest.epoch, now
        remaining = self._deadline.remaining
        if before is None or before[0] != slowest.stage:
            return remaining < 0
        epochs, call = slowest.epoch - before[1], now - before[2]
        if epochs <= 0 or remaining >= call:
            return remaining < 0
        self.needed = call / epochs * self._remaining_epochs(slowest)
        return True

    def _remaining_epochs(self, progress: Progress) -> float:
        """Epochs to do, those of later stages in the time of this one's."""
        here = progress.stage
        work = [s.windows.rows.shape[1] * s.windows.length for s in self._stages]
        total = 0.0
        for i, stage in enumerate(self._stages[here:], here):
            epochs = stage.recipe.epochs - (progress.epoch if i == here else 0)
            share = 1.0 if stage.recipe.patience is None else _ENDS_EARLY
            total += share * epochs * work[i] / work[here]
        return total
