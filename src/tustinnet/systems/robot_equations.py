"""Energies, friction, actuators and elastic gears of a robot, as functions of a system."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from tustinnet.data.experiment import Experiment
from tustinnet.models import forces
from tustinnet.models.added import PlacedForce, compute_friction
from tustinnet.models.chains import Chain
from tustinnet.models.internal_states import Memory
from tustinnet.models.lagrangian import Inertia, UnmeasuredCoordinates, solve_positive
from tustinnet.systems.robot import Range, RobotActuator

_UNSURE = 0.1  # of the twist of a gear under the largest force: how far it may be off at first


@dataclass(frozen=True)
class Drive:
    """The way in which an input acts on a coordinate.

    Attributes:
        actuator: the actuator, at a joint that moves by `ratio` times the coordinate, plus
            `offset`.
        coordinate: index of the coordinate.
        ratio: travel of the joint by that of the coordinate.
        offset: position of the joint where the coordinate is at 0.
        label: what the names of its gains begin with.
        motor_constant: parameter that multiplies the input, None without one.
        joint_range: smallest and largest force of all actuators of the joint, None without.
    """

    actuator: RobotActuator
    coordinate: int
    ratio: float
    offset: float
    label: str
    motor_constant: str | None = None
    joint_range: Range | None = None

    def force(self, q: Any, v: Any, u: Any, p: Mapping[str, Any]) -> Any:
        """The force at the joint under an input `u`, at a position and speed of the coordinate.

        Of an actuator that integrates, `u` is the integral.
        """
        a = self.actuator
        gains = {name: p[f"{self.label}.{name}"] for name in a.gains}
        travel, speed = self.ratio * q + self.offset, self.ratio * v
        signal = u if self.motor_constant is None else p[self.motor_constant] * u
        limits = a.goal_range if a.integrates else a.input_range
        force = gains.get(a.goal or "gain", a.gain) * _within(limits, signal) + a.bias
        for name, motion in (("kp", travel), ("kv", speed)):
            if name in gains:
                force = force - gains[name] * a.gear * motion
        return a.gear * _within(a.force_range, force)

    def followed_goal(self, q: Any, v: Any, p: Mapping[str, Any]) -> Any:
        """The goal of an actuator that integrates, where it moves along without a force."""
        a = self.actuator
        lag = p[f"{self.label}.kv"] / p[f"{self.label}.kp"] if a.kv else 0.0
        return _within(a.goal_range, a.gear * (self.ratio * (q + lag * v) + self.offset))

    def acting(self, record: Experiment, column: int) -> np.ndarray:
        """The input of a record that acts, (n,): of an actuator that integrates, its goal.

        Args:
            record: the record.
            column: index of the input.
        """
        u, a = record.u[:, column], self.actuator
        if not a.integrates:
            return u
        at_first = a.gear * (self.ratio * record.q[0, self.coordinate] + self.offset)
        speeds = np.asarray(_within(a.input_range, u[:-1]))
        return at_first + np.cumsum([0.0, *(speeds * np.diff(record.t))])


def _within(ends: Range | None, x: Any) -> Any:
    return x if ends is None else jnp.clip(x, *ends)


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
            friction and actuator are the motor's.
        backlash: indices of those of them with play.
        at_motor: indices of those of them whose encoder is at the motor. There the link is the
            coordinate that no sensor measures, at the others the motor.
        largest_forces: largest force of each joint [N m or N], for the twists of elastic gears.
    """

    chain: Chain
    joints: tuple[str, ...]
    drives: tuple[Drive, ...]
    springs: tuple[Spring, ...]
    friction: tuple[PlacedForce, ...] = ()
    elastic: tuple[int, ...] = ()
    backlash: tuple[int, ...] = ()
    at_motor: tuple[int, ...] = ()
    largest_forces: tuple[float, ...] = ()

    @property
    def inertia(self) -> Inertia:
        """The mass matrix and the Coriolis forces as a system takes them."""
        if not self.elastic:
            return self.chain.inertia
        uncoupled = tuple(self._motor_places[k] for k in self.elastic)
        return Inertia(self._mass_matrix, self._coriolis, uncoupled, self._inverse)

    @property
    def unmeasured(self) -> UnmeasuredCoordinates | None:
        """The motors, or the links, behind elastic gears whose encoders are on the other side.

        Spong (1987), Modeling and control of elastic joint robots, Journal of Dynamic Systems,
        Measurement and Control 109(4), equation 13: the motor's kinetic energy is that of its
        own rotation.
        """
        if not self.elastic:
            return None
        places = jnp.array(self.elastic)
        sides = ("link" if k in self.at_motor else "motor" for k in self.elastic)
        names = tuple(
            f"{self.joints[k]}.{side}" for k, side in zip(self.elastic, sides, strict=True)
        )
        return UnmeasuredCoordinates(
            names, lambda q, p: q[places], self._initial_states, self._spread
        )

    def kinetic(self, q: Any, v: Any, p: Any) -> Any:
        """Energy of the motion of links, and of motors behind elastic gears [J]."""
        energy = self.chain.kinetic(self._links(q), self._links(v), p)
        for k in self.elastic:
            energy = energy + p[f"{self.joints[k]}.armature"] * v[self._motor_places[k]] ** 2 / 2
        return energy

    def potential(self, q: Any, p: Any) -> Any:
        """Energy of gravity, of springs at joints, and of elastic gears [J]."""
        energy = self._potential_of_links(self._links(q), p)
        for k in self.elastic:
            name, twist = self.joints[k], q[self._motor_places[k]] - q[self._link_places[k]]
            if k in self.backlash:
                gap = p[f"{name}.backlash"] / 2
                twist = twist - jnp.clip(twist, -gap, gap)
            energy = energy + forces.linear_spring(twist, p[f"{name}.gear_stiffness"])
        return energy

    def dissipation(self, q: Any, v: Any, p: Any) -> Any:
        """Friction and an offset against the motion of motors, and damping of elastic gears."""
        # what loads a gear is gravity at the link
        friction = self._friction(self._links(q), self._motors(v), p)
        damping = []
        for k, name in enumerate(self.joints):
            slip = v[self._motor_places[k]] - v[self._link_places[k]]
            damping.append(p[f"{name}.gear_damping"] * slip if k in self.elastic else 0.0 * v[k])
        return self._on_coordinates(
            [-d for d in damping], [f + d for f, d in zip(friction, damping, strict=True)]
        )

    def input_map(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Forces of the actuators, at the motors [N m or N]."""
        acting = self._actuator_forces(self._motors(q), self._motors(v), u, p)
        return self._on_coordinates([0.0 * f for f in acting], list(acting))

    @property
    def integrating(self) -> dict[int, Drive]:
        """Drives whose goals are the integrals of their inputs, by the index of the input."""
        return {i: d for i, d in enumerate(self.drives) if d.actuator.integrates}

    def with_goals(self, q: Any, v: Any, z: Any, u: Any, p: Any) -> Any:
        """The inputs, in the place of those that are integrated their integrals `z`, (n_u,)."""
        reached = dict(zip(self.integrating, z, strict=True))
        return jnp.stack([reached.get(i, u[i]) for i in range(len(self.drives))])

    @property
    def goals(self) -> Memory:
        """The goals that are integrals of inputs, as internal states."""
        drives = self.integrating

        def rate(q: Any, v: Any, z: Any, u: Any, p: Any) -> Any:
            return jnp.stack([_within(d.actuator.input_range, u[i]) for i, d in drives.items()])

        def settle(z: Any, p: Any) -> Any:
            limits = (d.actuator.goal_range for d in drives.values())
            return jnp.stack([_within(ends, x) for ends, x in zip(limits, z, strict=True)])

        def spread(p: Any) -> Any:
            """The distance from its goal at which a servo holds what loads it most."""
            return jnp.stack(
                [
                    self.largest_forces[d.coordinate] / (p[f"{d.label}.kp"] * abs(d.actuator.gear))
                    for d in drives.values()
                ]
            )

        names = tuple(f"{d.label}.goal" for d in drives.values())
        has_limits = any(d.actuator.goal_range for d in drives.values())
        return Memory(
            names,
            rate,
            initial=lambda q, v, u, p: self._followed_goals(self._motors(q), self._motors(v), p),
            spread=spread,
            searched=names,
            settle=settle if has_limits else None,
        )

    def _followed_goals(self, q: Any, v: Any, p: Any) -> Any:
        """The goals that a motion of the motors follows without a force."""
        drives = self.integrating.values()
        return jnp.stack([d.followed_goal(q[d.coordinate], v[d.coordinate], p) for d in drives])

    def _mass_matrix(self, q: Any, p: Any) -> Any:
        """Mass matrix of links and motors."""
        chain, size = self.chain.mass_matrix(self._links(q), p), q.shape[0]
        rows: list[list[Any]] = [[jnp.zeros((), q.dtype)] * size for _ in range(size)]
        for i, row in enumerate(self._link_places):
            for j, column in enumerate(self._link_places):
                rows[row][column] = chain[i, j]
        for k in self.elastic:
            place = self._motor_places[k]
            rows[place][place] = jnp.asarray(p[f"{self.joints[k]}.armature"], q.dtype)
        return jnp.stack([jnp.stack(row) for row in rows])

    def _coriolis(self, q: Any, v: Any, p: Any) -> Any:
        """Centrifugal and Coriolis forces, which act on links [N m or N]."""
        acting = self.chain.coriolis(self._links(q), self._links(v), p)
        return self._on_coordinates(list(acting), [0.0 * f for f in acting])

    def _inverse(self, q: Any, v: Any, a: Any, p: Any) -> Any:
        """Forces on links and motors that a motion needs, without gravity and gears [N m or N]."""
        needed = self.chain.inverse(self._links(q), self._links(v), self._links(a), p)
        accelerations = self._motors(a)
        own = [
            p[f"{name}.armature"] * accelerations[k] if k in self.elastic else 0.0 * q[k]
            for k, name in enumerate(self.joints)
        ]
        return self._on_coordinates(list(needed), own)

    def _initial_states(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Positions and velocities of what has no encoder, where a record begins.

        A motor without one is where its actuator twists the gear; a link without one where the
        load of the gear does.
        """
        if self.integrating:
            u = self.with_goals(q, v, self._followed_goals(q, v, p), u, p)
        driving = self._actuator_forces(q, v, u, p)
        loads = self._gear_loads(q, v, u, p) if self.at_motor else driving
        positions = []
        for k in self.elastic:
            stiffness = p[f"{self.joints[k]}.gear_stiffness"]
            is_link = k in self.at_motor
            positions.append(
                q[k] - loads[k] / stiffness if is_link else q[k] + driving[k] / stiffness
            )
        return jnp.concatenate([jnp.stack(positions), v[jnp.array(self.elastic)]])

    def _spread(self, p: Any) -> Any:
        """Spreads of twists: a tenth of those under the largest forces; of speeds by resonances."""
        twists, speeds = [], []
        for k in self.elastic:
            name = self.joints[k]
            stiffness = p[f"{name}.gear_stiffness"]
            twists.append(_UNSURE * self.largest_forces[k] / stiffness)
            speeds.append(twists[-1] * jnp.sqrt(stiffness / p[f"{name}.armature"]))
        return jnp.stack([*twists, *speeds])

    def _gear_loads(self, q: Any, v: Any, u: Any, p: Any) -> Any:
        """Forces of the gears on the links, were the gears rigid, (n_q,) [N m or N].

        Where a joint is at rest its dry friction holds as much as it can.
        """
        on_links = self.chain.coriolis(q, v, p) - jax.grad(self._potential_of_links)(q, p)
        total = on_links + self._actuator_forces(q, v, u, p) - self._friction(q, v, p)
        remaining = []
        for k, name in enumerate(self.joints):
            level, width = p[f"{name}.coulomb"], p[f"{name}.coulomb_speed"]
            at_rest = 1.0 - jnp.tanh(v[k] / width) ** 2
            remaining.append(total[k] - at_rest * jnp.clip(total[k], -level, level))
        links = self.chain.mass_matrix(q, p)
        motors = [
            p[f"{name}.armature"] if k in self.elastic else 0.0 * q[k]
            for k, name in enumerate(self.joints)
        ]
        acceleration = solve_positive(links + jnp.diag(jnp.stack(motors)), jnp.stack(remaining))
        return links @ acceleration - on_links

    def _potential_of_links(self, q: Any, p: Any) -> Any:
        """Energy of gravity and of springs at joints, by the positions of links [J]."""
        energy = self.chain.potential(q, p)
        for s in self.springs:
            stretch = s.ratio * q[s.coordinate] + s.offset - s.rest
            energy = energy + forces.linear_spring(stretch, p[f"{s.joint}.stiffness"])
        return energy

    @property
    def _link_places(self) -> list[int]:
        """Place of each joint's link among all coordinates."""
        return self._places(self.at_motor)

    @property
    def _motor_places(self) -> list[int]:
        """Place of each joint's motor among all coordinates."""
        return self._places(tuple(k for k in self.elastic if k not in self.at_motor))

    def _places(self, without_encoder: tuple[int, ...]) -> list[int]:
        """Places of links or of motors, some of which have no encoder and stand at the end."""
        n = len(self.joints)
        return [n + self.elastic.index(k) if k in without_encoder else k for k in range(n)]

    def _links(self, x: Any) -> Any:
        """The elements of links in positions or velocities of all coordinates, (n_q,)."""
        return x[jnp.array(self._link_places)] if self.elastic else x

    def _motors(self, x: Any) -> Any:
        """The elements of motors in positions or velocities of all coordinates, (n_q,)."""
        return x[jnp.array(self._motor_places)] if self.elastic else x

    def _on_coordinates(self, on_links: Sequence[Any], on_motors: Sequence[Any]) -> Any:
        """Forces on links and on motors as generalised forces of all coordinates."""
        total: list[Any] = [0.0] * (len(self.joints) + len(self.elastic))
        for places, acting in (self._link_places, on_links), (self._motor_places, on_motors):
            for place, force in zip(places, acting, strict=True):
                total[place] = total[place] + force
        return jnp.stack(total)

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
        by_joint: dict[str, Any] = {}
        for i, d in enumerate(self.drives):
            joint, k = d.actuator.joint, d.coordinate
            by_joint[joint] = by_joint.get(joint, 0.0) + d.force(q[k], v[k], u[i], p)
        total: list[Any] = [jnp.zeros_like(q[0])] * len(self.joints)
        for d in {d.actuator.joint: d for d in self.drives}.values():
            force = _within(d.joint_range, by_joint[d.actuator.joint])
            total[d.coordinate] = total[d.coordinate] + d.ratio * force
        return jnp.stack(total)
