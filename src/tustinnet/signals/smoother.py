"""A Kalman (Rauch-Tung-Striebel) smoother for positions read by an encoder."""

import numpy as np
from jaxtyping import Float

Matrices = Float[np.ndarray, "... 3 3"]
Vectors = Float[np.ndarray, "... 3"]

_CANDIDATES = np.logspace(-2, 10, 25)  # jerk intensities tried, (rad or m)^2 / s^5


def kalman_smoother(
    q: Float[np.ndarray, "n n_q"], dt: float, resolution: Float[np.ndarray, " n_q"]
) -> Float[np.ndarray, "n n_q"]:
    """Velocities of the most likely motion behind quantised positions.

    Each coordinate moves as a triple integrator driven by white jerk; the encoder adds an error
    of variance `resolution^2 / 12`. The jerk's intensity is the one of largest likelihood
    among 25 (two a decade), chosen per coordinate.

    Args:
        q: positions, (n, n_q) [rad or m].
        dt: sampling period [s].
        resolution: encoder count, (n_q,) [rad or m].

    Returns:
        Velocities, (n, n_q) [rad/s or m/s].

    References:
        Rauch, Tung, Striebel (1965), Maximum likelihood estimates of linear dynamic systems.
    """
    noise = resolution**2 / 12.0
    # one run of the filter with a leading axis of candidates
    grid = np.broadcast_to(_CANDIDATES[:, None], (len(_CANDIDATES), q.shape[1]))
    transition, process = _triple_integrator(dt, grid)
    # the first samples of a long record tell the jerk
    likelihood = _filter(q[:4000], transition, process, noise)[2]
    transition, process = _triple_integrator(dt, _CANDIDATES[np.argmax(likelihood, axis=0)])
    means, covariances, _ = _filter(q, transition, process, noise)
    predicted = transition @ covariances[:-1] @ transition.T + process
    # gain = P F' (F P F' + Q)^-1, as a solve with the symmetric matrix on the left
    gains = np.swapaxes(np.linalg.solve(predicted, transition @ covariances[:-1]), -1, -2)
    smoothed = means.copy()
    for k in range(len(means) - 2, -1, -1):
        ahead = smoothed[k + 1] - means[k] @ transition.T
        smoothed[k] = means[k] + (gains[k] @ ahead[..., None])[..., 0]
    return smoothed[..., 1]


def _triple_integrator(
    dt: float, intensity: Float[np.ndarray, "..."]
) -> tuple[Float[np.ndarray, "3 3"], Matrices]:
    """Transition and process noise of position, velocity, acceleration under white jerk."""
    transition = np.array([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    unit = np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    return transition, intensity[..., None, None] * unit


def _filter(
    q: Float[np.ndarray, "n n_q"],
    transition: Float[np.ndarray, "3 3"],
    process: Matrices,
    noise: Float[np.ndarray, " n_q"],
) -> tuple[Vectors, Matrices, Float[np.ndarray, "..."]]:
    """Filtered means and covariances per sample, and the log-likelihood (up to a constant)."""
    lead = process.shape[:-2]
    means = np.empty((len(q), *lead, 3))
    covariances = np.empty((len(q), *lead, 3, 3))
    dt = transition[0, 1]
    mean = np.zeros((*lead, 3))
    mean[..., 0] = q[0]
    spread = np.maximum(np.ptp(q, axis=0), np.sqrt(noise))
    covariance = np.zeros((*lead, 3, 3))
    # the first sample gives a position, no speed: begin with the widest spread of speeds
    covariance[..., 0, 0] = noise
    covariance[..., 1, 1] = (spread / (5 * dt)) ** 2
    covariance[..., 2, 2] = (spread / (5 * dt) ** 2) ** 2
    likelihood = np.zeros(lead)
    means[0], covariances[0] = mean, covariance
    for k in range(1, len(q)):
        mean = mean @ transition.T
        covariance = transition @ covariance @ transition.T + process
        innovation = q[k] - mean[..., 0]
        variance = covariance[..., 0, 0] + noise
        gain = covariance[..., :, 0] / variance[..., None]
        mean = mean + gain * innovation[..., None]
        covariance = covariance - gain[..., :, None] * covariance[..., None, 0, :]
        likelihood -= 0.5 * (innovation**2 / variance + np.log(variance))
        means[k], covariances[k] = mean, covariance
    return means, covariances, likelihood
