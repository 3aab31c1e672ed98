"""One step of any model, compiled, for control loops."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Float

from tustinnet.models.contract import Model

Vector = Float[np.ndarray, " _"]


def compiled_step(model: Model) -> Callable[[Vector, Vector], Vector]:
    """A function that steps a model, compiled before it returns; NumPy in and out.

    Of a Tustin-Net `numpy_step` is as fast and needs no JAX. JAX usually computes beside the
    program that calls it, which costs a control loop more than the step itself (28 us instead
    of 10): start the program with `JAX_CPU_ENABLE_ASYNC_DISPATCH=false`.

    Args:
        model: the model; of a continuous one the discretised form. Its values are built in.

    Returns:
        `step(x, u) -> x`, arrays of (n_x,) and (n_u,) in, (n_x,) out. What a model is driven by
        between two samples (straight lines) is held at `u`.
    """
    folded = model.folded()
    size = np.zeros(model.state_size), np.zeros(model.channels.n_u)
    program = jax.jit(lambda x, u: folded.step(x, u)).lower(*size).compile()

    def step(x: Vector, u: Vector) -> Vector:
        return np.asarray(program(np.asarray(x, size[0].dtype), np.asarray(u, size[1].dtype)))

    return step
