"""Progress of fits: bars on a terminal, a line now and then elsewhere."""

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, TextColumn
from rich.progress import Task as Bar
from rich.text import Text

from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.listener import EpochReport, Listener, SearchProgress
from tustinnet.fitting.task import Task
from tustinnet.report.tables import number

_LINE_EVERY = 15.0  # seconds between two lines where there is no terminal
_SEARCH_LINE_EVERY = 5.0  # seconds between two lines of a stage of an identification
_COMPILING = "compiling"


class FitProgress(AbstractContextManager["FitProgress"]):
    """Shows the progress of the fits within the context.

    It shows loss, validation RMSE, learning rate and remaining time of trainings; stage,
    iteration and cost of identifications.

    Args:
        console: output; a terminal gets bars, a file or pipe plain lines.
        quiet: show only events such as a return to the last good state.
    """

    def __init__(self, console: Console, *, quiet: bool = False) -> None:
        self._console, self._quiet = console, quiet
        self._messages = set[str]()  # that were printed
        self._bars = Progress(
            TextColumn("{task.description}"),
            # a terminal of 110 columns leaves room for a longer bar
            BarColumn(bar_width=20 if console.width >= 110 else 4),
            _Figures(),
            console=console,
            disable=quiet or not console.is_terminal,
        )

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def listener(self, label: str = "") -> Listener:
        """Makes a listener that shows fits, one after the other.

        Args:
            label: name of the fits; by default that of their recipe.
        """
        shown: Callable[[Any], None]
        has_lines = self._bars.disable and not self._quiet

        def on_begin(prepared: TrainingPlan | Task) -> None:
            nonlocal shown
            if isinstance(prepared, TrainingPlan):
                shown = _Trainings(self._bars, has_lines, prepared, label)
            else:
                name = label or prepared.recipe.name
                shown = _Identification(self._bars, has_lines, name)

        return Listener(
            on_begin=on_begin,
            on_epoch=lambda report: shown(report),
            on_progress=lambda progress: shown(progress),
            on_message=self._print_once,
        )

    def _print_once(self, message: str) -> None:
        """Prints a message of a fit, unless another fit had the same: folds have records alike."""
        if not self._quiet and message not in self._messages:
            self._messages.add(message)
            self._console.print(message)


class _Figures(ProgressColumn):
    """Column with the figures of a fit, and its duration while it compiles or has no known end."""

    def render(self, task: Bar) -> Text:
        figures = task.fields["figures"]
        is_timed = figures == _COMPILING or task.total is None
        return Text(f"{figures}, {task.elapsed or 0:.0f} s" if is_timed else figures)


class _Identification:
    """Progress of an identification: a changing line on a terminal.

    Elsewhere a line where a stage begins, and every few seconds while it goes on.
    """

    def __init__(self, bars: Progress, has_lines: bool, label: str) -> None:
        self._bars, self._has_lines, self._label = bars, has_lines, label
        self._stage, self._begin = ("", 0), time.monotonic()
        self._last = self._begin
        self._task = bars.add_task(label, total=None, figures=_COMPILING)

    def __call__(self, progress: SearchProgress) -> None:
        figures = f"{progress.stage}, iteration {progress.iteration}, cost {progress.cost:.4g}"
        if progress.number:
            figures = f"stage {progress.number} of {progress.stages}, {figures}"
        self._bars.update(self._task, figures=figures)
        stage, now = (progress.stage, progress.number), time.monotonic()
        is_soon = stage == self._stage and now - self._last < _SEARCH_LINE_EVERY
        if is_soon or not self._has_lines:
            return
        self._stage, self._last = stage, now
        line = f"{self._label}: {figures}, {duration(now - self._begin)}"
        self._bars.console.print(line, highlight=False, soft_wrap=True)


class _Trainings:
    """Progress of trainings that run together: a bar on a terminal, a line now and then elsewhere.

    The bar shows the progress of the slowest training and the score of the best one.
    """

    def __init__(self, bars: Progress, has_lines: bool, plan: TrainingPlan, label: str) -> None:
        self._bars, self._has_lines = bars, has_lines
        # work before each stage: in steps of windows, and in epochs
        self._before, self._total, self._epochs_before, self._epochs = {}, 0, {}, 0
        self._work = {
            s.recipe.name: s.windows.rows.shape[1] * s.windows.length for s in plan.stages
        }
        for stage in plan.stages:
            name = stage.recipe.name
            self._before[name], self._epochs_before[name] = self._total, self._epochs
            self._total += stage.recipe.epochs * self._work[name]
            self._epochs += stage.recipe.epochs
        title = label or plan.recipe.name
        # a label names the fold
        members = [replace(m, fold=0) if label else m for m in plan.members]
        self._names = [f"{title}, {m.name.replace('-', ' ')}" for m in members]
        self._more = f" and {len(self._names) - 1} more" if len(self._names) > 1 else ""
        self._name = self._names[0] + self._more
        self._task = bars.add_task(self._name, total=self._total, figures=_COMPILING)
        self._last = time.monotonic()
        self._compiling = 0.0  # seconds, of the last stage that was compiled
        self._scale = max(float(e.q.std(axis=0).max()) for e in plan.task.folds[0].roles.train)
        self._progress = [0] * len(self._names)
        self._lowest = [math.inf] * len(self._names)

    def __call__(self, report: EpochReport) -> None:
        stage, m = report.stage, report.member
        if report.event:
            self._bars.console.print(f"{self._names[m]}: {report.event}", highlight=False)
        self._progress[m] = self._before[stage] + report.epoch * self._work[stage]
        self._lowest[m] = report.best
        done = min(self._progress)
        now = time.monotonic()
        # the pace of this call; stages to come are compiled like the last one
        self._compiling = report.compiling or self._compiling
        remaining = ""
        if done < self._total and report.seconds:
            stages = sum(before > self._before[stage] for before in self._before.values())
            seconds = (self._total - done) / self._work[stage] * report.seconds
            remaining = f", {duration(seconds + stages * self._compiling)} left"
        epoch = self._epochs_before[stage] + report.epoch
        # three digits of a tenth of the motion
        rmse, lowest = (
            number(v, scale=self._scale / 10) for v in (report.validation, min(self._lowest))
        )
        best = f"best {lowest} " if self._more else ""
        figures = (
            f"{epoch}/{self._epochs} loss {report.loss:.3g} rmse {rmse} {best}"
            f"rate {report.rate:.1e}{remaining}"
        )
        self._bars.update(self._task, completed=done, figures=figures)
        is_soon = now - self._last < _LINE_EVERY and done < self._total
        if is_soon or not self._has_lines:
            return
        self._last = now
        self._bars.console.print(
            f"{self._name}: {100 * done / self._total:.0f} %, {figures}",
            highlight=False,
            soft_wrap=True,
        )


def duration(seconds: float) -> str:
    """Text of a duration: seconds, minutes or hours, to about two digits."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    if seconds < 6000:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
