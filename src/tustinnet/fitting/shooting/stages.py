"""The stages of a search: from the equation-error estimate over longer and longer segments.

`search` takes a problem and the state to start from and returns the state after all stages. A
stage compares the simulation over segments of one length and minimises the error; the last one is
the final stage, over whole records. Records along which errors grow without end stay in segments
of their horizon, see `horizons`; where simulations of long segments diverge, all records stay
in the longest segments whose simulations stayed finite.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax.numpy as jnp
import numpy as np

from tustinnet.errors import InputError
from tustinnet.finding import make_finding
from tustinnet.fitting.listener import Iteration, SearchProgress, StageResult
from tustinnet.fitting.residual import robust_weights
from tustinnet.fitting.shooting.equation_error import estimate_by_equation_error
from tustinnet.fitting.shooting.horizons import find_horizons
from tustinnet.fitting.shooting.identifiability import (
    describe_confounded,
    find_confounded,
    has_diverged,
)
from tustinnet.fitting.shooting.least_squares import StoppingRule, minimise
from tustinnet.fitting.shooting.problem import (
    Problem,
    SearchState,
    make_cost_function,
    make_model,
    position_errors,
    report_step,
    score_validation,
)
from tustinnet.fitting.shooting.uncertainty import estimate_uncertainty, shift_of_estimate
from tustinnet.simulate.horizon import pieces
from tustinnet.simulate.substeps import MOST_CHOSEN, PROBED_SECONDS, enough_substeps
from tustinnet.simulate.substeps import choose_substeps as needed_substeps

ESTIMATE = "equation-error estimate"  # what the listener calls the first step

_TARGET = 0.25  # integration error allowed, in encoder counts: less than rounding to them makes
_TARGET_SPAN = 1e-5  # or of the largest travel, where no count is known
_QUARTER_SWINGS = (4, 16)  # lengths of the early stages' segments
# steps in a period, of which dry friction and stiff loops of servos on light links need many
_TRIED_SUBSTEPS = (1, 4, 16)


@dataclass(frozen=True)
class SearchStage:
    """Stage of a search.

    Attributes:
        initial_treatment: how initial states are treated, see `CutOptions`.
        stopping: when it ends.
        quarter_swings: length of the segments in quarters of a swing, None for whole records.
        has_velocities: whether velocities are compared, too. They lead from values that are far
            off, but those that a stencil derives are too slow for fast motion.
    """

    initial_treatment: str
    stopping: StoppingRule
    quarter_swings: int | None = None
    has_velocities: bool = True


def search(problem: Problem, state: SearchState) -> SearchState:
    """Runs all stages of a search.

    Args:
        problem: the problem.
        state: the initial values.

    Returns:
        The state after the final stage, or after the last one before the search was stopped.
    """
    state = _fix_confounded_parameters(problem, state)
    if not state.has_fitted_values:
        estimate = estimate_by_equation_error(
            problem.system, state.space, state.vector, problem.motion
        )
        unexplained = float(estimate.unexplained.max())
        values = state.space.to_values_in_range(estimate.vector)
        problem.listener.on_iteration(Iteration(ESTIMATE, 1, unexplained, 0.0))
        problem.listener.on_progress(SearchProgress(ESTIMATE, 0, 0, 1, unexplained))
        problem.listener.on_stage(StageResult(ESTIMATE, "", 1, unexplained, "converged", values))
        state = replace(state, vector=estimate.vector, worst_unexplained=unexplained)
    state = choose_substeps(problem, update_horizons(problem, state))

    longest = max(state.horizons.get(e.name, len(e) - 1) for e in problem.records)
    stages = [
        SearchStage(problem.early_initial_treatment, StoppingRule(0.1, 20), quarters)
        for quarters in _QUARTER_SWINGS
        if quarters * problem.motion.quarter_swing < longest
    ]
    stages.append(SearchStage(problem.early_initial_treatment, StoppingRule(1e-2, 30)))
    treatment = problem.search.initial
    compares = treatment == "choose" and bool(problem.validation)
    has_refit = problem.refit_start is not None
    state = replace(state, stages=len(stages) + compares + 1 + has_refit)
    state, stable = _run_early_stages(problem, state, stages)
    if state.is_stopped:
        return state
    state = choose_substeps(problem, state)

    if treatment == "choose":
        treatment = "anchored"
    final = run_final_stage(problem, state, treatment)
    if compares and not (final.is_stopped or final.has_diverged):
        state = replace(state, finished_stages=final.finished_stages)
        loose = run_final_stage(problem, state, "unanchored")
        if loose.is_stopped:
            return replace(final, is_stopped=True)
        if score_validation(problem, loose) < score_validation(problem, final):
            return loose
        return replace(final, finished_stages=loose.finished_stages)
    if final.is_stopped or not final.has_diverged or state.has_diverged:
        return final
    state, stable, _ = _lengthen_segments(problem, state, stable)
    if state.is_stopped:
        return state
    state = update_horizons(problem, replace(state, longest_stable=stable))
    return run_final_stage(problem, state, treatment)


def _run_early_stages(
    problem: Problem, state: SearchState, stages: Sequence[SearchStage]
) -> tuple[SearchState, int]:
    """Runs the stages before the final one, over longer and longer segments.

    Returns:
        The state after the last stage whose simulations stayed finite, and the steps of its longest
        segments. Where simulations diverge even along the shortest segments, the state after the
        last stage, and 0.
    """
    stable = 0
    for stage in stages:
        later = run_stage(problem, state, stage)
        if not stable and not later.is_stopped and later.has_diverged:
            shorter = run_stage(problem, state, replace(stage, quarter_swings=1))
            if not shorter.is_stopped and not shorter.has_diverged:
                state = replace(shorter, stages=state.stages + 1)
                stable = problem.motion.quarter_swing
                later = run_stage(problem, state, stage)
        if later.is_stopped:
            return later, stable
        if stable and later.has_diverged:
            state, stable, has_diverged = _lengthen_segments(problem, state, stable)
            if has_diverged and not state.is_stopped:
                state = update_horizons(problem, replace(state, longest_stable=stable))
            return state, stable
        if not later.has_diverged:
            stable = int(later.last_result.segments.steps.max())
        state = update_horizons(problem, later)  # the better the values, the better the horizons
    return state, stable


def _lengthen_segments(
    problem: Problem, state: SearchState, steps: int
) -> tuple[SearchState, int, bool]:
    """Runs stages over segments twice as long each, up to whole records or until one diverges.

    Args:
        problem: the problem.
        state: the state after a stage whose simulations stayed finite.
        steps: the longest segments of that stage.

    Returns:
        The state after the last stage whose simulations stayed finite, the steps of its longest
        segments, and whether those of a longer one diverged.
    """
    longest = max(len(e) - 1 for e in problem.records)
    while 2 * steps < longest:
        quarters = max(1, 2 * steps // problem.motion.quarter_swing)
        stage = SearchStage(problem.early_initial_treatment, StoppingRule(1e-2, 30), quarters)
        state = replace(state, stages=state.stages + 1)
        longer = run_stage(problem, state, stage)
        if longer.is_stopped:
            return longer, steps, False
        if longer.has_diverged:
            return state, steps, True
        state, steps = longer, 2 * steps
    return state, steps, False


def run_final_stage(problem: Problem, state: SearchState, initial_treatment: str) -> SearchState:
    """Runs the final stage: whole records, to the tolerance of the recipe.

    A robust search repeats it with weights from the residuals before, until these change nothing.
    It is repeated with twice as many integration steps, too, as long as these would move some
    parameter by a quarter of its standard error.

    Args:
        problem: the problem.
        state: the state to start from.
        initial_treatment: how initial states are treated, see `CutOptions`.
    """
    options = problem.search
    stopping = StoppingRule(options.tolerance, options.iterations)
    stage = SearchStage(initial_treatment, stopping, has_velocities=False)
    finished = state.finished_stages
    before, state = state, run_stage(problem, state, stage)
    for _ in range(20 if options.robust != "none" else 0):
        before = replace(state, finished_stages=finished)
        state = run_stage(problem, before, stage)
        if (
            state.is_stopped
            or state.has_diverged
            # of a logarithm, or of a range: new weights do not matter any more
            or np.abs(state.vector - before.vector).max() < 1e-5
        ):
            break
    while not state.is_stopped and _needs_finer_steps(problem, before, state):
        before = replace(state, substeps=2 * state.substeps, finished_stages=finished)
        finer = run_stage(problem, before, stage)
        if finer.is_stopped or finer.has_diverged:
            return state
        state = finer
    return state


def _needs_finer_steps(problem: Problem, before: SearchState, state: SearchState) -> bool:
    """Whether twice as many integration steps would move a parameter noticeably.

    The error target of `choose_substeps` is that of single samples: a share of the encoders'
    counts. Many samples together determine parameters so well that the integration error may show
    in these. Without counts the target is far below any noise.

    Args:
        problem: the problem.
        before: the state before the final stage, whose variance weighs its anchors.
        state: the state after it.
    """
    result = state.last_result
    is_chosen = not problem.search.substeps and problem.records[0].channels.resolution.any()
    if not is_chosen or state.has_diverged or 2 * state.substeps > MOST_CHOSEN:
        return False
    cost = make_cost_function(problem, before, result.segments, 2 * state.substeps)
    finer = cost.products(result.vector, result.x0)
    if not finer.is_finite:
        return False
    inside = state.space.inside(result.vector)
    curvature = cost.prior.curvature(state.space, result.vector)
    shift = shift_of_estimate(result.products, finer, curvature, inside)
    uncertainty = estimate_uncertainty(result.products, result.segments, curvature, inside)
    errors = np.sqrt(np.diag(uncertainty.trusted)[inside])
    # finer steps may move a parameter by a quarter of a standard error
    return bool(np.any(np.abs(shift) > 0.25 * errors))


def run_stage(problem: Problem, state: SearchState, stage: SearchStage) -> SearchState:
    """Runs one stage; the state has its result, also where it diverged.

    Where the search is to stop, the state is the one before, marked as stopped.
    """
    if state.is_stopped or problem.should_stop():
        return replace(state, is_stopped=True)
    steps = stage.quarter_swings and stage.quarter_swings * problem.motion.quarter_swing
    segments = problem.segments(steps, stage.initial_treatment, state.horizons)
    if not stage.has_velocities:
        segments = segments.without_velocities(problem.system.channels)
    if state.robust_weights is not None:
        weights = segments.weights * np.sqrt(np.tile(state.robust_weights, 2))
        segments = replace(segments, weights=weights)
    # over a few swings the integration error stays far below what the early stages leave
    substeps = state.substeps if steps is None else max(1, state.substeps // 2)
    cost = make_cost_function(problem, state, segments, substeps)
    treatment = stage.initial_treatment
    name = f"{_segments_in_words(problem, state, steps)}, {treatment} start"

    on_step = partial(report_step, problem, state, name, treatment)
    x0 = None if state.result is None else state.result.continue_in(segments)
    result = minimise(cost, state.vector, stage.stopping, on_step, problem.should_stop, x0)
    values = state.space.to_values_in_range(result.vector)
    problem.listener.on_stage(
        StageResult(name, treatment, result.iterations, result.cost, result.status, values)
    )
    if result.status == "stopped":
        return replace(state, is_stopped=True)
    state = replace(
        state,
        vector=result.vector,
        result=result,
        stage=name,
        initial_treatment=treatment,
        finished_stages=state.finished_stages + 1,
    )
    if state.has_diverged:
        return state
    channels = problem.system.channels
    errors = np.zeros_like(segments.measurements)  # of positions, those of velocities do not count
    for k, error in enumerate(result.products.error):
        errors[segments.rows(k), channels.position] = error
    residuals = np.asarray(problem.residual.wrapped_residual(jnp.asarray(errors)))
    variance = float(np.sum((residuals * segments.weights) ** 2)) / len(problem.records)
    weights = None
    if problem.search.robust != "none":
        counts = problem.records[0].channels.resolution
        weights = robust_weights(problem.search.robust, errors[:, channels.position], counts)
    return replace(state, variance=variance, robust_weights=weights)


def _segments_in_words(problem: Problem, state: SearchState, steps: int | None) -> str:
    """The segments of a stage in words: `whole records`, or `segments of 0.5 s`."""
    dt = problem.motion.dt
    if steps is not None:
        return f"segments of {steps * dt:.2g} s"
    horizons = [state.horizons[e.name] for e in problem.records if e.name in state.horizons]
    if not horizons:
        return "whole records"
    segments = f"segments of {min(horizons) * dt:.2g} s"
    if len(horizons) == len(problem.records):
        return segments
    return f"whole records, {len(horizons)} of them in {segments}"


def _fix_confounded_parameters(problem: Problem, state: SearchState) -> SearchState:
    """Fixes one parameter of every set that is not identifiable from the records.

    Raises:
        InputError: no parameter is left.
    """
    space, vector = state.space, state.vector
    steps = _QUARTER_SWINGS[0] * problem.motion.quarter_swing
    segments = problem.segments(steps, problem.early_initial_treatment, state.horizons)
    for substeps in _TRIED_SUBSTEPS:
        products = problem.products(space, vector, segments, substeps).pp.sum(axis=0)
        if not has_diverged(products):
            break
    else:
        return replace(state, remarks=(*state.remarks, make_finding("identifiability unchecked")))
    confounded = find_confounded(space, vector, products)
    if not confounded:
        return state
    names = dict.fromkeys(parameters.suggestion for parameters in confounded)
    values = space.to_values_in_range(vector)
    space = space.fixing({name: values[name] for name in names})
    if not space.free_parameters:
        raise InputError(
            f"system '{problem.system.name}'",
            "; ".join(parameters.finding.text for parameters in confounded),
            "records from which at least one parameter is identifiable",
        )
    remarks = describe_confounded(confounded, len(vector))
    return replace(
        state,
        space=space,
        vector=space.to_vector(values),
        remarks=(*state.remarks, *remarks),
        confounded=confounded,
    )


def update_horizons(problem: Problem, state: SearchState) -> SearchState:
    """The state with the horizons of the recipe, or else those that its parameters allow."""
    horizons = problem.recipe_horizons
    if horizons is None:
        records = (*problem.records, *problem.validation)
        horizons = find_horizons(
            problem.system,
            state.space,
            state.vector,
            records,
            problem.group_indices(records),
            problem.motion.quarter_swing,
        )
    if (limit := state.longest_stable) is not None:
        every = (*problem.records, *problem.validation)
        longer = {e.name for e in every if len(e) - 1 > limit}
        horizons = {**horizons, **{n: min(limit, horizons.get(n, limit)) for n in longer}}
    return replace(state, horizons=horizons)


def choose_substeps(problem: Problem, state: SearchState) -> SearchState:
    """The state with the integration steps of the recipe, or else as many as its error needs."""
    if problem.search.substeps:
        return replace(state, substeps=problem.search.substeps)
    counts = [r for r in problem.records[0].channels.resolution if r]
    travel = max(float(np.abs(e.q - e.q[-1]).max()) for e in problem.records)
    target = _TARGET * min(counts) if counts else _TARGET_SPAN * travel
    samples = max(2, round(PROBED_SECONDS / problem.records[0].dt))
    start = problem.measured_start
    heads = [pieces(e, state.horizons.get(e.name), start)[0][:samples] for e in problem.records]
    if not state.space.names:  # the program of free runs serves, too
        model = make_model(problem, state).continuous
        return replace(state, substeps=needed_substeps(model, heads, target))
    segments = problem.free_runs(heads)
    substeps = enough_substeps(
        lambda n: np.concatenate(position_errors(problem, state, segments, n)), target
    )
    return replace(state, substeps=substeps)
