"""Identification of a grey-box model: from records and a system to parameters with errors.

`identify` is the public function; `identify_task` does the same for a task of `fit`. Both return
the identified model, its parameters with errors and correlations, and findings as sentences.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp

from tustinnet.channels import Input
from tustinnet.data.dataset import DataSet
from tustinnet.data.inspection import transient_end
from tustinnet.errors import InputError
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import FitResult, Identification
from tustinnet.fitting.shooting.checks import (
    require_finite_terms,
    require_mass_matrix,
    require_refit_possible,
)
from tustinnet.fitting.shooting.equation_error import find_reversed_signs
from tustinnet.fitting.shooting.forces import with_added
from tustinnet.fitting.shooting.groups import expand_values
from tustinnet.fitting.shooting.holds import search_over_holds, with_assumed_hold
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.fitting.shooting.problem import Problem, SearchState
from tustinnet.fitting.shooting.refit import refit_to_free_runs
from tustinnet.fitting.shooting.results import make_identification
from tustinnet.fitting.shooting.sensors import sensor_parameters
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.fitting.task import AnyRecipe, Member, Task, make_task
from tustinnet.models.contract import require_float64
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sensors import with_delays, with_sensor_errors
from tustinnet.renamed import with_renamed_arguments
from tustinnet.simulate.batches import batches
from tustinnet.systems.files import AnySystem, SystemTemplate

# what right signs leave of the momentum is a few hundredths, what wrong ones leave over a half
_POORLY_EXPLAINED = 0.1
_SHORTEST = 10  # samples of a transient worth fitting
DEFAULT_IDENTIFICATION = "grey"


class UnfinishedSearchError(InputError):
    """A search was stopped before any of its stages was finished: there is no model."""


@with_renamed_arguments(told="on_iteration")
def identify(
    data: DataSet,
    system: AnySystem,
    recipe: AnyRecipe = DEFAULT_IDENTIFICATION,
    *,
    begin: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    on_iteration: Callable[[Iteration], None] = lambda _: None,
    should_stop: ShouldStopSearch = never_stop_search,
) -> Identification:
    """Identifies a system's parameters by the simulation error over all training records at once.

    First values come from the equations of motion on the measured motion; then the simulation
    error over segments of one swing, of four swings and over whole records is minimised. Records
    along which errors grow without end, as about an unstable equilibrium that a controller
    holds, stay in segments; `findings` says which.

    Args:
        data: records; those of the split `train` are used, or all where there are no splits.
        system: the system, its name or its file, see `LagrangianSystem`.
        recipe: a recipe of a kind that is identified; `grey` by default.
        begin: values where the search starts, by name, besides those of the recipe; the nominal
            values for all others.
        fixed: parameters to fix at a value, besides those that the recipe and the system fix.
        on_iteration: called with every iteration.
        should_stop: asked before every step of the search, as for a time limit. A search that it
            stops returns the model of its last finished stage, and says so in `outcome`.

    Returns:
        The model, its parameters with errors and correlations, and findings as sentences.

    Raises:
        InputError: records of another system, a value outside its range, a mass matrix that is
            not positive definite, float64 is off; it was stopped before a stage was finished
            (`UnfinishedSearchError`).
    """
    recipe = read_recipe(recipe)
    tables = {
        "begin": {**getattr(recipe.model, "begin", {}), **(begin or {})},
        "fixed": {**getattr(recipe.model, "fixed", {}), **(fixed or {})},
    }
    recipe = recipe.model_copy(update={"model": recipe.model.model_copy(update=tables)})
    task = make_task(data, recipe, system=system)
    result = identify_task(task, Member(), Listener(on_iteration=on_iteration), should_stop)
    assert result.identification is not None
    return result.identification


def identify_task(
    task: Task,
    member: Member,
    listener: Listener,
    should_stop: ShouldStopSearch = never_stop_search,
) -> FitResult:
    """Identifies the system of a task from the records of a member's fold.

    Args:
        task: what is to be fitted.
        member: one of its members.
        listener: functions that are called while the search goes on.
        should_stop: see `identify`.

    Raises:
        UnfinishedSearchError: it was stopped before a stage was finished.
        InputError: see `identify`.
    """
    require_float64("identify")
    start_time = time.perf_counter()
    recipe, roles = task.identification_recipe, task.folds[member.fold].roles
    system = task.system
    assert system is not None
    records = list(roles.train)
    system = system.for_records(records) if isinstance(system, SystemTemplate) else system
    system = _with_open_holds(system, records[0].inputs)
    system.channels.require_same(
        records[0].channels, records[0].name, f"the system '{system.name}'"
    )
    if recipe.search.part == "transients":
        # records that hardly move are left out
        records = [e[:end] for e in records if (end := transient_end(e)) >= _SHORTEST]
        if not records:
            raise InputError(
                "part 'transients'", "no record that moves", "records with a transient"
            )

    # forces, and parameters of sensors, that the recipe adds to the system
    begin, fixed = recipe.model.begin, recipe.model.fixed
    numbers = {name: x for name, x in {**begin, **fixed}.items() if not isinstance(x, str)}
    system = with_added(system, recipe.model.forces, records, numbers)
    free_sensors = sensor_parameters(system, recipe.model.free, records)
    system = with_sensor_errors(system, free_sensors)

    inputs = with_delays(records[0].inputs, {})  # unknown delays are searched for from 0 on
    problem = Problem(
        system=system,
        records=tuple(e.with_timing(inputs) for e in records),
        validation=tuple(e.with_timing(inputs) for e in roles.validation),
        search=recipe.search,
        listener=listener,
        should_stop=should_stop,
    )
    require_refit_possible(with_assumed_hold(problem))

    # the search space and the initial values
    nominal = {p.name: p.nominal for p in problem.parameters}
    initial_values = expand_values(system, problem.parameters, begin)
    fixed_values = {
        name: nominal[name] if isinstance(x, str) else x
        for name, x in expand_values(system, problem.parameters, fixed).items()
    }
    space = make_search_space(system, initial_values, fixed_values, problem.parameters)
    initial_vector = space.clip(space.to_vector(nominal | initial_values))
    values = {
        name: jnp.asarray(x, jnp.float64) for name, x in space.to_values(initial_vector).items()
    }
    for model, rows in batches(system.model(values), records):
        batch = [records[i] for i in rows]
        require_mass_matrix(model, batch)
        require_finite_terms(model, batch)

    state = SearchState(space, initial_vector, horizons=problem.recipe_horizons or {})
    problem, state = search_over_holds(problem, state)
    if state.result is None:
        raise UnfinishedSearchError(
            f"identification of '{system.name}'",
            "stopped at its time limit before a stage was finished",
            "time for the first stage", "allow more",
        )  # fmt: skip
    reversed_signs: tuple[tuple[str, ...], ...] = ()
    if state.unexplained > _POORLY_EXPLAINED:
        initial_values = space.to_values_in_range(initial_vector)
        vector = state.space.to_vector(initial_values)
        reversed_signs = find_reversed_signs(problem.system, state.space, vector, problem.motion)
    identification = make_identification(problem, state, reversed_signs)
    if problem.refit_start:
        identification = refit_to_free_runs(problem, state, problem.refit_start, identification)
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


def _with_open_holds(system: LagrangianSystem, inputs: Sequence[Input]) -> LagrangianSystem:
    """The system without the holds that records declare otherwise: those of the records count."""
    declared = {i.name: i.hold for i in inputs if i.hold not in (None, "unknown")}
    opened = tuple(
        replace(i, hold=None) if i.hold != declared.get(i.name, i.hold) else i
        for i in system.inputs
    )
    return system if opened == system.inputs else replace(system, inputs=opened)
