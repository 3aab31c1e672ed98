"""Rollouts of models with layers by machine code, inside of programs that JAX compiles.

Training needs the gradient of many short rollouts by the weights of layers. A model's step is read
once as a program, its layers' weights left open; machine code of it and of its adjoints does the
steps, and JAX sees one operation with a gradient. XLA would compile the equations of motion for
longer than a short training lasts.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine import engines as engine
from tustinnet.engine import xla
from tustinnet.engine.equations import Equations, ResidualFormula
from tustinnet.engine.xla import Rollouts
from tustinnet.models.blocks import Affine, is_layer
from tustinnet.models.contract import Model
from tustinnet.program.reading import Unreadable

# operations of a step in reverse: with fewer, which are those of a network alone, XLA is as fast;
# more would take LLVM longer than XLA
FEWEST_OPERATIONS, MOST_OPERATIONS = 200, 20_000
_WIDEST = 2000  # units of all layers together; beyond, products of matrices decide, which XLA does


class LayeredSteps(NamedTuple):
    """The steps of a model by machine code, inside of a program that JAX compiles.

    Attributes:
        rollouts: rollouts of all models of its structure.
        weights: the matrices of its layers.
        biases: the biases of these, one behind the other.
        others: all other numbers of the model, one behind the other.
    """

    rollouts: Rollouts
    weights: list[Array]
    biases: Array
    others: Array

    def states(
        self, x0: Float[Array, "batch n_x"], u: Float[Array, "batch steps *input"]
    ) -> Float[Array, "batch samples n_x"]:
        """The states of rollouts, with derivatives by layers and initial states alone."""
        stop = jax.lax.stop_gradient
        return self.rollouts.states(
            self.weights, self.biases, stop(self.others), x0, stop(_flat(x0, u))
        )

    def compare(
        self,
        x0: Float[Array, "batch n_x"],
        u: Float[Array, "batch steps *input"],
        residual: ResidualFormula,
        target: Float[Array, "batch samples n_y"],
        weight: Float[Array, "batch samples n_y"],
    ) -> tuple[Array, Array, Array]:
        """Products of residuals of rollouts and their derivatives, see `Rollouts.compare`."""
        return self.rollouts.compare(
            self.weights, self.biases, self.others, x0, _flat(x0, u), residual, target, weight
        )


def layered_steps(
    model: Model, input_shape: tuple[int, ...], kind: np.dtype | type
) -> LayeredSteps | None:
    """The steps of a model by machine code; its numbers may be traced.

    Args:
        model: the model.
        input_shape: shape of the input that a step takes.
        kind: precision of the computation.

    Returns:
        None where XLA does them as well, or machine code cannot: for networks without physics or
        very wide ones, on another device than the processor, without layers, for a step that no
        program can hold, and for one that is too long.
    """
    leaves, structure = jax.tree.flatten(model, is_leaf=is_layer)
    others = [leaf for leaf in leaves if not is_layer(leaf)]
    layers = [leaf for leaf in leaves if is_layer(leaf)]
    if not layers or not all(eqx.is_inexact_array(leaf) for leaf in others):
        return None
    if engine.current_engine() != "llvm" or not xla.available():
        return None
    shapes = tuple(
        (leaf.weight.shape, leaf.bias is not None) if is_layer(leaf) else leaf.shape
        for leaf in leaves
    )
    if sum(len(layer.weight) for layer in layers) > _WIDEST:
        return None
    rollouts = _rollouts(structure, shapes, model.state_size, input_shape)
    if rollouts is None:
        return None
    biases = [layer.bias for layer in layers if layer.bias is not None]
    empty = jnp.zeros(0, kind)
    return LayeredSteps(
        rollouts,
        [layer.weight.astype(kind) for layer in layers],
        jnp.concatenate([empty, *biases]).astype(kind),
        jnp.concatenate([empty, *map(jnp.ravel, others)]).astype(kind),
    )


def _flat(x0: Array, u: Array) -> Array:
    """The input of each step as a vector of numbers."""
    return u.reshape(*u.shape[:2], math.prod(u.shape[2:])).astype(x0.dtype)


@lru_cache(maxsize=64)
def _rollouts(
    structure: Any, shapes: tuple[Any, ...], n_x: int, input_shape: tuple[int, ...]
) -> Rollouts | None:
    """Rollouts of models of one structure; None where machine code cannot do them."""
    are_layers = [isinstance(shape[-1], bool) if shape else False for shape in shapes]
    matrices = {f"layer{i}": s[0] for i, s in enumerate(shapes) if are_layers[i]}
    bias_sizes = [s[0][0] if s[1] else 0 for i, s in enumerate(shapes) if are_layers[i]]
    other_sizes = [math.prod(s) for i, s in enumerate(shapes) if not are_layers[i]]

    def step(x: Array, u: Array, p: Array, c: Array, *weights: Array) -> Array:
        biases = iter(_cut(p, bias_sizes))
        numbers, matrices = iter(_cut(c, other_sizes)), iter(weights)
        leaves = []
        for shape, has_weight in zip(shapes, are_layers, strict=True):
            if has_weight:
                bias = next(biases)
                leaves.append(Affine(next(matrices), bias if shape[1] else None))
            else:
                leaves.append(next(numbers).reshape(shape))
        model = jax.tree.unflatten(structure, leaves)
        return model.step(x, u.reshape(input_shape))

    equations = Equations(
        step,
        n_x,
        math.prod(input_shape),
        sum(bias_sizes),
        sum(other_sizes),
        continuous=False,
        matrices=matrices,
    )
    try:
        size = equations.adjoints.program.operations
    except Unreadable:
        return None
    return Rollouts(equations) if FEWEST_OPERATIONS <= size <= MOST_OPERATIONS else None


def _cut(numbers: Array, sizes: Sequence[int]) -> list[Array]:
    """Parts of an array, one after the other."""
    ends = np.cumsum(sizes).tolist()
    return [numbers[end - size : end] for size, end in zip(sizes, ends, strict=True)]
