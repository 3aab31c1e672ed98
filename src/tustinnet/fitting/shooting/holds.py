"""What inputs do between samples, found out by trying."""

from dataclasses import replace
from typing import get_args

import numpy as np

from tustinnet.fitting.shooting.problem import Problem, State
from tustinnet.fitting.shooting.stages import refined, search
from tustinnet.fitting.shooting.terms import with_needed
from tustinnet.signals.excitation import HALF, DeclaredHold

_FIRST = "first-order"  # between the others, so that both are near enough to go on from it
_ALIKE = 1.01  # root mean squares of errors that differ by less say nothing


def search_with_holds(problem: Problem, begin: State) -> tuple[Problem, State, str]:
    """A search that also finds out the holds that the data card calls `unknown`.

    Optional terms of the system that are not needed are left out before it.

    The whole search is done for straight lines; from what it found, the last stage is done again
    for every other hold, and the lowest cost over the training records decides. The holds of
    several unknown inputs are taken to be alike.

    Returns:
        The problem with the holds found, and what `search` returns; the state's remarks tell the
        simulation error of every hold.
    """
    unknown = _unknown(problem)
    first, begin = with_needed(with_some_hold(problem), begin)
    if not unknown:
        return first, *search(first, begin)
    problem = replace(problem, system=first.system)
    found, initial = search(first, begin)
    tried = {_FIRST: (first, found)}
    holds: tuple[DeclaredHold, ...] = get_args(DeclaredHold)
    short = min(map(len, (*problem.records, *problem.validation))) <= HALF
    for hold in holds:
        if hold != _FIRST and not (short and hold == "band-limited"):
            other = _with_hold(problem, hold)
            tried[hold] = other, refined(other, found, initial)
    best = min(tried, key=lambda hold: _cost(tried[hold][1]))
    chosen, ended = tried[best]
    told = _told(unknown, best, {hold: _error(*of) for hold, of in tried.items()}, problem)
    ended = replace(ended, remarks=(*ended.remarks, told))
    return chosen, ended, initial


def with_some_hold(problem: Problem) -> Problem:
    """The problem with a hold where none is known yet, so that records can be simulated."""
    return _with_hold(problem, _FIRST) if _unknown(problem) else problem


def _unknown(problem: Problem) -> list[str]:
    return [i.name for i in problem.records[0].inputs if i.hold == "unknown"]


def _with_hold(problem: Problem, hold: DeclaredHold) -> Problem:
    inputs = [
        replace(i, hold=hold) if i.hold == "unknown" else i for i in problem.records[0].inputs
    ]
    return replace(
        problem,
        records=tuple(e.with_timing(inputs) for e in problem.records),
        validation=tuple(e.with_timing(inputs) for e in problem.validation),
    )


def _cost(state: State) -> float:
    return state.fitted.cost if state.fitted and state.fitted.why != "diverged" else np.inf


def _error(problem: Problem, state: State) -> float:
    """Root mean square of the simulation error over all training samples [rad or m]."""
    assert state.fitted is not None
    at = problem.system.channels.position
    squares = sum(float(np.sum(error[:, at] ** 2)) for error in state.fitted.normal.error)
    return float(np.sqrt(squares / sum(len(e) for e in problem.records)))


def _told(unknown: list[str], best: str, errors: dict[str, float], problem: Problem) -> str:
    unit = problem.system.channels.unit
    ranked = sorted(errors, key=lambda hold: errors[hold])
    each = ", ".join(f"{hold} {errors[hold]:.3g} {unit}" for hold in ranked)
    names = " and ".join(f"'{name}'" for name in unknown)
    if max(errors.values()) < _ALIKE * min(errors.values()):
        return (
            f"hold of {names}: makes no difference to the simulation error ({each}); {best} taken"
        )
    return (
        f"hold of {names}: {best}, by the simulation error of the training records ({each}); "
        f'declare hold = "{best}" in the data card'
    )
