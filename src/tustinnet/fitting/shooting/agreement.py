"""Agreement of the records: do parameters fitted to some of them contradict those of others?

`find_disagreements` takes a problem and the state after its search. It compares the records of
each value of a group with those of every other value, and single records with all others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
import scipy.special
from jaxtyping import Float

from tustinnet.fitting.report import Disagreement, Side
from tustinnet.fitting.shooting.least_squares import StoppingRule, minimise
from tustinnet.fitting.shooting.normal import eliminate_initial_states
from tustinnet.fitting.shooting.problem import Problem, SearchState, make_cost_function
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.uncertainty import (
    FEWEST_RECORDS,
    estimate_uncertainty,
    lag_correlation,
)
from tustinnet.signals.outliers import TO_DEVIATION

_MOST_SUSPECTS = 1 / 3  # of the records
_LARGE_FREEDOM = 1000.0  # degrees of freedom of errors from J'J
_CLOSE = StoppingRule(1e-2, 6)  # near enough to compare


class AgreementLevels(NamedTuple):
    """Levels from which on estimates from different records disagree.

    All are set by hand, not measured.

    Attributes:
        chance: chance of a difference in any comparison of a kind, where none is real.
        least: share of a value, or of a range: less is no disagreement that matters.
        suspect: distance from the median of all records, in robust standard deviations.
        information: share of the information of all records, below which a parameter is not
            determined.
    """

    chance: float = 0.01
    least: float = 0.01
    suspect: float = 5.0
    information: float = 1e-6


AGREEMENT = AgreementLevels()


@dataclass(frozen=True)
class _PartialEstimate:
    """Parameters fitted to some of the records, in the coordinates of the search.

    Attributes:
        name: which records.
        vector: the parameters.
        variance: variances of their errors, infinite where these do not determine them.
        freedom: degrees of freedom of the variances.
    """

    name: str
    vector: ParameterVector
    variance: Float[np.ndarray, " n_p"]
    freedom: float


def find_disagreements(problem: Problem, state: SearchState) -> tuple[Disagreement, ...]:
    """Finds parameters on which records disagree beyond their errors.

    Returns:
        First the disagreements between values of a group that no parameter is per, then those
        between a single record and all others, the clearest first; none after a search that
        diverged.
    """
    if state.has_diverged:
        return ()
    return (*_between_groups(problem, state), *_between_records(problem, state))


def _between_groups(problem: Problem, state: SearchState) -> list[Disagreement]:
    """Parameters on which the records of two values of a group disagree."""
    records, disagreements = problem.records, []
    modelled = {p.per for p in problem.system.grouped}
    for group in sorted({name for e in records for name, _ in e.groups} - modelled):
        estimates = []
        for value in sorted({value for e in records if (value := e.group(group)) is not None}):
            rows = [i for i, e in enumerate(records) if e.group(group) == value]
            estimate = _fit_records(problem, state, f"{group}={value}", rows)
            if estimate is not None:
                estimates.append(estimate)
        pairs = list(combinations(estimates, 2))
        for one, other in pairs:
            variance = one.variance + other.variance
            freedom = min(one.freedom, other.freedom)
            disagreements += _differences(
                state.space, one, other, variance, freedom, len(pairs), group
            )
    return sorted(disagreements, key=lambda d: d.chance)


def _between_records(problem: Problem, state: SearchState) -> list[Disagreement]:
    """Parameters on which a record contradicts the others, beyond how these scatter.

    The scatter of the others is that of their estimates, so that what a model lacks in every
    record makes none of them stand out.
    """
    records = problem.records
    suspects = _find_suspects(state, len(records))
    if not suspects:
        return []
    others = [i for i in range(len(records)) if i not in suspects]
    rest = _fit_records(problem, state, f"the {len(others)} others", others)
    disagreements: list[Disagreement] = []
    for i in suspects:
        alone = _fit_records(problem, state, records[i].name, [i])
        if rest is None or alone is None:
            continue
        # one record scatters by sqrt(n) more than the estimate from n of them
        scatter = rest.variance * len(others) if rest.freedom < _LARGE_FREEDOM else 0.0
        variance = np.maximum(alone.variance, scatter) + rest.variance
        disagreements += _differences(
            state.space, alone, rest, variance, rest.freedom, len(records), group=""
        )
    return sorted(disagreements, key=lambda d: d.chance)


def _find_suspects(state: SearchState, n_records: int) -> list[int]:
    """Records whose own estimate, to first order, is far from the median of all."""
    if n_records < FEWEST_RECORDS:
        return []
    result = state.last_result
    reduced, first = eliminate_initial_states(result.products), result.segments.first_of_records
    matrices = np.add.reduceat(reduced.matrices, first)
    gradients = np.add.reduceat(reduced.gradients, first)
    matrices = matrices + 0.01 * matrices.mean(
        axis=0
    )  # directions that a record does not determine: as all
    unit = np.sqrt(np.maximum(np.einsum("spp->sp", matrices), 1e-300))
    inverses = np.linalg.pinv(
        matrices / unit[:, :, None] / unit[:, None, :], rcond=1e-10, hermitian=True
    )
    steps = -np.einsum("spq,sq->sp", inverses, gradients / unit) / unit
    distance = np.abs(steps - np.median(steps, axis=0))
    usual = TO_DEVIATION * np.median(distance, axis=0)
    least = AGREEMENT.least / AGREEMENT.suspect
    largest = np.max(distance / np.maximum(usual, least), axis=1, initial=0.0)
    worst = np.argsort(-largest)[: int(n_records * _MOST_SUSPECTS)]
    return [int(i) for i in worst if largest[i] > AGREEMENT.suspect]


def _fit_records(
    problem: Problem, state: SearchState, name: str, records: Sequence[int]
) -> _PartialEstimate | None:
    """Fits the parameters to some of the records, given by index; None where that diverges."""
    space, whole = state.space, state.last_result
    segments = whole.segments.for_records(records)
    cost = make_cost_function(problem, state, segments, state.substeps)
    result = minimise(cost, state.vector, _CLOSE, x0=whole.continue_in(segments))
    if result.status == "diverged" or not np.isfinite(result.products.cost).all():
        return None
    part_information, information = (
        np.einsum("spp->p", eliminate_initial_states(products).matrices)
        for products in (result.products, whole.products)
    )
    informed = space.inside(result.vector) & (
        part_information > AGREEMENT.information * information
    )
    curvature = cost.prior.curvature(space, result.vector)
    uncertainty = estimate_uncertainty(result.products, segments, curvature, informed)
    is_clustered, freedom = uncertainty.clustered is not None, float(len(records) - 1)
    variance = np.diag(uncertainty.trusted if is_clustered else uncertainty.naive).copy()
    if not is_clustered:
        lag = lag_correlation(result.products.error)
        correlation = float(np.clip(np.max(np.abs(lag)), 0.0, 0.999))
        variance = variance * (1 + correlation) / (1 - correlation)
        freedom = _LARGE_FREEDOM
    return _PartialEstimate(name, result.vector, np.where(informed, variance, np.inf), freedom)


def _differences(
    space: SearchSpace,
    one: _PartialEstimate,
    other: _PartialEstimate,
    variance: Float[np.ndarray, " n_p"],
    freedom: float,
    comparisons: int,
    group: str,
) -> list[Disagreement]:
    """Parameters on which two estimates differ by more than chance (Bonferroni).

    Args:
        space: the search space.
        one: an estimate.
        other: the other.
        variance: variances of their difference, (n_p,).
        freedom: degrees of freedom of these.
        comparisons: how many pairs of estimates are compared in all.
        group: the group that divides the records, empty for single records.
    """
    distance = np.abs(one.vector - other.vector)
    disagreements = []
    for j, p in enumerate(space.free_parameters):
        if not (np.isfinite(variance[j]) and variance[j] > 0 and distance[j] > AGREEMENT.least):
            continue
        t = distance[j] / np.sqrt(variance[j])
        single = 2 * float(scipy.special.stdtr(freedom, -t))
        chance = min(1.0, single * comparisons * len(space.free_parameters))
        if chance < AGREEMENT.chance:
            side, other_side = (
                Side(
                    estimate.name,
                    space.to_values_in_range(estimate.vector)[p.name],
                    float(np.sqrt(estimate.variance[j]))
                    * abs(float(space.derivatives(estimate.vector)[j])),
                )
                for estimate in (one, other)
            )
            disagreements.append(Disagreement(p.name, p.unit, group, (side, other_side), chance))
    return disagreements
