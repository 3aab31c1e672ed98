"""Margins of a feedback loop: how far it is from being unstable."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tustinnet.control.dynamics import controlled
from tustinnet.control.lqr import Feedback, loop_matrices
from tustinnet.errors import InputError
from tustinnet.models.contract import Model

# frequencies at which loops are computed, and the lowest as a share of half of the sampling rate
_FREQUENCIES, _LOWEST = 2000, 1e-5


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
    """

    inputs: tuple[InputMargins, ...]
    sensitivity_peak: float
    peak_frequency: float


def margins(model: Model, feedback: Feedback) -> Margins:
    """Margins of linear feedback about its operating point, computed by python-control.

    The loop is that of model and state feedback, delays and integral action included. An estimator
    in the loop makes them smaller.

    Args:
        model: the model.
        feedback: the feedback, as `lqr` gives it.

    Raises:
        InputError: the loop is unstable without limits.
    """
    from control import FrequencyResponseData, StateSpace, frequency_response, stability_margins

    system = controlled(model, feedback.delay)
    a, b = loop_matrices(system, feedback.x0, feedback.u0, feedback.speeds, feedback.integral)
    gain, dt = feedback.gain, feedback.dt
    largest = np.abs(np.linalg.eigvals(a - b @ gain)).max()
    if largest >= 1:
        raise InputError(
            "margins",
            f"the closed loop has an eigenvalue of {largest:.6g}",
            "below 1",
            "design the feedback on this model",
        )
    frequencies = np.geomspace(_LOWEST, 1.0, _FREQUENCIES) * np.pi / dt
    results = []
    for j, channel in enumerate(model.channels.inputs):
        others = [i for i in range(system.n_u) if i != j]
        rest = a - b[:, others] @ gain[others]
        loop = StateSpace(rest, b[:, [j]], gain[[j]], [[0.0]], dt)
        # by the response: by polynomials, rounding makes crossings that there are none
        response = FrequencyResponseData(loop, frequencies, smooth=True)
        gains, phases, _, _, crossings, _ = map(
            np.atleast_1d, stability_margins(response, returnall=True)
        )
        # at both ends the response is real: -180 degrees are reached there, not crossed
        ends = [float(np.real(loop(z, warn_infinite=False))) for z in (1.0, -1.0)]
        gains = np.concatenate([gains, [-1 / end for end in ends if -np.inf < end < 0]])
        nearest = int(np.argmin(np.abs(phases))) if len(phases) else None
        lags = np.radians(phases % 360) / crossings
        results.append(
            InputMargins(
                input=channel.name,
                gain_up=float(min(gains[gains > 1], default=np.inf)),
                gain_down=float(max(gains[gains < 1], default=0.0)),
                phase=np.inf if nearest is None else float(np.radians(abs(phases[nearest]))),
                delay=float(min(lags, default=np.inf)),
                crossover=np.nan if nearest is None else float(crossings[nearest]),
            )
        )
    # S = (1 + K (z - A)^-1 B)^-1, from a disturbance at the inputs to the inputs
    sensitivity = StateSpace(a - b @ gain, b, -gain, np.eye(system.n_u), dt)
    responses: Any = frequency_response(sensitivity, frequencies, squeeze=False)
    response = responses.complex
    peaks = np.linalg.norm(np.moveaxis(response, 2, 0), 2, axis=(1, 2))
    highest = int(np.argmax(peaks))
    return Margins(tuple(results), float(peaks[highest]), float(frequencies[highest]))
