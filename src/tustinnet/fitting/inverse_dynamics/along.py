"""Forces along the motion of records: filtered, evaluated, compared.

A motion is filtered and differentiated, forces are evaluated along it and filtered after that, for
friction changes its sign faster than a filtered velocity shows.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.fitting.shooting.equations import SystemEquations
from tustinnet.fitting.shooting.groups import expand_parameters_by_values, group_indices
from tustinnet.models.internal_states import Memory
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sensors import delay_names
from tustinnet.signals.low_pass import HIGHEST_CUTOFF, low_pass, noise_bandwidth


class FilterSettings(NamedTuple):
    """Settings by which the motion and the forces of a record are filtered.

    All are set by hand, not measured.

    Attributes:
        compared: samples at which forces are compared, for each period of the cut-off
            frequency of forces.
        evaluated: samples for each of these periods at which forces are evaluated, at most.
        motion: cut-off frequency of the motion, by that of the forces: friction needs
            sharper reversals.
        inputs: cut-off frequency of the inputs by that of the forces, before samples are
            left out.
        fewest: samples that must be left of a record.
    """

    compared: float = 2.5
    evaluated: int = 20
    motion: float = 6.0
    inputs: float = 6.0
    fewest: int = 20


FILTER = FilterSettings()


class Obstacle(NamedTuple):
    """Reason why a system cannot be identified by inverse dynamics.

    Attributes:
        problem: what it is, as words behind "inverse dynamics".
        expected: what is needed instead.
        remedy: what to do.
    """

    problem: str
    expected: str
    remedy: str


class FilteredRecord(NamedTuple):
    """The motion and the inputs of a record, and how forces along it are compared.

    Attributes:
        record: the record.
        q: positions, (n, n_q).
        v: velocities, (n, n_q).
        a: accelerations, (n, n_q).
        u: inputs, (n, n_u).
        dt: period of these samples [s].
        cutoff: frequency up to which forces are compared [Hz].
    """

    record: Experiment
    q: Float[np.ndarray, "n n_q"]
    v: Float[np.ndarray, "n n_q"]
    a: Float[np.ndarray, "n n_q"]
    u: Float[np.ndarray, "n n_u"]
    dt: float
    cutoff: float

    @property
    def step(self) -> int:
        """Number of samples from one at which forces are compared to the next."""
        return max(1, int(1 / (FILTER.compared * self.cutoff * self.dt)))

    @property
    def edge(self) -> int:
        """Number of samples at each end that are not compared."""
        return round(1 / (self.cutoff * self.dt))

    @property
    def weight(self) -> float:
        """Independent measurements by compared sample: filtered noise is correlated."""
        return min(1.0, 2 * noise_bandwidth(self.cutoff) * self.step * self.dt)

    @property
    def kept(self) -> slice:
        """The samples that are compared."""
        return slice(self.edge, len(self.q) - self.edge, self.step)

    @property
    def times(self) -> Float[np.ndarray, " k"]:
        """Times of the samples that are compared [s]."""
        return self.record.t[0] + self.dt * np.arange(len(self.q))[self.kept]

    def compare(self, forces: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "k m"]:
        """Forces along the record as they are compared: filtered, at nearly independent samples."""
        compared, some = np.zeros_like(forces[self.kept]), forces.any(axis=0)
        compared[:, some] = low_pass(forces[:, some], self.dt, self.cutoff)[self.kept]
        return compared


def filter_record(e: Experiment, cutoff: float) -> FilteredRecord:
    """The motion of a record and its derivatives, as smooth as forces up to a frequency need them.

    Args:
        e: the record.
        cutoff: frequency up to which forces are compared [Hz].

    Raises:
        InputError: the record is too short.
    """
    motion_cutoff = min(FILTER.motion * cutoff, HIGHEST_CUTOFF / e.dt)
    q, v, a = (low_pass(e.q, e.dt, motion_cutoff, derivative) for derivative in range(3))
    # what a held input is around a sample, to fourth order: their mean would be too smooth
    first, last = e.held_inputs[:1], e.held_inputs[-1:]
    padded = np.vstack([first, first, e.held_inputs, last, last])
    u = (13 * (padded[1:-2] + padded[2:-1]) - padded[:-3] - padded[3:]) / 24
    every = max(1, int(1 / (FILTER.evaluated * cutoff * e.dt)))
    if every > 1:
        u = low_pass(u, e.dt, FILTER.inputs * cutoff)
    part = FilteredRecord(e, q[::every], v[::every], a[::every], u[::every], every * e.dt, cutoff)
    if (remaining := len(part.q) - 2 * part.edge) < FILTER.fewest:
        raise InputError(
            f"record '{e.name}'",
            f"{len(e)} samples, of which a filter of {cutoff:.3g} Hz leaves {max(remaining, 0)}",
            f"at least {FILTER.fewest}",
            "longer records, or another search.cutoff",
        )
    return part


def find_obstacle(system: LagrangianSystem, records: Sequence[Experiment]) -> Obstacle | None:
    """Why a system cannot be identified by forces along the motion of records; None if it can.

    Args:
        system: the system, without a controller in the loop.
        records: the records.
    """
    by_simulation = "identify it by simulation: `recipe=` grey"
    if system.unmeasured or not _follows_motion(system):
        return Obstacle("of a system with internal states", "one without", by_simulation)
    if delay_names(system.sensors):
        return Obstacle("of a system with delays", "one without", by_simulation)
    if any(e.channels.controller is not None and e.outputs is None for e in records):
        return Obstacle(
            "without the inputs that the controller computed",
            "their columns in the data card",
            "add them, or identify by simulation: `recipe=` grey",
        )
    return None


def require_possible(system: LagrangianSystem, records: Sequence[Experiment]) -> None:
    """Raises where `find_obstacle` finds one."""
    if (obstacle := find_obstacle(system, records)) is not None:
        raise InputError(
            "search.method",
            f"inverse-dynamics, {obstacle.problem}",
            obstacle.expected,
            obstacle.remedy,
        )


def _follows_motion(system: LagrangianSystem) -> bool:
    """Whether internal states follow from the motion alone, whatever the free parameters are."""
    memory, n = system.states.memory, len(system.coordinates)
    if not memory.names:
        return True
    if memory.has_inputs:
        return False
    free = {p.name: p.nominal for p in system.parameters if not p.fixed}
    fixed = system.nominal()

    def following(free: Mapping[str, Array]) -> Array:
        p, moving = {**fixed, **free}, jnp.ones(n)
        z = jnp.linspace(0.1, 1.0, len(memory.names))
        rate = memory.compute_rate(moving, moving, z, None, p)
        return jnp.concatenate([rate, memory.compute_settled(z, p)])

    return not any(np.any(slope) for slope in jax.jacfwd(following)(free).values())


def remember(
    memory: Memory, values: Mapping[str, float], part: FilteredRecord
) -> Float[np.ndarray, "n n_z"]:
    """Internal states along a motion, those that follow from it alone, 0 at first, (n, n_z)."""
    if not memory.names:
        return np.zeros((len(part.q), 0))

    def step(z: Array, q: Array, v: Array) -> Array:
        z = z + part.dt * memory.compute_rate(q, v, z, None, values)
        return memory.compute_settled(z, values)

    start = jnp.zeros(len(memory.names), part.q.dtype)
    return np.asarray(follow(step, start, jnp.asarray(part.q), jnp.asarray(part.v)))


def follow(step: Callable[..., Array], start: Array, *motion: Array) -> Array:
    """Internal states along a motion, (n, n_z): the start, then one step for each further sample.

    Args:
        step: the next states, by the states and what the motion has at a sample.
        start: the states at the first sample, (n_z,).
        motion: arrays whose first axis are the samples.
    """

    def one(z: Array, now: tuple[Array, ...]) -> tuple[Array, Array]:
        z = step(z, *now)
        return z, z

    following = jax.lax.scan(one, start, tuple(x[1:] for x in motion))[1]
    return jnp.concatenate([start[None], following])


@lru_cache(maxsize=64)  # so that it is compiled once
def missing_forces(equations: SystemEquations) -> Formula:
    """Forces that a motion needs and the inputs do not give, (n_q,), by a point of a record.

    A point is [q, v, a, z, u, parameters]; differentiated by the free ones.
    """
    system = equations.system
    n, n_z, n_u = len(system.coordinates), len(system.internal), len(system.inputs)
    ends = np.cumsum([n, n, n, n_z, n_u])

    def missing(point: Array) -> Array:
        q, v, a, z, u, row = jnp.split(point, ends)
        model = system.model(equations.values_in_row(row))
        return model.imbalance(jnp.concatenate([q, v, z]), u, a)

    first = int(ends[-1])
    free = range(first, first + equations.n_p)
    return Formula(missing, first + equations.n_columns, free, f"system '{system.name}'")


class ForcesAlong:
    """The forces of a system along a filtered record, by the values of its parameters.

    Args:
        equations: the equations of the system, without a controller in the loop.
        part: the record.
        values: values of the parameters by name, of which those of internal states count.
    """

    def __init__(
        self, equations: SystemEquations, part: FilteredRecord, values: Mapping[str, float]
    ) -> None:
        self.equations, self.part, self.formula = equations, part, missing_forces(equations)
        z = remember(equations.system.states.memory, values, part)
        self.points = np.concatenate([part.q, part.v, part.a, z, part.u], axis=1)
        self.at_rest = self.points.copy()
        self.at_rest[:, self.points.shape[1] - part.u.shape[1] :] = 0.0

    def missing(self, values: Mapping[str, float]) -> Float[np.ndarray, "k n_q"]:
        """The missing forces, filtered as they are compared [N m or N]."""
        return self.part.compare(self._evaluate(self.points, values))

    def needed(self, values: Mapping[str, float]) -> Float[np.ndarray, "k n_q"]:
        """The forces that the motion needs, filtered as they are compared [N m or N]."""
        return self.part.compare(self._evaluate(self.at_rest, values))

    def changes(
        self, values: Mapping[str, float], others: Sequence[Mapping[str, float]]
    ) -> Float[np.ndarray, "k n_q m"]:
        """The change of the missing forces by other values, filtered as compared [N m or N].

        Args:
            values: the values of all parameters by name.
            others: other values of all of them.
        """
        columns, own = [], self.with_parameters(self.points, values)
        nominal, before = self._row(values), evaluate(self.formula, own)
        for other in others:
            row = self._row(other)
            changed = np.flatnonzero(row != nominal)
            own[:, self.points.shape[1] + changed] = row[changed]
            columns.append(evaluate(self.formula, own) - before if len(changed) else 0 * before)
            own[:, self.points.shape[1] + changed] = nominal[changed]
        stacked = np.stack(columns, axis=2)
        compared = self.part.compare(stacked.reshape(len(stacked), -1))
        return compared.reshape(len(compared), *stacked.shape[1:])

    def _evaluate(
        self, points: Float[np.ndarray, "n m"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "n n_q"]:
        return evaluate(self.formula, self.with_parameters(points, values))

    def with_parameters(
        self, points: Float[np.ndarray, "n m"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "n m_and_p"]:
        """Points with the parameters behind them, as the formula takes them."""
        row = self._row(values)
        return np.concatenate([points, np.broadcast_to(row, (len(points), len(row)))], axis=1)

    def _row(self, values: Mapping[str, float]) -> Float[np.ndarray, " p"]:
        """The parameters that apply to the record."""
        system = self.equations.system
        parameters = expand_parameters_by_values(system, values)
        indices = group_indices(system, parameters, [self.part.record])
        return self.equations.parameter_rows(values, indices)[0]
