"""Margins of a feedback loop: how far it is from being unstable."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Float

from tustinnet.control.dynamics import controlled
from tustinnet.control.lqr import (
    FAST,
    Feedback,
    LoopMatrices,
    loop_matrices,
    loop_without_friction,
    spectral_radius,
)
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.simulate.filtering import FilterNoise

_POLE = -1 / np.sqrt(np.finfo(float).eps)  # responses beyond are those at a pole, but for rounding

Numbers = Float[np.ndarray, " n"]
Matrix = Float[np.ndarray, "n m"]


@dataclass(frozen=True)
class InputMargins:
    """Margins of a loop that is broken at one input, the others closed.

    Attributes:
        input: name of the input.
        gain_up: factor by which the loop gain may grow, inf where nothing bounds it.
        gain_down: factor to which it may fall, 0 where nothing bounds it.
        phase: phase margin [rad], inf where the loop gain never is 1.
        delay: delay that the phase margin allows [s].
        crossover: frequency at which the loop gain is 1 [rad/s], the one with the least phase
            margin; nan where it never is.
    """

    input: str
    gain_up: float
    gain_down: float
    phase: float
    delay: float
    crossover: float


@dataclass(frozen=True)
class Margins:
    """Margins of a feedback loop.

    Attributes:
        inputs: margins of the loop broken at each input.
        sensitivity_peak: the largest singular value of the sensitivity at the inputs over all
            frequencies; 1 / peak is the distance of the loop from the point -1.
        peak_frequency: the frequency of that peak [rad/s].
        slowest: time constant of the closed loop's slowest mode [s].
        has_estimator: whether an estimator is in the loop; else all states are known.
        needs_friction: whether large motions, which dry friction does not damp, would grow.
    """

    inputs: tuple[InputMargins, ...]
    sensitivity_peak: float
    peak_frequency: float
    slowest: float
    has_estimator: bool = False
    needs_friction: bool = False


def margins(model: Model, feedback: Feedback, noise: FilterNoise | None = None) -> Margins:
    """Margins of linear feedback about its operating point.

    The loop is that of model and state feedback, delays and integral action included. Margins are
    the least of two linear models: of usual motions, and of those so large that dry friction does
    not damp them, where feedback is stable for these.

    Args:
        model: the model.
        feedback: the feedback, as `lqr` gives it.
        noise: of a filter of this model, which then is in the loop and makes the margins smaller;
            without it, and where a filter never settles, all states are known.

    Raises:
        InputError: the loop is unstable without limits.
    """
    system = controlled(model, feedback.delay)
    loop, fast = (
        loop_matrices(system, feedback.x0, feedback.u0, k * feedback.speeds, feedback.integral)
        for k in (1.0, FAST)
    )
    largest = spectral_radius(loop, feedback.gain)
    if largest >= 1:
        raise InputError(
            "margins",
            f"the closed loop has an eigenvalue of {largest:.6g}",
            "below 1",
            "design the feedback on this model",
        )
    slowest = -feedback.dt / np.log(largest) if largest else 0.0
    undamped = loop_without_friction(loop, fast)
    is_stable = spectral_radius(undamped, feedback.gain) < 1
    loops = [loop, undamped] if is_stable else [loop]
    gains = [None if noise is None else filter_gain(one, noise) for one in loops]
    wholes = [
        (one, feedback) if gain is None else with_filter(one, feedback, gain)
        for one, gain in zip(loops, gains, strict=True)
    ]
    frequencies = usual_frequencies(feedback.dt)
    inputs = tuple(
        _least([_input_margins(c.name, open_loop(*whole, j), frequencies) for whole in wholes])
        for j, c in enumerate(model.channels.inputs)
    )
    peaks = np.max([sensitivity(*whole, frequencies) for whole in wholes], axis=0)
    highest = int(np.argmax(peaks))
    return Margins(
        inputs,
        float(peaks[highest]),
        float(frequencies[highest]),
        float(slowest),
        has_estimator=all(gain is not None for gain in gains),
        needs_friction=not is_stable,
    )


def _least(of_loops: Sequence[InputMargins]) -> InputMargins:
    """The least margins of one input in several loops."""
    return replace(
        min(of_loops, key=lambda m: m.phase),
        gain_up=min(m.gain_up for m in of_loops),
        gain_down=max(m.gain_down for m in of_loops),
        delay=min(m.delay for m in of_loops),
    )


def filter_gain(loop: LoopMatrices, noise: FilterNoise) -> Matrix | None:
    """The gain of a filter that has settled, from innovations to states, (n_z, n_q).

    It leaves integrals and previous commands as they are. None where a filter never settles.
    """
    n_x, n_q = len(noise.process), len(noise.measured)
    a, shown = loop.a[:n_x, :n_x], np.eye(n_q, n_x)
    measured = np.diag(np.square(noise.measured))
    try:
        p = scipy.linalg.solve_discrete_are(
            a.T, shown.T, np.diag(np.square(noise.process)), measured
        )
    except (np.linalg.LinAlgError, ValueError):
        return None
    gain = np.linalg.solve(shown @ p @ shown.T + measured, shown @ p).T
    return np.concatenate([gain, np.zeros((len(loop.a) - n_x, n_q))])


def with_filter(
    loop: LoopMatrices, feedback: Feedback, gain: Matrix, plant: LoopMatrices | None = None
) -> tuple[LoopMatrices, Feedback]:
    """A loop and its feedback with a filter that has settled, whose estimates are further states.

    Args:
        loop: the model.
        feedback: what acts on the estimates.
        gain: of the filter.
        plant: what it is connected to, where that is not the model.
    """
    a, b = loop
    real = plant or loop
    measured = gain @ np.eye(gain.shape[1], len(a))
    # what is estimated after a measurement, by the states and by what was expected of them
    estimate = np.concatenate([measured, np.eye(len(a)) - measured], axis=1)
    states = np.concatenate([real.a, np.zeros_like(a)], axis=1)
    joint = np.concatenate([states, (a - b @ feedback.gain) @ estimate])
    inputs = np.concatenate([real.b, np.zeros_like(b)])
    return LoopMatrices(joint, inputs), replace(feedback, gain=feedback.gain @ estimate)


def usual_frequencies(dt: float) -> Numbers:
    """Frequencies up to half of the sampling rate at which loops are computed [rad/s]."""
    return np.geomspace(1e-5, 1.0, 2000) * np.pi / dt


def open_loop(loop: LoopMatrices, feedback: Feedback, j: int) -> "Response":
    """The loop that is broken at an input, the others closed."""
    (a, b), gain = loop, feedback.gain
    others = [i for i in range(len(gain)) if i != j]
    return Response(a - b[:, others] @ gain[others], b[:, [j]], gain[[j]], feedback.dt)


def sensitivity(loop: LoopMatrices, feedback: Feedback, frequencies: Numbers) -> Numbers:
    """The largest singular value of the sensitivity at the inputs, (n,).

    `S = (1 + K (z - A)^-1 B)^-1`, from a disturbance at the inputs to the inputs.
    """
    (a, b), gain = loop, feedback.gain
    closed = Response(a - b @ gain, b, gain, feedback.dt).at(frequencies)
    return np.linalg.norm(np.eye(len(gain)) - closed, 2, axis=(1, 2))


class Response(NamedTuple):
    """The frequency response `c (z - a)^-1 b`."""

    a: Matrix
    b: Matrix
    c: Matrix
    dt: float

    def at(self, frequencies: Numbers) -> Complex[np.ndarray, "n n_y n_u"]:
        """Its values at some frequencies, (n, n_y, n_u); inf at a pole."""
        z = np.exp(1j * frequencies * self.dt)[:, None, None]
        try:
            return self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b)
        except np.linalg.LinAlgError:
            return np.full((len(z), len(self.c), self.b.shape[1]), np.inf + 0j)


def _input_margins(name: str, loop: Response, frequencies: Numbers) -> InputMargins:
    """Margins of a loop that is broken at one input, crossings found between frequencies."""

    def respond(w: Numbers) -> Complex[np.ndarray, " n"]:
        return loop.at(w)[:, 0, 0]

    crossings = _find_crossings(lambda w: np.abs(respond(w)) - 1, frequencies)
    phases = np.angle(-respond(crossings))
    # at -180 degrees; the angle also jumps where the response is positive
    turns = _find_crossings(lambda w: np.angle(-respond(w)), frequencies)
    # at both ends the response is real: -180 degrees are reached there, not crossed
    values = [
        *np.real(respond(turns)),
        *(respond(np.array([w]))[0].real for w in (0.0, np.pi / loop.dt)),
    ]
    gains = np.array([-1 / value for value in values if _POLE < value < 0])
    nearest = int(np.argmin(np.abs(phases))) if len(phases) else None
    return InputMargins(
        input=name,
        gain_up=float(min(gains[gains > 1], default=np.inf)),
        gain_down=float(max(gains[gains < 1], default=0.0)),
        phase=np.inf if nearest is None else float(abs(phases[nearest])),
        delay=float(min(phases % (2 * np.pi) / crossings, default=np.inf)),
        crossover=np.nan if nearest is None else float(crossings[nearest]),
    )


def _find_crossings(
    function: Callable[[Numbers], Numbers], at: Numbers
) -> Float[np.ndarray, " crossings"]:
    """The places between some where a function changes its sign."""
    from scipy.optimize import brentq  # takes long to load

    begins = np.flatnonzero(np.diff(np.sign(function(at))))
    found = [brentq(lambda x: function(np.array([x]))[0], at[k], at[k + 1]) for k in begins]
    return np.array(found, float)
