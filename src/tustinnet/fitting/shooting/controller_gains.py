"""Gains of a controller in the loop, from its set points and what it computed as recorded.

No equation of motion is needed for that. `gain_parameters` takes records and returns the gains as
parameters: those of the data card are fixed, the others are found by least squares, with their
errors as priors of a search.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import GAINS, Input, PDLoop
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.feedback import gain_name
from tustinnet.models.lagrangian import Parameter
from tustinnet.signals.low_pass import low_pass, occupied_band

_RANGE = 3.0  # factor by which a gain may differ from what is found
_HIGHEST = 0.4  # cut-off frequency by the sampling rate, at most
_APART = 3  # periods between a sample and those that it is found by, which have other noise
_LEAST_MOTION = 1e-4  # of the products of deviations, by their squares
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


def gain_parameters(
    records: Sequence[Experiment], *, compares_inputs: bool = False
) -> ControllerGains:
    """Gains of the controller in the loop of records, as parameters of the closed loop.

    The law of the controller is averaged over every period. Its gains are found with instrumental
    variables, deviations from the set points a few samples before and after: noise of encoders in
    the deviations themselves would make gains too small. Samples at a limit do not count.

    Args:
        records: records with the channels of one controller.
        compares_inputs: whether the recorded inputs are compared with those that the motion needs,
            as by inverse dynamics.

    Raises:
        InputError: a gain that cannot be found, or whose sign is wrong.

    References:
        Söderström, Stoica (1983), Instrumental Variable Methods for System Identification.
    """
    controller = records[0].channels.controller
    if controller is None:
        return ControllerGains((), ())
    parameters, listed, shares = [], [], {}
    cutoff = min(max(occupied_band(e.q, e.dt) for e in records), _HIGHEST / records[0].dt)
    inputs = {i.name: i for i in controller.inputs}
    is_recorded = all(e.outputs is not None for e in records)
    for k, loop in enumerate(controller.loops):
        given = {gain: getattr(loop, gain) for gain in GAINS}
        found: dict[str, tuple[float, float]] = {}
        if is_recorded:
            found, shares[loop.input] = _fit_gains(records, k, loop, inputs[loop.input], cutoff)
        coordinate = next(c for c in records[0].coordinates if c.name == loop.coordinate)
        for gain, per in zip(GAINS, ("", " s"), strict=True):
            name = gain_name(loop, gain)
            unit = f"{inputs[loop.input].unit}{per}/{coordinate.unit}"
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
    return ControllerGains(
        tuple(parameters), _remarks(listed, shares, compares_inputs=compares_inputs)
    )


def _remarks(
    listed: Sequence[str], shares: dict[str, float], *, compares_inputs: bool
) -> tuple[str, ...]:
    """Sentences on the gains that were found, and how well the law gives what was recorded."""
    used = "are used for its gains alone" if listed else "are not used in simulations"
    used = "are compared with those that the motion needs" if compares_inputs else used
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
    regressors, instruments, outputs = [], [], []
    for e in records:
        assert e.outputs is not None
        wanted = dict(zip((i.name for i in e.inputs), e.u.T, strict=True))
        zero = np.zeros(len(e))
        j = next(j for j, c in enumerate(e.coordinates) if c.name == loop.coordinate)
        signals = np.stack([
            wanted[loop.position] - e.q[:, j],
            wanted.get(loop.velocity, zero),
            e.outputs[:, k] - wanted.get(loop.feedforward, zero),
        ], axis=1)  # fmt: skip
        # means over both ends of a period: the mean of velocities is there the difference of
        # positions, exactly so under a force that is held
        velocity = np.diff(e.q[:, j]) / e.dt
        if e.v is not None and e.v_measured and e.padded_rows == (0, 0):
            velocity = (e.v[1:, j] + e.v[:-1, j]) / 2
        means = (signals[1:] + signals[:-1]) / 2
        means[:, 1] -= velocity
        x, inside = means[:, :2], slice(_APART, max(_APART, len(means) - _APART))
        is_free = ~_near_limit(e.outputs[:, k], computed)[inside]
        regressors.append(x[inside][is_free])
        instruments.append((x[: -2 * _APART] + x[2 * _APART :])[is_free] / 2)
        outputs.append(means[inside, 2][is_free])
    x, z, y = (np.concatenate(parts) for parts in (regressors, instruments, outputs))
    size = float(np.sqrt(np.mean(y**2))) if len(y) else 0.0
    free = [g for g, gain in enumerate(GAINS) if getattr(loop, gain) is None]
    gains = np.array([getattr(loop, gain) or 0.0 for gain in GAINS])
    found: dict[str, tuple[float, float]] = {}
    where = f"the loop of '{loop.input}' in [controller]"
    if free:
        rest = y - x @ gains
        unit = np.sqrt(np.mean(x[:, free] ** 2, axis=0)) if len(x) else np.zeros(len(free))
        unit = np.where(unit > 0, unit, 1.0)
        scaled, instrument = x[:, free] / unit, z[:, free] / unit
        products = instrument.T @ scaled
        if len(y) <= len(free) or np.linalg.svd(products)[1].min() < _LEAST_MOTION * len(y):
            raise InputError(
                where, f"records from which {' and '.join(GAINS[g] for g in free)} cannot be found",
                "deviations from the set points, within the limits", "give the gains in the card",
            )  # fmt: skip
        inverse = np.linalg.inv(products)
        values = inverse @ (instrument.T @ rest)
        noise = np.sum((rest - scaled @ values) ** 2) / (len(y) - len(free))
        covariance = noise * inverse @ (instrument.T @ instrument) @ inverse.T
        deviations = np.sqrt(np.diag(covariance)) / unit
        gains[free] = values / unit
        for g, deviation in zip(free, deviations.tolist(), strict=True):
            if gains[g] < -_SURE * deviation:
                raise InputError(
                    where, f"{GAINS[g]} is found to be {gains[g]:.4g}", "0 or more",
                    "check the key `sign` of the input and of the coordinate, and the set points",
                )  # fmt: skip
            found[GAINS[g]] = max(float(gains[g]), 0.0), deviation
    # noise of velocities is not the law's
    left = (
        low_pass((y - x @ gains)[:, None], records[0].dt, cutoff)
        if len(y) > 1
        else np.zeros((1, 1))
    )
    return found, float(np.sqrt(np.mean(left**2))) / size if size else 0.0


def _near_limit(output: Float[np.ndarray, " n"], computed: Input) -> Bool[np.ndarray, " periods"]:
    """Mask of the periods at an end of which a recorded input is at a limit of its actuator."""
    if computed.limits is None:
        return np.zeros(len(output) - 1, dtype=bool)
    low, high = computed.limits
    at_limit = (output <= low) | (output >= high)
    return at_limit[1:] | at_limit[:-1]
