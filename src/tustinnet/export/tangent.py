"""A step about an operating point, as matrices."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.simulate.linearise import value_and_jacobian


@dataclass(frozen=True)
class Tangent:
    """`x[k+1] - x = drift + a (x[k] - x) + b (u[k] - u)`.

    Attributes:
        x: the state of the operating point, (n_x,).
        u: the inputs there, of all samples that a step takes, (n_w,).
        a: derivatives by the state, (n_x, n_x).
        b: derivatives by the inputs, (n_x, n_w).
        drift: how far a step leads away from the point, (n_x,); 0 at an equilibrium.
    """

    x: Float[np.ndarray, " n_x"]
    u: Float[np.ndarray, " n_w"]
    a: Float[np.ndarray, "n_x n_x"]
    b: Float[np.ndarray, "n_x n_w"]
    drift: Float[np.ndarray, " n_x"]


def compute_tangent(
    source: Source, x: Float[np.ndarray, " n_x"], u: Float[np.ndarray, " n_u"]
) -> Tangent:
    """A step about an operating point, by its exact derivatives.

    Args:
        source: the model.
        x: the state, (n_x,).
        u: the inputs, (n_u,), equal at all samples that a step takes.

    Raises:
        InputError: other shapes, or derivatives that are not finite there.
    """
    n_x, n_u = source.n_x, source.channels.n_u
    if np.shape(x) != (n_x,) or np.shape(u) != (n_u,):
        raise InputError(
            "operating point",
            f"x of shape {np.shape(x)}, u of shape {np.shape(u)}",
            f"({n_x},) and ({n_u},)",
        )
    state = np.asarray(x, float)
    inputs = np.tile(np.asarray(u, float), len(source.input_layout.offsets))
    point = np.concatenate([state, inputs])
    following, jacobian = value_and_jacobian(source.batched_step, point)
    if not (np.isfinite(following).all() and np.isfinite(jacobian).all()):
        raise InputError(
            "operating point",
            "derivatives that are not finite",
            "a point where the model is smooth",
        )
    return Tangent(state, inputs, jacobian[:, :n_x], jacobian[:, n_x:], following - state)


def operating_point(
    source: Source, named: Mapping[str, float]
) -> tuple[Float[np.ndarray, " n_x"], Float[np.ndarray, " n_u"]]:
    """States and inputs of an operating point, 0 where they are not named.

    Raises:
        InputError: a name that the model does not have, or a value that is not finite.
    """
    inputs = tuple(i.name for i in source.channels.inputs)
    names = (*source.states, *inputs)
    for name, value in named.items():
        if name not in names:
            raise InputError(
                "operating point", f"no state or input '{name}'", f"some of {', '.join(names)}"
            )
        if not np.isfinite(value):
            raise InputError("operating point", f"{name} = {value}", "a finite value")
    x = np.array([named.get(name, 0.0) for name in source.states])
    return x, np.array([named.get(name, 0.0) for name in inputs])
