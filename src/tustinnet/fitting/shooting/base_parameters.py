"""Base parameters: the combinations of parameters that change the forces of a motion.

`find_combinations` takes derivatives of forces by parameters and returns the combinations.
`LinearCoordinates` has the parameters in which the forces of rigid bodies are linear: mass, first
moment and inertia of each body, in the place of its centre and spreads.

References:
    Khalil, Dombre (2002), Modeling, Identification and Control of Robots, chapter 9: standard and
    base inertial parameters. Gautier (1991), Numerical calculation of the base inertial parameters
    of robots, Journal of Robotic Systems 8(4).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.fitting.shooting.space import SearchSpace
from tustinnet.models.chains import INERTIAL, STANDARD, standard_inertia

_SMALLEST_TERM = 1e-3  # of a combination, in standard deviations of the priors


@dataclass(frozen=True)
class Combinations:
    """Combinations of parameters that change forces, each named after one that is in no other.

    Attributes:
        factors: factors of the parameters, (n_b, n_p); 1 of the one that a combination is named
            after.
        pivots: indices of those, (n_b,).
    """

    factors: Float[np.ndarray, "n_b n_p"]
    pivots: tuple[int, ...]

    def terms(self, row: int, spread: Float[np.ndarray, " n_p"]) -> list[int]:
        """Indices of the other parameters in a combination that matter in it, in their order.

        Args:
            row: index of the combination.
            spread: standard deviations of what is known of the parameters beforehand, (n_p,).
        """
        sizes = np.abs(self.factors[row]) * spread
        pivot = self.pivots[row]
        return [int(i) for i in np.flatnonzero(sizes > _SMALLEST_TERM * sizes[pivot]) if i != pivot]


def find_combinations(
    slopes: Float[np.ndarray, "n n_p"], spread: Float[np.ndarray, " n_p"], order: Sequence[int]
) -> Combinations:
    """Finds the combinations of parameters that change forces.

    Args:
        slopes: derivatives of forces by parameters, in which forces are linear.
        spread: standard deviations of what is known of the parameters beforehand, (n_p,).
        order: indices of the parameters; one that those before it make up names no combination.
    """
    scaled: Any = np.linalg.qr(slopes * spread, mode="r")
    sizes = np.linalg.norm(scaled, axis=0)
    basis, pivots = np.zeros((len(scaled), 0)), []
    for j in order:
        if sizes[j] <= 1e-7 * sizes.max():
            continue  # it changes no force
        rest = scaled[:, j]
        for _ in range(2):  # once more, for what rounding has left
            rest = rest - basis @ (basis.T @ rest)
        # a smaller rest is what rounding leaves of one that the others make up
        if (remaining := np.linalg.norm(rest)) > 1e-6 * sizes[j]:
            basis = np.column_stack([basis, rest / remaining])
            pivots.append(j)
    factors = np.linalg.lstsq(scaled[:, pivots], scaled, rcond=None)[0]
    factors = factors * spread[pivots][:, None] / spread
    factors[:, pivots] = np.eye(len(pivots))
    return Combinations(factors, tuple(pivots))


class LinearCoordinates:
    """The free parameters of a search as those in which the forces of rigid bodies are linear.

    Of a body whose ten inertial parameters are free these are `mass`, `mass*center_x` and so on
    [kg m] and `inertia_xx` and so on [kg m^2], about the origin of the frame in which the centre is
    given. All other parameters stay as they are.

    Args:
        space: the search space.
        values: values of the parameters by name.

    Attributes:
        values: values of the coordinates, (n_p,).
        derivatives: derivatives by the free parameters, (n_p, n_p).
    """

    def __init__(self, space: SearchSpace, values: Mapping[str, float]) -> None:
        self._space = space
        self.values = np.array([values[name] for name in space.names])
        self.derivatives = np.eye(len(self.values))
        if bodies := bodies_of(space.names):
            columns = np.array([own for _, own in bodies])
            self.values[columns], derivatives = standard_inertia(self.values[columns])
            self.derivatives[columns[:, :, None], columns[:, None]] = derivatives

    @cached_property
    def names(self) -> list[str]:
        """Names of the coordinates, (n_p,)."""
        names = list(self._space.names)
        for group, columns in bodies_of(self._space.names):
            body = names[columns[0]].partition(f".{INERTIAL[0]}")[0]
            for i, kind in zip(columns, STANDARD, strict=True):
                names[i] = f"{body}.{kind}{group}"
        return names

    @cached_property
    def units(self) -> list[str]:
        """Their units, (n_p,)."""
        units = [p.unit for p in self._space.free_parameters]
        for _, columns in bodies_of(self._space.names):
            for i, unit in zip(columns, STANDARD.values(), strict=True):
                units[i] = unit
        return units

    def spread(self, deviations: Float[np.ndarray, " n_p"]) -> Float[np.ndarray, " n_p"]:
        """Standard deviations of the coordinates by independent ones of the free parameters."""
        return np.sqrt(np.sum((self.derivatives * deviations) ** 2, axis=1))


@lru_cache(maxsize=64)  # a search asks for those of its parameters at each step
def bodies_of(names: tuple[str, ...]) -> list[tuple[str, list[int]]]:
    """Bodies all of whose inertial parameters are among some names.

    Returns:
        Of each the group of records whose own it is, as `[1kg]`, "" where it is the same in all;
        and the indices of its parameters, in the order of `INERTIAL`.
    """
    places, bodies = {name: i for i, name in enumerate(names)}, []
    for name in names:
        body, is_mass, group = name.partition(f".{INERTIAL[0]}")
        own = [places.get(f"{body}.{kind}{group}") for kind in INERTIAL]
        if is_mass and None not in own:
            bodies.append((group, [i for i in own if i is not None]))
    return bodies


def order_of(names: Sequence[str]) -> list[int]:
    """Indices of parameters in the order in which combinations are to be named after them.

    Moments and inertias of bodies come first, from the base outwards as they are declared, and
    masses last. So the inertia of a link is named with what it carries and with the motor at its
    joint, as in textbooks.
    """
    mass, *others = (f".{kind}" for kind in STANDARD)

    def rank(i: int) -> int:
        kind = names[i].partition("[")[0]
        return 0 if kind.endswith(tuple(others)) else 2 if kind.endswith(mass) else 1

    return sorted(range(len(names)), key=rank)
