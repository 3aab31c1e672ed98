"""The problem of an identification, the state of its search, and how a state is scored.

`Problem` has what stays the same during a search: system, records and recipe. `SearchState` has
what changes from stage to stage: the parameters above all. The functions below make of the two
what several modules need: the cost function, the model, and the score on the validation records.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from tustinnet.data.experiment import Experiment
from tustinnet.finding import Finding
from tustinnet.fitting.listener import SILENT, Iteration, Listener, SearchProgress
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.residual import Residual, make_residual
from tustinnet.fitting.shooting.equation_error import MeasuredMotion, collect_motion
from tustinnet.fitting.shooting.groups import expand_parameters, group_indices
from tustinnet.fitting.shooting.identifiability import ConfoundedParameters
from tustinnet.fitting.shooting.least_squares import CostFunction, LeastSquaresResult, Prior
from tustinnet.fitting.shooting.normal import NormalProducts, compute_products
from tustinnet.fitting.shooting.segments import CutOptions, Segments, cut_records
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.models.sensors import delay_names, with_delays
from tustinnet.simulate.horizon import effective_horizon, horizon_samples, pieces
from tustinnet.simulate.start_names import FITTED
from tustinnet.simulate.start_rules import Start, start_named
from tustinnet.simulate.starts import default_start, measured_start, start_states

_HELD_HORIZON = 0.25  # s, of free runs of a system that a controller of unknown kind held


@dataclass(frozen=True, eq=False)
class Problem:
    """The system, records and options of an identification, the same during the whole search.

    Attributes:
        system: the system whose parameters are identified.
        records: the training records.
        validation: the validation records, whose free runs choose how initial states are treated.
        search: the options of the search, as the recipe has them.
        listener: gets every iteration and every stage; asked before each whether to stop.
        remarks: findings about the records, before the search.
    """

    system: LagrangianSystem
    records: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    search: SearchRecipe
    listener: Listener = SILENT
    remarks: tuple[Finding, ...] = ()

    def should_stop(self) -> bool:
        """Whether the search ends before its next step."""
        return self.listener.should_stop(0.0)

    @cached_property
    def plant(self) -> "Problem":
        """The problem of the system alone, without a controller in the loop."""
        return replace(
            self,
            system=self.system.plant,
            records=tuple(e.without_controller() for e in self.records),
            validation=tuple(e.without_controller() for e in self.validation),
        )

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The system's parameters, of those per group one for each value among the records."""
        return expand_parameters(self.system, self.records)

    def group_indices(self, records: Sequence[Experiment]) -> Int[np.ndarray, "n_r n_g"]:
        """Values of parameters per group that apply in records, see `groups.group_indices`."""
        return group_indices(self.system, self.parameters, records)

    @cached_property
    def motion(self) -> MeasuredMotion:
        """The measured motion of the training records."""
        return collect_motion(self.records, self.group_indices(self.records))

    @cached_property
    def residual(self) -> Residual:
        """The residual: how simulation and measurement are compared."""
        return make_residual(self.search, self.records)

    @cached_property
    def default_start(self) -> Start:
        """The start of free runs of whole records."""
        return start_named(default_start([*self.records, *self.validation], self.nominal_model))

    @property
    def measured_start(self) -> Start:
        """The start of free runs whose initial states are found without a model."""
        return start_named(measured_start([*self.records, *self.validation]))

    def scoring_start(self, horizon: int | None) -> Start:
        """The start of the free runs that are scored, over a horizon in steps or as a whole.

        What errs in a velocity that was read from a few samples grows over a horizon to more
        than any model misses; a state fitted through the model has no such error. A controller in
        the loop leaves nothing of an error, and later samples say little of the state before them.
        """
        fitted = start_named(FITTED.usual)
        if horizon is None or horizon < fitted.samples or self.system.feedback is not None:
            return self.default_start
        return fitted

    @cached_property
    def refit_start(self) -> Start | None:
        """The start of the free runs that the parameters are refitted to; None without a refit."""
        name = self.search.refine
        return None if name == "none" else start_named(name)

    @cached_property
    def recipe_horizons(self) -> dict[str, int] | None:
        """Horizons in steps by record, where the recipe has a horizon; else None.

        Forces are compared where a controller holds a system that no free run follows for long.
        """
        records, horizon = (*self.records, *self.validation), self.search.horizon
        is_open = self.system.feedback is None
        if horizon is None and is_open and self.search.is_by_forces:
            # of slow machines it would be less than a start needs, short records are whole
            fewest = max(2, self.measured_start.samples)
            horizon = effective_horizon(max(_HELD_HORIZON, fewest * records[0].dt), records)
        samples = horizon_samples(horizon, records, self.measured_start, "search.horizon")
        return None if samples is None else {e.name: samples for e in records if len(e) > samples}

    @property
    def delays(self) -> tuple[str, ...]:
        """Names of the delays of inputs that are parameters."""
        return delay_names(self.system.sensors)

    @property
    def early_initial_treatment(self) -> str:
        """The treatment of initial states in all stages but the final one, see `CutOptions`."""
        chosen = self.search.initial
        return "anchored" if chosen in ("choose", "unanchored") else chosen

    @cached_property
    def nominal_model(self) -> Discretised:
        """The system with its nominal values, for the layout of its states."""
        return self.model(self.system.nominal())

    def model(self, values: Mapping[str, float], substeps: int = 1) -> Discretised:
        """The system with some values; between the samples its inputs are as the records say."""
        arrays = {name: jnp.asarray(x) for name, x in values.items()}
        first = self.records[0]
        inputs = with_delays(first.inputs, values)
        return discretise(self.system.model(arrays), first.dt, substeps, inputs=inputs)

    def products(
        self, space: SearchSpace, vector: ParameterVector, segments: Segments, substeps: int
    ) -> NormalProducts:
        """Products of residuals and derivatives of segments from their own initial states."""
        return compute_products(
            self.system, self.residual, space, vector, segments.x0, segments, substeps
        )

    def segments(
        self, steps: int | None, initial_treatment: str, horizons: Mapping[str, int]
    ) -> Segments:
        """The training records cut into segments.

        Args:
            steps: longest segment in steps, None for whole records.
            initial_treatment: see `CutOptions`.
            horizons: longest segment of single records in steps, by name.
        """
        options = CutOptions(
            residual=self.residual,
            steps=steps,
            initial_treatment=initial_treatment,
            horizons=horizons,
            has_delays=bool(self.delays),
        )
        indices = self.group_indices(self.records)
        return cut_records(self.records, self.nominal_model, options, indices)

    def free_runs(self, records: Sequence[Experiment]) -> Segments:
        """Records as a whole from `measured_start`; no initial state is searched for."""
        options = CutOptions(
            residual=self.residual,
            initial_treatment=self.measured_start.name,
            timestamps=False,
            has_delays=bool(self.delays),
        )
        return cut_records(records, self.nominal_model, options, self.group_indices(records))


@dataclass(frozen=True)
class SearchState:
    """The state of a search between two stages.

    Attributes:
        space: the search space: free and fixed parameters.
        vector: the free parameters.
        substeps: integration steps in a sampling period.
        variance: mean squared residual of a record's positions so far.
        result: result of the last stage that was finished, None before the first.
        stage: what that stage was doing.
        initial_treatment: how initial states were treated in it.
        finished_stages: how many stages were finished.
        stages: how many the search has, 0 while that is not known.
        is_stopped: whether the search was stopped before its end; the rest is that of the last
            finished stage.
        worst_unexplained: share of the worst record's change of momentum that the equation-error
            estimate does not explain; None where no estimate was made.
        horizons: steps over which records are compared that cannot be simulated as a whole, by
            name; validation records too.
        longest_stable: steps of the longest segments whose simulations stay finite, where those of
            longer ones diverge; None where whole records can be simulated.
        remarks: findings of the search so far.
        confounded: parameters that the records do not tell apart; one of each set is fixed.
        robust_weights: weight of every squared residual in a robust search, (n, n_q); None while
            each weighs the same.
        has_fitted_values: whether the values were fitted to forces, or to short segments, of the
            records already, so that no equation-error estimate is needed.
    """

    space: SearchSpace
    vector: ParameterVector
    substeps: int = 1
    variance: float = 1e-4  # before residuals are known
    result: LeastSquaresResult | None = None
    stage: str = ""
    initial_treatment: str = ""
    finished_stages: int = 0
    stages: int = 0
    is_stopped: bool = False
    worst_unexplained: float | None = None
    horizons: Mapping[str, int] = field(default_factory=dict)
    longest_stable: int | None = None
    remarks: tuple[Finding, ...] = ()
    confounded: tuple[ConfoundedParameters, ...] = ()
    robust_weights: np.ndarray | None = None
    has_fitted_values: bool = False

    @property
    def last_result(self) -> LeastSquaresResult:
        """Result of the last stage; there must have been one."""
        assert self.result is not None
        return self.result

    @property
    def has_diverged(self) -> bool:
        """Whether the simulations of the last stage diverged."""
        return self.last_result.status == "diverged"

    @property
    def shortest_horizon(self) -> int | None:
        """The shortest of the horizons, of training and validation records, in steps.

        None where each of them is simulated as a whole.
        """
        return min(self.horizons.values(), default=None)


def report_step(
    problem: Problem,
    state: SearchState,
    stage: str,
    initial_treatment: str,
    number: int,
    cost: float,
    damping: float,
    is_accepted: bool,
) -> None:
    """Reports a step of a stage to the listener, as an iteration where it was accepted.

    Args:
        problem: the problem.
        state: the state before the stage.
        stage: what the stage is doing.
        initial_treatment: how initial states are treated in it.
        number: iterations of the stage so far.
        cost: the lowest so far.
        damping: Levenberg-Marquardt's.
        is_accepted: whether the step was accepted.
    """
    if is_accepted:
        problem.listener.on_iteration(Iteration(stage, number, cost, damping, initial_treatment))
    count = state.finished_stages + 1 if state.stages else 0
    problem.listener.on_progress(SearchProgress(stage, count, state.stages, number, cost))


def make_prior(problem: Problem, state: SearchState) -> Prior:
    """The prior of the parameters, comparable with residuals of the size so far."""
    parameters = state.space.free_parameters
    samples = sum(len(e) for e in problem.records)
    return Prior(
        centre=np.array([p.nominal for p in parameters]),
        precision=np.array([1 / p.prior if p.prior else 0.0 for p in parameters]),
        weight=state.variance * len(problem.records) / samples,
    )


def make_cost_function(
    problem: Problem, state: SearchState, segments: Segments, substeps: int
) -> CostFunction:
    """The cost of segments, with anchors and prior that weigh as residuals of the size so far."""
    return CostFunction(
        system=problem.system,
        residual=problem.residual,
        space=state.space,
        segments=segments,
        prior=make_prior(problem, state),
        anchor_variance=state.variance,
        substeps=substeps,
    )


def make_model(problem: Problem, state: SearchState) -> Discretised:
    """The model with the parameters of a state."""
    return problem.model(state.space.to_values_in_range(state.vector), state.substeps)


def position_errors(
    problem: Problem, state: SearchState, segments: Segments, substeps: int
) -> list[np.ndarray]:
    """Simulated minus measured positions of segments, (samples, n_q) each [rad or m]."""
    return list(problem.products(state.space, state.vector, segments, substeps).error)


def score_validation(problem: Problem, state: SearchState) -> float:
    """Mean free-run RMSE of the validation records [rad or m]; there must be some."""
    start = problem.scoring_start(state.shortest_horizon)
    parts = [pieces(e, state.shortest_horizon, start) for e in problem.validation]
    all_parts = [part for record_parts in parts for part in record_parts]
    segments = problem.free_runs(all_parts)
    if start.needs_model:
        model = make_model(problem, state)
        segments = segments.with_fixed_states(start_states(model, all_parts, start))
    errors = position_errors(problem, state, segments, state.substeps)
    record = np.repeat(np.arange(len(parts)), list(map(len, parts)))
    squares = np.bincount(record, [float(np.sum(error**2)) for error in errors])
    rmse = float(np.mean(np.sqrt(squares / [len(e) for e in problem.validation])))
    return rmse if np.isfinite(rmse) else np.inf
