"""The sentences at the end of a fit: what was fitted, and how good it is."""

import math

import numpy as np

from tustinnet.evaluate.scores import mean_rmse_by_unit
from tustinnet.fits.run import Run
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.report.progress import duration
from tustinnet.report.tables import amounts
from tustinnet.simulate.horizon import horizon_words
from tustinnet.wording import counted, percent


def fit_summary(run: Run) -> tuple[str, ...]:
    """Sentences on a run: what was fitted, and how good it is."""
    records = run.roles.train
    motion = sum(e.seconds for e in records)
    return (
        f"fitted: {run.best.result.recipe.name}, to {counted(len(records), 'record')} with "
        f"{duration(motion)} of motion, in {duration(run.seconds)}",
        f"how good: {_describe_accuracy(run)}",
    )


def time_sentence(total: float, fitting: float, preparation: float) -> str:
    """Sentence on the time that a command took, and for what.

    Args:
        total: time of the command [s].
        fitting: time of the fits [s].
        preparation: time of the preparation of the records [s]: holds, delays, parts left out.
    """
    parts = {
        "the fit": fitting,
        "preparation of the records": preparation,
        "scores, figures and the rest": total - fitting - preparation,
    }
    # parts of a command that took a second
    listed = ", ".join(f"{what} {duration(x)}" for what, x in parts.items() if x >= 1.0)
    return f"time: {duration(total)}" + (f" ({listed})" if listed else "")


def _describe_accuracy(run: Run) -> str:
    """Describes the error of the best model's free runs, and whether it is optimistic."""
    scores, channels = run.best.scores, run.roles.train[0].channels
    finite = [s for s in scores if math.isfinite(s.rmse)]
    if not finite:
        return f"all free runs of {counted(len(scores), 'record')} diverge"
    reference = run.reference
    nrmse = np.mean([s.nrmse for s in finite], axis=0)
    shares = ", ".join(
        f"{percent(share)} % of {c.name}'s"
        for c, share in zip(channels.coordinates, nrmse, strict=True)
    )
    if len(nrmse) > 3:  # no room for all: the largest says what is wrong
        worst = channels.coordinates[int(np.argmax(nrmse))].name
        shares = f"{percent(nrmse.min())} to {percent(nrmse.max())} %, most of {worst}'s,"
    diverged = f"; {len(scores) - len(finite)} diverge" if len(finite) < len(scores) else ""
    recipe = run.best.result.recipe
    restarted = horizon_words(scores[0].horizon)
    remark = ""
    if not run.roles.validation:
        remark = (
            ". This is optimistic: the model was fitted to these records. "
            "tustinnet cross-validate scores it on others"
        )
    elif isinstance(recipe, TrainingRecipe) and any(s.keep != "last" for s in recipe.stages):
        remark = ". This is slightly optimistic: the kept weights were chosen by these records"
    return (
        f"free runs of {len(finite)} {run.judging_split} "
        f"record{'s' if len(finite) > 1 else ''}{restarted and f'{restarted},'} are off by "
        f"{amounts(mean_rmse_by_unit(finite, channels))} (mean RMSE): {shares} "
        f"standard deviation; {reference.label} is off by {amounts(reference.mean_by_unit)}"
        f"{diverged}{'' if run.follows else f'; it follows them no better than {reference.label}'}"
        f"{remark}"
    )
