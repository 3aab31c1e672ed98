"""Forces along records as a linear function of parameters, with further forces beside a system's.

`LinearForces` is a system, the parameters of a search, and filtered records. It makes the columns
whose sums `solver` takes. Forces of the library that are linear in their levels are further
columns, so that folds may decide on them without any other evaluation.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.fitting.inverse_dynamics.along import (
    FilteredRecord,
    ForcesAlong,
    filter_record,
    follow,
)
from tustinnet.fitting.inverse_dynamics.solver import Prior, coordinates_of
from tustinnet.fitting.inverse_dynamics.sums import Columns
from tustinnet.fitting.shooting.base_parameters import LinearCoordinates
from tustinnet.fitting.shooting.equations import SystemEquations, system_equations
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.added import PlacedForce, parse_forces
from tustinnet.models.forces import AddedInertia, ForceWithMemory, Friction, Law, Spring
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

CANDIDATES = "search.candidates"
_STEP = 1e-4  # of a value or a range, by which slopes are differences


@dataclass(frozen=True, eq=False)
class LinearForces:
    """The forces of a system along filtered records, and forces that are linear beside them.

    Attributes:
        system: the system, without a controller in the loop.
        space: the search space; of the forces beside the system their parameters stand last.
        parts: the filtered records.
        beside: the forces beside the system.
        brought: the parameters of these.
    """

    system: LagrangianSystem
    space: SearchSpace
    parts: tuple[FilteredRecord, ...]
    beside: tuple[PlacedForce, ...] = ()
    brought: tuple[Parameter, ...] = ()

    @cached_property
    def alone(self) -> SearchSpace:
        """The search space of the system without the forces beside it."""
        return self.space.without({p.name for p in self.brought})

    @cached_property
    def along(self) -> tuple[ForcesAlong, ...]:
        """The forces of the system along each record."""
        equations = system_equations(self.system)
        return tuple(ForcesAlong(equations, part, self.system.nominal()) for part in self.parts)

    @cached_property
    def prior(self) -> Prior:
        """The priors of the parameters."""
        return Prior(self.space, self.gains)

    @cached_property
    def gains(self) -> dict[str, int]:
        """Gains of the inputs with the places of the coordinates that they act on."""
        return _input_gains(self.system, self.parts[0].q[0])

    def gains_among(self, values: Mapping[str, float]) -> dict[int, float]:
        """The values of free gains of inputs, by their places in the search space."""
        names = self.space.names
        return {names.index(n): values[n] for n in self.gains if n in names and n in values}

    def of_records(self, records: Sequence[Experiment]) -> "LinearForces":
        """The linear forces along other records."""
        cutoff = self.parts[0].cutoff
        return replace(self, parts=tuple(filter_record(e, cutoff) for e in records))

    def with_forces(
        self, forces: Sequence[PlacedForce], parameters: Sequence[Parameter]
    ) -> "LinearForces":
        """The linear forces with further forces beside the system, with parameters of their own."""
        space = self.space.adding(parameters)
        return self._with_beside(space, (*self.beside, *forces), (*self.brought, *parameters))

    def without(self, forces: Sequence[PlacedForce]) -> "LinearForces":
        """The linear forces without some of those beside the system."""
        beside = tuple(force for force in self.beside if force not in forces)
        used = {name for force in beside for name in force.brought}
        brought = tuple(p for p in self.brought if p.name in used)
        space = self.space.without({p.name for p in self.brought} - used)
        fixed = {p.name for p in self.brought if p.fixed} - used
        kept = {name: x for name, x in space.fixed_values.items() if name not in fixed}
        return self._with_beside(replace(space, fixed_values=kept), beside, brought)

    def _with_beside(
        self,
        space: SearchSpace,
        beside: tuple[PlacedForce, ...],
        brought: tuple[Parameter, ...],
    ) -> "LinearForces":
        other = LinearForces(self.system, space, self.parts, beside, brought)
        other.__dict__.update(along=self.along, gains=self.gains)  # the system is asked once
        return other

    def columns(
        self, vector: ParameterVector, alone: Sequence[Columns] | None = None
    ) -> list[Columns]:
        """The missing forces of each record, linear about a vector.

        Args:
            vector: the parameters.
            alone: the columns of the system alone, where these are known.
        """
        columns = self._columns_alone(vector) if alone is None else [*alone]
        if not self.beside:
            return columns
        beside = self.columns_beside(vector, self.beside)
        return [own.followed_by(more) for own, more in zip(columns, beside, strict=True)]

    def _columns_alone(self, vector: ParameterVector) -> list[Columns]:
        values = self.space.to_values(vector)
        point = LinearCoordinates(self.alone, values)
        # machine code of derivatives would take far longer to make than differences, which are
        # exact on one side, too: forces are linear in these coordinates
        steps = {
            p.name: _STEP * (values[p.name] if p.positive else p.upper - p.lower)
            for p in self.alone.free_parameters
        }
        others = [{**values, name: values[name] + step} for name, step in steps.items()]
        moved = [LinearCoordinates(self.alone, other).values - point.values for other in others]
        by_coordinate = np.linalg.inv(np.transpose(moved))
        columns = []
        for along, part in zip(self.along, self.parts, strict=True):
            slopes = along.changes(values, others) @ by_coordinate
            missing, needed = along.missing(values), along.needed(values)
            own = Columns(
                slopes,
                missing - slopes @ point.values,
                needed - missing,
                needed,
                part.compare(np.abs(part.v)),
                part.weight,
            )
            columns.append(own)
        return columns

    def missing(self, vector: ParameterVector) -> list[Float[np.ndarray, "_ n_q"]]:
        """The missing forces of each record: needed by its motion, given by nothing [N m or N]."""
        values = self.space.to_values(vector)
        if not self.beside:
            return [along.missing(values) for along in self.along]
        levels = coordinates_of(self.space, vector)[len(self.alone.names) :]
        beside = self.columns_beside(vector, self.beside)
        return [
            along.missing(values) + more @ levels
            for along, more in zip(self.along, beside, strict=True)
        ]

    def columns_beside(
        self, vector: ParameterVector, forces: Sequence[PlacedForce]
    ) -> list[Float[np.ndarray, "_ n_q _"]]:
        """The forces that each record's motion needs because of some forces, by their levels."""
        values, parts = self.space.to_values(vector), self.parts
        joined = _JoinedMotion.join(parts)
        needs_load = any(isinstance(f.law, Friction) and f.law.needs_load for f in forces)
        load = self._load(values) if needs_load else joined.q
        along, factors = [], []  # what each needs along its own direction, and of whom
        for force in forces:
            along.append(_needed_by(force, joined, force.along(load.T), values))
            at = np.zeros((joined.q.shape[1], along[-1].shape[1]))
            for i, factor in force.places:
                at[i] += factor
            factors.append(at)
        ends = np.cumsum([len(part.q) for part in parts])[:-1]
        by_part = np.split(np.concatenate(along, axis=1), ends)
        of_forces = np.concatenate(factors, axis=1)
        return [
            part.compare(own)[:, None] * of_forces for part, own in zip(parts, by_part, strict=True)
        ]

    def _load(self, values: Mapping[str, float]) -> Float[np.ndarray, "n n_q"]:
        """Forces of the potential energy along the records, one after the other [N m or N]."""
        loads = []
        for along, part in zip(self.along, self.parts, strict=True):
            points = along.with_parameters(part.q, values)
            loads.append(evaluate(_load_formula(along.equations), points))
        return np.concatenate(loads)


class _JoinedMotion(NamedTuple):
    """The motion of records one after the other.

    Attributes:
        q: positions, (n, n_q).
        v: velocities, (n, n_q).
        a: accelerations, (n, n_q).
        dt: period that ends at each sample, (n,) [s].
        goes_on: 0 at the first sample of each record, else 1, (n,).
    """

    q: Float[np.ndarray, "n n_q"]
    v: Float[np.ndarray, "n n_q"]
    a: Float[np.ndarray, "n n_q"]
    dt: Float[np.ndarray, " n"]
    goes_on: Float[np.ndarray, " n"]

    @classmethod
    def join(cls, parts: Sequence[FilteredRecord]) -> "_JoinedMotion":
        """The motion of some records."""
        q, v, a = (np.concatenate([getattr(part, name) for part in parts]) for name in "qva")
        dt = np.concatenate([np.full(len(part.q), part.dt) for part in parts])
        goes_on = np.concatenate([np.arange(len(part.q)) > 0 for part in parts])
        return cls(q, v, a, dt, goes_on.astype(float))


def parse_candidates(system: LagrangianSystem, names: Sequence[str]) -> tuple[PlacedForce, ...]:
    """Forces of some names that can stand beside a system.

    Raises:
        InputError: a force that `parse_forces` refuses, or one that is not linear in its levels.
    """
    forces = parse_forces(system, names)
    for force in forces:
        if not force.law.is_linear:
            raise InputError(
                CANDIDATES,
                f"'{force}', whose parameters do not all multiply a force",
                "a force that does not depend on inputs and is linear in its parameters",
                f"ask for it behind the recipe's name: '+ {force}'",
            )
    return forces


def _input_gains(system: LagrangianSystem, q: Float[np.ndarray, " n_q"]) -> dict[str, int]:
    """The parameters that the inputs' force at one coordinate is proportional to, and its place.

    Args:
        system: the system.
        q: positions at which it is looked.
    """
    if (input_map := system.input_map) is None:
        return {}
    nominal, still, u = system.nominal(), jnp.zeros(len(q)), jnp.ones(len(system.inputs))

    def pushed(values: Mapping[str, float]) -> np.ndarray:
        ends = (np.asarray(input_map(jnp.asarray(q), still, x, values)) for x in (u, 0.0 * u))
        return np.subtract(*ends)

    force, gains = pushed(nominal), dict[str, int]()
    if np.array_equal(pushed({name: 2 * x for name, x in nominal.items()}), force):
        return gains  # of most robots, at once
    for p in system.parameters:
        # a doubled gain doubles the force; derivatives would take longer to compile than these
        more = (
            np.zeros_like(force) if p.fixed else pushed({**nominal, p.name: 2 * p.nominal}) - force
        )
        driven = np.flatnonzero(more)
        if len(driven) == 1 and np.isclose(more[driven], force[driven]).all():
            gains[p.name] = int(driven[0])
    return gains


def levels_of(force: PlacedForce) -> list[str]:
    """The names of the parameters that a force beside a system is linear in."""
    return [name for name, p in force.brought.items() if not p.fixed]


def _needed_by(
    force: PlacedForce, motion: _JoinedMotion, load: Array | np.ndarray, values: Mapping[str, float]
) -> Float[np.ndarray, "n m"]:
    """The force that a motion needs because of another one, along its direction, for a level of 1.

    Args:
        force: the force.
        motion: the motion.
        load: forces of the potential energy along its direction, (n,) [N m or N].
        values: values of parameters, of which those that are no levels count.
    """
    levels = levels_of(force)
    nothing = {**values, **dict.fromkeys(levels, 0.0)}
    units = np.array([force.values({**nothing, name: 1.0}) for name in levels])
    q, v, a = (force.along(x.T) for x in (motion.q, motion.v, motion.a))
    return np.asarray(_by_level(force.law)(q, v, a, load, motion.dt, motion.goes_on, units))


@lru_cache  # so that it is compiled once
def _by_level(law: Law) -> Callable[..., Array]:
    """Forces of a law that a motion needs, (n, m), by rows of its parameters' values, (m, _)."""

    def needed(
        q: Array, v: Array, a: Array, load: Array, dt: Array, goes_on: Array, units: Array
    ) -> Array:
        z = q
        if isinstance(law, ForceWithMemory):
            z = _remember(law, v, dt, goes_on, units[0])

        def of_unit(unit: Array) -> Array:
            if isinstance(law, AddedInertia):
                return unit[0] * a
            if isinstance(law, Spring):
                energy = law.energy
                return jax.vmap(jax.grad(lambda q: energy(q, *unit)))(q)
            if isinstance(law, ForceWithMemory):
                return -law.force(v, z.T, *unit)
            assert isinstance(law, Friction)
            return law.force(load if law.needs_load else q, v, *unit)

        return jax.vmap(of_unit, out_axes=1)(units)

    return jax.jit(needed)


def _remember(law: ForceWithMemory, v: Array, dt: Array, goes_on: Array, values: Array) -> Array:
    """The internal states of a law along a motion, (n, states), 0 where records begin."""
    assert law.settle is not None
    settle = law.settle

    def step(z: Array, v: Array, dt: Array, goes_on: Array) -> Array:
        return settle(goes_on * (z + dt * law.rate(v, z, *values)), *values)

    return follow(step, jnp.zeros(law.states or 1), v, dt, goes_on)


@lru_cache(maxsize=64)  # so that it is compiled once
def _load_formula(equations: SystemEquations) -> Formula:
    """Forces of the potential energy, (n_q,), by positions and parameters."""
    system, n = equations.system, len(equations.system.coordinates)

    def load(point: Array) -> Array:
        assert system.potential is not None
        return jax.grad(system.potential)(point[:n], equations.values_in_row(point[n:]))

    return Formula(load, n + equations.n_columns, range(0), f"system '{system.name}'")
