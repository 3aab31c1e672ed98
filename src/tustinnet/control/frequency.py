"""Frequency responses and steps of feedback loops, with bands of what records allow."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from tustinnet.control.dynamics import controlled
from tustinnet.control.lqr import Feedback, loop_matrices, spectral_radius
from tustinnet.control.margins import (
    filter_gain,
    open_loop,
    sensitivity,
    usual_frequencies,
    with_filter,
)
from tustinnet.models.contract import Model
from tustinnet.shown import Brief
from tustinnet.simulate.filtering import FilterNoise


@dataclass(frozen=True, repr=False)
class LoopResponses(Brief):
    """Responses of loops of one feedback: the first is that of the model, then those of others.

    Attributes:
        frequencies: (n_w,) [rad/s].
        loops: gains of the loop that is broken at an input, the others closed,
            (models, n_w, n_u).
        sensitivity: largest singular value of the sensitivity at the inputs, (models, n_w).
        times: (n_t,) [s].
        steps: each coordinate after a step of its own goal by 1, (models, n_t, n_q); not finite
            where the loop is unstable.
    """

    frequencies: Float[np.ndarray, " n_w"]
    loops: Complex[np.ndarray, "models n_w n_u"]
    sensitivity: Float[np.ndarray, "models n_w"]
    times: Float[np.ndarray, " n_t"]
    steps: Float[np.ndarray, "models n_t n_q"]


def loop_responses(
    model: Model,
    feedback: Feedback,
    values: Sequence[Mapping[str, float]] = (),
    noise: FilterNoise | None = None,
) -> LoopResponses:
    """Responses of linear feedback about its operating point; steps with all states known.

    Args:
        model: the model.
        feedback: the feedback.
        values: values of the model's parameters for further loops, as they are drawn from the
            errors of the identification.
        noise: of a filter that is in the loop, as `margins` has it.
    """
    system = controlled(model, feedback.delay)
    point = feedback.x0, feedback.u0, feedback.speeds, feedback.integral
    loops = [loop_matrices(system, *point, each) for each in (None, *values)]
    closed, dt = [a - b @ feedback.gain for a, b in loops], feedback.dt
    slowest = min(spectral_radius(loops[0], feedback.gain), 1 - 1e-9)
    # ten times the time constant of the slowest mode
    seconds = min(5.0, -10.0 * dt / np.log(slowest))
    times, frequencies = dt * np.arange(round(seconds / dt) + 1), usual_frequencies(dt)
    gain = None if noise is None else filter_gain(loops[0], noise)
    if gain is not None:
        pairs = [with_filter(loops[0], feedback, gain, plant) for plant in loops]
        loops, feedback = [loop for loop, _ in pairs], pairs[0][1]
    broken = [[open_loop(loop, feedback, j) for j in range(system.n_u)] for loop in loops]
    return LoopResponses(
        frequencies,
        np.array([[one.at(frequencies)[:, 0, 0] for one in row] for row in broken]).swapaxes(1, 2),
        np.stack([sensitivity(loop, feedback, frequencies) for loop in loops]),
        times,
        np.stack([_steps(one, model.channels.position, len(times)) for one in closed]),
    )


def _steps(
    closed: Float[np.ndarray, "n_z n_z"], position: slice, count: int
) -> Float[np.ndarray, "count n_q"]:
    """Positions after a step of each goal: errors of -1 that go back to 0."""
    z = -np.eye(len(closed))[:, position]
    rows = []
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(count):
            rows.append(1 + np.diag(z[position]))
            z = closed @ z
    return np.stack(rows)
