"""Training of a plan: from initial weights to fit results."""

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.gradient.epoch import compute_validation_rmse
from tustinnet.fitting.gradient.loop import ResumePoint, train
from tustinnet.fitting.gradient.plan import TrainingPlan, restore_untrained
from tustinnet.fitting.gradient.state import Progress
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.report import FINISHED, FitResult
from tustinnet.models.contract import Model
from tustinnet.simulate.start_rules import start_named


def train_plan(
    plan: TrainingPlan,
    listener: Listener = SILENT,
    resume: ResumePoint | None = None,
) -> list[FitResult]:
    """Trains as planned, from the beginning or from a state that a listener was given.

    Args:
        plan: models, stages, records.
        listener: functions that are called while training goes on.
        resume: a state that a listener was given, to go on from there.

    Returns:
        The members' models and how they came about. A training that diverged or was stopped
        returns the best weights it had and says so in `outcome`.
    """
    for message in plan.messages:
        listener.on_message(message)
    best, progress = train(plan, listener, resume)
    results = []
    for m, p in enumerate(progress):
        # off the devices that trained it: what comes now is one model's business
        model = jax.tree.map(lambda a, m=m: jnp.asarray(np.asarray(a)[m]), best)
        physics = plan.recipe.family.without_correction(model)
        details = {
            "windows": [s.windows.rows.shape[1] for s in plan.stages],
            "window_lengths": [s.windows.length for s in plan.stages],
            "epochs": list(p.epochs),
            "kept_epoch": p.best_epoch,
        }
        results.append(
            FitResult(
                model=restore_untrained(plan, m, model).simplify(),
                recipe=plan.recipe,
                member=plan.members[m],
                outcome=p.outcome,
                sound=p.outcome == FINISHED,
                start=plan.start,
                validation_rmse=_validation_rmse(plan, m, model),
                physics_rmse=_validation_rmse(plan, m, physics),
                seconds=p.seconds,
                details={"training": details},
                horizon=plan.recipe.horizon,
                fewest_samples=start_named(plan.start).samples,
                findings=describe_kept_epoch(plan, p),
            )
        )
    return results


def _validation_rmse(plan: TrainingPlan, member: int, model: Model | None) -> float | None:
    """Mean free-run RMSE of the validation records of a member [rad or m], None without any."""
    runs = plan.validation_runs
    if runs is None or model is None:
        return None
    indices, counts = plan.run_indices[member], plan.run_counts[member]
    return float(compute_validation_rmse(model, runs, indices, counts))


def describe_kept_epoch(plan: TrainingPlan, progress: Progress) -> tuple[Finding, ...]:
    """A finding where the kept epoch is among the first or last few of the last stage.

    A few are a tenth of the epochs, at most 5. There is none for stages that are shorter.
    """
    if progress.outcome != FINISHED:
        return ()
    index, best_epoch, done = progress.stage, progress.best_epoch, progress.epoch
    recipe = plan.stages[index].recipe
    if recipe.keep == "last":
        return ()
    # epochs at the ends of a stage
    few = min(5, recipe.epochs // 10)
    criterion = "training loss" if plan.validation_runs is None else f"lowest `{recipe.keep}`"
    kept = {
        "epoch": best_epoch,
        "epochs": done,
        "stage": recipe.name,
        "index": index,
        "criterion": criterion,
    }
    if best_epoch > recipe.epochs - few:
        return (make_finding("still improving", **kept, longer=2 * recipe.epochs),)
    if best_epoch <= few:
        return (make_finding("worse after first", **kept, rate=recipe.rate / 3),)
    return ()
