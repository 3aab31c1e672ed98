"""The time that a selection may take."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from tustinnet.fitting.gradient.plan import Plan
from tustinnet.fitting.listener import EpochReport, Iteration, Listener
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

    def within(self, tell: Callable[[Plan | Task], Listener]) -> Callable[[Plan | Task], Listener]:
        """The same listeners, which end a fit with `OutOfTime` when it cannot end in time."""
        if self.end is None:
            return tell

        def follow(prepared: Plan | Task) -> Listener:
            told = tell(prepared)
            watch = _Watch(self, prepared if isinstance(prepared, Plan) else None)

            def epoch(report: EpochReport) -> None:
                told.epoch(report)
                watch.epoch(report)

            def iteration(of: Iteration) -> None:
                told.iteration(of)
                if self.left < 0:
                    raise OutOfTime(None)

            return replace(told, epoch=epoch, iteration=iteration)

        return follow


class _Watch:
    """Foresees when a training ends, from the time of its compiled calls."""

    def __init__(self, clock: Clock, plan: Plan | None) -> None:
        self._clock, self._stages = clock, plan.stages if plan else ()
        self._members = len(plan.members) if plan else 1
        self._heard: float | None = None  # when the first call of the stage had ended
        self._first = 0  # how many epochs it did
        self._stage = ""

    def epoch(self, report: EpochReport) -> None:
        """Told of every epoch; those of one call come together."""
        now = time.monotonic()
        if report.stage != self._stage:
            self._stage, self._heard, self._first = report.stage, None, 0
        if self._heard is None or now - self._heard < _APART:
            self._heard, self._first = self._heard or now, report.epoch
            left = None
        else:
            rate = (now - self._heard) / max(report.epoch - self._first, 1)
            left = rate * self._to_do(report)
        if self._clock.left < (left or 0.0):
            raise OutOfTime(left)

    def _to_do(self, report: EpochReport) -> float:
        """Epochs that are left, those of later stages in the time of this one's."""
        names = [stage.recipe.name for stage in self._stages]
        here = names.index(report.stage)
        work = [s.windows.rows.shape[1] * s.windows.length for s in self._stages]
        found = 0.0
        for i, stage in enumerate(self._stages[here:], here):
            epochs = stage.recipe.epochs - (report.epoch if i == here else 0)
            share = 1.0 if stage.recipe.patience is None else _ENDS_EARLY
            found += share * epochs * work[i] / work[here]
        return found


_APART = 0.05  # seconds; epochs of one compiled call are reported closer together
