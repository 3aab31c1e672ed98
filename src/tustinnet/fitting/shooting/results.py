"""The result of an identification: estimates with errors, residuals, initial states, findings.

`make_identification` takes a problem, the state after its search and the result of its refit, and
returns the `Identification`. What is said of it comes from `findings`.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.report import Estimate, Identification, SignAlternatives, Stretch
from tustinnet.fitting.shooting import findings
from tustinnet.fitting.shooting.agreement import find_disagreements
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.least_squares import LeastSquaresResult
from tustinnet.fitting.shooting.problem import (
    Problem,
    SearchState,
    make_model,
    make_prior,
    score_validation,
)
from tustinnet.fitting.shooting.refit import RefitResult
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.fitting.shooting.uncertainty import (
    INFORMED,
    Uncertainty,
    estimate_uncertainty,
    lag_correlation,
    without_overflow,
)
from tustinnet.models.lagrangian import LagrangianSystem

_EXACT = 1e-6  # of the motion: residuals of records without counts that are taken for rounding


def make_identification(
    problem: Problem,
    state: SearchState,
    reversed_signs: SignAlternatives,
    refit_result: RefitResult,
) -> Identification:
    """Makes the account of an identification from the state after its search, and after its refit.

    Estimates, their errors and the residuals are of the search; the model and its score on the
    validation records are of the refit, where there is one.

    Args:
        problem: the problem.
        state: the state after the final stage, or after the last one before a search was stopped.
        reversed_signs: coordinates and inputs whose sign is probably reversed: alternatives, each
            the names to reverse together.
        refit_result: the result of the refit to free runs.
    """
    result, space, records = state.last_result, state.space, problem.records
    prior_curvature = make_prior(problem, state).curvature(space, result.vector)
    uncertainty = estimate_uncertainty(
        result.products, result.segments, prior_curvature, space.inside(result.vector)
    )
    # a search that was stopped has no minimum about which the records could be compared
    disagreements = () if state.is_stopped else find_disagreements(problem, state)
    # a variance that rounding has made negative is unknown, as a correlation above 1
    errors, naive_errors = (np.sqrt(np.diag(x)) for x in (uncertainty.trusted, uncertainty.naive))
    correlation = uncertainty.trusted / np.outer(errors, errors)
    correlation[np.abs(correlation) > 1 + 1e-6] = np.nan
    # without a prior the range is what was known, as a uniform distribution
    priors = np.array([p.prior or np.nan for p in space.free_parameters])
    spread = priors / np.abs(space.derivatives(result.vector))
    spread = np.where(np.isnan(spread), (space.upper - space.lower) / np.sqrt(12), spread)
    informed = errors < INFORMED * spread
    quantiles = _quantiles(problem, space, uncertainty)
    estimates = make_estimates(space, result.vector, errors, naive_errors, quantiles, informed)

    lag = lag_correlation(result.products.error)
    noise_ratio = _residuals_over_noise(result, records)
    rmse = _rmse_by_record(result, records)
    horizons = {name: steps * records[0].dt for name, steps in state.horizons.items()}
    start = problem.scoring_start(state.shortest_horizon).name
    final_state = refit_result.state
    validation_rmse = score_validation(problem, final_state) if problem.validation else None
    downweighted = (
        () if state.robust_weights is None else _downweighted(state.robust_weights, records)
    )
    has_converged = result.status == "converged" and not state.is_stopped
    all_findings = [
        *findings.describe_signs(reversed_signs),
        *state.remarks,
        *findings.describe_horizons(
            horizons,
            () if state.is_stopped else records,
            is_from_recipe=problem.recipe_horizons is not None,
            longest_stable=(state.longest_stable or 0) * records[0].dt,
            scoring_start=start if problem.validation else None,
        ),
        *findings.describe_disagreements(disagreements),
        *findings.describe_bounds(estimates, noise_ratio, problem.system.plant),
        *findings.describe_scale(estimates, state.confounded, space, result.vector),
        *findings.describe_stretches(downweighted),
        *([] if state.has_diverged else findings.describe_condition(space.names, uncertainty)),
        *(
            findings.describe_errors(uncertainty, lag, noise_ratio, len(records))
            if has_converged
            else []
        ),
    ]
    if refit_result.finding is not None:
        all_findings.append(refit_result.finding)
    model = make_model(problem, final_state)
    return Identification(
        system=problem.system,
        model=model,
        estimates=estimates,
        fixed=dict(space.fixed_values),
        correlation=correlation,
        condition=uncertainty.condition,
        converged=has_converged and not refit_result.is_stopped,
        outcome=(
            findings.describe_stop(state)
            if state.is_stopped or refit_result.is_stopped
            else findings.describe_outcome(
                result.status, result.iterations, records, rmse, horizons
            )
        ).text,
        reversed_signs=reversed_signs,
        findings=tuple(all_findings),
        trust=uncertainty.source,
        rmse=rmse,
        autocorrelation=tuple(lag.tolist()),
        disagreements=disagreements,
        initial=state.initial_treatment,
        initial_states=_initial_states_by_record(problem.system, state, records),
        horizons=horizons,
        start=start,
        validation_rmse=validation_rmse,
        substeps=model.substeps,
        iterations=result.iterations,
        downweighted=downweighted,
        refit=refit_result.refit,
    )


def make_estimates(
    space: SearchSpace,
    vector: ParameterVector,
    errors: Float[np.ndarray, " n_p"],
    naive_errors: Float[np.ndarray, " n_p"],
    quantiles: Float[np.ndarray, " n_p"],
    informed: Bool[np.ndarray, " n_p"],
) -> tuple[Estimate, ...]:
    """Estimates of the free parameters, with errors and intervals of those not at a bound.

    Args:
        space: the search space.
        vector: the parameters.
        errors: standard errors of the vector to trust, NaN where they are not known.
        naive_errors: standard errors that take residuals for independent noise.
        quantiles: standard errors that make half an interval.
        informed: parameters of which the records tell more than the prior.
    """
    bounds, values = space.active_bounds(vector), space.to_values_in_range(vector)
    slopes, lower, upper = space.derivatives(vector), space.lower, space.upper
    estimates = []
    for i, p in enumerate(space.free_parameters):
        has_error = p.name not in bounds and bool(np.isfinite(errors[i]))
        half = quantiles[i] * errors[i]
        # beyond its range a value is excluded beforehand
        edges = np.clip([vector[i] - half, vector[i] + half], lower[i], upper[i])
        low, high = (np.exp(edges) if p.positive else edges * slopes[i]).tolist()
        error, naive_error = (float(x[i] * abs(slopes[i])) for x in (errors, naive_errors))
        estimates.append(
            Estimate(
                name=p.name,
                unit=p.unit,
                value=values[p.name],
                error=error if has_error else None,
                naive_error=naive_error if has_error and np.isfinite(naive_error) else None,
                interval=(low, high) if has_error else None,
                lower=p.lower,
                upper=p.upper,
                bound=bounds.get(p.name, ""),
                is_informed=p.name in bounds or bool(informed[i]),
            )
        )
    return tuple(estimates)


def _quantiles(
    problem: Problem, space: SearchSpace, uncertainty: Uncertainty
) -> Float[np.ndarray, " n_p"]:
    """Standard errors that make half an interval of each free parameter.

    Only the records of its group inform of a parameter of one group.
    """
    counts = [
        sum(not p.per or p.name.endswith(f"[{e.group(p.per)}]") for e in problem.records)
        for p in space.free_parameters
    ]
    return np.array([uncertainty.quantile_for_records(n) for n in counts])


def _initial_states_by_record(
    system: LagrangianSystem, state: SearchState, records: Sequence[Experiment]
) -> Mapping[str, tuple[float, ...]]:
    """Initial states of the records by name, internal ones included."""
    segments, result = state.last_result.segments, state.last_result
    first = segments.first_of_records
    equations = system_equations(system)
    parameter_rows = equations.parameter_rows(
        state.space.to_values(result.vector), segments.group_indices[first]
    )
    # with the delays that were found
    delayed = segments.with_delays(state.space.to_values_in_range(result.vector))
    inputs = delayed.inputs[segments.first_row[first]]
    states = equations.initial_states(
        result.x0[first],
        parameter_rows,
        segments.adds_expected[first],
        inputs[:, None] if inputs.ndim == 2 else inputs,
    ).states
    return {e.name: tuple(x.tolist()) for e, x in zip(records, states, strict=True)}


def _rmse_by_record(result: LeastSquaresResult, records: Sequence[Experiment]) -> dict[str, float]:
    """Root mean square of every record's residuals, its segments together.

    Where initial states are anchored, the cost of the anchors is in the squares.
    """
    segments = result.segments
    # every residual weighs 1 / T, and a joint of two segments counts in both
    total = np.bincount(segments.record, result.products.cost)
    weight = np.bincount(segments.record, segments.share * (segments.steps + 1))
    rmse = np.sqrt(total / weight).tolist()
    return dict(zip((e.name for e in records), rmse, strict=True))


def _residuals_over_noise(
    result: LeastSquaresResult, records: Sequence[Experiment]
) -> float | None:
    """Size of the residuals over that of the encoders' rounding.

    None where a channel has no encoder counts, but 0 if the model then fits exactly.
    """
    errors = np.concatenate(without_overflow(result.products.error))
    counts = records[0].channels.resolution
    sizes = np.sqrt(np.mean(errors**2, axis=0))
    if not np.all(counts > 0):
        motion = np.concatenate([e.q for e in records]).std(axis=0)
        return 0.0 if np.all(sizes < _EXACT * motion) else None
    return float(np.max(sizes / (counts / np.sqrt(12))))


def _downweighted(
    weights: Float[np.ndarray, "n n_q"], records: Sequence[Experiment]
) -> tuple[Stretch, ...]:
    """Stretches of samples whose mean weight over the channels is below a half."""
    stretches, row = [], 0
    for e in records:
        mean = weights[row : row + len(e)].mean(axis=1)
        row += len(e)
        # below half of the weight of others
        edges = np.flatnonzero(np.diff(mean < 0.5, prepend=False, append=False))
        for a, b in edges.reshape(-1, 2).tolist():
            weight = float(mean[a:b].mean())
            stretches.append(Stretch(e.name, float(e.t[a]), float(e.t[b - 1]), weight))
    return tuple(stretches)
