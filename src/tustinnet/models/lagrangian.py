"""Euler-Lagrange models: equations of motion from energies, by automatic differentiation."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Bool, Float

from tustinnet.channels import Channels, Coordinate, Input
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError, describe_error
from tustinnet.models.contract import (
    ContinuousModel,
    Coordinates,
    Directions,
    InputVector,
    Internal,
    State,
)
from tustinnet.models.feedback import PDFeedback
from tustinnet.models.internal_states import (
    AllCoordinates,
    InternalStates,
    Memory,
    UnmeasuredCoordinates,
    Values,
    takes_inputs,
)
from tustinnet.models.kinematics import Link, require_links
from tustinnet.models.motion_limits import MotionLimits
from tustinnet.models.parameters import Parameter, require_group_value
from tustinnet.wording import counted

Scalar = Float[Array, ""]

_CHECKS_INDICES = "jax_check_static_indices"  # a setting of JAX from 0.8 on
_LETTERS = "q are positions, v velocities, u inputs, p the parameters by name"
_SMALLEST_PIVOT = 1e-12  # of balanced internal states, relative to the size of the equations


@dataclass(frozen=True)
class Inertia:
    """Mass matrix and Coriolis forces of a kinetic energy, where a recursion gives them.

    Without them they are second derivatives of `LagrangianSystem.kinetic`, whose programs grow with
    the cube of the number of links of a chain.

    Attributes:
        mass_matrix: `M(q, p)`, d2T/dv2, (n_q, n_q) [kg m^2, kg m or kg].
        coriolis: `C(q, v, p)`, dT/dq - (d2T/dv dq) v, (n_q,) [N m or N].
        uncoupled: indices of coordinates whose rows of the mass matrix are 0 beside the diagonal,
            as of motors behind elastic gears. Their accelerations are quotients.
        inverse: `M(q, p) a - C(q, v, p)` as a function of `(q, v, a, p)` by one recursion, (n_q,):
            derivatives of equations of motion are shortest by it. None to add both.
    """

    mass_matrix: Callable[[Coordinates, Values], Any]
    coriolis: Callable[[Coordinates, Coordinates, Values], Any]
    uncoupled: tuple[int, ...] = ()
    inverse: Callable[[Coordinates, Coordinates, Coordinates, Values], Any] | None = None


class _HeldLoop(ContinuousModel):
    """A closed loop from one sample to the next, while what its controller computed is held.

    Attributes:
        model: the closed loop.
        computed: what the controller computed at the sample, see `LagrangianModel.computed`.
    """

    model: "LagrangianModel"
    computed: Array

    # a property in the place of a field of the base class: nobody assigns it
    @property
    def channels(self) -> Channels:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The coordinates and inputs of the model."""
        return self.model.channels

    def derivative(self, x: State, u: InputVector) -> State:
        """The derivative of the model's state."""
        return self.model.held_derivative(x, u, self.computed)


class ChannelSource(ABC):
    """A file by which a system can be made for coordinates and inputs of any order.

    Attributes:
        path: the file.
    """

    path: Path

    @abstractmethod
    def for_channels(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input], where: object
    ) -> "LagrangianSystem":
        """The system with these coordinates and inputs, see `LagrangianSystem.for_channels`."""

    @abstractmethod
    def for_records(self, records: Sequence[Experiment], where: object) -> "LagrangianSystem":
        """The system with ranges by records, see `LagrangianSystem.for_records`."""

    @property
    @abstractmethod
    def remarks(self) -> tuple[str, ...]:
        """Sentences on what counts otherwise than the file says it."""

    @abstractmethod
    def input_joints(self) -> dict[str, str]:
        """The coordinate on which each input acts, by name."""

    @abstractmethod
    def call(self, **more: object) -> str:
        """The line of a system file that loads the file as it is used, with more options."""


@dataclass(frozen=True)
class LagrangianSystem:
    """A mechanical system written as energies and forces.

    All functions take the parameters as a mapping from name to value, last. Where there are
    unmeasured coordinates, `q`, `v` and generalised forces have them behind the others.

    Attributes:
        name: what it is called.
        coordinates: the generalised coordinates, in the order of q.
        inputs: the inputs, in the order of u.
        parameters: what the functions need.
        kinetic: `T(q, v, p)` [J], quadratic in v.
        potential: `V(q, p)` [J], or None for none.
        dissipation: `D(q, v, p)`, generalised force against the motion, (n_q,) [N m or N].
        input_map: `Q(q, v, u, p)`, generalised force of the actuators, (n_q,) [N m or N].
        memory: forces with internal states, if any.
        sensors: names of parameters of sensor errors, see `models.sensors.with_sensor_errors`.
        added: names of forces that were added, see `models.added.with_forces`.
        added_parameters: names of the parameters that they brought.
        links: its links, by which it is drawn; none if unknown.
        inertia: mass matrix and Coriolis forces of `kinetic` by a recursion, which must agree with
            it; None to derive them from it.
        source: the file of a robot from which it was made, and from which it can be made with
            coordinates and inputs in another order; None if its functions know no names.
        limits: limits of the motion of each coordinate, in the order of q; none if unknown. No
            equation of motion knows of them.
        feedback: the controller in the loop, whose set points are among the inputs; None without.
        alone: the system without the controller in the loop; None without one.
        unmeasured: coordinates that no sensor measures; None without.
        energy_unit: unit of the energies; another one than J where an inertia is 1 by choice, as
            `rad^2/s^2` of those per inertia.
    """

    name: str
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    parameters: tuple[Parameter, ...]
    kinetic: Callable[[Coordinates, Coordinates, Values], Any]
    potential: Callable[[Coordinates, Values], Any] | None = None
    dissipation: Callable[[Coordinates, Coordinates, Values], Any] | None = None
    input_map: Callable[[Coordinates, Coordinates, InputVector, Values], Any] | None = None
    memory: Memory | None = None
    sensors: tuple[str, ...] = ()
    added: tuple[str, ...] = ()
    added_parameters: tuple[str, ...] = ()
    links: tuple[Link, ...] = ()
    inertia: Inertia | None = None
    source: "ChannelSource | None" = None
    limits: tuple[MotionLimits, ...] = ()
    feedback: PDFeedback | None = None
    alone: "LagrangianSystem | None" = None
    unmeasured: UnmeasuredCoordinates | None = None
    energy_unit: str = "J"

    def __repr__(self) -> str:
        counts = counted(len(self.parameters), "parameter")
        return f"LagrangianSystem({self.name!r}, {self.channels.brief}, {counts})"

    def __post_init__(self) -> None:
        names = [p.name for p in self.parameters]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(f"system '{self.name}'", f"two parameters '{twice[0]}'", "one")
        _ = self.channels  # whose names differ
        for p in self.grouped:
            if by_group := p.by_group(dict.fromkeys(names)):
                reserved = p.for_group(next(iter(by_group))).name
                raise InputError(
                    f"system '{self.name}'",
                    f"a parameter '{reserved}'",
                    "another name",
                    f"'{p.name}' has values of such names, one per {p.per}",
                )
        if not self.coordinates:
            raise InputError(f"system '{self.name}'", "no coordinates", "at least one")
        require_links(self.links, self.coordinates, f"system '{self.name}'")
        if self.limits and len(self.limits) != len(self.coordinates):
            raise InputError(
                f"system '{self.name}'",
                f"limits of {len(self.limits)} coordinates",
                f"of all {len(self.coordinates)}, or none",
            )
        self._require_shapes()

    def force_unit(self, coordinate: Coordinate) -> str:
        """The unit of generalised forces on a coordinate."""
        unit = coordinate.unit
        if self.energy_unit == f"{unit}^2/s^2":
            return f"{unit}/s^2"
        forces = {"rad": "N m", "m": "N"} if self.energy_unit == "J" else {}
        return forces.get(unit, f"{self.energy_unit}/{unit}")

    def nominal(self) -> dict[str, float]:
        """The nominal values by name."""
        return {p.name: p.nominal for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        """A parameter by name; `mass[1kg]` is that of a group."""
        for p in self.parameters:
            if p.name == name:
                return p
            if p.per is not None and (group := p.by_group({name: None})):
                return p.for_group(*group)
        names = ", ".join(p.name for p in self.parameters)
        raise InputError(f"system '{self.name}'", f"no parameter '{name}'", f"one of {names}")

    @property
    def grouped(self) -> tuple[Parameter, ...]:
        """The parameters that have a value for each group."""
        return tuple(p for p in self.parameters if p.per is not None)

    @cached_property
    def channels(self) -> Channels:
        """The coordinates and inputs, in continuous time."""
        controller = None if self.feedback is None else self.feedback.channels.controller
        return Channels(self.coordinates, self.inputs, controller=controller)

    @property
    def plant(self) -> "LagrangianSystem":
        """The system without a controller in the loop; itself where there is none."""
        return self.alone or self

    @cached_property
    def states(self) -> InternalStates:
        """The internal states, of whatever they are."""
        parts = {"unmeasured": self.unmeasured, "memory": self.memory}
        return InternalStates(**{name: part for name, part in parts.items() if part})

    @property
    def internal(self) -> tuple[str, ...]:
        """The names of the internal states."""
        return self.states.names

    @property
    def coordinate_names(self) -> tuple[str, ...]:
        """The names of all coordinates: of the measured ones, then of the unmeasured ones."""
        return (*(c.name for c in self.coordinates), *self.states.unmeasured.names)

    def for_channels(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input], where: object
    ) -> "LagrangianSystem":
        """The system with coordinates and inputs in the order of records.

        Only a system with a `source` can be rearranged. Encoder counts and limits of inputs that
        the system does not declare are those of the records.

        Args:
            coordinates: coordinates of the records.
            inputs: inputs of the records.
            where: what has them, for messages.

        Raises:
            InputError: coordinates or inputs that the source does not know, or some are missing.
        """
        arranged = self
        if self.source is not None:
            arranged = self.source.for_channels(coordinates, inputs, where)
        return arranged._completed_by(coordinates, inputs)

    def for_records(self, records: Sequence[Experiment], where: object) -> "LagrangianSystem":
        """The system with coordinates and inputs of records, and ranges by their motion.

        Only a system with a `source` gets ranges; for the rest see `for_channels`.

        Args:
            records: records of one kind, at least one.
            where: what has them, for messages.

        Raises:
            InputError: see `for_channels`.
        """
        arranged = self if self.source is None else self.source.for_records(records, where)
        return arranged._completed_by(records[0].coordinates, records[0].inputs)

    def _completed_by(
        self, coordinates: Sequence[Coordinate], inputs: Sequence[Input]
    ) -> "LagrangianSystem":
        """The system with encoder counts and limits that only these coordinates and inputs have."""
        given = (*coordinates, *inputs)
        if [c.name for c in given] != [c.name for c in (*self.coordinates, *self.inputs)]:
            return self
        recorded = Channels(tuple(coordinates), tuple(inputs))
        own, added = Channels(self.coordinates, self.inputs).completed_by([recorded])
        return replace(self, coordinates=own.coordinates, inputs=own.inputs) if added else self

    def model(self, values: Values) -> "LagrangianModel":
        """The equations of motion with the values of all parameters, by name.

        Of a parameter `per` a group either one value, or one for each group (`mass[1kg]`,
        `mass[2kg]`), of which `LagrangianModel.for_record` takes a record's.
        """
        return LagrangianModel(self, dict(values))

    @property
    def optional(self) -> tuple[str, ...]:
        """The parameters whose terms are left out unless records need them."""
        return tuple(p.name for p in self.parameters if p.optional)

    def without(self, names: Collection[str]) -> "LagrangianSystem":
        """The system without some of its optional parameters."""
        kept = tuple(p for p in self.parameters if p.name not in names)
        return replace(self, parameters=kept, alone=self.alone and self.alone.without(names))

    def inside(self, outer: Memory, inputs: Callable[..., Any] | None = None) -> dict[str, Any]:
        """Attributes of the system with further internal states, which may compute its inputs.

        Args:
            outer: the further internal states, which stand behind its own.
            inputs: `inputs(q, v, z, u, p)`, what acts in the place of its inputs, by the further
                states. None where these do not change its inputs.

        Returns:
            `memory` and `input_map`. Behind inputs that depend on states, the map of the inputs is
            a force of the memory.
        """
        memory, input_map = self.states.memory, self.input_map
        if inputs is None or input_map is None:
            return {"memory": memory.followed_by(outer, inputs), "input_map": input_map}
        if not outer.names:

            def of_computed(q: Any, v: Any, u: Any, p: Values) -> Any:
                return input_map(q, v, inputs(q, v, jnp.zeros(0, q.dtype), u, p), p)

            return {"memory": memory.followed_by(outer, inputs), "input_map": of_computed}

        def force(q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
            return memory.compute_force(q, v, z, u, p) + jnp.asarray(input_map(q, v, u, p))

        driven = replace(memory, force=force)
        return {"memory": driven.followed_by(outer, inputs), "input_map": None}

    def _require_shapes(self) -> None:
        """Raises unless every function returns the shape that the equations of motion need."""
        memory, hidden, inertia = self.states.memory, self.states.unmeasured, self.inertia
        n, n_z, n_h = len(self.coordinate_names), len(memory.names), len(hidden.states)
        sizes = {"q": n, "v": n, "z": n_z, "u": len(self.inputs), "x": len(self.coordinates)}
        # without the optional ones: a function that requires one is refused
        names = tuple(x.name for x in self.parameters if not x.optional)
        functions: list[tuple[str, Callable[..., Any] | None, str, tuple[int, ...]]] = [
            ("kinetic", self.kinetic, "qvp", ()),
            ("potential", self.potential, "qp", ()),
            ("dissipation", self.dissipation, "qvp", (n,)),
            ("input_map", self.input_map, "qvup", (n,)),
            ("mass_matrix", inertia and inertia.mass_matrix, "qp", (n, n)),
            ("coriolis", inertia and inertia.coriolis, "qvp", (n,)),
            ("memory rate", memory.rate, "qvzp", (n_z,)),
            ("memory force", memory.force, "qvzp", (n,)),
            ("memory initial", memory.initial, "qvp", (n_z,)),
            ("memory spread", memory.spread, "p", (n_z,)),
            ("memory settle", memory.settle, "zp", (n_z,)),
            ("unmeasured follow", hidden.follow, "xp", (n_h // 2,)),
            ("unmeasured initial", hidden.initial, "xxup", (n_h,)),
            ("unmeasured spread", hidden.spread, "p", (n_h,)),
        ]
        for name, function, letters, shape in functions:
            if function is None:
                continue
            where = f"system '{self.name}', {name}"
            if function in (memory.rate, memory.force, memory.initial):
                letters = self._with_inputs(function, letters, where)
            given = tuple(names if letter == "p" else sizes[letter] for letter in letters)
            try:
                found = _shape(function, given)
            except KeyError as error:
                if error.args[0] in self.optional:
                    raise InputError(
                        where,
                        f"asks for the parameter {error}, which is optional",
                        f"p.get({error}, 0.0)",
                        "records that do not need the term are simulated without it",
                    ) from error
                raise InputError(
                    where,
                    f"asks for the parameter {error}",
                    f"one of {', '.join(self.nominal())}",
                    "declare it among the parameters",
                ) from error
            except Exception as error:
                remedy = tracing_remedy(error)
                problem = type(error).__name__ if remedy else describe_error(error)
                if isinstance(error, TypeError) and "positional argument" in str(error):
                    remedy = f"its arguments are ({', '.join(letters)}): {_LETTERS}"
                elif isinstance(error, IndexError) and not remedy:
                    counts = f"{counted(n, 'coordinate')} and {counted(sizes['u'], 'input')}"
                    remedy = f"there are {counts}, counted from 0"
                raise InputError(
                    where,
                    f"fails with {problem}",
                    "a function of jax arrays",
                    remedy or "write it with jax.numpy",
                ) from error
            if found != shape:
                raise InputError(
                    where,
                    f"returns shape {found}",
                    f"{shape}" if shape else "a scalar",
                    "energies are scalars, forces have a value per coordinate",
                )

    def _with_inputs(self, function: Callable[..., Any], letters: str, where: str) -> str:
        """The arguments of a function of the memory, a letter each, with inputs if it has them."""
        try:
            return f"{letters[:-1]}up" if takes_inputs(function, letters) else letters
        except TypeError as error:
            problem, _, expected = str(error).partition("; expected ")
            raise InputError(where, problem, expected, _LETTERS) from error


@lru_cache(maxsize=256)  # files are loaded again with every model of theirs
def _shape(
    function: Callable[..., Any], given: tuple[int | tuple[str, ...], ...]
) -> tuple[int, ...]:
    """The shape that a function returns of vectors of some sizes, and of numbers by their names."""
    arguments = [
        jax.ShapeDtypeStruct((x,), jnp.float32)
        if isinstance(x, int)
        else {name: jax.ShapeDtypeStruct((), jnp.float32) for name in x}
        for x in given
    ]
    with _refuse_wrong_indices():
        return jax.eval_shape(lambda *a: jnp.asarray(function(*a)), *arguments).shape


@contextmanager
def _refuse_wrong_indices() -> Iterator[None]:
    """Within it, JAX refuses an index that an array has not; it takes the last element else."""
    if not hasattr(jax.config, _CHECKS_INDICES):
        yield
        return
    before = getattr(jax.config, _CHECKS_INDICES)
    jax.config.update(_CHECKS_INDICES, True)
    try:
        yield
    finally:
        jax.config.update(_CHECKS_INDICES, before)


def tracing_remedy(error: BaseException) -> str:
    """The code to write where a function needs values of arrays that JAX traces; "" if not so.

    Args:
        error: the error of JAX or NumPy in the function.
    """
    errors = jax.errors
    match error:
        case errors.TracerBoolConversionError():
            return (
                "write jnp.where(condition, a, b) for if and else, & | ~ for and, or, not, "
                "jnp.maximum for max, jax.lax.fori_loop for while"
            )
        case errors.NonConcreteBooleanIndexError():
            return "write jnp.where(condition, a, b) for an index by a condition"
        case errors.TracerArrayConversionError():
            return "write jax.numpy for numpy: jnp.sin, jnp.where, jnp.interp, jnp.stack"
        case errors.TracerIntegerConversionError():
            return "write jnp.asarray(values)[i], and loops of a fixed length"
        case errors.ConcretizationTypeError():
            return "write jax.numpy for math, float and int: jnp.sin, jnp.floor"
    if isinstance(error, ValueError) and "setting an array element" in str(error):
        return "write jnp.stack([a, b]) for assignments to elements"
    return ""


class LagrangianModel(ContinuousModel):
    """The equations of motion of a system.

        d/dt dT/dv - dT/dq + dV/dq = Q(q, v, u) - D(q, v) + F(q, v, z, u)

    Solved for the acceleration: `M(q) a = Q - D + F - c(q, v) - dV/dq` with the mass matrix
    `M = d2T/dv2` and `c = (d2T/dv dq) v - dT/dq`, by Cholesky factorisation of M. `F` are the
    forces with memory, `dz/dt = rate(q, v, z, u)`. The `q` and `v` of these functions have all
    coordinates, unmeasured ones behind the others.

    Attributes:
        system: the energies and forces.
        values: the parameters by name, SI units. Where some are by group (`mass[1kg]`), the
            model steps only with those of a record, see `for_record` and `for_groups`.

    References:
        van Esch, Bonassi, Schön, section 2.2, Euler-Lagrange equations.
    """

    system: LagrangianSystem = eqx.field(static=True)
    values: dict[str, Array]

    # a property in the place of a field of the base class: nobody assigns it
    @property
    def channels(self) -> Channels:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The coordinates and inputs of the system."""
        return self.system.channels

    @property
    def internal(self) -> tuple[str, ...]:
        """The names of the internal states."""
        return self.system.internal

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """The names of groups with values of their own, each with the groups that have one."""
        groups: dict[str, tuple[str, ...]] = {}
        for p in self.system.grouped:
            if by_group := tuple(p.by_group(self.values)):
                groups[str(p.per)] = by_group
        return groups

    def for_record(self, experiment: Experiment) -> "LagrangianModel":
        """The equations of motion with the values of a record's groups."""
        return self.for_groups(dict(experiment.groups), f"record '{experiment.name}'")

    def for_groups(self, groups: Mapping[str, str], where: object) -> "LagrangianModel":
        """The equations of motion with the values of some groups, as `{"payload": "1kg"}`.

        Of a group that is not given, values that were taken before stay.

        Args:
            groups: the values of the groups.
            where: what has them, for messages.

        Raises:
            InputError: a group is missing, or the model has no value for it.
        """
        chosen: dict[str, Array] = {}
        for p in self.system.grouped:
            is_taken = p.name in self.values and p.per not in groups
            if not is_taken and (values := p.by_group(self.values)):
                chosen[p.name] = values[require_group_value(p, groups, tuple(values), where)]
        return LagrangianModel(self.system, self.values | chosen) if chosen else self

    def mass_matrix(self, q: Coordinates) -> Float[Array, "n_q n_q"]:
        """`M(q)`, (n_q, n_q) [kg m^2, kg m or kg]."""
        if self.system.inertia:
            return jnp.asarray(self.system.inertia.mass_matrix(q, self.values))
        at_rest = jnp.zeros_like(q)
        return jax.hessian(self.system.kinetic, argnums=1)(q, at_rest, self.values)

    def energy(self, x: State) -> Scalar:
        """`T + V` at a state [J]."""
        q, v, _ = self._parts(x)
        kinetic = self.system.kinetic(q, v, self.values)
        return kinetic + self.system.potential(q, self.values) if self.system.potential else kinetic

    def conservative(self, q: Coordinates, v: Coordinates) -> Coordinates:
        """`dT/dq - dV/dq - (d2T/dv dq) v`: forces without actuators and losses, (n_q,)."""
        s, p = self.system, self.values
        if s.inertia:
            force = jnp.asarray(s.inertia.coriolis(q, v, p))
        else:
            momentum = jax.grad(s.kinetic, argnums=1)
            _, rate = jax.jvp(lambda position: momentum(position, v, p), (q,), (v,))
            force = jax.grad(s.kinetic)(q, v, p) - rate
        return force - jax.grad(s.potential)(q, p) if s.potential else force

    def applied(self, q: Coordinates, v: Coordinates, z: Internal, u: InputVector) -> Coordinates:
        """`Q - D + F`: actuators, losses and forces with memory, (n_q,)."""
        s, p = self.system, self.values
        force = jnp.zeros_like(q)
        if s.input_map:
            force = force + jnp.asarray(s.input_map(q, v, u, p))
        if s.dissipation:
            force = force - jnp.asarray(s.dissipation(q, v, p))
        return force + s.states.memory.compute_force(q, v, z, u, p)

    def acceleration(self, x: State, u: InputVector) -> AllCoordinates:
        """The acceleration at a state under an input, of all coordinates [rad/s^2 or m/s^2]."""
        q, v, z = self._parts(x)
        force = self.applied(q, v, z, u) + self.conservative(q, v)
        return self._accelerate(self.mass_matrix(q), force)

    def _accelerate(
        self, matrix: Float[Array, "n n"], force: Float[Array, "n *columns"]
    ) -> Float[Array, "n *columns"]:
        """Accelerations by forces, with the mass matrix of all coordinates."""
        uncoupled = self.system.inertia.uncoupled if self.system.inertia else ()
        if not uncoupled:
            return solve_positive(matrix, force)
        coupled = [i for i in range(len(force)) if i not in uncoupled]
        accelerations = [force[i] / matrix[i, i] for i in range(len(force))]
        if coupled:
            at = jnp.array(coupled)
            for i, a in zip(coupled, solve_positive(matrix[at][:, at], force[at]), strict=True):
                accelerations[i] = a
        return jnp.stack(accelerations)

    def imbalance(self, x: State, u: InputVector, a: AllCoordinates) -> AllCoordinates:
        """`M a + c + dV/dq + D - Q - F`: forces that a motion needs and does not have, (n,).

        Args:
            x: the state, (n_x,).
            u: the inputs, (n_u,).
            a: accelerations of all coordinates, (n,).
        """
        (q, v, z), s, p = self._parts(x), self.system, self.values
        if s.inertia and s.inertia.inverse:
            needed = jnp.asarray(s.inertia.inverse(q, v, a, p))
            needed = needed + jax.grad(s.potential)(q, p) if s.potential else needed
        else:
            needed = self.mass_matrix(q) @ a - self.conservative(q, v)
        return needed - self.applied(q, v, z, u)

    def derivative_along(
        self,
        x: State,
        u: InputVector,
        dx: Directions,
        du: Directions,
    ) -> tuple[State, Float[Array, "n_x directions"]]:
        """The derivative of the state, and its own derivatives along some directions.

        Along a motion the imbalance of forces is 0: `M da = -d(imbalance)` with the acceleration
        held. So neither the mass matrix nor its factorisation is differentiated, and all directions
        share one Jacobian.

        Args:
            x: the state, (n_x,).
            u: the inputs, (n_u,).
            dx: directions of the state, (n_x, directions).
            du: directions of the inputs, (n_u, directions).

        References:
            Carpentier, Mansard (2018), Analytical derivatives of rigid body dynamics algorithms,
            Robotics: Science and Systems.
        """
        q, v, z = self._parts(x)
        matrix, n = self.mass_matrix(q), self.channels.n_q
        a = self._accelerate(matrix, self.applied(q, v, z, u) + self.conservative(q, v))

        def along(function: Callable[[State, InputVector], Any]) -> Any:
            by_x, by_u = jax.jacfwd(function, argnums=(0, 1))(x, u)
            return by_x @ dx + by_u @ du

        da = self._accelerate(matrix, -along(lambda x, u: self.imbalance(x, u, a)))
        hidden = dx[self.channels.internal][len(v) - n : 2 * (len(v) - n)]
        rate = jnp.concatenate([v[:n], a[:n], v[n:], a[n:], self.memory_rate(x, u)])
        parts = [dx[self.channels.velocity], da[:n], hidden, da[n:]]
        if len(rate) > 2 * len(v):
            parts.append(along(self.memory_rate))
        return rate, jnp.concatenate(parts)

    def derivative(self, x: State, u: InputVector) -> State:
        """`d/dt [q, v, z] = [v, a, rate]`."""
        for p in self.system.grouped:
            if p.name not in self.values:
                raise InputError(
                    f"a model of the system '{self.system.name}'",
                    f"no one value of '{p.name}': it has one per {p.per}",
                    "the model of a record or of a group",
                    f"model.for_record(record) takes the values of the record's {p.per}",
                )
        return _derivative(self, x, u)

    def between_samples(self, x: State, u: InputVector) -> tuple[State, ContinuousModel]:
        """The settled state, and the equations until the next sample: what is sampled is held."""
        feedback, x = self.system.feedback, self.settled(x)
        is_held = feedback is not None and feedback.is_sampled
        return x, _HeldLoop(self, self.computed(x, u)) if is_held else self

    @property
    def changes_at_samples(self) -> bool:
        """Whether states settle at samples, or a controller in the loop computes then."""
        feedback, memory = self.system.feedback, self.system.states.memory
        return memory.settle is not None or (feedback is not None and feedback.is_sampled)

    def settled(self, x: State) -> State:
        """The state as it goes on at a sample, (n_x,): of memory that settles."""
        memory = self.system.states.memory
        if memory.settle is None:
            return x
        first = len(x) - len(memory.names)
        return jnp.concatenate([x[:first], memory.compute_settled(x[first:], self.values)])

    def computed(self, x: State, w: InputVector) -> Float[Array, " computed"]:
        """The command of the controller in the loop, see `PDFeedback.compute`.

        Args:
            x: the state, (n_x,).
            w: inputs of the closed loop, (n_w,).
        """
        feedback, (q, v, z) = self.system.feedback, self._parts(x)
        assert feedback is not None
        s = z[len(z) - len(feedback.states) :]
        return feedback.compute(q, v, s, w, self.values)

    def held_derivative(self, x: State, w: InputVector, computed: Array) -> State:
        """The derivative while the controller in the loop holds what it computed.

        Args:
            x: the state, (n_x,).
            w: inputs of the closed loop, (n_w,).
            computed: what `computed` returned at the sample.
        """
        feedback = self.system.feedback
        assert feedback is not None
        u = feedback.plant_inputs(computed[: feedback.size], w)
        plant = LagrangianModel(self.system.plant, self.values)
        own = plant.derivative(x[: len(x) - len(feedback.states)], u)
        return jnp.concatenate([own, computed[feedback.size :]])

    def memory_rate(self, x: State, u: InputVector) -> Internal:
        """Rates of the internal states of the memory at a state, without unmeasured coordinates.

        Args:
            x: the state, (n_x,).
            u: the inputs, (n_u,).
        """
        return self.system.states.memory.compute_rate(*self._parts(x), u, self.values)

    def balanced_internal(self, q: Coordinates, v: Coordinates, u: InputVector) -> Internal:
        """Internal states that follow inputs, as if these had been there for long, (n_z,).

        For estimates without a simulation, of a system without unmeasured coordinates: the rates of
        states that inputs drive, also by way of other states, are 0, where rates are linear in the
        states. All others are 0.
        """
        memory = self.system.states.memory
        n = len(memory.names)
        zero = jnp.zeros(n, q.dtype)
        if not memory.has_inputs or not self.channels.n_u:
            return zero

        def rate(z: Internal, u: InputVector) -> Internal:
            return memory.compute_rate(q, v, z, u, self.values)

        matrix, by_input = jax.jacfwd(rate, argnums=(0, 1))(zero, u)
        driven = jnp.where(jnp.sum(jnp.abs(by_input), axis=1) > 0, 1.0, 0.0)
        for _ in range(n - 1):
            driven = jnp.where(driven + jnp.abs(matrix) @ driven > 0, 1.0, 0.0)
        # least squares of the rates, as the matrix is singular where a state only integrates
        matrix = matrix * driven * driven[:, None]
        square = matrix.T @ matrix
        ridge = _SMALLEST_PIVOT * jnp.sum(jnp.abs(square)) + jnp.finfo(q.dtype).tiny
        regular = square + jnp.diag(jnp.where(driven > 0, ridge, 1.0))
        return solve_positive(regular, -matrix.T @ (driven * rate(zero, u)))

    @property
    def initial_needs_inputs(self) -> bool:
        """Whether the internal states at the beginning of a record depend on inputs."""
        return self.system.states.initial_needs_inputs

    def initial_internal(
        self, measured: Float[Array, " n_measured"], u: InputVector | None = None
    ) -> Internal:
        """Expected internal states at the beginning of a record, see `LagrangianSystem`.

        Args:
            measured: the record's first positions and velocities [q, v], (2 n_q,).
            u: the inputs at its beginning, (n_u,); None for 0.
        """
        q, v = measured[self.channels.position], measured[self.channels.velocity]
        u = jnp.zeros(self.channels.n_u, measured.dtype) if u is None else u
        return self.system.states.initial(q, v, u, self.values)

    @property
    def internal_spread(self) -> Internal:
        """Standard deviations of internal states, 1 where neither system nor controller has any."""
        return self.system.states.spread(self.values)

    @property
    def searched_internal(self) -> Bool[np.ndarray, " n_z"]:
        """Mask of the internal states of unmeasured coordinates and of the controller."""
        return self.system.states.searched

    def _parts(self, x: State) -> tuple[AllCoordinates, AllCoordinates, Internal]:
        """Positions and velocities of all coordinates, and the states of the memory."""
        channels = self.channels
        return self.system.states.split(
            x[channels.position], x[channels.velocity], x[channels.internal]
        )


# a function of its own, so that it is derived once and not for each of a step's many uses
@jax.jit
def _derivative(model: LagrangianModel, x: State, u: InputVector) -> State:
    _, v, _ = model._parts(x)
    a, n = model.acceleration(x, u), model.channels.n_q
    rates = jnp.concatenate([v[:n], a[:n], v[n:], a[n:], model.memory_rate(x, u)])
    return rates.astype(x.dtype)  # constants of equations may be of double precision


def solve_positive(
    matrix: Float[Array, "n n"], right: Float[Array, "n *columns"]
) -> Float[Array, "n *columns"]:
    """Solves `matrix x = right` for a symmetric positive definite matrix by Cholesky."""
    return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(matrix, lower=True), right)
