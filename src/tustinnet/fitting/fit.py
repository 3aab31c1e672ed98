"""Fits of tasks: trainings, those that are alike together; identifications; least squares."""

from collections.abc import Sequence

from tustinnet.fitting.gradient.loop import ResumePoint
from tustinnet.fitting.gradient.plan import groups_alike, make_plan
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.identify import identify_task
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import SolvedRecipe, TrainingRecipe
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.solve import solve_task
from tustinnet.fitting.task import Member, Task
from tustinnet.simulate.programs import make_room


def fit_task(
    task: Task,
    listener: Listener = SILENT,
    resume: Sequence[tuple[Sequence[Member], ResumePoint]] = (),
) -> list[FitResult]:
    """Fits all members of a task; those that are alike train together.

    Args:
        task: what is to be fitted.
        listener: functions that are called while they go on.
        resume: members whose training goes on together, and from where; the others begin anew.

    Returns:
        One result for each member, in their order.

    Raises:
        InputError: see `tustinnet.fit`; also if an identification was stopped without a model.
    """
    make_room()
    if isinstance(task.recipe, SolvedRecipe):
        listener.on_begin(task)
        return [solve_task(task, task.recipe, member, listener) for member in task.members]
    if not isinstance(task.recipe, TrainingRecipe):
        listener.on_begin(task)
        return [identify_task(task, member, listener) for member in task.members]
    resumed = {member for members, _ in resume for member in members}
    fresh = [member for member in task.members if member not in resumed]
    groups: list[tuple[Sequence[Member], ResumePoint | None]] = [
        (group, None) for group in groups_alike(task.with_members(fresh))
    ]
    results: dict[Member, FitResult] = {}
    for members, state in [*groups, *resume]:
        plan = make_plan(task.with_members(members))
        listener.on_begin(plan)
        trained = train_plan(plan, listener, state)
        results.update(zip(members, trained, strict=True))
    return [results[member] for member in task.members]
