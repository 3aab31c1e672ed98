"""Candidates of a plan that can take part in a selection, and why the others cannot."""

import math
from collections.abc import Sequence

from tustinnet.data.inspection import coordinate_timescales, rotating_coordinates
from tustinnet.errors import InputError
from tustinnet.finding import Finding, make_finding
from tustinnet.fits.timing import LAG
from tustinnet.fitting.arrangement import arrange_system
from tustinnet.fitting.inverse_dynamics.along import find_obstacle
from tustinnet.fitting.inverse_dynamics.cutoff import choose_cutoff
from tustinnet.fitting.inverse_dynamics.identification import are_all_driven
from tustinnet.fitting.roles import records_without_test
from tustinnet.fitting.task import resolve_system
from tustinnet.models.added import parse_forces, require_additions
from tustinnet.models.forces import LAWS
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.selection.jobs import RunContext
from tustinnet.selection.plan import Candidate, SelectionPlan
from tustinnet.systems.files import SystemTemplate


def applicable_candidates(
    plan: SelectionPlan, context: RunContext, budget: float | None
) -> tuple[list[Candidate], list[Finding]]:
    """The candidates for which everything is given, and findings on those for which not.

    Args:
        plan: the plan.
        context: the records and the system.
        budget: how long the selection may take [s], None for no limit.

    Raises:
        InputError: a budget of no time, a system that no candidate identifies, or no candidate
            that can take part.
    """
    if budget is not None and not 0 < budget < math.inf:
        raise InputError("`budget=`", f"{budget:g} s", "a time above 0")
    if context.system is not None and not any(_identifies(c) for c in plan.candidates):
        raise InputError(
            "`system=`",
            f"not applicable to the plan '{plan.name}'",
            "a plan with a candidate that identifies a system",
        )
    scales = coordinate_timescales(list(context.data)).values()
    speed = "fast" if any(scale.is_fast for scale in scales) else "slow"
    around = rotating_coordinates(records_without_test(context.data))
    all_turn = around == {c.name for c in context.data.channels.coordinates}
    omitted: dict[str, str] = {}  # the reason by candidate
    for c in plan.candidates:
        if reason := _reason_against(c, context, speed, all_turn=all_turn):
            omitted[c.name] = reason
        elif c.corrects and omitted.keys() >= set(c.corrects):
            omitted[c.name] = omitted[c.corrects[0]]
    findings = []
    for why in dict.fromkeys(omitted.values()):
        names = [name for name, reason in omitted.items() if reason == why]
        findings.append(make_finding("candidates left out", why=why, candidates=names))
    candidates = [c for c in plan.candidates if c.name not in omitted]
    if not candidates:
        where, expected = f"plan '{plan.name}'", "a candidate that can take part"
        raise InputError(where, "; ".join(f.text for f in findings), expected)
    return candidates, findings


def _reason_against(
    candidate: Candidate, context: RunContext, speed: str, *, all_turn: bool
) -> str:
    """Why a candidate cannot take part, empty if it can.

    Args:
        candidate: the candidate.
        context: the records and the system.
        speed: whether the records are `fast` or `slow`.
        all_turn: whether every coordinate turns around in them.
    """
    channels, reason = context.data.channels, ""
    if candidate.when in ("fast", "slow") and candidate.when != speed:
        reason = f"only for {candidate.when} records"
    elif LAG in _laws(candidate) and not channels.inputs:
        reason = "only for records with inputs"
    elif all_turn and _needs_limited_travel(candidate):
        reason = "only for coordinates with an end, and all turn around"
    elif channels.controller is not None and _ignores_controller(candidate):
        reason = "without the controller of the data card"
    elif candidate.when == "no-system" and context.system is not None:
        reason = "only without a system"
    elif _identifies(candidate):
        system = context.system_for(candidate.content)
        reason = _system_problem(system, context)
        if isinstance(system, LagrangianSystem) and not reason:
            reason = _force_problem(system, candidate)
    if not reason and candidate.when == "fully-actuated":
        problem = _inverse_dynamics_problem(context)
        reason = f"no inverse dynamics {problem}" if problem else ""
    return reason


def _system_problem(system: LagrangianSystem | SystemTemplate | None, context: RunContext) -> str:
    """Why a system cannot be identified from the records, empty if it can."""
    if system is None:
        return "requires a system (`system=`)"
    if isinstance(system, SystemTemplate):
        try:
            system.for_records(records_without_test(context.data))
        except InputError as error:
            return str(error)
    return ""


def _force_problem(system: LagrangianSystem, candidate: Candidate) -> str:
    """Why the forces of a candidate cannot be added to a system, empty if they can."""
    try:
        require_additions(system, parse_forces(system, _forces(candidate)))
    except InputError:
        return "the system has these forces already, or has no place for them"
    return ""


def adds_lag_alone(candidate: Candidate) -> bool:
    """Whether all that the recipe of a candidate adds is the lag of an actuator."""
    return _laws(candidate) == [LAG]


def _forces(candidate: Candidate) -> tuple[str, ...]:
    """The forces that the recipe of a candidate adds, as it has them."""
    return getattr(candidate.content.model, "forces", ())


def _laws(candidate: Candidate) -> list[str]:
    """The names of the forces that the recipe of a candidate adds."""
    return [force.partition(":")[0] for force in _forces(candidate)]


def _needs_limited_travel(candidate: Candidate) -> bool:
    return any(LAWS[name].needs_limited_travel for name in _laws(candidate) if name in LAWS)


def _identifies(candidate: Candidate) -> bool:
    return "system" in candidate.content.family.needs


def _ignores_controller(candidate: Candidate) -> bool:
    """Whether a controller in the loop of records has no use for the models of a candidate."""
    recipe = candidate.content
    made_for_records = isinstance(resolve_system(recipe, None), SystemTemplate)
    return made_for_records or not recipe.family.has_feedback


def _inverse_dynamics_problem(context: RunContext) -> str:
    """Why forces do not tell all parameters of the system that is given; empty if they do."""
    system, records = context.loaded_system, records_without_test(context.data)
    if system is None or isinstance(system, SystemTemplate):
        return "without equations of motion"
    try:
        system = arrange_system(system, records)
    except InputError:
        return ""  # what does not fit together is said by every candidate of the system
    if (obstacle := find_obstacle(system, records)) is not None:
        return obstacle.problem
    return "" if are_all_driven(system, records) else "as inputs are no forces on every coordinate"


def force_cutoff(context: RunContext, candidates: Sequence[Candidate]) -> float | None:
    """The frequency up to which forces along records are compared [Hz].

    None without a system, and where no candidate compares them.
    """
    if not any(c.content.is_by_forces for c in candidates):
        return None
    system, records = context.loaded_system, records_without_test(context.data)
    if system is None or isinstance(system, SystemTemplate):
        return None
    alone = [e.without_controller() for e in records]
    return choose_cutoff(arrange_system(system, records), alone)
