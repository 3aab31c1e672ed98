"""Fits of models that least squares find: from the task of a fit to its result."""

import time

from tustinnet.families.family import SolvedRecords
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.recipe import SolvedRecipe
from tustinnet.fitting.report import FINISHED, OUT_OF_TIME, FitResult
from tustinnet.fitting.task import Member, Task
from tustinnet.simulate.horizon import horizon_samples
from tustinnet.simulate.starts import default_start, start_named


def solve_task(
    task: Task,
    recipe: SolvedRecipe,
    member: Member,
    listener: Listener,
) -> FitResult:
    """Finds the model of a member's fold.

    Args:
        task: what is to be fitted.
        recipe: its recipe.
        member: one of its members.
        listener: gets sentences on what is unusual, and ends the search early.

    Raises:
        InputError: records that the kind of model cannot be fitted to.
    """
    began, fold = time.perf_counter(), task.folds[member.fold]
    start_name = recipe.start or default_start(list(fold.roles.all))
    start = start_named(start_name)
    roles = fold.roles.with_long_validation(start.samples, listener.on_message)
    horizon_samples(recipe.horizon, roles.all, start, f"recipe '{recipe.name}', horizon")
    records = SolvedRecords(roles.train, roles.validation, recipe.velocity, recipe.horizon)
    origin = None if fold.origin is None else fold.origin.model
    model, is_complete = recipe.family.solve(
        recipe.model, records, origin, lambda: listener.should_stop(0.0)
    )
    outcome = FINISHED if is_complete else f"{OUT_OF_TIME}: its best stage so far was taken"
    return FitResult(
        model=model,
        recipe=recipe,
        member=member,
        outcome=outcome,
        sound=is_complete,
        start=start_name,
        validation_rmse=None,
        seconds=time.perf_counter() - began,
        details={"least-squares": {}},
        horizon=recipe.horizon,
        fewest_samples=start.samples,
    )
