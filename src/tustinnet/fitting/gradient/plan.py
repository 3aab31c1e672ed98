"""Training plans: everything that training needs, prepared from a task."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, Key

from tustinnet.errors import InputError
from tustinnet.fitting.free_runs import FreeRuns, make_free_runs
from tustinnet.fitting.gradient.layout import lay_out_devices
from tustinnet.fitting.gradient.state import Stage, TrainingState, begin_stage
from tustinnet.fitting.gradient.windows import (
    RecordPool,
    Records,
    StageWindows,
    draw_stage_windows,
    draw_windows,
    record_identity,
    window_length,
)
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.fitting.residual import make_residual
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Member, Task
from tustinnet.models.contract import Model, with_dtype
from tustinnet.simulate.batches import batches
from tustinnet.simulate.horizon import effective_horizon, horizon_samples
from tustinnet.simulate.starts import Start, default_start, start_named


@dataclass(frozen=True)
class TrainingPlan:
    """A prepared training: models, stages, records and free runs, made from a task.

    Attributes:
        task: what is to be fitted.
        initial_models: the members' models with their initial weights, as they were built.
        models: these models in single precision, arrays with the member first.
        stages: the stages with their windows drawn.
        records: the records, end to end.
        internal_states: internal states along them, by member, (members, rows, n_z).
        validation_runs: the validation free runs of all members, or None.
        run_indices: which of these each member has, (members, runs).
        run_counts: 1 for each that counts, 0 for what fills up, (members, runs).
        start: where these start.
        messages: sentences on validation records that are too short for it and left out.
        keys: the sources of the shuffling, one a member.
        mesh: which device trains what.
    """

    task: Task
    initial_models: tuple[Model, ...]
    models: Model
    stages: tuple[Stage, ...]
    records: Records
    internal_states: Float[Array, "members rows n_z"]
    validation_runs: FreeRuns | None
    run_indices: Int[Array, "members runs"]
    run_counts: Float[Array, "members runs"]
    start: str
    messages: tuple[str, ...]
    keys: Key[Array, " members"]
    mesh: Mesh

    @property
    def recipe(self) -> TrainingRecipe:
        """The recipe of the task."""
        return self.task.training_recipe

    @property
    def members(self) -> tuple[Member, ...]:
        """The members that train together."""
        return self.task.members

    @property
    def factors(self) -> np.ndarray:
        """The factor of each member's rates."""
        return np.array([member.rate for member in self.members])

    def begin(self, stage: int) -> TrainingState:
        """The state in which a stage begins from the initial weights."""
        stopped = jnp.zeros(len(self.members), bool)
        return begin_stage(self.models, self.stages[stage], self.keys, self.factors, stopped)


def make_plan(task: Task, devices: Sequence[Any] | None = None) -> TrainingPlan:
    """Prepares trainings that run together: initial weights, windows, validation free runs.

    Arrays are laid out for all folds that are alike, also for those without a member here: the
    members of one fold compile to the same program and train to the same weights, whether those of
    other folds train beside them or in a job of their own.

    Args:
        task: what is to be fitted.
        devices: where they train; by default all of the kind that JAX prefers.

    Raises:
        InputError: records too short for a window, a recipe that does not fit, members that cannot
            train together.
    """
    original, recipe, folds, members = task, task.training_recipe, task.folds, task.members
    family = recipe.family
    keys = [jax.random.split(jax.random.key(member.seed)) for member in members]
    fold_numbers = sorted({m.fold for m in members})
    builders = {
        f: family.builder(
            recipe.model, folds[f].roles.train, recipe.velocity, _shared_physics(folds[f])
        )
        for f in fold_numbers
    }
    initial_models = []
    for member, (key, _) in zip(members, keys, strict=True):
        model, origin = builders[member.fold](key), folds[member.fold].origin
        if origin is not None:
            model = family.with_weights_from(model, origin.model)
        initial_models.append(model)
    single = [with_dtype(model, np.float32) for model in initial_models]
    require_alike(single)
    # the records of every fold that could train together with the members' folds
    peer_numbers = fold_numbers
    if len(folds) > len(fold_numbers):
        programs = {f: _fold_program(recipe, fold) for f, fold in enumerate(folds)}
        member_programs = {programs[f] for f in fold_numbers}
        peer_numbers = [f for f in range(len(folds)) if programs[f] in member_programs]
    # validation records in which no free run can start are left out
    every_record = {id(e): e for f in peer_numbers for e in folds[f].roles.all}
    start_name = recipe.start or default_start([*every_record.values()], single[0])
    start = start_named(start_name)
    messages, ignored = list[str](), list[str]()
    kept = [
        fold.roles.with_long_validation(
            start.samples, (messages if f in fold_numbers else ignored).append
        )
        for f, fold in enumerate(folds)
    ]
    task = replace(task, folds=tuple(replace(f, roles=r) for f, r in zip(folds, kept, strict=True)))
    peers = [task.folds[f].roles for f in peer_numbers]
    pool = RecordPool([e for roles in peers for e in roles.all])
    stages = tuple(
        _plan_stage(index, task, recipe, single[0], pool, peers)
        for index in range(len(recipe.stages))
    )
    horizon_samples(recipe.horizon, pool.experiments, start, f"recipe '{recipe.name}', horizon")
    internal_states = {
        m.fold: pool.internal_states(initial_models[i], recipe.velocity)
        for i, m in reversed(list(enumerate(members)))
    }
    validation_runs, run_indices, run_counts = _plan_validation(
        task, recipe, single[0], start, peers
    )
    return TrainingPlan(
        task=original,
        initial_models=tuple(initial_models),
        models=jax.tree.map(lambda *arrays: jnp.stack(arrays), *single),
        stages=stages,
        records=pool.records(single[0], recipe.velocity),
        internal_states=jnp.asarray(np.stack([internal_states[m.fold] for m in members])),
        validation_runs=validation_runs,
        run_indices=run_indices,
        run_counts=run_counts,
        start=start_name,
        messages=tuple(dict.fromkeys(messages)),
        keys=jnp.stack([shuffling for _, shuffling in keys]),
        mesh=lay_out_devices(len(members), min(s.batch for s in recipe.stages), devices),
    )


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
            "`physics=`",
            f"has other values for {differ}",
            "records that share their values",
            "train on the records of one group",
        )
    return physics


def require_alike(models: Sequence[Model]) -> None:
    """Raises unless models have the same structure, so that one program trains them."""
    if len({jax.tree.structure(model) for model in models}) > 1:
        raise InputError("members", "models of different structure", "models that are alike")


def groups_alike(task: Task) -> list[list[Member]]:
    """Members that can train together: in folds whose windows and models are alike."""
    folds = {member.fold for member in task.members}
    if len(folds) == 1:
        return [list(task.members)]
    programs = {f: _fold_program(task.training_recipe, task.folds[f]) for f in folds}
    groups: dict[Any, list[Member]] = {}
    for member in task.members:
        groups.setdefault(programs[member.fold], []).append(member)
    return list(groups.values())


def _fold_program(recipe: TrainingRecipe, fold: Fold) -> Any:
    """A key that is the same for folds whose members can train as one program."""
    train = fold.roles.train
    physics = recipe.family.physics_for_training(recipe.model, fold.physics, train)
    return (
        tuple(window_length(train, stage.windows) for stage in recipe.stages),
        tuple(make_residual(stage, train) for stage in recipe.stages),
        jax.tree.structure(physics),
    )


def _plan_stage(
    index: int,
    task: Task,
    recipe: TrainingRecipe,
    model: Model,
    pool: RecordPool,
    peers: Sequence[Roles],
) -> Stage:
    """The stage of an index with the windows of every member drawn."""
    stage, lead = recipe.stages[index], model.warm_up
    roles = [task.folds[m.fold].roles for m in task.members]
    # windows are drawn for the members, then for folds without a member
    draws = [(m.seed, r) for m, r in zip(task.members, roles, strict=True)]
    draws += [(task.members[0].seed, r) for r in peers if all(r is not own for own in roles)]
    rows, lengths = [], set()
    for seed, records in draws:
        generator = np.random.default_rng([seed, index])
        windows, length = draw_stage_windows(records.train, stage.windows, generator, lead)
        rows.append(pool.window_rows(windows, records.train))
        lengths.add(length)
    if len(lengths) > 1:
        raise InputError(f"stage '{stage.name}'", "windows of different lengths", "one length")
    length, validation_rows = lengths.pop(), None
    criteria = (stage.keep, stage.plateau.watch if stage.plateau else None)
    if "validation-loss" in criteria:
        drawn = []
        for seed, records in draws:
            generator = np.random.default_rng([seed, index, 1])
            if records.validation:
                windows = draw_windows(records.validation, stage.windows, length + lead, generator)
                drawn.append(pool.window_rows(windows, records.validation))
        if len(drawn) == len(draws) and all(map(len, drawn)):
            validation_rows = _stack_rows(drawn, len(roles))
    residuals = {make_residual(stage, records.train) for records in roles}
    if len(residuals) > 1:
        raise InputError(f"stage '{stage.name}'", "residuals of different units", "one unit")
    return Stage(
        recipe=stage,
        windows=StageWindows(_stack_rows(rows, len(roles)), length, lead),
        trainable=recipe.family.trainable_mask(model, stage),
        residual=residuals.pop(),
        validation_rows=validation_rows,
    )


def _stack_rows(rows: Sequence[np.ndarray], members: int) -> Int[np.ndarray, "members count"]:
    """The rows of the first so many, as many for each as the fewest, others thinned out evenly."""
    fewest = min(map(len, rows))
    return np.stack(
        [r[np.linspace(0, len(r) - 1, fewest).round().astype(int)] for r in rows[:members]]
    )


def _plan_validation(
    task: Task, recipe: TrainingRecipe, model: Model, start: Start, peers: Sequence[Roles]
) -> tuple[FreeRuns | None, Int[Array, "members runs"], Float[Array, "members runs"]]:
    """The validation free runs, which of them each member has, and which of these count."""
    by_member = [task.folds[m.fold].roles.validation for m in task.members]
    if not all(by_member):
        nothing = jnp.zeros((len(by_member), 0))
        return None, nothing.astype(jnp.int32), nothing
    by_peer = [roles.validation for roles in peers]
    distinct = {record_identity(e): e for records in by_peer for e in records}
    index_of_record = {identity: i for i, identity in enumerate(distinct)}
    most = max(map(len, by_peer))
    run_indices = np.zeros((len(by_member), most), np.int32)
    run_counts = np.zeros((len(by_member), most), np.float32)
    for m, records in enumerate(by_member):
        run_indices[m, : len(records)] = [index_of_record[record_identity(e)] for e in records]
        run_counts[m, : len(records)] = 1.0
    experiments = tuple(distinct.values())
    runs = make_free_runs(model, experiments, start, effective_horizon(recipe.horizon, experiments))
    return runs, jnp.asarray(run_indices), jnp.asarray(run_counts)


def restore_untrained(plan: TrainingPlan, member: int, trained: Model) -> Model:
    """A trained model whose arrays that never trained are the initial ones, bit for bit.

    Training is in single precision; physics that is corrected stays as it was.
    """
    masks = [stage.trainable for stage in plan.stages]
    mask = jax.tree.map(lambda *trains: any(trains), *masks)
    new, _ = eqx.partition(trained, mask)
    _, old = eqx.partition(plan.initial_models[member], mask)
    return eqx.combine(new, old)
