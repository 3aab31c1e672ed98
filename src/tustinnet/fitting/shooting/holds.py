"""Holds of inputs that the data card calls unknown: the search is done for every hold.

A hold is what an input does between two samples. `search_over_holds` runs the stages of the
search, the final one for every hold, and chooses the holds by the cost over the training records.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import get_args

import numpy as np

from tustinnet.channels import Channels
from tustinnet.fitting.shooting.problem import Problem, SearchState
from tustinnet.fitting.shooting.stages import choose_substeps, run_final_stage, search
from tustinnet.signals.excitation import HALF, DeclaredHold

_USUAL = "zero-order"
_FIRST = "first-order"  # between the others, so that both are near enough to go on from it
_ALIKE = 1.01  # root mean squares of errors that differ by less are alike


def search_over_holds(problem: Problem, state: SearchState) -> tuple[Problem, SearchState]:
    """Searches for the parameters, and for the holds that the data card calls `unknown`.

    The whole search is done for straight lines; from its result, the final stage is done again
    for every other hold, and the lowest cost over the training records decides. The holds of
    several unknown inputs are taken to be alike. A search that is stopped chooses among the holds
    whose final stage was finished.

    Returns:
        The problem with the chosen holds, and the state after the final stage. Its remarks have
        the simulation error of every hold. A state that is stopped already stays as it is but for
        its remarks.
    """
    unknown = _unknown_holds(problem)
    others: list[DeclaredHold] = []
    if unknown:
        is_short = min(map(len, (*problem.records, *problem.validation))) <= HALF
        left_out = (_FIRST, "band-limited") if is_short else (_FIRST,)
        others = [hold for hold in get_args(DeclaredHold) if hold not in left_out]
    assumed = with_assumed_hold(problem)
    if not state.is_stopped:
        has_refit = problem.refit_start is not None
        state = search(assumed, state, later_stages=len(others) + has_refit)
    if not unknown:
        return assumed, state
    channel_names = " and ".join(f"'{n}'" for n in unknown)
    if state.is_stopped:
        remark = f"hold of {channel_names}: not searched for before the time limit; {_FIRST} taken"
        return assumed, replace(state, remarks=(*state.remarks, remark))
    trials = {_FIRST: (assumed, state)}
    finished, is_stopped = state.finished_stages, False
    for hold in others:
        other = _with_hold(problem, hold)
        other_state = replace(choose_substeps(other, state), finished_stages=finished)
        other_state = run_final_stage(other, other_state, state.initial_treatment)
        if other_state.is_stopped:
            is_stopped = True
            break
        finished = other_state.finished_stages
        trials[hold] = other, other_state

    costs = {
        hold: np.inf if trial.has_diverged else trial.last_result.cost
        for hold, (_, trial) in trials.items()
    }
    best = min(costs, key=lambda hold: costs[hold])
    position = problem.system.channels.position
    samples = sum(len(e) for e in problem.records)
    rmse = {}  # of all training samples [rad or m]
    for hold, (_, trial) in trials.items():
        errors = trial.last_result.products.error
        squares = sum(float(np.sum(error[:, position] ** 2)) for error in errors)
        rmse[hold] = float(np.sqrt(squares / samples))
    listed = describe_hold_errors(rmse, problem.system.channels)
    if max(rmse.values()) < _ALIKE * min(rmse.values()):
        remark = (
            f"hold of {channel_names}: makes no difference to the simulation error ({listed}); "
            f"{best} taken"
        )
    else:
        remark = (
            f"hold of {channel_names}: {best}, by the simulation error of the training records "
            f'({listed}); declare hold = "{best}" in the data card'
        )
    if is_stopped:
        remark += f"; the time limit left out {', '.join(h for h in others if h not in trials)}"
    problem, state = trials[best]
    return problem, replace(
        state,
        remarks=(*state.remarks, remark),
        hold_errors=rmse,
        finished_stages=finished,
        is_stopped=is_stopped,
    )


def describe_hold_errors(errors: Mapping[str, float], channels: Channels) -> str:
    """Text of the simulation errors by hold, the smallest first.

    Where coordinates have different units, errors are relative to that of one hold.

    Args:
        errors: root mean square position errors by hold [rad or m].
        channels: the coordinates.
    """
    ranked = sorted(errors, key=lambda hold: errors[hold])
    if len(channels.units) == 1:
        return ", ".join(f"{hold} {errors[hold]:.3g} {channels.unit}" for hold in ranked)
    usual = _FIRST if _USUAL not in errors else _USUAL
    shares = ", ".join(f"{hold} {errors[hold] / errors[usual]:.3g}" for hold in ranked)
    return f"by that of {usual}: {shares}"


def with_assumed_hold(problem: Problem) -> Problem:
    """The problem with a hold where none is known yet, so that records can be simulated."""
    return _with_hold(problem, _FIRST) if _unknown_holds(problem) else problem


def _unknown_holds(problem: Problem) -> list[str]:
    """Names of the inputs whose hold is unknown."""
    return [i.name for i in problem.records[0].inputs if i.hold == "unknown"]


def _with_hold(problem: Problem, hold: DeclaredHold) -> Problem:
    """The problem with a hold for all inputs whose hold is unknown."""
    inputs = [
        replace(i, hold=hold) if i.hold == "unknown" else i for i in problem.records[0].inputs
    ]
    return replace(
        problem,
        records=tuple(e.with_timing(inputs) for e in problem.records),
        validation=tuple(e.with_timing(inputs) for e in problem.validation),
    )
