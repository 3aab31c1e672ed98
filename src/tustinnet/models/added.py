"""Forces that are added to a system by name, each at one of its coordinates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax.numpy as jnp

from tustinnet.errors import InputError
from tustinnet.models import forces
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter, Values

WHERE = "model.forces"
_SMOOTH = "smooth_speed"  # the dry frictions of a coordinate have one together


@dataclass(frozen=True)
class Law:
    """A force of the library: a friction, a spring, or a force that remembers.

    Attributes:
        needs: its parameters; that of the coordinate `theta` is called `theta.NEED`.
        friction: force against the motion, `friction(v, *values)` [N m or N].
        rubbing: one that a deflection brings, `rubbing(q, v, *values)` [N m or N].
        energy: `energy(q, *values)` [J].
        rate: of its internal state, `rate(v, z, *values)`.
        begun: that state where a record begins, `begun(q, *values)`.
        pull: what that state does to the coordinate, `pull(z, *values)` [N m or N].
    """

    needs: tuple[str, ...]
    friction: Callable[..., Any] | None = None
    rubbing: Callable[..., Any] | None = None
    energy: Callable[..., Any] | None = None
    rate: Callable[..., Any] | None = None
    begun: Callable[..., Any] | None = None
    pull: Callable[..., Any] | None = None

    @property
    def elastic(self) -> bool:
        """Whether it is of a deflection, which a coordinate that turns around has not."""
        return any(part is not None for part in (self.rubbing, self.energy, self.rate))


def _stribeck(v: Any, level: Any, more: Any, stribeck_speed: Any, speed: Any) -> Any:
    return forces.stribeck(v, level, level + more, stribeck_speed, speed)


LAWS = {
    "coulomb": Law(("coulomb", _SMOOTH), friction=forces.coulomb),
    "stribeck": Law(
        ("coulomb", "breakaway", "stribeck_speed", _SMOOTH), friction=_stribeck
    ),
    "viscous": Law(("viscous",), friction=forces.viscous),
    "rubbing": Law(("rubbing", _SMOOTH), rubbing=forces.rubbing),
    "spring": Law(("spring",), energy=forces.linear_spring),
    "cubic": Law(("cubic",), energy=forces.cubic_spring),
    "maxwell": Law(
        ("maxwell", "relaxation", "turned"),
        rate=lambda v, z, stiffness, relaxation, turned: forces.maxwell_rate(v, z, relaxation),
        begun=lambda q, stiffness, relaxation, turned: turned * q,
        pull=lambda z, stiffness, relaxation, turned: forces.maxwell_force(z, stiffness),
    ),
}  # fmt: skip


@dataclass(frozen=True)
class PlacedForce:
    """A force at a coordinate.

    Attributes:
        law: which of `LAWS`.
        coordinate: the name of the coordinate.
    """

    law: str
    coordinate: str

    def __str__(self) -> str:
        return f"{self.law}:{self.coordinate}"

    @property
    def needs(self) -> tuple[str, ...]:
        """What its parameters are called, in the order of its law."""
        return tuple(f"{self.coordinate}.{need}" for need in LAWS[self.law].needs)


def parse_forces(system: LagrangianSystem, names: Sequence[str]) -> tuple[PlacedForce, ...]:
    """The forces that names stand for.

    Args:
        system: the system that they are to be added to.
        names: `LAW` for a force at every coordinate, `LAW:COORDINATE` for one.

    Raises:
        InputError: no such force or coordinate, or a force twice at a coordinate.
    """
    every = [c.name for c in system.coordinates]
    found: list[PlacedForce] = []
    for name in names:
        law, colon, coordinate = name.partition(":")
        if law not in LAWS:
            raise InputError(WHERE, f"no force '{law}'", f"one of {', '.join(LAWS)}")
        if colon and coordinate not in every:
            raise InputError(
                WHERE, f"'{name}': no coordinate '{coordinate}'", f"one of {', '.join(every)}"
            )
        for at in [coordinate] if colon else every:
            if PlacedForce(law, at) in found:
                raise InputError(WHERE, f"'{law}:{at}' twice", "once")
            found.append(PlacedForce(law, at))
    return tuple(found)


def added_parameters(system: LagrangianSystem) -> tuple[str, ...]:
    """The names of the parameters that a system's added forces brought."""
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
        parameters: what the forces need, as `theta.coulomb`.

    Raises:
        InputError: what `parse_forces` refuses, or a parameter that the system or another of the forces
            has already.
    """
    if not names:
        return system
    added = parse_forces(system, names)
    _require_new(system, added)
    friction, rubbing, elastic = (
        _parts(system, added, part) for part in ("friction", "rubbing", "energy")
    )

    def dissipation(q: Any, v: Any, p: Values) -> Any:
        dry = [(i, law(v[i], *(p[n] for n in needs))) for i, needs, law in friction]
        wound = [(i, law(q[i], v[i], *(p[n] for n in needs))) for i, needs, law in rubbing]
        lost = _along(v, [*dry, *wound])
        return lost + jnp.asarray(system.dissipation(q, v, p)) if system.dissipation else lost

    def potential(q: Any, p: Values) -> Any:
        stored = sum(law(q[i], *(p[n] for n in needs)) for i, needs, law in elastic)
        return stored + system.potential(q, p) if system.potential else stored

    return replace(
        system,
        parameters=(*system.parameters, *parameters),
        dissipation=dissipation if friction or rubbing else system.dissipation,
        potential=potential if elastic else system.potential,
        memory=_remembering(system, added),
        added=(*system.added, *map(str, added)),
    )


def _require_new(system: LagrangianSystem, added: Sequence[PlacedForce]) -> None:
    """Raises where a parameter or internal state has its name already."""
    own = dict.fromkeys(system.nominal(), f"the system '{system.name}'")
    known, before = dict(own), added_parameters(system)
    for force in added:
        for name in force.parameter_names:
            free = name in before or name not in own
            shared = free and name.endswith(f".{_SMOOTH}")
            if name in known and not shared:
                raise InputError(
                    WHERE, f"'{force}' brings '{name}', which {known[name]} has already",
                    "forces that differ", "leave it out, or call the other one otherwise",
                )  # fmt: skip
            known[name] = f"'{force}'"


def _parts(
    system: LagrangianSystem, added: Sequence[PlacedForce], part: str
) -> list[tuple[int, tuple[str, ...], Callable[..., Any]]]:
    """Of forces whose law has a part: coordinate, names of the parameters, the part."""
    of = [c.name for c in system.coordinates]
    laws = [(f, getattr(LAWS[f.law], part)) for f in added]
    return [(of.index(f.coordinate), f.needs, law) for f, law in laws if law]


def _along(like: Any, acting: Sequence[tuple[int, Any]]) -> Any:
    """The sum of forces at coordinates, (n_q,)."""
    each = [jnp.zeros_like(x) for x in like]
    for i, force in acting:
        each[i] = each[i] + force
    return jnp.stack(each)


def _remembering(system: LagrangianSystem, added: Sequence[PlacedForce]) -> Memory | None:
    """The forces with memory that the system has, and behind them those that were added."""
    rates, pulls, begun = (_parts(system, added, part) for part in ("rate", "pull", "begun"))
    if not rates:
        return system.memory
    n = len(system.internal)

    def rate(q: Any, v: Any, z: Any, p: Values) -> Any:
        each = zip(rates, z[n:], strict=True)
        found = jnp.stack([law(v[i], x, *(p[m] for m in needs)) for (i, needs, law), x in each])
        if system.memory is None:
            return found
        return jnp.concatenate([jnp.asarray(system.memory.rate(q, v, z[:n], p)), found])

    def force(q: Any, v: Any, z: Any, p: Values) -> Any:
        each = zip(pulls, z[n:], strict=True)
        found = _along(v, [(i, law(x, *(p[m] for m in needs))) for (i, needs, law), x in each])
        if system.memory is None:
            return found
        return jnp.asarray(system.memory.force(q, v, z[:n], p)) + found

    def initial(q: Any, v: Any, p: Values) -> Any:
        found = jnp.stack([law(q[i], *(p[m] for m in needs)) for i, needs, law in begun])
        if system.memory is None:
            return found
        before = system.memory.initial
        own = jnp.asarray(before(q, v, p)) if before else jnp.zeros(n, found.dtype)
        return jnp.concatenate([own, found])

    names = tuple(str(force) for force in added if LAWS[force.law].rate)
    return Memory((*system.internal, *names), rate, force, initial)
