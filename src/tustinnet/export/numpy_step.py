"""A step of a model that needs NumPy only, for control loops."""

import numpy as np

from tustinnet.families.family import NumpyStep, family_of
from tustinnet.models.contract import Model


def numpy_step(model: Model, dtype: type[np.floating] = np.float64) -> NumpyStep:
    """A function that steps a model without JAX.

    Equal to `model.step` to rounding. It is called once a period, as in a controller or an
    estimator, where starting a compiled program would cost more than the arithmetic.

    Args:
        model: a Tustin-Net, so far.
        dtype: precision of weights and states.

    Returns:
        `step(x, u) -> x`, arrays of (n_x,) and (n_u,) in, (n_x,) out.

    Raises:
        InputError: another kind of model.
    """
    return family_of(model).numpy_step(model, dtype)
