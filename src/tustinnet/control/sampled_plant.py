"""Simulated plants as a controller meets them: encoders that count, inputs that saturate."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.errors import InputError
from tustinnet.simulate.filtering import checked_vector

Vector = Float[np.ndarray, " _"]


@runtime_checkable
class Plant(Protocol):
    """The plant that a controller drives: a simulated device, or a real one.

    Attributes:
        dt: sampling period [s].
        state: its true state, (n_x,), where it is known: positions and velocities first.
    """

    dt: float
    state: Vector

    def reset(self, q: Vector, seed: int) -> None:
        """Puts it to rest at positions, (n_q,); all that is random follows from the seed."""
        ...

    def measure(self) -> Vector:
        """The positions that the encoders read now, (n_q,)."""
        ...

    def apply(self, u: Vector) -> None:
        """Goes on by one period under inputs, (n_u,)."""
        ...


@dataclass(frozen=True)
class PlantOptions:
    """The encoders and inputs of a simulated plant.

    Attributes:
        counts: counts of the encoders [rad or m], (n_q,), 0 for no rounding; None for those that
            the plant's coordinates declare. Where encoders begin to count is drawn at each reset.
        noise: standard deviation of noise on the positions before they are rounded [rad or m],
            (n_q,) or one for all.
        delay: samples by which inputs act late.
        limits: smallest and largest value of each input, (n_u, 2); None for those that the inputs
            declare.
        disturbance: standard deviation of what is added to each velocity in a period [rad/s or
            m/s], (n_q,) or one for all; of models only.
        glitches: share of the readings of each encoder that are no number, or wrong by 3 rad or m.
    """

    counts: Sequence[float] | Vector | None = None
    noise: float | Sequence[float] | Vector = 0.0
    delay: int = 0
    limits: Sequence[Sequence[float]] | Float[np.ndarray, "n_u 2"] | None = None
    disturbance: float | Sequence[float] | Vector = 0.0
    glitches: float = 0.0


USUAL = PlantOptions()


class SampledPlant(ABC):
    """A simulated plant: encoders that count, inputs that saturate and may act late.

    Args:
        channels: its coordinates and inputs, and the sampling period.
        options: of its encoders and inputs.
        where: its name in messages.

    Attributes:
        channels: its coordinates, inputs and period.
        dt: sampling period [s].
        state: its true state, (n_x,); no numbers before the first reset.
        applied: the inputs that acted in the last period, (n_u,).

    Raises:
        InputError: options of other sizes than the plant's, or that are negative.
    """

    state: Vector = np.zeros(0)  # before the first reset

    def __init__(self, channels: Channels, options: PlantOptions, where: str) -> None:
        self.channels, self.options, self.dt = channels, options, channels.dt
        n_q, n_u = channels.n_q, channels.n_u

        def sizes(name: str, value: Any) -> Vector:
            array = np.asarray(value, np.float64)
            array = checked_vector(
                name, np.full(n_q, array) if not array.ndim else array, n_q, where
            )
            if (array < 0).any():
                raise InputError(where, f"{name} {value}", "numbers from 0 on")
            return array

        counts = channels.resolution if options.counts is None else options.counts
        self._counts, self._noise = sizes("counts", counts), sizes("noise", options.noise)
        self._disturbance = sizes("disturbance", options.disturbance)
        if options.delay < 0:
            raise InputError(where, f"a delay of {options.delay} samples", "0 samples or more")
        limits = options.limits
        if limits is None:
            limits = [i.limits or (-np.inf, np.inf) for i in channels.inputs]
        self._limits = np.asarray(limits, np.float64).reshape(-1, 2)
        if self._limits.shape != (n_u, 2) or not (self._limits[:, 0] <= self._limits[:, 1]).all():
            raise InputError(where, f"limits {limits}", f"(smallest, largest) of {n_u} inputs")
        self._limits = self._limits.T
        self._is_noisy, self._is_disturbed = self._noise.any(), self._disturbance.any()
        self._steps = np.where(self._counts > 0, self._counts, 1.0)
        self._where = where
        self.state = np.full(channels.measured.stop, np.nan)

    def reset(self, q: Vector, seed: int) -> None:
        """Puts it to rest at positions, (n_q,); encoders and noise follow from the seed."""
        q = checked_vector("positions at the start", q, self.channels.n_q, self._where)
        self.generator = np.random.default_rng(seed)
        self._offset = self.generator.uniform(-0.5, 0.5, len(q)) * self._counts
        self.applied = np.zeros(self.channels.n_u)
        self._coming = deque([self.applied] * self.options.delay)
        self.state = self.restart(q)

    def measure(self) -> Vector:
        """The positions that the encoders read now, (n_q,)."""
        q = self.state[self.channels.position]
        if self._is_noisy:
            q = q + self._noise * self.generator.normal(size=len(q))
        rounded = np.rint((q - self._offset) / self._steps) * self._steps + self._offset
        q = np.where(self._counts > 0, rounded, q)
        if self.options.glitches:
            is_wrong = self.generator.random(len(q)) < self.options.glitches
            errors = self.generator.choice([np.nan, np.inf, -3.0, 3.0], len(q))
            q[is_wrong] += errors[is_wrong]
        return q

    def apply(self, u: Vector) -> None:
        """Goes on by one period under inputs, (n_u,), within their limits."""
        self._coming.append(np.clip(u, *self._limits))
        self.applied = self._coming.popleft()
        self.state = self.advance(self.applied)
        if self._is_disturbed:
            self.state[self.channels.velocity] += self._disturbance * self.generator.normal(
                size=self.channels.n_q
            )

    @abstractmethod
    def restart(self, q: Vector) -> Vector:
        """The state at rest at positions, from which it goes on."""

    @abstractmethod
    def advance(self, u: Vector) -> Vector:
        """The state a period later, under inputs that act."""
