"""Where records lie: the smallest and largest states and inputs of a model along them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import Model
from tustinnet.simulate.along import states_along

KEY = "range"  # in headers of model files


@dataclass(frozen=True)
class Range:
    """Smallest and largest values along records.

    Attributes:
        states: of [q, v, z], (n_x, 2).
        inputs: (n_u, 2).
    """

    states: Float[np.ndarray, "n_x 2"]
    inputs: Float[np.ndarray, "n_u 2"]

    def as_header(self) -> dict[str, Any]:
        """The same as plain values, as model files have it."""
        return {"states": self.states.tolist(), "inputs": self.inputs.tolist()}

    @classmethod
    def from_header(cls, header: Mapping[str, Any], model: Model) -> "Range | None":
        """What the header of a model's file says; None where it says nothing that fits.

        Args:
            header: the whole header.
            model: the model of the file.
        """
        told = header.get(KEY)
        if told is None:
            return None
        found = cls(*(np.array(told[part], float).reshape(-1, 2) for part in ("states", "inputs")))
        fits = len(found.states) == model.state_size and len(found.inputs) == model.channels.n_u
        return found if fits else None


def range_of(model: Model, experiments: Sequence[Experiment]) -> Range:
    """Where records lie, internal states as the model has them along the records."""
    states = np.concatenate(states_along(model, experiments))
    inputs = np.concatenate([e.u for e in experiments])
    return Range(_ends(states), _ends(inputs))


def _ends(signals: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "c 2"]:
    return np.stack([signals.min(axis=0), signals.max(axis=0)], axis=1)
