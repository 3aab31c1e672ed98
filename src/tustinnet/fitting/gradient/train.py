"""From a plan to trained models."""

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.fitting.gradient.epoch import validation_rmse
from tustinnet.fitting.gradient.loop import Resumed, ShouldStop, never_stop, train
from tustinnet.fitting.gradient.plan import Plan, completed
from tustinnet.fitting.gradient.state import Progress
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.report import FINISHED, FitResult
from tustinnet.models.contract import Model

_FEW = 5  # epochs at the ends of a stage


def train_plan(
    prepared: Plan,
    listener: Listener = SILENT,
    resume: Resumed | None = None,
    should_stop: ShouldStop = never_stop,
) -> list[FitResult]:
    """Trains as planned, from the beginning or from a state that a listener was given.

    Args:
        prepared: models, stages, records.
        listener: functions that are called while training goes on.
        resume: a state that a listener was given, to go on from there.
        should_stop: asked after every compiled call whether to stop, as for a deadline.

    Returns:
        The members' models and how they came about. A training that diverged or was stopped
        returns the best weights it had and says so in `outcome`.
    """
    best, progress = train(prepared, listener, resume, should_stop)
    return [_result(prepared, best, m, p) for m, p in enumerate(progress)]


def _result(prepared: Plan, best: Model, m: int, progress: Progress) -> FitResult:
    # off the devices that trained it: what comes now is one model's business
    model = jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[m]), best)
    score = None
    if prepared.validation is not None:
        mine = prepared.chosen[m], prepared.counted[m]
        score = float(validation_rmse(model, prepared.validation, *mine))
    details = {
        "windows": [s.windows.rows.shape[1] for s in prepared.stages],
        "window_lengths": [s.windows.length for s in prepared.stages],
        "epochs": list(progress.epochs),
        "kept_epoch": progress.best_epoch,
    }
    return FitResult(
        model=completed(prepared, m, model).folded(),
        recipe=prepared.recipe,
        member=prepared.members[m],
        outcome=progress.outcome,
        sound=progress.outcome == FINISHED,
        start=prepared.start,
        validation_rmse=score,
        seconds=progress.seconds,
        details={"training": details},
        horizon=prepared.recipe.horizon,
        findings=ends(prepared, progress),
    )


def ends(prepared: Plan, progress: Progress) -> tuple[str, ...]:
    """What to say where the kept epoch is among the first or last few of the last stage.

    A few are a tenth of the epochs, at most 5. Of stages that are shorter nothing is said.
    """
    if progress.outcome != FINISHED:
        return ()
    index, kept, done = progress.stage, progress.best_epoch, progress.epoch
    recipe = prepared.stages[index].recipe
    if recipe.keep == "last":
        return ()
    few = min(_FEW, recipe.epochs // 10)
    judge = "training loss" if prepared.validation is None else f"lowest `{recipe.keep}`"
    at = f"epoch {kept} of {done} of stage '{recipe.name}' was kept ({judge})"
    if kept > recipe.epochs - few:
        return (
            f"{at}, one of the last: it was still improving; train longer: --set "
            f"stages.{index}.epochs={2 * recipe.epochs}",
        )
    if kept <= few:
        return (
            f"{at}, one of the first: what followed was worse; train more carefully: --set "
            f"stages.*.rate={recipe.rate / 3:.1g}",
        )
    return ()
