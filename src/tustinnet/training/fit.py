"""From a data set and a recipe to a trained model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Key, PRNGKeyArray, PyTree

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.models.base import DiscreteModel, require_fit, with_dtype
from tustinnet.models.hybrid import HybridModel, uncorrected
from tustinnet.models.tustin import (
    TustinNet,
    learn_scaling,
    published_scaling,
    random_tustin_net,
)
from tustinnet.simulation.initial_state import default_start
from tustinnet.simulation.internal_states import known_states
from tustinnet.training.epoch import validation_rmse
from tustinnet.training.layout import lay_out_devices
from tustinnet.training.loop import FINISHED, begin_stage, train
from tustinnet.training.material import (
    Records,
    StageWindows,
    ValidationRuns,
    held_windows,
    lay_out,
    stage_windows,
    validation_runs,
)
from tustinnet.training.recipe import Recipe, StageRecipe, read_recipe
from tustinnet.training.state import SILENT, Listener, Progress, Stage, TrainingState

DEFAULT_RECIPE = "standard"


@dataclass(frozen=True)
class Member:
    """One of the trainings that run together.

    Attributes:
        seed: initial weights, windows and shuffling follow from it.
        rate: multiplies the recipe's rates.
    """

    seed: int
    rate: float = 1.0

    @property
    def name(self) -> str:
        """What it is called in files and messages."""
        return f"seed-{self.seed}" + ("" if self.rate == 1.0 else f"-rate-{self.rate:g}")


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


@dataclass(frozen=True)
class Plan:
    """Everything that training needs, prepared from data, recipe and members.

    Attributes:
        models: the members' models with their initial weights, arrays with the member first.
        stages: the stages with their windows drawn.
        records: the training records.
        validation: the validation free runs, or None.
        start: where these start.
        keys: the sources of the shuffling, one a member.
        recipe: the recipe.
        members: what runs together.
        mesh: which device trains what.
        physics: what the networks correct, or None.
    """

    models: DiscreteModel
    stages: tuple[Stage, ...]
    records: Records
    validation: ValidationRuns | None
    start: str
    keys: Key[Array, " members"]
    recipe: Recipe
    members: tuple[Member, ...]
    mesh: Mesh
    physics: DiscreteModel | None = None

    @property
    def factors(self) -> np.ndarray:
        """What each member multiplies the rates by."""
        return np.array([member.rate for member in self.members])

    def template(self, stage: int) -> TrainingState:
        """A state of the shapes that a stage has, for reading a checkpoint."""
        stopped = jnp.zeros(len(self.members), bool)
        return begin_stage(self.models, self.stages[stage], self.keys, self.factors, stopped)


def plan(
    data: DataSet,
    recipe: Recipe | str | Path,
    members: Sequence[Member] = (Member(0),),
    devices: Sequence[Any] | None = None,
    physics: DiscreteModel | None = None,
) -> Plan:
    """Prepares trainings that run together: initial weights, windows, validation free runs.

    The records of the split `train` are trained on, those of `validation` choose the best
    weights. A data set without splits is trained on as a whole.

    Args:
        data: the records.
        recipe: a packaged recipe's name, a TOML file, or a `Recipe`.
        members: seeds, and factors of the rates.
        devices: where they train; by default all of the kind that JAX prefers.
        physics: a model whose accelerations the network is to correct, and which stays as it is.

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
    keys = [jax.random.split(jax.random.key(member.seed)) for member in members]
    models = [_initial_model(train_set, recipe, for_model, physics) for for_model, _ in keys]
    stages = tuple(
        _plan_stage(index, stage, models[0], train_set, held, members)
        for index, stage in enumerate(recipe.stages)
    )
    start = recipe.start or default_start([*train_set, *held])
    return Plan(
        models=jax.tree.map(lambda *arrays: jnp.stack(arrays), *models),
        stages=stages,
        records=lay_out(models[0], train_set, recipe.velocity),
        validation=validation_runs(models[0], held, start, recipe.velocity) if held else None,
        start=start,
        keys=jnp.stack([shuffling for _, shuffling in keys]),
        recipe=recipe,
        members=tuple(members),
        mesh=lay_out_devices(len(members), min(s.batch for s in recipe.stages), devices),
        physics=physics,
    )


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


def trainable_arrays(model: TustinNet | HybridModel, frozen_layers: int) -> PyTree:
    """A tree like the model, True at the arrays that train.

    The scaling never trains, the output layer always does, of the hidden layers all but the
    first `frozen_layers`; a stem trains when the first hidden layer does. Physics does not.
    """
    mask = jax.tree.map(lambda leaf: False, model)
    network = model.residual if isinstance(model, HybridModel) else model
    free = [*network.hidden[frozen_layers:], network.output]
    if network.stem is not None and frozen_layers == 0:
        free.append(network.stem)
    trained = {id(leaf) for layer in free for leaf in jax.tree.leaves(layer)}
    return jax.tree.map(lambda flag, leaf: id(leaf) in trained, mask, model)


def _plan_stage(
    index: int,
    recipe: StageRecipe,
    model: TustinNet | HybridModel,
    train_set: list[Experiment],
    held: list[Experiment],
    members: Sequence[Member],
) -> Stage:
    generators = [np.random.default_rng([m.seed, index]) for m in members]
    drawn = [stage_windows(train_set, recipe.windows, g) for g in generators]
    windows = StageWindows(np.stack([w.rows for w in drawn]), drawn[0].length)
    criteria = (recipe.keep, recipe.plateau.watch if recipe.plateau else None)
    watched = None
    if held and "validation-loss" in criteria:
        generators = [np.random.default_rng([m.seed, index, 1]) for m in members]
        found = [held_windows(held, recipe.windows, windows.length, g) for g in generators]
        if found[0] is not None:
            rows = np.stack([w.rows for w in found if w is not None])
            watched = StageWindows(rows, windows.length)
    return Stage(recipe, windows, trainable_arrays(model, recipe.frozen_layers), watched)


def _initial_model(
    train_set: list[Experiment],
    recipe: Recipe,
    key: PRNGKeyArray,
    physics: DiscreteModel | None,
) -> TustinNet | HybridModel:
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
        scaling = learn_scaling(train_set, recipe.velocity, recipe.model.memory)
    if physics is not None:
        scaling = replace(scaling, acceleration=_left_by(physics, train_set, recipe.velocity))
    network = random_tustin_net(
        first.coordinates,
        first.inputs,
        first.dt,
        scaling,
        key,
        hidden=recipe.model.hidden,
        stem=recipe.model.stem,
        activation=recipe.model.activation,
        output_bias=recipe.model.output_bias,
        relaxation_times=recipe.model.memory,
    )
    if physics is None:
        return network
    return uncorrected(
        with_dtype(physics, np.float32), network, fades_at_rest=recipe.model.fades_at_rest
    )


def _left_by(
    physics: DiscreteModel, train_set: list[Experiment], velocity: VelocitySource
) -> Float[Array, " n_q"]:
    """Root mean square of what physics leaves of the accelerations, the unit of a correction."""
    for e in train_set:
        require_fit(physics, e)
    states = known_states(physics, train_set, velocity)
    drive = np.concatenate([physics.drive(e) for e in train_set])
    x = np.concatenate([x[:-1] for x in states])
    measured = np.concatenate([x[1:] for x in states])
    following = np.asarray(_steps(physics, jnp.asarray(x), jnp.asarray(drive)))
    n_q = len(physics.coordinates)
    left = (measured - following)[:, n_q : 2 * n_q] / physics.dt
    return jnp.asarray(np.sqrt(np.mean(left**2, axis=0)), jnp.float32)


@eqx.filter_jit
def _steps(
    model: DiscreteModel,
    x: Float[Array, "steps n_x"],
    u: Float[Array, "steps *drive"],
) -> Float[Array, "steps n_x"]:
    return jax.vmap(model.step)(x, u)
