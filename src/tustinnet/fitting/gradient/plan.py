"""Everything that training needs, from a task."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, Key

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.free_runs import FreeRuns, free_runs
from tustinnet.fitting.gradient.layout import lay_out_devices
from tustinnet.fitting.gradient.material import (
    Pool,
    Records,
    StageWindows,
    adapted_length,
    draw,
    lead_of,
    sameness,
    stage_windows,
)
from tustinnet.fitting.gradient.state import Stage, TrainingState, begin_stage
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.fitting.residual import residual_of
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Member, Task
from tustinnet.models.contract import Model, with_dtype
from tustinnet.simulate.batches import batches
from tustinnet.simulate.horizon import horizon_samples, within
from tustinnet.simulate.starts import Start, default_start, start_named


@dataclass(frozen=True)
class Plan:
    """Everything that training needs, prepared from a task.

    Attributes:
        task: what is to be fitted.
        given: the members' models with their initial weights, as they were built.
        models: the same in single precision, arrays with the member first.
        stages: the stages with their windows drawn.
        records: the records, end to end.
        internal: internal states along them, by member, (members, rows, n_z).
        validation: the validation free runs of all members, or None.
        chosen: which of these each member has, (members, runs).
        counted: 1 for each that counts, 0 for what fills up, (members, runs).
        start: where these start.
        keys: the sources of the shuffling, one a member.
        mesh: which device trains what.
    """

    task: Task
    given: tuple[Model, ...]
    models: Model
    stages: tuple[Stage, ...]
    records: Records
    internal: Float[Array, "members rows n_z"]
    validation: FreeRuns | None
    chosen: Int[Array, "members runs"]
    counted: Float[Array, "members runs"]
    start: str
    keys: Key[Array, " members"]
    mesh: Mesh

    @property
    def recipe(self) -> TrainingRecipe:
        """The recipe."""
        recipe = self.task.recipe
        assert isinstance(recipe, TrainingRecipe)
        return recipe

    @property
    def members(self) -> tuple[Member, ...]:
        """What trains together."""
        return self.task.members

    @property
    def factors(self) -> np.ndarray:
        """What each member multiplies the rates by."""
        return np.array([member.rate for member in self.members])

    def begin(self, stage: int) -> TrainingState:
        """The state in which a stage begins from the initial weights."""
        going = jnp.zeros(len(self.members), bool)
        return begin_stage(self.models, self.stages[stage], self.keys, self.factors, going)


def plan(task: Task, devices: Sequence[Any] | None = None) -> Plan:
    """Prepares trainings that run together: initial weights, windows, validation free runs.

    Material is laid out for all folds that are alike, also for those without a member here: the
    members of one fold compile to the same program and train to the same weights, whether those of
    other folds train beside them or in a job of their own.

    Args:
        task: what is to be fitted.
        devices: where they train; by default all of the kind that JAX prefers.

    Raises:
        InputError: records too short for a window, a recipe that does not fit, members that cannot
            train together.
    """
    recipe, folds, members = task.recipe, task.folds, task.members
    if not isinstance(recipe, TrainingRecipe):
        raise InputError(f"recipe '{recipe.name}'", "nothing to train", "a recipe with stages")
    keys = [jax.random.split(jax.random.key(member.seed)) for member in members]
    used = sorted({m.fold for m in members})
    peers = _peers(task)
    make = {
        f: recipe.family.builder(
            recipe.model, folds[f].roles.train, recipe.velocity, _shared_physics(folds[f])
        )
        for f in used
    }
    given = tuple(
        _begun(task, m.fold, make[m.fold](key)) for m, (key, _) in zip(members, keys, strict=True)
    )
    single = [with_dtype(model, np.float32) for model in given]
    require_alike(single)
    pool = Pool([e for of in peers for e in of.all])
    stages = tuple(
        _plan_stage(index, task, single[0], pool, peers) for index in range(len(recipe.stages))
    )
    named = recipe.start or default_start(pool.experiments, single[0])
    rule = start_named(named)
    horizon_samples(recipe.horizon, pool.experiments, rule, f"recipe '{recipe.name}', horizon")
    along = {m.fold: pool.internal_states(given[i], recipe.velocity)
             for i, m in reversed(list(enumerate(members)))}  # fmt: skip
    validation, chosen, counted = _validation(task, single[0], rule, peers)
    return Plan(
        task=task,
        given=given,
        models=jax.tree.map(lambda *arrays: jnp.stack(arrays), *single),
        stages=stages,
        records=pool.records(single[0], recipe.velocity),
        internal=jnp.asarray(np.stack([along[m.fold] for m in members])),
        validation=validation,
        chosen=chosen,
        counted=counted,
        start=named,
        keys=jnp.stack([shuffling for _, shuffling in keys]),
        mesh=lay_out_devices(len(members), min(s.batch for s in recipe.stages), devices),
    )


def _begun(task: Task, fold: int, built: Model) -> Model:
    """A model as it was built, or with the weights of the one that its fold begins with."""
    recipe, origin = task.recipe, task.folds[fold].origin
    assert isinstance(recipe, TrainingRecipe)
    if origin is not None:
        built = recipe.family.begun(built, origin.model)
    return built


def _shared_physics(fold: Fold) -> Model | None:
    """The physics of the records of a fold, which they must share."""
    if fold.physics is None:
        return None
    (physics, rows), *others = batches(fold.physics, fold.roles.all)
    if others:
        one, other = fold.roles.all[rows[0]], fold.roles.all[others[0][1][0]]
        differ = " and ".join(
            f"{name} '{value}' of '{e.name}'"
            for e, than in ((one, other), (other, one))
            for name, value in sorted(set(e.groups) - set(than.groups))
        )
        raise InputError(
            "--physics", f"has other values for {differ}", "records that share their values",
            "train on the records of one group",
        )  # fmt: skip
    return physics


def require_alike(models: Sequence[Model]) -> None:
    """Raises unless models have the same structure, so that one program trains them."""
    if len({jax.tree.structure(model) for model in models}) > 1:
        raise InputError("members", "models of different structure", "models that are alike")


def groups_alike(task: Task) -> list[list[Member]]:
    """Members that can train together: in folds whose windows and models are alike.

    Members of kinds that are identified are fitted one by one and make one group.
    """
    recipe = task.recipe
    if not isinstance(recipe, TrainingRecipe):
        return [list(task.members)]
    groups: dict[Any, list[Member]] = {}
    alike: dict[int, Any] = {}
    for member in task.members:
        if member.fold not in alike:
            alike[member.fold] = _likeness(recipe, task.folds[member.fold])
        groups.setdefault(alike[member.fold], []).append(member)
    return list(groups.values())


def _likeness(recipe: TrainingRecipe, fold: Fold) -> Any:
    """What must be the same for members to train as one program."""
    train = fold.roles.train
    windows = [s.windows for s in recipe.stages]
    physics = recipe.family.stepped(recipe.model, fold.physics, train)
    return (
        tuple(adapted_length(train, w.length) if w.adapt else w.length for w in windows),
        tuple(residual_of(stage, train) for stage in recipe.stages),
        jax.tree.structure(physics),
    )


def _peers(task: Task) -> list[Roles]:
    """The records of every fold that could train together with the members' folds."""
    used = {m.fold for m in task.members}
    if len(task.folds) == len(used):
        return [task.folds[f].roles for f in sorted(used)]
    assert isinstance(task.recipe, TrainingRecipe)
    recipe = task.recipe
    of = {f: _likeness(recipe, fold) for f, fold in enumerate(task.folds)}
    ours = {of[f] for f in used}
    return [fold.roles for f, fold in enumerate(task.folds) if of[f] in ours]


def _plan_stage(index: int, task: Task, model: Model, pool: Pool, peers: Sequence[Roles]) -> Stage:
    """The stage with the windows of every member drawn."""
    assert isinstance(task.recipe, TrainingRecipe)
    lead, recipe = lead_of(model), task.recipe.stages[index]
    roles = [task.folds[m.fold].roles for m in task.members]
    drawn, lengths = [], set()
    for seed, of in _drawing(task, peers):
        generator = np.random.default_rng([seed, index])
        windows, length = stage_windows(of.train, recipe.windows, generator, lead)
        drawn.append(pool.rows(windows, of.train))
        lengths.add(length)
    if len(lengths) > 1:
        raise InputError(f"stage '{recipe.name}'", "windows of different lengths", "one length")
    length, watched = lengths.pop(), None
    criteria = (recipe.keep, recipe.plateau.watch if recipe.plateau else None)
    if "validation-loss" in criteria:
        found = []
        for seed, of in _drawing(task, peers):
            generator = np.random.default_rng([seed, index, 1])
            if of.validation:
                windows = draw(of.validation, recipe.windows, length + lead, generator)
                found.append(pool.rows(windows, of.validation))
        if len(found) == len(drawn) and all(len(rows) for rows in found):
            watched = StageWindows(_side_by_side(found, len(roles)), length, lead)
    residuals = {residual_of(recipe, of.train) for of in roles}
    if len(residuals) > 1:
        raise InputError(f"stage '{recipe.name}'", "residuals of different units", "one unit")
    return Stage(
        recipe=recipe,
        windows=StageWindows(_side_by_side(drawn, len(roles)), length, lead),
        trainable=family_of(model).trainable(model, recipe),
        residual=residuals.pop(),
        watched=watched,
    )


def _drawing(task: Task, peers: Sequence[Roles]) -> list[tuple[int, Roles]]:
    """For whom windows are drawn, seed and records: the members, then folds without a member."""
    mine = [(m.seed, task.folds[m.fold].roles) for m in task.members]
    others = [of for of in peers if all(of is not own for _, own in mine)]
    return mine + [(task.members[0].seed, of) for of in others]


def _side_by_side(rows: Sequence[np.ndarray], members: int) -> Int[np.ndarray, "members count"]:
    """The first so many, as many windows for each as the fewest have, others thinned out evenly."""
    fewest = min(map(len, rows))
    return np.stack(
        [r[np.linspace(0, len(r) - 1, fewest).round().astype(int)] for r in rows[:members]]
    )


def _validation(
    task: Task, model: Model, start: Start, peers: Sequence[Roles]
) -> tuple[FreeRuns | None, Int[Array, "members runs"], Float[Array, "members runs"]]:
    """The free runs that judge, which of them each member has, and what counts of these."""
    mine = [task.folds[m.fold].roles.validation for m in task.members]
    if not all(mine):
        nothing = jnp.zeros((len(mine), 0))
        return None, nothing.astype(jnp.int32), nothing
    theirs = [of.validation for of in peers]
    known = {sameness(e): e for of in theirs for e in of}
    every: tuple[Experiment, ...] = tuple(known.values())
    place = {same: i for i, same in enumerate(known)}
    most = max(map(len, theirs))
    chosen = np.zeros((len(mine), most), np.int32)
    counted = np.zeros((len(mine), most), np.float32)
    for m, of in enumerate(mine):
        chosen[m, : len(of)] = [place[sameness(e)] for e in of]
        counted[m, : len(of)] = 1.0
    assert isinstance(task.recipe, TrainingRecipe)
    horizon = within(task.recipe.horizon, every)
    runs = free_runs(model, every, start, horizon)
    return runs, jnp.asarray(chosen), jnp.asarray(counted)


def completed(prepared: Plan, member: int, trained: Model) -> Model:
    """A trained model whose arrays that never trained are those that were given, bit for bit.

    Training is in single precision; physics that is corrected stays as it was.
    """
    ever = jax.tree.map(lambda *of: any(of), *(stage.trainable for stage in prepared.stages))
    new, _ = eqx.partition(trained, ever)
    _, old = eqx.partition(prepared.given[member], ever)
    return eqx.combine(new, old)
