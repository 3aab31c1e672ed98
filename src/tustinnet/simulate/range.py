"""Where records lie: the smallest and largest states and inputs of a model along them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import refusing
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
        """What the header of a model's file says; None where it says nothing.

        Args:
            header: the whole header.
            model: the model of the file.

        Raises:
            InputError: it says something that is no range of this model.
        """
        told = header.get(KEY)
        if told is None:
            return None
        n_x, n_u = model.state_size, model.channels.n_u
        expected = f"smallest and largest values of {n_x} states and {n_u} inputs"
        with refusing(KEY, "no range of the model", expected):
            states, inputs = (np.array(told[part], float) for part in ("states", "inputs"))
            found = cls(states.reshape(n_x, 2), inputs.reshape(n_u, 2))
        # internal states of a model that diverged are no numbers along its records
        return found if all(np.isfinite(e).all() for e in (states, inputs)) else None


def range_of(model: Model, experiments: Sequence[Experiment]) -> Range:
    """Where records lie, internal states as the model has them along the records."""
    states = np.concatenate(states_along(model, experiments))
    inputs = np.concatenate([e.u for e in experiments])
    return Range(_ends(states), _ends(inputs))


def joined(ranges: Sequence[Range], channels: Channels) -> Range:
    """The range of models that step together, their internal states one after the other.

    Args:
        ranges: of each model.
        channels: what they share.
    """
    measured = [of.states[channels.measured] for of in ranges]
    internal = [of.states[channels.internal] for of in ranges]
    return Range(
        np.concatenate([_around(measured), *internal]), _around([of.inputs for of in ranges])
    )


def _around(ends: Sequence[Float[np.ndarray, "c 2"]]) -> Float[np.ndarray, "c 2"]:
    low, high = np.moveaxis(np.stack(ends), -1, 0)
    return np.stack([low.min(axis=0), high.max(axis=0)], axis=1)


def _ends(signals: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "c 2"]:
    return np.stack([signals.min(axis=0), signals.max(axis=0)], axis=1)
