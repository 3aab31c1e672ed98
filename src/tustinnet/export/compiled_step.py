"""One step of any model as machine code, for control loops."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tustinnet.engine.engines import make_step
from tustinnet.models.contract import Model, require_float64, with_dtype
from tustinnet.simulate.simulation import step_equations

Vector = Float[np.ndarray, " _"]


def compiled_step(model: Model) -> Callable[[Vector, Vector], Vector]:
    """A function that steps a model, compiled before it returns; NumPy in and out.

    A step takes a few microseconds. It uses memory of its own: each thread needs a function of
    its own.

    Args:
        model: the model, discretised if it is a continuous one. Later changes of its values have
            no effect.

    Returns:
        `step(x, u) -> x`, arrays of (n_x,) and (n_u,) in, (n_x,) out, in double precision. Inputs
        act at once and are held at `u` until the next sample, also where the model's inputs are
        straight lines between samples or act late.

    Raises:
        InputError: float64 is off. The step raises it for arrays of other shapes.
    """
    require_float64("compiled_step")
    folded = with_dtype(model, np.float64).simplify()
    return make_step(step_equations(folded, (model.channels.n_u,)))
