"""Identification of a grey-box model: from the task of a fit to parameters with errors.

The steps of `tustinnet.identify` after the preparation of the records.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from tustinnet.channels import Channels
from tustinnet.data.inspection import transient_end
from tustinnet.errors import InputError
from tustinnet.finding import make_finding
from tustinnet.fitting.arrangement import arrange_system
from tustinnet.fitting.inverse_dynamics.column_mistakes import describe_beyond_limits
from tustinnet.fitting.inverse_dynamics.identification import identify_by_inverse_dynamics
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.recipe import IdentificationRecipe
from tustinnet.fitting.report import FitResult, Identification, SignAlternatives
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.fitting.shooting.checks import (
    require_finite_terms,
    require_mass_matrix,
    require_refit_possible,
)
from tustinnet.fitting.shooting.controller_gains import gain_parameters
from tustinnet.fitting.shooting.equation_error import (
    WELL_EXPLAINED,
    estimate_by_equation_error,
    find_reversed_signs,
)
from tustinnet.fitting.shooting.groups import expand_values
from tustinnet.fitting.shooting.optional_terms import drop_unneeded_terms
from tustinnet.fitting.shooting.problem import Problem, SearchState
from tustinnet.fitting.shooting.refit import refit_to_free_runs
from tustinnet.fitting.shooting.results import make_identification
from tustinnet.fitting.shooting.sensor_errors import sensor_parameters
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.fitting.shooting.stages import search
from tustinnet.fitting.task import Member, Task
from tustinnet.models.closed_loop import with_controller
from tustinnet.models.contract import require_float64
from tustinnet.models.sensors import with_delays, with_sensor_errors
from tustinnet.simulate.batches import batches
from tustinnet.simulate.start_rules import FIT_SAMPLES
from tustinnet.systems.files import SystemTemplate


class UnfinishedSearchError(InputError):
    """A search was stopped before any of its stages was finished: there is no model."""


@np.errstate(all="ignore")  # simulations may diverge: what they make is judged where it is used
def identify_task(task: Task, member: Member, listener: Listener) -> FitResult:
    """Identifies the system of a task from the records of a member's fold.

    Args:
        task: what is to be fitted.
        member: one of its members.
        listener: functions that are called while the search goes on.

    Raises:
        UnfinishedSearchError: it was stopped before a stage was finished.
        InputError: see `tustinnet.identify`.
    """
    require_float64("identify")
    start_time = time.perf_counter()
    problem = _make_problem(task, member, listener)
    origin = task.folds[member.fold].origin
    initial_state = _make_initial_state(
        problem, task.identification_recipe, has_origin=origin is not None
    )
    if origin is not None and origin.fits_records:
        initial_state = replace(initial_state, has_fitted_values=True)
    if problem.search.is_by_forces:
        identification = identify_by_inverse_dynamics(problem, initial_state)
        if identification is None:
            raise _unfinished_search(problem)
        return _make_fit_result(task, member, identification, start_time)
    kept, state = drop_unneeded_terms(problem, initial_state)
    problem = replace(problem, system=kept.system)
    if not state.is_stopped:
        state = search(problem, state)
    if state.result is None:
        raise _unfinished_search(problem)
    reversed_signs = _find_suspect_signs(task, problem, initial_state, state)
    refit_result = refit_to_free_runs(problem, state)
    identification = make_identification(problem, state, reversed_signs, refit_result)
    return _make_fit_result(task, member, identification, start_time)


def _unfinished_search(problem: Problem) -> UnfinishedSearchError:
    """The error of a search that was stopped before it had a model."""
    return UnfinishedSearchError(
        f"identification of '{problem.system.name}'",
        "stopped at its time limit before a stage was finished",
        "time for the first stage",
        "allow more",
    )


def _make_fit_result(
    task: Task, member: Member, identification: Identification, start_time: float
) -> FitResult:
    """The result of a fit that began at a time of `time.perf_counter`."""
    identification = replace(identification, seconds=time.perf_counter() - start_time)
    return FitResult(
        model=identification.model,
        recipe=task.recipe,
        member=member,
        outcome=identification.outcome,
        sound=identification.sound,
        start=identification.start,
        validation_rmse=identification.validation_rmse,
        seconds=identification.seconds,
        details={"identification": identification.as_plain()},
        findings=identification.findings,
        identification=identification,
        horizon=identification.horizon,
    )


def _make_problem(task: Task, member: Member, listener: Listener) -> Problem:
    """The problem of a task: its system with what the recipe adds, and the records to use.

    Raises:
        InputError: records of another system, none that moves, or an addition that is refused.
    """
    recipe, roles = task.identification_recipe, task.folds[member.fold].roles
    # free runs over horizons, and of a refit, start in states fitted to so many samples
    roles = roles.with_long_validation(FIT_SAMPLES, listener.on_message)
    system = task.system
    assert system is not None
    records = list(roles.train)
    channels = records[0].channels
    # first of all the system alone: what acts on it, its sensors, and added forces
    if isinstance(system, SystemTemplate):
        if channels.controller is not None:
            raise InputError(
                f"system '{system.name}'",
                "made for records without [controller] in their card",
                "a system of your own: `system=` FILE",
                "or take [controller] out of the card",
            )
        system = system.for_records(records)
    system = arrange_system(system, records)
    of_file = () if system.source is None else system.source.remarks
    of_file = tuple(make_finding("of file", remark=remark) for remark in of_file)
    beyond_limits = describe_beyond_limits(system, [e.without_controller() for e in records])
    if recipe.search.part == "transients":
        # records that hardly move, in fewer than 10 samples, are left out
        records = [e[:end] for e in records if (end := transient_end(e)) >= 10]
        if not records:
            raise InputError(
                "part 'transients'", "no record that moves", "records with a transient"
            )

    # forces, and parameters of sensors, that the recipe adds to the system
    begin, fixed = recipe.model.begin, recipe.model.fixed
    numbers = {name: x for name, x in {**begin, **fixed}.items() if not isinstance(x, str)}
    plant_records = [e.without_controller() for e in records]
    system = with_added(system, recipe.model.forces, plant_records, numbers)
    _require_no_delay_in_loop(recipe.model.free, channels)
    free_sensors = sensor_parameters(system, recipe.model.free, plant_records)
    system = with_sensor_errors(system, free_sensors)

    gains = gain_parameters(records, compares_inputs=recipe.search.is_by_forces)
    inputs = with_delays(records[0].inputs, {})  # unknown delays are searched for from 0 on
    return Problem(
        system=with_controller(system, channels, gains.parameters),
        records=tuple(e.with_timing(inputs) for e in records),
        validation=tuple(e.with_timing(inputs) for e in roles.validation),
        search=recipe.search,
        listener=listener,
        remarks=(*of_file, *beyond_limits, *gains.remarks),
    )


def _require_no_delay_in_loop(names: Sequence[str], channels: Channels) -> None:
    """Raises if a delay of an input that a controller in the loop computes is to be free."""
    loops = () if channels.controller is None else channels.controller.loops
    for loop in loops:
        if (name := f"{loop.input}.delay") in names:
            raise InputError(
                "model.free",
                f"'{name}', of an input that the controller computes",
                "a delay of another input",
                "`delay` of its loop in the card counts whole samples",
            )


def _make_initial_state(
    problem: Problem, recipe: IdentificationRecipe, *, has_origin: bool
) -> SearchState:
    """The state before the first stage: the search space and the initial values of the recipe.

    Those of an origin, which other records may have given, are brought into the ranges of these.

    Raises:
        InputError: a value outside its range, or with which the records cannot be simulated.
    """
    require_refit_possible(problem)
    system, parameters = problem.system, problem.parameters
    nominal = {p.name: p.nominal for p in parameters}
    initial_values = expand_values(system, parameters, recipe.model.begin)
    if has_origin:
        ranges = {p.name: (p.lower, p.upper) for p in parameters}
        initial_values = {n: float(np.clip(x, *ranges[n])) for n, x in initial_values.items()}
    fixed_values = {
        name: nominal[name] if isinstance(x, str) else x
        for name, x in expand_values(system, parameters, recipe.model.fixed).items()
    }
    space = make_search_space(system, initial_values, fixed_values, parameters)
    vector = space.clip(space.to_vector(nominal | initial_values))
    values = {name: jnp.asarray(x, jnp.float64) for name, x in space.to_values(vector).items()}
    for model, rows in batches(system.model(values), problem.records):
        batch = [problem.records[i] for i in rows]
        if not problem.search.is_by_forces:  # which may find the inertia that a file lacks
            require_mass_matrix(model, batch)
        require_finite_terms(model, batch)
    horizons = problem.recipe_horizons or {}
    return SearchState(space, vector, horizons=horizons, remarks=problem.remarks)


def _find_suspect_signs(
    task: Task, problem: Problem, initial_state: SearchState, state: SearchState
) -> SignAlternatives:
    """Signs that are probably reversed, where the equations of motion explain the records poorly.

    A search whose first values are not an equation-error estimate gets one for that, unless it was
    stopped, it began with values that were fitted to the records, or the system was made for them:
    its optional terms may have either sign.

    Args:
        task: the task.
        problem: the problem.
        initial_state: the state before the search, from whose values signs are reversed.
        state: the state after it.
    """
    # parameters of forces that optional terms brought are not among the initial ones
    values = state.space.to_values_in_range(state.vector)
    values |= initial_state.space.to_values_in_range(initial_state.vector)
    vector = state.space.to_vector(values)
    unexplained = state.worst_unexplained
    is_known = initial_state.has_fitted_values or isinstance(task.system, SystemTemplate)
    if unexplained is None and not (state.is_stopped or is_known):
        estimate = estimate_by_equation_error(problem.system, state.space, vector, problem.motion)
        unexplained = float(estimate.unexplained.max())
    if unexplained is None or unexplained <= WELL_EXPLAINED:
        return ()
    return find_reversed_signs(problem.system, state.space, vector, problem.motion)
