"""How well groups of records are explained by what the other groups say, without a new fit."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from tustinnet.fitting.shooting.least_squares import eliminated, prior_deviation
from tustinnet.fitting.shooting.problem import Problem, State, prior

_GROUPS = 8  # into which the segments of fewer than 4 records are dealt
_FEWEST = 4
_TINY = 1e-300

Given = Mapping[int, float]  # parameters that do not follow, by place, and their entries


@dataclass(frozen=True)
class Quadratic:
    """The cost of each group about where a search ended, by steps of its parameters.

        cost_g(s) = cost_g + 2 gradient_g' s + s' curvature_g s

    Initial states follow. Steps are in units in which the curvature of all groups is 1.

    Attributes:
        at: where the search ended, in these units, (n_p,).
        unit: of each parameter, (n_p,).
        cost: (n_g,).
        gradient: (n_g, n_p).
        curvature: (n_g, n_p, n_p).
        held: what is known beforehand, and what keeps steps small, (n_p,).
    """

    at: Float[np.ndarray, " n_p"]
    unit: Float[np.ndarray, " n_p"]
    cost: Float[np.ndarray, " n_g"]
    gradient: Float[np.ndarray, "n_g n_p"]
    curvature: Float[np.ndarray, "n_g n_p n_p"]
    held: Float[np.ndarray, " n_p"]

    def vector(self, given: Given) -> Float[np.ndarray, " n_p"]:
        """The parameters that fit all groups best with some that are given."""
        return (self.at + self._steps(given, *self._all)[0]) / self.unit

    def cost_of(self, given: Given) -> float:
        """The cost of all groups with these parameters."""
        return self._cost(self._steps(given, *self._all))

    def cost_left_out(self, given: Given) -> float:
        """The same where each group is judged with the parameters that fit the others best."""
        gradient, curvature = self._all
        return self._cost(self._steps(given, gradient - self.gradient, curvature - self.curvature))

    @cached_property
    def _all(self) -> tuple[np.ndarray, np.ndarray]:
        """Gradient and curvature of all groups together, (1, n_p) and (1, n_p, n_p)."""
        curvature = self.curvature.sum(axis=0) + np.diag(self.held)
        return self.gradient.sum(axis=0)[None], curvature[None]

    def _steps(
        self,
        given: Given,
        gradient: Float[np.ndarray, "n n_p"],
        curvature: Float[np.ndarray, "n n_p n_p"],
    ) -> Float[np.ndarray, "n n_p"]:
        """The best steps by some sums, where some parameters go to where they are given."""
        steps, to = np.zeros_like(gradient), list(given)
        free = np.setdiff1d(np.arange(len(self.at)), to)
        steps[:, to] = np.array(list(given.values())) * self.unit[to] - self.at[to]
        pushed = gradient[:, free] + np.einsum(
            "gpr,gr->gp", curvature[:, free][:, :, to], steps[:, to]
        )
        inner = curvature[:, free][:, :, free]
        steps[:, free] = -np.linalg.solve(inner, pushed[:, :, None])[:, :, 0]
        return steps

    def _cost(self, steps: Float[np.ndarray, "n n_p"]) -> float:
        """The sum over the groups, each with its own step or all with one."""
        bent = np.einsum("gpr,gr->gp", self.curvature, np.broadcast_to(steps, self.gradient.shape))
        return float(self.cost.sum() + np.sum((2 * self.gradient + bent) * steps))


def quadratic(problem: Problem, state: State, far: float, share: float) -> Quadratic:
    """The second-order model of the cost where a stage ended.

    Args:
        problem: records and system.
        state: after a stage of segments.
        far: times the largest parameter, in its unit: a step that long costs `share`.
        share: of the cost.
    """
    fitted, segments = state.fitted, state.segments
    assert fitted is not None
    assert segments is not None
    matrices, gradients, _, _ = eliminated(fitted.normal)
    known = prior(problem, state)
    of_prior = known.weight * prior_deviation(known, state.space, fitted.vector)[1] ** 2
    group = _groups(problem, segments.first)
    belongs = (group[None, :] == np.unique(group)[:, None]).astype(float)
    curvature = np.einsum("gs,sij->gij", belongs, matrices)
    unit = np.sqrt(np.maximum(np.diag(curvature.sum(axis=0)) + of_prior, _TINY))
    gradient = belongs @ gradients / unit
    at = fitted.vector * unit
    reach = far * (np.abs(at).max(initial=0.0) or 1.0)
    return Quadratic(
        at=at,
        unit=unit,
        cost=belongs @ fitted.normal.cost,
        # where a parameter stands at an end of its range the search left a slope: it stays
        gradient=gradient - gradient.mean(axis=0),
        curvature=curvature / np.outer(unit, unit),
        held=of_prior / unit**2 + share * fitted.cost / reach**2,
    )


def _groups(problem: Problem, first: Int[np.ndarray, " n_s"]) -> Int[np.ndarray, " n_s"]:
    """Which group every segment belongs to: its record, or its part of few records."""
    if len(problem.records) >= _FEWEST:
        ends = np.cumsum([len(e) for e in problem.records])
        return np.searchsorted(ends, first, side="right")
    count = min(_GROUPS, len(first))
    return np.arange(len(first)) * count // len(first)
