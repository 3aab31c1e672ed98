"""A system's equations of motion as formulas of the engine, with derivatives by free parameters.

The engine takes parameters as rows of numbers. `SystemEquations` says which parameter is in which
column of such a row, and has the formulas: the derivative of the state, the momentum balance, the
derivative of measured states linearised about them, and the internal states that are expected at
the beginning of a record.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Equations, Formula
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sensors import delay_name
from tustinnet.simulate.simulation import delay_changes, system_motion

GroupIndices = Int[np.ndarray, "n n_g"]  # see `groups.group_indices`


class InitialStates(NamedTuple):
    """Initial states of segments and their derivatives, a direction in a row.

    Attributes:
        states: the states, (n, n_x).
        by_parameter: derivatives by the free parameters, (n, n_p, n_x).
        by_state: derivatives by the states that are searched for, (n, n_x, n_x).
    """

    states: Float[np.ndarray, "n n_x"]
    by_parameter: Float[np.ndarray, "n n_p n_x"]
    by_state: Float[np.ndarray, "n n_x n_x"]


@dataclass(frozen=True)
class SystemEquations:
    """The equations of a system, their parameters in a fixed order.

    Attributes:
        system: the system.
        free_names: parameters that derivatives are needed by; one per group counts once.
        other_names: all other parameters.
        has_delays: whether delays of inputs are free. Then the inputs are followed by their
            derivatives by their delays, and the parameters by the delays that the inputs were
            made with.
    """

    system: LagrangianSystem
    free_names: tuple[str, ...]
    other_names: tuple[str, ...]
    has_delays: bool

    @property
    def n_p(self) -> int:
        """Number of parameters that derivatives are needed by."""
        return len(self.free_names)

    @property
    def n_columns(self) -> int:
        """Number of all parameters that the equations take."""
        n_delays = len(self.system.inputs) if self.has_delays else 0
        return self.n_p + len(self.other_names) + n_delays

    @cached_property
    def motion(self) -> Equations:
        """Derivative of the state by time."""
        return system_motion(self.system, self.free_names, self.other_names, delays=self.has_delays)

    @cached_property
    def expected_internal_states(self) -> Formula:
        """Internal states that are expected at a beginning, by [q, v], parameters and inputs.

        Inputs stand last, and only where the internal states depend on them; they are followed by
        their derivatives by their delays where these are free. Differentiated by all but the
        inputs and the parameters that are not free.
        """
        system, measured, n_u = self.system, self.system.channels.measured, len(self.system.inputs)
        last = measured.stop + self.n_columns

        def expected(point: Array) -> Array:
            row = point[measured.stop : last]
            values = self.values_in_row(row)
            if not self.expects_by_inputs:
                return system.model(values).initial_internal(point[measured])
            u = point[last : last + n_u]
            if self.has_delays:
                u = u + point[last + n_u :] * delay_changes(system, values, row[-n_u:])
            return system.model(values).initial_internal(point[measured], u)

        differentiated = range(measured.stop + self.n_p)
        size = last + (n_u * (1 + self.has_delays) if self.expects_by_inputs else 0)
        return Formula(expected, size, differentiated, f"system '{system.name}'")

    @property
    def expects_by_inputs(self) -> bool:
        """Whether the internal states that are expected at a beginning depend on inputs."""
        return self.system.states.initial_needs_inputs

    @cached_property
    def momentum_and_force(self) -> Formula:
        """Momentum and generalised force, (2 n_q,), by [q, v], the inputs and the parameters.

        Differentiated by the free parameters. Forces with memory are left out, except those whose
        internal states follow inputs: an actuator without its lag. Unmeasured coordinates follow
        the measured ones rigidly.
        """
        system, channels = rigid_system(self.system), self.system.channels
        first = channels.measured.stop + channels.n_u

        def momentum_and_force(point: Array) -> Array:
            q, v = point[channels.position], point[channels.velocity]
            u = point[channels.measured.stop : first]
            values = self.values_in_row(point[first:])
            momentum = jax.grad(system.kinetic, argnums=1)(q, v, values)
            force = jax.grad(system.kinetic)(q, v, values)
            if system.potential:
                force = force - jax.grad(system.potential)(q, values)
            model = system.model(values)
            z = model.balanced_internal(q, v, u)
            return jnp.concatenate([momentum, force + model.applied(q, v, z, u)])

        return Formula(
            momentum_and_force,
            first + self.n_columns,
            range(first, first + self.n_p),
            f"system '{system.name}'",
        )

    @cached_property
    def measured_derivative(self) -> Formula:
        """Derivative of [q, v] by time, by a change of [q, v], themselves, inputs and parameters.

        Differentiated by the change, which internal states do not follow: those that inputs drive
        are balanced without it, see `LagrangianModel.balanced_internal`.
        """
        channels, n_m = self.system.channels, self.system.channels.measured.stop
        ends = np.cumsum([n_m, n_m, channels.n_u])

        def derivative(point: Array) -> Array:
            change, measured, u, row = jnp.split(point, ends)
            model = self.system.model(self.values_in_row(row))
            q, v = measured[channels.position], measured[channels.velocity]
            x = jnp.concatenate([measured + change, model.balanced_internal(q, v, u)])
            return model.derivative(x, u)[channels.measured]

        where = f"system '{self.system.name}'"
        return Formula(derivative, int(ends[-1]) + self.n_columns, range(n_m), where)

    def values_in_row(self, parameters: Any) -> dict[str, Any]:
        """Values by name of a row of `parameter_rows`."""
        return {name: parameters[i] for i, name in enumerate((*self.free_names, *self.other_names))}

    def parameter_rows(
        self, values: Mapping[str, float], group_indices: GroupIndices
    ) -> Float[np.ndarray, "n n_columns"]:
        """Parameters as the equations take them, a row for every segment or sample.

        Args:
            values: the parameters by name, those per group with a value for each of its values.
            group_indices: which of these apply in each row, see `groups.group_indices`.
        """
        by_group = {p.name: list(p.by_group(values).values()) for p in self.system.grouped}
        names = (*self.free_names, *self.other_names)
        row = [0.0 if by_group.get(name) else values[name] for name in names]
        if self.has_delays:
            row += [values.get(delay_name(i), 0.0) for i in self.system.inputs]
        rows = np.tile(np.array(row, float), (len(group_indices), 1))
        for i, (name, options) in enumerate(by_group.items()):
            if options:
                rows[:, names.index(name)] = np.array(options)[group_indices[:, i]]
        return rows

    def free_columns(self, space: SearchSpace) -> list[int]:
        """Column of each free parameter of a search space; those of one group share a column."""
        return [self.free_names.index(_ungrouped_name(self.system, name)) for name in space.names]

    def coordinate_derivatives(
        self, space: SearchSpace, vector: ParameterVector, group_indices: GroupIndices
    ) -> Float[np.ndarray, "n n_p"]:
        """Derivatives of the parameters of each row by the coordinates of the search.

        The derivative by a parameter per group is 0 in rows where another of its values applies.
        """
        return self.applicable(space, group_indices) * space.derivatives(vector)

    def applicable(
        self, space: SearchSpace, group_indices: GroupIndices
    ) -> Float[np.ndarray, "n n_p"]:
        """Mask of the free parameters that apply in each row, 1 or 0."""
        mask = np.ones((len(group_indices), len(space.names)))
        names = dict.fromkeys([*space.names, *space.fixed_values], 0.0)
        for i, p in enumerate(self.system.grouped):
            members = [p.for_group(value).name for value in p.by_group(names)]
            for j, name in enumerate(space.names):
                if name in members:
                    mask[:, j] = group_indices[:, i] == members.index(name)
        return mask

    def initial_states(
        self,
        x0: Float[np.ndarray, "n n_x"],
        parameter_rows: Float[np.ndarray, "n n_columns"],
        adds_expected: Float[np.ndarray, " n"],
        polynomials: Float[np.ndarray, "n order n_u"],
    ) -> InitialStates:
        """States in which segments begin, with their derivatives by parameters and by `x0`.

        Args:
            x0: states as `Segments` has them.
            parameter_rows: the parameters of the segments, see `parameter_rows`.
            adds_expected: whether the internal states that the system expects are added, 1 or 0.
            polynomials: inputs over the first period of each, as the equations take them.
        """
        n, n_x = x0.shape
        n_m, n_p, states = self.system.channels.measured.stop, self.n_p, x0.copy()
        by_parameter, by_state = np.zeros((n, n_p, n_x)), np.tile(np.eye(n_x), (n, 1, 1))
        if not self.system.states.has_initial:
            return InitialStates(states, by_parameter, by_state)
        formula = self.expected_internal_states
        points = np.concatenate([x0[:, :n_m], parameter_rows], axis=1)
        if self.expects_by_inputs:
            points = np.concatenate([points, polynomials[:, 0]], axis=1)
        states[:, n_m:] += adds_expected[:, None] * evaluate(formula, points)
        derivatives = evaluate(formula, points, derivatives=True).reshape(n, n_x - n_m, n_m + n_p)
        derivatives = adds_expected[:, None, None] * np.swapaxes(derivatives, 1, 2)
        by_state[:, :n_m, n_m:] = derivatives[:, :n_m]
        by_parameter[:, :, n_m:] = derivatives[:, n_m:]
        return InitialStates(states, by_parameter, by_state)


@lru_cache(maxsize=64)  # so that equations are read and compiled once
def system_equations(
    system: LagrangianSystem, free_names: tuple[str, ...] = (), *, has_delays: bool = False
) -> SystemEquations:
    """The equations of a system, with derivatives by some of its parameters.

    Args:
        system: the system.
        free_names: the parameters to differentiate by; of those per group, their expanded names.
        has_delays: see `SystemEquations`.
    """
    free = tuple(dict.fromkeys(_ungrouped_name(system, name) for name in free_names))
    others = tuple(p.name for p in system.parameters if p.name not in free)
    return SystemEquations(system, free, others, has_delays)


def _ungrouped_name(system: LagrangianSystem, name: str) -> str:
    """Name of a parameter in the system's declaration: `mass` of `mass[1kg]`."""
    return next((p.name for p in system.grouped if p.by_group({name: 0.0})), name)
