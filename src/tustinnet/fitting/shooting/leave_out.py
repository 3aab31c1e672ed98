"""Leave-one-group-out cost: how well records are explained by parameters of the others.

Nothing is fitted anew: about the end of a stage the cost of every group of segments is a quadratic
function of the parameters (`QuadraticCost`), of which `make_quadratic_cost` takes the terms from
the normal equations. Its methods return the cost where some parameters are fixed at given values.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from tustinnet.fitting.shooting.normal import eliminate_initial_states
from tustinnet.fitting.shooting.problem import Problem, SearchState, make_prior
from tustinnet.fitting.shooting.space import ParameterVector
from tustinnet.fitting.shooting.uncertainty import FEWEST_RECORDS

_ROUNDING = 1e-12  # of a curvature of 1: where two terms are one, the sum would be singular
FixedEntries = Mapping[int, float]  # entries of the vector that are fixed, by index


@dataclass(frozen=True)
class QuadraticCost:
    """The cost of each group about the end of a stage, by steps of its parameters.

        cost_g(s) = cost_g + 2 gradient_g' s + s' curvature_g s

    Initial states follow. Steps are in units in which the curvature of all groups is 1.

    Attributes:
        point: the parameters at the end of the stage, in these units, (n_p,).
        unit: factor from the entries of the vector to these units, (n_p,).
        cost: costs there, (n_g,).
        gradient: half the gradients, (n_g, n_p).
        curvature: half the second derivatives, (n_g, n_p, n_p).
        regularisation: curvature of the prior, and of what keeps steps small, (n_p,).
    """

    point: Float[np.ndarray, " n_p"]
    unit: Float[np.ndarray, " n_p"]
    cost: Float[np.ndarray, " n_g"]
    gradient: Float[np.ndarray, "n_g n_p"]
    curvature: Float[np.ndarray, "n_g n_p n_p"]
    regularisation: Float[np.ndarray, " n_p"]

    def best_vector(self, fixed: FixedEntries) -> ParameterVector:
        """Parameters that fit all groups best with some of them fixed, (n_p,)."""
        return (self.point + self._best_steps(fixed, *self._sums)[0]) / self.unit

    def best_cost(self, fixed: FixedEntries) -> float:
        """Cost of all groups with the parameters that fit all of them best."""
        return self._cost(self._best_steps(fixed, *self._sums))

    def leave_one_out_cost(self, fixed: FixedEntries) -> float:
        """Cost of all groups, each with the parameters that fit the others best."""
        gradient, curvature = self._sums
        return self._cost(
            self._best_steps(fixed, gradient - self.gradient, curvature - self.curvature)
        )

    @cached_property
    def _sums(self) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and curvature of all groups together, (1, n_p) and (1, n_p, n_p)."""
        regularisation = np.maximum(self.regularisation, _ROUNDING)
        curvature = self.curvature.sum(axis=0) + np.diag(regularisation)
        return self.gradient.sum(axis=0)[None], curvature[None]

    def _best_steps(
        self,
        fixed: FixedEntries,
        gradient: Float[np.ndarray, "n n_p"],
        curvature: Float[np.ndarray, "n n_p n_p"],
    ) -> Float[np.ndarray, "n n_p"]:
        """Steps to the minimum of each of n quadratic functions, with some parameters fixed."""
        steps, k = np.zeros_like(gradient), list(fixed)
        free = np.setdiff1d(np.arange(len(self.point)), k)
        steps[:, k] = np.array(list(fixed.values())) * self.unit[k] - self.point[k]
        free_gradient = gradient[:, free] + np.einsum(
            "gpr,gr->gp", curvature[:, free][:, :, k], steps[:, k]
        )
        free_curvature = curvature[:, free][:, :, free]
        steps[:, free] = -np.linalg.solve(free_curvature, free_gradient[:, :, None])[:, :, 0]
        return steps

    def _cost(self, steps: Float[np.ndarray, "n n_p"]) -> float:
        """The sum of the costs of all groups, each with a step of its own or all with one."""
        steps = np.broadcast_to(steps, self.gradient.shape)
        second = np.einsum("gpr,gr->gp", self.curvature, steps)
        return float(self.cost.sum() + np.sum((2 * self.gradient + second) * steps))


def make_quadratic_cost(
    problem: Problem, state: SearchState, reach: float, share: float
) -> QuadraticCost:
    """The second-order model of the cost about the end of a stage of segments.

    Groups are records, or parts of them where there are few.

    Args:
        problem: records and system.
        state: the state after the stage.
        reach: length of a step, over the largest parameter in its unit, that costs `share`.
        share: part of the cost.
    """
    result = state.last_result
    reduced = eliminate_initial_states(result.products)
    prior_curvature = make_prior(problem, state).curvature(state.space, result.vector)
    first_row = result.segments.first_row
    if len(problem.records) >= FEWEST_RECORDS:
        ends = np.cumsum([len(e) for e in problem.records])
        group = np.searchsorted(ends, first_row, side="right")
    else:
        count = min(8, len(first_row))
        group = np.arange(len(first_row)) * count // len(first_row)
    membership = (group[None, :] == np.unique(group)[:, None]).astype(float)
    curvature = np.einsum("gs,sij->gij", membership, reduced.matrices)
    unit = np.sqrt(np.maximum(np.diag(curvature.sum(axis=0)) + prior_curvature, 1e-300))
    gradient = membership @ reduced.gradients / unit
    point = result.vector * unit
    longest = reach * (np.abs(point).max(initial=0.0) or 1.0)
    return QuadraticCost(
        point=point,
        unit=unit,
        cost=membership @ result.products.cost,
        # at a bound the search has not brought the gradient to 0: a parameter there stays
        gradient=gradient - gradient.mean(axis=0),
        curvature=curvature / np.outer(unit, unit),
        regularisation=prior_curvature / unit**2 + share * result.cost / longest**2,
    )
