"""Gains of a controller in the loop, from its set points and what it computed as recorded.

No equation of motion is needed for that. `gain_parameters` takes records and returns the gains as
parameters: those of the data card are fixed, the others are found by least squares, with their
errors as priors of a search.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Input, PDLoop
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.feedback import GAINS, gain_name
from tustinnet.models.lagrangian import Parameter
from tustinnet.signals.low_pass import low_pass

_RANGE = 3.0  # factor by which a gain may differ from what is found
_SAMPLES = 2.5  # that count as independent for each period of the cut-off frequency
_SURE = 3.0  # standard errors below 0 from which on a gain has the wrong sign
_LEAST_ERROR = 1e-3  # of a gain, relative: what a derived velocity may add
_OTHER_LAW = 0.3  # share of the recorded input that another controller than the card's would leave


@dataclass(frozen=True)
class ControllerGains:
    """Gains of a controller as parameters, and what is to be said of them.

    Attributes:
        parameters: `COORDINATE.kp` and `COORDINATE.kd` of each loop.
        remarks: sentences.
    """

    parameters: tuple[Parameter, ...]
    remarks: tuple[str, ...]


def gain_parameters(records: Sequence[Experiment], cutoff: float) -> ControllerGains:
    """Gains of the controller in the loop of records, as parameters of the closed loop.

    Set points, positions and recorded inputs are filtered alike, so the law of the controller holds
    between them; what is faster than the motion, and samples at a limit, do not count.

    Args:
        records: records with the channels of one controller.
        cutoff: frequency up to which signals are compared [Hz].

    Raises:
        InputError: a gain that cannot be found, or whose sign is wrong.
    """
    controller = records[0].channels.controller
    if controller is None:
        return ControllerGains((), ())
    parameters, listed, shares = [], [], {}
    inputs = {i.name: i for i in controller.inputs}
    is_recorded = all(e.outputs is not None for e in records)
    for k, loop in enumerate(controller.loops):
        given = {gain: getattr(loop, gain) for gain in GAINS}
        found: dict[str, tuple[float, float]] = {}
        if is_recorded:
            found, shares[loop.input] = _fit_gains(records, k, loop, inputs[loop.input], cutoff)
        coordinate = next(c for c in records[0].coordinates if c.name == loop.coordinate)
        for gain, unit in zip(GAINS, (coordinate.unit, f"{coordinate.unit}/s"), strict=True):
            name, unit = gain_name(loop, gain), f"{inputs[loop.input].unit}/({unit})"
            if gain not in found:
                value = given[gain]
                assert value is not None  # the data card requires it where nothing was recorded
                parameters.append(Parameter(name, unit, value, value, value, fixed=True))
                continue
            value, error = found[gain]
            if value <= 0:
                parameters.append(Parameter(name, unit, 0.0, 0.0, 0.0, fixed=True))
            else:
                error = max(error, _LEAST_ERROR * value)
                parameters.append(
                    Parameter(name, unit, value, value / _RANGE, value * _RANGE, prior=error)
                )
            listed.append(f"{name} {value:.4g} ± {error:.1g} {unit}")
    return ControllerGains(tuple(parameters), _remarks(listed, shares, list(inputs)))


def _remarks(
    listed: Sequence[str], shares: dict[str, float], inputs: Sequence[str]
) -> tuple[str, ...]:
    """Sentences on the gains that were found, and how well the law gives what was recorded."""
    used = "are used for its gains alone" if listed else "are not used in simulations"
    computed = ", ".join(shares)
    remarks = [
        "the controller of the data card is in the loop: set points drive the simulations"
        + (f", the recorded inputs ({computed}) {used}" if computed else "")
    ]
    if listed:
        remarks.append(f"gains of the controller, by the recorded inputs: {', '.join(listed)}")
    if shares:
        low, high = min(shares.values()), max(shares.values())
        spread = f"{100 * high:.2g}" if len(shares) == 1 else f"{100 * low:.2g} to {100 * high:.2g}"
        remarks.append(f"the controller's law leaves {spread} % of the recorded inputs unexplained")
    if other := [name for name, share in shares.items() if share > _OTHER_LAW]:
        remarks.append(
            f"the controller computed {', '.join(other)} otherwise than the data card says; check "
            "its set points, their units, its gains, and whether a feed-forward is missing"
        )
    return tuple(remarks)


def _fit_gains(
    records: Sequence[Experiment], k: int, loop: PDLoop, computed: Input, cutoff: float
) -> tuple[dict[str, tuple[float, float]], float]:
    """The gains of a loop that are not given, each with its standard error.

    Returns:
        The gains, and the share of the recorded input that the law leaves.
    """
    errors, outputs = [], []
    for e in records:
        columns, wanted = [], dict(zip((i.name for i in e.inputs), e.u.T, strict=True))
        j = next(j for j, c in enumerate(e.coordinates) if c.name == loop.coordinate)
        assert e.outputs is not None
        output = e.outputs[:, k] - wanted.get(loop.feedforward, 0.0)
        if e.v is not None and e.v_measured and e.padded_rows == (0, 0):
            velocity = low_pass(e.v[:, j : j + 1], e.dt, cutoff)
        else:
            q = e.q[:, j : j + 1]
            velocity = low_pass(q, e.dt, cutoff, 1)
            if computed.hold in (None, "zero-order", "unknown"):
                # under a force that is held over a period, velocities at the samples are
                # tan(wT/2) / (T/2) = w (1 + (wT)^2 / 12) times the positions, not w times
                velocity -= e.dt**2 / 12 * low_pass(q, e.dt, cutoff, 3)
        target = np.stack([wanted.get(loop.velocity, np.zeros(len(e)))], axis=1)
        filtered = low_pass(
            np.stack([wanted[loop.position] - e.q[:, j], output], axis=1), e.dt, cutoff
        )
        columns = [filtered[:, 0], (low_pass(target, e.dt, cutoff) - velocity)[:, 0]]
        edge, step = (max(1, round(n / (cutoff * e.dt))) for n in (1, 1 / _SAMPLES))
        places = np.arange(edge, len(e) - edge, step)
        places = places[~_near_limit(e.outputs[:, k], computed, edge)[places]]
        errors.append(np.stack(columns, axis=1)[places])
        outputs.append(filtered[places, 1])
    x, y = np.concatenate(errors), np.concatenate(outputs)
    size = float(np.sqrt(np.mean(y**2))) if len(y) else 0.0
    free = [g for g, gain in enumerate(GAINS) if getattr(loop, gain) is None]
    gains = np.array([getattr(loop, gain) or 0.0 for gain in GAINS])
    where = f"the loop of '{loop.input}' in [controller]"
    deviations = np.zeros(len(free))
    if free:
        unit = np.sqrt(np.mean(x[:, free] ** 2, axis=0)) if len(x) else np.zeros(len(free))
        scaled = x[:, free] / np.where(unit > 0, unit, 1.0)
        rest = y - x @ gains
        values, _, rank, _ = np.linalg.lstsq(scaled, rest, rcond=1e-6)
        if rank < len(free) or len(y) <= len(free):
            raise InputError(
                where, f"records from which {' and '.join(GAINS[g] for g in free)} cannot be found",
                "deviations from the set points, within the limits", "give the gains in the card",
            )  # fmt: skip
        noise = np.sum((rest - scaled @ values) ** 2) / (len(y) - len(free))
        deviations = np.sqrt(noise * np.diag(np.linalg.inv(scaled.T @ scaled))) / unit
        gains[free] = values / unit
        for g, deviation in zip(free, deviations, strict=True):
            if gains[g] < -_SURE * deviation:
                raise InputError(
                    where, f"{GAINS[g]} is found to be {gains[g]:.4g}", "0 or more",
                    "check the key `sign` of the input and of the coordinate, and the set points",
                )  # fmt: skip
    share = float(np.sqrt(np.mean((y - x @ gains) ** 2))) / size if size else 0.0
    found = zip(free, deviations.tolist(), strict=True)
    return {GAINS[g]: (max(float(gains[g]), 0.0), error) for g, error in found}, share


def _near_limit(
    output: Float[np.ndarray, " n"], computed: Input, reach: int
) -> Bool[np.ndarray, " n"]:
    """Mask of samples near which a recorded input is at a limit of its actuator."""
    if computed.limits is None:
        return np.zeros(len(output), dtype=bool)
    low, high = computed.limits
    at_limit = (output <= low) | (output >= high)
    return np.convolve(at_limit, np.ones(2 * reach + 1), "same") > 0
