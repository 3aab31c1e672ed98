"""What a search is about, where it stands, and how it is judged."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.residual import Residual, make_residual
from tustinnet.fitting.shooting import inverse_dynamics
from tustinnet.fitting.shooting.groups import expanded, picks
from tustinnet.fitting.shooting.inverse_dynamics import Motion
from tustinnet.fitting.shooting.least_squares import Fitted, Prior
from tustinnet.fitting.shooting.normal import Normal, normal_products
from tustinnet.fitting.shooting.segments import Cut, Segments, cut
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.models.sensors import delay_names, with_delays
from tustinnet.simulate.horizon import horizon_samples, pieces
from tustinnet.simulate.start_rules import FIT_SAMPLES, PARABOLA_SAMPLES, Start, start_named
from tustinnet.simulate.starts import default_start, start_states

_FIRST_VARIANCE = 1e-4  # of residuals, before any are known


@dataclass(frozen=True, eq=False)
class Problem:
    """What stays the same from stage to stage.

    Attributes:
        system: the system.
        records: the records to identify from.
        validation: the records whose free runs choose.
        search: how to identify.
        listener: who is told of every iteration and stage.
    """

    system: LagrangianSystem
    records: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    search: SearchRecipe
    listener: Listener = SILENT

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The system's parameters, of those per group one for each value among the records."""
        return expanded(self.system, self.records)

    def picks(self, records: Sequence[Experiment]) -> Int[np.ndarray, "n_r n_g"]:
        """Which of their values parameters per group have in records, see `groups.picks`."""
        return picks(self.system, self.parameters, records)

    @cached_property
    def motion(self) -> Motion:
        """The measured motion."""
        return inverse_dynamics.measured_motion(self.records, self.picks(self.records))

    @cached_property
    def usual_start(self) -> Start:
        """Where free runs of whole records start."""
        return start_named(default_start([*self.records, *self.validation]))

    @property
    def start(self) -> Start:
        """Where free runs start without a model."""
        usual = self.usual_start
        return start_named(f"derived-{PARABOLA_SAMPLES}") if usual.fitted_samples else usual

    def judging_start(self, horizon: int | None) -> Start:
        """Where the free runs start that judge, over a horizon or as a whole.

        What errs in a velocity that was read from a few samples grows over a horizon to more
        than any model misses; a state fitted through the model has no such error.
        """
        fitted = start_named(f"model-{FIT_SAMPLES}")
        return self.usual_start if horizon is None or horizon < fitted.samples else fitted

    @cached_property
    def residual(self) -> Residual:
        """What is compared."""
        return make_residual(self.search, self.records)

    @cached_property
    def asked(self) -> dict[str, int] | None:
        """Steps over which every record is to be fitted, by name, where the recipe says it."""
        every = (*self.records, *self.validation)
        samples = horizon_samples(self.search.horizon, every, self.start, "search.horizon")
        return None if samples is None else {e.name: samples for e in every if len(e) > samples}

    @cached_property
    def refining(self) -> Start | None:
        """Where the free runs start to which the parameters are fitted once more, if they are."""
        named = self.search.refine
        return None if named == "none" else start_named(named)

    @property
    def delays(self) -> tuple[str, ...]:
        """The delays of inputs that are searched for."""
        return delay_names(self.system.sensors)

    @property
    def first(self) -> str:
        """How initial states are treated until the last stage."""
        chosen = self.search.initial
        return "anchored" if chosen in ("choose", "unanchored") else chosen

    @cached_property
    def nominal(self) -> Discretised:
        """The system with its nominal values, for the layout of its states."""
        return self.model(self.system.nominal())

    def model(self, values: Mapping[str, float], substeps: int = 1) -> Discretised:
        """The system with some values; between the samples its inputs are as the records say."""
        arrays = {name: jnp.asarray(x) for name, x in values.items()}
        first = self.records[0]
        inputs = with_delays(first.inputs, values)
        return discretise(self.system.model(arrays), first.dt, substeps, inputs=inputs)

    def products(self, space: Space, vector: Searched, segments: Segments, substeps: int) -> Normal:
        """Products of residuals and derivatives of segments from their initial states."""
        return normal_products(
            self.system, self.residual, space, vector, segments.x0, segments, substeps
        )

    def segments(self, length: int | None, initial: str, horizons: Mapping[str, int]) -> Segments:
        """The records cut for a stage: to a length, or those that have one to their horizon."""
        searched = initial in ("anchored", "unanchored")
        how = Cut(
            residual=self.residual,
            length=length,
            start="estimated" if searched else initial,
            anchored=initial != "unanchored",
            horizons=horizons,
            delays=bool(self.delays),
        )
        return cut(self.records, self.nominal, how, self.picks(self.records))

    def free_runs(self, records: Sequence[Experiment]) -> Segments:
        """Free runs from the start by which models are judged; nothing is searched for."""
        how = Cut(
            residual=self.residual,
            start=self.start.name,
            timestamps=False,
            delays=bool(self.delays),
        )
        return cut(records, self.nominal, how, self.picks(records))


@dataclass(frozen=True)
class State:
    """Where a search is.

    Attributes:
        space: the parameters that are still searched for.
        vector: their values.
        substeps: integration steps in a period.
        variance: mean squared residual of a record so far.
        fitted: where the last stage ended, None before the first.
        segments: what that stage compared, None before the first.
        unexplained: what the equations of motion leave of the worst record.
        horizons: steps over which records are compared that cannot be simulated as a whole, by
            name; validation records too.
        remarks: what there is to say.
        weights: what every squared residual weighs, (n, n_y); None while all weigh the same.
        rough: whether its values come from simulations already, of short segments.
    """

    space: Space
    vector: Searched
    substeps: int = 1
    variance: float = _FIRST_VARIANCE
    fitted: Fitted | None = None
    segments: Segments | None = None
    unexplained: float = 0.0
    horizons: Mapping[str, int] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    weights: np.ndarray | None = None
    rough: bool = False

    @property
    def horizon(self) -> int | None:
        """Steps over which validation records are scored: what all of them can be; or None."""
        return min(self.horizons.values(), default=None)


def prior(problem: Problem, state: State) -> Prior:
    """What is known beforehand, made comparable with residuals of the size so far."""
    searched = state.space.searched
    samples = sum(len(e) for e in problem.records)
    return Prior(
        centre=np.array([p.nominal for p in searched]),
        precision=np.array([1 / p.prior if p.prior else 0.0 for p in searched]),
        variance=state.variance,
        weight=state.variance * len(problem.records) / samples,
    )


def errors_of(problem: Problem, state: State, runs: Segments, substeps: int) -> list[np.ndarray]:
    """Simulated minus measured positions of free runs, record by record."""
    found = problem.products(state.space, state.vector, runs, substeps)
    return [error[:, problem.system.channels.position] for error in found.error]


def score(problem: Problem, state: State) -> float:
    """Mean free-run RMSE of the validation records [rad or m]; there must be some."""
    start = problem.judging_start(state.horizon)
    cut = [pieces(e, state.horizon, start) for e in problem.validation]
    every = [piece for of in cut for piece in of]
    runs = problem.free_runs(every)
    if start.fitted_samples:
        model = model_of(problem, state)
        runs = runs.beginning_at(start_states(model, every, start))
    errors = errors_of(problem, state, runs, state.substeps)
    owner = np.repeat(np.arange(len(cut)), list(map(len, cut)))
    with np.errstate(over="ignore"):
        squares = np.bincount(owner, [float(np.sum(error**2)) for error in errors])
    found = float(np.mean(np.sqrt(squares / [len(e) for e in problem.validation])))
    return found if np.isfinite(found) else np.inf


def model_of(problem: Problem, state: State) -> Discretised:
    """The model with the values of a state."""
    return problem.model(state.space.numbers(state.vector), state.substeps)
