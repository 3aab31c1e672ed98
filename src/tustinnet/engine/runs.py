"""Simulations that are done side by side, and what comes of their comparison with samples."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Runs:
    """Simulations that are done side by side.

    Attributes:
        start: states at the beginning, (runs, n_x).
        parameters: of the equations, those that derivatives are needed by first, (runs, n_p + n_c).
        steps: steps of each, (runs,).
        first: row of the inputs at the beginning of each, (runs,).
        drive: inputs from each sample to the next, (rows, order, n_u): the coefficients of the
            polynomials that they follow, or what a discrete model's step is given (order 1).
        periods: time from each sample to the next [s], (rows,); discrete models do not use it.
        measured: positions and velocities that take the place of the simulated ones, (rows, n_m).
        measured_samples: at how many of the first samples of each they do, (runs,).
    """

    start: Float[np.ndarray, "runs n_x"]
    parameters: Float[np.ndarray, "runs n_p"]
    steps: Int[np.ndarray, " runs"]
    first: Int[np.ndarray, " runs"]
    drive: Float[np.ndarray, "rows order n_u"]
    periods: Float[np.ndarray, " rows"]
    measured: Float[np.ndarray, "rows n_m"] | None = None
    measured_samples: Int[np.ndarray, " runs"] | None = None

    @property
    def results(self) -> Int[np.ndarray, " runs"]:
        """The row of the first sample of each run where samples stand run after run."""
        return np.cumsum(self.steps + 1) - self.steps - 1

    @property
    def samples(self) -> int:
        """The number of samples of all runs together."""
        return int(np.sum(self.steps + 1))


@dataclass(frozen=True)
class Directions:
    """Directions along which runs are differentiated.

    Attributes:
        seeds: derivatives of the states at the beginning along every direction,
            (runs, n_d, n_x).
        parameters: whether the first `n_p` directions are those of the parameters; else the
            equations do not depend on any direction, only the states do.
    """

    seeds: Float[np.ndarray, "runs n_d n_x"]
    parameters: bool


@dataclass(frozen=True)
class Samples:
    """Measured values that runs are compared with, in rows as of the inputs.

    Attributes:
        target: values of the first numbers of the states, (rows, n_y).
        weight: weight of each residual, (rows, n_y).
    """

    target: Float[np.ndarray, "rows n_y"]
    weight: Float[np.ndarray, "rows n_y"]


@dataclass(frozen=True)
class Comparison:
    """Products of residuals and their derivatives, run by run.

    Attributes:
        products: of derivatives by the directions, (runs, n_d, n_d).
        gradient: of derivatives and residuals, (runs, n_d).
        cost: sums of squared residuals, (runs,).
        error: simulated minus measured, 0 where it has no weight, run after run, (samples, n_y).
    """

    products: Float[np.ndarray, "runs n_d n_d"]
    gradient: Float[np.ndarray, "runs n_d"]
    cost: Float[np.ndarray, " runs"]
    error: Float[np.ndarray, "samples n_y"]
