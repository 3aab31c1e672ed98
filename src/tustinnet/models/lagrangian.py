"""Euler-Lagrange models: equations of motion from energies, by automatic differentiation."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Float

from tustinnet.data.experiment import Coordinate, Input
from tustinnet.errors import InputError
from tustinnet.models.base import ContinuousModel, InputVector, State

Coordinates = Float[Array, " n_q"]
Scalar = Float[Array, ""]
Values = Mapping[str, Array]


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a system.

    Attributes:
        name: what it is called.
        unit: its SI unit.
        nominal: its nominal value.
        lower: smallest value that makes sense (the paper's set Xi).
        upper: largest.
        fixed: whether identification leaves it alone.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    fixed: bool = False

    def __post_init__(self) -> None:
        if not self.lower <= self.nominal <= self.upper:
            raise InputError(
                f"parameter '{self.name}'",
                f"nominal value {self.nominal:g} {self.unit}",
                f"a value within {self.lower:g}..{self.upper:g}",
            )


@dataclass(frozen=True)
class LagrangianSystem:
    """A mechanical system written as energies and forces.

    All functions take the parameters as a mapping from name to value.

    Attributes:
        name: what it is called.
        coordinates: the generalised coordinates, in the order of q.
        inputs: the inputs, in the order of u.
        parameters: what the functions need.
        kinetic: `T(q, v, p)` [J], quadratic in v.
        potential: `V(q, p)` [J].
        dissipation: `D(q, v, p)`, generalised force against the motion, (n_q,) [N m or N].
        input_map: `Q(q, v, u, p)`, generalised force of the actuators, (n_q,) [N m or N].
    """

    name: str
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    parameters: tuple[Parameter, ...]
    kinetic: Callable[[Coordinates, Coordinates, Values], Scalar]
    potential: Callable[[Coordinates, Values], Scalar]
    dissipation: Callable[[Coordinates, Coordinates, Values], Coordinates]
    input_map: Callable[[Coordinates, Coordinates, InputVector, Values], Coordinates]

    def nominal(self) -> dict[str, float]:
        """The nominal values by name."""
        return {p.name: p.nominal for p in self.parameters}


class LagrangianModel(ContinuousModel):
    """The equations of motion of a system.

        d/dt dT/dv - dT/dq + dV/dq = Q(q, v, u) - D(q, v)

    Solved for the acceleration: `M(q) a = Q - D - c(q, v) - dV/dq` with the mass matrix
    `M = d2T/dv2` and `c = (d2T/dv dq) v - dT/dq`, by Cholesky factorisation of M.

    Attributes:
        system: the energies and forces.
        values: the parameters by name, SI units.

    References:
        van Esch, Bonassi, Schön, section 2.2, Euler-Lagrange equations.
    """

    system: LagrangianSystem = eqx.field(static=True)
    values: dict[str, Array]

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates of the system."""
        return self.system.coordinates

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The inputs of the system."""
        return self.system.inputs

    def mass_matrix(self, q: Coordinates) -> Float[Array, "n_q n_q"]:
        """`M(q)`, (n_q, n_q) [kg m^2, kg m or kg]."""
        still = jnp.zeros_like(q)
        return jax.hessian(self.system.kinetic, argnums=1)(q, still, self.values)

    def energy(self, x: State) -> Scalar:
        """`T + V` at a state [J]."""
        q, v = jnp.split(x, 2)
        return self.system.kinetic(q, v, self.values) + self.system.potential(q, self.values)

    def acceleration(self, x: State, u: InputVector) -> Coordinates:
        """The acceleration at a state under an input, (n_q,) [rad/s^2 or m/s^2]."""
        q, v = jnp.split(x, 2)
        s, p = self.system, self.values
        momentum = jax.grad(s.kinetic, argnums=1)
        _, carried = jax.jvp(lambda at: momentum(at, v, p), (q,), (v,))
        conservative = jax.grad(s.kinetic)(q, v, p) - jax.grad(s.potential)(q, p)
        force = s.input_map(q, v, u, p) - s.dissipation(q, v, p)
        factor = jax.scipy.linalg.cho_factor(self.mass_matrix(q))
        return jax.scipy.linalg.cho_solve(factor, force + conservative - carried)

    def derivative(self, x: State, u: InputVector) -> State:
        """`d/dt [q, v] = [v, a]`."""
        return jnp.concatenate([x[len(self.coordinates) :], self.acceleration(x, u)])
