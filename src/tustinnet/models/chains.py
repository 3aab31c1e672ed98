"""Open kinematic chains of rigid bodies: energies, mass matrix and Coriolis forces by recursion.

The functions go once through the bodies, from the base outwards or back. So programs that are
made of them grow with the number of bodies, and not with its cube as derivatives of an energy do.

References:
    Featherstone (2008), Rigid Body Dynamics Algorithms: recursive Newton-Euler and composite rigid
    body algorithm. Rucker, Wensing (2022), Smooth parameterization of rigid-body inertia, IEEE
    Robotics and Automation Letters 7(2): log-Cholesky parameters of an inertia.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Kind
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.models.contract import Coordinates
from tustinnet.models.lagrangian import Inertia, Scalar, Values

Vector3 = tuple[float, float, float]
Rows3 = tuple[Vector3, Vector3, Vector3]

CENTER = ("center_x", "center_y", "center_z")
DIAGONAL = ("spread_x", "spread_y", "spread_z")
OFF_DIAGONAL = ("spread_xy", "spread_xz", "spread_yz")
INERTIAL = ("mass", *CENTER, *DIAGONAL, *OFF_DIAGONAL)  # the ten parameters of a body
# the parameters in which forces are linear, in the place of those of a body, with their units
STANDARD = {
    "mass": "kg",
    **{f"mass*{name}": "kg m" for name in CENTER},
    **{f"inertia_{axes}": "kg m^2" for axes in ("xx", "yy", "zz", "xy", "xz", "yz")},
}
# the places of the spreads in the upper triangular factor
_PLACES = dict(
    zip((*DIAGONAL, *OFF_DIAGONAL), ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True)
)
# (9, 3): the matrix of the vector product a x b, written in a row, is linear in a
_CROSS = np.array(
    [
        [0, 0, 0],
        [0, 0, -1],
        [0, 1, 0],
        [0, 0, 1],
        [0, 0, 0],
        [-1, 0, 0],
        [0, -1, 0],
        [1, 0, 0],
        [0, 0, 0],
    ],
    float,
)


@dataclass(frozen=True)
class Body:
    """A rigid body and the joint that carries it.

    The frame of a body has its origin on the axis of the joint. Where the joint is at 0,
    `rotation` turns vectors from this frame into that of the parent.

    Attributes:
        name: the body's name, with which the names of its parameters begin.
        parent: the index of the body that carries it, None for the base.
        kind: whether the joint turns (`angular`) or slides (`linear`).
        axis: unit vector of the joint's axis, in the body's frame.
        rotation: rows of the rotation from the body's frame to the parent's.
        position: origin of the body's frame in the parent's [m].
        coordinate: index of the coordinate that moves the joint.
        ratio: travel of the joint by that of the coordinate; not 1 for a mimic joint.
        offset: travel of the joint where the coordinate is 0 [rad or m].
        anchor: origin of the body's frame in that in which its centre is given [m].
        has_mass: whether it has the parameters of an inertia; without, it has no mass.
    """

    name: str
    parent: int | None
    kind: Kind
    axis: Vector3
    rotation: Rows3
    position: Vector3
    coordinate: int
    ratio: float = 1.0
    offset: float = 0.0
    anchor: Vector3 = (0.0, 0.0, 0.0)
    has_mass: bool = True


class BodyInertia(NamedTuple):
    """The inertia of a body about the origin of a frame.

    Attributes:
        mass: mass [kg].
        moment: mass times the position of the centre of mass, (3,) [kg m].
        tensor: rotational inertia about the origin, (3, 3) [kg m^2].
    """

    mass: Any
    moment: Any
    tensor: Any


class _Placement(NamedTuple):
    """Pose of a body in the frame of its parent: rotation (3, 3), and position (3,) [m]."""

    rotation: Any
    position: Any


@dataclass(frozen=True)
class Chain:
    """An open chain of rigid bodies on a fixed base, serial or branched.

    Parameters are those of `INERTIAL` for each body, as `forearm.mass`: the mass [kg], the centre
    [m], and six spreads [m], the upper triangular factor U of the covariance of the mass about
    its centre, `U U' = integral r r' dm / m`. These are log-Cholesky parameters: every value with a
    positive mass and a positive diagonal of U is the inertia of a body that can be built.

    Attributes:
        bodies: the bodies, each after the one that carries it.
        gravity: acceleration of gravity in the frame of the base [m/s^2].
        armatures: parameters of inertias that a coordinate sees beside those of the bodies, as that
            of a motor by its gear [kg m^2 or kg]: a name each, or None, one for each coordinate.
    """

    bodies: tuple[Body, ...]
    gravity: Vector3
    armatures: tuple[str | None, ...]

    @property
    def inertia(self) -> Inertia:
        """The mass matrix and the Coriolis forces as a system takes them."""
        return Inertia(self.mass_matrix, self.coriolis, inverse=self.inverse)

    def kinetic(self, q: Coordinates, v: Coordinates, p: Values) -> Scalar:
        """Kinetic energy [J]."""
        inertias, placements = self._inertias(p), self._placements(q)
        total: Any = sum(
            p[name] * v[k] ** 2 / 2 for k, name in enumerate(self.armatures) if name is not None
        )
        for (turning, sliding), inertia in zip(
            self._velocities(placements, v), inertias, strict=True
        ):
            if inertia is not None:
                momentum = inertia.tensor @ turning + 2 * _skew(inertia.moment) @ sliding
                total = total + (turning @ momentum + inertia.mass * (sliding @ sliding)) / 2
        return total

    def potential(self, q: Coordinates, p: Values) -> Scalar:
        """Energy in the field of gravity [J]; 0 where all centres are at the origin of the base."""
        moments: list[Any] = [np.zeros(3)] * len(self.bodies)
        masses: list[Any] = [0.0] * len(self.bodies)
        for i, inertia in enumerate(self._inertias(p)):
            if inertia is not None:
                masses[i], moments[i] = inertia.mass, inertia.moment
        total: Any = np.zeros(3)
        for i, placement in reversed(list(enumerate(self._placements(q)))):
            moment = placement.rotation @ moments[i] + masses[i] * placement.position
            parent = self.bodies[i].parent
            if parent is None:
                total = total + moment
            else:
                masses[parent] = masses[parent] + masses[i]
                moments[parent] = moments[parent] + moment
        return -(np.array(self.gravity) @ total)

    def mass_matrix(self, q: Coordinates, p: Values) -> Float[Array, "n_q n_q"]:
        """Mass matrix by the composite rigid body algorithm, (n_q, n_q) [kg m^2, kg m or kg]."""
        placements, composites = self._placements(q), self._inertias(p)
        n = len(self.armatures)
        rows: list[list[Any]] = [[0.0] * n for _ in range(n)]
        for k, name in enumerate(self.armatures):
            if name is not None:
                rows[k][k] = p[name]
        for i in reversed(range(len(self.bodies))):
            body, composite = self.bodies[i], composites[i]
            if composite is None:
                continue
            if body.parent is not None:
                carried = _in_parent(composite, placements[i])
                composites[body.parent] = _sum(composites[body.parent], carried)
            axis = np.array(body.axis)
            # momentum of all that the joint carries where it moves at unit speed
            if body.kind == "angular":
                torque, force = composite.tensor @ axis, -_skew(composite.moment) @ axis
            else:
                torque, force = _skew(composite.moment) @ axis, composite.mass * axis
            j: int | None = i
            while j is not None:
                other = self.bodies[j]
                along = np.array(other.axis) @ (torque if other.kind == "angular" else force)
                entry = body.ratio * other.ratio * along
                k, m = body.coordinate, other.coordinate
                rows[k][m] = rows[k][m] + entry
                if j != i:
                    rows[m][k] = rows[m][k] + entry
                rotation, position = placements[j]
                force = rotation @ force
                torque = rotation @ torque + _skew(position) @ force
                j = other.parent
        return jnp.stack([jnp.stack([jnp.asarray(x, q.dtype) for x in row]) for row in rows])

    def coriolis(self, q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
        """`dT/dq - (d2T/dv dq) v`: centrifugal and Coriolis forces, (n_q,) [N m or N]."""
        return -self.inertial_forces(q, v, jnp.zeros_like(v), self._inertias(p))

    def inverse(self, q: Coordinates, v: Coordinates, a: Coordinates, p: Values) -> Coordinates:
        """Forces that a motion needs, without those of gravity, (n_q,) [N m or N]."""
        armatures = [0.0 if name is None else p[name] for name in self.armatures]
        own = jnp.stack([x * a[k] for k, x in enumerate(armatures)])
        return self.inertial_forces(q, v, a, self._inertias(p)) + own

    def inertial_forces(
        self,
        q: Coordinates,
        v: Coordinates,
        a: Coordinates,
        inertias: list[BodyInertia | None],
        gravity: Vector3 = (0.0, 0.0, 0.0),
    ) -> Coordinates:
        """Forces that a motion needs, by the recursive Newton-Euler algorithm, (n_q,) [N m or N].

        They are linear in the inertias, which may be those of no real body. Armatures are left out.

        Args:
            q: positions, (n_q,).
            v: velocities, (n_q,).
            a: accelerations, (n_q,).
            inertias: of each body about the origin of its frame, None without mass.
            gravity: acceleration of gravity in the frame of the base, (3,) [m/s^2].
        """
        placements = self._placements(q)
        forces: list[Any] = []
        torques: list[Any] = []
        motions: list[tuple[Any, Any, Any]] = []  # angular velocity, its rate, acceleration
        for body, placement, inertia in zip(self.bodies, placements, inertias, strict=True):
            turning, rate, pull = (
                (np.zeros(3), np.zeros(3), -np.array(gravity))
                if body.parent is None
                else motions[body.parent]
            )
            back, axis = placement.rotation.T, np.array(body.axis)
            speed, change = body.ratio * v[body.coordinate], body.ratio * a[body.coordinate]
            lever = _skew(turning) @ placement.position
            pull = back @ (pull + _skew(rate) @ placement.position + _skew(turning) @ lever)
            turning, rate = back @ turning, back @ rate
            across = _skew(turning) @ axis
            if body.kind == "angular":
                rate = rate + speed * across + change * axis
                turning = turning + speed * axis
            else:
                pull = pull + 2 * speed * across + change * axis
            motions.append((turning, rate, pull))
            if inertia is None:
                forces.append(np.zeros(3))
                torques.append(np.zeros(3))
                continue
            mass, moment, tensor = inertia
            spin = _skew(turning)
            swing = _skew(rate) @ moment + spin @ (spin @ moment)
            forces.append(mass * pull + swing)
            torques.append(tensor @ rate + spin @ (tensor @ turning) + _skew(moment) @ pull)
        total: list[Any] = [jnp.zeros((), q.dtype)] * len(self.armatures)
        for i, body in reversed(list(enumerate(self.bodies))):
            along = np.array(body.axis) @ (torques[i] if body.kind == "angular" else forces[i])
            total[body.coordinate] = total[body.coordinate] + body.ratio * along
            if body.parent is not None:
                rotation, position = placements[i]
                force = rotation @ forces[i]
                forces[body.parent] = forces[body.parent] + force
                torques[body.parent] = (
                    torques[body.parent] + rotation @ torques[i] + _skew(position) @ force
                )
        return jnp.stack(total)

    def _inertias(self, p: Values) -> list[BodyInertia | None]:
        """The inertia of each body about the origin of its frame, None without mass."""
        return [body_inertia(body, p) if body.has_mass else None for body in self.bodies]

    def _placements(self, q: Coordinates) -> list[_Placement]:
        """Poses of bodies in the frames of their parents, at positions (n_q,)."""
        placements = []
        for body in self.bodies:
            travel = body.ratio * q[body.coordinate] + body.offset
            rotation, axis = np.array(body.rotation), np.array(body.axis)
            if body.kind == "angular":
                along = np.outer(axis, axis)
                turn = (
                    along
                    + jnp.cos(travel) * (np.eye(3) - along)
                    + jnp.sin(travel) * (_CROSS @ axis).reshape(3, 3)
                )
                placements.append(_Placement(rotation @ turn, np.array(body.position)))
            else:
                position = np.array(body.position) + travel * (rotation @ axis)
                placements.append(_Placement(rotation, position))
        return placements

    def _velocities(self, placements: list[_Placement], v: Coordinates) -> list[tuple[Any, Any]]:
        """Angular velocity, and velocity of the frame's origin, of each body in its frame."""
        velocities: list[tuple[Any, Any]] = []
        for body, placement in zip(self.bodies, placements, strict=True):
            turning, sliding = (
                (np.zeros(3), np.zeros(3)) if body.parent is None else velocities[body.parent]
            )
            back, axis = placement.rotation.T, np.array(body.axis)
            sliding = back @ (sliding + _skew(turning) @ placement.position)
            turning, speed = back @ turning, body.ratio * v[body.coordinate]
            if body.kind == "angular":
                turning = turning + speed * axis
            else:
                sliding = sliding + speed * axis
            velocities.append((turning, sliding))
        return velocities


def body_inertia(body: Body, p: Values) -> BodyInertia:
    """The inertia of a body about the origin of its frame, by the values of its parameters."""
    values = jnp.stack([jnp.asarray(p[f"{body.name}.{name}"]) for name in INERTIAL])
    return _inertia(values, np.array(body.anchor))


def _inertia(values: Float[Array, " 10"], origin: np.ndarray) -> BodyInertia:
    """The inertia of a body about an origin, by the values of `INERTIAL`."""
    mass, center = values[0], values[1:4] - origin
    second = jnp.outer(center, center)
    # U U' by its columns: U is upper triangular
    for column in range(3):
        entries: list[Any] = [jnp.zeros_like(mass)] * 3
        for value, (i, j) in zip(values[4:], _PLACES.values(), strict=True):
            if j == column:
                entries[i] = value
        u = jnp.stack(entries)
        second = second + jnp.outer(u, u)
    second = mass * second
    return BodyInertia(mass, mass * center, jnp.trace(second) * np.eye(3) - second)


def inertial_parameters(
    mass: float, center: np.ndarray, tensor: np.ndarray, smallest: float = 1e-6
) -> dict[str, float]:
    """The values of `INERTIAL` of a body.

    Args:
        mass: mass [kg].
        center: centre of mass, (3,) [m].
        tensor: rotational inertia about the centre, (3, 3) [kg m^2].
        smallest: smallest spread in any direction [m]: a thin rod gets this thickness.

    Raises:
        ValueError: no body has this inertia: in some direction its mass would have a negative
            spread.
    """
    covariance = np.trace(tensor) / 2 * np.eye(3) - tensor
    covariance = covariance / mass
    values, vectors = np.linalg.eigh(covariance)
    if values[0] < -max(smallest**2, 1e-6 * abs(values[-1])):
        raise ValueError(f"a principal inertia larger than the sum of the others ({values[0]:.2g})")
    covariance = (vectors * np.maximum(values, smallest**2)) @ vectors.T
    # upper triangular U with U U' = covariance: the Cholesky factor of the matrix in reverse
    upper = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
    spreads = {name: float(upper[place]) for name, place in _PLACES.items()}
    return {"mass": float(mass), **dict(zip(CENTER, map(float, center), strict=True)), **spreads}


def standard_inertia(
    values: Float[np.ndarray, "b 10"],
) -> tuple[Float[np.ndarray, "b 10"], Float[np.ndarray, "b 10 10"]]:
    """The standard inertial parameters of bodies, in which forces are linear, and derivatives.

    Args:
        values: those of `INERTIAL` of each body.

    Returns:
        Mass [kg], first moments [kg m] and the inertia about the origin of the frame in which the
        centre is given [kg m^2], as `STANDARD` names them; their derivatives by `values`.
    """
    derivatives = evaluate(_STANDARD, values, derivatives=True)
    return evaluate(_STANDARD, values), derivatives.reshape(-1, 10, 10)


def _standard(values: Float[Array, " 10"]) -> Float[Array, " 10"]:
    """The standard inertial parameters of a body, by the values of `INERTIAL`."""
    mass, moment, tensor = _inertia(values, np.zeros(3))
    return jnp.stack([mass, *moment, *(tensor[place] for place in _PLACES.values())])


# it is read and compiled once: a search asks for it at each step
_STANDARD = Formula(_standard, len(INERTIAL), where="an inertia")


def _in_parent(inertia: BodyInertia, placement: _Placement) -> BodyInertia:
    """The inertia about the origin of the parent's frame."""
    rotation, position = placement
    moment, lever = rotation @ inertia.moment, _skew(position)
    across = lever @ _skew(moment)
    tensor = rotation @ inertia.tensor @ rotation.T
    tensor = tensor - across - across.T - inertia.mass * (lever @ lever)
    return BodyInertia(inertia.mass, moment + inertia.mass * position, tensor)


def _sum(a: BodyInertia | None, b: BodyInertia) -> BodyInertia:
    return b if a is None else BodyInertia(*(x + y for x, y in zip(a, b, strict=True)))


def _skew(a: Any) -> Any:
    """The matrix of the vector product `a x b`, (3, 3)."""
    return (_CROSS @ a).reshape(3, 3)
