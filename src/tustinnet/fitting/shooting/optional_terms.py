"""Optional terms of a system: those that the records do not need are left out.

`drop_unneeded_terms` takes a problem and the state to start from, fits all terms to short segments
and returns both without the terms that other records do not confirm (see `leave_out`).
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

from tustinnet.errors import InputError
from tustinnet.finding import make_finding
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.fitting.shooting.equation_error import estimate_by_equation_error
from tustinnet.fitting.shooting.least_squares import StoppingRule
from tustinnet.fitting.shooting.leave_out import QuadraticCost, make_quadratic_cost
from tustinnet.fitting.shooting.problem import Problem, SearchState
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.stages import (
    SearchStage,
    choose_substeps,
    run_stage,
    update_horizons,
)

_STOPPING = StoppingRule(1e-2, 15)
_NEEDED = 0.1  # share of the cost of records left out by which it rises without a needed term
_MOST_COST = 3.0  # times the cost of all terms: with few segments, those left out decide too little
_CLEARLY = 0.5  # times the cost from the initial values: another start is clearly better


def drop_unneeded_terms(problem: Problem, state: SearchState) -> tuple[Problem, SearchState]:
    """Drops the optional terms that the records do not need.

    Many terms compete, so their first values come from simulations of short segments, not from
    the equations of motion on derived velocities, whose errors favour small inertias.

    A term is needed where without it records are explained worse by 10 %, by the parameters that
    fit the other records, all other parameters following. Of several the last one goes first, so a
    system lists its terms from the plain to the special: over a small range of motion they can
    stand for one another. Then the rest is fitted and tested again, until every term is needed.
    Forces that a kept term brings are added last: short segments hardly show them.

    Args:
        problem: records and system.
        state: the initial values.

    Returns:
        Problem and initial values; unchanged where no term is optional. Where the search is
        stopped, the terms that were left and the state after the last fit of them.

    Raises:
        InputError: the simulations with the initial values diverge.
    """
    if not set(problem.system.optional) & set(state.space.names):
        return problem, state
    offered, remarks, recipe_horizons = problem.system.optional, state.remarks, state.horizons

    # all terms, fitted to short segments, of which there are several
    stage, longer_stage = (
        SearchStage(problem.early_initial_treatment, _STOPPING, quarters)
        for quarters in (1, 4)  # lengths of segments
    )
    state = _fit_from_best_start(problem, state, stage)
    if state.result is not None and state.has_diverged:
        raise InputError(
            f"system '{problem.system.name}'",
            "first values with which the simulations diverge",
            "values that stay finite",
            "give others in the recipe: model.begin",
        )
    longer = run_stage(problem, state, longer_stage)
    if not longer.is_stopped and longer.has_diverged:
        # terms that short segments do not determine can drive longer ones apart
        problem, state = _drop_all_unneeded(problem, state, stage)
        state = choose_substeps(problem, state)
        longer = run_stage(problem, state, longer_stage)
    if longer.is_stopped or (
        len(longer.last_result.segments.steps) >= 4 and not longer.has_diverged
    ):
        state, stage = longer, longer_stage
    problem, state = _drop_all_unneeded(problem, state, stage)
    if state.is_stopped:
        remaining = len(problem.system.optional)
        remark = make_finding("optional terms left", remaining=remaining, offered=len(offered))
        return problem, replace(state, remarks=(*remarks, remark))

    kept, fixed_values = problem.system.optional, state.space.fixed_values
    remark = make_finding(
        "optional terms dropped" if len(kept) < len(offered) else "optional terms",
        kept=len(kept),
        offered=len(offered),
        terms=[
            make_finding("term at", term=n, value=fixed_values[n]) if n in fixed_values else n
            for n in kept
        ],
        none=not kept,
    )

    problem, space, vector = _add_brought_forces(problem, state)
    # the search begins anew from here: its stages cut the records for themselves
    return problem, SearchState(
        space=space,
        vector=vector,
        substeps=state.substeps,
        variance=state.variance,
        horizons=recipe_horizons,
        remarks=(*remarks, remark),
        has_fitted_values=True,
    )


def _fit_from_best_start(problem: Problem, state: SearchState, stage: SearchStage) -> SearchState:
    """The state after a stage from the initial values, or from the equation-error estimate.

    From values without forces, stiff machines are not found: their periods need more integration
    steps than those of free motion. The estimate is tried where the stage has not converged, and
    taken where it is clearly better.

    Args:
        problem: records and system.
        state: the initial values.
        stage: the stage.
    """
    first = run_stage(problem, choose_substeps(problem, update_horizons(problem, state)), stage)
    if first.is_stopped or first.last_result.status == "converged":
        return first
    vector = estimate_by_equation_error(
        problem.system, state.space, state.vector, problem.motion
    ).vector
    estimate = update_horizons(problem, replace(state, vector=vector))
    other = run_stage(problem, choose_substeps(problem, estimate), stage)
    if other.is_stopped:
        return replace(first, is_stopped=True)
    return other if other.last_result.cost < _CLEARLY * first.last_result.cost else first


def _drop_all_unneeded(
    problem: Problem, state: SearchState, stage: SearchStage
) -> tuple[Problem, SearchState]:
    """Drops terms, and fits the others to the segments of a stage, until every term is needed.

    Args:
        problem: records and system.
        state: the state after the stage.
        stage: the stage.
    """
    # of the largest parameter: where one that moves so far to make up for others costs as much as a
    # term that is needed; less where the second-order model did not hold so far
    for reach in (10.0, 1.0, 0.1):
        while (
            not state.is_stopped
            and (reduced := _drop_some(problem, state, stage, reach)) is not None
        ):
            problem, state = reduced
    return problem, state


def _drop_some(
    problem: Problem, state: SearchState, stage: SearchStage, reach: float
) -> tuple[Problem, SearchState] | None:
    """Drops all terms that seem not needed, or half of them, or a quarter, and fits the others.

    None where every term is needed, or where no fit without some of them is as good as predicted;
    problem and state as they were where the fit is stopped.
    """
    cost, space = make_quadratic_cost(problem, state, reach, _NEEDED), state.space
    optional = {p.name: p for p in problem.system.parameters if p.optional}
    choices = {
        i: (0.0, *(x / (optional[name].upper - optional[name].lower) for x in optional[name].usual))
        for i, name in enumerate(space.names)
        if name in optional
    }
    fixed = _find_unneeded(cost, choices)
    for _ in range(3):  # fewer are dropped where the second-order model did not hold
        if not fixed:
            return None
        # terms at 0 are dropped, those at a usual value are fixed there
        values = space.to_values_in_range(space.clip(cost.best_vector(fixed)))
        dropped = {space.names[i] for i, x in fixed.items() if x == 0}
        usual = {space.names[i]: values[space.names[i]] for i, x in fixed.items() if x != 0}
        fewer = replace(problem, system=problem.system.without(dropped))
        fewer_space = space.without(dropped).fixing(usual)
        trial = replace(state, space=fewer_space, vector=fewer_space.to_vector(values))
        trial = run_stage(fewer, trial, stage)
        if trial.is_stopped:
            return problem, replace(state, is_stopped=True)
        predicted = max(state.last_result.cost, cost.best_cost(fixed))
        if trial.last_result.cost <= (1 + _NEEDED) * predicted:
            return fewer, trial
        fixed = dict(list(fixed.items())[: len(fixed) // 2])
    return None


def _find_unneeded(cost: QuadraticCost, choices: Mapping[int, Sequence[float]]) -> dict[int, float]:
    """Finds the terms that are not needed, in the order in which they go.

    Terms with usual values go last, and are tried there after all others: while another term is
    free, it could make up for a usual value that is wrong.

    Args:
        cost: the cost of the groups of segments.
        choices: for entries of optional parameters, the values to try: 0, then the usual ones.

    Returns:
        Entries of the vector and the value, of `choices`, where each costs least.
    """
    fixed: dict[int, float] = {}
    lowest, most = cost.leave_one_out_cost(fixed), _MOST_COST * cost.best_cost(fixed)
    plain = [i for i, values in choices.items() if len(values) == 1]
    with_usual = [i for i, values in choices.items() if len(values) > 1]
    rounds = [(plain, slice(1)), (with_usual, slice(1)), (with_usual, slice(1, None))]
    # terms that nobody would miss go first
    for (entries, part), share in itertools.product(rounds, (1e-2, 1e-1, 1.0)):
        has_changed = True
        while has_changed:
            has_changed = False
            for i in sorted(set(entries) - fixed.keys(), reverse=True):
                costs = {x: cost.leave_one_out_cost({**fixed, i: x}) for x in choices[i][part]}
                best = min(costs, key=costs.__getitem__)
                is_fair = cost.best_cost({**fixed, i: best}) <= most
                if is_fair and costs[best] <= (1 + share * _NEEDED) * lowest:
                    fixed[i], lowest, has_changed = best, min(lowest, costs[best]), True
    return fixed


def _add_brought_forces(
    problem: Problem, state: SearchState
) -> tuple[Problem, SearchSpace, ParameterVector]:
    """Adds the forces that the kept terms bring; new parameters are at their nominal values.

    What they bring only pulls back: a spring that pulls outwards beyond the motion of the records
    makes other motion run away.
    """
    system, space = problem.system, state.space
    forces = dict.fromkeys(force for p in system.parameters for force in p.brings)
    brought = [force for force in forces if force not in system.added]
    if not brought:
        return problem, space, state.vector
    values = space.to_values_in_range(state.vector)
    extended = with_added(system, brought, problem.records, values)
    new = [
        replace(p, lower=0.0) if p.nominal == 0.0 else p
        for p in extended.parameters
        if p not in system.parameters
    ]
    extended = replace(extended, parameters=(*system.parameters, *new))
    space = space.adding(new)
    vector = space.clip(space.to_vector(values | {p.name: p.nominal for p in new}))
    return replace(problem, system=extended), space, vector
