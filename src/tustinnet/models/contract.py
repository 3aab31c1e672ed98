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
from tustinnet.models.state_encoder import StateEncoder
from tustinnet.signals.excitation import Excitation

State = Float[Array, " n_x"]
InputVector = Float[Array, " n_u"]
StepInput = Float[Array, "*between n_u"]
StepInputs = Float[np.ndarray, "steps *between n_u"]
Internal = Float[Array, " n_z"]
Coordinates = Float[Array, " n_q"]


Own = TypeVar("Own")


class Stateful(HasChannels, eqx.Module):
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

    def initial_internal(self, measured: Float[Array, " n_measured"]) -> Internal:
        """The internal states that are expected where a record begins, (n_z,); mostly 0.

        Args:
            measured: the record's first positions and velocities [q, v], (2 n_q,).
        """
        return jnp.zeros(len(self.internal), measured.dtype)

    @property
    def internal_spread(self) -> Internal:
        """How far internal states may be from those expected, as standard deviations, (n_z,).

        In their units, where a record begins; mostly 1. Starts that search for them use it.
        """
        return jnp.asarray(np.ones(len(self.internal)))

    def initial_state(self, measured: Float[Array, " n_measured"]) -> State:
        """The state in which a record begins, by its first [q, v]; see `initial_internal`."""
        return jnp.concatenate([measured, self.initial_internal(measured)])

    def for_record(self: Own, experiment: Experiment) -> Own:
        """The model that simulates a record: of values by group it takes the record's.

        Most models are the same for every record and return themselves.

        Raises:
            InputError: a record without the group, or of a value that the model does not know.
        """
        return self


class Model(Stateful):
    """A model that steps from sample to sample; `Channels` has the layout of its state."""

    @abstractmethod
    def step(self, x: State, u: StepInput) -> State:
        """The state one period after `x`.

        Args:
            x: the state, (n_x,).
            u: a row of what `seen` makes of the inputs; a vector of inputs, (n_u,), acts unchanged
                over the period.
        """

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The state `period` [s] after `x`, for models that can step by any period."""
        raise InputError(
            f"a {type(self).__name__}", "steps from timestamp to timestamp",
            f"steps of its sampling period, {self.dt:g} s", "resample the record",
        )  # fmt: skip

    def step_inputs(self, inputs: Excitation) -> StepInputs:
        """What each step is given of a record's inputs; by default the mean over the period."""
        return inputs.mean

    @property
    def warm_up(self) -> int:
        """Samples of a record that its internal states need before a free run; 0 for most."""
        return 0

    def simplify(self) -> "Model":
        """The cheapest form of the model that computes the same; what a rollout should use."""
        return self

    @property
    def encoder(self) -> StateEncoder | None:
        """What estimates the state in which a free run starts; None of most models."""
        return None

    @property
    def dynamics(self) -> "Model":
        """What steps: the model without its encoder."""
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

    Attributes:
        taps: the samples of the inputs that it sees in every period, counted from the sample at
            which the period begins: -1 is the one before, 1 the one after. None to see the mean
            over the period.
    """

    @property
    def taps(self) -> tuple[int, ...]:
        """The samples of the inputs that it sees; most models see the mean over the period."""
        return ()

    def step_inputs(self, inputs: Excitation) -> StepInputs:
        """The samples at its taps, (steps, taps, n_u); beyond a record's ends its last samples."""
        if not self.taps:
            return super().step_inputs(inputs)
        last = len(inputs.samples) - 1
        rows = np.arange(last)[:, None] + np.array(self.taps)
        return inputs.samples[np.clip(rows, 0, last)]

    def input_at_taps(self, u: StepInput) -> Float[Array, "*seen n_u"]:
        """Inputs as its network sees them: a vector acts unchanged, at all of its taps."""
        return jnp.tile(u, (len(self.taps), 1)) if self.taps and u.ndim == 1 else u

    @abstractmethod
    def with_zero_output(self) -> "AccelerationModel":
        """The same model with an output of zero."""

    @abstractmethod
    def accelerate(
        self, x: State, u: StepInput
    ) -> tuple[Coordinates, Callable[[Coordinates], Internal]]:
        """The mean acceleration over the coming period, and what becomes of the internal states.

        Returns:
            The acceleration, (n_q,) [rad/s^2 or m/s^2], and a function from the mean velocity
            over the period to the internal states at its end.
        """

    def step(self, x: State, u: StepInput) -> State:
        """`v[k+1] = v[k] + dt a`, `q[k+1] = q[k] + dt (v[k] + v[k+1]) / 2`."""
        q, v = x[self.channels.position], x[self.channels.velocity]
        acceleration, remember = self.accelerate(x, u)
        v_next = v + self.dt * acceleration
        mean = (v + v_next) / 2
        return jnp.concatenate([q + self.dt * mean, v_next, remember(mean)])


class ContinuousModel(Stateful):
    """A model that says how fast the state changes; `discretise` makes it a discrete one."""

    @abstractmethod
    def derivative(self, x: State, u: InputVector) -> State:
        """`dx/dt` at a state under an input."""


AnyModel = TypeVar("AnyModel", bound=Stateful)


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
