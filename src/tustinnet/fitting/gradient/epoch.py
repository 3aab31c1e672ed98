"""The compiled parts of training: epochs of all members, and the figures they are judged by."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jax.flatten_util import ravel_pytree
from jax.sharding import Mesh, NamedSharding
from jax.sharding import PartitionSpec as Spec
from jaxtyping import Array, Bool, Float, Int, PyTree

from tustinnet.fitting.free_runs import FreeRuns
from tustinnet.fitting.gradient.layout import MEMBERS, WINDOWS
from tustinnet.fitting.gradient.plan import TrainingPlan
from tustinnet.fitting.gradient.plateau import decay_rate, update_plateau
from tustinnet.fitting.gradient.state import (
    EpochFigures,
    MemberWeights,
    Stage,
    StageProgress,
    TrainingState,
    adam_without_rate,
)
from tustinnet.fitting.gradient.windows import Records
from tustinnet.fitting.recipe import Criterion, Kept, StageRecipe
from tustinnet.fitting.residual import Residual
from tustinnet.models.blocks import is_layer
from tustinnet.models.contract import Model
from tustinnet.simulate.rollout import rollouts

EPOCHS_A_CALL = 5  # at most; fewer run the same program
ROLLBACKS = 5  # a member gives up after this many in a stage
ROLLBACK_FACTOR = 0.5  # each multiplies the rate


@dataclass(frozen=True)
class WindowLoss:
    """The loss of a window: its simulation compared with the record.

    Attributes:
        residual: what is compared.
        length: steps in a window that are.
        lead: steps before them, see `StageWindows`.
        only_layers: whether nothing trains but `Affine` layers, see `rollouts`.
    """

    residual: Residual
    length: int
    lead: int = 0
    only_layers: bool = False


@dataclass(frozen=True)
class _EpochProgram:
    """The settings an epoch is compiled for; one program serves every training with the same."""

    recipe: StageRecipe
    loss: WindowLoss
    trainable: tuple[bool, ...]
    keep: Criterion
    watch: Criterion
    mesh: Mesh


class _MemberInputs(NamedTuple):
    """The inputs of an epoch that each member has for itself, see `TrainingPlan`."""

    rows: Int[Array, "*members count"]
    validation_rows: Int[Array, "*members validation"]
    internal_states: Float[Array, "*members rows n_z"]
    run_indices: Int[Array, "*members runs"]
    run_counts: Float[Array, "*members runs"]


class _EpochInputs(NamedTuple):
    """The inputs of an epoch: each member's own, and those that all members share."""

    member: _MemberInputs
    epochs: Int[Array, ""]
    records: Records
    validation_runs: FreeRuns | None


def compile_epochs(
    plan: TrainingPlan, stage: Stage
) -> Callable[[TrainingState, int], tuple[TrainingState, EpochFigures]]:
    """Several epochs of all members as one compiled call, given their number.

    Each member that has epochs left does as many, `EPOCHS_A_CALL` at most: shuffles, scans over
    batches, runs free over its validation records, notes the best weights, adapts the rate. Weights
    that are not finite are dropped for the last good ones at a lower rate. No member sees another.
    The figures have `EPOCHS_A_CALL` rows, the last ones not active where there are fewer epochs.
    """
    recipe, windows = stage.recipe, stage.windows
    validation = stage.validation_rows if plan.validation_runs is not None else None

    def available(criterion: Kept) -> Criterion:
        """The criterion, or the next one where there are no records or windows for it."""
        if plan.validation_runs is None or criterion == "last":
            return "training"
        if criterion == "validation-loss" and validation is None:
            return "validation"  # the validation records are shorter than a window
        return criterion

    layers = jax.tree.map(is_layer, plan.models, is_leaf=is_layer)
    in_layers = jax.tree.map(lambda layer, mask: layer or not mask, layers, stage.trainable)
    program = _EpochProgram(
        # the name and the number of epochs make no other program
        recipe=recipe.model_copy(update={"name": "", "epochs": 1, "rate": 1.0}),
        loss=WindowLoss(
            stage.residual,
            windows.length,
            windows.lead,
            only_layers=all(jax.tree.leaves(in_layers)),
        ),
        trainable=tuple(jax.tree.leaves(stage.trainable)),
        keep=available(recipe.keep),
        watch=available(recipe.plateau.watch if recipe.plateau else "training"),
        mesh=plan.mesh,
    )
    validation_rows = jnp.zeros((len(windows.rows), 0)) if validation is None else validation
    member = _MemberInputs(
        rows=jnp.asarray(windows.rows, jnp.int32),
        validation_rows=jnp.asarray(validation_rows, jnp.int32),
        internal_states=plan.internal_states,
        run_indices=plan.run_indices,
        run_counts=plan.run_counts,
    )
    epochs = jnp.asarray(recipe.epochs, jnp.int32)
    inputs = _EpochInputs(member, epochs, plan.records, plan.validation_runs)
    # laid out as the first call takes it: arrays without entries come back laid out otherwise, and
    # another layout would be compiled for anew
    layout = NamedSharding(plan.mesh, Spec(MEMBERS))
    return lambda state, count: _run(
        jax.device_put(state, layout), inputs, jnp.asarray(count, jnp.int32), program=program
    )


@partial(jax.jit, static_argnames=("program",))
def _run(
    state: TrainingState, inputs: _EpochInputs, count: Int[Array, ""], *, program: _EpochProgram
) -> tuple[TrainingState, EpochFigures]:
    member, shared = Spec(MEMBERS), Spec()
    # where the arrays are, in a tree like theirs
    specs = _EpochInputs(member, shared, shared, shared)  # pyright: ignore[reportArgumentType]

    def on_device(
        state: TrainingState, inputs: _EpochInputs, count: Int[Array, ""]
    ) -> tuple[TrainingState, EpochFigures]:
        state, inputs = _replace_empty((state, inputs))

        def step(state: TrainingState, i: Int[Array, ""]) -> tuple[TrainingState, EpochFigures]:
            return jax.lax.cond(
                i < count,
                lambda state: _epoch(state, inputs, program),
                lambda state: (state, _no_figures(state.progress)),
                state,
            )

        return jax.lax.scan(step, state, jnp.arange(EPOCHS_A_CALL))

    sharded = jax.shard_map(
        on_device,
        mesh=program.mesh,
        in_specs=(member, specs, shared),
        out_specs=(member, Spec(None, MEMBERS)),
        check_vma=False,
    )
    return sharded(state, inputs, count)


def _replace_empty(arrays: PyTree) -> PyTree:
    """The arrays, those without entries made where they are used.

    JAX 0.11 ends with a segmentation fault where it compiles a function of several devices that
    reads an array without entries from outside.
    """
    return jax.tree.map(lambda a: a if a.size else jnp.zeros(a.shape, a.dtype), arrays)


def _no_figures(progress: StageProgress) -> EpochFigures:
    """The figures of an epoch that was not done."""
    rate = progress.plateau.rate
    no, unknown = jnp.zeros(rate.shape, bool), jnp.full(rate.shape, jnp.nan, jnp.float32)
    return EpochFigures(
        active=no,
        finite=no,
        epoch=progress.epoch,
        loss=unknown,
        validation=unknown,
        rate=rate,
        best=progress.best_score,
    )


def _epoch(
    state: TrainingState, inputs: _EpochInputs, program: _EpochProgram
) -> tuple[TrainingState, EpochFigures]:
    """An epoch of all members of a device that have one to do."""
    progress = state.progress
    due = (progress.epoch < inputs.epochs) & ~progress.stopped
    if program.recipe.patience is not None:
        due &= progress.epoch - progress.best_epoch < program.recipe.patience

    def attempt(
        weights: MemberWeights, member: _MemberInputs, rate: Array, due: Array
    ) -> tuple[MemberWeights, Array, Array]:
        nothing = jnp.full((), jnp.nan, jnp.float32), jnp.zeros((), bool)
        return jax.lax.cond(
            due,
            lambda weights: _train_epoch(weights, rate, inputs._replace(member=member), program),
            lambda weights: (weights, *nothing),
            weights,
        )

    rate = decay_rate(progress.plateau.rate, progress.epoch, inputs.epochs, program.recipe)
    attempts, loss, finite = _map_members(
        program.mesh, attempt, state.weights, inputs.member, rate, due
    )
    figures = _compute_figures(attempts.average, loss, inputs, program)
    update = jax.vmap(partial(_update_member, program=program))
    after, epoch_figures = update(state, attempts, figures, finite, due)
    return after, epoch_figures._replace(rate=rate)


def _update_member(
    before: TrainingState,
    attempt: MemberWeights,
    figures: dict[Criterion, Float[Array, ""]],
    finite: Bool[Array, ""],
    due: Bool[Array, ""],
    *,
    program: _EpochProgram,
) -> tuple[TrainingState, EpochFigures]:
    """A member after an epoch: its best weights, its rate, where it is."""
    weights, progress = before
    rate, last = progress.plateau.rate, program.recipe.keep == "last"
    score = figures[program.keep]
    better = finite & (last | (score < progress.best_score))
    plateau = update_plateau(progress.plateau, figures[program.watch], program.recipe.plateau)
    attempt = attempt._replace(best=_choose(better, attempt.average, weights.best))
    gives_up = ~finite & (progress.rollbacks >= ROLLBACKS)
    lowered = progress.plateau._replace(rate=jnp.where(gives_up, rate, rate * ROLLBACK_FACTOR))
    after = StageProgress(
        epoch=progress.epoch + finite,
        plateau=_choose(finite, plateau, lowered),
        best_score=jnp.where(better, score, progress.best_score),
        best_epoch=jnp.where(better, progress.epoch + 1, progress.best_epoch),
        rollbacks=progress.rollbacks + (~finite & ~gives_up),
        stopped=gives_up,
    )
    epoch_figures = EpochFigures(
        active=due,
        finite=finite,
        epoch=progress.epoch + 1,
        loss=jnp.where(finite, figures["training"], jnp.nan),
        validation=jnp.where(finite, figures["validation"], jnp.nan),
        rate=rate,
        best=after.best_score,
    )
    state = TrainingState(_choose(finite, attempt, weights), after)
    return _choose(due, state, before), epoch_figures


class _Batches(NamedTuple):
    """The batches of an epoch, this device's share of each: windows, weights, signs, sizes."""

    order: Int[Array, "steps share"]
    weight: Float[Array, "steps share"]
    sign: Float[Array, "steps share"]
    total: Float[Array, " steps"]


def _shuffle(key: Array, count: int, program: _EpochProgram) -> _Batches:
    """Batches of equal size for every device, filled up with windows that weigh nothing."""
    batch = min(program.recipe.batch, count)
    steps = -(-count // batch)
    share = -(-batch // program.mesh.shape[WINDOWS])
    padding = ((0, 0), (0, share * program.mesh.shape[WINDOWS] - batch))
    order = jnp.pad(jax.random.permutation(key, count), (0, steps * batch - count))
    valid = (jnp.arange(steps * batch) < count).astype(jnp.float32)
    order, valid = (jnp.pad(a.reshape(steps, batch), padding) for a in (order, valid))
    signs = jnp.ones(order.shape, jnp.float32)
    if program.recipe.mirror:
        signs = jax.random.rademacher(jax.random.fold_in(key, 1), order.shape, jnp.float32)
    first = jax.lax.axis_index(WINDOWS) * share
    cut = partial(jax.lax.dynamic_slice_in_dim, start_index=first, slice_size=share, axis=1)
    return _Batches(cut(order), cut(valid), cut(signs), jnp.sum(valid, axis=1))


def _train_epoch(
    weights: MemberWeights, rate: Float[Array, ""], inputs: _EpochInputs, program: _EpochProgram
) -> tuple[MemberWeights, Float[Array, ""], Bool[Array, ""]]:
    """A pass over the windows: new weights, mean loss, whether all of it is finite."""
    mask = jax.tree.unflatten(jax.tree.structure(weights.model), program.trainable)
    trainable, frozen = eqx.partition(weights.model, mask)
    average, _ = eqx.partition(weights.average, mask)
    share = 1.0 - (program.recipe.averaging or 0.0)
    optimiser, member = adam_without_rate(program.recipe), inputs.member
    key, for_order = jax.random.split(weights.key)
    batches = _shuffle(for_order, len(member.rows), program)

    def advance(carry: tuple[PyTree, ...], batch: _Batches) -> tuple[Any, Array]:
        trained, average, state = carry

        def compute_loss(trained: PyTree) -> Float[Array, ""]:
            model, rows = eqx.combine(trained, frozen), member.rows[batch.order]
            target, u = gather_windows(inputs.records, member.internal_states, rows, program.loss)
            if program.recipe.mirror:
                target, u = (
                    a * jnp.expand_dims(batch.sign, tuple(range(1, a.ndim))) for a in (target, u)
                )
            losses = compute_window_losses(model, target, u, program.loss)
            return jnp.sum(batch.weight * losses) / batch.total

        loss, gradient = _sum_over_windows(program.mesh, *jax.value_and_grad(compute_loss)(trained))
        update, state = optimiser.update(gradient, state)
        trained = jax.tree.map(lambda p, d: p - rate * d, trained, update)
        average = optax.incremental_update(trained, average, share)
        return (trained, average, state), loss * batch.total

    (trainable, average, state), losses = jax.lax.scan(
        advance, (trainable, average, weights.optimiser), batches
    )
    loss = jnp.sum(losses) / len(member.rows)
    finite = jnp.isfinite(loss)
    for leaf in jax.tree.leaves(trainable):
        finite &= jnp.all(jnp.isfinite(leaf))
    model, average = (eqx.combine(tree, frozen) for tree in (trainable, average))
    return MemberWeights(model, average, state, key, weights.best), loss, finite


def _sum_over_windows(
    mesh: Mesh, loss: Float[Array, ""], gradient: PyTree
) -> tuple[Float[Array, ""], PyTree]:
    """The sum over devices that have the windows of a batch, in one exchange."""
    if mesh.shape[WINDOWS] == 1:
        return loss, gradient
    flat, as_tree = ravel_pytree((loss, gradient))
    return as_tree(jax.lax.psum(flat, WINDOWS))


def _map_members(mesh: Mesh, function: Callable[..., Any], *arguments: Any) -> Any:
    """A function of every member: a core does best what stays in its cache, a GPU all at once."""
    if mesh.devices.flat[0].platform == "cpu":
        return jax.lax.map(lambda member: function(*member), arguments)
    return jax.vmap(function)(*arguments)


def _compute_figures(
    models: Model, loss: Float[Array, " members"], inputs: _EpochInputs, program: _EpochProgram
) -> dict[Criterion, Float[Array, " members"]]:
    """The values of all criteria after an epoch, which decide over best weights and rate."""
    figures: dict[Criterion, Float[Array, " members"]] = {
        "training": loss,
        "validation": jnp.full(loss.shape, jnp.nan, jnp.float32),
    }
    runs, member = inputs.validation_runs, inputs.member
    if runs is not None:
        # long and narrow: all members at once, also where training is member after member
        score = jax.vmap(compute_validation_rmse, in_axes=(0, None, 0, 0))
        figures["validation"] = score(models, runs, member.run_indices, member.run_counts)
        if member.validation_rows.shape[-1]:
            figures["validation-loss"] = _map_members(
                program.mesh,
                lambda model, own: _validation_loss(model, inputs._replace(member=own), program),
                models,
                member,
            )
    return figures


def _validation_loss(
    model: Model, inputs: _EpochInputs, program: _EpochProgram
) -> Float[Array, ""]:
    """The stage's loss over windows that are not trained on."""
    rows, devices = inputs.member.validation_rows, program.mesh.shape[WINDOWS]
    share = -(-len(rows) // devices)
    first = jax.lax.axis_index(WINDOWS) * share
    padded = jnp.pad(rows, (0, share * devices - len(rows)))
    own_rows = jax.lax.dynamic_slice_in_dim(padded, first, share)
    target, u = gather_windows(
        inputs.records, inputs.member.internal_states, own_rows, program.loss
    )
    losses = compute_window_losses(model, target, u, program.loss)
    real = first + jnp.arange(share) < len(rows)
    loss = jnp.sum(jnp.where(real, losses, 0.0)) / len(rows)
    return _sum_over_windows(program.mesh, loss, ())[0]


def gather_windows(
    records: Records,
    internal_states: Float[Array, "rows n_z"],
    rows: Int[Array, " batch"],
    loss: WindowLoss,
) -> tuple[Float[Array, "batch samples n"], Float[Array, "batch steps *drive"]]:
    """The recorded states and the inputs of windows that begin at these rows."""
    steps = loss.lead + loss.length

    def window(row: Array) -> tuple[Array, Array]:
        cut = jax.lax.dynamic_slice_in_dim
        target = cut(records.x, row, steps + 1)
        if internal_states.shape[-1]:
            target = jnp.concatenate([target, cut(internal_states, row, steps + 1)], axis=1)
        return target, cut(records.u, row, steps)

    return jax.vmap(window)(rows)


def compute_window_losses(
    model: Model,
    target: Float[Array, "batch samples n"],
    u: Float[Array, "batch steps *drive"],
    loss: WindowLoss,
) -> Float[Array, " batch"]:
    """The loss of each of a batch of windows.

    Args:
        model: the model.
        target: recorded states, internal ones where windows begin with them.
        u: what drives them.
        loss: what is compared.
    """
    # a stem is folded once a batch, not applied at every step; its gradient passes the fold
    simulator, measured = model.simplify(), model.channels.measured
    lead = target[:, : loss.lead + 1, measured] if loss.lead else None
    x0 = jnp.pad(target[:, 0], ((0, 0), (0, model.state_size - target.shape[-1])))
    simulated = rollouts(simulator, x0, u, lead, only_layers=loss.only_layers)
    return jax.vmap(loss.residual.window_loss)(
        simulated[:, loss.lead :, measured], target[:, loss.lead :, measured]
    )


@eqx.filter_jit
def compute_validation_rmse(
    model: Model,
    runs: FreeRuns,
    run_indices: Int[Array, " runs"],
    run_counts: Float[Array, " runs"],
) -> Float[Array, ""]:
    """Mean over records of the free run's RMSE in float32 [rad or m]; NaN counts as infinite.

    Args:
        model: the model.
        runs: free runs of all records.
        run_indices: which of them.
        run_counts: 1 for those that count.
    """
    simulator = model.simplify()
    # the segments of all records side by side; counted, for where there are no inputs the size of
    # an array says nothing of their number
    count = len(run_indices) * runs.weight.shape[1]
    start_data, u, q, weight = jax.tree.map(
        lambda a: a[run_indices].reshape(count, *a.shape[2:]),
        (runs.start_data, runs.u, runs.q, runs.weight),
    )
    x0 = runs.start.traced_states(simulator, start_data)
    # nothing is differentiated
    states = rollouts(simulator, x0, u, only_layers=True)
    simulated = states[..., model.channels.position]
    # beyond a record's end the model may do anything, also overflow
    error = jnp.where(weight[..., None] > 0, simulated - q, 0.0)
    squares = (weight * jnp.sum(error**2, axis=-1)).reshape(len(run_indices), -1)
    rmse = jnp.sqrt(jnp.sum(squares, axis=-1))
    mean = jnp.sum(run_counts * rmse) / jnp.sum(run_counts)
    return jnp.where(jnp.isfinite(mean), mean, jnp.inf)


def _choose(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(partial(jnp.where, condition), yes, no)
