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
from jax.sharding import Mesh
from jax.sharding import PartitionSpec as Spec
from jaxtyping import Array, Bool, Float, Int, PyTree

from tustinnet.models.base import DiscreteModel
from tustinnet.simulation.model_start import model_starts
from tustinnet.simulation.rollout import rollouts
from tustinnet.training.layout import MEMBERS, WINDOWS
from tustinnet.training.losses import window_loss
from tustinnet.training.material import Records, ValidationRuns
from tustinnet.training.plateau import after_epoch
from tustinnet.training.recipe import Criterion, LossName, StageRecipe
from tustinnet.training.state import Course, EpochFigures, Stage, TrainingState, Weights

EPOCHS_A_CALL = 5  # always as many, so that a resumed training runs the same program
ROLLBACKS = 5  # a member gives up after this many in a stage
ROLLBACK_FACTOR = 0.5  # each multiplies the rate


def adam_without_rate(recipe: StageRecipe) -> optax.GradientTransformation:
    """Adam without its rate, which changes from epoch to epoch."""
    clip = optax.clip_by_global_norm(recipe.clip) if recipe.clip else optax.identity()
    return optax.chain(clip, optax.scale_by_adam())


@dataclass(frozen=True)
class _Program:
    """What an epoch is compiled for; the same program serves every training that is alike."""

    recipe: StageRecipe
    length: int
    held_length: int
    trainable: tuple[bool, ...]
    keep: Criterion
    watch: Criterion
    mesh: Mesh


class _Material(NamedTuple):
    """What an epoch reads: of each member its windows, for all members the records."""

    rows: Int[Array, "*members count"]
    held_rows: Int[Array, "*members held"]
    epochs: Int[Array, ""]
    records: Records
    validation: ValidationRuns | None


EpochsFunction = Callable[[TrainingState], tuple[TrainingState, EpochFigures]]


def compiled_epochs(
    stage: Stage, records: Records, validation: ValidationRuns | None, mesh: Mesh
) -> EpochsFunction:
    """Several epochs of all members as one compiled call.

    Each member that has epochs left does up to `EPOCHS_A_CALL`: shuffles, scans over batches,
    runs free over the validation records, notes the best weights, adapts the rate. Weights that
    are not finite are dropped for the last good ones at a lower rate. No member sees another.
    """
    keep = _possible(stage.recipe.keep, stage, validation)
    watched = stage.recipe.plateau.watch if stage.recipe.plateau else "training"
    members = len(stage.windows.rows)
    program = _Program(
        # the name and the number of epochs make no other program
        recipe=stage.recipe.model_copy(update={"name": "", "epochs": 1, "rate": 1.0}),
        length=stage.windows.length,
        held_length=stage.held.length if stage.held else 0,
        trainable=tuple(jax.tree.leaves(stage.trainable)),
        keep=keep,
        watch=_possible(watched, stage, validation),
        mesh=mesh,
    )
    held = stage.held.rows if stage.held else jnp.zeros((members, 0))
    material = _Material(
        rows=jnp.asarray(stage.windows.rows, jnp.int32),
        held_rows=jnp.asarray(held, jnp.int32),
        epochs=jnp.asarray(stage.recipe.epochs, jnp.int32),
        records=records,
        validation=validation,
    )
    return lambda state: _run(state, material, program=program)


def _possible(wanted: Criterion, stage: Stage, validation: ValidationRuns | None) -> Criterion:
    """The criterion, or the next one where there are no records or windows for it."""
    if validation is None:
        return "training"
    if wanted == "validation-loss" and stage.held is None:
        return "validation"  # the validation records are shorter than a window
    return wanted


@partial(jax.jit, static_argnames=("program",))
def _run(
    state: TrainingState, material: _Material, *, program: _Program
) -> tuple[TrainingState, EpochFigures]:
    own, shared = Spec(MEMBERS), Spec()
    reads = _Material(rows=own, held_rows=own, epochs=shared, records=shared, validation=shared)  # pyright: ignore[reportArgumentType]

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
        mine, rows, rate, due = of
        nothing = jnp.full((), jnp.nan, jnp.float32), jnp.zeros((), bool)
        return jax.lax.cond(
            due,
            lambda weights: _trained(weights, rate, material._replace(rows=rows), program),
            lambda weights: (weights, *nothing),
            mine,
        )

    # a core does best what stays in its cache: member after member; a GPU all at once
    on_cpu = program.mesh.devices.flat[0].platform == "cpu"
    each: Any = (lambda f, of: jax.lax.map(f, of)) if on_cpu else (lambda f, of: jax.vmap(f)(of))
    of = (state.weights, material.rows, course.plateau.rate, due)
    attempts, loss, finite = each(attempt, of)
    figures = _figures(attempts.average, loss, material, program, each)
    judge = jax.vmap(partial(_judged, program=program))
    return judge(state, attempts, figures, finite, due)


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
    rate, score = course.plateau.rate, figures[program.keep]
    better = finite & (score < course.best_score)
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


def _trained(
    weights: Weights, rate: Float[Array, ""], material: _Material, program: _Program
) -> tuple[Weights, Float[Array, ""], Bool[Array, ""]]:
    """A pass over the windows: new weights, mean loss, whether all of it is finite."""
    trainable, frozen = _parted(weights.model, program.trainable)
    average, _ = _parted(weights.average, program.trainable)
    kept = program.recipe.averaging or 0.0
    optimiser = adam_without_rate(program.recipe)
    count = len(material.rows)
    batch = min(program.recipe.batch, count)
    steps = -(-count // batch)
    key, for_order = jax.random.split(weights.key)
    # batches of equal size for every device, filled up with windows that weigh nothing
    share = -(-batch // program.mesh.shape[WINDOWS])
    wide = share * program.mesh.shape[WINDOWS]
    order = jnp.pad(jax.random.permutation(for_order, count), (0, steps * batch - count))
    valid = (jnp.arange(steps * batch) < count).astype(jnp.float32)
    filled = ((0, 0), (0, wide - batch))
    order = jnp.pad(order.reshape(steps, batch), filled)
    valid = jnp.pad(valid.reshape(steps, batch), filled)
    total = jnp.sum(valid, axis=1)
    signs = jnp.ones(order.shape, jnp.float32)
    if program.recipe.mirror:
        signs = jax.random.rademacher(jax.random.fold_in(for_order, 1), order.shape, jnp.float32)
    first = jax.lax.axis_index(WINDOWS) * share
    order, valid, signs = (
        jax.lax.dynamic_slice_in_dim(a, first, share, axis=1) for a in (order, valid, signs)
    )

    def advance(carry: tuple[PyTree, ...], chosen: tuple[Array, ...]) -> tuple[Any, Array]:
        trained, average, state = carry
        index, weight, sign, whole = chosen

        def loss_of(trained: PyTree) -> Float[Array, ""]:
            model = eqx.combine(trained, frozen)
            rows = material.rows[index]
            losses = window_losses(
                model, rows, material.records, program.length, program.recipe.loss,
                program.recipe.penalty, sign if program.recipe.mirror else None,
            )  # fmt: skip
            return jnp.sum(weight * losses) / whole

        loss, gradient = _sum_over_windows(program.mesh, *jax.value_and_grad(loss_of)(trained))
        update, state = optimiser.update(gradient, state)
        trained = jax.tree.map(lambda p, d: p - rate * d, trained, update)
        average = jax.tree.map(lambda a, p: p + kept * (a - p), average, trained)
        return (trained, average, state), loss * whole

    (trainable, average, state), losses = jax.lax.scan(
        advance, (trainable, average, weights.optimiser), (order, valid, signs, total)
    )
    loss = jnp.sum(losses) / count
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


def _figures(
    models: DiscreteModel,
    loss: Float[Array, " members"],
    material: _Material,
    program: _Program,
    each: Callable[[Any, Any], Any],
) -> dict[Criterion, Float[Array, " members"]]:
    """What decides over the best weights and the rate after an epoch."""
    figures: dict[Criterion, Float[Array, " members"]] = {
        "training": loss,
        "validation": jnp.full(loss.shape, jnp.nan, jnp.float32),
    }
    if material.validation is not None:
        runs = material.validation
        # long and narrow: all members at once, also where training is member after member
        figures["validation"] = jax.vmap(lambda model: validation_rmse(model, runs))(models)
        if program.held_length:
            figures["validation-loss"] = each(
                lambda of: _held_loss(of[0], of[1], runs.records, program),
                (models, material.held_rows),
            )
    return figures


def _held_loss(
    model: DiscreteModel, rows: Int[Array, " held"], records: Records, program: _Program
) -> Float[Array, ""]:
    """The stage's loss over windows that are not trained on."""
    devices = program.mesh.shape[WINDOWS]
    share = -(-len(rows) // devices)
    first = jax.lax.axis_index(WINDOWS) * share
    filled = jnp.pad(rows, (0, share * devices - len(rows)))
    mine = jax.lax.dynamic_slice_in_dim(filled, first, share)
    losses = window_losses(model, mine, records, program.held_length, program.recipe.loss)
    real = first + jnp.arange(share) < len(rows)
    loss = jnp.sum(jnp.where(real, losses, 0.0)) / len(rows)
    return _sum_over_windows(program.mesh, loss, ())[0]


def window_losses(
    model: DiscreteModel,
    rows: Int[Array, " batch"],
    records: Records,
    length: int,
    kind: LossName,
    penalty: float = 0.0,
    signs: Float[Array, " batch"] | None = None,
) -> Float[Array, " batch"]:
    """The loss of each of a batch of windows, which are gathered from the records by index.

    Where a sign is -1, the window is mirrored: all positions, velocities and inputs.
    """

    def window(row: Array) -> tuple[Array, Array]:
        return (
            jax.lax.dynamic_slice_in_dim(records.x, row, length + 1),
            jax.lax.dynamic_slice_in_dim(records.u, row, length),
        )

    target, u = jax.vmap(window)(rows)
    if signs is not None:
        target, u = (a * jnp.expand_dims(signs, tuple(range(1, a.ndim))) for a in (target, u))
    # a stem is folded once a batch, not applied at every step; its gradient passes the fold
    simulator = model.folded()
    simulated = rollouts(simulator, target[:, 0], u)
    losses = jax.vmap(lambda x, y: window_loss(x, y, model.angular, kind))(simulated, target)
    if penalty:
        effort = jax.vmap(jax.vmap(simulator.effort))(simulated[:, :-1], u)
        losses += penalty * jnp.mean(effort, axis=1)
    return losses


@eqx.filter_jit
def validation_rmse(model: DiscreteModel, runs: ValidationRuns) -> Float[Array, ""]:
    """Mean over records of the free run's RMSE in float32 [rad or m]; NaN counts as infinite."""
    n_q, simulator, x0 = runs.q.shape[-1], model.folded(), runs.x0
    if runs.fitted:
        u, q = runs.u[:, : runs.fitted - 1], runs.q[:, : runs.fitted]
        x0 = model_starts(simulator, x0, u, q)
    simulated = rollouts(simulator, x0, runs.u)[..., :n_q]
    # beyond a record's end the model may do anything, also overflow
    error = jnp.where(runs.weight[..., None] > 0, simulated - runs.q, 0.0)
    mean = jnp.mean(jnp.sqrt(jnp.sum(runs.weight * jnp.sum(error**2, axis=-1), axis=-1)))
    return jnp.where(jnp.isfinite(mean), mean, jnp.inf)


def _parted(model: DiscreteModel, trainable: tuple[bool, ...]) -> tuple[PyTree, PyTree]:
    mask = jax.tree.unflatten(jax.tree.structure(model), trainable)
    return eqx.partition(model, mask)


def _choose(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(partial(jnp.where, condition), yes, no)
