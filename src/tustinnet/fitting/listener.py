"""Listeners: functions that are called while a fit goes on, and the reports that they get."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from tustinnet.shown import Brief


@dataclass(frozen=True)
class EpochReport:
    """The figures of an epoch of a member.

    Attributes:
        stage: the stage's name.
        epoch: its number in the stage, from 1.
        loss: mean training loss.
        validation: mean free-run RMSE over the validation records [rad or m], NaN without them.
        rate: the rate that was used.
        best: the lowest figure of the stage so far.
        event: a sentence when something happened, else empty.
        member: which of those that train together.
        seconds: what an epoch of all members took in this compiled call, without compiling.
        compiling: seconds until the call began to compute.
    """

    stage: str
    epoch: int
    loss: float
    validation: float
    rate: float
    best: float
    event: str = ""
    member: int = 0
    seconds: float = field(default=0.0, compare=False)
    compiling: float = field(default=0.0, compare=False)


@dataclass(frozen=True)
class Iteration:
    """An iteration of an identification.

    Attributes:
        stage: what it is doing.
        number: iterations so far in the stage.
        cost: sum over records of the mean squared residual; of a refinement their mean RMSE.
        damping: Levenberg-Marquardt's.
        initial: how initial states are treated, empty where nothing is simulated.
    """

    stage: str
    number: int
    cost: float
    damping: float
    initial: str = ""


@dataclass(frozen=True)
class SearchProgress:
    """The progress of an identification, after every simulation of its segments.

    Attributes:
        stage: what it is doing.
        number: of the stage, from 1; 0 of a step that is not counted, as the choice of terms.
        stages: how many stages there are, 0 while that is not known.
        iteration: iterations of the stage so far.
        cost: the lowest so far in the stage, see `Iteration`.
    """

    stage: str
    number: int
    stages: int
    iteration: int
    cost: float


@dataclass(frozen=True)
class StageResult:
    """The result of a stage of an identification.

    Attributes:
        stage: what it was doing.
        initial: how initial states were treated, empty where nothing was simulated.
        iterations: how many it took.
        cost: at its end; infinite where it diverged.
        why: `converged`, `stalled`, `limit`, `diverged`, or `stopped` at a time limit.
        parameters: the values at its end by name, those fixed included.
    """

    stage: str
    initial: str
    iterations: int
    cost: float
    why: str
    parameters: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class Listener(Brief):
    """Functions that are called while a fit goes on; each call may be slow.

    Attributes:
        on_begin: before fits that run together begin, with the plan of a training, whose records
            are then known to fit the recipe, or with the task of an identification.
        on_epoch: with every epoch of every member.
        on_state: with a training's state and the members' progress, after every compiled call,
            which does several epochs, and at the ends of stages: all that a resumed run needs.
        on_iteration: with every iteration of an identification.
        on_message: with a sentence on what is unusual.
        on_stage: with every stage of an identification, at its end.
        on_progress: with the progress of an identification, several times an iteration.
        should_stop: before every step, with the seconds that it will take as far as the one before
            says, else 0: whether the fit ends, as at a time limit.
    """

    on_begin: Callable[[Any], None] = field(default=lambda prepared: None)
    on_epoch: Callable[[EpochReport], None] = field(default=lambda report: None)
    on_state: Callable[[Any, Any], None] = field(default=lambda state, progress: None)
    on_iteration: Callable[[Iteration], None] = field(default=lambda iteration: None)
    on_message: Callable[[str], None] = field(default=lambda message: None)
    on_stage: Callable[[StageResult], None] = field(default=lambda result: None)
    on_progress: Callable[[SearchProgress], None] = field(default=lambda progress: None)
    should_stop: Callable[[float], bool] = field(default=lambda seconds: False)


SILENT = Listener()  # does nothing
