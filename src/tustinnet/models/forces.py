"""Forces and elastic energies of mechanical systems, and the laws among them that have a name.

The functions work on numbers as well as on arrays. A friction returns the force against the motion,
as `LagrangianSystem.dissipation` returns it; a spring returns its energy, as `potential` returns
it; forces that act return a force in the direction of the coordinate.

A law of `LAWS` can be added to any system by its name (`[model] forces` of a recipe). All that the
package knows of it stands in its entry: messages, ranges, the table in `docs/reference/training.md`
and the springs of the system `mechanism` follow from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Coordinate, Input
from tustinnet.models.parameters import Parameter

Value = Float[Array, "..."] | float

CURVE_SPEEDS = (1.0, 3.0, 10.0, 30.0, 100.0)  # of a friction curve, by the width of its first term
SLIP = "slip"  # dry friction with a memory
SLIP_TRAVELS = (0.1, 0.3, 1.0, 3.0, 10.0)  # after which elements slip, by that of the middle one
LARGEST_LOAD_SHARE = 0.5  # of a load, as friction
# level and width of the Coulomb friction that a system has itself at a coordinate, `theta.NAME`
OWN_LEVEL, OWN_WIDTH = "coulomb", "coulomb_speed"


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


def coulomb_by_position(q: Value, v: Value, growth: Value, speed: Value) -> Any:
    """Coulomb friction that grows with the deflection: `g |q| tanh(v / w)` [N m or N].

    A cable that is wound, or a seal that is squeezed, rubs the more the further it is deflected.

    Args:
        q: deflection [rad or m].
        v: velocity [rad/s or m/s].
        growth: g, friction at speed for each unit of deflection [N m/rad or N/m].
        speed: w, the speed at which 76 % of it are reached [rad/s or m/s].
    """
    return coulomb(v, growth * jnp.abs(q), speed)


def coulomb_by_load(load: Value, v: Value, share: Value, speed: Value) -> Any:
    """Coulomb friction that grows with the load: `s |f| tanh(v / w)` [N m or N].

    Args:
        load: f, the force that bearings and gears carry, as that of gravity [N m or N].
        v: velocity [rad/s or m/s].
        share: s, friction at speed by the load [1].
        speed: w, the speed at which 76 % of it are reached [rad/s or m/s].

    References:
        Hamon, Gautier, Garrec (2010), Dynamic identification of robots with a dry friction model
        depending on load and velocity, IROS; there the whole load, of which accelerations are a
        part.
    """
    return coulomb(v, share * jnp.abs(load), speed)


def friction_curve(v: Value, weights: Sequence[Value], speed: Value) -> Any:
    """Friction that grows with the speed and ever less so: `sum a_i tanh(v / w_i)` [N m or N].

    Linear in its weights. Of weights that are not negative it takes energy at every speed.

    Args:
        v: velocity [rad/s or m/s].
        weights: a_i [N m or N].
        speed: w, the width of the first term; w_i are `CURVE_SPEEDS` times it [rad/s or m/s].
    """
    terms = (jnp.tanh(v / (by_width * speed)) for by_width in CURVE_SPEEDS)
    return sum(a * term for a, term in zip(weights, terms, strict=True))


def slip_force(z: Array, levels: Sequence[Value], travel: Value) -> Any:
    """Force of Maxwell-slip elements on their coordinate: `-sum c_i sat(z_i / d_i)` [N m or N].

    Each is a spring that slips at its level. Its deflection follows the motion and is cut to its
    travel, so it holds at rest what it held before, and winds up anew where the motion turns back.

    Args:
        z: the internal states, deflections of the elements, (5, ...) [rad or m].
        levels: c_i, at which they slip [N m or N].
        travel: d, of the middle element; d_i are `SLIP_TRAVELS` times it [rad or m].

    References:
        Lampaert, Al-Bender, Swevers (2003), A generalized Maxwell-slip friction model appropriate
        for control purposes, International Conference on Physics and Control; here without the
        Stribeck curve of an element.
    """
    return -sum(
        level * jnp.clip(z[i] / (SLIP_TRAVELS[i] * travel), -1.0, 1.0)
        for i, level in enumerate(levels)
    )


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


def backlash_spring(q: Value, stiffness: Value, gap: Value) -> Any:
    """Energy of a spring with backlash: `k (|q| - g)^2 / 2` beyond the gap, 0 within [J].

    The force has kinks at both ends of the gap and no jump, so that derivatives by the gap exist.

    Args:
        q: deflection from the middle of the gap [rad or m].
        stiffness: k beyond the gap [N m/rad or N/m].
        gap: g, half of the backlash [rad or m].
    """
    return stiffness * jnp.maximum(jnp.abs(q) - gap, 0.0) ** 2 / 2


def end_stops(
    q: Value, v: Value, lower: Value, upper: Value, stiffness: Value, damping: Value
) -> Any:
    """Force of two ends of travel against positive motion [N m or N].

    Beyond an end by x, `k x max(1 + d dx/dt, 0)`: it pushes and never pulls, and has no jump. A
    coordinate that arrives at w leaves at about `w (1 - 2 d w / 3)` for small `d w`, and hardly
    leaves for large.

    Args:
        q: position [rad or m].
        v: velocity [rad/s or m/s].
        lower: position of the lower end [rad or m].
        upper: position of the upper end [rad or m].
        stiffness: k of both [N m/rad or N/m].
        damping: d of both [s/rad or s/m].

    References:
        Hunt, Crossley (1975), Coefficient of restitution interpreted as damping in vibroimpact,
        Journal of Applied Mechanics 42(2), with the exponent 1.
    """
    beyond = [(jnp.maximum(q - upper, 0.0), v), (jnp.maximum(lower - q, 0.0), -v)]
    above, below = (x * jnp.maximum(1.0 + damping * speed, 0.0) for x, speed in beyond)
    return stiffness * (above - below)


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


def dahl_rate(v: Value, z: Value, level: Value, stiffness: Value) -> Any:
    """Rate of the deflection in Dahl friction: `dz/dt = v - s |v| z / c` [rad/s or m/s].

    Two surfaces stick together by asperities, which bend like springs before they slip. The
    equation has a kink at v = 0, no jump: z is smooth, and Runge-Kutta steps of a fixed length are
    accurate to second order across a reversal. It is stiff at high speed, where z settles within
    the travel c / s: steps longer than 2.8 c / (s |v|) diverge.

    Args:
        v: velocity [rad/s or m/s].
        z: its internal state, mean deflection of the asperities [rad or m].
        level: c, friction in steady motion [N m or N].
        stiffness: s of the asperities [N m/rad or N/m].

    References:
        Dahl (1968), A solid friction model, Aerospace Corporation, TOR-158(3107-18), with the
        exponent 1, at which friction approaches its level exponentially.
    """
    return v - stiffness * jnp.abs(v) * z / level


def dahl_force(z: Value, stiffness: Value) -> Any:
    """Force of Dahl friction on its coordinate: `-s z` [N m or N].

    Args:
        z: its internal state [rad or m].
        stiffness: s of the asperities [N m/rad or N/m].
    """
    return -stiffness * z


def lugre_rate(
    v: Value, z: Value, level: Value, breakaway: Value, stribeck_speed: Value, stiffness: Value
) -> Any:
    """Rate of the bristles' deflection in LuGre friction: `dz/dt = v - s |v| z / g(v)`.

    `g(v) = c + (b - c) exp(-(v / v_s)^2)` is the Stribeck curve, the friction in steady motion.
    The kink and the stiffness are those of `dahl_rate`.

    Args:
        v: velocity [rad/s or m/s].
        z: its internal state, mean deflection of the bristles [rad or m].
        level: c, friction at speed [N m or N].
        breakaway: b, friction at the onset of motion, at least c [N m or N].
        stribeck_speed: v_s, where friction has fallen from one to the other [rad/s or m/s].
        stiffness: s of the bristles, sigma_0 in the paper [N m/rad or N/m].

    References:
        Canudas de Wit, Olsson, Åström, Lischinsky (1995), A new model for control of systems with
        friction, IEEE Transactions on Automatic Control 40(3), equations 1, 2 and 4.
    """
    falling = jnp.exp(-((v / stribeck_speed) ** 2))
    return v - stiffness * jnp.abs(v) * z / (level + (breakaway - level) * falling)


def lugre_force(z: Value, rate: Value, stiffness: Value, damping: Value) -> Any:
    """Force of LuGre friction on its coordinate: `-(s z + d dz/dt)` [N m or N].

    The paper's viscous term is `viscous`, in the dissipation.

    Args:
        z: its internal state [rad or m].
        rate: dz/dt by `lugre_rate` [rad/s or m/s].
        stiffness: s of the bristles [N m/rad or N/m].
        damping: d of the bristles, sigma_1 in the paper [N m s/rad or N s/m].

    References:
        Canudas de Wit, Olsson, Åström, Lischinsky (1995), equation 3.
    """
    return -(stiffness * z + damping * rate)


def bouc_wen_rate(v: Value, z: Value, deflection: Value, shape: Value, exponent: Value) -> Any:
    """Rate of the hysteretic deflection of a Bouc-Wen element [rad/s or m/s].

    `dz/dt = v - a |v| |w|^(n-1) w + (a - 1) v |w|^n` with `w = z / d`: the normalised form, in
    which no two sets of parameters mean one hysteresis. `|w|` is `sqrt(w^2 + 1e-18)`, so that
    derivatives by n exist at w = 0. Kink and stiffness are those of `dahl_rate`, which is this with
    a = n = 1.

    Args:
        v: velocity [rad/s or m/s].
        z: its internal state, between -d and d [rad or m].
        deflection: d, at which the element yields [rad or m].
        shape: a, at least 1/2: where the motion turns back, the element is as stiff as at first for
            1/2, up to 2 a times as stiff for more.
        exponent: n, at least 1: how suddenly it yields.

    References:
        Wen (1976), Method for random vibration of hysteretic systems, Journal of the Engineering
        Mechanics Division 102(2); normalised by Ikhouane, Rodellar (2005), On the hysteretic
        Bouc-Wen model, part I, Nonlinear Dynamics 42, equations 9 and 10.
    """
    w = z / deflection
    size = jnp.exp((exponent - 1) / 2 * jnp.log(w**2 + 1e-18))  # |w|^(n-1)
    return v - shape * jnp.abs(v) * size * w + (shape - 1) * v * size * jnp.abs(w)


def bouc_wen_force(z: Value, deflection: Value, level: Value) -> Any:
    """Force of a Bouc-Wen element on its coordinate: `-c z / d` [N m or N].

    Args:
        z: its internal state [rad or m].
        deflection: d, at which it yields [rad or m].
        level: c, its force where it yields [N m or N].
    """
    return -level * z / deflection


def lag_rate(u: Value, w: Value, time_constant: Value) -> Any:
    """Rate of an actuator that lags behind its command: `dw/dt = (u - w) / T`.

    Args:
        u: the command, in its unit.
        w: its internal state, what the actuator has reached, in the unit of the command.
        time_constant: T, the time in which it covers 63 % of a step [s].
    """
    return (u - w) / time_constant


def dead_zone(u: Value, width: Value) -> Any:
    """An input behind its dead zone: `u - clip(u, -d, d)`, 0 within.

    Args:
        u: the input, in its unit.
        width: d, up to which nothing acts, in the same.
    """
    return u - jnp.clip(u, -width, width)


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


@dataclass(frozen=True)
class Motion:
    """The motion of a coordinate in the records, from which ranges of parameters follow.

    Attributes:
        force: generalised force [N m or N], the largest of inertia, springs and gravity, and
            actuators; root mean squares.
        position: distance from 0, root mean square [rad or m].
        travel: distance from the mean, root mean square [rad or m].
        speed: root mean square [rad/s or m/s].
        ends: positions below and above which a hundredth of the samples are [rad or m].
        dt: sampling period [s].
        longest: duration of the longest record [s].
        drive: largest absolute value of the input, of a law at an input, in its unit.
        width: width of the smoothed sign, where a law takes that of the system's own Coulomb
            friction [rad/s or m/s]; None otherwise.
    """

    force: float
    position: float
    travel: float
    speed: float
    ends: tuple[float, float]
    dt: float
    longest: float
    drive: float = 0.0
    width: float | None = None

    @property
    def largest_force(self) -> float:
        """The largest value of a force that the system lacks [N m or N]: 10 times `force`."""
        return 10.0 * self.force

    @property
    def slow(self) -> float:
        """The width of the smoothed sign of a dry friction [rad/s or m/s]: 2 % of the speed."""
        return slow_speed(self.speed)


def slow_speed(speed: float) -> float:
    """The width of the smoothed sign of a dry friction [rad/s or m/s]: 2 % of the speed.

    Args:
        speed: that of the motion, root mean square [rad/s or m/s].
    """
    return 0.02 * speed


SearchRange = tuple[float, float, float]  # initial value, lower and upper end


@dataclass(frozen=True)
class ForceParameter:
    """A parameter of a law; that of the channel `theta` is called `theta.NAME`.

    Attributes:
        name: its name, as files keep it.
        symbol: its letter in the formula of the law.
        unit: its unit, with `{force}` and `{position}` for those of a coordinate, `{input}` for
            that of an input.
        range: initial value, lower and upper end of the search, from the motion in the records.
        fixed: whether the search leaves it at its initial value.
        shared: whether the laws of a coordinate share one parameter of this name.
        own: name of a parameter, `theta.OWN`, that takes its place where a system has Coulomb
            friction itself; "" where the law brings it always.
        is_level: whether it is the level of a Coulomb friction. A system that has this parameter
            has this friction, too: the law adds what is beyond it.
        prior: standard deviation of what is known of it, from the motion; None for none.
    """

    name: str
    symbol: str
    unit: str
    range: Callable[[Motion], SearchRange]
    fixed: bool = False
    shared: bool = False
    own: str = ""
    is_level: bool = False
    prior: Callable[[Motion], float] | None = None

    def for_coordinate(self, coordinate: Coordinate, force_unit: str, motion: Motion) -> Parameter:
        """The parameter of the law at a coordinate that moves in some way."""
        unit = self.unit.format(force=force_unit, position=coordinate.unit)
        prior = None if self.prior is None else self.prior(motion)
        return Parameter(
            f"{coordinate.name}.{self.name}", unit, *self.range(motion), self.fixed, prior
        )

    def for_input(self, channel: Input, motion: Motion) -> Parameter:
        """The parameter of the law at an input; `motion` is that of any coordinate."""
        unit = self.unit.format(input=channel.unit)
        return Parameter(f"{channel.name}.{self.name}", unit, *self.range(motion), fixed=self.fixed)


@dataclass(frozen=True, kw_only=True)
class Law:
    """A force with a name.

    Attributes:
        name: its name in recipes.
        help: what it is, in a line of the documentation.
        parameters: its parameters, in the order in which its functions take their values.
        needs_limited_travel: whether it depends on a deflection. Where no coordinate is named, it
            is not added at those that turn around, which have none.
        joins_springs: whether a spring of the system `mechanism` brings it along.
        is_at_input: whether its place is an input instead of a coordinate.
        is_linear: whether it is the sum of what each of its free parameters multiplies, and follows
            from the motion alone.
    """

    name: str
    help: str
    parameters: tuple[ForceParameter, ...]
    needs_limited_travel: bool = False
    joins_springs: bool = False
    is_at_input: bool = False
    is_linear: bool = True

    def steady_force(self, v: Value, values: Sequence[Value]) -> Any:
        """Force against a motion of constant speed [N m or N].

        Args:
            v: velocities [rad/s or m/s].
            values: values of its parameters.

        Returns:
            The force; None where it depends on more than the speed.
        """


@dataclass(frozen=True, kw_only=True)
class Friction(Law):
    """A force without a potential, positive against positive motion.

    Attributes:
        force: `force(q, v, *values)` [N m or N].
        needs_load: whether `force` takes, in the place of q, the load: the force of the system's
            potential energy at the coordinate [N m or N].
    """

    force: Callable[..., Any]
    needs_load: bool = False

    def steady_force(self, v: Value, values: Sequence[Value]) -> Any:
        """See `Law.steady_force`."""
        depends = self.needs_load or self.needs_limited_travel
        return None if depends else self.force(0.0, v, *values)


@dataclass(frozen=True, kw_only=True)
class Spring(Law):
    """A force with a potential.

    Attributes:
        energy: `energy(q, *values)` [J].
    """

    energy: Callable[..., Any]
    needs_limited_travel: bool = True


@dataclass(frozen=True, kw_only=True)
class ForceWithMemory(Law):
    """A force with internal states z: a number, or of several an array.

    Attributes:
        rate: the derivative of z, `rate(v, z, *values)`.
        initial: z as it is expected at the beginning of a record, `initial(q, *values)`.
        force: the force on the coordinate, `force(v, z, *values)` [N m or N].
        states: how many there are; None for z as a number.
        settle: z as it goes on at a sample, `settle(z, *values)`; None for z itself.
    """

    rate: Callable[..., Any]
    initial: Callable[..., Any]
    force: Callable[..., Any]
    states: int | None = None
    settle: Callable[..., Any] | None = None

    def steady_force(self, v: Value, values: Sequence[Value]) -> Any:
        """See `Law.steady_force`."""
        if self.settle is None:
            return None
        z = self.settle(jnp.inf * jnp.sign(jnp.asarray(v))[..., None], *values)
        return -self.force(v, z.T, *values)


@dataclass(frozen=True, kw_only=True)
class AddedInertia(Law):
    """An inertia beside those that a system has; its parameter is the inertia."""


@dataclass(frozen=True, kw_only=True)
class ActuatorLag(Law):
    """An internal state w that follows an input and acts on the system in its place.

    Attributes:
        rate: the derivative of w, `rate(u, w, *values)`.
        initial: w as it is expected at the beginning of a record, `initial(u, *values)`.
    """

    rate: Callable[..., Any]
    initial: Callable[..., Any]
    is_at_input: bool = True


@dataclass(frozen=True, kw_only=True)
class InputCurve(Law):
    """A curve of what acts in the place of an input, or of what follows it with a lag.

    Attributes:
        acting: `acting(u, *values)`, in the unit of the input.
    """

    acting: Callable[..., Any]
    is_at_input: bool = True


def _from_zero(most: Callable[[Motion], float]) -> Callable[[Motion], SearchRange]:
    """A range from 0 on, where the search begins."""
    return lambda motion: (0.0, 0.0, most(motion))


def _either_sign(most: Callable[[Motion], float]) -> Callable[[Motion], SearchRange]:
    """A range to both sides of 0, where the search begins."""
    return lambda motion: (0.0, -most(motion), most(motion))


def _positive(most: Callable[[Motion], float]) -> Callable[[Motion], SearchRange]:
    """A range of what has no derivative at 0: the search begins at a thousandth of the largest."""
    return lambda motion: (1e-3 * most(motion), 1e-6 * most(motion), most(motion))


def _sticking_forces(motion: Motion) -> SearchRange:
    """Sticking forces up to twice the force: larger ones would let nothing move.

    Wider ranges, and initial values below a tenth of the force, lead to friction that is all spring
    or all damping.
    """
    return 0.1 * motion.force, 1e-3 * motion.force, 2.0 * motion.force


def _stribeck_speeds(motion: Motion) -> SearchRange:
    """A fifth of the speed, and a range by the width of the smoothed sign, which lies below it.

    Of two widths, by the motion and of the system itself, the smaller and the larger one count.
    """
    widths = motion.slow, motion.width or motion.slow
    return 10.0 * motion.slow, 2.0 * min(widths), 100.0 * max(widths)


def _relaxation_rates(motion: Motion) -> SearchRange:
    """Rates from one over the longest record to a quarter of the sampling rate."""
    slowest, fastest = 1 / motion.longest, 1 / (4 * motion.dt)
    return min(max(motion.speed / motion.travel, slowest), fastest), slowest, fastest


def _presliding_deflections(motion: Motion) -> SearchRange:
    """Deflections from the travel in a quarter of a period, between samples, to the whole."""
    least = motion.speed * motion.dt / 4
    most = max(motion.travel, 16 * least)
    return min(max(0.05 * motion.travel, 4 * least), most), least, most


def _end(motion: Motion, which: int) -> SearchRange:
    """The end beyond which few samples are, and half of the travel to each side.

    Further inside, ends would stand for what is missing between them.
    """
    around = motion.travel / 2
    return motion.ends[which], motion.ends[which] - around, motion.ends[which] + around


def _stop_stiffness(motion: Motion) -> SearchRange:
    """Stiffnesses by which the usual force reaches a tenth of the travel into an end, or less.

    Soft ends have derivatives where hard ones have none to speak of.
    """
    soft = 10.0 * motion.force / motion.travel
    return soft, 0.1 * soft, 100.0 * soft


def _time_constants(motion: Motion) -> SearchRange:
    """Time constants from a quarter of a period to a quarter of the longest record."""
    return 2 * motion.dt, motion.dt / 4, max(motion.longest / 4, 4 * motion.dt)


_COULOMB = ForceParameter(
    "coulomb", "c", "{force}", _from_zero(lambda m: m.largest_force), is_level=True
)
# over a whole record the search would make up for other errors by it, so it is fixed
_SMOOTH_SPEED = ForceParameter(
    "smooth_speed",
    "w",
    "{position}/s",
    lambda m: (m.slow, m.slow / 10.0, m.slow * 10.0),
    fixed=True,
    shared=True,
)
_OWN_COULOMB = replace(_COULOMB, own=OWN_LEVEL)
_OWN_SMOOTH_SPEED = replace(_SMOOTH_SPEED, own=OWN_WIDTH)
_BREAKAWAY = ForceParameter("breakaway", "b", "{force}", _positive(lambda m: m.largest_force))
_STRIBECK_SPEED = ForceParameter("stribeck_speed", "v_s", "{position}/s", _stribeck_speeds)
_STICKING = ForceParameter("sticking", "c", "{force}", _sticking_forces)
_PRESLIDING = ForceParameter("presliding", "d", "{position}", _presliding_deflections)


_CURVE_WEIGHTS, _SLIP_LEVELS = (
    tuple(
        ForceParameter(
            f"{name}_{i}", f"{letter}_{i}", "{force}", _from_zero(lambda m: m.largest_force)
        )
        for i in range(1, len(widths) + 1)
    )
    for name, letter, widths in (("curve", "a", CURVE_SPEEDS), (SLIP, "c", SLIP_TRAVELS))
)
# presliding behind gears and in bearings, whatever the motion [rad or m]
_SLIP_TRAVEL = ForceParameter(
    f"{SLIP}_travel", "d", "{position}", lambda m: (1e-3, 1e-5, 1e-1), fixed=True
)
_ARMATURE = ForceParameter(
    "armature",
    "J",
    "{force} s^2/{position}",
    _from_zero(lambda m: m.largest_force * m.travel / m.speed**2),
)
_LOAD_SHARE = ForceParameter(
    "load_friction",
    "s",
    "1",
    _from_zero(lambda m: LARGEST_LOAD_SHARE),
    prior=lambda m: 0.3 * LARGEST_LOAD_SHARE,
)


def _undeflected(q: Value, *values: Value) -> Any:
    """The internal state of a friction where a record begins: what came before is unknown."""
    return jnp.zeros_like(q)


def _lugre_rate(
    v: Value,
    z: Value,
    level: Value,
    more: Value,
    stribeck_speed: Value,
    deflection: Value,
    damping: Value,
) -> Any:
    """The rate of LuGre friction by the parameters of its law."""
    return lugre_rate(v, z, level, level + more, stribeck_speed, level / deflection)


_LAWS: tuple[Law, ...] = (
    Friction(
        name="viscous",
        help="viscous friction, `b v` against the motion",
        parameters=(
            ForceParameter(
                "viscous",
                "b",
                "{force} s/{position}",
                _from_zero(lambda m: m.largest_force / m.speed),
            ),
        ),
        force=lambda q, v, damping: viscous(v, damping),
    ),
    Friction(
        name="coulomb",
        help="Coulomb friction, `c tanh(v / w)` against the motion",
        parameters=(_COULOMB, _SMOOTH_SPEED),
        force=lambda q, v, level, speed: coulomb(v, level, speed),
    ),
    Friction(
        name="stribeck",
        is_linear=False,
        help="Stribeck friction, `(c + b exp(-(v / v_s)²)) tanh(v / w)` against the motion",
        parameters=(
            _OWN_COULOMB,
            _BREAKAWAY,
            _STRIBECK_SPEED,
            _OWN_SMOOTH_SPEED,
        ),
        force=lambda q, v, level, more, stribeck_speed, speed: stribeck(
            v, level, level + more, stribeck_speed, speed
        ),
    ),
    Friction(
        name="curve",
        help="friction that grows with the speed and ever less so, the sum of `a_i tanh(v / w_i)` "
        f"with `w_i` = {', '.join(f'{x:g}' for x in CURVE_SPEEDS)} times w",
        # its narrowest term is a Coulomb friction
        parameters=(
            replace(_CURVE_WEIGHTS[0], own=OWN_LEVEL, is_level=True),
            *_CURVE_WEIGHTS[1:],
            _OWN_SMOOTH_SPEED,
        ),
        force=lambda q, v, *values: friction_curve(v, values[:-1], values[-1]),
    ),
    Friction(
        name="load",
        help="Coulomb friction that grows with the load, `s abs(f) tanh(v / w)` against the motion;"
        " f is the force of the system's potential energy, as of gravity",
        parameters=(_LOAD_SHARE, _OWN_SMOOTH_SPEED),
        force=coulomb_by_load,
        needs_load=True,
    ),
    Friction(
        name="end_stops",
        is_linear=False,
        help="ends of travel: beyond an end by x, `k x max(1 + d dx/dt, 0)` back",
        parameters=(
            ForceParameter("lower_end", "e_1", "{position}", lambda m: _end(m, 0)),
            ForceParameter("upper_end", "e_2", "{position}", lambda m: _end(m, 1)),
            ForceParameter("stop_stiffness", "k", "{force}/{position}", _stop_stiffness),
            ForceParameter(
                "stop_damping",
                "d",
                "s/{position}",
                lambda m: (10.0 / m.speed, 0.0, 100.0 / m.speed),
            ),
        ),
        needs_limited_travel=True,
        force=end_stops,
    ),
    Spring(
        name="spring",
        help="linear spring, `k q` towards q = 0; k of either sign",
        parameters=(
            ForceParameter(
                "spring",
                "k",
                "{force}/{position}",
                _either_sign(lambda m: m.largest_force / m.position),
            ),
        ),
        energy=linear_spring,
    ),
    Spring(
        name="cubic",
        help="cubic spring, `k q³` towards q = 0; k of either sign",
        parameters=(
            ForceParameter(
                "cubic",
                "k",
                "{force}/{position}^3",
                _either_sign(lambda m: m.largest_force / m.position**3),
            ),
        ),
        joins_springs=True,
        energy=cubic_spring,
    ),
    Friction(
        name="coulomb_by_position",
        help="Coulomb friction that grows with the deflection, `g abs(q) tanh(v / w)` against the "
        "motion: the more a cable is wound, the more it rubs",
        parameters=(
            ForceParameter(
                "rubbing",
                "g",
                "{force}/{position}",
                _from_zero(lambda m: m.largest_force / m.position),
            ),
            _SMOOTH_SPEED,
        ),
        needs_limited_travel=True,
        joins_springs=True,
        force=coulomb_by_position,
    ),
    Friction(
        name="constant",
        help="constant force `f` against positive motion: friction that differs by direction, a "
        "weight, the offset of an amplifier; of either sign",
        parameters=(
            ForceParameter("constant", "f", "{force}", _either_sign(lambda m: m.largest_force)),
        ),
        force=lambda q, v, level: level,
    ),
    ForceWithMemory(
        name="maxwell",
        is_linear=False,
        help="spring that relaxes (Maxwell element), `k z` against its deflection z, an internal "
        "state: `dz/dt = v - r z`. At the beginning of a record z is `s q`: s is 0 after a long "
        "rest, 1 where the coordinate was deflected just now",
        parameters=(
            ForceParameter(
                "maxwell",
                "k",
                "{force}/{position}",
                _positive(lambda m: m.largest_force / m.travel),
            ),
            ForceParameter("relaxation", "r", "1/s", _relaxation_rates),
            # records do not show what was before them: between the two cases, and fixed
            ForceParameter("turned", "s", "1", lambda m: (0.5, 0.0, 1.0), fixed=True),
        ),
        needs_limited_travel=True,
        joins_springs=True,
        rate=lambda v, z, stiffness, relaxation, share: maxwell_rate(v, z, relaxation),
        initial=lambda q, stiffness, relaxation, share: share * q,
        force=lambda v, z, stiffness, relaxation, share: maxwell_force(z, stiffness),
    ),
    ForceWithMemory(
        name=SLIP,
        help="dry friction with a memory (Maxwell-slip), the sum of `c_i sat(z_i / d_i)` against "
        "the motion: springs that slip, with `d_i` = "
        f"{', '.join(f'{x:g}' for x in SLIP_TRAVELS)} times d; z_i are their deflections, internal "
        "states that follow the motion and are cut to d_i",
        parameters=(*_SLIP_LEVELS, _SLIP_TRAVEL),
        states=len(SLIP_TRAVELS),
        rate=lambda v, z, *values: jnp.ones_like(z) * v,
        initial=lambda q, *values: jnp.zeros(len(SLIP_TRAVELS), jnp.result_type(q)),
        force=lambda v, z, *values: slip_force(z, values[:-1], values[-1]),
        settle=lambda z, *values: jnp.clip(
            z, *(sign * np.array(SLIP_TRAVELS) * values[-1] for sign in (-1, 1))
        ),
    ),
    ForceWithMemory(
        name="dahl",
        is_linear=False,
        help="Dahl friction, `c z / d` against the motion; z is the deflection of the surfaces "
        "before they slip, an internal state: `dz/dt = v - abs(v) z / d`",
        parameters=(_STICKING, _PRESLIDING),
        rate=lambda v, z, level, deflection: dahl_rate(v, z, level, level / deflection),
        initial=_undeflected,
        force=lambda v, z, level, deflection: dahl_force(z, level / deflection),
    ),
    ForceWithMemory(
        name="lugre",
        is_linear=False,
        help="LuGre friction, `c z / d + e dz/dt` against the motion; z is the deflection of "
        "bristles, an internal state: `dz/dt = v - c abs(v) z / (d g)` with the Stribeck curve "
        "`g = c + b exp(-(v / v_s)²)`",
        parameters=(
            _STICKING,
            ForceParameter("breakaway", "b", "{force}", _sticking_forces),
            _STRIBECK_SPEED,
            _PRESLIDING,
            ForceParameter(
                "bristle_damping",
                "e",
                "{force} s/{position}",
                _from_zero(lambda m: m.largest_force / m.speed),
            ),
        ),
        rate=_lugre_rate,
        initial=_undeflected,
        force=lambda v, z, level, more, stribeck_speed, deflection, damping: lugre_force(
            z,
            _lugre_rate(v, z, level, more, stribeck_speed, deflection, damping),
            level / deflection,
            damping,
        ),
    ),
    ForceWithMemory(
        name="bouc_wen",
        is_linear=False,
        help="hysteresis (Bouc-Wen), `c z / d` against the motion; z is an internal state, with "
        "`w = z / d`: `dz/dt = v - a abs(v) abs(w)^(n-1) w + (a - 1) v abs(w)^n`",
        parameters=(
            _STICKING,
            _PRESLIDING,
            ForceParameter("hysteresis_shape", "a", "1", lambda m: (1.0, 0.5, 5.0)),
            # records hardly show it beside the shape
            ForceParameter("hysteresis_exponent", "n", "1", lambda m: (2.0, 1.0, 10.0), fixed=True),
        ),
        rate=lambda v, z, level, deflection, shape, exponent: bouc_wen_rate(
            v, z, deflection, shape, exponent
        ),
        initial=_undeflected,
        force=lambda v, z, level, deflection, shape, exponent: bouc_wen_force(z, deflection, level),
    ),
    AddedInertia(
        name="armature",
        help="inertia of a motor, `J a`: of use where a motor turns with several coordinates, as "
        "`armature:A+B`",
        parameters=(_ARMATURE,),
    ),
    InputCurve(
        name="dead_zone",
        is_linear=False,
        help="dead zone of an input: nothing acts up to d, and beyond it `abs(u) - d`",
        parameters=(ForceParameter("dead_zone", "d", "{input}", _from_zero(lambda m: m.drive)),),
        acting=dead_zone,
    ),
    ActuatorLag(
        name="lag",
        is_linear=False,
        help="lag of an actuator: the system is driven by w in the place of the input u, an "
        "internal state: `dw/dt = (u - w) / T`. At the beginning of a record w is `s u`: s is 1 "
        "where the input was there for long, 0 where the actuator begins at rest",
        parameters=(
            ForceParameter("lag", "T", "s", _time_constants),
            # few records show it, and where the first input is 0 it does not matter
            ForceParameter("initial_share", "s", "1", lambda m: (1.0, 0.0, 1.0), fixed=True),
        ),
        rate=lambda u, w, time_constant, share: lag_rate(u, w, time_constant),
        initial=lambda u, time_constant, share: share * u,
    ),
)
LAWS = {law.name: law for law in _LAWS}
