"""Refit: parameters fitted once more after the search, to free runs of the training records.

A search may find the initial state of a record along the whole of it, and minimises squares; a
free run has only its first samples for that. Where the model lacks physics, the parameters that
explain the records are not those that simulate them best. `refit_to_free_runs` takes the state
after the search and returns it with the refitted parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.report import Refit
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.levenberg_marquardt import DampingRule, iterate
from tustinnet.fitting.shooting.normal import compute_products
from tustinnet.fitting.shooting.problem import (
    Problem,
    SearchState,
    make_model,
    report_step,
)
from tustinnet.fitting.shooting.segments import CutOptions, cut_records, first_of_records
from tustinnet.fitting.shooting.space import SearchSpace
from tustinnet.models.parameters import Parameter
from tustinnet.simulate.horizon import horizon_samples, pieces
from tustinnet.simulate.start_rules import FirstSamples, Start
from tustinnet.simulate.state_fits import fit_states_with_derivatives

_COST_TOLERANCE = 1e-3  # converged: decrease by an iteration, of the cost
_WORTH = 0.05  # of the mean RMSE of free runs: a smaller gain leaves parameters as identified
_LARGE_CHANGE = 0.01  # of a parameter's value: a smaller one is not worth a word
_PRIOR = 2.0  # cost of a parameter that doubles: the mean RMSE of so many records
_WELL = 0.25  # of the mean RMSE: below it a record counts by its square

# any decrease will do: what is predicted does not matter
_DAMPING_RULE = DampingRule(
    initial=1e-2,
    largest=9e5,
    increase=10.0,
    decreased=lambda damping, _: damping / 10,
    least_gain_ratio=0.0,
)


@dataclass(frozen=True)
class RefitResult:
    """The result of a refit to free runs: refitted parameters, or the reason why there are none.

    Attributes:
        state: the state after the search, with the refitted parameters where there are any.
        refit: these parameters, and the errors of the free runs before and after; None without.
        finding: what is said of it; None where the search left nothing to refit.
        is_stopped: whether the time limit came before its end.
    """

    state: SearchState
    refit: Refit | None = None
    finding: Finding | None = None
    is_stopped: bool = False


def refit_to_free_runs(problem: Problem, state: SearchState) -> RefitResult:
    """Refits the parameters to free runs of the training records, where the recipe asks for it.

    Args:
        problem: the problem.
        state: the state after the search.

    Returns:
        The refitted parameters; none where the search was stopped or diverged, and where a refit
        is not possible, is stopped or gains next to nothing, which `finding` says.
    """
    start = problem.refit_start
    if start is None or state.is_stopped or state.has_diverged:
        return RefitResult(state)
    # a delay is in the inputs, which free runs take as they are
    free = [p for p in state.space.free_parameters if p.name not in problem.delays]
    obstacle, refit, is_stopped = "", None, False
    if state.shortest_horizon is not None and state.shortest_horizon < start.samples:
        obstacle = f"{start.name} requires longer segments"
    elif not free:
        obstacle = "nothing but delays is free"
    else:
        refit = _minimise_mean_rmse(problem, state, start, free)
        if refit is None:
            obstacle, is_stopped = "stopped at its time limit", True
        elif not np.isfinite(refit.before):
            obstacle = "free runs diverge; `horizon` in the table [search] shortens them"
    if refit is None or obstacle:
        return RefitResult(
            state, finding=make_finding("not refitted", why=obstacle), is_stopped=is_stopped
        )

    if refit.after > (1 - _WORTH) * refit.before:
        # of short segments noise alone gives as much, and moves parameters out of their intervals
        kept = make_finding("refit not needed", start=start.name, share=_WORTH)
        return RefitResult(state, finding=kept)

    space, after = state.space, refit.values
    before = space.to_values_in_range(state.vector)
    refitted = replace(state, vector=space.clip(space.to_vector(before | after)))
    changes = {name: abs(x / before[name] - 1) for name, x in after.items() if before[name]}
    large = [name for name in changes if changes[name] >= _LARGE_CHANGE]
    most = sorted(large, key=lambda name: -changes[name])[:3]
    finding = make_finding(
        "refitted",
        start=start.name,
        before=refit.before,
        after=refit.after,
        changes=[
            make_finding("changed", parameter=name, before=before[name], after=after[name])
            for name in most
        ],
    )
    return RefitResult(refitted, refit, finding)


@dataclass(frozen=True)
class _RefitPoint:
    """Relative changes of the parameters, the free runs there, and the cost."""

    change: Float[np.ndarray, " n_p"]
    products: "_FreeRunProducts"
    cost: float


def _minimise_mean_rmse(
    problem: Problem, state: SearchState, start: Start, free: Sequence[Parameter]
) -> Refit | None:
    """Minimises the mean over the records of their RMSE, not of its square.

    A record that no parameter explains then pulls no more than others. A parameter's change
    relative to its value has a prior, so that what the records do not determine stays as it
    was identified; the more records there are, the less it weighs. Initial states follow from the
    parameters, as they do in the free runs that are scored.

    Levenberg-Marquardt, each record's squares weighed by one over its RMSE.

    Returns:
        The values before and after; unchanged where some free run diverges. None where the time
        limit comes before its end.
    """
    names = [p.name for p in free]
    identified = state.space.to_values_in_range(state.vector)
    first = np.array([identified[name] for name in names])
    # a change of 1 is the value, unless it is nearly 0
    unit = np.array(
        [max(abs(x), 0.01 * (p.upper - p.lower)) for x, p in zip(first, free, strict=True)]
    )
    lower = (np.array([p.lower for p in free]) - first) / unit
    upper = (np.array([p.upper for p in free]) - first) / unit
    space = state.space.fixing({n: identified[n] for n in state.space.names if n not in names})
    simulate = _make_simulation(problem, state, start, space, unit)
    initial = simulate(first)
    scale, prior = initial.mean_rmse, _PRIOR / len(problem.records)

    def propose(point: _RefitPoint, damping: float) -> tuple[_RefitPoint, float]:
        # Gauss-Newton matrix and gradient of half the mean RMSE over the scale
        rmse = np.maximum(point.products.rmse, _WELL * scale)
        weight = 1 / (2 * scale * rmse * len(rmse))
        matrix = np.einsum("r,rij->ij", weight, point.products.matrix) + prior * np.eye(len(free))
        gradient = np.einsum("r,ri->i", weight, point.products.gradient) + prior * point.change
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), -gradient)
        change = np.clip(point.change + step, lower, upper)
        products = simulate(first + unit * change)
        cost = products.mean_rmse / scale + prior * float(change @ change)
        return _RefitPoint(change, products, cost), 1.0  # see the damping rule

    def has_converged(point: _RefitPoint, previous_cost: float) -> bool:
        return previous_cost - point.cost < _COST_TOLERANCE * point.cost

    report = partial(
        report_step, problem, state, f"refit to free runs from {start.name}", start.name
    )

    def on_step(number: int, point: _RefitPoint, damping: float, is_accepted: bool) -> None:
        report(number, point.products.mean_rmse, damping, is_accepted)

    point, iterations = _RefitPoint(np.zeros(len(free)), initial, 1.0), 0
    if 0 < scale < np.inf:
        result = iterate(
            point,
            propose,
            has_converged,
            _DAMPING_RULE,
            10,  # iterations
            on_step,
            problem.should_stop,
        )
        if result.status == "stopped":
            return None
        point, iterations = result.point, result.iterations
    values = dict(zip(names, (first + unit * point.change).tolist(), strict=True))
    return Refit(scale, point.products.mean_rmse, iterations, values)


@dataclass(frozen=True)
class _FreeRunProducts:
    """Errors of the free runs of each record, and products of their derivatives.

    Attributes:
        rmse: (n_r,).
        matrix: `J'J` by the scaled parameters, (n_r, n_p, n_p).
        gradient: `J'r`, (n_r, n_p).
    """

    rmse: Float[np.ndarray, " n_r"]
    matrix: Float[np.ndarray, "n_r n_p n_p"]
    gradient: Float[np.ndarray, "n_r n_p"]

    @property
    def mean_rmse(self) -> float:
        """Mean over the records."""
        return float(np.mean(self.rmse))


def _make_simulation(
    problem: Problem, state: SearchState, start: Start, space: SearchSpace, unit: np.ndarray
) -> Callable[[Float[np.ndarray, " n_p"]], _FreeRunProducts]:
    """A function that simulates free runs of the training records with some parameters.

    The runs are whole records, or these cut end to end over the horizon of the search.

    Args:
        problem: the problem.
        state: the state after the search.
        start: the start of the free runs.
        space: the search space of the refit.
        unit: unit of each free parameter, by which its derivatives are multiplied, (n_p,).
    """
    model, records = make_model(problem, state), problem.records
    horizon = None if state.shortest_horizon is None else state.shortest_horizon * problem.motion.dt
    steps = horizon_samples(horizon, records, start)
    by_record = [pieces(e, steps, start) for e in records]
    parts = [part for own in by_record for part in own]
    record = np.repeat(np.arange(len(records)), list(map(len, by_record)))
    start_data, fit_states = start.start_data(model, parts), None
    if isinstance(start_data, FirstSamples):
        fit_states = partial(
            fit_states_with_derivatives, model, signal=start_data.signal, q=start_data.q
        )
        start_data = start_data.parabola
    residual = Residual((False,) * model.channels.n_q, (1.0,) * model.channels.n_q)
    options = CutOptions(residual, None, problem.measured_start.name, timestamps=False)
    segments = cut_records(parts, model, options, problem.group_indices(parts))
    # measured states, with the internal ones that are expected there
    x0 = np.zeros_like(segments.x0)
    x0[:, model.channels.measured] = np.asarray(start_data)[:, model.channels.measured]
    segments = replace(segments.with_fixed_states(x0), adds_expected=np.ones(len(parts)))
    # every record counts the same, however long
    lengths = segments.steps + 1
    share = lengths / np.bincount(record, lengths)[record]
    first_parts = first_of_records(record)

    def simulate(values: Float[np.ndarray, " n_p"]) -> _FreeRunProducts:
        vector = space.to_vector(dict(zip(space.names, values.tolist(), strict=True)))
        products = compute_products(
            problem.system, residual, space, vector, x0, segments, model.substeps, fit_states
        )
        chain = unit / space.derivatives(vector)
        matrix = products.pp * share[:, None, None] * np.outer(chain, chain)
        gradient, cost = products.gp * share[:, None] * chain, products.cost * share
        cost, matrix, gradient = (np.add.reduceat(x, first_parts) for x in (cost, matrix, gradient))
        return _FreeRunProducts(np.sqrt(cost), matrix, gradient)

    return simulate
