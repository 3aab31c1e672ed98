"""Unstable equilibria that a controller holds to the end of a record."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.signals.transients import resting_positions

_AHEAD = 5  # samples, the baseline of a velocity: errors of both ends are then independent
_ALIKE = 2.0  # factor between growth rates of one mode


@dataclass(frozen=True)
class HeldEquilibrium:
    """An unstable equilibrium that a controller holds to a record's end.

    Attributes:
        sample: first sample near it.
        e_fold: time in which an error would grow e-fold if the input did not answer to it [s].
    """

    sample: int
    e_fold: float


def find_held_equilibrium(
    q: Float[np.ndarray, "n n_q"],
    v: Float[np.ndarray, "n n_q"],
    u: Float[np.ndarray, "n n_u"],
    angular: tuple[bool, ...],
    dt: float,
) -> HeldEquilibrium | None:
    """The unstable equilibrium about which a record stays to its end, None where there is none.

    For every coordinate the stretch is examined in which it stays near its median of the record's
    last tenth: within 0.5 rad, or a fifth of the travel of a length. There the state 5 samples
    on is fitted as a linear function of the state and the inputs between. A growing mode that
    nevertheless stays small is held, if both halves of the stretch have it: of a robot that rests,
    or drifts, each has another. Errors of the positions make modes look more stable.

    Args:
        q: positions [rad or m].
        v: velocities [rad/s or m/s].
        u: inputs; without a change in the stretch they hold nothing.
        angular: whether each coordinate is an angle.
        dt: sampling period [s].
    """
    # so far, in rad or of the travel of a length, motion is near to linear
    near = np.where(angular, 0.5, 0.2 * np.ptp(q, axis=0))
    far = np.abs(q - resting_positions(q)) > near
    first_samples = {int(np.flatnonzero(c)[-1]) + 1 if c.any() else 0 for c in far.T}
    for k in sorted(first_samples):
        # velocities at the stretch's edge are made of positions before it
        x, begin, middle = np.concatenate([q, v], axis=1), k + _AHEAD, (k + len(q)) // 2
        rate = _fastest_growth(x[begin:], u[begin:], dt)
        # with fewer e-folds within the stretch it might be drift
        if rate * (len(q) - k) * dt > 10.0 and all(
            rate / _ALIKE < _fastest_growth(x[half], u[half], dt) < rate * _ALIKE
            for half in (slice(begin, middle), slice(middle, None))
        ):
            # before it, too, as where its set point moves
            is_whole = rate / _ALIKE < _fastest_growth(x[_AHEAD:k], u[_AHEAD:k], dt) < rate * _ALIKE
            return HeldEquilibrium(0 if is_whole else k, 1 / rate)
    return None


def _fastest_growth(
    x: Float[np.ndarray, "n n_x"], u: Float[np.ndarray, "n n_u"], dt: float
) -> float:
    """Rate of the fastest mode of a linear fit [1/s]; 0 where there is too little to fit."""
    n = len(x) - _AHEAD
    if n < 100 or not np.ptp(u, axis=0).any():
        return 0.0
    between = [u[j : j + n] for j in range(_AHEAD)]
    regressors = np.concatenate([x[:n], *between, np.ones((n, 1))], axis=1)
    size = np.maximum(np.abs(regressors).max(axis=0), 1e-300)
    coefficients, _, rank, _ = np.linalg.lstsq(regressors / size, x[_AHEAD:], rcond=1e-8)
    if rank < regressors.shape[1] - np.sum(np.ptp(regressors, axis=0) == 0):
        return 0.0
    modes = np.linalg.eigvals((coefficients / size[:, None])[: x.shape[1]])
    return max(0.0, float(np.log(max(np.abs(modes).max(), 1e-300))) / (_AHEAD * dt))
