"""Gains of a controller in the loop, from its set points and what it computed as recorded.

No equation of motion is needed for that. `gain_parameters` takes records and returns the gains as
parameters: those of the data card are fixed, the others are found by least squares, with their
errors as priors of a search.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Input, PDLoop
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.finding import Finding, make_finding
from tustinnet.models.feedback import gain_name
from tustinnet.models.lagrangian import Parameter
from tustinnet.signals.low_pass import HIGHEST_CUTOFF, low_pass, occupied_band

_PER = {"kp": "", "kd": " s", "ki": "/s"}  # unit of a gain: the input's, this, by the coordinate's


class GainSettings(NamedTuple):
    """Settings of the estimate of a controller's gains.

    All are set by hand, not measured.

    Attributes:
        factor: factor by which a gain may differ from its estimate.
        apart: periods between a sample and its instruments, whose noise is another.
        least_motion: products of deviations by their squares, below which no gain is found.
        sure: standard errors below 0, from which on a gain has the wrong sign.
        least_error: relative standard error of a gain, at least: what a derived velocity
            may add.
        other_law: share of the recorded input that is missing where another controller
            acted.
    """

    factor: float = 3.0
    apart: int = 3
    least_motion: float = 1e-4
    sure: float = 3.0
    least_error: float = 1e-3
    other_law: float = 0.3


GAINS = GainSettings()


@dataclass(frozen=True)
class ControllerGains:
    """Gains of a controller as parameters, and what is to be said of them.

    Attributes:
        parameters: `COORDINATE.kp` and `COORDINATE.kd` of each loop, and `COORDINATE.ki` where it
            has an integral.
        remarks: what is to be said.
    """

    parameters: tuple[Parameter, ...]
    remarks: tuple[Finding, ...]


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
    cutoff = min(max(occupied_band(e.q, e.dt) for e in records), HIGHEST_CUTOFF / records[0].dt)
    inputs = {i.name: i for i in controller.inputs}
    is_recorded = all(e.outputs is not None for e in records)
    for k, loop in enumerate(controller.loops):
        given = {gain: getattr(loop, gain) for gain in loop.gains}
        fitted: dict[str, tuple[float, float]] = {}
        if is_recorded:
            fitted, shares[loop.input] = _fit_gains(records, k, loop, inputs[loop.input], cutoff)
        coordinate = next(c for c in records[0].coordinates if c.name == loop.coordinate)
        for gain in loop.gains:
            name = gain_name(loop, gain)
            unit = f"{inputs[loop.input].unit}{_PER[gain]}/{coordinate.unit}"
            if gain not in fitted:
                value = given[gain]
                assert value is not None  # the data card requires it where nothing was recorded
                parameters.append(Parameter(name, unit, value, value, value, fixed=True))
                continue
            value, error = fitted[gain]
            if value <= 0:
                parameters.append(Parameter(name, unit, 0.0, 0.0, 0.0, fixed=True))
            else:
                error = max(error, GAINS.least_error * value)
                parameters.append(
                    Parameter(
                        name, unit, value, value / GAINS.factor, value * GAINS.factor, prior=error
                    )
                )
            listed.append(
                make_finding("controller gain", gain=name, value=value, error=error, unit=unit)
            )
    return ControllerGains(
        tuple(parameters), _remarks(listed, shares, compares_inputs=compares_inputs)
    )


def _remarks(
    listed: Sequence[Finding], shares: dict[str, float], *, compares_inputs: bool
) -> tuple[Finding, ...]:
    """The gains that were found, and how well the law gives what was recorded."""
    used = "are used for its gains alone" if listed else "are not used in simulations"
    used = "are compared with those that the motion needs" if compares_inputs else used
    remarks = [make_finding("controller in loop", inputs=[*shares], used=used)]
    if listed:
        remarks.append(make_finding("controller gains", gains=listed))
    if shares:
        low, high = min(shares.values()), max(shares.values())
        low = low if len(shares) > 1 else None
        remarks.append(make_finding("controller unexplained", low=low, high=high))
    if other := [name for name, share in shares.items() if share > GAINS.other_law]:
        remarks.append(make_finding("controller other law", inputs=other))
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
        x, y, is_free = _law_along(e, k, loop, computed)
        inside = slice(GAINS.apart, max(GAINS.apart, len(x) - GAINS.apart))
        own = x[inside], (x[: -2 * GAINS.apart] + x[2 * GAINS.apart :]) / 2, y[inside, None]
        own = [part[is_free[inside]] for part in own]
        if "ki" in loop.gains:  # nobody knows where the integral of a record begins
            own = [part - part.mean(axis=0) if len(part) else part for part in own]
        for parts, part in zip((regressors, instruments, outputs), own, strict=True):
            parts.append(part)
    x, z, y = (np.concatenate(parts) for parts in (regressors, instruments, outputs))
    y = y[:, 0]
    size = float(np.sqrt(np.mean(y**2))) if len(y) else 0.0
    free = [g for g, gain in enumerate(loop.gains) if getattr(loop, gain) is None]
    gains = np.array([getattr(loop, gain) or 0.0 for gain in loop.gains])
    fitted: dict[str, tuple[float, float]] = {}
    where = f"the loop of '{loop.input}' in [controller]"
    if free:
        rest = y - x @ gains
        unit = np.sqrt(np.mean(x[:, free] ** 2, axis=0)) if len(x) else np.zeros(len(free))
        unit = np.where(unit > 0, unit, 1.0)
        scaled, instrument = x[:, free] / unit, z[:, free] / unit
        products = instrument.T @ scaled
        if len(y) <= len(free) or np.linalg.svd(products)[1].min() < GAINS.least_motion * len(y):
            names = " and ".join(loop.gains[g] for g in free)
            raise InputError(
                where,
                f"records from which {names} cannot be found",
                "deviations from the set points, within the limits",
                "give the gains in the card",
            )
        inverse = np.linalg.inv(products)
        values = inverse @ (instrument.T @ rest)
        noise = np.sum((rest - scaled @ values) ** 2) / (len(y) - len(free))
        covariance = noise * inverse @ (instrument.T @ instrument) @ inverse.T
        deviations = np.sqrt(np.diag(covariance)) / unit
        gains[free] = values / unit
        for g, deviation in zip(free, deviations.tolist(), strict=True):
            if gains[g] < -GAINS.sure * deviation:
                raise InputError(
                    where,
                    f"{loop.gains[g]} is found to be {gains[g]:.4g}",
                    "0 or more",
                    "check the key `sign` of the input and of the coordinate, and the set points",
                )
            fitted[loop.gains[g]] = max(float(gains[g]), 0.0), deviation
    # noise of velocities is not the law's
    residual = (
        low_pass((y - x @ gains)[:, None], records[0].dt, cutoff)
        if len(y) > 1
        else np.zeros((1, 1))
    )
    return fitted, float(np.sqrt(np.mean(residual**2))) / size if size else 0.0


def _law_along(
    e: Experiment, k: int, loop: PDLoop, computed: Input
) -> tuple[
    Float[np.ndarray, "periods gains"], Float[np.ndarray, " periods"], Bool[np.ndarray, " periods"]
]:
    """The law of a loop along a record, averaged over every period.

    Returns:
        What each gain multiplies, what the products have to add up to, and a mask of the periods
        in which no limit acts.
    """
    assert e.outputs is not None
    set_points = dict(zip((i.name for i in e.inputs), e.u.T, strict=True))
    n, zero = len(e) - loop.delay, np.zeros(len(e))  # what was computed acts later
    j = next(j for j, c in enumerate(e.coordinates) if c.name == loop.coordinate)
    error, output = set_points[loop.position] - e.q[:, j], e.outputs[loop.delay :, k]
    rate, extra = (set_points.get(name, zero)[:n] for name in (loop.velocity, loop.feedforward))
    signals = np.stack([error[:n], rate, output - extra], axis=1)
    # means over both ends of a period: the mean of velocities is there the difference of
    # positions, exactly so under a force that is held
    velocity = np.diff(e.q[:, j]) / e.dt
    if (speeds := e.sensor_velocities) is not None:
        velocity = (speeds[1:, j] + speeds[:-1, j]) / 2
    if loop.velocity_filter:
        import scipy.signal  # takes a second, and few controllers filter

        share = -np.expm1(-e.dt / loop.velocity_filter)
        velocity = scipy.signal.lfilter(
            [share], [1.0, share - 1.0], velocity, zi=[(1.0 - share) * velocity[0]]
        )[0]
    means = (signals[1:] + signals[:-1]) / 2
    means[:, 1] -= velocity[: n - 1]
    columns = [means[:, 0], means[:, 1]]
    if "ki" in loop.gains:
        integral = np.concatenate([[0.0], np.cumsum(_growing(error[:n], output, computed))[:-1]])
        columns.append(e.dt * (integral[1:] + integral[:-1]) / 2)
    return np.stack(columns, axis=1), means[:, 2], ~_near_limit(output, computed)


def _growing(
    error: Float[np.ndarray, " n"], output: Float[np.ndarray, " n"], computed: Input
) -> Float[np.ndarray, " n"]:
    """Deviations by which an integral grows: 0 where they would push an input beyond its limit."""
    if computed.limits is None:
        return error
    low, high = computed.limits
    return np.where((output >= high) & (error > 0) | (output <= low) & (error < 0), 0.0, error)


def _near_limit(output: Float[np.ndarray, " n"], computed: Input) -> Bool[np.ndarray, " periods"]:
    """Mask of the periods at an end of which a recorded input is at a limit of its actuator."""
    if computed.limits is None:
        return np.zeros(len(output) - 1, dtype=bool)
    low, high = computed.limits
    at_limit = (output <= low) | (output >= high)
    return at_limit[1:] | at_limit[:-1]
