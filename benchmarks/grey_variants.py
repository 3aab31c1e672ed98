"""What was tried beside the packaged structure of the rotary pendulum with a relaxing cable.

Each variant is `qube-servo2-memory` with one more piece of physics; `accuracy.py variants` measures
them by folds of records.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp

from tustinnet.data.dataset import DataSet
from tustinnet.models import forces
from tustinnet.models.lagrangian import LagrangianSystem, Memory, Parameter
from tustinnet.systems import qube_servo2

BASE = qube_servo2.WITH_MEMORY
assert BASE.potential is not None
assert BASE.dissipation is not None
POTENTIAL: Callable[..., Any] = BASE.potential
DISSIPATION: Callable[..., Any] = BASE.dissipation


def with_more(*parameters: Parameter, **functions: Any) -> LagrangianSystem:
    """The packaged structure with further parameters and other functions."""
    return replace(BASE, parameters=(*BASE.parameters, *parameters), **functions)


def second_maxwell_element() -> LagrangianSystem:
    """The cable relaxes with two rates."""

    def rate(q: Any, v: Any, z: Any, p: Any) -> Any:
        rates = [p["cable_relaxation"], p["cable_relaxation_2"]]
        return jnp.stack([forces.maxwell_rate(v[0], z[i], r) for i, r in enumerate(rates)])

    def force(q: Any, v: Any, z: Any, p: Any) -> Any:
        pull = forces.maxwell_force(z[0], p["cable_memory"])
        pull += forces.maxwell_force(z[1], p["cable_memory_2"])
        return jnp.stack([pull, jnp.zeros_like(pull)])

    return with_more(
        Parameter("cable_memory_2", "N m/rad", 1e-3, 1e-5, 2e-2),
        Parameter("cable_relaxation_2", "1/s", 0.3, 0.02, 2.0),
        memory=Memory(("cable", "cable 2"), rate, force),
    )


def stribeck_friction() -> LagrangianSystem:
    """The arm's friction is larger at the onset of motion."""

    def dissipation(q: Any, v: Any, p: Any) -> Any:
        breakaway = p["arm_friction"] + p["arm_breakaway"]
        dry = forces.stribeck(
            v[0], p["arm_friction"], breakaway, p["arm_stribeck_speed"], qube_servo2.SLOW
        )
        return qube_servo2.damping(q, v, p) + jnp.stack([dry, jnp.zeros_like(dry)])

    return with_more(
        Parameter("arm_breakaway", "N m", 1e-4, -2e-3, 5e-3),
        Parameter("arm_stribeck_speed", "rad/s", 1.0, 0.2, 10.0),
        dissipation=dissipation,
    )


def dry_friction_of_the_pendulum() -> LagrangianSystem:
    """Coulomb friction of the hinge, too."""

    def dissipation(q: Any, v: Any, p: Any) -> Any:
        dry = forces.coulomb(v[1], p["pendulum_friction"], qube_servo2.SLOW)
        return DISSIPATION(q, v, p) + jnp.stack([jnp.zeros_like(dry), dry])

    return with_more(
        Parameter("pendulum_friction", "N m", 1e-5, 1e-7, 5e-4), dissipation=dissipation
    )


def cable_that_rubs() -> LagrangianSystem:
    """Dry friction of the arm that grows with its deflection."""
    return qube_servo2.WITH_CABLE_FRICTION


def relaxing_part_that_stiffens() -> LagrangianSystem:
    """The Maxwell element's stiffness grows with the square of the arm's deflection."""

    def force(q: Any, v: Any, z: Any, p: Any) -> Any:
        pull = -(p["cable_memory"] + p["memory_cubic"] * q[0] ** 2) * z[0]
        return jnp.stack([pull, jnp.zeros_like(pull)])

    return with_more(
        Parameter("memory_cubic", "N m/rad^3", 1e-4, -2e-3, 5e-3),
        memory=Memory(("cable",), qube_servo2.cable_rate, force),
    )


def damping_that_grows() -> LagrangianSystem:
    """Viscous friction of the arm that grows with the square of its deflection."""

    def dissipation(q: Any, v: Any, p: Any) -> Any:
        more = p["damping_growth"] * q[0] ** 2 * v[0]
        return DISSIPATION(q, v, p) + jnp.stack([more, jnp.zeros_like(more)])

    return with_more(
        Parameter("damping_growth", "N m s/rad^3", 1e-5, -1e-3, 1e-3), dissipation=dissipation
    )


def air_drag() -> LagrangianSystem:
    """Drag that grows with the square of the speed, on both bodies."""

    def dissipation(q: Any, v: Any, p: Any) -> Any:
        size = jnp.sqrt(v**2 + 1e-4)  # smooth at 0
        return DISSIPATION(q, v, p) + jnp.stack([p["arm_drag"], p["pendulum_drag"]]) * v * size

    return with_more(
        Parameter("arm_drag", "N m s^2", 1e-6, -1e-3, 1e-3),
        Parameter("pendulum_drag", "N m s^2", 1e-7, -1e-5, 1e-5),
        dissipation=dissipation,
    )


def tilted_base() -> LagrangianSystem:
    """The arm's axis is not vertical."""

    def potential(q: Any, p: Any) -> Any:
        turn, sway = qube_servo2.ARM * q[0], jnp.sin(q[1])
        out = (p["pendulum_mass"] + p["arm_mass"] / 2) * p["arm_length"]
        along = p["pendulum_mass"] * p["pendulum_centre"] * sway
        x = out * jnp.cos(turn) - along * jnp.sin(turn)
        y = out * jnp.sin(turn) + along * jnp.cos(turn)
        return POTENTIAL(q, p) + qube_servo2.GRAVITY * (p["tilt_x"] * x + p["tilt_y"] * y)

    return with_more(
        Parameter("tilt_x", "rad", 0.0, -0.1, 0.1),
        Parameter("tilt_y", "rad", 0.0, -0.1, 0.1),
        potential=potential,
    )


def voltage_offset() -> LagrangianSystem:
    """The amplifier adds a voltage."""
    return with_more(
        Parameter("offset", "V", 0.0, -0.5, 0.5),
        input_map=lambda q, v, u, p: qube_servo2.motor(q, v, u + p["offset"], p),
    )


def offset_of_the_pendulums_encoder() -> LagrangianSystem:
    """Upright is not where the encoder reads 0."""

    def turned(q: Any, p: Any) -> Any:
        return jnp.stack([q[0], q[1] + p["alpha_zero"]])

    return with_more(
        Parameter("alpha_zero", "rad", 0.0, -0.05, 0.05),
        potential=lambda q, p: POTENTIAL(turned(q, p), p),
        kinetic=lambda q, v, p: BASE.kinetic(turned(q, p), v, p),
    )


VARIANTS: dict[str, Callable[[], LagrangianSystem]] = {
    "as packaged": lambda: BASE,
    "second Maxwell element": second_maxwell_element,
    "Stribeck friction of the arm": stribeck_friction,
    "dry friction of the pendulum": dry_friction_of_the_pendulum,
    "air drag": air_drag,
    "dry friction grows with the deflection": cable_that_rubs,
    "relaxing part stiffens with the deflection": relaxing_part_that_stiffens,
    "damping grows with the deflection": damping_that_grows,
    "tilted base": tilted_base,
    "offset of the voltage": voltage_offset,
    "offset of the pendulum's encoder": offset_of_the_pendulums_encoder,
    "spring alone (the paper's structure)": lambda: qube_servo2.SYSTEM,
}


def shifted(data: DataSet, samples: float) -> DataSet:
    """The records with their inputs later (positive) or earlier by up to a sample."""
    moved = []
    for e in data:
        before, after = e.u[[0, *range(len(e) - 1)]], e.u[[*range(1, len(e)), -1]]
        other = before if samples > 0 else after
        moved.append(replace(e, u=(1 - abs(samples)) * e.u + abs(samples) * other))
    return DataSet(data.name, tuple(moved))


SHIFTS: Sequence[float] = (-0.5, 0.5)
