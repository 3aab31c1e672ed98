"""Velocities from positions: stencil, Savitzky-Golay, Kalman (RTS) smoother, Wiener filters."""

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.signals.smoother import kalman_smoother
from tustinnet.signals.transients import is_moving
from tustinnet.signals.wiener import trapezoidal_response, wiener_velocities
from tustinnet.wording import counted

VelocityMethod = Literal["stencil", "savgol", "kalman", "wiener", "trapezoidal"]
Positions = Float[np.ndarray, "n n_q"]

_STENCIL = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12.0


def differentiate(
    q: Positions,
    dt: float,
    method: VelocityMethod = "stencil",
    resolution: Float[np.ndarray, " n_q"] | None = None,
) -> Positions:
    """Velocities of sampled positions.

    Args:
        q: positions, unwrapped, (n, n_q) [rad or m].
        dt: sampling period [s].
        method: `stencil` (five-point stencil), `savgol` (cubic Savitzky-Golay over 7 samples),
            `kalman` (Rauch-Tung-Striebel smoother that knows the encoder's count), `wiener` (the
            filter of smallest error, from the record's spectrum) or `trapezoidal` (that filter for
            velocities whose trapezoidal sum is the positions, as those of a Tustin-Net are).
        resolution: encoder count per coordinate, (n_q,) [rad or m]; `kalman` needs it.

    Returns:
        Velocities, (n, n_q) [rad/s or m/s]; exactly 0 for a coordinate that never moves.

    Raises:
        InputError: an unknown method, fewer than 5 samples, or no resolution for `kalman`.
    """
    if method not in get_args(VelocityMethod):
        raise InputError(
            "velocity", f"unknown method '{method}'", ", ".join(get_args(VelocityMethod))
        )
    if len(q) < len(_STENCIL):
        raise InputError("velocity", counted(len(q), "sample"), f"at least {len(_STENCIL)}")
    if method == "kalman":
        if resolution is None or not np.all(resolution > 0):
            raise InputError(
                "velocity",
                "the method 'kalman' without an encoder resolution",
                "a positive count per coordinate",
                "give `resolution` or `counts_per_revolution` for every coordinate in the card",
            )
        v = kalman_smoother(q, dt, resolution)
    else:
        estimators: dict[str, Callable[[Positions, float], Positions]] = {
            "stencil": five_point_stencil,
            "savgol": savitzky_golay,
            "wiener": lambda q, dt: wiener_velocities(q, dt, resolution),
            "trapezoidal": lambda q, dt: wiener_velocities(q, dt, resolution, trapezoidal_response),
        }
        v = estimators[method](q, dt)
    return np.where(is_moving(q), v, 0.0)  # the rounding of a constant is no motion


def five_point_stencil(q: Positions, dt: float) -> Positions:
    """Five-point stencil `(q[k-2] - 8 q[k-1] + 8 q[k+1] - q[k+2]) / (12 dt)`.

    The paper's equation omits the period; its public code and this function divide by it.
    The first and last two samples get the one-sided derivative of the least-squares parabola
    through the five outermost samples. The one-sided formula of the stencil's own order would
    amplify the encoder's quantisation 5.6 times over the stencil's 0.95 / dt; the parabola 1.1.

    Args:
        q: positions, (n, n_q) [rad or m].
        dt: sampling period [s].

    Returns:
        Velocities, (n, n_q) [rad/s or m/s].

    References:
        van Esch, Bonassi, Schön, equation of the velocity estimate in section 3.2.
    """
    v = np.empty_like(q)
    v[2:-2] = (_STENCIL[0] * (q[:-4] - q[4:]) + _STENCIL[1] * (q[1:-3] - q[3:-1])) / dt
    v[:2] = polynomial_fit(np.arange(5.0) * dt, q[:5], 2, at=np.array([0.0, dt]))[1]
    v[-2:] = polynomial_fit(np.arange(5.0) * dt, q[-5:], 2, at=np.array([3 * dt, 4 * dt]))[1]
    return v


def savitzky_golay(q: Positions, dt: float) -> Positions:
    """Derivative of the least-squares cubic in a sliding window of 7 samples.

    The ends take the derivative of the outermost window's cubic.
    """
    import scipy.signal  # takes a second, and the method is rarely used

    length = min(7, len(q) if len(q) % 2 else len(q) - 1)
    slopes = scipy.signal.savgol_filter(q, length, 3, deriv=1, delta=dt, axis=0)
    return np.asarray(slopes)


def polynomial_fit(
    t: Float[np.ndarray, " m"],
    q: Float[np.ndarray, "m n_q"],
    degree: int,
    at: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "p n_q"], Float[np.ndarray, "p n_q"]]:
    """Value and slope of the least-squares polynomial through `q(t)`, at the times `at` [s]."""
    powers = np.arange(degree + 1)
    scale = max(float(np.ptp(t)), np.finfo(float).tiny)
    coefficients = np.linalg.lstsq(((t - t[0]) / scale)[:, None] ** powers, q, rcond=None)[0]
    s = ((at - t[0]) / scale)[:, None]
    slopes = powers[1:] * s ** (powers[1:] - 1) / scale
    return s**powers @ coefficients, slopes @ coefficients[1:]
