"""What a fit says at its end: what was done, how good it is, what to do next."""

import math
from pathlib import Path

import numpy as np

from tustinnet.evaluate.scores import Score, mean_rmse
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.report.progress import duration
from tustinnet.report.tables import number
from tustinnet.simulate.horizon import over
from tustinnet.store.run import MODEL, Run


def fit_summary(run: Run, data: str) -> tuple[str, ...]:
    """Sentences on a run whose records are those of `data`, as the user named it."""
    records = run.roles.train
    motion = sum(e.seconds for e in records)
    spent = sum(of.result.seconds for of in run.members)
    done = (
        f"fitted: {run.best.result.recipe.name}, to {len(records)} records with "
        f"{duration(motion)} of motion, in {duration(spent)}"
    )
    return done, f"how good: {_how_good(run)}", f"next: {next_steps(run.folder / MODEL, data)}"


def next_steps(model: Path, data: str) -> str:
    """What to do with a model: look for what it lacks, take it elsewhere."""
    return (
        f"tustinnet residuals {model} {data} (what it lacks), "
        f"tustinnet export {model} --to c --out model-c (take it elsewhere)"
    )


def _how_good(run: Run) -> str:
    """The error of the best model's free runs against what moves, and on which records."""
    scores, channels = run.best.scores, run.roles.train[0].channels
    sound = [s for s in scores if math.isfinite(s.rmse)]
    if not sound:
        return f"all free runs of {len(scores)} records diverge"
    shares = np.mean([s.nrmse for s in sound], axis=0)
    told = ", ".join(
        f"{100 * share:.0f} % of {c.name}'s"
        for c, share in zip(channels.coordinates, shares, strict=True)
    )
    diverged = f"; {len(scores) - len(sound)} diverge" if len(sound) < len(scores) else ""
    return (
        f"free runs{over(scores[0].horizon)} of {_which(run, sound)} are off by "
        f"{number(mean_rmse(sound))} {channels.unit} (mean RMSE): {told} "
        f"standard deviation{diverged}{_honest(run)}"
    )


def _which(run: Run, scores: list[Score]) -> str:
    return f"{len(scores)} {run.judging_split} record{'s' if len(scores) > 1 else ''}"


def _honest(run: Run) -> str:
    """What makes these records kinder to the model than others are."""
    if not run.roles.validation:
        return ". These records were fitted: tustinnet cross-validate judges on others"
    recipe = run.best.result.recipe
    if isinstance(recipe, TrainingRecipe) and any(s.keep != "last" for s in recipe.stages):
        return ". They chose the weights that are kept: on others it is somewhat worse"
    return ""
