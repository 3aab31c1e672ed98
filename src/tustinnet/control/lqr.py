"""Linear-quadratic feedback: about an operating point, and along a plan."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float
from numpy.typing import ArrayLike

from tustinnet.control.dynamics import (
    ControlledModel,
    Limits,
    controlled,
    input_limits,
    require_known,
    safe_inputs,
)
from tustinnet.control.equilibrium import require_stabilisable
from tustinnet.control.plan import Plan
from tustinnet.control.weights import Deviations, Weights, bryson_weights
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.shown import Brief
from tustinnet.simulate.filtering import checked_vector
from tustinnet.simulate.range import Range

FAST = 10.0  # times usual speeds: of motions that dry friction hardly damps
_DEVIATION_SECONDS = (
    1.0  # for which a position may stay at its deviation, where its integral has no weight
)


class Pid(NamedTuple):
    """Gains of a PID controller in parallel form, `u0 + kp e + ki integral(e) - kd dq/dt`.

    Attributes:
        proportional: kp, by the error `e = q0 - q` [unit of the input/rad or /m].
        integral: ki, by its integral [unit of the input/(rad s) or /(m s)].
        derivative: kd, by the velocity [s times that of kp].
    """

    proportional: float
    integral: float
    derivative: float


@dataclass(frozen=True, kw_only=True)
class Feedback:
    """Linear feedback about an operating point, `u = u0 - gain z`, within the input limits.

    `z` has the errors of the states `x - x0`, then the integrals of the errors [s times their
    units] of the coordinates in `integral`, then the previous commands as differences from `u0`,
    the latest first. There are previous commands where inputs act late, and where a step of the
    model depends on inputs before its sample. An integral grows by `dt` times the error after each
    sample at which no input is at a limit.

    Attributes:
        gain: (n_u, n_z).
        x0: the state of the operating point, (n_x,).
        u0: the inputs there, (n_u,).
        lower: lower limits of the inputs, (n_u,).
        upper: upper limits of the inputs, (n_u,).
        dt: sampling period [s].
        speeds: usual speeds for which the model was linearised [rad/s or m/s], (n_q,), see
            `ControlledModel.tangent`.
        integral: indices of the coordinates with integral action.
        delay: samples from when an input is computed to when it acts.
        periodic: indices of the angles whose errors are wrapped into -pi..pi: those that the model
            does not change by whole turns.
        safe: inputs while the state is not known, (n_u,) or one for all, within the limits.
    """

    gain: Float[np.ndarray, "n_u n_z"]
    x0: Float[np.ndarray, " n_x"]
    u0: Float[np.ndarray, " n_u"]
    lower: Float[np.ndarray, " n_u"]
    upper: Float[np.ndarray, " n_u"]
    dt: float
    speeds: Float[np.ndarray, " n_q"]
    integral: tuple[int, ...] = ()
    delay: int = 0
    periodic: tuple[int, ...] = ()
    safe: Float[np.ndarray, " n_u"] | float = 0.0

    @property
    def final(self) -> "Feedback":
        """Itself: what holds the goal, as `Tracking.final` does after its plan."""
        return self

    @property
    def previous(self) -> int:
        """Number of samples of previous commands that `z` has."""
        n_u, n_z = self.gain.shape
        return (n_z - len(self.x0) - len(self.integral)) // n_u

    @property
    def pid(self) -> Pid | None:
        """The feedback as a PID controller, None where it is more than that.

        It is one of one coordinate by one input, without internal states and late inputs.
        """
        if len(self.u0) > 1 or len(self.speeds) > 1 or len(self.x0) > 2 or self.previous:
            return None
        gains = [float(x) for x in self.gain[0]]
        return Pid(gains[0], gains[2] if self.integral else 0.0, gains[1])

    def command(self, unlimited: Float[np.ndarray, " n_u"]) -> Float[np.ndarray, " n_u"]:
        """Inputs within the limits; the safe ones where an input is not finite, (n_u,)."""
        known = unlimited if np.isfinite(unlimited).all() else np.full_like(unlimited, self.safe)
        return np.clip(known, self.lower, self.upper)


@dataclass(frozen=True)
class Recovery:
    """The way back to the start of a plan, after a fall from its end.

    A state has fallen if any of its errors about the plan's end is larger than `fallen_beyond`.
    Then `feedback` damps the motion, until all errors about the plan's start are at most
    `settled_within`; the plan begins again there. Where a number is 0 its state does not count.

    Attributes:
        feedback: feedback about the plan's start, without integrals.
        fallen_beyond: errors about the plan's end, (n_x,).
        settled_within: errors about the plan's start, (n_x,).
    """

    feedback: Feedback
    fallen_beyond: Float[np.ndarray, " n_x"]
    settled_within: Float[np.ndarray, " n_x"]


class AccelerationGains(NamedTuple):
    """Gains from errors of each coordinate to its acceleration.

    Attributes:
        proportional: kp, by the error of the position [1/s^2].
        derivative: kd, by that of the velocity [1/s].
        integral: ki, by the integral of the error of the position [1/s^3].
    """

    proportional: float
    derivative: float
    integral: float


@dataclass(frozen=True, repr=False)
class Tracking(Brief):
    """Time-varying feedback along a plan, and the feedback that holds its end.

    Attributes:
        plan: the plan.
        gains: gains at every step, (N, n_u, n_z): `u = plan.u[k] - gains[k] z`, `z` the errors of
            the states and the previous commands as differences from those of the plan. With
            `by_acceleration` also the integrals of `final`, which go on from the plan to its end.
        final: the feedback after the last step.
        recovery: the way back to the plan's start after a fall; None for none.
        by_acceleration: the gains of which those along the plan follow by inverse dynamics, see
            `computed_torque`; None for others.
    """

    plan: Plan
    gains: Float[np.ndarray, "N n_u n_z"]
    final: Feedback
    recovery: Recovery | None = None
    by_acceleration: AccelerationGains | None = None

    @property
    def integral(self) -> tuple[int, ...]:
        """Indices of the coordinates whose errors are integrated along the plan."""
        return self.final.integral if self.by_acceleration else ()


class LoopMatrices(NamedTuple):
    """Matrices of a feedback loop, `z[k+1] = a z[k] + b du[k]`, `z` as in `Feedback`.

    Attributes:
        a: (n_z, n_z).
        b: (n_z, n_u).
    """

    a: Float[np.ndarray, "n_z n_z"]
    b: Float[np.ndarray, "n_z n_u"]


class Holding(NamedTuple):
    """Linear-quadratic feedback about a point, and the linear model that it is for.

    Attributes:
        speeds: usual speeds for which the model was linearised, (n_q,).
        matrices: the linear model.
        value: the cost to go, `z' value z`, (n_z, n_z).
        gain: the gain, (n_u, n_z).
    """

    speeds: Float[np.ndarray, " n_q"]
    matrices: LoopMatrices
    value: Float[np.ndarray, "n_z n_z"]
    gain: Float[np.ndarray, "n_u n_z"]


def lqr(
    model: Model,
    x: ArrayLike,
    u: ArrayLike,
    *,
    deviations: Deviations | None = None,
    range: Range | None = None,
    integral: Sequence[str] = (),
    delay: int = 0,
    limits: Limits | None = None,
    safe: Mapping[str, float] | None = None,
) -> Feedback:
    """Discrete linear-quadratic feedback about an operating point, mostly an equilibrium.

    It minimises the sum of squared errors and inputs, each divided by its acceptable deviation.
    The model is linearised in the mean over motions, see `hold`.

    Args:
        model: a model that steps from sample to sample.
        x: the state of the operating point, (n_x,), as `find_equilibrium` finds it.
        u: the inputs there, (n_u,).
        deviations: acceptable deviations of states and inputs by name, `{"theta": 0.1}`, and of
            integrals as `integral_theta` [rad s]; what is not named follows from `range`, see the
            reference.
        range: the range of the training records, which a model file has.
        integral: names of the coordinates whose errors are integrated.
        delay: samples from when an input is computed to when it acts, beside the delays that the
            inputs of the model have.
        limits: limits of inputs by name, instead of those that the model declares.
        safe: inputs by name while the estimator has lost the state; 0 of those without.

    Raises:
        InputError: an input without limits, safe inputs beyond them; a mode that does not decay and
            that the inputs do not move (its coordinates and eigenvalue); an integral that cannot be
            held at 0; names that the model does not have.

    References:
        Anderson and Moore (1990), Optimal control: linear quadratic methods; Gelb and Vander Velde
        (1968), Multiple-input describing functions.
    """
    system, bounds = controlled(model, delay), input_limits(model, limits)
    x0 = checked_vector("x", x, system.n_x, "lqr")
    u0 = checked_vector("u", u, system.n_u, "lqr")
    positions = [c.name for c in model.channels.coordinates]
    require_known(dict.fromkeys(integral), positions, "integral", "coordinates")
    if len(integral) > system.n_u:
        raise InputError(
            "integral", f"{len(integral)} coordinates", f"at most {system.n_u}, as there are inputs"
        )
    indices = tuple(positions.index(name) for name in integral)
    own = {k: v for k, v in (deviations or {}).items() if not k.startswith("integral_")}
    weights = bryson_weights(system, bounds, own, range)
    sums = []
    for name, i in zip(integral, indices, strict=True):
        default = (
            _DEVIATION_SECONDS / np.sqrt(weights.states[i])
            if weights.states[i]
            else _DEVIATION_SECONDS
        )
        sums.append(1 / (deviations or {}).get(f"integral_{name}", default) ** 2)
    sum_names = {f"integral_{name}" for name in integral}
    require_known(
        dict.fromkeys(set(deviations or {}) - set(own)),
        sorted(sum_names) or ["states"],
        "weights",
        "integrals",
    )
    require_stabilisable(system, x0, u0, weights.usual_speeds(model.channels))
    held = hold(system, x0, u0, weights, indices, sums)
    return Feedback(
        gain=held.gain,
        x0=x0,
        u0=u0,
        lower=bounds.lower,
        upper=bounds.upper,
        dt=system.dt,
        integral=indices,
        delay=delay,
        periodic=system.periodic,
        speeds=held.speeds,
        safe=safe_inputs(model, bounds, safe),
    )


def hold(
    system: ControlledModel,
    x: Float[np.ndarray, " n_x"],
    u: Float[np.ndarray, " n_u"],
    weights: Weights,
    integral: Sequence[int] = (),
    sums: Sequence[float] = (),
) -> Holding:
    """Linear-quadratic feedback about a point, for motions as fast as it needs.

    The model is linearised in the mean over a tenth of the acceptable speeds, where dry friction is
    a force and not the huge viscous friction that it looks like at rest. Where it still rules, a
    joint without an input seems stuck to the next one, and feedback for that drives a moving
    machine away. So the speeds are doubled until feedback serves motions twice as fast, too, and is
    stable without the damping that dry friction is to small motions.

    Args:
        system: the model.
        x: the state of the point, (n_x,).
        u: the inputs there, (n_u,).
        weights: of states and inputs.
        integral: indices of the coordinates whose errors are integrated.
        sums: weights of these integrals.

    Raises:
        InputError: an integral that the inputs cannot hold at 0, derivatives that are not finite.
    """

    def solve(speeds: Float[np.ndarray, " n_q"]) -> Holding:
        matrices = loop_matrices(system, x, u, speeds, integral)
        value = _riccati_solution(system, matrices, weights, sums)
        return Holding(speeds, matrices, value, _feedback_gain(matrices, value, weights))

    def mean_cost(value: Float[np.ndarray, "n_z n_z"]) -> float:
        """The mean cost from states that are as far away as is acceptable."""
        has_weight = weights.states > 0
        own = np.diag(value)[: system.n_x][has_weight]
        return float(np.mean(own / weights.states[has_weight]))

    def cost(loop: LoopMatrices, gain: Float[np.ndarray, "n_u n_z"]) -> float:
        """The mean cost by a gain, inf if errors grow."""
        if spectral_radius(loop, gain) >= 1:
            return np.inf
        closed = loop.a - loop.b @ gain
        price = np.diag(_prices(system, len(closed), weights, sums))
        price += gain.T @ np.diag(weights.inputs) @ gain
        return mean_cost(scipy.linalg.solve_discrete_lyapunov(closed.T, price))

    holding = solve(weights.usual_speeds(system.model.channels))
    # usual speeds are mostly a tenth of the acceptable ones: up to nearly these
    for _ in range(3):
        faster = solve(2 * holding.speeds)
        # feedback that costs no more in motions twice as fast serves both, see
        # docs/explanation/control.md
        if cost(faster.matrices, holding.gain) <= 1.25 * mean_cost(faster.value):
            fast = loop_matrices(system, x, u, FAST * holding.speeds, integral)
            if spectral_radius(loop_without_friction(holding.matrices, fast), holding.gain) < 1:
                break
        holding = faster
    return holding


def loop_matrices(
    system: ControlledModel,
    x: Float[np.ndarray, " n_x"],
    u: Float[np.ndarray, " n_u"],
    speeds: Float[np.ndarray, " n_q"],
    integral: Sequence[int] = (),
    values: Mapping[str, float] | None = None,
) -> LoopMatrices:
    """The linearised model with integrals of errors, in the order of `Feedback`.

    With other values of physical parameters, see `ControlledModel.tangent`.
    """
    a, b = system.tangent(x, u, speeds, values)
    n_x, n_i = system.n_x, len(integral)
    sums = np.zeros((n_i, len(a)))
    sums[np.arange(n_i), list(integral)] = system.dt
    a = np.block([[a, np.zeros((len(a), n_i))], [sums, np.eye(n_i)]])
    b = np.concatenate([b, np.zeros((n_i, system.n_u))])
    # integrals stand between the states and the previous commands
    order = [*range(n_x), *range(system.size, len(a)), *range(n_x, system.size)]
    return LoopMatrices(a[np.ix_(order, order)], b[order])


def loop_without_friction(usual: LoopMatrices, fast: LoopMatrices) -> LoopMatrices:
    """The loop of motions that are so large that dry friction does not damp them.

    In the mean over motions its damping falls as their speeds grow, so two of them say the limit.

    Args:
        usual: the loop of motions at some speeds.
        fast: that at `FAST` times these.
    """
    pairs = zip(usual, fast, strict=True)
    return LoopMatrices(*((FAST * many - one) / (FAST - 1) for one, many in pairs))


def spectral_radius(loop: LoopMatrices, gain: Float[np.ndarray, "n_u n_z"]) -> float:
    """The largest size of the eigenvalues of a loop that feedback closes; below 1 it is stable."""
    return float(np.abs(np.linalg.eigvals(loop.a - loop.b @ gain)).max())


def _riccati_solution(
    system: ControlledModel, matrices: LoopMatrices, weights: Weights, sums: Sequence[float] = ()
) -> Float[np.ndarray, "n_z n_z"]:
    """The cost to go of linear-quadratic feedback without an end: `z' P z`.

    Raises:
        InputError: there is none: an integral that the inputs cannot hold at 0.
    """
    price = np.diag(_prices(system, len(matrices.a), weights, sums))
    try:
        return scipy.linalg.solve_discrete_are(
            matrices.a, matrices.b, price, np.diag(weights.inputs)
        )
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            "lqr",
            f"no feedback holds this point ({error})",
            "inputs that move all states and integrals",
            "leave out integrals, or change weights",
        ) from error


def _prices(
    system: ControlledModel, size: int, weights: Weights, sums: Sequence[float]
) -> Float[np.ndarray, " n_z"]:
    """Weights of states, of integrals, and of what has none, in the order of `Feedback`."""
    # no mode is without any weight
    prices = np.full(size, 1e-9)
    prices[: system.n_x] += weights.states
    prices[system.n_x : system.n_x + len(sums)] += np.array(sums)
    return prices


def _feedback_gain(
    matrices: LoopMatrices, value: Float[np.ndarray, "n_z n_z"], weights: Weights
) -> Float[np.ndarray, "n_u n_z"]:
    """The gain whose cost to go one step later is `z' value z`, (n_u, n_z)."""
    a, b = matrices
    return np.linalg.solve(np.diag(weights.inputs) + b.T @ value @ b, b.T @ value @ a)


def time_varying_lqr(
    model: Model,
    plan: Plan,
    final: Feedback,
    *,
    deviations: Deviations | None = None,
    range: Range | None = None,
    settle: Feedback | None = None,
) -> Tracking:
    """Time-varying linear-quadratic feedback along a plan, and the feedback that holds its end.

    With `settle` the plan begins again after a fall (`Recovery`): a coordinate that makes most of
    the plan's way is farther from its end than a quarter of this way. The start is reached where
    positions and velocities are within a tenth of their range along the plan.

    Args:
        model: a model that steps from sample to sample.
        plan: the plan.
        final: the feedback about the plan's end, without integrals. Its limits and its delay hold
            along the plan, too.
        deviations: acceptable deviations of states and inputs by name, as in `lqr`.
        range: the range of the training records.
        settle: feedback about the plan's start, without integrals; None where the plan does not
            begin again after a fall. It is of use where the start is stable and the end is not.

    Raises:
        InputError: a plan of another model or period, names that the model does not have; a
            `settle` with integrals, or of another delay or limits than `final`.
    """
    system = controlled(model, final.delay)
    plan.require_for(system.n_x, system.n_u, system.dt, final.delay, "time_varying_lqr")
    if settle is not None and (
        settle.integral
        or _limits_of(model, settle) != _limits_of(model, final)
        or (settle.delay, settle.previous) != (final.delay, final.previous)
    ):
        raise InputError(
            "time_varying_lqr, settle",
            "a feedback with integrals, or of another delay or limits",
            "one without integrals, with the delay and the limits of `final`",
        )
    bounds = input_limits(model, _limits_of(model, final))
    weights = bryson_weights(system, bounds, deviations, range)
    end = hold(system, final.x0, final.u0, weights)
    gains, _ = gains_along(system, plan, end.value, weights)
    return Tracking(plan, gains, final, settle and _make_recovery(model, plan, settle))


def as_tracking(gains: Feedback | Tracking) -> Tracking:
    """Feedback along a motion; that about a point is along one of no steps."""
    if isinstance(gains, Tracking):
        return gains
    n_u, n_z = gains.gain.shape
    plan = Plan(
        x=gains.x0[None],
        u=np.zeros((0, n_u)),
        cost=0.0,
        converged=True,
        reached=True,
        iterations=0,
        dt=gains.dt,
        goal=gains.x0,
        before=gains.u0,
        delay=gains.delay,
    )
    return Tracking(plan, np.zeros((0, n_u, n_z)), gains)


def _make_recovery(model: Model, plan: Plan, settle: Feedback) -> Recovery:
    """The way back to a plan's start, its distances by the plan."""
    position, measured = model.channels.position, model.channels.measured
    fallen_beyond, settled_within = np.zeros((2, len(plan.goal)))
    way = np.abs(wrap(plan.goal - plan.x[0], settle.periodic))[position]
    # balances come back from less than a quarter of the way
    fallen_beyond[position] = np.where(way >= way.max() / 2, 0.25 * way, 0.0)
    settled_within[measured] = 0.1 * np.ptp(plan.x[:, measured], axis=0)
    return Recovery(settle, fallen_beyond, settled_within)


def wrap(error: Float[np.ndarray, " n_x"], periodic: tuple[int, ...]) -> Float[np.ndarray, " n_x"]:
    """An error whose periodic angles are brought into -pi..pi."""
    wrapped = np.array(error, np.float64)
    for i in periodic:
        wrapped[i] = (wrapped[i] + np.pi) % (2 * np.pi) - np.pi
    return wrapped


def gains_along(
    system: ControlledModel,
    plan: Plan,
    value: Float[np.ndarray, "n_z n_z"],
    weights: Weights,
) -> tuple[Float[np.ndarray, "N n_u n_z"], Float[np.ndarray, "samples n_z n_z"]]:
    """Linear-quadratic gains along a plan, and the costs to go at all of its samples.

    Args:
        system: the model.
        plan: the plan.
        value: the cost to go at its end.
        weights: of states and inputs.
    """
    before = plan.previous_inputs(system.previous)
    derivatives = system.derivatives(np.hstack([plan.x[:-1], before]), plan.u)
    price = np.diag(np.concatenate([weights.states, np.zeros(system.size - system.n_x)]))
    gains, values = [], [value]
    for derivative in derivatives[::-1]:
        matrices = LoopMatrices(derivative[:, : system.size], derivative[:, system.size :])
        gain = _feedback_gain(matrices, value, weights)
        value = price + matrices.a.T @ value @ (matrices.a - matrices.b @ gain)
        value = (value + value.T) / 2
        gains.append(gain)
        values.append(value)
    return np.stack(gains[::-1]), np.stack(values[::-1])


def _limits_of(model: Model, feedback: Feedback) -> Limits:
    """The limits of a feedback by the names of the inputs."""
    rows = zip(model.channels.inputs, feedback.lower, feedback.upper, strict=True)
    return {i.name: (float(low), float(high)) for i, low, high in rows}
