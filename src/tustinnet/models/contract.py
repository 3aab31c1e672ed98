"""The interface of models: states, inputs, steps."""

import warnings
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from tustinnet.channels import HasChannels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.blocks import Scaling
from tustinnet.models.step_layout import StepInput, StepInputs, StepLayout
from tustinnet.old_names import METHODS, attribute_error, refuse_old_names
from tustinnet.signals.excitation import Excitation

State = Float[Array, " n_x"]
InputVector = Float[Array, " n_u"]
Internal = Float[Array, " n_z"]
Coordinates = Float[Array, " n_q"]

# of state, inputs of a step, and directions of both, by columns: the next state, and behind it its
# derivatives along these directions, (n_x, 1 + directions)
Directions = Float[Array | np.ndarray, "_ directions"]
StepAlong = Callable[[State, InputVector, Directions, Directions], Float[Array, "n_x columns"]]

SameModel = TypeVar("SameModel")  # a bound by name could not be checked in other modules


class Stateful(HasChannels, eqx.Module):
    """A model with a state, in discrete or in continuous time.

    Attributes:
        channels: its coordinates and inputs, and its sampling period; a field or a property of
            every model.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        methods = [name for name, item in vars(cls).items() if callable(item)]
        refuse_old_names(f"class {cls.__module__}.{cls.__qualname__}", methods, METHODS)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            raise attribute_error(f"'{type(self).__name__}'", name, METHODS)

    def __repr__(self) -> str:
        kinds = Counter(type(model).__name__ for model in self.inner_models)
        inner = "".join(f", {count} {kind}" for kind, count in kinds.items())
        period = f", {self.dt:g} s a sample" if self.dt else ""
        return f"{type(self).__name__}({self.channels.brief}{period}{inner})"

    @property
    def inner_models(self) -> "tuple[Stateful, ...]":
        """The models inside whose internal states are its own, in their order; mostly none."""
        return ()

    @property
    def internal(self) -> tuple[str, ...]:
        """Names of its internal states; most models have none."""
        return tuple(name for model in self.inner_models for name in model.internal)

    @property
    def state_size(self) -> int:
        """`n_x`: positions, velocities, internal states."""
        return 2 * self.channels.n_q + len(self.internal)

    @property
    def initial_needs_inputs(self) -> bool:
        """Whether `initial_internal` depends on inputs; of most models it does not."""
        return any(model.initial_needs_inputs for model in self.inner_models)

    def initial_internal(
        self, measured: Float[Array, " n_measured"], u: InputVector | None = None
    ) -> Internal:
        """Expected internal states at the beginning of a record, (n_z,); mostly 0.

        Args:
            measured: the record's first positions and velocities [q, v], (2 n_q,).
            u: the inputs at its beginning, (n_u,), which only models with `initial_needs_inputs`
                use; None for 0.
        """
        if not self.inner_models:
            return jnp.zeros(len(self.internal), measured.dtype)
        return jnp.concatenate([x.initial_internal(measured, u) for x in self.inner_models])

    @property
    def internal_spread(self) -> Internal:
        """Standard deviations of internal states from the expected ones, (n_z,); mostly 1.

        In the states' units, at the beginning of a record. Starts that search for them use it.
        """
        if not self.inner_models:
            return jnp.asarray(np.ones(len(self.internal)))
        return jnp.concatenate([model.internal_spread for model in self.inner_models])

    @property
    def searched_internal(self) -> Bool[np.ndarray, " n_z"]:
        """Mask of internal states that an identification searches for where a record begins.

        Within `internal_spread` of the expected ones. Of most models these are none: records say
        little of what forces remember.
        """
        if not self.inner_models:
            return np.zeros(len(self.internal), dtype=bool)
        return np.concatenate([model.searched_internal for model in self.inner_models])

    def initial_state(
        self, measured: Float[Array, " n_measured"], u: InputVector | None = None
    ) -> State:
        """The state at the beginning of a record from its first [q, v]; see `initial_internal`."""
        return jnp.concatenate([measured, self.initial_internal(measured, u)])

    def for_record(self: SameModel, experiment: Experiment) -> SameModel:
        """The model that simulates a record, with the values of the record's groups.

        Most models have no values by group and return themselves.

        Raises:
            InputError: a record without the group, or of a value that the model does not have.
        """
        return self


class Model(Stateful):
    """A model that steps from sample to sample; `Channels` has the layout of its state."""

    @abstractmethod
    def step(self, x: State, u: StepInput) -> State:
        """The state one period after `x`.

        Args:
            x: the state, (n_x,).
            u: a row of `step_inputs`; a vector of inputs, (n_u,), is constant over the period.
        """

    def advance(self, x: State, u: StepInput, period: Array | float) -> State:
        """The state `period` [s] after `x`, for models that can step by any period."""
        raise InputError(
            f"a {type(self).__name__}",
            "steps from timestamp to timestamp",
            f"steps of its sampling period, {self.dt:g} s",
            "resample the record",
        )

    @property
    def step_along(self) -> StepAlong | None:
        """The step with derivatives along directions, where these have equations of their own.

        It takes inputs that are constant over the period. By default there is none, and the
        derivatives are those of the step's program.
        """
        return None

    @property
    def step_layout(self) -> StepLayout:
        """The part of the inputs that a step takes; by default their means over the period."""
        return StepLayout(mean=True)

    @final
    def step_inputs(self, inputs: Excitation) -> StepInputs:
        """The inputs of every step along a record, in the model's `step_layout`."""
        return self.step_layout.arrange(inputs)

    @property
    def warm_up(self) -> int:
        """Number of samples that internal states need before a free run; 0 for most models."""
        return 0

    def simplify(self) -> "Model":
        """An equal model that is cheaper to compute; rollouts should use it."""
        return self


class _HasScaling:
    """A model with the units of a network's features and outputs.

    Attributes:
        scaling: the units.
    """

    scaling: Scaling


class AccelerationModel(_HasScaling, Model):
    """A model of accelerations; positions follow the velocities by the trapezoidal rule.

    Such a model can also correct another one (see `HybridModel`).
    """

    @property
    def taps(self) -> tuple[int, ...]:
        """Input samples of a step, counted from the beginning of its period.

        -1 is the sample before, 1 the one after. Most models have none: their input is the mean
        over the period.
        """
        return ()

    @property
    def step_layout(self) -> StepLayout:
        """The input samples at the taps, or the mean over the period."""
        return StepLayout(taps=self.taps) if self.taps else super().step_layout

    def input_at_taps(self, u: StepInput) -> Float[Array, "*taps n_u"]:
        """Inputs at all taps; a vector, (n_u,), is repeated."""
        return jnp.tile(u, (len(self.taps), 1)) if self.taps and u.ndim == 1 else u

    @abstractmethod
    def with_zero_output(self) -> "AccelerationModel":
        """A model of the same structure whose accelerations are zero."""

    @abstractmethod
    def accelerate(
        self, x: State, u: StepInput
    ) -> tuple[Coordinates, Callable[[Coordinates], Internal]]:
        """The mean acceleration over the coming period, and the step of the internal states.

        Returns:
            The acceleration, (n_q,) [rad/s^2 or m/s^2], and a function from the mean velocity
            over the period to the internal states at its end.
        """

    def step(self, x: State, u: StepInput) -> State:
        """`v[k+1] = v[k] + dt a`, `q[k+1] = q[k] + dt (v[k] + v[k+1]) / 2`."""
        q, v = x[self.channels.position], x[self.channels.velocity]
        acceleration, step_internal = self.accelerate(x, u)
        v_next = v + self.dt * acceleration
        mean = (v + v_next) / 2
        return jnp.concatenate([q + self.dt * mean, v_next, step_internal(mean)])


class ContinuousModel(Stateful):
    """A model of the state's derivative; `discretise` makes it a discrete one."""

    @abstractmethod
    def derivative(self, x: State, u: InputVector) -> State:
        """`dx/dt` at a state under an input."""

    def between_samples(self, x: State, u: InputVector) -> "tuple[State, ContinuousModel]":
        """The state from which a model goes on at a sample, and the model until the next.

        Only a model with something that is sampled, as a controller, is another one there, and only
        internal states that settle are others.

        Args:
            x: the state at the sample, (n_x,).
            u: the inputs there, (n_u,).
        """
        return x, self


AnyModel = TypeVar("AnyModel", bound=Stateful)


def with_dtype(model: AnyModel, dtype: DTypeLike) -> AnyModel:
    """A model with its floating-point arrays in another precision."""
    return jax.tree.map(
        lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, model
    )


def require_fit(model: Model, experiment: Experiment) -> None:
    """Raises unless a model has the coordinates, inputs and sampling period of a record."""
    model.channels.require_same(experiment.channels, experiment.name, "the model")


def warn_of_single_precision(what: str) -> None:
    """Warns, once for each place of a program, where JAX computes in single precision."""
    if not jax.config.read("jax_enable_x64"):
        warnings.warn(
            f"{what}: JAX computes in single precision; scores of the model need float64: call "
            "jax.config.update('jax_enable_x64', True) before anything else",
            stacklevel=3,
        )


def require_float64(what: str) -> None:
    """Raises unless JAX computes in double precision."""
    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            what,
            "JAX computes in single precision",
            "float64",
            "call jax.config.update('jax_enable_x64', True) before anything else",
        )
