"""The design of a controller on a model: where, feedback, planned motion, estimator."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.control.closed_loop import WINDOW, Goal
from tustinnet.control.computed_torque import computed_torque, smooth_motion
from tustinnet.control.disturbances import cancel_disturbances, observe_disturbances
from tustinnet.control.dynamics import (
    InputLimits,
    Limits,
    controlled,
    input_limits,
    recorded_limits,
)
from tustinnet.control.equilibrium import OperatingPoint, find_equilibrium
from tustinnet.control.estimator import FilterConsistency, check_filter, find_noise, usual_noise
from tustinnet.control.ilqr import follow, ilqr
from tustinnet.control.lqr import Feedback, Recovery, Tracking, lqr, time_varying_lqr
from tustinnet.control.margins import Margins, margins
from tustinnet.control.mpc import Mpc
from tustinnet.control.plan import Plan
from tustinnet.control.weights import Deviations, Weights, bryson_weights
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.models.physical_values import equations_in
from tustinnet.simulate.filtering import FilterNoise
from tustinnet.simulate.range import ExtrapolationPoint, Range, features

Vector = Float[np.ndarray, " _"]


class DesignDefaults(NamedTuple):
    """Values that a design assumes where nothing else is said.

    All but `input` are set by hand, not measured.

    Attributes:
        swings: duration of a motion in periods of the slowest oscillation about its start.
        shortest: shortest such duration [s].
        longest: longest such duration [s].
        longer: times this duration that are tried in turn.
        input: acceptable deviation of an input, as a share of its limits' range; chosen by the
            success of two models on their own variants (docs/explanation/control.md).
        planned: share of the inputs' limits that a plan uses: the rest is for its feedback.
        followed: acceptable deviation from a reference, as a share of its range.
        window: deviation within which a position counts as held, as a share of its recorded
            range; of an angle at most 0.2 rad, and of any its acceptable deviation, and as large
            a share of the way of a motion.
        unknown_window: this deviation of a length whose range is not known [m].
        hold: periods for which a goal is to be held, where these are shorter than usual.
        settling: time constants of the slowest mode of a loop in which it comes to its point.
        longest_settling: longest such time, by that for which the goal is to be held.
    """

    swings: float = 6.0
    shortest: float = 1.0
    longest: float = 10.0
    longer: tuple[float, ...] = (1.0, 1.5, 2.5)
    input: float = 0.25
    planned: float = 0.8
    followed: float = 0.01
    window: float = 0.1
    unknown_window: float = 0.05
    hold: int = 5000
    settling: float = 3.0
    longest_settling: float = 12.0


DESIGN = DesignDefaults()


@dataclass(frozen=True)
class ControlTask:
    """Task of a controller: points to hold, a motion between them, and limits.

    Attributes:
        at: positions to hold, by the name of their coordinate [rad or m].
        start: positions, at rest, from which a planned motion leads there; None for no motion. What
            is not named is as near to 0 as an equilibrium allows.
        seconds: duration of the motion; None for one by the model's own oscillations.
        deviations: acceptable deviations of states, inputs and integrals by name, see `lqr`; of
            inputs by default a quarter of their limits' range.
        integral: names of coordinates with integral action.
        delay: samples from when an input is computed to when it acts.
        limits: limits of inputs by name, instead of those that the model declares; where neither
            says any, those that its training records have.
        within: limits of states by name, which a motion and predictive control keep.
        trust_beyond: whether a motion may leave the range of the training records, and a network
            hold a point that they do not have.
        safe: inputs by name while the estimator has lost the state, see `lqr`.
        reference: positions to follow to `at`, by the name of their coordinate, at each sample from
            the start on (see `read_reference`); None for a motion that is free between its ends.
        observer: whether lasting disturbances are estimated and taken from the inputs.
        mpc: steps that predictive control looks ahead, see `Mpc`; None for linear feedback.
    """

    at: Mapping[str, float]
    start: Mapping[str, float] | None = None
    seconds: float | None = None
    deviations: Deviations = field(default_factory=dict)
    integral: Sequence[str] = ()
    delay: int = 0
    limits: Limits | None = None
    within: Limits | None = None
    trust_beyond: bool = False
    safe: Mapping[str, float] | None = None
    reference: Mapping[str, Vector] | None = None
    observer: bool = False
    mpc: int | None = None


@dataclass(frozen=True)
class ControlDesign:
    """A controller with its estimator, and what is known of both.

    Attributes:
        model: the model.
        estimated: the model whose states are estimated: with disturbances where these are.
        task: what it is to do.
        deviations: acceptable ones of inputs, named states and short ways, by name.
        point: the equilibrium that is held.
        start: the equilibrium from which the motion begins, None without a motion.
        gains: the feedback, along the plan where there is one.
        mpc: the predictive controller that begins with this feedback, None without one.
        margins: of the loop about the equilibrium; where disturbances are estimated with all states
            known.
        noise: the noise of the estimator.
        consistency: tests of the estimator along records, None without records.
        goal: what counts as success.
        beyond: where the plan leaves the range of the training records, None where it does not.
    """

    model: Model
    estimated: Model
    task: ControlTask
    deviations: Deviations
    point: OperatingPoint
    start: OperatingPoint | None
    gains: Feedback | Tracking
    mpc: Mpc | None
    margins: Margins
    noise: FilterNoise
    consistency: FilterConsistency | None
    goal: Goal
    beyond: ExtrapolationPoint | None

    @property
    def plan(self) -> Plan | None:
        """The planned motion, None without one."""
        return self.gains.plan if isinstance(self.gains, Tracking) else None

    @property
    def has_computed_torque(self) -> bool:
        """Whether inverse dynamics follow the motion."""
        return isinstance(self.gains, Tracking) and self.gains.by_acceleration is not None

    def errors_along(self, x: Float[np.ndarray, "samples n_x"]) -> dict[str, float]:
        """Largest errors of states from the reference, by coordinate [rad or m]; none without."""
        names = [c.name for c in self.model.channels.coordinates]
        positions = x[:, self.model.channels.position]
        return {
            name: float(np.abs(positions[: len(q), names.index(name)] - q[: len(x)]).max())
            for name, q in (self.task.reference or {}).items()
        }

    @property
    def recovery(self) -> Recovery | None:
        """The way back to the motion's start after a fall, None without one."""
        return self.gains.recovery if isinstance(self.gains, Tracking) else None

    @property
    def feedback(self) -> Feedback:
        """The feedback about the equilibrium."""
        return self.gains.final

    @property
    def own_feedback(self) -> Feedback:
        """The feedback of the states of the model alone, without disturbances."""
        feedback, n_x, more = self.feedback, self.model.state_size, self.estimated.state_size
        gain = np.delete(feedback.gain, np.s_[n_x:more], axis=1)
        return replace(feedback, gain=gain, x0=feedback.x0[:n_x])

    @property
    def steps(self) -> int:
        """The periods of a run that shows whether the goal is met: the motion, and the hold."""
        planned = 0 if self.plan is None else len(self.plan.u)
        # without a plan, as long again to get there, and longer where the loop is slow
        hold = self.goal.hold
        slow = np.clip(DESIGN.settling * self.margins.slowest, hold, DESIGN.longest_settling * hold)
        settling = 0.2 * hold if planned else slow
        return planned + round((hold + settling) / self.model.dt)

    @property
    def first_positions(self) -> Vector:
        """The positions from which a run begins, (n_q,)."""
        point = self.point if self.start is None else self.start
        return point.x[self.model.channels.position]

    @property
    def controller(self) -> Feedback | Tracking | Mpc:
        """The controller: predictive, or its feedback alone."""
        return self.mpc or self.gains


def design_controller(
    model: Model,
    task: ControlTask,
    *,
    range: Range | None = None,
    records: Sequence[Experiment] = (),
    on_message: Callable[[str], None] = lambda _: None,
) -> ControlDesign:
    """Designs feedback, a motion and an estimator on a model.

    Args:
        model: a model that steps from sample to sample, with the values of one group.
        task: what the controller is to do.
        range: the range of its training records, which a model file has.
        records: records of the system, by which the noise of the estimator is found; without them
            it follows from the range and from the encoders.
        on_message: receives a line at each step of the design.

    Raises:
        InputError: no equilibrium under the limits, or one that a network has no records of; an
            input without limits; a mode that does not decay and that the inputs do not move or the
            encoders do not show; a motion whose planning did not converge, or that leaves the range
            of the records; names that the model does not have; disturbances or integrals beside
            predictive control.
    """
    task = _with_limits(task, model, range, on_message)
    bounds = input_limits(model, task.limits)
    if task.mpc is not None and task.observer:
        raise InputError(
            "`observer=`", "not applicable beside `mpc=`", "linear feedback", "leave one out"
        )
    on_message("equilibrium")
    own = _usual_deviations(model, task, bounds)
    weights = bryson_weights(controlled(model, task.delay), bounds, own, range)
    own |= _deviations_of_short_ways(model, task, weights)
    weights = bryson_weights(controlled(model, task.delay), bounds, own, range)
    speeds = weights.usual_speeds(model.channels)
    sizes = None if range is None else range.share_of_spans(0.5, model.channels, np.pi)
    find = partial(find_equilibrium, model, limits=task.limits, speeds=speeds, sizes=sizes)
    point = find(task.at)
    for mode in point.modes:
        if not mode.observable and not mode.is_stable:
            raise InputError(
                "`at=`",
                f"{mode} cannot be observed from the encoders and does not decay",
                "encoders that show it",
                "measure another coordinate, or choose another point",
            )
    if range is not None and not task.trust_beyond:
        _require_recorded(model, point, range)
    sums = {k: v for k, v in task.deviations.items() if k.startswith("integral_")}
    on_message("feedback")
    make_feedback = partial(lqr, model, range=range, delay=task.delay, limits=task.limits)
    feedback = make_feedback(
        point.x, point.u, deviations=own | sums, integral=task.integral, safe=task.safe
    )
    goal = Goal(
        task.at,
        _windows(model, task, range),
        min(Goal.hold, DESIGN.hold * model.dt),
        _position_limits(model, task),
    )
    start, beyond, gains = None, None, feedback
    _require_less_than_a_turn(model, task, feedback.periodic)
    if task.start is not None:
        on_message("motion")
        start = find(task.start)
        options = _planning_options(model, task, point, bounds, range)
        torque = _try_computed_torque(model, task, start, point, feedback, options)
        make_plan = _plan_motion if task.reference is None else _plan_following
        plan = torque.plan if torque else make_plan(model, task, start, point, options)
        beyond = (
            None
            if range is None
            else range.extrapolation_point(model.channels, plan.x[:-1], plan.u)
        )
        if beyond is not None and beyond.signal and not task.trust_beyond:
            low, high = beyond.recorded
            raise InputError(
                "the motion",
                f"after {beyond.sample * model.dt:.3g} s it leaves the range of the "
                f"training records: {beyond.signal} reaches {beyond.value:.4g}",
                f"recorded {low:.4g} to {high:.4g}",
                "record such motions, limit it (`within=`, `limits=`), or add `trust_beyond=`",
            )
        if torque is not None:
            gains, feedback = torque, torque.final
        else:
            # along the plan errors are not integrated; from its end on they are
            final = feedback
            if task.integral:
                final = make_feedback(point.x, point.u, deviations=own)
            settle = None
            if point.is_unstable and not start.is_unstable:
                # only from a start where it comes to rest by itself a motion can begin again
                with suppress(InputError):  # a mode there that the inputs do not move
                    settle = make_feedback(start.x, start.u, deviations=own)
            gains = time_varying_lqr(model, plan, final, deviations=own, range=range, settle=settle)
            gains = replace(gains, final=feedback)
    estimated, mpc = model, None
    if task.mpc is not None:
        on_message("predictive control")
        mpc = Mpc(model, gains, steps=task.mpc, deviations=own, range=range, within=task.within)
    if task.observer:
        estimated = observe_disturbances(model, bounds)
        gains = cancel_disturbances(gains)
    on_message("estimator")
    noise = find_noise(estimated, records) if records else usual_noise(estimated, range)
    consistency = check_filter(estimated, records, noise) if records else None
    loop_margins = margins(model, feedback, None if task.observer else noise)
    return ControlDesign(
        model,
        estimated,
        task,
        own,
        point,
        start,
        gains,
        mpc,
        loop_margins,
        noise,
        consistency,
        goal,
        beyond,
    )


def _with_limits(
    task: ControlTask, model: Model, range: Range | None, on_message: Callable[[str], None]
) -> ControlTask:
    """The task with limits of all inputs, where nothing says them those of the records."""
    limits = recorded_limits(model, task.limits, range)
    if assumed := limits.keys() - (task.limits or {}).keys():
        on_message(f"limits of {', '.join(sorted(assumed))} as recorded, as none are declared")
    return replace(task, limits=limits)


def _require_recorded(model: Model, point: OperatingPoint, range: Range) -> None:
    """Raises unless records have inputs near an equilibrium, for a model that learnt all by them.

    Equations of motion know the effect of inputs elsewhere, too; a network may have its sign wrong.

    Raises:
        InputError: no record has inputs there.
    """
    if range.support is None or equations_in(model) is not None:
        return
    ends = range.inputs.T  # the smallest and the largest of all inputs
    inputs = np.stack([point.u, *(point.u + (ends - point.u) / 2)])
    states = np.tile(point.x, (len(inputs), 1))
    if (range.support.distance(features(model.channels, states, inputs)) > 1).all():
        raise InputError(
            "the equilibrium",
            "no record has such positions at rest, or inputs near them: a model "
            "without equations of motion does not know what inputs do there",
            "records about the equilibrium",
            "record some (a fall from there with inputs will do), "
            "use a grey box or a hybrid, or add `trust_beyond=`",
        )


def _usual_deviations(model: Model, task: ControlTask, bounds: InputLimits) -> dict[str, float]:
    """The deviations of a task without those of integrals; of inputs those that are usual.

    Feedback that uses all of its limits for what is expected leaves nothing for the unexpected.
    """
    usual = DESIGN.input * (bounds.upper - bounds.lower)
    inputs = {i.name: float(d) for i, d in zip(model.channels.inputs, usual, strict=True)}
    own = {k: v for k, v in task.deviations.items() if not k.startswith("integral_")}
    return inputs | own


def _plan_motion(
    model: Model,
    task: ControlTask,
    start: OperatingPoint,
    point: OperatingPoint,
    options: Mapping[str, Any],
) -> Plan:
    """A motion from a start to the equilibrium that is held.

    Raises:
        InputError: no plan arrives; it says what the best one reached.
    """
    channels, best = model.channels, None
    for seconds in _durations(model, task, start, point):
        plan = ilqr(
            model,
            start.x,
            point.x,
            max(1, round(seconds / model.dt)),
            **options,
        )
        if plan.reached:
            return plan
        best = plan if best is None or plan.cost < best.cost else best
    assert best is not None
    reached = ", ".join(
        f"{c.name} = {value:.3g} {c.unit}"
        for c, value in zip(channels.coordinates, best.x[-1][channels.position], strict=True)
    )
    goal = ", ".join(
        f"{c.name} = {value:.3g}"
        for c, value in zip(channels.coordinates, best.goal[channels.position], strict=True)
    )
    end = "does not arrive" if best.converged else "did not converge"
    raise InputError(
        "the motion",
        f"its plan {end}: after {len(best.u) * model.dt:.3g} s it reached {reached}",
        goal,
        "give it more time (`seconds=`), wider limits, or other weights (`weight=`)",
    )


def _try_computed_torque(
    model: Model,
    task: ControlTask,
    start: OperatingPoint,
    point: OperatingPoint,
    feedback: Feedback,
    options: Mapping[str, Any],
) -> Tracking | None:
    """The motion by inverse dynamics; None where it is not possible, or the task asks for others.

    Weights, integrals, delays and observers are those of linear-quadratic feedback, as is what
    predictive control begins with.

    Args:
        model: the model.
        task: the task, with a start.
        start: where it begins.
        point: where it ends.
        feedback: the feedback there.
        options: the limits of a plan, see `_planning_options`.
    """
    is_linear = task.deviations or task.integral or task.delay or task.observer
    if is_linear or task.mpc is not None:
        return None
    channels, names = model.channels, controlled(model).names
    if task.reference is not None:
        references = [_reference_states(model, task.reference, start, point)]
    else:
        ends = start.x[channels.position], point.x[channels.position]
        references = [
            smooth_motion(*ends, max(1, round(seconds / model.dt)), float(model.dt))
            for seconds in _durations(model, task, start, point)
        ]
    for x in references:
        columns = {name: x[:, names.index(name)] for name in options["within"]}
        ends = options["within"].items()
        if all(low <= columns[n].min() and columns[n].max() <= high for n, (low, high) in ends):
            with suppress(InputError):  # not fully driven, or too quick for the limits
                return computed_torque(model, x, feedback, limits=options["limits"])
    return None


def _durations(
    model: Model, task: ControlTask, start: OperatingPoint, point: OperatingPoint
) -> list[float]:
    """Durations of a motion that are tried in turn [s]."""
    if task.seconds is not None:
        return [task.seconds]
    channels = model.channels
    way = np.abs(point.x - start.x)[channels.position]
    moved = [c.name for c, d in zip(channels.coordinates, way, strict=True) if d >= way.max() / 2]
    usual = _usual_duration(start, moved)
    return [usual * factor for factor in DESIGN.longer]


def _planning_options(
    model: Model,
    task: ControlTask,
    point: OperatingPoint,
    bounds: InputLimits,
    range: Range | None,
) -> dict[str, Any]:
    """The arguments that `ilqr` and `follow` share, by name.

    Raises:
        InputError: an input that never changes in the records.
    """
    channels = model.channels
    middle = (bounds.lower + bounds.upper) / 2
    half = DESIGN.planned * (bounds.upper - bounds.lower) / 2
    lower, upper, within = middle - half, middle + half, dict(task.within or {})
    if range is not None and not task.trust_beyond:
        # nobody knows the model beyond what was recorded; what holds the goal is always allowed
        lower = np.maximum(lower, np.minimum(range.inputs[:, 0], point.u))
        upper = np.minimum(upper, np.maximum(range.inputs[:, 1], point.u))
        for i, low, high in zip(channels.inputs, lower, upper, strict=True):
            if low == high:
                raise InputError(
                    "the motion",
                    f"{i.name} never changes in the training records: there is "
                    "nothing to plan with",
                    f"records with {i.name}",
                    "record some, or add `trust_beyond=`",
                )
        speeds = range.states[channels.velocity]
        for c, (slowest, fastest) in zip(channels.coordinates, speeds, strict=True):
            if slowest < 0 < fastest:
                within.setdefault(f"der_{c.name}", (float(slowest), float(fastest)))
    planned = {
        i.name: (float(low), float(high))
        for i, low, high in zip(channels.inputs, lower, upper, strict=True)
    }
    return {
        "goal_inputs": point.u,
        "deviations": _usual_deviations(model, task, bounds),
        "range": range,
        "within": within,
        "limits": planned,
        "delay": task.delay,
    }


def _plan_following(
    model: Model,
    task: ControlTask,
    start: OperatingPoint,
    point: OperatingPoint,
    options: Mapping[str, Any],
) -> Plan:
    """The motion nearest to the reference of a task.

    Raises:
        InputError: a search that did not converge.
    """
    reference = dict(task.reference or {})
    near = {name: DESIGN.followed * float(np.ptp(q)) or WINDOW for name, q in reference.items()}
    x = _reference_states(model, reference, start, point)
    plan = follow(model, x, **{**options, "deviations": near | options["deviations"]})
    if not (plan.converged and plan.reached):
        miss = zip(controlled(model).names, plan.miss.tolist(), strict=True)
        found = (
            f"the plan that follows it ends {', '.join(f'{m:.3g} in {name}' for name, m in miss)} "
            "beside its end"
            if plan.converged
            else f"the plan that follows it did not converge in {plan.iterations} iterations"
        )
        raise InputError(
            "the reference",
            found,
            "a motion that the inputs can do, to a rest that feedback holds",
            "a slower one, or wider limits (`limits=`)",
        )
    return plan


def _reference_states(
    model: Model, reference: Mapping[str, Vector], start: OperatingPoint, point: OperatingPoint
) -> Float[np.ndarray, "samples n_x"]:
    """States along a reference, at rest at its ends; what it does not name stays at the start."""
    channels = model.channels
    names = [c.name for c in channels.coordinates]
    x = np.tile(point.x, (len(next(iter(reference.values()))), 1))
    x[:, channels.position] = start.x[channels.position]
    for name, q in reference.items():
        j = names.index(name)
        x[:, channels.position][:, j] = q
        x[1:-1, channels.velocity][:, j] = np.gradient(q, model.dt)[1:-1]
    return x


def _usual_duration(start: OperatingPoint, moved: Sequence[str]) -> float:
    """A duration by the oscillations about the start of the coordinates that move most [s]."""
    swinging = [m for m in start.modes if m.frequency > 0]
    own = [m for m in swinging if m.states[0] in moved] or swinging
    slowest = max((2 * np.pi / m.frequency for m in own), default=0.0)
    return float(np.clip(DESIGN.swings * slowest, DESIGN.shortest, DESIGN.longest))


def _windows(model: Model, task: ControlTask, range: Range | None) -> dict[str, float]:
    """Distances within which a position counts as held, by name."""
    channels = model.channels
    unknown = np.where(channels.angular, WINDOW, DESIGN.unknown_window)
    windows = unknown if range is None else range.share_of_spans(DESIGN.window, channels, WINDOW)
    windows = np.where(windows > 0, windows, unknown)
    named = {c.name: float(w) for c, w in zip(channels.coordinates, windows, strict=True)}
    # of a short way a share of that
    return {
        n: min(named[n], DESIGN.window * way or np.inf, task.deviations.get(n, np.inf))
        for n, way in _ways(task).items()
    }


def _deviations_of_short_ways(
    model: Model, task: ControlTask, weights: Weights
) -> dict[str, float]:
    """Half of the ways of a motion that are shorter than what is acceptable otherwise, by name."""
    names, ways = [c.name for c in model.channels.coordinates], _ways(task)
    prices = {n: weights.states[names.index(n)] for n in ways if n not in task.deviations}
    return {n: ways[n] / 2 for n in prices if 0 < (ways[n] / 2) ** 2 * prices[n] < 1}


def _require_less_than_a_turn(model: Model, task: ControlTask, periodic: Sequence[int]) -> None:
    """Raises for a free motion of more than a turn of an angle: the nearest turn is held."""
    if task.reference is not None:
        return
    names, ways = [model.channels.coordinates[i].name for i in periodic], _ways(task)
    for name in (n for n in names if ways.get(n, 0.0) > 1.5 * np.pi):
        raise InputError(
            "`to=`",
            f"{name} = {task.at[name]:.4g} rad, {ways[name]:.4g} rad from where the motion begins",
            "less than a turn: the model is alike after each, so feedback holds the nearest one",
            'for a wheel `kind = "linear"` in the data card, or a file of the motion (`follow=`)',
        )


def _ways(task: ControlTask) -> dict[str, float]:
    """The distances of a motion, 0 without one, by the positions that are held after it."""
    return {n: abs(goal - (task.start or {}).get(n, goal)) for n, goal in task.at.items()}


def _position_limits(model: Model, task: ControlTask) -> dict[str, tuple[float, float]]:
    """The limits of positions that end a run where they are left."""
    names = [c.name for c in model.channels.coordinates]
    return {name: pair for name, pair in (task.within or {}).items() if name in names}


def find_rest(
    model: Model, at: Mapping[str, float], limits: Limits | None = None
) -> dict[str, float]:
    """Positions of the stable equilibrium where a swing-up begins: named angles half a turn on.

    Args:
        model: the model.
        at: the positions to swing up to.
        limits: limits of inputs by name.

    Returns:
        The positions by name.

    Raises:
        InputError: no named angle, or no stable equilibrium there.
    """
    channels = model.channels
    angles = [c.name for c in channels.coordinates if c.kind == "angular" and c.name in at]
    for turned in [*[[a] for a in angles], angles]:
        positions = {n: v + np.pi * (n in turned) for n, v in at.items()}
        try:
            point = find_equilibrium(model, positions, limits)
        except InputError:
            continue
        if not point.is_unstable:
            return positions
    raise InputError(
        "`swing_up=`",
        f"no stable equilibrium half a turn from {', '.join(at)}",
        "an angle that hangs at rest there",
        "name the start and the goal: `at=` and `to=`",
    )
