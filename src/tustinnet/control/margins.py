"""Margins of a feedback loop: how far it is from being unstable."""

from dataclasses import dataclass

import numpy as np

from tustinnet.control.dynamics import controlled
from tustinnet.control.lqr import Feedback, loop_matrices
from tustinnet.errors import InputError, require_package
from tustinnet.models.contract import Model

_FREQUENCIES = 2000  # at which the sensitivity is computed


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
        InputError: the package control is not installed, or the loop is unstable without limits.
    """
    require_package("control", "control", "margins")
    from control import StateSpace, frequency_response, stability_margins

    system = controlled(model, feedback.delay)
    a, b = loop_matrices(system, feedback.x0, feedback.u0, feedback.integral)
    gain, dt = feedback.gain, feedback.dt
    largest = np.abs(np.linalg.eigvals(a - b @ gain)).max()
    if largest >= 1:
        raise InputError(
            "margins", f"the closed loop has an eigenvalue of {largest:.6g}", "below 1",
            "design the feedback on this model",
        )  # fmt: skip
    results = []
    for j, channel in enumerate(model.channels.inputs):
        others = [i for i in range(system.n_u) if i != j]
        rest = a - b[:, others] @ gain[others]
        loop = StateSpace(rest, b[:, [j]], gain[[j]], [[0.0]], dt)
        gains, phases, _, _, crossings, _ = stability_margins(loop, returnall=True)
        gains, phases, crossings = (
            np.atleast_1d(gains),
            np.atleast_1d(phases),
            np.atleast_1d(crossings),
        )
        least = int(np.argmin(np.abs(phases))) if len(phases) else None
        phase = np.inf if least is None else float(np.radians(abs(phases[least])))
        crossover = np.nan if least is None else float(crossings[least])
        results.append(
            InputMargins(
                channel.name, float(min(gains[gains > 1], default=np.inf)),
                float(max(gains[(gains < 1) & (gains > 0)], default=0.0)), phase,
                float(min((np.radians(p % 360) / w for p, w in zip(phases, crossings, strict=True)),
                          default=np.inf)),
                crossover,
            )
        )  # fmt: skip
    frequencies = np.geomspace(1e-4, 1.0, _FREQUENCIES) * np.pi / dt
    # S = (1 + K (z - A)^-1 B)^-1, the loop of a disturbance at the inputs
    sensitivity = StateSpace(a - b @ gain, b, -gain, np.eye(system.n_u), dt)
    response = np.moveaxis(
        frequency_response(sensitivity, frequencies, squeeze=False).complex, 2, 0
    )
    peaks = np.linalg.norm(response, 2, axis=(1, 2))
    highest = int(np.argmax(peaks))
    return Margins(tuple(results), float(peaks[highest]), float(frequencies[highest]))
