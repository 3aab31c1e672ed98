"""One step of any model, compiled, for control loops."""

from collections.abc import Callable

import jax
import numpy as np
from jaxtyping import Float

from tustinnet.models.contract import Model

Vector = Float[np.ndarray, " _"]


def compiled_step(model: Model) -> Callable[[Vector, Vector], Vector]:
    """A function that steps a model, compiled before it returns; NumPy in and out.

    For a Tustin-Net, `numpy_step` is as fast and needs no JAX. By default JAX computes in another
    thread than the program that calls it. In a control loop this costs more than the step itself
    (28 us instead of 10); `JAX_CPU_ENABLE_ASYNC_DISPATCH=false` in the environment avoids it.

    Args:
        model: the model, discretised if it is a continuous one. Later changes of its values have
            no effect.

    Returns:
        `step(x, u) -> x`, arrays of (n_x,) and (n_u,) in, (n_x,) out. Inputs are held at `u` until
        the next sample, also where the model knows straight lines between samples.
    """
    folded = model.folded()
    size = np.zeros(model.state_size), np.zeros(model.channels.n_u)
    program = jax.jit(lambda x, u: folded.step(x, u)).lower(*size).compile()

    def step(x: Vector, u: Vector) -> Vector:
        return np.asarray(program(np.asarray(x, size[0].dtype), np.asarray(u, size[1].dtype)))

    return step
