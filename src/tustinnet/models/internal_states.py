"""Internal states of systems, beside the positions and velocities of their coordinates.

Forces that remember, actuators that lag and controllers are each a `Memory`, and several of them
are one. `InternalStates` is all that a system has: coordinates without a sensor, then its memory.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from tustinnet.errors import InputError
from tustinnet.models.contract import Coordinates, InputVector, Internal

Values = Mapping[str, Any]
AllCoordinates = Float[Array, " n_all"]  # measured ones, then the others


def takes_inputs(function: Callable[..., Any], arguments: str) -> bool:
    """Whether a function of a system takes the inputs u beside other arguments.

    Args:
        function: the function.
        arguments: its arguments without the inputs, a letter each, the parameters last: `qvzp`.

    Raises:
        TypeError: it takes neither as many arguments nor one more; the message has both forms.
    """
    try:
        signature = inspect.signature(function)
    except ValueError:  # of some functions in C nothing is known
        return False
    with_inputs = f"{arguments[:-1]}u{arguments[-1]}"
    for form in (arguments, with_inputs):
        try:
            signature.bind(*form)
        except TypeError:
            continue
        return form is with_inputs
    forms = " or ".join(f"({', '.join(form)})" for form in (arguments, with_inputs))
    raise TypeError(f"the arguments {signature}; expected {forms}")


@dataclass(frozen=True)
class Memory:
    """Equations of internal states `z`: forces with memory, lags of actuators, controllers.

    Functions may also take the inputs, before the parameters. So a motor or a fan
    that lags behind its command is written: `rate(q, v, z, u, p)` returns `(u - z) / p["lag"]`.

    Attributes:
        names: names of the internal states.
        rate: `dz/dt = rate(q, v, z, p)` or `rate(q, v, z, u, p)`, (n_z,).
        force: generalised force on the system, `force(q, v, z, p)` or `force(q, v, z, u, p)`,
            (n_q,) [N m or N]. None for 0.
        initial: the expected internal states at the beginning of a record, `initial(q, v, p)` or
            `initial(q, v, u, p)`, (n_z,): the effect of the time before. None for 0.
        spread: `spread(p)`, standard deviations from the expected ones, (n_z,). None for 1.
        searched: names of those that an identification searches for where a record begins.
        settle: `settle(z, p)`, the states as they go on at a sample, (n_z,). None for `z` itself.
    """

    names: tuple[str, ...]
    rate: Callable[..., Any]
    force: Callable[..., Any] | None = None
    initial: Callable[..., Any] | None = None
    spread: Callable[[Values], Any] | None = None
    searched: tuple[str, ...] = ()
    settle: Callable[[Internal, Values], Any] | None = None

    def __post_init__(self) -> None:
        for name in self.searched:
            if name not in self.names:
                expected = f"among {', '.join(self.names) or '(none)'}"
                raise InputError("memory", f"'{name}' in `searched`", expected)

    @property
    def has_inputs(self) -> bool:
        """Whether inputs drive the internal states: whether `rate` takes them."""
        return bool(self.names) and takes_inputs(self.rate, "qvzp")

    @property
    def initial_needs_inputs(self) -> bool:
        """Whether the expected internal states at the beginning of a record depend on inputs."""
        return self.initial is not None and takes_inputs(self.initial, "qvp")

    def compute_rate(
        self, q: Coordinates, v: Coordinates, z: Internal, u: InputVector | None, p: Values
    ) -> Internal:
        """The rate `dz/dt`, (n_z,); `u` may be None where the function does not take it."""
        return _call(self.rate, (q, v, z), u, p) if self.names else z

    def compute_force(
        self, q: Coordinates, v: Coordinates, z: Internal, u: InputVector, p: Values
    ) -> Coordinates:
        """The generalised force, (n_q,)."""
        return jnp.zeros_like(q) if self.force is None else _call(self.force, (q, v, z), u, p)

    def compute_initial(
        self, q: Coordinates, v: Coordinates, u: InputVector | None, p: Values
    ) -> Internal:
        """The expected states, (n_z,); `u` may be None where the function does not take it."""
        if self.initial is None:
            return jnp.zeros(len(self.names), q.dtype)
        return _call(self.initial, (q, v), u, p).astype(q.dtype)

    def compute_settled(self, z: Internal, p: Values) -> Internal:
        """The states as they go on at a sample, (n_z,)."""
        return z if self.settle is None else jnp.asarray(self.settle(z, p), z.dtype)

    def compute_spread(self, p: Values) -> Internal:
        """The standard deviations, (n_z,)."""
        return jnp.asarray(self.spread(p) if self.spread else np.ones(len(self.names)))

    def followed_by(self, outer: "Memory", inputs: Callable[..., Any] | None = None) -> "Memory":
        """These internal states, then others, which may stand between these and the inputs.

        Args:
            outer: the others.
            inputs: `inputs(q, v, z, u, p)`, what these are given in the place of the inputs, by the
                states `z` of the others. None where they are given the inputs.
        """
        n = len(self.names)

        def given(q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
            return u if inputs is None or u is None else inputs(q, v, z, u, p)

        def rate(q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
            own = self.compute_rate(q, v, z[:n], given(q, v, z[n:], u, p), p)
            return jnp.concatenate([own, outer.compute_rate(q, v, z[n:], u, p)])

        def force(q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
            own = self.compute_force(q, v, z[:n], given(q, v, z[n:], u, p), p)
            return own + outer.compute_force(q, v, z[n:], u, p)

        def initial(q: Any, v: Any, u: Any, p: Values) -> Any:
            others = outer.compute_initial(q, v, u, p)
            own = self.compute_initial(q, v, given(q, v, others, u, p), p)
            return jnp.concatenate([own, others])

        def settle(z: Any, p: Values) -> Any:
            return jnp.concatenate(
                [self.compute_settled(z[:n], p), outer.compute_settled(z[n:], p)]
            )

        both = (self, outer)
        return Memory(
            (*self.names, *outer.names),
            _of_inputs(rate, any(memory.has_inputs for memory in both)),
            force,
            _of_inputs(initial, any(memory.initial_needs_inputs for memory in both))
            if any(memory.initial for memory in both)
            else None,
            lambda p: jnp.concatenate([memory.compute_spread(p) for memory in both]),
            (*self.searched, *outer.searched),
            settle if any(memory.settle for memory in both) else None,
        )


NO_MEMORY = Memory((), lambda q, v, z, p: z)


def _call(function: Callable[..., Any], before: tuple[Array, ...], u: Any, p: Values) -> Array:
    """The result of a function that may take the inputs between other arguments and parameters."""
    inputs = (u,) if takes_inputs(function, f"{'qvz'[: len(before)]}p") else ()
    return jnp.asarray(function(*before, *inputs, p))


def _of_inputs(function: Callable[..., Any], takes: bool) -> Callable[..., Any]:
    """A function that takes the inputs before the parameters, or as one that does not."""
    return function if takes else lambda *others: function(*others[:-1], None, others[-1])


@dataclass(frozen=True)
class UnmeasuredCoordinates:
    """Generalised coordinates without a sensor, as the angle of a link behind an elastic gear.

    In the `q` and `v` that the functions of a system take they stand behind the measured ones, and
    so do their forces. Their positions, then their velocities are internal states, the first ones.

    Attributes:
        names: names of the coordinates; their velocities are called `NAME_speed`.
        follow: `follow(q, p)`, their positions if all joints were rigid, by the measured
            coordinates, (n_h,) [rad or m]. Estimates without a simulation take this for the
            motion.
        initial: `initial(q, v, u, p)`, their expected positions and velocities where a record or a
            piece of one begins, (2 n_h,), by the measured coordinates. None for those of `follow`.
        spread: `spread(p)`, standard deviations of positions and velocities from the expected ones,
            (2 n_h,). None for 1.
    """

    names: tuple[str, ...]
    follow: Callable[[Coordinates, Values], Any]
    initial: Callable[[Coordinates, Coordinates, InputVector, Values], Any] | None = None
    spread: Callable[[Values], Any] | None = None

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the internal states: of the positions, then of the velocities."""
        return (*self.names, *(f"{name}_speed" for name in self.names))

    def complete(self, q: Coordinates, p: Values) -> AllCoordinates:
        """Positions of all coordinates if all joints were rigid, (n_q + n_h,).

        Args:
            q: measured positions, (n_q,).
            p: values of the parameters by name.
        """
        return jnp.concatenate([q, jnp.asarray(self.follow(q, p), q.dtype)])

    def initial_states(
        self, q: Coordinates, v: Coordinates, u: InputVector, p: Values
    ) -> Float[Array, " n_states"]:
        """The expected positions and velocities, (2 n_h,), see `initial`."""
        if self.initial is not None:
            return jnp.asarray(self.initial(q, v, u, p), q.dtype)
        return jnp.concatenate(jax.jvp(lambda x: jnp.asarray(self.follow(x, p)), (q,), (v,)))


@dataclass(frozen=True)
class InternalStates:
    """All internal states of a system, those of unmeasured coordinates first.

    Attributes:
        unmeasured: the coordinates without a sensor, if any.
        memory: the other internal states, if any.
    """

    unmeasured: UnmeasuredCoordinates = UnmeasuredCoordinates((), lambda q, p: q[:0])
    memory: Memory = NO_MEMORY

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of all internal states."""
        return (*self.unmeasured.states, *self.memory.names)

    @property
    def searched(self) -> Bool[np.ndarray, " n_z"]:
        """Mask of the internal states that an identification searches for, unmeasured ones too."""
        searched = (*self.unmeasured.states, *self.memory.searched)
        return np.array([name in searched for name in self.names], dtype=bool)

    @property
    def has_initial(self) -> bool:
        """Whether internal states other than 0 are expected where a record begins."""
        return bool(self.unmeasured.names) or self.memory.initial is not None

    @property
    def initial_needs_inputs(self) -> bool:
        """Whether the internal states that are expected where a record begins depend on inputs."""
        return bool(self.unmeasured.names) or self.memory.initial_needs_inputs

    def initial(self, q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Internal:
        """The expected internal states where a record begins, (n_z,), by measured coordinates."""
        own = self.unmeasured.initial_states(q, v, u, p)
        q, v, _ = self.split(q, v, own)
        return jnp.concatenate([own, self.memory.compute_initial(q, v, u, p)])

    def spread(self, p: Values) -> Internal:
        """Standard deviations from the expected ones, (n_z,)."""
        own = self.unmeasured
        first = own.spread(p) if own.spread else np.ones(len(own.states))
        return jnp.concatenate([jnp.asarray(first), self.memory.compute_spread(p)])

    def split(
        self, q: Coordinates, v: Coordinates, z: Float[Array, " n_states"]
    ) -> tuple[AllCoordinates, AllCoordinates, Internal]:
        """Positions and velocities of all coordinates, and the states of the memory.

        Args:
            q: measured positions, (n_q,).
            v: their velocities, (n_q,).
            z: the internal states, (n_states,).
        """
        n = len(self.unmeasured.names)
        return jnp.concatenate([q, z[:n]]), jnp.concatenate([v, z[n : 2 * n]]), z[2 * n :]
