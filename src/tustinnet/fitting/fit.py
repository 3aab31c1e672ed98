"""Fits of tasks: trainings, those that are alike together; identifications; least squares."""

from collections.abc import Callable, Sequence

from tustinnet.fitting.gradient.loop import ResumePoint, ShouldStop, never_stop
from tustinnet.fitting.gradient.plan import TrainingPlan, groups_alike, make_plan
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.identify import identify_task
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import SolvedRecipe, TrainingRecipe
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.fitting.solve import solve_task
from tustinnet.fitting.task import Member, Task
from tustinnet.simulate.programs import make_room

MakeListener = Callable[[TrainingPlan | Task], Listener]
MakeStopCheck = Callable[[TrainingPlan], ShouldStop]


def fit_task(
    task: Task,
    make_listener: MakeListener = lambda _: SILENT,
    resume: Sequence[tuple[Sequence[Member], ResumePoint]] = (),
    make_stop_check: MakeStopCheck = lambda _: never_stop,
    should_stop_search: ShouldStopSearch = never_stop_search,
) -> list[FitResult]:
    """Fits all members of a task; those that are alike train together.

    Args:
        task: what is to be fitted.
        make_listener: returns the listener of fits that run together; called before they begin
            with the plan of a training, whose records are then known to fit the recipe, or with
            the task of an identification.
        resume: members whose training goes on together, and from where; the others begin anew.
        make_stop_check: given the plan of trainings that run together, returns the `should_stop`
            of `train_plan`.
        should_stop_search: the `should_stop` of `identify_task`.

    Returns:
        One result for each member, in their order.

    Raises:
        InputError: see `tustinnet.fit`; also if an identification was stopped without a model.
    """
    make_room()
    if isinstance(task.recipe, SolvedRecipe):
        recipe, listener = task.recipe, make_listener(task)
        return [
            solve_task(task, recipe, member, listener, should_stop_search)
            for member in task.members
        ]
    if not isinstance(task.recipe, TrainingRecipe):
        listener = make_listener(task)
        return [
            identify_task(task, member, listener, should_stop_search) for member in task.members
        ]
    resumed = {member for members, _ in resume for member in members}
    fresh = [member for member in task.members if member not in resumed]
    groups: list[tuple[Sequence[Member], ResumePoint | None]] = [
        (group, None) for group in groups_alike(task.with_members(fresh))
    ]
    results: dict[Member, FitResult] = {}
    for members, state in [*groups, *resume]:
        plan = make_plan(task.with_members(members))
        trained = train_plan(plan, make_listener(plan), state, make_stop_check(plan))
        results.update(zip(members, trained, strict=True))
    return [results[member] for member in task.members]
