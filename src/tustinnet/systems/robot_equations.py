"""Energies, friction, actuators and elastic gears of a robot, as functions of a system."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from tustinnet.models import forces
from tustinnet.models.added import PlacedForce, compute_friction
from tustinnet.models.chains import Chain
from tustinnet.models.lagrangian import Memory


@dataclass(frozen=True)
class Drive:
    """The way in which an input acts on a coordinate.

    `force = gain u + by_position q + by_speed v + bias` at a joint that moves by `ratio` times the
    coordinate, plus `offset`.

    Attributes:
        joint: name of the joint.
        coordinate: index of the coordinate.
        ratio: travel of the joint by that of the coordinate.
        offset: position of the joint where the coordinate is at 0.
        motor_constant: parameter that multiplies the input, None without one.
        gain: force by input.
        by_position: force by position.
        by_speed: force by speed.
        bias: force without input.
        largest_force: largest force at the joint, None if unknown.
    """

    joint: str
    coordinate: int
    ratio: float
    offset: float
    motor_constant: str | None
    gain: float
    by_position: float
    by_speed: float
    bias: float
    largest_force: float | None = None


@dataclass(frozen=True)
class Spring:
    """A linear spring at a joint that moves by `ratio` times a coordinate, plus `offset`.

    Attributes:
        joint: name of the joint, whose parameter `stiffness` is its own.
        coordinate: index of the coordinate.
        ratio: travel of the joint by that of the coordinate.
        offset: position of the joint where the coordinate is at 0.
        rest: position of the joint at which the spring is at rest.
    """

    joint: str
    coordinate: int
    ratio: float
    offset: float
    rest: float


@dataclass(frozen=True)
class RobotEquations:
    """Potential energy, friction and actuators of a robot, and the motors behind elastic gears.

    Attributes:
        chain: its bodies.
        joints: names of the joints of its coordinates.
        drives: how its inputs act.
        springs: springs at its joints.
        friction: friction of its joints beside the viscous and the Coulomb one.
        elastic: indices of the coordinates with a spring between motor and link. There armature,
            friction and actuator are the motor's, whose position and speed are internal states.
        backlash: indices of those of them with play.
    """

    chain: Chain
    joints: tuple[str, ...]
    drives: tuple[Drive, ...]
    springs: tuple[Spring, ...]
    friction: tuple[PlacedForce, ...] = ()
    elastic: tuple[int, ...] = ()
    backlash: tuple[int, ...] = ()

    def potential(self, q: Any, p: Any) -> Any:
        """Energy of gravity and of springs at joints [J]."""
        energy = self.chain.potential(q, p)
        for s in self.springs:
            stretch = s.ratio * q[s.coordinate] + s.offset - s.rest
            energy = energy + forces.linear_spring(stretch, p[f"{s.joint}.stiffness"])
        return energy

    def dissipation(self, q: Any, v: Any, p: Any) -> Any:
        """Friction and an offset against the motion, (n_q,) [N m or N]; 0 at elastic gears."""
        return self._rigid(self._friction(q, v, p))

    def input_map(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Forces of the actuators, (n_q,) [N m or N]; 0 at elastic gears."""
        return self._rigid(self._actuator_forces(q, v, u, p))

    @property
    def memory(self) -> Memory | None:
        """The motors behind elastic gears, and their forces on the links; None without them.

        Spong (1987), Modeling and control of elastic joint robots, Journal of Dynamic Systems,
        Measurement and Control 109(4), equation 13: the motor's kinetic energy is that of its
        own rotation.
        """
        if not self.elastic:
            return None
        names = [self.joints[k] for k in self.elastic]
        states = (*(f"{name}.motor" for name in names), *(f"{name}.motor_speed" for name in names))
        return Memory(states, self._motor_rate, self._gear_forces, self._initial_motors)

    def _motor_rate(self, q: Any, v: Any, z: Any, u: Any, p: Any) -> Any:
        """Speeds and accelerations of the motors behind elastic gears, (n_z,)."""
        speeds = z[len(self.elastic) :]
        positions, velocities = list(q), list(v)
        for k, position, speed in zip(self.elastic, z, speeds, strict=False):
            positions[k], velocities[k] = position, speed
        at, by = jnp.stack(positions), jnp.stack(velocities)
        # the load of a gear is gravity at the link
        driving = self._actuator_forces(at, by, u, p) - self._friction(q, by, p)
        driving = driving - self._gear_forces(q, v, z, p)
        accelerations = [driving[k] / p[f"{self.joints[k]}.armature"] for k in self.elastic]
        return jnp.concatenate([speeds, jnp.stack(accelerations)])

    def _gear_forces(self, q: Any, v: Any, z: Any, p: Any) -> Any:
        """Forces of elastic gears on the links, (n_q,) [N m or N]."""
        total: list[Any] = [jnp.zeros_like(q[0])] * len(self.joints)
        for i, k in enumerate(self.elastic):
            name, twist = self.joints[k], z[i] - q[k]
            if k in self.backlash:
                gap = p[f"{name}.backlash"] / 2
                twist = twist - jnp.clip(twist, -gap, gap)
            slip = z[len(self.elastic) + i] - v[k]
            total[k] = p[f"{name}.gear_stiffness"] * twist + p[f"{name}.gear_damping"] * slip
        return jnp.stack(total)

    def _initial_motors(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Positions and speeds of motors whose actuators twist their gears, (n_z,)."""
        driving = self._actuator_forces(q, v, u, p)
        twists = [driving[k] / p[f"{self.joints[k]}.gear_stiffness"] for k in self.elastic]
        places = jnp.array(self.elastic)
        return jnp.concatenate([q[places] + jnp.stack(twists), v[places]])

    def _rigid(self, total: Any) -> Any:
        """Forces on the links: those on motors behind elastic gears do not act there."""
        kept = [0.0 if k in self.elastic else 1.0 for k in range(len(self.joints))]
        return total * jnp.array(kept) if self.elastic else total

    def _friction(self, q: Any, v: Any, p: Any) -> Any:
        """Friction and an offset against the motion, (n_q,) [N m or N].

        Load is the torque or force of gravity.
        """
        total = []
        for k, name in enumerate(self.joints):
            dry = forces.coulomb(v[k], p[f"{name}.coulomb"], p[f"{name}.coulomb_speed"])
            total.append(forces.viscous(v[k], p[f"{name}.viscous"]) + dry + p[f"{name}.offset"])
        if not self.friction:
            return jnp.stack(total)
        return jnp.stack(total) + compute_friction(self.friction, self.chain.potential, q, v, p)

    def _actuator_forces(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Forces of the actuators at positions and speeds of the motors, (n_q,) [N m or N]."""
        total: list[Any] = [jnp.zeros_like(q[0])] * len(self.joints)
        for i, d in enumerate(self.drives):
            position, speed = d.ratio * q[d.coordinate] + d.offset, d.ratio * v[d.coordinate]
            constant = 1.0 if d.motor_constant is None else p[d.motor_constant]
            force = d.gain * constant * u[i] + d.by_position * position + d.by_speed * speed
            total[d.coordinate] = total[d.coordinate] + d.ratio * (force + d.bias)
        return jnp.stack(total)
