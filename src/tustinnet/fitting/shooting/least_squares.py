"""Least squares over parameters and initial states, within bounds (Levenberg-Marquardt).

`minimise` takes a `CostFunction`, which simulates segments and adds what is known beforehand
(`Prior`), and returns the best parameters, initial states and products: `LeastSquaresResult`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.levenberg_marquardt import (
    DampingRule,
    iterate,
)
from tustinnet.fitting.shooting.normal import (
    NormalProducts,
    add_anchors,
    compute_products,
    eliminate_initial_states,
)
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.lagrangian import LagrangianSystem

_LONGEST_STEP = 1.0  # of a logarithm, or of a range: a factor of e at most
_LEAST_DAMPING = 1e-9
_TINY = 1e-300

# rising gently finds the longest step that is still good; the fall is Nielsen's
_DAMPING_RULE = DampingRule(
    initial=1e-3,
    largest=1e7,
    increase=4.0,
    decreased=lambda damping, gain: max(
        damping * max(1 / 5, 1 - (2 * gain - 1) ** 3), _LEAST_DAMPING
    ),
    least_gain_ratio=1e-3,
)


@dataclass(frozen=True)
class Prior:
    """Prior knowledge of parameters: `weight ((value - centre) / deviation)^2` is a cost.

    Attributes:
        centre: expected values, (n_p,).
        precision: 1 / deviation, 0 where nothing is known, (n_p,).
        weight: what a squared, normalised deviation adds to the cost.
    """

    centre: Float[np.ndarray, " n_p"]
    precision: Float[np.ndarray, " n_p"]
    weight: float

    def cost(self, space: SearchSpace, vector: ParameterVector) -> float:
        """Cost of a vector's deviations."""
        return self.weight * np.sum(self._deviation(space, vector) ** 2)

    def gradient(self, space: SearchSpace, vector: ParameterVector) -> ParameterVector:
        """Half the gradient of the cost by the vector, (n_p,)."""
        slopes = space.derivatives(vector) * self.precision
        return self.weight * slopes * self._deviation(space, vector)

    def curvature(self, space: SearchSpace, vector: ParameterVector) -> ParameterVector:
        """Half the second derivative of the cost by each entry of the vector, (n_p,)."""
        return self.weight * (space.derivatives(vector) * self.precision) ** 2

    def _deviation(self, space: SearchSpace, vector: ParameterVector) -> ParameterVector:
        values = space.to_values_in_range(vector)
        return (np.array([values[name] for name in space.names]) - self.centre) * self.precision


@dataclass(frozen=True)
class CostFunction:
    """The cost to minimise: squared residuals of segments, anchors of initial states, a prior.

    Attributes:
        system: the system to simulate.
        residual: what is compared.
        space: the search space.
        segments: the segments to simulate.
        prior: what is known of parameters beforehand.
        anchor_variance: mean squared residual, which makes anchors of initial states comparable
            with the cost.
        substeps: integration steps in a sampling period.
    """

    system: LagrangianSystem
    residual: Residual
    space: SearchSpace
    segments: Segments
    prior: Prior
    anchor_variance: float
    substeps: int

    def products(self, vector: ParameterVector, x0: Float[np.ndarray, "n_s n_x"]) -> NormalProducts:
        """Products at parameters and initial states, the anchors of the latter included."""
        products = compute_products(
            self.system, self.residual, self.space, vector, x0, self.segments, self.substeps
        )
        return add_anchors(products, self.segments, x0, self.anchor_variance)


@dataclass(frozen=True)
class StoppingRule:
    """Tolerance and limit at which a search ends.

    Attributes:
        tolerance: converged when the undamped step promises less than this part of the cost.
        max_iterations: limit of iterations.
    """

    tolerance: float
    max_iterations: int


@dataclass(frozen=True)
class LeastSquaresResult:
    """Result of a least-squares search: where it ended, and why.

    Attributes:
        vector: the parameters.
        x0: the segments' initial states, (n_s, n_x).
        segments: the segments that were compared.
        products: the products there.
        cost: the sum of squares there, prior included; infinite where it diverged.
        iterations: accepted steps.
        status: `converged`, `stalled`, `slow`, `limit`, `stopped`, or `diverged` where the first
            simulation did.
    """

    vector: ParameterVector
    x0: Float[np.ndarray, "n_s n_x"]
    segments: Segments
    products: NormalProducts
    cost: float
    iterations: int
    status: str

    def continue_in(self, segments: Segments) -> Float[np.ndarray, "n_s n_x"]:
        """Initial states of other segments: as they were found where one began at the same row."""
        if self.x0.shape[1] != segments.x0.shape[1]:
            return segments.x0
        _, new, old = np.intersect1d(
            segments.first_row, self.segments.first_row, return_indices=True
        )
        x0 = segments.x0.copy()
        x0[new] = np.where(segments.is_free[new], self.x0[old], x0[new])
        return x0


# iterations so far, lowest cost, damping, whether the last step was accepted
OnStep = Callable[[int, float, float, bool], None]


def minimise(
    cost: CostFunction,
    vector: ParameterVector,
    stopping: StoppingRule,
    on_step: OnStep = lambda iterations, cost, damping, is_accepted: None,
    should_stop: Callable[[], bool] = lambda: False,
    x0: Float[np.ndarray, "n_s n_x"] | None = None,
) -> LeastSquaresResult:
    """Minimises the simulation error over parameters and initial states.

    The normal equations have the shape of an arrow: every segment's initial state meets only the
    parameters. It is eliminated (Schur complement), so a step costs the solution of a system of
    the parameters alone. A parameter at a bound that wants to leave its range stays there.

    Args:
        cost: the cost function.
        vector: the parameters to start from.
        stopping: when to end.
        on_step: called after every simulation, of which an iteration takes one or more.
        should_stop: asked before every step; the result then is that of the iterations so far.
        x0: initial states to start from, as of `continue_in`; by default those of the segments.

    References:
        Marquardt (1963), An algorithm for least-squares estimation of nonlinear parameters.
        Nielsen (1999), Damping parameter in Marquardt's method, IMM-REP-1999-05 (its fall).
    """

    def evaluate(vector: ParameterVector, x0: np.ndarray) -> _SearchPoint:
        products = cost.products(vector, x0)
        value = float(products.cost.sum() + cost.prior.cost(cost.space, vector))
        return _SearchPoint(vector, x0, products, value if products.is_finite else np.inf)

    def propose(point: _SearchPoint, damping: float) -> tuple[_SearchPoint, float]:
        step = _damped_step(cost, point, damping)
        trial = evaluate(cost.space.clip(point.vector + step.vector), point.x0 + step.x0)
        return trial, step.predicted_decrease

    def has_converged(point: _SearchPoint, _: float) -> bool:
        undamped = _damped_step(cost, point, _LEAST_DAMPING)
        length = max(np.max(np.abs(x), initial=0.0) for x in (undamped.vector, undamped.x0))
        small = undamped.predicted_decrease <= stopping.tolerance * (point.cost + _TINY)
        return bool(small or length < 1e-10)

    point = evaluate(cost.space.clip(vector), cost.segments.x0 if x0 is None else x0)
    iterations, status = 0, "diverged"
    if np.isfinite(point.cost):
        on_step(0, point.cost, _DAMPING_RULE.initial, False)
        result = iterate(
            point,
            propose,
            has_converged,
            _DAMPING_RULE,
            stopping.max_iterations,
            lambda number, point, damping, is_accepted: on_step(
                number, point.cost, damping, is_accepted
            ),
            should_stop,
            stopping.tolerance,
        )
        point, iterations, status = result.point, result.iterations, result.status
    return LeastSquaresResult(
        point.vector, point.x0, cost.segments, point.products, point.cost, iterations, status
    )


@dataclass(frozen=True)
class _SearchPoint:
    """Parameters and initial states, their products and their cost, infinite if they diverge."""

    vector: ParameterVector
    x0: Float[np.ndarray, "n_s n_x"]
    products: NormalProducts
    cost: float


class _Step(NamedTuple):
    """A step of parameters and initial states, and the decrease of the cost that it promises."""

    vector: Float[np.ndarray, " n_p"]
    x0: Float[np.ndarray, "n_s n_x"]
    predicted_decrease: float


def _damped_step(cost: CostFunction, point: _SearchPoint, damping: float) -> _Step:
    """The minimum of the damped quadratic model, within the bounds and a factor of e."""
    space, vector, products = cost.space, point.vector, point.products
    reduced = eliminate_initial_states(products, damping)
    curvature = cost.prior.curvature(space, vector)
    matrix = reduced.matrices.sum(axis=0) + np.diag(curvature)
    gradient = reduced.gradients.sum(axis=0) + cost.prior.gradient(space, vector)
    diagonal = products.pp.sum(axis=0).diagonal() + curvature
    matrix = matrix + np.diag(damping * diagonal + 1e-14 * diagonal.max(initial=_TINY))

    low = np.maximum(space.lower - vector, -_LONGEST_STEP)
    high = np.minimum(space.upper - vector, _LONGEST_STEP)
    step = solve_in_box(matrix, gradient, low, high)
    decrease = -(2 * gradient @ step + step @ matrix @ step)
    decrease_by_states = -float(np.einsum("sx,sx->", products.gx, reduced.state_step))
    return _Step(
        step,
        reduced.state_step + reduced.state_step_by_parameters @ step,
        float(decrease + decrease_by_states),
    )


def solve_in_box(
    matrix: Float[np.ndarray, "m m"],
    gradient: Float[np.ndarray, " m"],
    lower: Float[np.ndarray, " m"],
    upper: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """The least of a quadratic form within bounds.

    By active sets of primal and dual variables, which take a few steps, whatever the number of
    bounds; where these come round to sets that were tried, by bounded least squares, which free one
    variable at a time.

    Args:
        matrix: second derivatives, positive definite but for rounding.
        gradient: first derivatives at 0.
        lower: lower bounds.
        upper: upper bounds.

    References:
        Hintermüller, Ito, Kunisch (2002), The primal-dual active set strategy as a semismooth
        Newton method.
    """
    unit = 1 / np.sqrt(np.maximum(np.diag(matrix), _TINY))
    values, vectors = np.linalg.eigh(matrix * np.outer(unit, unit))
    sizes = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    # the form as the square of a residual
    root, target = (vectors * sizes).T, -(vectors.T @ (unit * gradient)) / sizes
    low, high = lower / unit, upper / unit
    x, slope, tried = vectors @ (target / sizes), np.zeros_like(unit), list[bytes]()
    while True:
        at_low, at_high = x - slope < low, x - slope > high
        sets = np.concatenate([at_low, at_high]).tobytes()
        if sets in tried or len(tried) > len(unit):
            break
        tried.append(sets)
        free = ~(at_low | at_high)
        x = np.where(at_low, low, np.where(at_high, high, 0.0))
        q, r = np.linalg.qr(root[:, free])
        x[free] = np.linalg.solve(r, q.T @ (target - root @ x))
        slope = root.T @ (root @ x - target)
        slope[free] = 0.0
    if sets != tried[-1]:
        import scipy.optimize  # takes half a second, and is rarely needed

        x = scipy.optimize.lsq_linear(root, target, bounds=(low, high), method="bvls").x
    return np.clip(unit * x, lower, upper)
