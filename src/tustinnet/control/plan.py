"""Planned motions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.shown import Brief
from tustinnet.wording import counted


@dataclass(frozen=True, repr=False)
class Plan(Brief):
    """States and inputs of a planned motion.

    Attributes:
        x: states at all samples, (N + 1, n_x).
        u: inputs that are commanded from each sample to the next, (N, n_u).
        cost: the cost that was minimised.
        converged: whether the search came to a minimum; no global one is promised.
        reached: whether it ends where linear feedback holds the goal with half of the limits of the
            inputs.
        iterations: how many there were.
        dt: sampling period [s].
        goal: the state that it should end in, (n_x,), with the whole turns of its way there.
        before: inputs before its first sample, (n_u,).
        delay: samples from a command to its effect.
    """

    x: Float[np.ndarray, "samples n_x"]
    u: Float[np.ndarray, "N n_u"]
    cost: float
    converged: bool
    reached: bool
    iterations: int
    dt: float
    goal: Float[np.ndarray, " n_x"]
    before: Float[np.ndarray, " n_u"]
    delay: int = 0

    @property
    def miss(self) -> Float[np.ndarray, " n_x"]:
        """The deviation of its end from the goal, (n_x,)."""
        return self.x[-1] - self.goal

    def previous_inputs(self, count: int) -> Float[np.ndarray, "N previous"]:
        """The inputs before each step, the latest first, (N, count n_u)."""
        n = len(self.u)
        padded = np.concatenate([np.tile(self.before, (count, 1)), self.u])
        return np.hstack(
            [padded[count - j : count - j + n] for j in range(1, count + 1)] or [np.zeros((n, 0))]
        )

    def require_for(self, n_x: int, n_u: int, dt: float, delay: int, where: str) -> None:
        """Raises unless it is a plan of a model of some size, period and delay.

        Raises:
            InputError: it is not.
        """
        sizes = self.x.shape[1], self.u.shape[1]
        if sizes != (n_x, n_u):
            raise InputError(
                where,
                f"a plan of {sizes[0]} states and {sizes[1]} inputs",
                f"{n_x} and {n_u} as the model has",
            )
        if not np.isclose(self.dt, dt, rtol=1e-6) or self.delay != delay:
            raise InputError(
                where,
                f"a plan of {self.dt:g} s a sample, {counted(self.delay, 'sample')} late",
                f"{dt:g} s a sample, {counted(delay, 'sample')} late",
            )
