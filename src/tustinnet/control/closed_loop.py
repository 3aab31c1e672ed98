"""Closed loops in simulation: a plant, an estimator, a controller, and whether the goal is met."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Channels
from tustinnet.control.controller import Controller
from tustinnet.control.estimator import Estimator
from tustinnet.control.sampled_plant import Plant
from tustinnet.errors import InputError
from tustinnet.shown import Brief

Vector = Float[np.ndarray, " _"]
End = Literal["held", "swings", "lost", "never reached", "left its limits", "diverged"]

_SWINGS = 0.05  # of the samples while a goal is held at each limit of an input: it never rests
WINDOW = 0.2  # rad, to both sides of an angle that is to be held


@dataclass(frozen=True)
class Goal:
    """The goal that a controller is to reach and to hold.

    Attributes:
        at: positions by the name of their coordinate [rad or m]; angles count up to whole turns.
        window: how far from them is near enough, by name; 0.2 rad of angles that have none.
        hold: how long they are held at the end of a run [s].
        limits: smallest and largest position of coordinates that must not leave them, by name.
    """

    at: Mapping[str, float]
    window: Mapping[str, float] = field(default_factory=dict)
    hold: float = 5.0
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def check(self, channels: Channels) -> None:
        """Raises unless it is a goal of a system with such coordinates.

        Raises:
            InputError: no position, an unknown coordinate, a linear one without a window, limits
                or durations out of order.
        """
        names = [c.name for c in channels.coordinates]
        for name in (*self.at, *self.window, *self.limits):
            if name not in names:
                raise InputError("goal", f"'{name}'", f"one of {', '.join(names)}")
        if not self.at:
            raise InputError("goal", "no position", f"a position of {' or '.join(names)}")
        linear = [c for c in channels.coordinates if c.kind == "linear" and c.name in self.at]
        for c in linear:
            if c.name not in self.window:
                raise InputError(
                    "goal", f"no window of '{c.name}'", f"how near is near enough [{c.unit}]"
                )
        if not (all(w > 0 for w in self.window.values()) and self.hold > 0):
            raise InputError("goal", "a window or a duration of 0", "positive numbers")
        for name, (low, high) in self.limits.items():
            if not low < high:
                raise InputError("goal", f"limits {low:g}..{high:g} of {name}", "lower first")

    def errors(self, channels: Channels, q: Float[np.ndarray, "n n_q"]) -> dict[str, Vector]:
        """Distances from the positions that are to be held, angles wrapped, by name, (n,)."""
        errors = {}
        for j, c in enumerate(channels.coordinates):
            if c.name in self.at:
                error = q[:, j] - self.at[c.name]
                if c.kind == "angular":
                    error = (error + np.pi) % (2 * np.pi) - np.pi
                errors[c.name] = np.abs(error)
        return errors

    def is_near(self, errors: Mapping[str, Vector]) -> Bool[np.ndarray, " n"]:
        """Whether all distances are within their windows, (n,)."""
        return np.all([e <= self.window.get(name, WINDOW) for name, e in errors.items()], axis=0)

    def outside(self, channels: Channels, q: Vector) -> str:
        """The first coordinate that is beyond its limits, "" for none."""
        for j, c in enumerate(channels.coordinates):
            if c.name in self.limits:
                low, high = self.limits[c.name]
                if not low <= q[j] <= high:
                    return c.name
        return ""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a closed loop: whether its goal is met.

    Attributes:
        end: `held` where it was met; else why not, in a word.
        sentence: what happened, where and when.
        worst: largest distance from each position during the last seconds, by coordinate [rad or
            m]; of a run that ended early, at its end.
        energy: sum of the squared inputs times the period [squares of their units, s].
        time_to_reach: from when on it was held to the end [s], None where it was not.
        saturated: share of the samples at which an input was at its limit.
    """

    end: End
    sentence: str
    worst: Mapping[str, float]
    energy: float
    time_to_reach: float | None
    saturated: float

    @property
    def is_success(self) -> bool:
        """Whether the goal was held for as long as it was to be."""
        return self.end == "held"


@dataclass(frozen=True, repr=False)
class ClosedLoopResult(Brief):
    """A run of a closed loop; shorter than it was to be where it diverged or left its limits.

    Attributes:
        dt: sampling period [s].
        states: true states at all samples, (n + 1, n_x of the plant).
        measurements: what the encoders read, (n + 1, n_q).
        estimates: what the estimator made of that, (n + 1, n_x of the model).
        inputs: what the controller commanded from each sample to the next, (n, n_u).
        outcome: what became of the goal, None where there was none.
    """

    dt: float
    states: Float[np.ndarray, "samples n_x"]
    measurements: Float[np.ndarray, "samples n_q"]
    estimates: Float[np.ndarray, "samples n_e"]
    inputs: Float[np.ndarray, "steps n_u"]
    outcome: Outcome | None

    @property
    def is_success(self) -> bool:
        """Whether a goal was met."""
        return self.outcome is not None and self.outcome.is_success


def closed_loop(
    plant: Plant,
    controller: Controller,
    estimator: Estimator,
    steps: int,
    start: Vector,
    seed: int = 0,
    goal: Goal | None = None,
    channels: Channels | None = None,
) -> ClosedLoopResult:
    """Runs a controller on a plant, by what an estimator makes of the encoders.

    At each sample the encoders are read, the state is estimated, and the inputs until the next
    sample are computed. That takes no time; a delay belongs to the plant (`PlantOptions.delay`).

    Args:
        plant: the plant.
        controller: the controller.
        estimator: the estimator.
        steps: how many periods; more where a goal is reached so late that it could not be held.
        start: positions at the start, where the plant is at rest, (n_q,).
        seed: of all that is random in the plant.
        goal: what is to be reached, None for nothing.
        channels: the plant's coordinates, where it does not have them itself.

    Returns:
        The states, measurements, estimates and inputs, and whether the goal was met.

    Raises:
        InputError: fewer than one step, or a goal of other coordinates.
    """
    if steps < 1:
        raise InputError("closed_loop", f"{steps} steps", "one or more")
    channels = channels or getattr(plant, "channels", None)
    if goal is not None:
        if channels is None:
            raise InputError("closed_loop", "a goal, and a plant without channels", "its channels")
        goal.check(channels)
    plant.reset(np.asarray(start, np.float64), seed)
    controller.reset()
    y = plant.measure()
    x = estimator.reset(y)
    states, measurements, estimates = [plant.state], [y], [x]
    inputs: list[Vector] = []
    outside, k = "", 0
    while k < steps or _is_held_too_short(goal, channels, states, plant.dt):
        u = controller.inputs(k, x)
        plant.apply(u)
        y = plant.measure()
        inputs.append(np.array(u, np.float64))
        states.append(plant.state)
        is_finite = math.isfinite(plant.state.sum())
        if is_finite:
            x = estimator.update(y, u)
        measurements.append(y)
        estimates.append(x)
        if not is_finite:
            break
        if goal is not None and goal.limits and channels is not None:
            outside = goal.outside(channels, plant.state)
            if outside:
                break
        k += 1
    arrays = map(np.stack, (states, measurements, estimates, inputs))
    result = ClosedLoopResult(plant.dt, *arrays, outcome=None)
    if goal is None or channels is None:
        return result
    return replace(result, outcome=_judge(goal, channels, result, outside))


def _held_samples(goal: Goal, dt: float) -> int:
    """The samples for which a goal is to be held."""
    return max(1, round(goal.hold / dt))


def _is_held_too_short(
    goal: Goal | None, channels: Channels | None, states: Sequence[Vector], dt: float
) -> bool:
    """Whether a run ends near its goal, and was not there for as long as it is to be."""
    if goal is None or channels is None:
        return False
    needed = _held_samples(goal, dt) + 1
    q = np.stack(states[1:][-needed:])[:, channels.position]
    near = goal.is_near(goal.errors(channels, q))
    return bool(near[-1]) and not (len(near) == needed and near.all())


def _judge(goal: Goal, channels: Channels, result: ClosedLoopResult, outside: str) -> Outcome:
    """The outcome of a run for a goal."""
    q, dt = result.states[:, channels.position], result.dt
    end = (len(q) - 1) * dt
    is_finite = math.isfinite(result.states[-1].sum())
    errors = goal.errors(channels, q)
    near = goal.is_near(errors)
    last = _held_samples(goal, dt)
    since = len(near) - int(np.argmin(near[::-1])) if not near.all() else 0
    is_held = len(near) - since > last
    # a swing passes the window in less than half a second
    reached = _first_stay(near, max(1, round(min(0.5, goal.hold) / dt)))
    held: float | None = None
    kind: End
    if not is_finite:
        kind, sentence = "diverged", f"diverged at {end:.2f} s"
    elif outside:
        low, high = goal.limits[outside]
        kind, sentence = "left its limits", f"{outside} left {low:g}..{high:g} at {end:.2f} s"
    elif is_held and _swings(result.inputs, last):
        kind = "swings"
        sentence = f"near from {since * dt:.2f} s on, and inputs swing between limits"
    elif is_held:
        kind, sentence, held = "held", f"held from {since * dt:.2f} s on", since * dt
    elif reached is not None:
        lost = reached + int(np.argmin(near[reached:]))
        kind = "lost"
        sentence = f"reached at {reached * dt:.2f} s and lost at {lost * dt:.2f} s"
    else:
        closest = ", ".join(f"{name} came to {e.min():.2g}" for name, e in errors.items())
        kind, sentence = "never reached", f"never reached: {closest} from where it is to be"
    ended_early = kind in ("diverged", "left its limits")
    worst = {n: float(e[-1] if ended_early else e[-last:].max()) for n, e in errors.items()}
    saturated = _saturated(result.inputs)
    if kind != "held" and saturated > 0.2:
        sentence += f", inputs at their limits {100 * saturated:.0f} % of the time"
    with np.errstate(over="ignore"):
        energy = float(np.sum(result.inputs**2) * dt)
    return Outcome(
        end=kind,
        sentence=sentence,
        worst=worst,
        energy=energy,
        time_to_reach=held,
        saturated=saturated,
    )


def _first_stay(near: Bool[np.ndarray, " n"], length: int) -> int | None:
    """The first sample from which so many in a row are near."""
    totals = np.cumsum(np.r_[0, near])
    stays = np.flatnonzero(totals[length:] - totals[:-length] == length)
    return int(stays[0]) if len(stays) else None


def _swings(u: Float[np.ndarray, "n n_u"], last: int) -> bool:
    """Whether an input jumps between its limits to the end, as of a loop that never rests.

    Args:
        u: the inputs of a run.
        last: samples at its end.
    """
    shares = np.mean(_at_extremes(u)[:, -last:], axis=1)
    return bool((shares.min(axis=0) > _SWINGS).any())


def _saturated(u: Float[np.ndarray, "n n_u"]) -> float:
    """The share of samples at which an input has an extreme value that it has more than once.

    What is limited repeats its limit to the last digit, which no feedback does by chance.
    """
    at_extremes = _at_extremes(u)
    is_repeated = at_extremes.sum(axis=1, keepdims=True) > 1
    return float((at_extremes & is_repeated).any(axis=(0, 2)).mean())


def _at_extremes(u: Float[np.ndarray, "n n_u"]) -> Bool[np.ndarray, "2 n n_u"]:
    """Samples at which inputs have their least and their largest value, if these differ."""
    ends = np.stack([u.min(axis=0), u.max(axis=0)])
    return (u == ends[:, None]) & (np.ptp(u, axis=0) > 0)
