"""Inputs that are applied one after the other, as the steps of a model take them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tustinnet.export.source import InputLayout, Source, find_input_layout, make_source
from tustinnet.models.contract import Model
from tustinnet.simulate.recent import keep_latest

Vector = Float[np.ndarray, " _"]


class InputHistory:
    """The input samples that a step takes, of now and before: inputs are held between samples.

    Args:
        n_w: the number of all of them, as `Source.n_w`.
    """

    def __init__(self, n_w: int) -> None:
        self._none = np.zeros(n_w)
        self.reset()

    def reset(self) -> None:
        """Begins anew; before the first sample inputs are taken to be 0."""
        self._samples = self._none

    def add(self, u: Vector) -> Vector:
        """The samples of the step that begins now, (n_w,).

        Args:
            u: the inputs from now to the next sample, (n_u,).
        """
        self._samples = np.concatenate([u, self._samples])[: len(self._none)]
        return self._samples


def find_causal_layout(model: Model, delay: int = 0) -> InputLayout:
    """The input samples on which steps depend where inputs are held, delays of them included.

    They are those of now, of a sample before, and so on. Samples to come are taken to be those of
    now.

    Args:
        model: the model.
        delay: samples by which all inputs act late, beside the delays that the model's inputs have.
    """
    layout = find_input_layout(model)
    n_u, lags = model.channels.n_u, [delay + max(0, -offset) for offset in layout.offsets]
    matrix = np.zeros((len(layout.matrix), (max(lags) + 1) * n_u))
    for i, lag in enumerate(lags):
        matrix[:, lag * n_u : (lag + 1) * n_u] += layout.matrix[:, i * n_u : (i + 1) * n_u]
    return InputLayout(tuple(-lag for lag in range(max(lags) + 1)), matrix, layout.shape)


@keep_latest(8)
def causal_source(model: Model, delay: int) -> Source:
    """A model whose step is given inputs as a controller knows them, read once while it is in use.

    Args:
        model: the model.
        delay: as that of `find_causal_layout`.

    Raises:
        InputError: see `make_source`.
    """
    plain = make_source(model)
    return replace(plain, layout=find_causal_layout(plain.model, delay))
