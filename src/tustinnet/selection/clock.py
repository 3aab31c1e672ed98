"""The time that a selection may take."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.state import Progress
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.fitting.task import Task

_ENDS_EARLY = 0.5  # share of its epochs that a stage with `patience` is expected to take


class OutOfTime(Exception):
    """Time was up in the middle of a fit.

    Attributes:
        left: how much longer it would have taken [s], None where nobody knows.
    """

    def __init__(self, left: float | None) -> None:
        super().__init__(left)
        self.left = left


@dataclass(frozen=True)
class Clock:
    """When time is up.

    Attributes:
        end: `time.monotonic()` of that moment; None for never.
    """

    end: float | None = None

    @property
    def left(self) -> float:
        """Seconds until then."""
        return float("inf") if self.end is None else self.end - time.monotonic()

    def within(
        self, tell: Callable[[TrainingPlan | Task], Listener]
    ) -> Callable[[TrainingPlan | Task], Listener]:
        """The same listeners, which end a fit with `OutOfTime` when it cannot end in time."""
        if self.end is None:
            return tell

        def follow(prepared: TrainingPlan | Task) -> Listener:
            told = tell(prepared)
            watch = Watch(self, prepared) if isinstance(prepared, TrainingPlan) else None

            def state(of: Any, progress: Sequence[Progress]) -> None:
                told.on_state(of, progress)
                if watch is not None:
                    watch(progress)

            def iteration(of: Iteration) -> None:
                told.on_iteration(of)
                if self.left < 0:
                    raise OutOfTime(None)

            return replace(told, on_state=state, on_iteration=iteration)

        return follow


class Watch:
    """Foresees, after every compiled call, when a training ends; raises where that is too late.

    The first call of a stage compiles and says nothing of the time that the next ones take.

    Args:
        clock: when time is up.
        plan: the training.
    """

    def __init__(self, clock: Clock, plan: TrainingPlan) -> None:
        self._clock, self._stages = clock, plan.stages
        self._ended: tuple[int, int, float] | None = None  # stage, epochs, when the last call did

    def __call__(self, progress: Sequence[Progress]) -> None:
        """Told of every member's progress after a call.

        Raises:
            OutOfTime: the training cannot end in time.
        """
        slowest = min(progress, key=lambda p: (p.stage, p.epoch))
        now, before = time.monotonic(), self._ended
        self._ended = slowest.stage, slowest.epoch, now
        if before is None or before[0] != slowest.stage:
            return  # the next call says how long the rest takes, also where time is up
        epochs = slowest.epoch - before[1]
        left = (now - before[2]) / epochs * self._to_do(slowest) if epochs > 0 else 0.0
        if self._clock.left < left:
            raise OutOfTime(left or None)

    def _to_do(self, progress: Progress) -> float:
        """Epochs that are left, those of later stages in the time of this one's."""
        here = progress.stage
        work = [s.windows.rows.shape[1] * s.windows.length for s in self._stages]
        found = 0.0
        for i, stage in enumerate(self._stages[here:], here):
            epochs = stage.recipe.epochs - (progress.epoch if i == here else 0)
            share = 1.0 if stage.recipe.patience is None else _ENDS_EARLY
            found += share * epochs * work[i] / work[here]
        return found
