"""The least-squares problem of forces: convex in inertias, with a prior, within ranges.

`solve` weighs the joints by what they leave, moving and at rest apart, and for each set of weights
takes Newton steps within the ranges of the parameters.

References:
    Lee, Wensing, Park (2020), Geometric robot dynamic identification: a convex programming
    approach, IEEE Transactions on Robotics 36(2): the log-det divergence of pseudo-inertias.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from tustinnet.fitting.inverse_dynamics.sums import ForceSums
from tustinnet.fitting.shooting.base_parameters import LinearCoordinates, bodies_of
from tustinnet.fitting.shooting.least_squares import solve_in_box
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.uncertainty import NO_INFORMATION


class SolverSettings(NamedTuple):
    """Settings of the weighted least squares of forces.

    All are set by hand, not measured.

    Attributes:
        reweightings: times that weights follow from the missing forces.
        steps: steps of Newton's method for each set of weights, at most.
        converged: decrease of the cost from which on steps go on, in squares of standard
            deviations.
        rest: share of a joint's mean square, below which neither motion nor rest weighs
            more.
        least: share of a force, below which nothing is told apart.
    """

    reweightings: int = 4
    steps: int = 50
    converged: float = 1e-6
    rest: float = 0.1
    least: float = 1e-9


SOLVER = SolverSettings()


class Prior:
    """Priors in the coordinates of a search, about the nominal values.

    A link whose ten inertial parameters are free is kept near the file's by the log-det divergence
    of its pseudo-inertia, so it stays one that can be built; how near says the standard deviation
    of its mass. Any other parameter has its own; without one half of its range.

    Args:
        space: the search space.
        gains: parameters that the input of a coordinate is multiplied by, with the coordinate's
            place.
    """

    def __init__(self, space: SearchSpace, gains: Mapping[str, int] | None = None) -> None:
        self.space, free = space, space.free_parameters
        self._gains = [(i, gains[n]) for i, n in enumerate(space.names) if gains and n in gains]
        self.centre = space.to_vector(space.nominal)
        derivatives = space.derivatives(self.centre)
        priors = np.array([p.prior or np.inf for p in free]) / derivatives
        self.precision = 1 / np.minimum(priors, (space.upper - space.lower) / 2) ** 2
        # what is carried in groups of records is not what the file says
        self.bodies = [c for group, c in bodies_of(space.names) if not group]
        # of a link that is s times as heavy, and else the same, the divergence is 2 (s - 1)^2
        masses = [columns[0] for columns in self.bodies]
        relative = np.array([free[i].nominal for i in masses]) / derivatives[masses]
        self._weights = self.precision[masses] * relative**2 / 4
        for columns in self.bodies:
            self.precision[columns] = 0.0
        nominal = LinearCoordinates(space, space.to_values(self.centre)).values
        pseudo = [_pseudo_inertia(nominal[columns]) for columns in self.bodies]
        self._nominal = np.linalg.inv(np.reshape(pseudo, (-1, 4, 4)))
        self.spread = np.sqrt(np.diag(np.linalg.inv(self.at(self.centre)[2])))

    def at(
        self, vector: ParameterVector, point: LinearCoordinates | None = None
    ) -> tuple[float, ParameterVector, Float[np.ndarray, "n_p n_p"]]:
        """Half the sum of squares at a vector, its derivative and second derivatives.

        Args:
            vector: the vector.
            point: its linear coordinates, where they are known.
        """
        away = vector - self.centre
        cost, gradient = float(away @ (self.precision * away)) / 2, self.precision * away
        matrix = np.diag(self.precision)
        if not self.bodies:
            return cost, gradient, matrix
        point = point or LinearCoordinates(self.space, self.space.to_values(vector))
        by_vector = point.derivatives * self.space.derivatives(vector)
        bodies = np.array(self.bodies)
        pseudo = np.einsum("bk,kij->bij", point.values[bodies], _BASIS)
        inverse, ratio = np.linalg.inv(pseudo), self._nominal @ pseudo
        divergence = np.trace(ratio, axis1=1, axis2=2) - np.linalg.slogdet(ratio)[1] - 4
        own, turned = by_vector[_squares(bodies)], inverse[:, None] @ _BASIS
        slope = np.einsum("bij,kji->bk", self._nominal - inverse, _BASIS)
        curvature = np.einsum("bkij,blji->bkl", turned, turned)
        gradient[bodies] += self._weights[:, None] * np.einsum("bkl,bk->bl", own, slope)
        weighted = self._weights[:, None, None] * own.transpose(0, 2, 1) @ curvature @ own
        matrix[_squares(bodies)] += weighted
        cost += float(self._weights @ divergence)
        return cost, gradient, matrix

    def of_gains(
        self, counts: Float[np.ndarray, " n_q"], vector: ParameterVector
    ) -> tuple[float, ParameterVector]:
        """The addition to the cost because forces are compared in units of the inputs.

        A smaller gain makes the noise of an input smaller in N m, and explains nothing: the density
        of inputs is that of forces times their derivative by the input, for each measurement.

        Args:
            counts: independent measurements by coordinate.
            vector: the vector.

        Returns:
            The term, and its derivative by the vector.
        """
        values, slopes = self.space.to_values(vector), self.space.derivatives(vector)
        cost, gradient = 0.0, np.zeros(len(vector))
        for i, k in self._gains:
            gain = values[self.space.names[i]]
            cost -= float(counts[k] * np.log(abs(gain)))
            gradient[i] -= counts[k] * slopes[i] / gain
        return cost, gradient


class Solution(NamedTuple):
    """The parameters that explain forces best, and how well each joint is explained.

    Attributes:
        vector: the parameters.
        variances: mean squares of what is missing at each joint, moving and at rest, by which the
            joints were weighed, (n_q, 2).
        steps: Newton steps.
        cost: half the sum of squares by these, the prior's included.
    """

    vector: ParameterVector
    variances: Float[np.ndarray, "n_q 2"]
    steps: int
    cost: float


def solve(sums: ForceSums, prior: Prior, start: ParameterVector) -> Solution:
    """The parameters that explain the forces of all folds best.

    Args:
        sums: sums of squares in the linear coordinates of the prior's space.
        prior: the priors.
        start: first values.
    """
    total, space = sums.total, prior.space
    (matrices,), (counts,), (sizes,) = total.matrices, total.counts, total.sizes
    size = sizes.sum(axis=1) + matrices[..., -1, -1].sum(axis=1)
    least = SOLVER.least**2 * size / np.maximum(counts.sum(axis=1), 1)
    vector, steps, cost, variances = start, 0, 0.0, np.zeros_like(counts)
    for _ in range(SOLVER.reweightings):
        (left,) = total.squares(coordinates_of(space, vector))
        mean = np.maximum(left.sum(axis=1) / np.maximum(counts.sum(axis=1), 1), least)
        variances = np.maximum(left / np.maximum(counts, 1), SOLVER.rest * mean[:, None])
        matrix = np.einsum("jr,jrkl->kl", 1 / variances, matrices)
        vector, cost, more = _minimise(matrix, prior, vector, counts.sum(axis=1))
        steps += more
    return Solution(vector, variances, steps, cost)


def least_squares(
    sums: ForceSums, known: Mapping[int, float] | None = None
) -> Float[np.ndarray, " n_c"]:
    """The linear coordinates that explain forces best, without priors and ranges.

    Joints are weighed by what they leave.

    Args:
        sums: sums of squares.
        known: values of coordinates by their places, as of the gains of inputs: without any force
            and any gain nothing would be left.
    """
    total = sums.total
    matrices, counts = total.matrices[0].sum(axis=1), total.counts[0].sum(axis=1)
    n_c = matrices.shape[-1] - 1
    point = np.eye(n_c + 1)  # of what is free, and of 1
    for i, value in (known or {}).items():
        point[i, [i, -1]] = 0.0, value
    matrices = point.T @ matrices @ point
    left, found = matrices[:, -1, -1], point[:-1, -1]
    for _ in range(SOLVER.reweightings):
        matrix = np.einsum("j,jkl->kl", counts / np.maximum(left, 1e-300), matrices)
        size = np.sqrt(np.diag(matrix)[:-1])
        # a smaller column is what rounding leaves of none
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 1e-10 * size.max())
        # singular values below this share of the largest one are none
        inverse = np.linalg.pinv(matrix[:-1, :-1] * np.outer(scale, scale), 1e-12, True)
        found = point[:-1, -1] - scale * (inverse @ (scale * matrix[:-1, -1]))
        left = total.squares(found)[0].sum(axis=1)
    return found


def fold_derivatives(
    sums: ForceSums, prior: Prior, solution: Solution
) -> tuple[Float[np.ndarray, "f n_p"], Float[np.ndarray, "f n_p n_p"]]:
    """Derivatives of half the weighted squares of each fold by the vector, first and second."""
    weights, space, vector = 1 / solution.variances, prior.space, solution.vector
    by_fold = np.einsum("jr,fjrkl->fkl", weights, sums.matrices)
    point = LinearCoordinates(space, space.to_values(vector))
    parts = [force_matrix(matrix, space, vector, point)[1:] for matrix in by_fold]
    gradients, matrices = zip(*parts, strict=True)
    of_gains = [prior.of_gains(counts, vector)[1] for counts in sums.counts.sum(axis=2)]
    return np.stack(gradients) + of_gains, np.stack(matrices)


def folds_to_leave_out(sums: ForceSums, prior: Prior, solution: Solution) -> list[int]:
    """Folds of which none alone informs of a parameter, as the only record of a group does.

    Of what no fold knows more than the prior, none does: there rounding would say which fold it is.
    """
    _, matrices = fold_derivatives(sums, prior, solution)
    inside = prior.space.inside(solution.vector)
    by_fold = np.diagonal(matrices, axis1=1, axis2=2)[:, inside]
    precision = np.diag(prior.at(solution.vector)[2])[inside]
    by_all = by_fold.sum(axis=0)
    kept = by_all - by_fold >= NO_INFORMATION * (by_all - precision)
    return [int(k) for k in np.flatnonzero(kept.all(axis=1))]


def left_out_squares(
    sums: ForceSums, prior: Prior, start: ParameterVector, folds: Sequence[int]
) -> Float[np.ndarray, "f n_q"]:
    """Sums of squares of the missing forces of some folds, each by a fit to all others."""
    every, squares = np.arange(len(sums.counts)), []
    for f in folds:
        vector = solve(sums.of_folds(every != f), prior, start).vector
        own = sums.of_folds([f]).squares(coordinates_of(prior.space, vector))
        squares.append(own[0].sum(axis=1))
    return np.stack(squares)


def coordinates_of(space: SearchSpace, vector: ParameterVector) -> Float[np.ndarray, " n_c"]:
    """The linear coordinates of a vector."""
    return LinearCoordinates(space, space.to_values(vector)).values


def force_matrix(
    matrix: Float[np.ndarray, "n n"],
    space: SearchSpace,
    vector: ParameterVector,
    point: LinearCoordinates,
) -> tuple[float, ParameterVector, Float[np.ndarray, "n_p n_p"]]:
    """Half of a quadratic form of the coordinates and 1, with derivatives by a vector.

    The second derivatives are those of Gauss and Newton.
    """
    y = np.append(point.values, 1.0)
    slope, by_vector = matrix @ y, point.derivatives * space.derivatives(vector)
    return (
        float(y @ slope) / 2,
        by_vector.T @ slope[:-1],
        by_vector.T @ matrix[:-1, :-1] @ by_vector,
    )


def _minimise(
    matrix: Float[np.ndarray, "n n"],
    prior: Prior,
    vector: ParameterVector,
    counts: Float[np.ndarray, " n_q"],
) -> tuple[ParameterVector, float, int]:
    """The vector of the lowest cost within the ranges, the cost, and the number of steps."""
    space = prior.space

    def at(vector: ParameterVector) -> tuple[float, ParameterVector, np.ndarray]:
        point = LinearCoordinates(space, space.to_values(vector))
        of_forces, of_prior = force_matrix(matrix, space, vector, point), prior.at(vector, point)
        of_gains = (*prior.of_gains(counts, vector), 0.0)
        return tuple(a + b + c for a, b, c in zip(of_forces, of_prior, of_gains, strict=True))  # pyright: ignore

    lower, upper = space.lower, space.upper
    cost, gradient, curvature = at(vector)
    for number in range(SOLVER.steps):
        step = solve_in_box(curvature, gradient, lower - vector, upper - vector)
        if -(gradient @ step + step @ curvature @ step / 2) < SOLVER.converged:
            return vector, cost, number
        for _ in range(30):
            trial = np.clip(vector + step, lower, upper)
            if (reached := at(trial))[0] <= cost:
                break
            step = step / 2
        else:
            return vector, cost, number
        vector, (cost, gradient, curvature) = trial, reached
    return vector, cost, SOLVER.steps


def _pseudo_inertia(p: Float[np.ndarray, " 10"]) -> Float[np.ndarray, "4 4"]:
    """Second moments of the mass of a body by its standard parameters, see `STANDARD`."""
    mass, moment, (xx, yy, zz, xy, xz, yz) = p[0], p[1:4], p[4:]
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    second = np.trace(tensor) / 2 * np.eye(3) - tensor
    return np.block([[second, moment[:, None]], [moment[None], mass]])


def _squares(columns: Int[np.ndarray, "n m"]) -> tuple[Int[np.ndarray, "..."], ...]:
    """Indices of the square blocks of a matrix that some sets of columns make."""
    return columns[:, :, None], columns[:, None]


_BASIS = np.stack([_pseudo_inertia(row) for row in np.eye(10)])
