"""From a plan to trained models."""

import time
from dataclasses import asdict

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.fitting.gradient.epoch import validation_rmse
from tustinnet.fitting.gradient.loop import Resumed, train
from tustinnet.fitting.gradient.material import free_runs
from tustinnet.fitting.gradient.plan import Plan, completed
from tustinnet.fitting.gradient.refinement import Refined, refined
from tustinnet.fitting.gradient.state import Progress
from tustinnet.fitting.listener import SILENT, Iteration, Listener
from tustinnet.fitting.report import FINISHED, FitResult
from tustinnet.models.contract import Model, with_dtype
from tustinnet.simulate.horizon import within
from tustinnet.simulate.starts import start_named

_FEW = 5  # epochs at the ends of a stage


def train_plan(
    prepared: Plan, listener: Listener = SILENT, resume: Resumed | None = None
) -> list[FitResult]:
    """Trains as planned, from the beginning or from a state that a listener was given.

    Returns:
        The members' models and how they came about. A training that diverged returns the best
        weights it had and says so in `outcome`.
    """
    best, progress = train(prepared, listener, resume)
    return [_result(prepared, best, m, p, listener) for m, p in enumerate(progress)]


def _result(
    prepared: Plan, best: Model, m: int, progress: Progress, listener: Listener
) -> FitResult:
    # off the devices that trained it: what comes now is one model's business
    trained = jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[m]), best)
    model, account, spent = completed(prepared, m, trained).folded(), None, 0.0
    if prepared.refine and progress.outcome == FINISHED:
        begun = time.perf_counter()
        model, account = _refined(prepared, model, m, listener)
        spent = time.perf_counter() - begun
        trained = with_dtype(model, np.float32)
    score = None
    if prepared.validation is not None:
        mine = prepared.chosen[m], prepared.counted[m]
        score = float(validation_rmse(trained, prepared.validation, *mine))
    details = {
        "windows": [s.windows.rows.shape[1] for s in prepared.stages],
        "window_lengths": [s.windows.length for s in prepared.stages],
        "epochs": list(progress.epochs),
        "kept_epoch": progress.best_epoch,
        **({"refined": asdict(account)} if account else {}),
    }
    return FitResult(
        model=model,
        recipe=prepared.recipe,
        member=prepared.members[m],
        outcome=progress.outcome,
        sound=progress.outcome == FINISHED,
        start=prepared.start,
        validation_rmse=score,
        seconds=progress.seconds + spent,
        details={"training": details},
        horizon=prepared.recipe.horizon,
        findings=(*ends(prepared, progress), *unrefined(account)),
    )


def _refined(prepared: Plan, model: Model, m: int, listener: Listener) -> tuple[Model, Refined]:
    """The member's model with its physics fitted to free runs of its training records."""
    recipe, member = prepared.recipe, prepared.members[m]
    records = prepared.task.folds[member.fold].roles.train
    horizon = within(recipe.horizon, records)
    runs = free_runs(model, records, start_named(prepared.start), horizon)

    def told(number: int, rmse: float, damping: float) -> None:
        stage = f"refining the physics of {member.name.replace('-', ' ')}"
        listener.iteration(Iteration(stage, number, rmse, damping))

    return refined(model, runs, told)


def unrefined(account: Refined | None) -> tuple[str, ...]:
    """What to say where the physics could not be refined."""
    if account is None or np.isfinite(account.before):
        return ()
    return (
        "the physics was not fitted once more: free runs of the training records leave the range "
        "of numbers; give the recipe a `horizon`, or set refine = false",
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
