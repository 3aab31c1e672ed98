"""Layers of networks, whatever they stand in."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "leaky_relu": lambda z: jax.nn.leaky_relu(z, 0.01),
    "relu": jax.nn.relu,
    "tanh": jnp.tanh,
    "silu": jax.nn.silu,
    "softplus": jax.nn.softplus,
}


class Affine(eqx.Module):
    """`z -> W z + b`, the bias optional.

    Attributes:
        weight: `W`, (n_out, n_in).
        bias: `b`, (n_out,), or None.
    """

    weight: Float[Array, "n_out n_in"]
    bias: Float[Array, " n_out"] | None

    def __call__(self, z: Float[Array, " n_in"]) -> Float[Array, " n_out"]:
        """Applies the map."""
        product = z @ self.weight.T
        return product if self.bias is None else product + self.bias


def fold(first: Affine, second: Affine) -> Affine:
    """The affine map that applies `first`, then `second`."""
    bias = second.bias
    if first.bias is not None:
        carried = second.weight @ first.bias
        bias = carried if bias is None else bias + carried
    return Affine(second.weight @ first.weight, bias)


def random_affine(n_in: int, n_out: int, key: PRNGKeyArray, *, bias: bool = True) -> Affine:
    """Float32 weights, and perhaps biases, uniform within 1/sqrt(n_in) of 0."""
    bound = n_in**-0.5
    for_weight, for_bias = jax.random.split(key)
    weight = jax.random.uniform(for_weight, (n_out, n_in), jnp.float32, -bound, bound)
    if not bias:
        return Affine(weight, None)
    return Affine(weight, jax.random.uniform(for_bias, (n_out,), jnp.float32, -bound, bound))
