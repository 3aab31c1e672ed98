"""What every model answers."""

from abc import abstractmethod
from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from tustinnet.channels import HasChannels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.blocks import Scaling

State = Float[Array, " n_x"]
InputVector = Float[Array, " n_u"]
Drive = Float[Array, "*ends n_u"]
Ends = Float[Array | np.ndarray, "*batch 2 n_u"]
Seen = Float[Array | np.ndarray, "*any n_u"]
Internal = Float[Array, " n_z"]
Coordinates = Float[Array, " n_q"]


Own = TypeVar("Own")


class _Stateful(HasChannels, eqx.Module):
    """What discrete and continuous models have in common.

    Attributes:
        channels: the coordinates and inputs that it speaks of, and its sampling period; a field
            or a property of every model.
    """

    @property
    def internal(self) -> tuple[str, ...]:
        """What its internal states are called; most models have none."""
        return ()

    @property
    def state_size(self) -> int:
        """`n_x`: positions, velocities, internal states."""
        return 2 * self.channels.n_q + len(self.internal)

    def of(self: Own, experiment: Experiment) -> Own:
        """The model that simulates a record: of values by group it takes the record's.

        Most models are the same for every record and return themselves.

        Raises:
            InputError: a record without the group, or of a value that the model does not know.
        """
        return self


class Model(_Stateful):
    """A model that steps from sample to sample; `Channels` has the layout of its state."""

    @abstractmethod
    def step(self, x: State, u: Drive) -> State:
        """The state one period after `x`.

        Args:
            x: the state, (n_x,).
            u: what `seen` makes of the inputs at both ends of the period; a vector of inputs,
                (n_u,), acts unchanged over the period.
        """

    def advance(self, x: State, u: Drive, period: Array | float) -> State:
        """The state `period` [s] after `x`, for models that can step by any period."""
        raise InputError(
            f"a {type(self).__name__}", "steps from timestamp to timestamp",
            f"steps of its sampling period, {self.dt:g} s", "resample the record",
        )  # fmt: skip

    def seen(self, ends: Ends) -> Seen:
        """What steps are driven by, of the inputs at both ends of each period: here the mean."""
        return ends.mean(axis=-2)

    @property
    def warm_up(self) -> int:
        """Samples of a record that its internal states need before a free run; 0 for most."""
        return 0

    def folded(self) -> "Model":
        """The cheapest form of the model that computes the same; what a rollout should use."""
        return self


class _HasScaling:
    """Something with the units of what a network sees and says.

    Attributes:
        scaling: the units.
    """

    scaling: Scaling


class AccelerationModel(_HasScaling, Model):
    """A model that says accelerations; positions follow the velocities by the trapezoidal rule.

    Such a model can also correct another one (see `HybridModel`).
    """

    @abstractmethod
    def silent(self) -> "AccelerationModel":
        """The same model with an output of zero."""

    @abstractmethod
    def accelerate(
        self, x: State, u: InputVector
    ) -> tuple[Coordinates, Callable[[Coordinates], Internal]]:
        """The mean acceleration over the coming period, and what becomes of the internal states.

        Returns:
            The acceleration, (n_q,) [rad/s^2 or m/s^2], and a function from the mean velocity
            over the period to the internal states at its end.
        """

    def step(self, x: State, u: InputVector) -> State:
        """`v[k+1] = v[k] + dt a`, `q[k+1] = q[k] + dt (v[k] + v[k+1]) / 2`."""
        q, v = x[self.channels.position], x[self.channels.velocity]
        acceleration, remember = self.accelerate(x, u)
        v_next = v + self.dt * acceleration
        mean = (v + v_next) / 2
        return jnp.concatenate([q + self.dt * mean, v_next, remember(mean)])


class ContinuousModel(_Stateful):
    """A model that says how fast the state changes; `discretise` makes it a discrete one."""

    @abstractmethod
    def derivative(self, x: State, u: InputVector) -> State:
        """`dx/dt` at a state under an input."""


AnyModel = TypeVar("AnyModel", bound=_Stateful)


def with_dtype(model: AnyModel, dtype: DTypeLike) -> AnyModel:
    """The same model with its floating-point arrays in another precision."""
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, model
    )


def require_fit(model: Model, experiment: Experiment) -> None:
    """Raises unless a model speaks of the coordinates, inputs and period of a record."""
    model.channels.require_same(experiment.channels, experiment.name, "the model")


def require_float64(what: str) -> None:
    """Raises unless JAX computes in double precision."""
    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            what,
            "JAX computes in single precision",
            "float64",
            "call jax.config.update('jax_enable_x64', True) before anything else",
        )
