"""Forces by name, added to a system, each at a coordinate or, as lags of actuators, an input.

A motor or a friction that turns with two coordinates is at their sum, `A+B`, `A-B` or `A+0.5*B`.
"""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.models.closed_loop import gains_of, with_controller
from tustinnet.models.forces import (
    LAWS,
    OWN_LEVEL,
    OWN_WIDTH,
    ActuatorLag,
    AddedInertia,
    ForceParameter,
    ForceWithMemory,
    Friction,
    InputCurve,
    Law,
    Spring,
)
from tustinnet.models.internal_states import NO_MEMORY, Memory, Values
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.old_names import FORCES, refuse_old_names

WHERE = "model.forces"
_FAST = 1e6  # speed at which a Coulomb friction has reached its level [rad/s or m/s]


@dataclass(frozen=True)
class PlacedForce:
    """A force at a coordinate or a sum of two, or at an input.

    Attributes:
        law: its law.
        channel: the name of the coordinate, of the sum, or of the input.
        places: the coordinates' places in q with their factors in the sum, or the input's in u.
        own: parameters of the system, as it is without the force, that take the place of some of
            its law's.
    """

    law: Law
    channel: str
    places: tuple[tuple[int, float], ...]
    own: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.law.name}:{self.channel}"

    @property
    def index(self) -> int:
        """The place of the input, or of the first coordinate."""
        return self.places[0][0]

    def along(self, x: Any) -> Any:
        """The part of a vector over all coordinates that is along the force."""
        return sum(factor * x[i] for i, factor in self.places)

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


def place_force(
    law: Law, channel: str, places: tuple[tuple[int, float], ...], of_system: Collection[str]
) -> PlacedForce:
    """A force at coordinates or at an input of a system.

    Args:
        law: its law.
        channel: the name of the coordinate, of a sum of two, or of the input.
        places: their places in q or in u, with the factors of the sum.
        of_system: names of the parameters that the system has itself.
    """
    own = (f"{channel}.{p.own}" for p in law.parameters if p.own)
    if f"{channel}.{OWN_LEVEL}" not in of_system:
        own = ()
    return PlacedForce(law, channel, places, tuple(name for name in own if name in of_system))


def find_places(channel: str, coordinates: Sequence[str]) -> tuple[tuple[int, float], ...]:
    """Places and factors of a coordinate, or of a sum of two (`A+B`, `A-0.5*B`); else none."""
    if channel in coordinates:
        return ((coordinates.index(channel), 1.0),)
    for i, first in enumerate(coordinates):
        rest = re.fullmatch(r"([+-])(?:(\d+\.?\d*)\*)?(.+)", channel.removeprefix(first))
        if channel.startswith(first) and rest and rest[3] in coordinates:
            factor = float(f"{rest[1]}{rest[2] or 1}")
            return ((i, 1.0), (coordinates.index(rest[3]), factor))
    return ()


def parse_forces(system: LagrangianSystem, names: Sequence[str]) -> tuple[PlacedForce, ...]:
    """The forces of some names.

    Args:
        system: the system that they are to be added to.
        names: `LAW` for a force at every coordinate, `LAW:COORDINATE` for one, `LAW:A+B` for one
            at a sum of two; of a law at inputs `LAW` for every input, `LAW:INPUT` for one.

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
        for place in [channel] if colon else channels:
            places = find_places(place, channels)
            if not places or (kind == "input" and len(places) > 1):
                raise InputError(
                    WHERE, f"'{name}': no {kind} '{channel}'", f"one of {', '.join(channels)}"
                )
            force = place_force(LAWS[law], place, places, of_system)
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
        plant = with_forces(system.plant, names, parameters)
        return with_controller(plant, system.feedback.channels, gains_of(system))
    added = parse_forces(system, names)
    require_additions(system, added)
    springs = [(force, law) for force in added if isinstance(law := force.law, Spring)]
    frictions = [force for force in added if isinstance(force.law, Friction)]
    # those that depend on a deflection are added last, in whatever order the names stand
    frictions.sort(key=lambda force: force.law.needs_limited_travel)
    with_states = [f for f in added if isinstance(f.law, ForceWithMemory | ActuatorLag)]
    lagging = {f.index: k for k, f in enumerate(with_states) if f.law.is_at_input}
    curves = {f.index: (f, law) for f in added if isinstance(law := f.law, InputCurve)}

    def acting(q: Any, v: Any, z: Any, u: Any, p: Values) -> Any:
        """The acting inputs: in the place of those that lag the states that follow them."""
        reached = [z[lagging[i]] if i in lagging else u[i] for i in range(len(u))]
        for i, (force, law) in curves.items():
            reached[i] = law.acting(reached[i], *force.values(p))
        return jnp.stack(reached)

    def dissipation(q: Any, v: Any, p: Values) -> Any:
        total = compute_friction(frictions, system.potential, q, v, p)
        return total + jnp.asarray(system.dissipation(q, v, p)) if system.dissipation else total

    def potential(q: Any, p: Values) -> Any:
        energy = sum(law.energy(f.along(q), *f.values(p)) for f, law in springs)
        return energy + system.potential(q, p) if system.potential else energy

    inertias = [force for force in added if isinstance(force.law, AddedInertia)]
    changed: dict[str, Any] = _with_inertias(system, inertias) if inertias else {}
    if with_states or curves:
        memory = reduce(Memory.followed_by, map(_memory_of, with_states), NO_MEMORY)
        changed |= system.inside(memory, acting if lagging or curves else None)
    return replace(
        system,
        parameters=(*system.parameters, *parameters),
        dissipation=dissipation if frictions else system.dissipation,
        potential=potential if springs else system.potential,
        added=(*system.added, *map(str, added)),
        added_parameters=(*system.added_parameters, *(p.name for p in parameters)),
        **changed,
    )


def _with_inertias(system: LagrangianSystem, added: Sequence[PlacedForce]) -> dict[str, Any]:
    """Attributes of a system with further inertias."""
    directions = np.zeros((len(added), len(system.coordinate_names)))
    for row, force in zip(directions, added, strict=True):
        for i, factor in force.places:
            row[i] += factor

    def matrix(p: Values) -> Any:
        own = jnp.stack([jnp.asarray(force.values(p)[0]) for force in added])
        return (directions.T * own) @ directions

    def kinetic(q: Any, v: Any, p: Values) -> Any:
        return system.kinetic(q, v, p) + v @ matrix(p) @ v / 2

    inertia = system.inertia
    if inertia is not None:
        alone, coupled = inertia.mass_matrix, {i for row in directions for i in np.flatnonzero(row)}
        inverse = inertia.inverse
        inertia = replace(
            inertia,
            mass_matrix=lambda q, p: alone(q, p) + matrix(p),
            uncoupled=tuple(i for i in inertia.uncoupled if i not in coupled),
            inverse=inverse and (lambda q, v, a, p: inverse(q, v, a, p) + matrix(p) @ a),
        )
    return {"kinetic": kinetic, "inertia": inertia}


def require_additions(system: LagrangianSystem, added: Sequence[PlacedForce]) -> None:
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
        (f, law.force(f.along(load if law.needs_load else q), f.along(v), *f.values(p)))
        for f, law in laws
    ]
    return _sum_by_coordinate(v, acting)


def _sum_by_coordinate(like: Any, acting: Sequence[tuple[PlacedForce, Any]]) -> Any:
    """The sum of forces at each coordinate, (n_q,), from the forces and their values."""
    total = [jnp.zeros_like(x) for x in like]
    for force, value in acting:
        for i, factor in force.places:
            total[i] = total[i] + factor * value
    return jnp.stack(total)


def _memory_of(force: PlacedForce) -> Memory:
    """The internal states of an added force, or of an actuator that lags."""
    law, i = force.law, force.index
    if isinstance(law, ActuatorLag):
        return Memory(
            (str(force),),
            lambda q, v, z, u, p: jnp.stack([law.rate(u[i], z[0], *force.values(p))]),
            initial=lambda q, v, u, p: jnp.stack([law.initial(u[i], *force.values(p))]),
        )
    assert isinstance(law, ForceWithMemory)
    rate, force_of, initial, settle = law.rate, law.force, law.initial, law.settle
    names = tuple(f"{force}:{k + 1}" for k in range(law.states or 0)) or (str(force),)

    def given(z: Any) -> Any:
        return z if law.states else z[0]

    return Memory(
        names,
        lambda q, v, z, p: jnp.atleast_1d(rate(force.along(v), given(z), *force.values(p))),
        lambda q, v, z, p: _sum_by_coordinate(
            v, [(force, force_of(force.along(v), given(z), *force.values(p)))]
        ),
        lambda q, v, p: jnp.atleast_1d(initial(force.along(q), *force.values(p))),
        settle=settle and (lambda z, p: jnp.atleast_1d(settle(given(z), *force.values(p)))),
    )
