"""The parameters that are searched for, in the coordinates in which they are searched."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.fitting.shooting.groups import spread
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

Searched = Float[np.ndarray, " n_p"]


@dataclass(frozen=True)
class Space:
    """Which parameters are searched for, and how a vector stands for their values.

    A parameter whose range is positive is searched for by its logarithm, any other linearly, in
    units of its range. Either way the range becomes a box, which every iterate is projected into.

    Attributes:
        searched: the parameters that are.
        fixed: the values of all others, by name.
    """

    searched: tuple[Parameter, ...]
    fixed: Mapping[str, Any]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters that are searched for."""
        return tuple(p.name for p in self.searched)

    @property
    def lower(self) -> Searched:
        """The box's lower corner."""
        return self.vector({p.name: p.lower for p in self.searched})

    @property
    def upper(self) -> Searched:
        """The box's upper corner."""
        return self.vector({p.name: p.upper for p in self.searched})

    def vector(self, values: Mapping[str, float]) -> Searched:
        """The vector of some values."""
        return np.array(
            [
                np.log(values[p.name]) if p.positive else values[p.name] / (p.upper - p.lower)
                for p in self.searched
            ]
        ).reshape(len(self.searched))

    def values(self, vector: Searched) -> dict[str, float]:
        """The values of all parameters, searched for or fixed."""
        values = {name: float(value) for name, value in self.fixed.items()}
        for p, x in zip(self.searched, vector.tolist(), strict=True):
            values[p.name] = float(np.exp(x)) if p.positive else x * (p.upper - p.lower)
        return values

    def numbers(self, vector: Searched) -> dict[str, float]:
        """The values of all parameters as plain numbers, none outside its range by rounding."""
        found = self.values(vector)
        for p in self.searched:
            found[p.name] = min(max(found[p.name], p.lower), p.upper)
        return found

    def slopes(self, vector: Searched) -> Searched:
        """Derivative of each value by its entry of the vector."""
        values = self.values(vector)
        return np.array(
            [values[p.name] if p.positive else p.upper - p.lower for p in self.searched]
        ).reshape(len(self.searched))

    def clipped(self, vector: Searched) -> Searched:
        """The nearest vector within the box."""
        return np.clip(vector, self.lower, self.upper)

    def at_bounds(self, vector: Searched) -> dict[str, str]:
        """The parameters that stand at an end of their range, and at which: `lower`, `upper`."""
        near = 1e-6 * (self.upper - self.lower)
        found = {}
        for p, x, low, high, margin in zip(
            self.searched, vector, self.lower, self.upper, near, strict=True
        ):
            if x <= low + margin or x >= high - margin:
                found[p.name] = "lower" if x <= low + margin else "upper"
        return found


def make_space(
    system: LagrangianSystem,
    values: Mapping[str, float],
    fixed: Mapping[str, float],
    parameters: Sequence[Parameter] = (),
) -> Space:
    """The space of the parameters of a system that are searched for.

    Args:
        system: the system.
        values: where to start, by name; the nominal values for those not given.
        fixed: parameters to fix besides those that the system declares fixed.
        parameters: those of the system, of those per group one for each of its values, see
            `groups.expanded`; by default the system's as they are.

    Raises:
        InputError: an unknown name, a value outside its range, or nothing left to search for.
    """
    known = {p.name: p for p in parameters or system.parameters}
    values, fixed = (spread(system, tuple(known.values()), of) for of in (values, fixed))
    where = {name: p.nominal for name, p in known.items()} | values | fixed
    for name in (*values, *fixed):
        p = known[name]
        if not p.lower <= where[name] <= p.upper:
            raise InputError(
                f"parameter '{name}'",
                f"{where[name]:g} {p.unit}",
                f"a value within {p.lower:g}..{p.upper:g} {p.unit}",
                "start inside the range, or widen it in the system file",
            )
    searched = tuple(p for p in known.values() if not p.fixed and p.name not in fixed)
    if not searched:
        raise InputError(
            f"system '{system.name}'", "every parameter is fixed", "at least one that is not"
        )
    names = {p.name for p in searched}
    return Space(searched, {name: value for name, value in where.items() if name not in names})
