"""Rollouts of models with layers by machine code, inside of programs that JAX compiles.

Training needs the gradient of many short rollouts by the weights of layers. A model's step is read
once as a program, its layers' weights left open; machine code of it and of its adjoints does the
steps, and JAX sees one operation with a gradient. XLA would compile the equations of motion for
longer than a short training lasts.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine import runs as engine
from tustinnet.engine.equations import Equations
from tustinnet.engine.xla import Rollouts
from tustinnet.models.blocks import Affine, is_layer
from tustinnet.models.contract import Model
from tustinnet.program.reading import Unreadable

_MOST = 20_000  # operations of a step in reverse; more would take LLVM longer than XLA


def rollouts_by_engine(
    model: Model, x0: Float[Array, "batch n_x"], u: Float[Array, "batch steps *drive"]
) -> Float[Array, "batch samples n_x"] | None:
    """The states of rollouts, as a traced operation whose gradient is that of layers and starts.

    Args:
        model: the model.
        x0: initial states, (batch, n_x).
        u: what the model's steps take, batch first.

    Returns:
        (batch, steps + 1, n_x); None where machine code cannot do it: on another device than the
        processor, for a step that no program can hold, and for one that is too long.
    """
    leaves, structure = jax.tree.flatten(model, is_leaf=is_layer)
    others = [leaf for leaf in leaves if not is_layer(leaf)]
    layers = [leaf for leaf in leaves if is_layer(leaf)]
    if not layers or not all(eqx.is_inexact_array(leaf) for leaf in others):
        return None
    if jax.default_backend() != "cpu" or engine.engine() != "llvm":
        return None
    shapes = tuple(
        (leaf.weight.shape, leaf.bias is not None) if is_layer(leaf) else leaf.shape
        for leaf in leaves
    )
    found = _rollouts(structure, shapes, model.state_size, u.shape[2:])
    if found is None:
        return None
    weights = [layer.weight for layer in layers]
    biases = [layer.bias for layer in layers if layer.bias is not None]
    p = jnp.concatenate([jnp.zeros(0, x0.dtype), *biases])
    c = jnp.concatenate([jnp.zeros(0, x0.dtype), *(jnp.ravel(leaf) for leaf in others)])
    drive = u.reshape(*u.shape[:2], -1).astype(x0.dtype)
    return found.states(weights, p, jax.lax.stop_gradient(c), x0, jax.lax.stop_gradient(drive))


@lru_cache(maxsize=64)
def _rollouts(
    structure: Any, shapes: tuple[Any, ...], n_x: int, drive: tuple[int, ...]
) -> Rollouts | None:
    """Rollouts of models of one structure; None where machine code cannot do them."""
    layered = [isinstance(shape[-1], bool) if shape else False for shape in shapes]
    matrices = {f"layer{i}": s[0] for i, s in enumerate(shapes) if layered[i]}
    biased = [s[0][0] if s[1] else 0 for i, s in enumerate(shapes) if layered[i]]
    other = [math.prod(s) for i, s in enumerate(shapes) if not layered[i]]

    def step(x: Array, u: Array, p: Array, c: Array, *weights: Array) -> Array:
        biases = iter(_cut(p, biased))
        numbers, given = iter(_cut(c, other)), iter(weights)
        leaves = []
        for shape, weighs in zip(shapes, layered, strict=True):
            if weighs:
                bias = next(biases)
                leaves.append(Affine(next(given), bias if shape[1] else None))
            else:
                leaves.append(next(numbers).reshape(shape))
        model = jax.tree.unflatten(structure, leaves)
        return model.step(x, u.reshape(drive))

    equations = Equations(
        step, n_x, math.prod(drive), sum(biased), sum(other), continuous=False, matrices=matrices
    )
    try:
        with jax.ensure_compile_time_eval():
            size = equations.adjoints.program.operations
    except Unreadable:
        return None
    return Rollouts(equations) if size <= _MOST else None


def _cut(numbers: Array, sizes: Sequence[int]) -> list[Array]:
    """Parts of an array, one after the other."""
    ends = np.cumsum(sizes).tolist()
    return [numbers[end - size : end] for size, end in zip(sizes, ends, strict=True)]
