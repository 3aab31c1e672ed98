"""Training as it goes on: a bar on a terminal, a line now and then elsewhere."""

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.status import Status

from tustinnet.identification.least_squares import Iteration
from tustinnet.training.plan import Plan
from tustinnet.training.state import EpochReport

_WIDE = 110  # columns of a terminal that leave room for a longer bar
_LINE_EVERY = 15.0  # seconds between two lines where there is no terminal


class IdentificationProgress(AbstractContextManager["IdentificationProgress"]):
    """Shows stage, iteration and residual of an identification.

    Args:
        console: where to; a terminal gets a line that changes while the context is open, a file
            or pipe, or a terminal that shows something else, a line a stage.
        quiet: show nothing.
        label: what is being identified.
    """

    def __init__(self, console: Console, *, quiet: bool = False, label: str = "") -> None:
        self._console, self._quiet, self._label = console, quiet, label and f"{label}: "
        self._status: Status | None = None
        self._stage = ""

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._quiet:
            self._status = self._console.status(f"{self._label}compiling")
            self._status.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._status:
            self._status.stop()

    def told(self, iteration: Iteration) -> None:
        """Who is to be told of every iteration."""
        line = (
            f"{self._label}{iteration.stage}, iteration {iteration.number}, "
            f"cost {iteration.cost:.4g}"
        )
        if self._status:
            self._status.update(line)
        elif not self._quiet and iteration.stage != self._stage:
            self._console.print(line, highlight=False, soft_wrap=True)
        self._stage = iteration.stage


class TrainingProgress(AbstractContextManager["TrainingProgress"]):
    """Shows loss, validation RMSE, rate and time left of the trainings within the context.

    Args:
        console: where to; a terminal gets a bar, a file or pipe gets plain lines.
        quiet: show only events such as a return to the last good state.
    """

    def __init__(self, console: Console, *, quiet: bool = False) -> None:
        self._console, self._quiet = console, quiet
        self._bars: Progress | None = None
        if console.is_terminal and not quiet:
            self._bars = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=20 if console.width >= _WIDE else 4),
                TextColumn("{task.fields[figures]}"),
                TimeRemainingColumn(compact=True),
                console=console,
            )

    def __enter__(self) -> Self:
        if self._bars:
            self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bars:
            self._bars.stop()

    def follow(self, plan: Plan, label: str = "") -> Callable[[EpochReport], None]:
        """Who is to be told of every epoch of trainings that run together."""
        work = {s.recipe.name: s.windows.rows.shape[1] * s.windows.length for s in plan.stages}
        before, total, epochs_before, epochs = {}, 0, {}, 0
        for stage in plan.stages:
            before[stage.recipe.name], epochs_before[stage.recipe.name] = total, epochs
            total += stage.recipe.epochs * work[stage.recipe.name]
            epochs += stage.recipe.epochs
        names = [f"{label or plan.recipe.name}, {m.name.replace('-', ' ')}" for m in plan.members]
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        name = names[0] + more
        task = self._bars.add_task(name, total=total, figures="compiling") if self._bars else None
        begun = last = time.monotonic()
        first: int | None = None
        # of several that run together the slowest says what is done, the best one how well
        reached = [0] * len(names)
        lowest = [math.inf] * len(names)

        def told(report: EpochReport) -> None:
            nonlocal last, first
            if report.event:
                self._console.print(f"{names[report.member]}: {report.event}", highlight=False)
            reached[report.member] = before[report.stage] + report.epoch * work[report.stage]
            lowest[report.member] = report.best
            done = min(reached)
            first = done if first is None else first
            epoch = epochs_before[report.stage] + report.epoch
            best = f"best {min(lowest):.3f} " if more else ""
            figures = (
                f"{epoch}/{epochs} loss {report.loss:.3g} rmse {report.validation:.3f} {best}"
                f"rate {report.rate:.1e}"
            )
            if self._bars and task is not None:
                self._bars.update(task, completed=done, description=name, figures=figures)
                return
            now = time.monotonic()
            if self._quiet or (now - last < _LINE_EVERY and done < total):
                return
            last = now
            left = (now - begun) * (total - done) / max(done - first, 1) if done > first else 0.0
            self._console.print(
                f"{name}: {100 * done / total:.0f} %, {figures}, {left:.0f} s left",
                highlight=False, soft_wrap=True,
            )  # fmt: skip

        return told
