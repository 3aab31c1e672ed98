"""Everything that training needs, from a data set, a recipe and members."""

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
    Scaling,
    TustinNet,
    learn_scaling,
    published_scaling,
    random_tustin_net,
)
from tustinnet.simulation.initial_state import default_start
from tustinnet.simulation.internal_states import known_states
from tustinnet.training.layout import lay_out_devices
from tustinnet.training.loop import begin_stage
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
from tustinnet.training.state import Stage, TrainingState


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
    scaling = _scaling(train_set, recipe, physics)
    models = [_initial_model(train_set[0], recipe, scaling, key, physics) for key, _ in keys]
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


def _scaling(train_set: list[Experiment], recipe: Recipe, physics: DiscreteModel | None) -> Scaling:
    """The units of a network, the same for all members."""
    if recipe.model.scaling == "published":
        if any(c.kind == "linear" for c in train_set[0].coordinates):
            raise InputError(
                f"recipe '{recipe.name}'",
                "the published scaling is defined for angular coordinates",
                "no linear coordinate",
                "use the recipe 'standard' or 'transfer'",
            )
        scaling = published_scaling(train_set)
    else:
        scaling = learn_scaling(train_set, recipe.velocity, recipe.model.memory)
    if physics is None:
        return scaling
    return replace(scaling, acceleration=_left_by(physics, train_set, recipe.velocity))


def _initial_model(
    first: Experiment,
    recipe: Recipe,
    scaling: Scaling,
    key: PRNGKeyArray,
    physics: DiscreteModel | None,
) -> TustinNet | HybridModel:
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
