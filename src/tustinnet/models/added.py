"""Forces by name, added to a system, each at a coordinate or, as lags of actuators, an input."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.models.feedback import with_changed_plant
from tustinnet.models.forces import (
    LAWS,
    OWN_LEVEL,
    OWN_WIDTH,
    ActuatorLag,
    ForceParameter,
    ForceWithMemory,
    Friction,
    Law,
    Spring,
)
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter, Values
from tustinnet.old_names import FORCES, refuse_old_names

WHERE = "model.forces"
_FAST = 1e6  # speed at which a Coulomb friction has reached its level [rad/s or m/s]


@dataclass(frozen=True)
class PlacedForce:
    """A force at a coordinate, or at an input.

    Attributes:
        law: its law.
        channel: the name of the coordinate, or of the input.
        index: the coordinate's place in q, or the input's in u.
        own: parameters of the system, as it is without the force, that take the place of some of
            its law's.
    """

    law: Law
    channel: str
    index: int
    own: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.law.name}:{self.channel}"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The names of its parameters, in the order of its law."""
        names = []
        for p in self.law.parameters:
            of_system = f"{self.channel}.{p.own}"
            names.append(of_system if of_system in self.own else f"{self.channel}.{p.name}")
        return tuple(names)

    @property
    def own_width(self) -> str:
        """The name of the width of the smoothed sign that it takes of the system; "" for none."""
        name = f"{self.channel}.{OWN_WIDTH}"
        return name if name in self.own else ""

    @property
    def brought(self) -> dict[str, ForceParameter]:
        """The parameters that it brings to the system, by name."""
        named = zip(self.parameter_names, self.law.parameters, strict=True)
        return {name: p for name, p in named if name not in self.own}

    def values(self, p: Values) -> list[Any]:
        """The values of its parameters, in the order of its law.

        Of a level that the system has itself 0: its friction is there already.
        """
        named = zip(self.parameter_names, self.law.parameters, strict=True)
        return [0.0 if need.is_level and name in self.own else p[name] for name, need in named]


def place_force(law: Law, channel: str, index: int, of_system: Collection[str]) -> PlacedForce:
    """A force at a coordinate or at an input of a system.

    Args:
        law: its law.
        channel: the name of the coordinate, or of the input.
        index: its place in q or in u.
        of_system: names of the parameters that the system has itself.
    """
    own = (f"{channel}.{p.own}" for p in law.parameters if p.own)
    if f"{channel}.{OWN_LEVEL}" not in of_system:
        own = ()
    return PlacedForce(law, channel, index, tuple(name for name in own if name in of_system))


def parse_forces(system: LagrangianSystem, names: Sequence[str]) -> tuple[PlacedForce, ...]:
    """The forces of some names.

    Args:
        system: the system that they are to be added to.
        names: `LAW` for a force at every coordinate, `LAW:COORDINATE` for one; of a law at inputs
            `LAW` for every input, `LAW:INPUT` for one.

    Raises:
        InputError: no such force, coordinate or input, or a force twice at one.
    """
    coordinates = [c.name for c in system.coordinates]
    inputs = [i.name for i in system.inputs]
    of_system = system.nominal().keys() - {*system.added_parameters}
    forces: list[PlacedForce] = []
    for name in names:
        law, colon, channel = name.partition(":")
        refuse_old_names(WHERE, [law], FORCES)
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
            force = place_force(LAWS[law], place, channels.index(place), of_system)
            if force in forces:
                raise InputError(WHERE, f"'{force}' twice", "once")
            forces.append(force)
    return tuple(forces)


@lru_cache(maxsize=64)  # so that the same system serves the same compiled programs
def with_forces(
    system: LagrangianSystem, names: tuple[str, ...], parameters: tuple[Parameter, ...]
) -> LagrangianSystem:
    """The system with further forces, their values among its parameters.

    Internal states come after those that the system has. Where a system has Coulomb friction
    itself, laws take its parameters (see `ForceParameter.own`).

    Args:
        system: the system.
        names: `LAW:COORDINATE` each, see `parse_forces`; none leaves the system as it is.
        parameters: the parameters that the forces bring, as `theta.coulomb`.

    Raises:
        InputError: a force that `parse_forces` refuses, a parameter that the system or another of
            the forces has already, or a load without a potential energy.
    """
    if not names:
        return system
    if system.feedback is not None:
        return with_changed_plant(system, lambda plant: with_forces(plant, names, parameters))
    added = parse_forces(system, names)
    _require_additions(system, added)
    springs = [(force, law) for force in added if isinstance(law := force.law, Spring)]
    frictions = [force for force in added if isinstance(force.law, Friction)]
    # those that depend on a deflection are added last, in whatever order the names stand
    frictions.sort(key=lambda force: force.law.needs_limited_travel)
    with_states = tuple(f for f in added if isinstance(f.law, ForceWithMemory | ActuatorLag))
    is_lagging = any(isinstance(force.law, ActuatorLag) for force in added)

    def dissipation(q: Any, v: Any, p: Values) -> Any:
        total = compute_friction(frictions, system.potential, q, v, p)
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
        added_parameters=(*system.added_parameters, *(p.name for p in parameters)),
    )


def _require_additions(system: LagrangianSystem, added: Sequence[PlacedForce]) -> None:
    """Raises if a system cannot have some forces, see `with_forces`."""
    of_system = system.nominal()
    owners = dict.fromkeys(of_system, f"the system '{system.name}'")
    for force in added:
        needs_load = isinstance(force.law, Friction) and force.law.needs_load
        if needs_load and system.potential is None:
            raise InputError(
                WHERE,
                f"'{force}': the system '{system.name}' has no potential energy",
                "a load, as of gravity",
            )
        for name, parameter in zip(force.parameter_names, force.law.parameters, strict=True):
            if name in force.own:
                if parameter.is_level and not _is_coulomb_level(system, name, force.index):
                    raise InputError(
                        WHERE,
                        f"'{force}' adds to a Coulomb friction of the level '{name}', and "
                        f"that of the system '{system.name}' is none at the coordinate",
                        f"p['{name}'] * jnp.tanh(v / w) in its dissipation",
                        "call the parameter otherwise; of a robot's elastic joint: "
                        "tn.load_robot(friction=...)",
                    )
                continue
            is_before = name in system.added_parameters or name not in of_system
            if name in owners and not (parameter.shared and is_before):
                raise InputError(
                    WHERE,
                    f"'{force}' brings '{name}', which {owners[name]} has already",
                    "forces that differ",
                    "leave it out, or call the other one otherwise",
                )
            owners[name] = f"'{force}'"


def _is_coulomb_level(system: LagrangianSystem, name: str, index: int) -> bool:
    """Whether a parameter of a system is the level of a Coulomb friction at a coordinate.

    If so, the dissipation at high speed grows by as much as the parameter, against the motion and
    at this coordinate alone.
    """
    if system.dissipation is None:
        return False
    dissipation, nominal = system.dissipation, system.nominal()
    n = len(system.coordinate_names)

    def by_level(v: Any) -> Any:
        def at(level: Any) -> Any:
            return jnp.asarray(dissipation(jnp.zeros_like(v), v, nominal | {name: level}))

        one = jnp.ones((), v.dtype)
        return jax.jvp(at, (nominal[name] * one,), (one,))[1]

    both = np.eye(n)[[index]] * np.array([[1.0], [-1.0]])
    slopes = evaluate(Formula(by_level, n, where=f"system '{system.name}'"), _FAST * both)
    return np.allclose(slopes, both, atol=1e-3)


def compute_friction(
    frictions: Sequence[PlacedForce],
    potential: Callable[..., Any] | None,
    q: Any,
    v: Any,
    p: Values,
) -> Any:
    """The sum of frictions at each coordinate, against the motion, (n_q,) [N m or N].

    Args:
        frictions: the frictions.
        potential: the energy `V(q, p)` [J] whose forces are the load; None where none needs it.
        q: positions, (n_q,).
        v: velocities, (n_q,).
        p: values of parameters by name.
    """
    laws = [(f, law) for f in frictions if isinstance(law := f.law, Friction)]
    load = q
    if potential is not None and any(law.needs_load for _, law in laws):
        load = jax.grad(potential)(q, p)
    acting = [
        (f.index, law.force((load if law.needs_load else q)[f.index], v[f.index], *f.values(p)))
        for f, law in laws
    ]
    return _sum_by_coordinate(v, acting)


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
        n = len(self.system.memory_states)
        return {f.index: k for k, f in enumerate(self.added, n) if isinstance(f.law, ActuatorLag)}

    def reached(self, z: Any, u: Any) -> Any:
        """The inputs, in the place of those that lag the states that follow them."""
        if not (lagging := self.lagging):
            return u
        n_u = len(self.system.inputs)
        return jnp.stack([z[lagging[i]] if i in lagging else u[i] for i in range(n_u)])

    def rate(self, q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
        """The rates of the system's internal states, then of the added ones."""
        before, n = self.system.memory, len(self.system.memory_states)
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
        system, before, n = self.system, self.system.memory, len(self.system.memory_states)
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
        before, n = self.system.memory, len(self.system.memory_states)
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
        names = (*self.system.memory_states, *map(str, self.added))
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
