"""From a data set and a recipe to a trained model."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import PRNGKeyArray, PyTree

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel
from tustinnet.models.tustin import (
    TustinNet,
    learn_scaling,
    published_scaling,
    random_tustin_net,
)
from tustinnet.simulation.initial_state import default_start
from tustinnet.training.epoch import validation_rmse
from tustinnet.training.loop import begin_stage, train
from tustinnet.training.material import (
    Records,
    ValidationRuns,
    held_windows,
    lay_out,
    stage_windows,
    validation_runs,
)
from tustinnet.training.recipe import Recipe, StageRecipe, read_recipe
from tustinnet.training.state import SILENT, Listener, Progress, Stage, Weights

DEFAULT_RECIPE = "standard"


@dataclass(frozen=True)
class FitResult:
    """A trained model and how it came about.

    Attributes:
        model: the model with the best weights, folded.
        recipe: what was done.
        seed: the seed.
        outcome: `finished`, or a sentence on why training ended early.
        start: where the validation free runs started.
        validation_rmse: mean free-run RMSE over the validation records [rad or m], or None.
        train_seconds: time spent, compilation included.
        windows: windows in each stage.
        window_lengths: steps in a window of each stage.
        epochs: epochs done in each stage.
        kept_epoch: the epoch of the last stage whose weights the model has, 0 for none.
    """

    model: DiscreteModel
    recipe: Recipe
    seed: int
    outcome: str
    start: str
    validation_rmse: float | None
    train_seconds: float
    windows: tuple[int, ...]
    window_lengths: tuple[int, ...]
    epochs: tuple[int, ...]
    kept_epoch: int

    @property
    def finished(self) -> bool:
        """Whether all stages ran to their end."""
        return self.outcome == "finished"


@dataclass(frozen=True)
class Plan:
    """Everything that training needs, prepared from data, recipe and seed.

    Attributes:
        model: the model with its initial weights.
        stages: the stages with their windows drawn.
        records: the training records.
        validation: the validation free runs, or None.
        start: where these start.
        key: the source of the shuffling.
        recipe: the recipe.
        seed: the seed.
    """

    model: DiscreteModel
    stages: tuple[Stage, ...]
    records: Records
    validation: ValidationRuns | None
    start: str
    key: PRNGKeyArray
    recipe: Recipe
    seed: int

    def template(self, stage: int) -> Weights:
        """Weights of the shapes that a stage has, for reading a checkpoint."""
        return begin_stage(self.model, self.stages, stage, self.key)[0]


def plan(data: DataSet, recipe: Recipe | str | Path, seed: int) -> Plan:
    """Prepares training: initial weights, windows, validation free runs.

    The records of the split `train` are trained on, those of `validation` choose the best
    weights. A data set without splits is trained on as a whole.

    Raises:
        InputError: records too short for a window, no training split, a recipe that does not fit.
    """
    if not isinstance(data, DataSet):
        raise InputError(
            "data",
            f"a {type(data).__name__}",
            "a DataSet",
            "use tn.load(folder) or tn.DataSet(name, experiments)",
        )
    recipe = recipe if isinstance(recipe, Recipe) else read_recipe(recipe)
    train_set = list(data.split("train") if data.splits else data)
    held = list(data.split("validation")) if "validation" in data.splits else []
    for_model, shuffling = jax.random.split(jax.random.key(seed))
    model = _initial_model(train_set, recipe, for_model)
    stages = tuple(
        _plan_stage(stage, model, train_set, held, [seed, index])
        for index, stage in enumerate(recipe.stages)
    )
    start = recipe.start or default_start([*train_set, *held])
    return Plan(
        model=model,
        stages=stages,
        records=lay_out(train_set, recipe.velocity),
        validation=validation_runs(model, held, start, recipe.velocity) if held else None,
        start=start,
        key=shuffling,
        recipe=recipe,
        seed=seed,
    )


def fit(
    data: DataSet,
    recipe: Recipe | str | Path = DEFAULT_RECIPE,
    seed: int = 0,
    listener: Listener = SILENT,
) -> FitResult:
    """Trains a Tustin-Net on a data set.

    Args:
        data: records with the splits `train` and, if weights are to be chosen by free run,
            `validation`.
        recipe: a packaged recipe's name, a TOML file, or a `Recipe`.
        seed: initial weights, windows and shuffling follow from it.
        listener: who is told while training goes on.

    Returns:
        The model and how it came about. A training that diverged returns the best weights it
        had and says so in `outcome`.

    Raises:
        InputError: see `plan`.
    """
    return run_plan(plan(data, recipe, seed), listener)


def run_plan(
    prepared: Plan, listener: Listener, resume: tuple[Weights, Progress] | None = None
) -> FitResult:
    """Trains as planned, from the beginning or from a state that a listener was given."""
    model, progress = train(
        prepared.model,
        prepared.stages,
        prepared.records,
        prepared.validation,
        prepared.key,
        listener,
        resume,
    )
    score = None
    if prepared.validation is not None:
        score = float(validation_rmse(model, prepared.validation))
    done = [stage.recipe.epochs for stage in prepared.stages[: progress.stage]]
    return FitResult(
        model=model.folded(),
        recipe=prepared.recipe,
        seed=prepared.seed,
        outcome=progress.outcome,
        start=prepared.start,
        validation_rmse=score,
        train_seconds=progress.seconds,
        windows=tuple(len(s.windows.rows) for s in prepared.stages),
        window_lengths=tuple(s.windows.length for s in prepared.stages),
        epochs=(*done, progress.epoch),
        kept_epoch=progress.best_epoch,
    )


def trainable_arrays(model: TustinNet, frozen_layers: int) -> PyTree:
    """A tree like the model, True at the arrays that train.

    The scaling never trains, the output layer always does, of the hidden layers all but the
    first `frozen_layers`; a stem trains when the first hidden layer does.
    """
    mask = jax.tree.map(lambda leaf: False, model)
    free = [*model.hidden[frozen_layers:], model.output]
    if model.stem is not None and frozen_layers == 0:
        free.append(model.stem)
    trained = {id(leaf) for layer in free for leaf in jax.tree.leaves(layer)}
    return jax.tree.map(lambda flag, leaf: id(leaf) in trained, mask, model)


def _plan_stage(
    recipe: StageRecipe,
    model: TustinNet,
    train_set: list[Experiment],
    held: list[Experiment],
    seed: list[int],
) -> Stage:
    windows = stage_windows(train_set, recipe.windows, np.random.default_rng(seed))
    criteria = (recipe.keep, recipe.plateau.watch if recipe.plateau else None)
    watched = None
    if held and "validation-loss" in criteria:
        generator = np.random.default_rng([*seed, 1])
        watched = held_windows(held, recipe.windows, windows.length, generator)
    return Stage(recipe, windows, trainable_arrays(model, recipe.frozen_layers), watched)


def _initial_model(train_set: list[Experiment], recipe: Recipe, key: PRNGKeyArray) -> TustinNet:
    first = train_set[0]
    scaling: Any
    if recipe.model.scaling == "published":
        if any(c.kind == "linear" for c in first.coordinates):
            raise InputError(
                f"recipe '{recipe.name}'",
                "the published scaling is defined for angular coordinates",
                "no linear coordinate",
                "use the recipe 'standard' or 'transfer'",
            )
        scaling = published_scaling(train_set)
    else:
        scaling = learn_scaling(train_set, recipe.velocity)
    return random_tustin_net(
        first.coordinates,
        first.inputs,
        first.dt,
        scaling,
        key,
        hidden=recipe.model.hidden,
        stem=recipe.model.stem,
        activation=recipe.model.activation,
        output_bias=recipe.model.output_bias,
    )
