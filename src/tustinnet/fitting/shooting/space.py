"""The search space: the coordinates in which parameters are searched for, and their bounds.

The least-squares search works on a vector; `SearchSpace` maps it to values by name and back.
`make_search_space` builds it from a system, initial values and parameters to fix.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.errors import InputError
from tustinnet.fitting.shooting.groups import expand_values
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

ParameterVector = Float[np.ndarray, " n_p"]


@dataclass(frozen=True)
class SearchSpace:
    """Free and fixed parameters, and how a vector stands for the values of the free ones.

    A parameter whose range is positive is searched for by its logarithm, any other linearly, in
    units of its range. Either way the range becomes a box, which every iterate is projected into.

    Attributes:
        free_parameters: the parameters that are searched for, in the order of the vector.
        fixed_values: the values of all others, by name.
    """

    free_parameters: tuple[Parameter, ...]
    fixed_values: Mapping[str, Any]

    def fixing(self, values: Mapping[str, float]) -> "SearchSpace":
        """The space with free parameters fixed at values by name."""
        return replace(self.without(values), fixed_values={**self.fixed_values, **values})

    def without(self, names: Collection[str]) -> "SearchSpace":
        """The space without some free parameters, which it then knows nothing of."""
        free = tuple(p for p in self.free_parameters if p.name not in names)
        return replace(self, free_parameters=free)

    def adding(self, parameters: Iterable[Parameter]) -> "SearchSpace":
        """The space with more parameters; those that are declared fixed at their nominal values."""
        parameters = tuple(parameters)
        free = (p for p in parameters if not p.fixed)
        fixed = {p.name: p.nominal for p in parameters if p.fixed}
        return SearchSpace((*self.free_parameters, *free), {**self.fixed_values, **fixed})

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(p.name for p in self.free_parameters)

    @property
    def lower(self) -> ParameterVector:
        """Lower bounds of the vector."""
        return self.to_vector({p.name: p.lower for p in self.free_parameters})

    @property
    def upper(self) -> ParameterVector:
        """Upper bounds of the vector."""
        return self.to_vector({p.name: p.upper for p in self.free_parameters})

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal values of the free parameters by name."""
        return {p.name: p.nominal for p in self.free_parameters}

    def to_vector(self, values: Mapping[str, float]) -> ParameterVector:
        """Vector that stands for values by name; names of other parameters are ignored."""
        return np.array(
            [
                np.log(values[p.name]) if p.positive else values[p.name] / (p.upper - p.lower)
                for p in self.free_parameters
            ]
        ).reshape(len(self.free_parameters))

    def to_values(self, vector: ParameterVector) -> dict[str, float]:
        """Values of all parameters by name, free and fixed."""
        values = {name: float(value) for name, value in self.fixed_values.items()}
        for p, x in zip(self.free_parameters, vector.tolist(), strict=True):
            values[p.name] = float(np.exp(x)) if p.positive else x * (p.upper - p.lower)
        return values

    def to_values_in_range(self, vector: ParameterVector) -> dict[str, float]:
        """Values of all parameters by name, none outside its range by rounding."""
        values = self.to_values(vector)
        for p in self.free_parameters:
            values[p.name] = min(max(values[p.name], p.lower), p.upper)
        return values

    def derivatives(self, vector: ParameterVector) -> ParameterVector:
        """Derivative of each free parameter's value by its entry of the vector, (n_p,)."""
        values = self.to_values(vector)
        return np.array(
            [values[p.name] if p.positive else p.upper - p.lower for p in self.free_parameters]
        ).reshape(len(self.free_parameters))

    def clip(self, vector: ParameterVector) -> ParameterVector:
        """Nearest vector within the bounds."""
        return np.clip(vector, self.lower, self.upper)

    def active_bounds(self, vector: ParameterVector) -> dict[str, str]:
        """Names of the free parameters that are at a bound, and which: `lower` or `upper`."""
        lower, upper = self.lower, self.upper
        margin = 1e-6 * (upper - lower)
        at_lower, at_upper = vector <= lower + margin, vector >= upper - margin
        return {
            name: "lower" if at_lower[i] else "upper"
            for i, name in enumerate(self.names)
            if at_lower[i] or at_upper[i]
        }

    def inside(self, vector: ParameterVector) -> Bool[np.ndarray, " n_p"]:
        """Mask of the free parameters that are not at a bound."""
        bounds = self.active_bounds(vector)
        return np.array([name not in bounds for name in self.names])


def make_search_space(
    system: LagrangianSystem,
    initial_values: Mapping[str, float],
    fixed_values: Mapping[str, float],
    parameters: Sequence[Parameter] = (),
) -> SearchSpace:
    """The search space of a system's parameters.

    Args:
        system: the system.
        initial_values: values by name, the nominal ones for parameters not named; those that the
            system declares fixed stay there, those of free parameters are only checked.
        fixed_values: parameters to fix besides those that the system declares fixed.
        parameters: the parameters of the system, of those per group one for each of its values,
            see `groups.expand_parameters`; by default the system's as they are.

    Raises:
        InputError: an unknown name, a value outside its range, or no free parameter.
    """
    by_name = {p.name: p for p in parameters or system.parameters}
    initial_values, fixed_values = (
        expand_values(system, tuple(by_name.values()), values)
        for values in (initial_values, fixed_values)
    )
    values = {name: p.nominal for name, p in by_name.items()} | initial_values | fixed_values
    for name in (*initial_values, *fixed_values):
        p = by_name[name]
        if not p.lower <= values[name] <= p.upper:
            raise InputError(
                f"parameter '{name}'",
                f"{values[name]:g} {p.unit}",
                f"a value within {p.lower:g}..{p.upper:g} {p.unit}",
                "start inside the range, or widen it in the system file",
            )
    free = tuple(p for p in by_name.values() if not p.fixed and p.name not in fixed_values)
    if not free:
        raise InputError(
            f"system '{system.name}'", "every parameter is fixed", "at least one that is not"
        )
    names = {p.name for p in free}
    return SearchSpace(free, {name: x for name, x in values.items() if name not in names})
