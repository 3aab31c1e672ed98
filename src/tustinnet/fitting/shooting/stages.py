"""The stages of a search: from first values over longer and longer segments to whole records.

Records along which errors grow without end stay in segments; see `growth`.

A stage is data, and takes the state of the search to the next one; nothing is changed in place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from tustinnet.errors import InputError
from tustinnet.fitting.listener import Iteration, StageResult
from tustinnet.fitting.residual import robust_weights
from tustinnet.fitting.shooting import growth, inverse_dynamics
from tustinnet.fitting.shooting.identifiability import confounded
from tustinnet.fitting.shooting.least_squares import (
    Cost,
    Fitted,
    Limits,
    minimise,
)
from tustinnet.fitting.shooting.problem import Problem, State, errors_of, prior, score
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import Space
from tustinnet.simulate.horizon import pieces
from tustinnet.simulate.substeps import PROBED_SECONDS, enough_substeps

_TARGET = 0.25  # integration error allowed, in encoder counts: less than rounding to them makes
_TARGET_SPAN = 1e-5  # or of the largest travel, where no count is known
_SWINGS = (4, 16)  # lengths of the first stages' segments, in quarters of a swing
_REFIT = Limits(1e-2, 6)  # near enough to compare
_REWEIGHTED = 20  # times at most, with weights from the residuals before
_SETTLED = 1e-5  # change of a logarithm, or of a range


@dataclass(frozen=True)
class SearchStage:
    """A stage.

    Attributes:
        initial: how initial states are treated: anchored, unanchored, or a start.
        limits: when it ends.
        swings: length of the segments in quarters of a swing, None for whole records.
    """

    initial: str
    limits: Limits
    swings: int | None = None


def search(problem: Problem, state: State) -> tuple[State, str]:
    """All stages; the state at the end, and how initial states were treated."""
    begun = reduce(
        lambda now, step: step(problem, now), (_without_confounded, _first_values), state
    )
    rough = _chosen_substeps(problem, _run_all(problem, begun, _first_stages(problem, begun)))
    wanted = problem.search.initial
    if wanted == "choose":
        rough, wanted = _better(problem, rough)
    last = Limits(problem.search.tolerance, problem.search.iterations)
    return _settled(problem, rough, SearchStage(wanted, last)), wanted


def refined(problem: Problem, state: State, initial: str) -> State:
    """The last stage once more, for a problem that is a little different."""
    last = Limits(problem.search.tolerance, problem.search.iterations)
    return _settled(problem, _chosen_substeps(problem, state), SearchStage(initial, last))


def _first_stages(problem: Problem, begun: State) -> list[SearchStage]:
    longest = max(begun.horizons.get(e.name, len(e) - 1) for e in problem.records)
    short = [s for s in _SWINGS if s * problem.motion.length < longest]
    return [
        *(SearchStage(problem.first, Limits(0.1, 20), swings) for swings in short),
        SearchStage(problem.first, Limits(1e-2, 30)),
    ]


def _better(problem: Problem, rough: State) -> tuple[State, str]:
    """Anchored or not: the better free run on the validation records decides."""
    if not problem.validation:
        return rough, "anchored"
    loose = run(problem, rough, SearchStage("unanchored", Limits(1e-2, 15)))
    found = ((rough, "anchored"), (loose, "unanchored"))
    return min(found, key=lambda entry: score(problem, entry[0]))


def _run_all(problem: Problem, state: State, stages: Sequence[SearchStage]) -> State:
    """The state after several stages; the better the values, the better the horizons."""
    return reduce(lambda now, stage: _with_horizons(problem, run(problem, now, stage)), stages,
                  state)  # fmt: skip


def _with_horizons(problem: Problem, state: State) -> State:
    """The state with how long each record can be simulated by the values so far."""
    every = (*problem.records, *problem.validation)
    found = problem.asked
    if found is None:
        length = problem.motion.length
        known = (every, problem.picks(every))
        found = growth.horizons(problem.system, state.space, state.vector, known, length)
    return replace(state, horizons=found)


def run(problem: Problem, state: State, stage: SearchStage) -> State:
    """The state after a stage."""
    length = stage.swings and stage.swings * problem.motion.length
    segments = problem.segments(length, stage.initial, state.horizons)
    if state.weights is not None:
        segments = replace(segments, weight=segments.weight * np.sqrt(state.weights))
    cost = Cost(
        problem.system, problem.residual, state.space, segments, prior(problem, state),
        # over a few swings the integration error stays far below what the first stages leave
        state.substeps if length is None else max(1, state.substeps // 2),
    )  # fmt: skip

    name = f"{_told(problem, state, length)}, {stage.initial} start"

    def told(iterations: int, value: float, damping: float) -> None:
        problem.listener.on_iteration(Iteration(name, iterations, value, damping, stage.initial))

    fitted = minimise(cost, state.vector, stage.limits, told)
    values = state.space.numbers(fitted.vector)
    problem.listener.on_stage(
        StageResult(name, stage.initial, fitted.iterations, fitted.cost, fitted.why, values)
    )
    known = fitted.cost / len(problem.records) if fitted.why != "diverged" else state.variance
    weights = _weights(problem, segments, fitted) if fitted.why != "diverged" else state.weights
    return replace(
        state, vector=fitted.vector, fitted=fitted, segments=segments, variance=known,
        weights=weights,
    )  # fmt: skip


def _settled(problem: Problem, state: State, stage: SearchStage) -> State:
    """The state after the last stage, again with new weights until these change nothing."""
    ended = run(problem, state, stage)
    for _ in range(_REWEIGHTED if problem.search.robust != "none" else 0):
        before = ended.vector
        ended = run(problem, ended, stage)
        moved = np.abs(ended.vector - before).max()
        if ended.fitted is None or ended.fitted.why == "diverged" or moved < _SETTLED:
            break
    return ended


def _weights(problem: Problem, segments: Segments, fitted: Fitted) -> np.ndarray | None:
    """What the residuals of a stage weigh in the next one, None where all weigh the same."""
    if problem.search.robust == "none":
        return None
    errors = np.zeros_like(segments.target)
    for row, error in enumerate(fitted.normal.error):
        errors[segments.samples(row)] = error
    return robust_weights(problem.search.robust, errors, problem.records[0].channels.resolution)


def _told(problem: Problem, state: State, length: int | None) -> str:
    """What a stage is called."""
    dt = problem.motion.dt
    if length is not None:
        return f"segments of {length * dt:.2g} s"
    limits = [state.horizons[e.name] for e in problem.records if e.name in state.horizons]
    if not limits:
        return "whole records"
    some = (
        "" if len(limits) == len(problem.records) else f"whole records, {len(limits)} of them in "
    )
    return f"{some}segments of {min(limits) * dt:.2g} s"


def refitted(problem: Problem, state: State, segments: Segments) -> Fitted:
    """The parameters that fit other segments best, sought from where a search is."""
    cost = Cost(
        problem.system,
        problem.residual,
        state.space,
        segments,
        prior(problem, state),
        state.substeps,
    )
    return minimise(cost, state.vector, _REFIT)


def _without_confounded(problem: Problem, state: State) -> State:
    """One parameter of every set that the records cannot tell apart is fixed."""
    space, vector = state.space, state.vector
    s = problem.segments(_SWINGS[0] * problem.motion.length, problem.first, state.horizons)
    products = problem.products(space, vector, s, 1).pp.sum(axis=0)
    if not np.isfinite(products).all():
        told = "the first values simulate to infinity; identifiability was not checked"
        return replace(state, remarks=(*state.remarks, told))
    directions = confounded(space, vector, products)
    if not directions:
        return state
    names = {direction.suggestion for direction in directions}
    numbers = space.numbers(vector)
    searched = tuple(p for p in space.searched if p.name not in names)
    if not searched:
        raise InputError(
            f"system '{problem.system.name}'",
            "; ".join(str(direction) for direction in directions),
            "records that say something of at least one parameter",
        )
    fewer = Space(searched, dict(space.fixed) | {name: numbers[name] for name in names})
    told = [f"{direction}; here it was fixed at its first value" for direction in directions]
    return replace(
        state, space=fewer, vector=fewer.vector(numbers), remarks=(*state.remarks, *told)
    )


def begun_with(problem: Problem, state: State) -> State:
    """The state with horizons and integration steps for the values that it has."""
    return _chosen_substeps(problem, _with_horizons(problem, state))


def _first_values(problem: Problem, state: State) -> State:
    """Least squares on the equations of motion, and what they leave of the worst record."""
    if state.rough:
        return begun_with(problem, state)
    found, shares = inverse_dynamics.first_values(
        problem.system, state.space, state.vector, problem.motion
    )
    left = float(shares.max())
    name, values = "first values", state.space.numbers(found)
    problem.listener.on_iteration(Iteration(name, 1, left, 0.0))
    problem.listener.on_stage(StageResult(name, "", 1, left, "converged", values))
    return begun_with(problem, replace(state, vector=found, unexplained=left))


def _chosen_substeps(problem: Problem, state: State) -> State:
    """Integration steps in a period, by the error target, unless they are given."""
    if problem.search.substeps:
        return replace(state, substeps=problem.search.substeps)
    counts = [r for r in problem.records[0].channels.resolution if r]
    reach = max(float(np.abs(e.q - e.q[-1]).max()) for e in problem.records)
    target = _TARGET * min(counts) if counts else _TARGET_SPAN * reach
    probed = max(2, round(PROBED_SECONDS / problem.records[0].dt))
    parts = problem.free_runs(
        [pieces(e, state.horizons.get(e.name), problem.start)[0][:probed] for e in problem.records]
    )
    chosen = enough_substeps(lambda n: np.concatenate(errors_of(problem, state, parts, n)), target)
    return replace(state, substeps=chosen)
