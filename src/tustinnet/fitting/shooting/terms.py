"""Optional terms of a system: those that the records do not need are left out."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tustinnet.errors import InputError
from tustinnet.fitting.shooting.least_squares import Limits, eliminated, prior_deviation
from tustinnet.fitting.shooting.problem import Problem, State, prior
from tustinnet.fitting.shooting.space import Space
from tustinnet.fitting.shooting.stages import SearchStage, begun_with, run

_SWINGS = (1, 4)  # lengths of the segments, in quarters of a swing
_LIMITS = Limits(1e-2, 15)
_NEEDED = 1e-2  # share of the cost by which it rises, at least, without a term that is needed
_STEPS = (1e-2, 1e-1, 1.0)  # of it: terms that nobody would miss go first
_WORSE = 1.2  # times the cost with all terms: too much was left out
# of the largest term: a parameter that moves so far to make up for others costs as much as a term
# that is needed; less where the second-order model did not hold so far
_FAR = (10.0, 1.0, 0.1)


def with_needed(problem: Problem, begin: State) -> tuple[Problem, State]:
    """A problem without the optional terms that its records do not need, and where it begins.

    Many terms compete, so their first values come from simulations of short segments, not from
    the equations of motion on derived velocities, whose errors favour small inertias.

    A term is not needed where the cost rises by less than 1 % without it, by its second-order
    model in which all other parameters follow. Of several the last one goes first, so a system
    lists its terms from the plain to the special: over a small range of motion they can stand for
    one another. Then the rest is fitted again, and judged again, until every term is needed, or
    the cost would be more than a fifth above that of all terms.

    Args:
        problem: records and system.
        begin: where the search begins.

    Returns:
        Problem and beginning; as they are given where no term is optional.

    Raises:
        InputError: a system none of whose first values can be simulated.
    """
    known = set(problem.system.optional) & set(begin.space.names)
    if not known:
        return problem, begin
    state = begun_with(problem, begin)
    for swings in _SWINGS:
        state = run(problem, state, SearchStage(problem.first, _LIMITS, swings))
    if state.fitted is None or state.fitted.why == "diverged":
        raise InputError(
            f"system '{problem.system.name}'", "first values that simulate to infinity",
            "values that stay finite", "give others in the recipe: model.begin",
        )  # fmt: skip
    fewer, found, most = problem, state, _WORSE * state.fitted.cost
    for far in _FAR:
        while left_out := _not_needed(fewer, found, far):
            trial, fitted = _without(fewer, found, *left_out)
            if fitted.fitted is None or not fitted.fitted.cost <= most:
                break
            fewer, found = trial, fitted
    kept, count = fewer.system.optional, len(problem.system.optional)
    told = (
        f"optional terms: {len(kept)} of {count} kept ({', '.join(kept) or 'none'}); without any "
        "of the others the error hardly rises"
    )
    # the search begins anew from here: its stages cut the records for themselves
    return fewer, State(
        found.space, found.vector, found.substeps, found.variance,
        horizons=begin.horizons, remarks=(*begin.remarks, told), rough=True,
    )  # fmt: skip


def _without(
    problem: Problem, state: State, left_out: set[str], vector: Float[np.ndarray, " n_p"]
) -> tuple[Problem, State]:
    """The problem without some terms, and the state fitted to it from a vector of before."""
    space = state.space
    fewer = Space(
        tuple(p for p in space.searched if p.name not in left_out),
        {n: x for n, x in space.fixed.items() if n not in left_out},
    )
    begun = fewer.clipped(fewer.vector(space.numbers(space.clipped(vector))))
    changed = replace(problem, system=problem.system.without(left_out))
    last = SearchStage(problem.first, _LIMITS, _SWINGS[-1])
    return changed, run(changed, replace(state, space=fewer, vector=begun), last)


def _not_needed(
    problem: Problem, state: State, far: float
) -> tuple[set[str], Float[np.ndarray, " n_p"]] | None:
    """The terms to leave out, and the vector that makes up for them; None where all are needed.

    With the curvature `H` and its inverse over the parameters that are left, setting the i-th of
    them from `x` to 0 raises the cost by `x^2 / (H^-1)_ii`; the others move by
    `-x (H^-1)_ji / (H^-1)_ii`.
    """
    fitted, space = state.fitted, state.space
    assert fitted is not None
    known = prior(problem, state)
    matrix = eliminated(fitted.normal)[0].sum(axis=0)
    matrix += np.diag(known.weight * prior_deviation(known, space, fitted.vector)[1] ** 2)
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    x, left, gone = fitted.vector * size, list(range(len(size))), set[str]()
    optional = np.isin(space.names, problem.system.optional)
    reach = far * (np.abs(x[optional]).max(initial=0.0) or 1.0)
    matrix = matrix / np.outer(size, size) + _NEEDED * fitted.cost / reach**2 * np.eye(len(size))
    for share in _STEPS:
        while True:
            inverse = np.linalg.inv(matrix[np.ix_(left, left)])
            rises = x[left] ** 2 / np.diag(inverse)
            low = np.flatnonzero(rises < share * _NEEDED * fitted.cost)
            can = [at for at in low if optional[left[at]]]
            if not can:
                break
            at = can[-1]
            x[left] -= inverse[:, at] * x[left[at]] / inverse[at, at]
            gone.add(space.names[left.pop(at)])
    return (gone, x / size) if gone else None
