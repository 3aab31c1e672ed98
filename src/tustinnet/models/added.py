"""Forces by name, added to a system, each at one of its coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax.numpy as jnp

from tustinnet.errors import InputError
from tustinnet.models.forces import LAWS, Friction, Law, RelaxingSpring, Spring
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter, Values
from tustinnet.renamed import FORCES

WHERE = "model.forces"


@dataclass(frozen=True)
class PlacedForce:
    """A force at a coordinate.

    Attributes:
        law: its law.
        coordinate: the name of the coordinate.
        index: the coordinate's place in q.
    """

    law: Law
    coordinate: str
    index: int

    def __str__(self) -> str:
        return f"{self.law.name}:{self.coordinate}"

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The names of its parameters, in the order of its law."""
        return tuple(f"{self.coordinate}.{p.name}" for p in self.law.parameters)

    def values(self, p: Values) -> list[Any]:
        """The values of its parameters, in the order of its law."""
        return [p[name] for name in self.parameter_names]


def parse_forces(system: LagrangianSystem, names: Sequence[str]) -> tuple[PlacedForce, ...]:
    """The forces of some names.

    Args:
        system: the system that they are to be added to.
        names: `LAW` for a force at every coordinate, `LAW:COORDINATE` for one; also laws by the
            names that they had in earlier versions, as files have them.

    Raises:
        InputError: no such force or coordinate, or a force twice at a coordinate.
    """
    coordinates = [c.name for c in system.coordinates]
    forces: list[PlacedForce] = []
    for name in names:
        law, colon, coordinate = name.partition(":")
        law = FORCES.get(law, law)
        if law not in LAWS:
            raise InputError(WHERE, f"no force '{law}'", f"one of {', '.join(LAWS)}")
        if colon and coordinate not in coordinates:
            raise InputError(
                WHERE, f"'{name}': no coordinate '{coordinate}'", f"one of {', '.join(coordinates)}"
            )
        for place in [coordinate] if colon else coordinates:
            force = PlacedForce(LAWS[law], place, coordinates.index(place))
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
    relaxing = [(force, law) for force in added if isinstance(law := force.law, RelaxingSpring)]

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
        memory=_memory_with(system, relaxing) if relaxing else system.memory,
        added=(*system.added, *map(str, added)),
    )


def _sum_by_coordinate(like: Any, acting: Sequence[tuple[int, Any]]) -> Any:
    """The sum of forces at each coordinate, (n_q,), from pairs of coordinate and force."""
    total = [jnp.zeros_like(x) for x in like]
    for i, force in acting:
        total[i] = total[i] + force
    return jnp.stack(total)


def _memory_with(
    system: LagrangianSystem, springs: Sequence[tuple[PlacedForce, RelaxingSpring]]
) -> Memory:
    """The memory of a system followed by that of added springs."""
    before, n = system.memory, len(system.internal)

    def rate(q: Any, v: Any, z: Any, p: Values) -> Any:
        added = jnp.stack(
            [
                law.rate(v[f.index], state, *f.values(p))
                for (f, law), state in zip(springs, z[n:], strict=True)
            ]
        )
        if before is None:
            return added
        return jnp.concatenate([jnp.asarray(before.rate(q, v, z[:n], p)), added])

    def force(q: Any, v: Any, z: Any, p: Values) -> Any:
        acting = [
            (f.index, law.force(state, *f.values(p)))
            for (f, law), state in zip(springs, z[n:], strict=True)
        ]
        added = _sum_by_coordinate(v, acting)
        return added if before is None else jnp.asarray(before.force(q, v, z[:n], p)) + added

    def initial(q: Any, v: Any, p: Values) -> Any:
        added = jnp.stack([law.initial(q[f.index], *f.values(p)) for f, law in springs])
        if before is None:
            return added
        first = before.initial
        first_states = jnp.asarray(first(q, v, p)) if first else jnp.zeros(n, added.dtype)
        return jnp.concatenate([first_states, added])

    names = (*system.internal, *(str(f) for f, _ in springs))
    return Memory(names, rate, force, initial)
