"""The compiled parts of training: epochs of all members, and the figures they are judged by."""

from collections.abc import Callable
from dataclasses import dataclass, replace
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

from tustinnet.families.family import Regulariser
from tustinnet.fitting.free_runs import FreeRuns
from tustinnet.fitting.gradient.layout import MEMBERS, WINDOWS
from tustinnet.fitting.gradient.material import Records
from tustinnet.fitting.gradient.plan import Plan
from tustinnet.fitting.gradient.plateau import after_epoch, decayed
from tustinnet.fitting.gradient.state import (
    Course,
    EpochFigures,
    Stage,
    TrainingState,
    Weights,
    adam_without_rate,
)
from tustinnet.fitting.recipe import Criterion, Kept, StageRecipe
from tustinnet.fitting.residual import Residual
from tustinnet.models.blocks import is_layer
from tustinnet.models.contract import Model
from tustinnet.simulate.rollout import rollouts

EPOCHS_A_CALL = 5  # always as many, so that a resumed training runs the same program
ROLLBACKS = 5  # a member gives up after this many in a stage
ROLLBACK_FACTOR = 0.5  # each multiplies the rate


@dataclass(frozen=True)
class WindowLoss:
    """What a window is compared by.

    Attributes:
        residual: what is compared.
        length: steps in a window that are.
        lead: steps before them, see `StageWindows`.
        regulariser: what the model's family adds to the loss at every step, if anything.
        only_layers: whether nothing trains but `Affine` layers, see `rollouts`.
    """

    residual: Residual
    length: int
    lead: int = 0
    regulariser: Regulariser | None = None
    only_layers: bool = False


@dataclass(frozen=True)
class _Program:
    """What an epoch is compiled for; the same program serves every training that is alike."""

    recipe: StageRecipe
    loss: WindowLoss
    watched: bool
    trainable: tuple[bool, ...]
    keep: Criterion
    watch: Criterion
    mesh: Mesh


class _Own(NamedTuple):
    """What an epoch reads of each member: windows, internal states, which free runs are its."""

    rows: Int[Array, "*members count"]
    watched: Int[Array, "*members watched"]
    internal: Float[Array, "*members rows n_z"]
    chosen: Int[Array, "*members runs"]
    counted: Float[Array, "*members runs"]


class _Material(NamedTuple):
    """What an epoch reads: of each member its own, and what all share."""

    own: _Own
    epochs: Int[Array, ""]
    records: Records
    validation: FreeRuns | None


EpochsFunction = Callable[[TrainingState], tuple[TrainingState, EpochFigures]]


def compiled_epochs(prepared: Plan, stage: Stage) -> EpochsFunction:
    """Several epochs of all members as one compiled call.

    Each member that has epochs left does up to `EPOCHS_A_CALL`: shuffles, scans over batches,
    runs free over its validation records, notes the best weights, adapts the rate. Weights that
    are not finite are dropped for the last good ones at a lower rate. No member sees another.
    """
    validation, recipe, windows = prepared.validation, stage.recipe, stage.windows
    wanted = recipe.plateau.watch if recipe.plateau else "training"
    program = _Program(
        # the name and the number of epochs make no other program
        recipe=recipe.model_copy(update={"name": "", "epochs": 1, "rate": 1.0}),
        loss=WindowLoss(
            stage.residual,
            windows.length,
            windows.lead,
            stage.regulariser,
            only_layers=_only_layers(prepared.models, stage.trainable),
        ),
        watched=stage.watched is not None and validation is not None,
        trainable=tuple(jax.tree.leaves(stage.trainable)),
        keep=_possible(recipe.keep, stage, validation),
        watch=_possible(wanted, stage, validation),
        mesh=prepared.mesh,
    )
    watched = stage.watched.rows if stage.watched else jnp.zeros((len(windows.rows), 0))
    own = _Own(
        rows=jnp.asarray(windows.rows, jnp.int32),
        watched=jnp.asarray(watched, jnp.int32),
        internal=prepared.internal,
        chosen=prepared.chosen,
        counted=prepared.counted,
    )
    epochs = jnp.asarray(recipe.epochs, jnp.int32)
    material = _Material(own, epochs, prepared.records, validation)
    # laid out as the first call takes it: arrays without entries come back laid out otherwise, and
    # another layout would be compiled for anew
    layout = NamedSharding(prepared.mesh, Spec(MEMBERS))
    return lambda state: _run(jax.device_put(state, layout), material, program=program)


def _only_layers(models: Model, trainable: PyTree) -> bool:
    """Whether all that trains belongs to layers."""
    layers = jax.tree.map(is_layer, models, is_leaf=is_layer)
    each = jax.tree.map(lambda layer, mask: layer or not mask, layers, trainable)
    return all(jax.tree.leaves(each))


def _possible(wanted: Kept, stage: Stage, validation: FreeRuns | None) -> Criterion:
    """The criterion, or the next one where there are no records or windows for it."""
    if validation is None or wanted == "last":
        return "training"
    if wanted == "validation-loss" and stage.watched is None:
        return "validation"  # the validation records are shorter than a window
    return wanted


@partial(jax.jit, static_argnames=("program",))
def _run(
    state: TrainingState, material: _Material, *, program: _Program
) -> tuple[TrainingState, EpochFigures]:
    own, shared = Spec(MEMBERS), Spec()
    reads = _Material(own=own, epochs=shared, records=shared, validation=shared)  # pyright: ignore[reportArgumentType]

    def of_device(state: TrainingState, material: _Material) -> tuple[TrainingState, EpochFigures]:
        return jax.lax.scan(lambda s, _: _epoch(s, material, program), state, length=EPOCHS_A_CALL)

    spread = jax.shard_map(
        of_device, mesh=program.mesh, in_specs=(own, reads), out_specs=(own, Spec(None, MEMBERS)),
        check_vma=False,
    )  # fmt: skip
    return spread(state, material)


def _epoch(
    state: TrainingState, material: _Material, program: _Program
) -> tuple[TrainingState, EpochFigures]:
    """An epoch of all members of a device that have one to do."""
    course = state.course
    due = (course.epoch < material.epochs) & ~course.stopped
    if program.recipe.patience is not None:
        due &= course.epoch - course.best_epoch < program.recipe.patience

    def attempt(of: tuple[Any, ...]) -> tuple[Weights, Array, Array]:
        mine, own, rate, due = of
        nothing = jnp.full((), jnp.nan, jnp.float32), jnp.zeros((), bool)
        return jax.lax.cond(
            due,
            lambda weights: _trained(weights, rate, material._replace(own=own), program),
            lambda weights: (weights, *nothing),
            mine,
        )

    rate = decayed(course.plateau.rate, course.epoch, material.epochs, program.recipe)
    of = (state.weights, material.own, rate, due)
    attempts, loss, finite = _each(program.mesh, attempt, of)
    figures = _figures(attempts.average, loss, material, program)
    judge = jax.vmap(partial(_judged, program=program))
    after, told = judge(state, attempts, figures, finite, due)
    return after, told._replace(rate=rate)


def _judged(
    before: TrainingState,
    attempt: Weights,
    figures: dict[Criterion, Float[Array, ""]],
    finite: Bool[Array, ""],
    due: Bool[Array, ""],
    *,
    program: _Program,
) -> tuple[TrainingState, EpochFigures]:
    """What becomes of a member after an epoch: its best weights, its rate, where it is."""
    weights, course = before
    rate, last = course.plateau.rate, program.recipe.keep == "last"
    score = figures[program.keep]
    better = finite & (last | (score < course.best_score))
    plateau = after_epoch(course.plateau, figures[program.watch], program.recipe.plateau)
    attempt = attempt._replace(best=_choose(better, attempt.average, weights.best))
    gives_up = ~finite & (course.rollbacks >= ROLLBACKS)
    lowered = course.plateau._replace(rate=jnp.where(gives_up, rate, rate * ROLLBACK_FACTOR))
    after = Course(
        epoch=course.epoch + finite,
        plateau=_choose(finite, plateau, lowered),
        best_score=jnp.where(better, score, course.best_score),
        best_epoch=jnp.where(better, course.epoch + 1, course.best_epoch),
        rollbacks=course.rollbacks + (~finite & ~gives_up),
        stopped=gives_up,
    )
    told = EpochFigures(
        active=due,
        finite=finite,
        epoch=course.epoch + 1,
        loss=jnp.where(finite, figures["training"], jnp.nan),
        validation=jnp.where(finite, figures["validation"], jnp.nan),
        rate=rate,
        best=after.best_score,
    )
    kept = TrainingState(_choose(finite, attempt, weights), after)
    return _choose(due, kept, before), told


class _Batches(NamedTuple):
    """The batches of an epoch, this device's share of each: windows, weights, signs, sizes."""

    order: Int[Array, "steps share"]
    weight: Float[Array, "steps share"]
    sign: Float[Array, "steps share"]
    total: Float[Array, " steps"]


def _shuffled(key: Array, count: int, program: _Program) -> _Batches:
    """Batches of equal size for every device, filled up with windows that weigh nothing."""
    batch = min(program.recipe.batch, count)
    steps = -(-count // batch)
    share = -(-batch // program.mesh.shape[WINDOWS])
    filled = ((0, 0), (0, share * program.mesh.shape[WINDOWS] - batch))
    order = jnp.pad(jax.random.permutation(key, count), (0, steps * batch - count))
    valid = (jnp.arange(steps * batch) < count).astype(jnp.float32)
    order, valid = (jnp.pad(a.reshape(steps, batch), filled) for a in (order, valid))
    signs = jnp.ones(order.shape, jnp.float32)
    if program.recipe.mirror:
        signs = jax.random.rademacher(jax.random.fold_in(key, 1), order.shape, jnp.float32)
    first = jax.lax.axis_index(WINDOWS) * share
    cut = partial(jax.lax.dynamic_slice_in_dim, start_index=first, slice_size=share, axis=1)
    return _Batches(cut(order), cut(valid), cut(signs), jnp.sum(valid, axis=1))


def _trained(
    weights: Weights, rate: Float[Array, ""], material: _Material, program: _Program
) -> tuple[Weights, Float[Array, ""], Bool[Array, ""]]:
    """A pass over the windows: new weights, mean loss, whether all of it is finite."""
    trainable, frozen = _parted(weights.model, program.trainable)
    average, _ = _parted(weights.average, program.trainable)
    taken = 1.0 - (program.recipe.averaging or 0.0)
    optimiser, own = adam_without_rate(program.recipe), material.own
    key, for_order = jax.random.split(weights.key)
    batches = _shuffled(for_order, len(own.rows), program)

    def advance(carry: tuple[PyTree, ...], batch: _Batches) -> tuple[Any, Array]:
        trained, average, state = carry

        def loss_of(trained: PyTree) -> Float[Array, ""]:
            model, rows = eqx.combine(trained, frozen), own.rows[batch.order]
            target, u = gathered(material.records, own.internal, rows, program.loss)
            if program.recipe.mirror:
                target, u = (
                    a * jnp.expand_dims(batch.sign, tuple(range(1, a.ndim))) for a in (target, u)
                )
            return (
                jnp.sum(batch.weight * window_losses(model, target, u, program.loss)) / batch.total
            )

        loss, gradient = _sum_over_windows(program.mesh, *jax.value_and_grad(loss_of)(trained))
        update, state = optimiser.update(gradient, state)
        trained = jax.tree.map(lambda p, d: p - rate * d, trained, update)
        average = optax.incremental_update(trained, average, taken)
        return (trained, average, state), loss * batch.total

    (trainable, average, state), losses = jax.lax.scan(
        advance, (trainable, average, weights.optimiser), batches
    )
    loss = jnp.sum(losses) / len(own.rows)
    finite = jnp.isfinite(loss)
    for leaf in jax.tree.leaves(trainable):
        finite &= jnp.all(jnp.isfinite(leaf))
    model, average = (eqx.combine(tree, frozen) for tree in (trainable, average))
    return Weights(model, average, state, key, weights.best), loss, finite


def _sum_over_windows(
    mesh: Mesh, loss: Float[Array, ""], gradient: PyTree
) -> tuple[Float[Array, ""], PyTree]:
    """The sum over devices that have the windows of a batch, in one exchange."""
    if mesh.shape[WINDOWS] == 1:
        return loss, gradient
    flat, as_tree = ravel_pytree((loss, gradient))
    return as_tree(jax.lax.psum(flat, WINDOWS))


def _each(mesh: Mesh, function: Callable[[Any], Any], of: Any) -> Any:
    """A function of every member: a core does best what stays in its cache, a GPU all at once."""
    on_cpu = mesh.devices.flat[0].platform == "cpu"
    return jax.lax.map(function, of) if on_cpu else jax.vmap(function)(of)


def _figures(
    models: Model, loss: Float[Array, " members"], material: _Material, program: _Program
) -> dict[Criterion, Float[Array, " members"]]:
    """What decides over the best weights and the rate after an epoch."""
    figures: dict[Criterion, Float[Array, " members"]] = {
        "training": loss,
        "validation": jnp.full(loss.shape, jnp.nan, jnp.float32),
    }
    runs, own = material.validation, material.own
    if runs is not None:
        # long and narrow: all members at once, also where training is member after member
        score = jax.vmap(validation_rmse, in_axes=(0, None, 0, 0))
        figures["validation"] = score(models, runs, own.chosen, own.counted)
        if program.watched:
            figures["validation-loss"] = _each(
                program.mesh,
                lambda of: _watched_loss(of[0], material._replace(own=of[1]), program),
                (models, own),
            )
    return figures


def _watched_loss(model: Model, material: _Material, program: _Program) -> Float[Array, ""]:
    """The stage's loss over windows that are not trained on."""
    rows, devices = material.own.watched, program.mesh.shape[WINDOWS]
    share = -(-len(rows) // devices)
    first = jax.lax.axis_index(WINDOWS) * share
    filled = jnp.pad(rows, (0, share * devices - len(rows)))
    mine = jax.lax.dynamic_slice_in_dim(filled, first, share)
    plain = replace(program.loss, regulariser=None)
    target, u = gathered(material.records, material.own.internal, mine, plain)
    losses = window_losses(model, target, u, plain)
    real = first + jnp.arange(share) < len(rows)
    loss = jnp.sum(jnp.where(real, losses, 0.0)) / len(rows)
    return _sum_over_windows(program.mesh, loss, ())[0]


def gathered(
    records: Records,
    internal: Float[Array, "rows n_z"],
    rows: Int[Array, " batch"],
    loss: WindowLoss,
) -> tuple[Float[Array, "batch samples n"], Float[Array, "batch steps *drive"]]:
    """The recorded states and the inputs of windows that begin at these rows."""
    steps = loss.lead + loss.length

    def window(row: Array) -> tuple[Array, Array]:
        cut = jax.lax.dynamic_slice_in_dim
        target = cut(records.x, row, steps + 1)
        if internal.shape[-1]:
            target = jnp.concatenate([target, cut(internal, row, steps + 1)], axis=1)
        return target, cut(records.u, row, steps)

    return jax.vmap(window)(rows)


def window_losses(
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
    simulator, encoder, of = model.simplify().dynamics, model.encoder, model.channels
    lead, compared = target[:, : loss.lead + 1], slice(loss.lead, None)
    if encoder is not None:
        begin = jax.vmap(partial(encoder, of))(lead[..., of.position], u[:, : loss.lead])
        simulated = rollouts(simulator, begin, u[:, compared], only_layers=loss.only_layers)
    else:
        blank = ((0, 0), (0, model.state_size - target.shape[-1]))
        measured = lead[..., of.measured] if loss.lead else None
        begin = jnp.pad(target[:, 0], blank)
        states = rollouts(simulator, begin, u, measured, only_layers=loss.only_layers)
        simulated = states[:, compared]
    losses = jax.vmap(loss.residual.window_loss)(
        simulated[..., of.measured], target[:, compared, of.measured]
    )
    if loss.regulariser is not None:
        added = jax.vmap(jax.vmap(partial(loss.regulariser, simulator)))
        losses += jnp.mean(added(simulated[:, :-1], u[:, compared]), axis=1)
    return losses


@eqx.filter_jit
def validation_rmse(
    model: Model,
    runs: FreeRuns,
    chosen: Int[Array, " runs"],
    counted: Float[Array, " runs"],
) -> Float[Array, ""]:
    """Mean over records of the free run's RMSE in float32 [rad or m]; NaN counts as infinite.

    Args:
        model: the model.
        runs: free runs of all records.
        chosen: which of them.
        counted: 1 for those that count.
    """
    simulator = model.simplify()
    # the segments of all records side by side; counted, for where there are no inputs the size of
    # an array says nothing of their number
    count = len(chosen) * runs.weight.shape[1]
    material, u, q, weight = jax.tree.map(
        lambda a: a[chosen].reshape(count, *a.shape[2:]),
        (runs.material, runs.u, runs.q, runs.weight),
    )
    x0 = runs.start.states(simulator, material)
    # nothing is differentiated
    states = rollouts(simulator, x0, u, only_layers=True)
    simulated = states[..., model.channels.position]
    # beyond a record's end the model may do anything, also overflow
    error = jnp.where(weight[..., None] > 0, simulated - q, 0.0)
    squares = (weight * jnp.sum(error**2, axis=-1)).reshape(len(chosen), -1)
    each = jnp.sqrt(jnp.sum(squares, axis=-1))
    mean = jnp.sum(counted * each) / jnp.sum(counted)
    return jnp.where(jnp.isfinite(mean), mean, jnp.inf)


def _parted(model: Model, trainable: tuple[bool, ...]) -> tuple[PyTree, PyTree]:
    mask = jax.tree.unflatten(jax.tree.structure(model), trainable)
    return eqx.partition(model, mask)


def _choose(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(partial(jnp.where, condition), yes, no)
