"""Refit: parameters fitted once more after the search, to free runs of the training records.

A search may find the initial state of a record along the whole of it, and minimises squares; a
free run has only its first samples for that. Where the model lacks physics, the parameters that
explain the records are not those that simulate them best. `refit_to_free_runs` takes the state
after the search and its identification, and returns the latter with the refitted model; the
estimates of the search stay beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.engine.runs import Directions, Runs, Samples, compare
from tustinnet.fitting.listener import Iteration
from tustinnet.fitting.report import Identification, Refined
from tustinnet.fitting.shooting.equations import SystemEquations, system_equations
from tustinnet.fitting.shooting.levenberg_marquardt import DampingRule, Trial, iterate
from tustinnet.fitting.shooting.problem import (
    Problem,
    SearchState,
    make_model,
    score_validation,
)
from tustinnet.fitting.shooting.space import SearchSpace
from tustinnet.models.integrate import Discretised
from tustinnet.models.parameters import Parameter
from tustinnet.simulate.drive import drive_of
from tustinnet.simulate.horizon import horizon_samples, pieces
from tustinnet.simulate.starts import Fitted, Start
from tustinnet.simulate.state_fits import fitted_with_derivatives, positions

_MAX_ITERATIONS = 10
_TOLERANCE = 1e-3  # converged: decrease by an iteration, of the cost
_PRIOR = 2.0  # cost of a parameter that doubles: the mean RMSE of so many records
_LEAST = 0.01  # of its range: the size of a parameter that is nearly 0
_WELL = 0.25  # of the mean RMSE: below it a record counts by its square
_LISTED = 3  # parameters that changed most

# any decrease will do, whatever was predicted
_DAMPING_RULE = DampingRule(
    initial=1e-2,
    largest=9e5,
    increase=10,
    decreased=lambda damping, _: damping / 10,
    least_gain_ratio=0.0,
)


def refit_to_free_runs(
    problem: Problem, state: SearchState, start: Start, identification: Identification
) -> Identification:
    """Refits the parameters to free runs of the training records.

    Args:
        problem: the problem.
        state: the state after the search.
        start: the start of the free runs.
        identification: the identification by the search.

    Returns:
        The identification with the refitted model; its estimates, their errors and all that was
        said of them stay. Unchanged but for a finding where a refit is not possible.
    """
    if state.has_diverged:
        return identification
    # a delay is in the inputs, which free runs take as they are
    free = [p for p in state.space.free_parameters if p.name not in problem.delays]
    obstacle, refit = "", None
    if state.horizon is not None and state.horizon < start.samples:
        obstacle = f"{start.name} requires longer segments"
    elif not free:
        obstacle = "nothing but delays is free"
    else:
        refit = _minimise_mean_rmse(problem, state, start, free)
        if not np.isfinite(refit.before):
            obstacle = "free runs diverge; `horizon` in the table [search] shortens them"
    if refit is None or obstacle:
        finding = f"no refit to free runs: {obstacle}"
        return replace(identification, findings=(*identification.findings, finding))

    space, before, after = state.space, identification.values, refit.values
    values = space.to_values_in_range(state.vector) | after
    refitted = replace(state, vector=space.clip(space.to_vector(values)))
    changes = {name: abs(x / before[name] - 1) for name, x in after.items() if before[name]}
    most = sorted(changes, key=lambda name: -changes[name])[:_LISTED]
    listed = ", ".join(f"{name} {before[name]:.3g} -> {after[name]:.3g}" for name in most)
    finding = (
        "the parameters of the model were refitted to free runs of the training records from "
        f"{start.name}: their mean RMSE went from {refit.before:.3g} to {refit.after:.3g}; "
        f"{listed} changed most"
    )
    return replace(
        identification,
        model=make_model(problem, refitted),
        validation_rmse=score_validation(problem, refitted) if problem.validation else None,
        refined=refit,
        findings=(*identification.findings, finding),
    )


@dataclass(frozen=True)
class _Point:
    """Relative changes of the parameters, the free runs there, and the cost."""

    change: Float[np.ndarray, " n_p"]
    products: "_FreeRunProducts"
    cost: float


def _minimise_mean_rmse(
    problem: Problem, state: SearchState, start: Start, free: Sequence[Parameter]
) -> Refined:
    """Minimises the mean over the records of their RMSE, not of its square.

    A record that no parameter explains then pulls no more than others. A parameter's change
    relative to its value has a prior, so that what the records do not say stays as it was
    identified; the more records there are, the less it weighs. Initial states follow from the
    parameters, as they do in the free runs that are scored.

    Levenberg-Marquardt, each record's squares weighed by one over its RMSE.

    Returns:
        The values before and after; unchanged where some free run diverges.
    """
    names = [p.name for p in free]
    identified = state.space.to_values_in_range(state.vector)
    first = np.array([identified[name] for name in names])
    # a change of 1 is the value, unless it is nearly 0
    unit = np.array([max(abs(x), _LEAST * (p.upper - p.lower))
                     for x, p in zip(first, free, strict=True)])  # fmt: skip
    lower = (np.array([p.lower for p in free]) - first) / unit
    upper = (np.array([p.upper for p in free]) - first) / unit
    fixed = {name: x for name, x in identified.items() if name not in names}
    runs = _make_free_runs(problem, state, start, SearchSpace(tuple(free), fixed))

    def simulate(change: np.ndarray) -> _FreeRunProducts:
        return runs.simulate(first + unit * change, unit)

    initial = simulate(np.zeros(len(free)))
    scale, prior = initial.mean_rmse, _PRIOR / len(problem.records)

    def propose(point: _Point, damping: float) -> Trial[_Point]:
        # Gauss-Newton matrix and gradient of half the mean RMSE over the scale
        rmse = np.maximum(point.products.rmse, _WELL * scale)
        weight = 1 / (2 * scale * rmse * len(rmse))
        matrix = np.einsum("r,rij->ij", weight, point.products.matrix) + prior * np.eye(len(free))
        gradient = np.einsum("r,ri->i", weight, point.products.gradient) + prior * point.change
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), -gradient)
        change = np.clip(point.change + step, lower, upper)
        products = simulate(change)
        cost = products.mean_rmse / scale + prior * float(change @ change)
        return Trial(_Point(change, products, cost), predicted_decrease=1.0)

    def on_iteration(number: int, point: _Point, damping: float) -> None:
        stage, mean_rmse = f"refit to free runs from {start.name}", point.products.mean_rmse
        problem.listener.iteration(Iteration(stage, number, mean_rmse, damping, start.name))

    point, iterations = _Point(np.zeros(len(free)), initial, 1.0), 0
    if 0 < scale < np.inf:
        result = iterate(
            point,
            propose,
            lambda point, previous: previous - point.cost < _TOLERANCE * point.cost,
            _DAMPING_RULE,
            _MAX_ITERATIONS,
            on_iteration,
        )
        point, iterations = result.point, result.iterations
    values = dict(zip(names, (first + unit * point.change).tolist(), strict=True))
    return Refined(scale, point.products.mean_rmse, iterations, values)


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


@dataclass(frozen=True)
class _FreeRuns:
    """Free runs of records, whole or cut end to end over a horizon.

    Attributes:
        space: the parameters that are free.
        model: the model as identified, with the inputs as they act.
        equations: its equations, with derivatives by the free parameters.
        start: the start of the free runs, at the first sample of each.
        parts: the records, or their parts over a horizon.
        record: index of the record of each part, (n_s,).
        group_indices: the values of parameters per group that apply in each part, (n_s, n_g).
    """

    space: SearchSpace
    model: Discretised
    equations: SystemEquations
    start: Start
    parts: tuple[Experiment, ...]
    record: Int[np.ndarray, " n_s"]
    group_indices: Int[np.ndarray, "n_s n_g"]

    def simulate(
        self, values: Float[np.ndarray, " n_p"], unit: Float[np.ndarray, " n_p"]
    ) -> _FreeRunProducts:
        """Simulates the free runs with values of the free parameters.

        Args:
            values: the values.
            unit: unit of each parameter, by which the derivatives are multiplied.
        """
        equations = self.equations
        by_name = dict(zip(self.space.names, values.tolist(), strict=True))
        parameter_rows = equations.parameter_rows(
            dict(self.space.fixed_values) | by_name, self.group_indices
        )
        x0, by_parameter = self._initial_states(parameter_rows)
        lengths = self._lengths
        result = compare(
            equations.motion,
            positions(self.model.channels.n_q),
            Runs(
                start=x0,
                parameters=parameter_rows,
                steps=lengths - 1,
                first=np.cumsum(lengths) - lengths,
                drive=self._inputs,
                periods=np.full(len(self._inputs), self.model.dt),
            ),
            self.model.substeps,
            Directions(by_parameter, parameters=True),
            self._samples,
        )
        free = equations.free_columns(self.space)
        chain = unit * equations.applicable(self.space, self.group_indices)
        with np.errstate(over="ignore", invalid="ignore"):  # of simulations that diverged
            matrix = result.products[:, free][:, :, free] * chain[:, :, None] * chain[:, None]
            gradient = result.gradient[:, free] * chain
            first_parts = np.flatnonzero(np.diff(self.record, prepend=-1))
            cost, matrix, gradient = (
                np.add.reduceat(x, first_parts) for x in (result.cost, matrix, gradient)
            )
        return _FreeRunProducts(np.sqrt(cost), matrix, gradient)

    # the same in every iteration

    @cached_property
    def _start_data(self) -> Any:
        """The samples that the start estimates initial states from, see `Start.material`."""
        return self.start.material(self.model, self.parts)

    @cached_property
    def _lengths(self) -> Int[np.ndarray, " n_s"]:
        """Samples of every free run."""
        return np.array([len(part) for part in self.parts])

    @cached_property
    def _inputs(self) -> Float[np.ndarray, "rows order n_u"]:
        """Inputs between the samples, run after run, a row of zeros at the end of each."""
        inputs = [np.asarray(drive_of(self.model, part).u) for part in self.parts]
        rows = np.concatenate([np.concatenate([u, np.zeros_like(u[:1])]) for u in inputs])
        return rows[:, None] if rows.ndim == 2 else rows

    @cached_property
    def _samples(self) -> Samples:
        """Measured positions; every record counts the same, however long."""
        lengths = self._lengths
        record_lengths = np.bincount(self.record, lengths)
        weight = np.repeat(1 / np.sqrt(record_lengths[self.record]), lengths)
        q = np.concatenate([part.q for part in self.parts])
        return Samples(q, np.tile(weight[:, None], q.shape[1]))

    def _initial_states(
        self, parameter_rows: Float[np.ndarray, "n_s n_c"]
    ) -> tuple[Float[np.ndarray, "n_s n_x"], Float[np.ndarray, "n_s n_b n_x"]]:
        """Initial states of the free runs, and their derivatives by the parameters."""
        measured, inputs, q = self._start_data, None, None
        if isinstance(self.start, Fitted):
            measured, inputs, q = self._start_data
        # measured states, with the internal ones that are expected there
        internal = np.zeros((len(measured), len(self.model.internal)))
        x0 = np.concatenate([np.asarray(measured), internal], axis=1)
        initial = self.equations.initial_states(x0, parameter_rows, np.ones(len(x0)))
        if inputs is None or q is None:
            return initial.states, initial.by_parameter
        return fitted_with_derivatives(
            self.model,
            self.equations.motion,
            parameter_rows,
            initial.states,
            initial.by_parameter,
            inputs,
            q,
        )


def _make_free_runs(
    problem: Problem, state: SearchState, start: Start, space: SearchSpace
) -> _FreeRuns:
    """The free runs of the training records, over the horizon of the search."""
    horizon = None if state.horizon is None else state.horizon * problem.motion.dt
    samples = horizon_samples(horizon, problem.records, start)
    parts = [pieces(e, samples, start) for e in problem.records]
    record = np.repeat(np.arange(len(parts)), list(map(len, parts)))
    return _FreeRuns(
        space=space,
        model=make_model(problem, state),
        equations=system_equations(problem.system, space.names),
        start=start,
        parts=tuple(part for record_parts in parts for part in record_parts),
        record=record,
        group_indices=problem.group_indices(problem.records)[record],
    )
