"""Periodic motions as Fourier series that begin and end at rest."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class FourierMotion:
    """A periodic motion of several coordinates.

    `q(t) = offset + sum over k of sine_k sin(k w t) + cosine_k cos(k w t)` with `w = 2 pi f` and
    k = 1, 2, ...

    Attributes:
        frequency: base frequency f [Hz].
        offset: mean positions, (n_q,) [rad or m].
        sine: coefficients of the sines, a harmonic in a row, (harmonics, n_q) [rad or m].
        cosine: those of the cosines, (harmonics, n_q).
    """

    frequency: float
    offset: Float[np.ndarray, " n_q"]
    sine: Float[np.ndarray, "harmonics n_q"]
    cosine: Float[np.ndarray, "harmonics n_q"]

    def sample(self, t: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3 n n_q"]:
        """Positions, velocities and accelerations at times [s], (3, n, n_q)."""
        sine, cosine = harmonics(len(self.sine), self.frequency, t)
        motion = sine @ self.sine + cosine @ self.cosine
        motion[0] += self.offset
        return motion


def harmonics(
    count: int, frequency: float, t: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3 n harmonics"], Float[np.ndarray, "3 n harmonics"]]:
    """Sines and cosines of the first harmonics, and their first two derivatives by time.

    Args:
        count: the number of harmonics.
        frequency: base frequency [Hz].
        t: times [s].
    """
    speeds = 2 * np.pi * frequency * np.arange(1, count + 1)
    sine, cosine = np.sin(np.outer(t, speeds)), np.cos(np.outer(t, speeds))
    return (
        np.stack([sine, cosine * speeds, -sine * speeds**2]),
        np.stack([cosine, -sine * speeds, -cosine * speeds**2]),
    )


def motions_from_rest(count: int, frequency: float) -> Float[np.ndarray, "shapes coefficients"]:
    """Orthogonal shapes of a motion whose velocity and acceleration are 0 at time 0.

    Each row has the coefficients of the sines, then those of the cosines. Shapes are orthogonal,
    and all of one size, in velocity. At the end of each period velocity and acceleration are 0
    again.

    Args:
        count: the number of harmonics, at least 2.
        frequency: base frequency [Hz].

    Returns:
        The shapes, (2 count - 2, 2 count).
    """
    order = np.arange(1, count + 1)
    none = np.zeros(count)
    # in coefficients of the velocity: v(0) is the sum of those of sines, a(0) by order of the rest
    conditions = np.stack([np.concatenate([none + 1, none]), np.concatenate([none, order])])
    _, _, rows = np.linalg.svd(conditions)
    speeds = 2 * np.pi * frequency * np.concatenate([order, order])
    return rows[2:] / speeds
