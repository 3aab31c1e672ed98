"""The compiled parts of training: an epoch, and the figures it is judged by."""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float, Int, PyTree

from tustinnet.models.base import DiscreteModel
from tustinnet.simulation.rollout import rollout
from tustinnet.training.losses import window_loss
from tustinnet.training.material import Records, ValidationRuns
from tustinnet.training.recipe import LossName, StageRecipe
from tustinnet.training.state import Stage, Weights


def adam_without_rate(recipe: StageRecipe) -> optax.GradientTransformation:
    """Adam without its rate, which changes from epoch to epoch."""
    clip = optax.clip_by_global_norm(recipe.clip) if recipe.clip else optax.identity()
    return optax.chain(clip, optax.scale_by_adam())


EpochFunction = Callable[
    [Weights, Float[Array, ""], Int[Array, " count"], Records],
    tuple[Weights, Float[Array, ""], Array],
]


def compiled_epoch(stage: Stage) -> EpochFunction:
    """One epoch as one compiled call: shuffle, then a scan over batches."""
    recipe, length = stage.recipe, stage.windows.length
    count = len(stage.windows.rows)
    batch = min(recipe.batch, count)
    steps = -(-count // batch)
    optimiser = adam_without_rate(recipe)

    def epoch(
        weights: Weights, rate: Float[Array, ""], rows: Int[Array, " count"], records: Records
    ) -> tuple[Weights, Float[Array, ""], Array]:
        trainable, frozen = eqx.partition(weights.model, stage.trainable)
        key, for_order = jax.random.split(weights.key)
        order = jax.random.permutation(for_order, count)
        # the last batch is filled up with windows that weigh nothing
        order = jnp.pad(order, (0, steps * batch - count), constant_values=0)
        valid = (jnp.arange(steps * batch) < count).astype(jnp.float32)

        def advance(
            carry: tuple[PyTree, PyTree], chosen: tuple[Array, Array]
        ) -> tuple[tuple[PyTree, PyTree], Array]:
            trained, optimiser_state = carry
            index, weight = chosen
            loss, gradient = jax.value_and_grad(
                partial(_batch_loss, length=length, kind=recipe.loss)
            )(trained, frozen, rows[index], weight, records)
            update, optimiser_state = optimiser.update(gradient, optimiser_state)
            trained = jax.tree.map(lambda p, d: p - rate * d, trained, update)
            return (trained, optimiser_state), loss * jnp.sum(weight)

        (trainable, optimiser_state), losses = jax.lax.scan(
            advance,
            (trainable, weights.optimiser),
            (order.reshape(steps, batch), valid.reshape(steps, batch)),
        )
        loss = jnp.sum(losses) / count
        finite = jnp.isfinite(loss)
        for leaf in jax.tree.leaves(trainable):
            finite &= jnp.all(jnp.isfinite(leaf))
        model = eqx.combine(trainable, frozen)
        return Weights(model, optimiser_state, key, weights.best), loss, finite

    return eqx.filter_jit(epoch)


def _batch_loss(
    trainable: PyTree,
    frozen: PyTree,
    rows: Int[Array, " batch"],
    weight: Float[Array, " batch"],
    records: Records,
    *,
    length: int,
    kind: LossName,
) -> Float[Array, ""]:
    model: DiscreteModel = trainable if frozen is None else eqx.combine(trainable, frozen)
    # a stem is folded once a batch, not applied at every step; its gradient passes the fold
    simulator = model.folded()
    angular = model.angular

    def one(row: Array) -> Array:
        target = jax.lax.dynamic_slice_in_dim(records.x, row, length + 1)
        u = jax.lax.dynamic_slice_in_dim(records.u, row, length)
        return window_loss(rollout(simulator, target[0], u), target, angular, kind)

    return jnp.sum(weight * jax.vmap(one)(rows)) / jnp.sum(weight)


@eqx.filter_jit
def validation_rmse(model: DiscreteModel, runs: ValidationRuns) -> Float[Array, ""]:
    """Mean over records of the free run's RMSE in float32 [rad or m]; NaN counts as infinite."""
    simulator = model.folded()
    n_q = runs.q.shape[-1]
    simulated = jax.vmap(lambda x, u: rollout(simulator, x, u))(runs.x0, runs.u)[..., :n_q]
    # beyond a record's end the model may do anything, also overflow
    error = jnp.where(runs.weight[..., None] > 0, simulated - runs.q, 0.0)
    mean = jnp.mean(jnp.sqrt(jnp.sum(runs.weight * jnp.sum(error**2, axis=-1), axis=-1)))
    return jnp.where(jnp.isfinite(mean), mean, jnp.inf)


@eqx.filter_jit
def held_loss(
    model: DiscreteModel, rows: Int[Array, " count"], records: Records, length: int, kind: LossName
) -> Float[Array, ""]:
    """The stage's loss over windows that are not trained on."""
    weight = jnp.ones(len(rows), jnp.float32)
    return _batch_loss(model, None, rows, weight, records, length=length, kind=kind)
