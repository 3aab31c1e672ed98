"""Linear models about a point."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.errors import InputError
from tustinnet.models.contract import ContinuousModel, Model


@dataclass(frozen=True)
class Linearisation:
    """`dx' = A dx + B du` about a point, or `dx[k+1] = A dx[k] + B du[k]` of a discrete model.

    Attributes:
        a: A, (n_x, n_x).
        b: B, (n_x, n_u).
        drift: how fast the point itself moves, (n_x,) [per second; per sample of a discrete model];
            0 at an equilibrium.
        dt: sampling period of a discrete model [s], None of a continuous one.
    """

    a: Float[np.ndarray, "n_x n_x"]
    b: Float[np.ndarray, "n_x n_u"]
    drift: Float[np.ndarray, " n_x"]
    dt: float | None


def linearize(
    model: ContinuousModel | Model,
    x: Float[Array | np.ndarray, " n_x"],
    u: Float[Array | np.ndarray, " n_u"],
) -> Linearisation:
    """Linearises a model by automatic differentiation.

    Args:
        model: a continuous model, or a discrete one.
        x: the state, usually an equilibrium, (n_x,); `drift` tells how far from one it is.
        u: the inputs there, (n_u,).

    Raises:
        InputError: shapes that the model does not have.
    """
    n_x, n_u = model.state_size, model.channels.n_u
    state, inputs = jnp.asarray(x), jnp.asarray(u)
    if state.shape != (n_x,) or inputs.shape != (n_u,):
        raise InputError(
            "linearize",
            f"x of shape {state.shape}, u of shape {inputs.shape}",
            f"({n_x},) and ({n_u},)",
        )
    discrete = isinstance(model, Model)
    function = model.step if discrete else model.derivative
    value, (a, b) = value_and_jacobians(function, state, inputs)
    return Linearisation(
        np.asarray(a),
        np.asarray(b),
        np.asarray(value - state if discrete else value),
        model.dt if discrete else None,
    )


def value_and_jacobians(
    function: Callable[..., Array], *point: Any
) -> tuple[Array, tuple[Array, ...]]:
    """The value of a function at a point and its Jacobians by each argument, computed once.

    Args:
        function: from vectors, (n,) each, to a vector, (m,).
        point: the vectors.

    Returns:
        The value, (m,), and for each argument the derivatives, (m, n).
    """

    def twice(*point: Array) -> tuple[Array, Array]:
        value = function(*point)
        return value, value

    jacobians, value = jax.jacfwd(twice, argnums=tuple(range(len(point))), has_aux=True)(*point)
    return value, jacobians
