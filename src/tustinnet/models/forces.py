"""Forces and elastic energies that mechanical systems are made of.

Everything works on numbers as well as on arrays. A friction returns the force against the motion,
as `LagrangianSystem.dissipation` wants it; a spring returns its energy, as `potential` wants it;
forces that act return a force in the direction of the coordinate.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

Value = Float[Array, "..."] | float


def viscous(v: Value, damping: Value) -> Any:
    """Viscous friction `b v` [N m or N].

    Args:
        v: velocity [rad/s or m/s].
        damping: b [N m s/rad or N s/m].
    """
    return damping * v


def coulomb(v: Value, level: Value, speed: Value) -> Any:
    """Coulomb friction, smoothed: `c tanh(v / w)` [N m or N].

    The sign function would have no gradient, and no integrator keeps its order across a jump.

    Args:
        v: velocity [rad/s or m/s].
        level: c, friction at speed [N m or N].
        speed: w, the speed at which 76 % of it are reached [rad/s or m/s].
    """
    return level * jnp.tanh(v / speed)


def stribeck(v: Value, level: Value, breakaway: Value, stribeck_speed: Value, speed: Value) -> Any:
    """Stribeck friction, smoothed: `(c + (s - c) exp(-(v / v_s)^2)) tanh(v / w)` [N m or N].

    Args:
        v: velocity [rad/s or m/s].
        level: c, friction at speed [N m or N].
        breakaway: s, friction at the onset of motion, at least c [N m or N].
        stribeck_speed: v_s, where friction has fallen from one to the other [rad/s or m/s].
        speed: w, width of the smoothed sign, well below v_s [rad/s or m/s].

    References:
        Armstrong-Hélouvry, Dupont, Canudas de Wit (1994), A survey of models, analysis tools and
        compensation methods for the control of machines with friction, Automatica 30(7).
    """
    falling = jnp.exp(-((v / stribeck_speed) ** 2))
    return (level + (breakaway - level) * falling) * jnp.tanh(v / speed)


def rubbing(q: Value, v: Value, growth: Value, speed: Value) -> Any:
    """Dry friction that grows with the deflection: `g |q| tanh(v / w)` [N m or N].

    A cable that is wound, or a seal that is squeezed, rubs the more the further it is turned.

    Args:
        q: deflection [rad or m].
        v: velocity [rad/s or m/s].
        growth: g, friction at speed for each unit of deflection [N m/rad or N/m].
        speed: w, the speed at which 76 % of it are reached [rad/s or m/s].
    """
    return coulomb(v, growth * jnp.abs(q), speed)


def linear_spring(q: Value, stiffness: Value) -> Any:
    """Energy `k q^2 / 2` [J]; force against the deflection `k q`.

    Args:
        q: deflection [rad or m].
        stiffness: k [N m/rad or N/m].
    """
    return stiffness * q**2 / 2


def quadratic_spring(q: Value, stiffness: Value) -> Any:
    """Energy `k q^3 / 3` [J]; force against the deflection `k q^2`, of one sign on both sides.

    Args:
        q: deflection [rad or m].
        stiffness: k [N m/rad^2 or N/m^2].

    References:
        van Esch, Bonassi, Schön, section 2.2, elastic energy of the cable.
    """
    return stiffness * q**3 / 3


def cubic_spring(q: Value, stiffness: Value) -> Any:
    """Energy `k q^4 / 4` [J]; force against the deflection `k q^3`.

    Args:
        q: deflection [rad or m].
        stiffness: k [N m/rad^3 or N/m^3].
    """
    return stiffness * q**4 / 4


def maxwell_rate(v: Value, z: Value, relaxation: Value) -> Any:
    """Rate of a Maxwell element's elastic deflection: `dz/dt = v - r z` [rad/s or m/s].

    A spring and a damper in series: the spring follows the motion and relaxes through the damper.

    Args:
        v: velocity of the coordinate it hangs on [rad/s or m/s].
        z: its internal state, deflection of the spring [rad or m].
        relaxation: r [1/s].
    """
    return v - relaxation * z


def maxwell_force(z: Value, stiffness: Value) -> Any:
    """Force of a Maxwell element on its coordinate: `-k z` [N m or N].

    Args:
        z: its internal state [rad or m].
        stiffness: k of its spring [N m/rad or N/m].
    """
    return -stiffness * z


def dc_motor(
    voltage: Value,
    speed: Value,
    torque_constant: Value,
    resistance: Value,
    back_emf: Value,
    limit: float = float("inf"),
) -> Any:
    """Torque of a DC motor `kt (sat(u) - km w) / R` [N m]; the inductance is neglected.

    Args:
        voltage: u [V].
        speed: w of the shaft, in the direction in which u drives it [rad/s].
        torque_constant: kt [N m/A].
        resistance: R of the winding [ohm].
        back_emf: km [V s/rad].
        limit: the supply saturates at plus and minus this voltage [V].
    """
    supplied = jnp.clip(voltage, -limit, limit)
    return torque_constant * (supplied - back_emf * speed) / resistance
