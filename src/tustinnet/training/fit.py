"""From a data set and a recipe to a trained model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel
from tustinnet.models.hybrid import HybridModel
from tustinnet.training.epoch import validation_rmse
from tustinnet.training.loop import FINISHED, train
from tustinnet.training.plan import Member, Plan, plan
from tustinnet.training.recipe import Recipe
from tustinnet.training.state import SILENT, Listener, Progress, TrainingState

DEFAULT_RECIPE = "standard"


@dataclass(frozen=True)
class FitResult:
    """A trained model and how it came about.

    Attributes:
        model: the model with the best weights, folded.
        recipe: what was done.
        member: the seed, and what the recipe's rates were multiplied by.
        outcome: `finished`, or a sentence on why training ended early.
        start: where the validation free runs started.
        validation_rmse: mean free-run RMSE over the validation records [rad or m], or None.
        train_seconds: time spent, compilation included; of trainings that ran together an equal
            share.
        windows: windows in each stage.
        window_lengths: steps in a window of each stage.
        epochs: epochs done in each stage.
        kept_epoch: the epoch of the last stage whose weights the model has, 0 for none.
    """

    model: DiscreteModel
    recipe: Recipe
    member: Member
    outcome: str
    start: str
    validation_rmse: float | None
    train_seconds: float
    windows: tuple[int, ...]
    window_lengths: tuple[int, ...]
    epochs: tuple[int, ...]
    kept_epoch: int

    @property
    def seed(self) -> int:
        """The seed."""
        return self.member.seed

    @property
    def finished(self) -> bool:
        """Whether all stages ran to their end."""
        return self.outcome == FINISHED


def fit(
    data: DataSet,
    recipe: Recipe | str | Path = DEFAULT_RECIPE,
    seed: int = 0,
    listener: Listener = SILENT,
    physics: DiscreteModel | None = None,
) -> FitResult:
    """Trains a Tustin-Net on a data set, or a network that corrects known physics.

    Args:
        data: records with the splits `train` and, if weights are to be chosen by free run,
            `validation`.
        recipe: a packaged recipe's name, a TOML file, or a `Recipe`.
        seed: initial weights, windows and shuffling follow from it.
        listener: who is told while training goes on.
        physics: a model to correct, as `identify` returns it; it stays as it is, and the result
            is a `HybridModel`.

    Returns:
        The model and how it came about. A training that diverged returns the best weights it
        had and says so in `outcome`.

    Raises:
        InputError: see `plan`.
    """
    return run_plan(plan(data, recipe, [Member(seed)], physics=physics), listener)[0]


def fit_many(
    data: DataSet,
    recipe: Recipe | str | Path = DEFAULT_RECIPE,
    seeds: Sequence[int] = (0,),
    rates: Sequence[float] = (1.0,),
    listener: Listener = SILENT,
    physics: DiscreteModel | None = None,
) -> list[FitResult]:
    """Trains a recipe from several seeds, at several rates, as one batched program.

    Each training keeps its own rate, best weights and returns to the last good state; one that
    diverges does not touch the others.

    Args:
        data: as for `fit`.
        recipe: as for `fit`.
        seeds: one training each.
        rates: factors of the recipe's rates; every seed is trained with each.
        listener: who is told while training goes on.
        physics: as for `fit`.

    Returns:
        As `fit` does, for each seed and within it for each rate.

    Raises:
        InputError: no seed, a rate that is not positive; see `plan`.
    """
    members = [Member(seed, rate) for seed in seeds for rate in rates]
    if not members or not all(rate > 0 for rate in rates) or len(set(members)) < len(members):
        raise InputError(
            "fit_many", f"seeds {list(seeds)}, rates {list(rates)}",
            "different seeds and different factors above 0",
        )  # fmt: skip
    return run_plan(plan(data, recipe, members, physics=physics), listener)


def run_plan(
    prepared: Plan,
    listener: Listener,
    resume: tuple[TrainingState, tuple[Progress, ...]] | None = None,
) -> list[FitResult]:
    """Trains as planned, from the beginning or from a state that a listener was given."""
    best, progress = train(
        prepared.models,
        prepared.stages,
        prepared.records,
        prepared.validation,
        prepared.keys,
        prepared.mesh,
        prepared.factors,
        listener,
        resume,
    )
    return [_result(prepared, best, m, p) for m, p in enumerate(progress)]


def _result(prepared: Plan, best: DiscreteModel, m: int, progress: Progress) -> FitResult:
    # off the devices that trained it: what comes now is one model's business
    model = jax.tree.map(lambda a: jnp.asarray(np.asarray(a)[m]), best)
    if isinstance(model, HybridModel) and prepared.physics is not None:
        # it was trained with in single precision, but is kept as it was given
        model = replace(model, physics=prepared.physics)
    score = None
    if prepared.validation is not None:
        score = float(validation_rmse(model, prepared.validation))
    return FitResult(
        model=model.folded(),
        recipe=prepared.recipe,
        member=prepared.members[m],
        outcome=progress.outcome,
        start=prepared.start,
        validation_rmse=score,
        train_seconds=progress.seconds,
        windows=tuple(s.windows.rows.shape[1] for s in prepared.stages),
        window_lengths=tuple(s.windows.length for s in prepared.stages),
        epochs=progress.epochs,
        kept_epoch=progress.best_epoch,
    )
