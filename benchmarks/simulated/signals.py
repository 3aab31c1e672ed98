"""Inputs and references of the simulated machines: functions of time, random by their generator."""

from collections.abc import Callable

import numpy as np

Signal = Callable[[np.ndarray], np.ndarray]  # times [s], any shape; values of the same shape


def constant(value: float = 0.0) -> Signal:
    """A signal that does not change."""
    return lambda t: np.full_like(t, value)


def multisine(
    rng: np.random.Generator, low: float, high: float, rms: float, lines: int = 40
) -> Signal:
    """A sum of sines of equal amplitude and random phase.

    Args:
        rng: generator of phases.
        low: lowest frequency [Hz].
        high: highest frequency [Hz].
        rms: root mean square of the signal.
        lines: number of sines; their frequencies are a little irregular, so that nothing repeats.
    """
    frequencies = np.linspace(low, high, lines) + rng.uniform(-0.4, 0.4, lines) * (
        (high - low) / lines
    )
    phases = rng.uniform(0, 2 * np.pi, lines)
    amplitude = rms * np.sqrt(2 / lines)

    def signal(t: np.ndarray) -> np.ndarray:
        total = np.zeros_like(t)
        for frequency, phase in zip(frequencies, phases, strict=True):
            total += amplitude * np.sin(2 * np.pi * frequency * t + phase)
        return total

    return signal


def chirp(low: float, high: float, amplitude: float, seconds: float) -> Signal:
    """A sine whose frequency rises exponentially from `low` to `high` [Hz] in some seconds."""
    growth = np.log(high / low) / seconds
    return lambda t: amplitude * np.sin(2 * np.pi * low * (np.exp(growth * t) - 1) / growth)


def steps(rng: np.random.Generator, hold: float, amplitude: float, seconds: float) -> Signal:
    """Random levels within plus and minus an amplitude, each for `hold` seconds."""
    levels = rng.uniform(-amplitude, amplitude, int(seconds / hold) + 2)
    return lambda t: levels[np.floor(t / hold + 1e-9).astype(int)]


def moves(
    rng: np.random.Generator, hold: float, amplitude: float, seconds: float, rise: float
) -> Signal:
    """Random levels, each for `hold` seconds, reached within `rise` seconds without a jump.

    The first level is 0. Speed and acceleration are continuous, as a path generator makes them.
    """
    levels = rng.uniform(-amplitude, amplitude, int(seconds / hold) + 3)
    levels[0] = 0.0

    def signal(t: np.ndarray) -> np.ndarray:
        index = np.floor(t / hold + 1e-9).astype(int)
        s = np.clip((t - index * hold) / rise, 0, 1)
        blend = s**3 * (10 - 15 * s + 6 * s**2)
        return levels[index] + (levels[index + 1] - levels[index]) * blend

    return signal


def total(*signals: Signal) -> Signal:
    """The sum of some signals."""
    return lambda t: np.sum([signal(t) for signal in signals], axis=0)


def soft_start(signal: Signal, seconds: float = 1.0) -> Signal:
    """A signal that grows from 0 in some seconds, so that a machine at rest can follow it."""
    return lambda t: signal(t) * np.clip(t / seconds, 0, 1) ** 2
