"""Levenberg-Marquardt within a box, initial states eliminated."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.optimize
from jaxtyping import Float

from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.normal import Normal, normal_products
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import Space
from tustinnet.models.lagrangian import LagrangianSystem

_LONGEST_STEP = 1.0  # of a logarithm, or of a range: a factor of e at most
_FIRST_DAMPING = 1e-3
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e7
_LEAST_GAIN = 1e-3  # of the promised fall, for a step to be taken
_SHORTEST_STEP = 1e-10
_TINY = 1e-300


@dataclass(frozen=True)
class Prior:
    """What is known of parameters beforehand: `((value - centre) / deviation)^2` times a weight.

    Attributes:
        centre: expected values, (n_p,).
        precision: 1 / deviation, 0 where nothing is known, (n_p,).
        variance: mean squared residual: what makes it comparable with the cost.
        weight: what a squared, normalised deviation adds to the cost.
    """

    centre: Float[np.ndarray, " n_p"]
    precision: Float[np.ndarray, " n_p"]
    variance: float
    weight: float


@dataclass(frozen=True)
class Fitted:
    """Where the search ended.

    Attributes:
        vector: the parameters.
        x0: the segments' initial states, (n_s, n_x).
        normal: the products there.
        cost: the sum of squares there, priors included.
        iterations: accepted steps.
        evaluations: simulations of all segments.
        why: `converged`, `stalled`, `limit`, or `diverged` where it could not even begin.
    """

    vector: Float[np.ndarray, " n_p"]
    x0: Float[np.ndarray, "n_s n_x"]
    normal: Normal
    cost: float
    iterations: int
    evaluations: int
    why: str


@dataclass(frozen=True)
class Cost:
    """What is minimised: the squared residuals of segments, and what is known beforehand.

    Attributes:
        system: what is simulated.
        residual: what is compared.
        space: the parameters' coordinates.
        segments: what to simulate.
        prior: what is known beforehand.
        substeps: integration steps in a period.
    """

    system: LagrangianSystem
    residual: Residual
    space: Space
    segments: Segments
    prior: Prior
    substeps: int

    def products(self, vector: Float[np.ndarray, " n_p"], x0: np.ndarray) -> Normal:
        """The products at parameters and initial states, with what anchors the latter."""
        products = normal_products(
            self.system, self.residual, self.space, vector, x0, self.segments, self.substeps
        )
        return anchored(products, self.segments, x0, self.prior.variance)

    def value(self, normal: Normal, vector: Float[np.ndarray, " n_p"]) -> float:
        """The sum of squares, priors included."""
        deviation, _ = prior_deviation(self.prior, self.space, vector)
        return float(normal.cost.sum() + self.prior.weight * np.sum(deviation**2))


@dataclass(frozen=True)
class Limits:
    """When a search ends.

    Attributes:
        tolerance: converged when the undamped step promises less than this part of the cost.
        iterations: allowed.
    """

    tolerance: float
    iterations: int


Told = Callable[[int, float, float], None]  # iterations so far, cost, damping


def minimise(
    cost: Cost,
    vector: Float[np.ndarray, " n_p"],
    limits: Limits,
    told: Told = lambda iterations, cost, damping: None,
) -> Fitted:
    """Minimises the simulation error over parameters and initial states.

    The normal equations have the shape of an arrow: every segment's initial state meets only the
    parameters. It is eliminated (Schur complement), so a step costs the solution of a system of
    the parameters alone. A parameter at the end of its range that wants to leave it stays there.

    Args:
        cost: what is minimised.
        vector: where to start.
        limits: when to end.
        told: who is told of every iteration.

    References:
        Marquardt (1963), An algorithm for least-squares estimation of nonlinear parameters.
        Nielsen (1999), Damping parameter in Marquardt's method, IMM-REP-1999-05 (its fall).
    """
    space, x0 = cost.space, cost.segments.x0
    vector = space.clipped(vector)
    normal = cost.products(vector, x0)
    value = cost.value(normal, vector)
    damping, evaluations, iterations, why = _FIRST_DAMPING, 1, 0, "limit"
    if not _finite(normal):
        return Fitted(vector, x0, normal, np.inf, 0, 1, "diverged")
    while iterations < limits.iterations:
        undamped = _step(_reduce(normal, cost, vector, _LEAST_DAMPING), space, vector)
        if undamped.promised <= limits.tolerance * (value + _TINY) or (
            undamped.length < _SHORTEST_STEP
        ):
            why = "converged"
            break
        while damping <= _MOST_DAMPING:
            step = _step(_reduce(normal, cost, vector, damping), space, vector)
            trial, states = space.clipped(vector + step.vector), x0 + step.states
            found = cost.products(trial, states)
            trial_value = cost.value(found, trial)
            evaluations += 1
            gain = (value - trial_value) / step.promised if _finite(found) else -1.0
            if gain > _LEAST_GAIN:
                break
            damping *= 4  # rising gently finds the longest step that is still good
        else:
            why = "stalled"
            break
        vector, x0, normal, value = trial, states, found, trial_value
        iterations += 1
        damping = max(damping * max(1 / 5, 1 - (2 * gain - 1) ** 3), _LEAST_DAMPING)
        told(iterations, value, damping)
    return Fitted(vector, x0, normal, value, iterations, evaluations, why)


@dataclass(frozen=True)
class _Reduced:
    """The damped normal equations of the parameters, and the way back to the initial states."""

    matrix: Float[np.ndarray, "n_p n_p"]
    gradient: Float[np.ndarray, " n_p"]
    state_from_gradient: Float[np.ndarray, "n_s n_x"]
    state_from_step: Float[np.ndarray, "n_s n_x n_p"]
    state_gain: float


def eliminated(
    normal: Normal, damping: float = 0.0
) -> tuple[
    Float[np.ndarray, "n_s n_p n_p"], Float[np.ndarray, "n_s n_p"],
    Float[np.ndarray, "n_s n_x"], Float[np.ndarray, "n_s n_x n_p"],
]:  # fmt: skip
    """Every segment's share of the parameters' normal equations, initial states eliminated.

    Returns:
        The Schur complements, the reduced gradients, and the initial states' steps as an affine
        function of the parameters' step.
    """
    diagonal = np.einsum("sii->si", normal.xx)
    unused = np.where(diagonal > 0, damping * diagonal, 1.0)  # states that are not searched for
    inner = normal.xx + np.einsum("si,ij->sij", unused, np.eye(diagonal.shape[1]))
    # a state that no residual depends on any more must not make the block singular
    inner += 1e-13 * np.einsum("si,ij->sij", diagonal, np.eye(diagonal.shape[1]))
    by_gradient = -np.linalg.solve(inner, normal.gx[:, :, None])[:, :, 0]
    by_step = -np.linalg.solve(inner, np.swapaxes(normal.px, 1, 2))
    matrix = normal.pp + normal.px @ by_step
    gradient = normal.gp + np.einsum("spx,sx->sp", normal.px, by_gradient)
    return matrix, gradient, by_gradient, by_step


def _reduce(normal: Normal, cost: Cost, vector: np.ndarray, damping: float) -> _Reduced:
    matrices, gradients, by_gradient, by_step = eliminated(normal, damping)
    prior = cost.prior
    of_prior, prior_slopes = prior_deviation(prior, cost.space, vector)
    curvature = prior.weight * prior_slopes**2
    matrix = matrices.sum(axis=0) + np.diag(curvature)
    gradient = gradients.sum(axis=0) + prior.weight * prior_slopes * of_prior
    scale = normal.pp.sum(axis=0).diagonal() + curvature
    matrix = matrix + np.diag(damping * scale + 1e-14 * scale.max(initial=_TINY))
    state_gain = -float(np.einsum("sx,sx->", normal.gx, by_gradient))
    return _Reduced(matrix, gradient, by_gradient, by_step, state_gain)


@dataclass(frozen=True)
class _Step:
    vector: Float[np.ndarray, " n_p"]
    states: Float[np.ndarray, "n_s n_x"]
    promised: float

    @property
    def length(self) -> float:
        return float(max(np.max(np.abs(part), initial=0.0) for part in (self.vector, self.states)))


def _step(reduced: _Reduced, space: Space, vector: np.ndarray) -> _Step:
    """The step of parameters and initial states, and the fall of the cost it promises.

    The quadratic model is minimised within the box, and within a factor of e of where it stands.
    """
    low = np.maximum(space.lower - vector, -_LONGEST_STEP)
    high = np.minimum(space.upper - vector, _LONGEST_STEP)
    scale = 1 / np.sqrt(np.maximum(np.diag(reduced.matrix), _TINY))
    values, vectors = np.linalg.eigh(reduced.matrix * np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    # g's + s'Hs / 2 as the square of a residual, which bounded linear least squares takes
    solved = scipy.optimize.lsq_linear(
        (vectors * root).T,
        -(vectors.T @ (scale * reduced.gradient)) / root,
        bounds=(np.minimum(low, -1e-12) / scale, np.maximum(high, 1e-12) / scale),
        method="bvls",
    )
    step = np.clip(scale * solved.x, low, high)
    states = reduced.state_from_gradient + reduced.state_from_step @ step
    gain = -(2 * reduced.gradient @ step + step @ reduced.matrix @ step)
    return _Step(step, states, float(gain + reduced.state_gain))


def prior_deviation(
    prior: Prior, space: Space, vector: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normalised deviations from what is known beforehand, and their derivatives, (n_p,) each."""
    numbers = space.numbers(vector)
    values = np.array([numbers[name] for name in space.names])
    return (values - prior.centre) * prior.precision, space.slopes(vector) * prior.precision


def _finite(normal: Normal) -> bool:
    products = (normal.pp, normal.px, normal.xx, normal.gp, normal.gx, normal.cost)
    return all(np.isfinite(part).all() for part in products)


def anchor_weight(segments: Segments, variance: float) -> Float[np.ndarray, "n_s n_x"]:
    """What a squared departure from each measured initial state adds to the cost, (n_s, n_x)."""
    return variance * segments.share[:, None] * segments.precision**2


def anchored(normal: Normal, segments: Segments, x0: np.ndarray, variance: float) -> Normal:
    """The products with what is known of the initial states: positions were measured."""
    weight = anchor_weight(segments, variance)
    off = x0 - segments.x0
    return replace(
        normal,
        xx=normal.xx + np.einsum("sx,xy->sxy", weight, np.eye(x0.shape[1])),
        gx=normal.gx + weight * off,
        cost=normal.cost + np.sum(weight * off**2, axis=1),
    )
