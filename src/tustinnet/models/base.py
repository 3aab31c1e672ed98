"""What every model answers."""

from abc import abstractmethod
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from tustinnet.data.dataset import require_same_system
from tustinnet.data.experiment import Coordinate, Experiment, Input
from tustinnet.errors import InputError

State = Float[Array, " n_x"]
InputVector = Float[Array, " n_u"]


class DiscreteModel(eqx.Module):
    """A model that steps from sample to sample.

    The state is `x = [q, v, z]` with positions `q` [rad or m], velocities `v` [rad/s or m/s] and,
    in models with memory, internal states `z`.

    Attributes:
        coordinates: the coordinates it speaks of, in the order of `q`.
        inputs: the inputs it takes, in the order of `u`.
        dt: sampling period [s].
    """

    coordinates: eqx.AbstractVar[tuple[Coordinate, ...]]
    inputs: eqx.AbstractVar[tuple[Input, ...]]
    dt: eqx.AbstractVar[float]

    @abstractmethod
    def step(self, x: State, u: InputVector) -> State:
        """The state one period after `x` when `u` acts in between."""

    @property
    def memory(self) -> tuple[str, ...]:
        """What its internal states are called; most models have none."""
        return ()

    @property
    def state_size(self) -> int:
        """`n_x`: positions, velocities, internal states."""
        return 2 * len(self.coordinates) + len(self.memory)

    def effort(self, x: State, u: Float[Array, "*ends n_u"]) -> Float[Array, ""]:
        """How much a network corrects known physics at a state; 0 where there is none to."""
        return jnp.zeros((), x.dtype)

    def drive(self, experiment: Experiment) -> Float[np.ndarray, "steps *drive"]:
        """What a rollout of a record is driven by, a row a period."""
        return experiment.held_inputs

    def folded(self) -> "DiscreteModel":
        """The cheapest form of the model that computes the same; what a rollout should use."""
        return self

    @property
    def angular(self) -> np.ndarray:
        """Which coordinates are angles, (n_q,) of bool."""
        return np.array([c.kind == "angular" for c in self.coordinates])


class ContinuousModel(eqx.Module):
    """A model that says how fast the state changes; an integrator makes it a discrete one.

    Attributes:
        coordinates: the coordinates it speaks of, in the order of `q`.
        inputs: the inputs it takes, in the order of `u`.
    """

    @property
    @abstractmethod
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates it speaks of, in the order of `q`."""

    @property
    @abstractmethod
    def inputs(self) -> tuple[Input, ...]:
        """The inputs it takes, in the order of `u`."""

    @property
    def memory(self) -> tuple[str, ...]:
        """What its internal states are called; most models have none."""
        return ()

    @abstractmethod
    def derivative(self, x: State, u: InputVector) -> State:
        """`dx/dt` at a state under an input."""


AnyModel = TypeVar("AnyModel", bound=DiscreteModel)


def with_dtype(model: AnyModel, dtype: DTypeLike) -> AnyModel:
    """The same model with its floating-point arrays in another precision."""
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, model
    )


def require_fit(model: DiscreteModel, experiment: Experiment) -> None:
    """Raises unless a model speaks of the coordinates, inputs and period of a record."""
    require_same_system(experiment, model.coordinates, model.inputs, "the model")
    if abs(experiment.dt / model.dt - 1) > 1e-6:
        raise InputError(
            experiment.name,
            f"sampling period {experiment.dt:g} s",
            f"{model.dt:g} s as in the model",
            "resample the records, or train a model for this period",
        )
