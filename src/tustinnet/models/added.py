"""Forces by name, added to a system, each at a coordinate or, as lags of actuators, an input."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax.numpy as jnp

from tustinnet.errors import InputError
from tustinnet.models.feedback import with_changed_plant
from tustinnet.models.forces import LAWS, ActuatorLag, ForceWithMemory, Friction, Law, Spring
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter, Values
from tustinnet.renamed import FORCES

WHERE = "model.forces"


@dataclass(frozen=True)
class PlacedForce:
    """A force at a coordinate, or at an input.

    Attributes:
        law: its law.
        channel: the name of the coordinate, or of the input.
        index: the coordinate's place in q, or the input's in u.
    """

    law: Law
    channel: str
    index: int

    def __str__(self) -> str:
        return f"{self.law.name}:{self.channel}"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The names of its parameters, in the order of its law."""
        return tuple(f"{self.channel}.{p.name}" for p in self.law.parameters)

    def values(self, p: Values) -> list[Any]:
        """The values of its parameters, in the order of its law."""
        return [p[name] for name in self.parameter_names]


def parse_forces(system: LagrangianSystem, names: Sequence[str]) -> tuple[PlacedForce, ...]:
    """The forces of some names.

    Args:
        system: the system that they are to be added to.
        names: `LAW` for a force at every coordinate, `LAW:COORDINATE` for one; of a law at inputs
            `LAW` for every input, `LAW:INPUT` for one; also laws by the names that they had in
            earlier versions, as files have them.

    Raises:
        InputError: no such force, coordinate or input, or a force twice at one.
    """
    coordinates = [c.name for c in system.coordinates]
    inputs = [i.name for i in system.inputs]
    forces: list[PlacedForce] = []
    for name in names:
        law, colon, channel = name.partition(":")
        law = FORCES.get(law, law)
        if law not in LAWS:
            raise InputError(WHERE, f"no force '{law}'", f"one of {', '.join(LAWS)}")
        kind, channels = ("input", inputs) if LAWS[law].is_at_input else ("coordinate", coordinates)
        if not channels:
            raise InputError(WHERE, f"'{name}': the system has no inputs", "a system with inputs")
        if colon and channel not in channels:
            raise InputError(
                WHERE, f"'{name}': no {kind} '{channel}'", f"one of {', '.join(channels)}"
            )
        for place in [channel] if colon else channels:
            force = PlacedForce(LAWS[law], place, channels.index(place))
            if force in forces:
                raise InputError(WHERE, f"'{force}' twice", "once")
            forces.append(force)
    return tuple(forces)


def added_parameters(system: LagrangianSystem) -> tuple[str, ...]:
    """The names of the parameters of a system's added forces."""
    added = parse_forces(system, system.added)
    return tuple(dict.fromkeys(name for force in added for name in force.parameter_names))


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def with_forces(
    system: LagrangianSystem, names: tuple[str, ...], parameters: tuple[Parameter, ...]
) -> LagrangianSystem:
    """The system with further forces, their values among its parameters.

    Internal states come after those that the system has.

    Args:
        system: the system.
        names: `LAW:COORDINATE` each, see `parse_forces`; none leaves the system as it is.
        parameters: the parameters of the forces, as `theta.coulomb`.

    Raises:
        InputError: a force that `parse_forces` refuses, or a parameter that the system or another
            of the forces has already.
    """
    if not names:
        return system
    if system.feedback is not None:
        return with_changed_plant(system, lambda plant: with_forces(plant, names, parameters))
    added = parse_forces(system, names)
    of_system, added_before = system.nominal(), added_parameters(system)
    owners = dict.fromkeys(of_system, f"the system '{system.name}'")
    for force in added:
        for parameter, name in zip(force.law.parameters, force.parameter_names, strict=True):
            is_shared = parameter.shared and (name in added_before or name not in of_system)
            if name in owners and not is_shared:
                raise InputError(
                    WHERE, f"'{force}' brings '{name}', which {owners[name]} has already",
                    "forces that differ", "leave it out, or call the other one otherwise",
                )  # fmt: skip
            owners[name] = f"'{force}'"
    springs = [(force, law) for force in added if isinstance(law := force.law, Spring)]
    frictions = [(force, law) for force in added if isinstance(law := force.law, Friction)]
    # those that depend on a deflection are added last, in whatever order the names stand
    frictions.sort(key=lambda pair: pair[1].needs_limited_travel)
    with_states = tuple(f for f in added if isinstance(f.law, ForceWithMemory | ActuatorLag))
    is_lagging = any(isinstance(force.law, ActuatorLag) for force in added)

    def dissipation(q: Any, v: Any, p: Values) -> Any:
        acting = [
            (f.index, law.force(q[f.index], v[f.index], *f.values(p))) for f, law in frictions
        ]
        total = _sum_by_coordinate(v, acting)
        return total + jnp.asarray(system.dissipation(q, v, p)) if system.dissipation else total

    def potential(q: Any, p: Values) -> Any:
        energy = sum(law.energy(q[f.index], *f.values(p)) for f, law in springs)
        return energy + system.potential(q, p) if system.potential else energy

    return replace(
        system,
        parameters=(*system.parameters, *parameters),
        dissipation=dissipation if frictions else system.dissipation,
        potential=potential if springs else system.potential,
        # behind a lag the forces of the inputs depend on internal states
        input_map=None if is_lagging else system.input_map,
        memory=_ExtendedMemory(system, with_states).memory if with_states else system.memory,
        added=(*system.added, *map(str, added)),
    )


def _sum_by_coordinate(like: Any, acting: Sequence[tuple[int, Any]]) -> Any:
    """The sum of forces at each coordinate, (n_q,), from pairs of coordinate and force."""
    total = [jnp.zeros_like(x) for x in like]
    for i, force in acting:
        total[i] = total[i] + force
    return jnp.stack(total)


@dataclass(frozen=True)
class _ExtendedMemory:
    """The memory of a system followed by that of added forces.

    Behind the lags of inputs it also has the forces of the system's `input_map`: all that depends
    on inputs is given what the actuators have reached.

    Attributes:
        system: the system.
        added: the added forces with internal states.
    """

    system: LagrangianSystem
    added: tuple[PlacedForce, ...]

    @property
    def lagging(self) -> dict[int, int]:
        """The internal states that follow inputs that lag, by the index of the input."""
        n = len(self.system.internal)
        return {f.index: k for k, f in enumerate(self.added, n) if isinstance(f.law, ActuatorLag)}

    def reached(self, z: Any, u: Any) -> Any:
        """The inputs, in the place of those that lag the states that follow them."""
        if not (lagging := self.lagging):
            return u
        n_u = len(self.system.inputs)
        return jnp.stack([z[lagging[i]] if i in lagging else u[i] for i in range(n_u)])

    def rate(self, q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
        """The rates of the system's internal states, then of the added ones."""
        before, n = self.system.memory, len(self.system.internal)
        rates = []
        for f, state in zip(self.added, z[n:], strict=True):
            driving = u if f.law.is_at_input else v
            rates.append(_law_with_state(f).rate(driving[f.index], state, *f.values(p)))
        added = jnp.stack(rates)
        if before is None:
            return added
        own = before.compute_rate(q, v, z[:n], self.reached(z, u), p)
        return jnp.concatenate([jnp.asarray(own), added])

    def force(self, q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
        """The forces of the system's internal states, of the added ones, and of lagging inputs."""
        system, before, n = self.system, self.system.memory, len(self.system.internal)
        acting = [
            (f.index, f.law.force(v[f.index], state, *f.values(p)))
            for f, state in zip(self.added, z[n:], strict=True)
            if isinstance(f.law, ForceWithMemory)
        ]
        total = _sum_by_coordinate(v, acting)
        if before is not None:
            own = before.compute_force(q, v, z[:n], self.reached(z, u), p)
            total = jnp.asarray(own) + total
        if self.lagging and system.input_map is not None:
            total = total + jnp.asarray(system.input_map(q, v, self.reached(z, u), p))
        return total

    def initial(self, q: Any, v: Any, u: Any, p: Values) -> Any:
        """The expected internal states of the system, then the added ones."""
        before, n = self.system.memory, len(self.system.internal)
        states = []
        for f in self.added:
            place = u if f.law.is_at_input else q
            states.append(_law_with_state(f).initial(place[f.index], *f.values(p)))
        added = jnp.stack(states)
        if before is None:
            return added
        own = jnp.zeros(n, added.dtype)
        if before.initial is not None:
            reached = self.reached(jnp.concatenate([own, added]), u)
            inputs = (reached,) if before.initial_needs_inputs else ()
            own = jnp.asarray(before.initial(q, v, *inputs, p))
        return jnp.concatenate([own, added])

    @property
    def memory(self) -> Memory:
        """The memory, whose functions take inputs only where something depends on them."""
        before, lags = self.system.memory, bool(self.lagging)
        names = (*self.system.internal, *map(str, self.added))
        rate, force, initial = self.rate, self.force, self.initial
        if not (lags or (before and before.has_inputs)):
            rate = _without_inputs(self.rate)
        if not (lags or (before and before.force_needs_inputs)):
            force = _without_inputs(self.force)
        if not (lags or (before and before.initial_needs_inputs)):
            return Memory(names, rate, force, lambda q, v, p: initial(q, v, None, p))
        return Memory(names, rate, force, initial)


def _law_with_state(force: PlacedForce) -> ForceWithMemory | ActuatorLag:
    """The law of a force that has an internal state."""
    assert isinstance(force.law, ForceWithMemory | ActuatorLag)
    return force.law


def _without_inputs(function: Callable[..., Any]) -> Callable[..., Any]:
    """A rate or a force that takes the inputs, as one that does not."""
    return lambda q, v, z, p: function(q, v, z, None, p)
