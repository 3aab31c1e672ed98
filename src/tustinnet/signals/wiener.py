"""The linear estimate of velocities of least error, from the spectrum of the positions."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from tustinnet.signals.spectra import ABOVE_NOISE, SEGMENT, welch

Response = Callable[[Float[np.ndarray, " f"], float], Float[np.ndarray, " f"]]


def derivative_response(omega: Float[np.ndarray, " f"], dt: float) -> Float[np.ndarray, " f"]:
    """The imaginary part of `v / q` at angular frequencies [rad/s], for the derivative."""
    return omega


def trapezoidal_response(omega: Float[np.ndarray, " f"], dt: float) -> Float[np.ndarray, " f"]:
    """The imaginary part of `v / q` for velocities whose trapezoidal sum is the positions.

    It is `(2/dt) tan(omega dt/2)`.
    """
    return 2 / dt * np.tan(omega * dt / 2)


def wiener_velocities(
    q: Float[np.ndarray, "n n_q"],
    dt: float,
    resolution: Float[np.ndarray, " n_q"] | None = None,
    response: Response = derivative_response,
) -> Float[np.ndarray, "n n_q"]:
    """Velocities by the linear filter over 25 samples whose expected error is smallest.

    The record says how strong the motion is at each frequency, the encoder's count (or else the
    weakest tenth of the frequencies) how strong the noise. Up to the frequencies where the
    motion sinks into the noise the filter differentiates, beyond them it smooths. Finite
    differences err by `(omega dt)^4 / 30`, which is much where a period has few samples. So do
    velocities of a model whose positions follow by the trapezoidal rule, by `(omega dt)^2 / 12`:
    `trapezoidal_response` gives those that such a model means.

    Args:
        q: positions, (n, n_q) [rad or m].
        dt: sampling period [s].
        resolution: encoder counts, (n_q,) [rad or m], 0 or None where there are none.
        response: `v / q` of the velocities to estimate, as a function of angular frequency [rad/s]
            and period.

    Returns:
        (n, n_q) [rad/s or m/s].

    References:
        Wiener (1949), Extrapolation, interpolation, and smoothing of stationary time series.
    """
    counts = np.zeros(q.shape[1]) if resolution is None else resolution
    columns = zip(q.T, counts, strict=True)
    return np.stack([_filter(column, count, dt, response) for column, count in columns], axis=1)


def _filter(
    q: Float[np.ndarray, " n"], count: float, dt: float, response: Response
) -> Float[np.ndarray, " n"]:
    # twelve samples to both sides
    n, reach = len(q), min(12, (len(q) - 1) // 2)
    if not np.ptp(q):  # less its mean, a constant may be rounding errors
        return np.zeros(n)
    centred = q - q.mean()
    frequency, density = welch(centred, dt, min(n, SEGMENT))
    omega = 2 * np.pi * frequency[:-1]
    density = density[:-1]  # the trapezoidal rule has none at the last one, half the rate
    if count:
        floor, motion = count**2 / 12 * 2 * dt, density
    else:
        # of short segments: a single long one scatters as much as it is large, so that its weakest
        # tenth is ten times too weak, and much of the noise is above a multiple of it
        segment = min(max(n // 8, 64), n, SEGMENT)
        coarse_frequency, coarse = welch(centred, dt, segment)
        floor = float(np.quantile(coarse[:-1], 0.1))
        motion = np.interp(frequency[:-1], coarse_frequency, coarse)
    is_motion = motion > ABOVE_NOISE * floor
    power = np.where(is_motion, np.maximum(density - floor, 0.0), 0.0) * frequency[1]
    # solves stay well-posed for exact positions
    noise = max(floor / (2 * dt), 1e-10 * float(np.var(centred)))  # its variance
    lags = np.arange(2 * reach + 1)
    autocovariance = np.cos(np.outer(lags, omega * dt)) @ power
    covariance = autocovariance[np.abs(lags[:, None] - lags)] + noise * np.eye(len(lags))
    # covariance of the velocity at a sample and the position `lag` samples later
    both = np.arange(-2 * reach, 2 * reach + 1)
    cross_covariance = np.sin(np.outer(both, omega * dt)) @ (power * response(omega, dt))
    # each row: the filter for the velocity at that sample of the 2 reach + 1
    velocity_rows = cross_covariance[2 * reach + lags[None] - lags[:, None]]
    filters = np.linalg.solve(covariance, velocity_rows.T).T
    v = np.empty(n)
    v[reach : n - reach] = np.convolve(centred, filters[reach, ::-1], "valid")
    v[:reach] = filters[:reach] @ centred[: 2 * reach + 1]
    v[n - reach :] = filters[reach + 1 :] @ centred[n - 2 * reach - 1 :]
    return v
