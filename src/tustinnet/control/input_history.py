"""Inputs that are applied one after the other, as the steps of a model take them."""

import numpy as np
from jaxtyping import Float

from tustinnet.export.source import find_input_layout
from tustinnet.models.contract import Model

Vector = Float[np.ndarray, " _"]


class InputHistory:
    """What the steps of a model take of the inputs up to now, delays of its inputs included.

    Inputs are held from sample to sample. A step that takes samples to come is given those of now.

    Args:
        model: the model.

    Attributes:
        shape: the shape of a step's inputs.
        samples: how many samples a step depends on.
    """

    def __init__(self, model: Model) -> None:
        channels = model.channels
        layout = find_input_layout(model, [(i.delay or 0.0) / channels.dt for i in channels.inputs])
        n_u, self.shape = channels.n_u, layout.shape
        lags = [max(0, -offset) for offset in layout.offsets]
        self.samples = max(lags) + 1
        matrix = np.zeros((len(layout.matrix), self.samples * n_u))
        for i, lag in enumerate(lags):
            matrix[:, lag * n_u : (lag + 1) * n_u] += layout.matrix[:, i * n_u : (i + 1) * n_u]
        is_plain = self.samples == 1 and np.array_equal(matrix, np.eye(n_u))
        self._matrix = None if is_plain else matrix
        self._size = self.samples * n_u
        self.reset()

    def reset(self) -> None:
        """Begins anew; before the first sample inputs are taken to be 0."""
        self._past = np.zeros(self._size)

    def add(self, u: Vector) -> Vector:
        """The inputs of the step that begins now, flattened.

        Args:
            u: the inputs from now to the next sample, (n_u,).
        """
        if self._matrix is None:
            return u
        self._past = np.concatenate([u, self._past[: self._size - len(u)]])
        return self._matrix @ self._past
