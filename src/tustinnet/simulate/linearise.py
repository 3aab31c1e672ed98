"""Linear models about a point."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
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
    """Linearises a model by the exact derivatives of its equations.

    Args:
        model: a continuous model, or a discrete one.
        x: the state, usually an equilibrium, (n_x,); `drift` tells how far from one it is.
        u: the inputs there, (n_u,).

    Raises:
        InputError: shapes that the model does not have.
    """
    n_x, n_u = model.state_size, model.channels.n_u
    state, inputs = np.asarray(x, np.float64), np.asarray(u, np.float64)
    if state.shape != (n_x,) or inputs.shape != (n_u,):
        raise InputError(
            "linearize",
            f"x of shape {state.shape}, u of shape {inputs.shape}",
            f"({n_x},) and ({n_u},)",
        )
    discrete = isinstance(model, Model)
    function = model.step if discrete else model.derivative
    formula = Formula(
        lambda point: function(point[:n_x], point[n_x:]),
        n_x + n_u,
        where=f"the model ({type(model).__name__})",
    )
    value, jacobian = value_and_jacobian(formula, np.concatenate([state, inputs]))
    return Linearisation(
        jacobian[:, :n_x],
        jacobian[:, n_x:],
        value - state if discrete else value,
        model.dt if discrete else None,
    )


def value_and_jacobian(
    formula: Formula, point: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m n_by"]]:
    """The value of a formula at a point, (m,), and its derivatives there, (m, n_by)."""
    points = point[None]
    value = evaluate(formula, points)[0]
    return value, evaluate(formula, points, derivatives=True).reshape(len(value), -1)
