"""Optional terms of a system: those that the records do not need are left out."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

from tustinnet.errors import InputError
from tustinnet.fitting.shooting.forces import with_added
from tustinnet.fitting.shooting.least_squares import Limits
from tustinnet.fitting.shooting.left_out import Given, Quadratic, quadratic
from tustinnet.fitting.shooting.problem import Problem, State
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.fitting.shooting.stages import SearchStage, begun_with, run

_SWINGS = (1, 4)  # lengths of the segments, in quarters of a swing
_FEWEST = 4  # segments, for records to say something of one another
_LIMITS = Limits(1e-2, 15)
_NEEDED = 0.1  # share of the cost of records left out by which it rises without a needed term
_MOST = 3.0  # times the cost of all terms: with few segments, those left out say too little
_STEPS = (1e-2, 1e-1, 1.0)  # of it: terms that nobody would miss go first
_WORSE = 1.2  # times the cost that was foreseen: the second-order model did not hold so far
_HALVES = 2  # times that fewer terms are tried then
# of the largest parameter: where one that moves so far to make up for others costs as much as a
# term that is needed; less where the second-order model did not hold so far
_FAR = (10.0, 1.0, 0.1)


def with_needed(problem: Problem, begin: State) -> tuple[Problem, State]:
    """A problem without the optional terms that its records do not need, and where it begins.

    Many terms compete, so their first values come from simulations of short segments, not from
    the equations of motion on derived velocities, whose errors favour small inertias.

    A term is needed where records are explained worse without it by the parameters that the other
    records say, by 10 %, all other parameters following. Of several the last one goes first, so a
    system lists its terms from the plain to the special: over a small range of motion they can
    stand for one another. Then the rest is fitted and judged again, until every term is needed.
    Forces that a kept term brings are added last: short segments hardly show them.

    Args:
        problem: records and system.
        begin: where the search begins.

    Returns:
        Problem and beginning; as they are given where no term is optional.

    Raises:
        InputError: a system none of whose first values can be simulated.
    """
    if not set(problem.system.optional) & set(begin.space.names):
        return problem, begin
    fewer, found = _left_with(problem, *_first_fit(problem, begin))
    remarks = (*begin.remarks, _told(problem, fewer, found.space))
    fewer, found = _with_brought(fewer, found)
    # the search begins anew from here: its stages cut the records for themselves
    return fewer, State(
        found.space, found.vector, found.substeps, found.variance,
        horizons=begin.horizons, remarks=remarks, rough=True,
    )  # fmt: skip


def _with_brought(problem: Problem, state: State) -> tuple[Problem, State]:
    """The problem with the forces that come with the terms that were kept."""
    system = problem.system
    every = [force for p in system.parameters for force in p.brings]
    brought = [force for force in dict.fromkeys(every) if force not in system.added]
    if not brought:
        return problem, state
    values = state.space.numbers(state.vector)
    more = with_added(system, brought, problem.records, values)
    new = [p for p in more.parameters if p not in system.parameters]
    fixed = {p.name: p.nominal for p in new if p.fixed}
    space = Space(
        (*state.space.searched, *(p for p in new if not p.fixed)), dict(state.space.fixed) | fixed
    )
    vector = space.clipped(space.vector(values | {p.name: p.nominal for p in new}))
    return replace(problem, system=more), replace(state, space=space, vector=vector)


def _told(problem: Problem, fewer: Problem, space: Space) -> str:
    """Which terms were kept, and which of them at a usual value."""
    kept, count = fewer.system.optional, len(problem.system.optional)
    each = [f"{n} at {space.fixed[n]:g}" if n in space.fixed else n for n in kept]
    told = f"optional terms: {len(kept)} of {count} kept ({', '.join(each) or 'none'})"
    others = "; without any of the others, records that are left out are explained as well"
    return told + (others if len(kept) < count else "")


def _first_fit(problem: Problem, begin: State) -> tuple[State, SearchStage]:
    """All terms, fitted to short segments, of which there are several; and how."""
    stages = [SearchStage(problem.first, _LIMITS, swings) for swings in _SWINGS]
    state, last = run(problem, begun_with(problem, begin), stages[0]), stages[0]
    for stage in stages[1:]:
        longer = run(problem, state, stage)
        if longer.segments and len(longer.segments.first) >= _FEWEST:
            state, last = longer, stage
    if state.fitted is None or state.fitted.why == "diverged":
        raise InputError(
            f"system '{problem.system.name}'", "first values that simulate to infinity",
            "values that stay finite", "give others in the recipe: model.begin",
        )  # fmt: skip
    return state, last


def _left_with(problem: Problem, state: State, stage: SearchStage) -> tuple[Problem, State]:
    """The problem with the terms that are needed, and the state fitted to it."""
    for far in _FAR:
        while (trial := _one_round(problem, state, stage, far)) is not None:
            problem, state = trial
    return problem, state


def _one_round(
    problem: Problem, state: State, stage: SearchStage, far: float
) -> tuple[Problem, State] | None:
    """What is left after leaving out all that seems not needed, or half of it, or a quarter.

    None where every term is needed, or where no fit without some of them was as foreseen.
    """
    assert state.fitted is not None
    model = quadratic(problem, state, far, _NEEDED)
    given = _not_needed(model, _choices(problem, state.space))
    for _ in range(1 + _HALVES):
        if not given:
            return None
        trial = _with_given(problem, state, given, model.vector(given))
        ended = run(*trial, stage)
        most = _WORSE * max(state.fitted.cost, model.cost_of(given))
        if ended.fitted and ended.fitted.cost <= most:
            return trial[0], ended
        given = dict(list(given.items())[: len(given) // 2])
    return None


def _choices(problem: Problem, space: Space) -> dict[int, tuple[float, ...]]:
    """Where optional parameters may be given, 0 or a usual value; entries of the vector."""
    optional = {p.name: p for p in problem.system.parameters if p.optional}
    found = {}
    for i, name in enumerate(space.names):
        if name in optional:
            width = optional[name].upper - optional[name].lower
            found[i] = (0.0, *(x / width for x in optional[name].usual))
    return found


def _with_given(
    problem: Problem, state: State, given: Given, vector: Searched
) -> tuple[Problem, State]:
    """The problem without terms that are given as 0, others fixed; the state at a vector."""
    space = state.space
    values = space.numbers(space.clipped(vector))
    gone = {space.names[i] for i, x in given.items() if x == 0}
    fixed = {space.names[i]: values[space.names[i]] for i, x in given.items() if x != 0}
    fewer = Space(
        tuple(p for i, p in enumerate(space.searched) if i not in given),
        dict(space.fixed) | fixed,
    )
    return (
        replace(problem, system=problem.system.without(gone)),
        replace(state, space=fewer, vector=fewer.vector(values)),
    )


def _not_needed(model: Quadratic, choices: Mapping[int, Sequence[float]]) -> dict[int, float]:
    """The terms that are not needed, and where they are given, in the order in which they go.

    Those with usual values go last, and are tried there after all others: while another term is
    free, it could make up for a usual value that is wrong.
    """
    given: dict[int, float] = {}
    lowest, most = model.cost_left_out(given), _MOST * model.cost_of(given)
    plain, tied = (
        [i for i, x in choices.items() if (len(x) > 1) == more] for more in (False, True)
    )
    rounds = [(plain, slice(1)), (tied, slice(1)), (tied, slice(1, None))]
    for (some, where), share in itertools.product(rounds, _STEPS):
        going = True
        while going:
            going = False
            for i in sorted(set(some) - given.keys(), reverse=True):
                costs = {x: model.cost_left_out({**given, i: x}) for x in choices[i][where]}
                best = min(costs, key=costs.__getitem__)
                fair = model.cost_of({**given, i: best}) <= most
                if fair and costs[best] <= (1 + share * _NEEDED) * lowest:
                    given[i], lowest, going = best, min(lowest, costs[best]), True
    return given
