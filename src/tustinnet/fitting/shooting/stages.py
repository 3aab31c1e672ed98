"""The stages of a search: from first values over longer and longer segments to whole records.

A stage is data, and takes the state of the search to the next one; nothing is changed in place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.fitting.listener import Iteration
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.residual import Residual, residual_of
from tustinnet.fitting.shooting import inverse_dynamics
from tustinnet.fitting.shooting.by_gradient import minimise_by_gradient
from tustinnet.fitting.shooting.groups import expanded, picks
from tustinnet.fitting.shooting.identifiability import confounded
from tustinnet.fitting.shooting.inverse_dynamics import Motion
from tustinnet.fitting.shooting.least_squares import (
    Cost,
    Fitted,
    Limits,
    Prior,
    minimise,
)
from tustinnet.fitting.shooting.normal import Shape, lanes_for, normal_products
from tustinnet.fitting.shooting.segments import Cut, Segments, cut
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.simulate.starts import default_start
from tustinnet.simulate.substeps import PROBED_SECONDS, enough_substeps

_TARGET = 0.25  # integration error allowed, in encoder counts: less than rounding to them makes
_TARGET_SPAN = 1e-5  # or of the largest travel, where no count is known
_SWINGS = (4, 16)  # lengths of the first stages' segments, in quarters of a swing
_REFIT = Limits(1e-5, 20)
_FIRST_VARIANCE = 1e-4  # of residuals, before any are known
_METHODS = {"levenberg-marquardt": minimise, "l-bfgs": minimise_by_gradient}


@dataclass(frozen=True, eq=False)
class Problem:
    """What stays the same from stage to stage.

    Attributes:
        system: the system.
        records: the records to identify from.
        validation: the records whose free runs choose.
        search: how to identify.
        told: who is told of every iteration.
    """

    system: LagrangianSystem
    records: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]
    search: SearchRecipe
    told: Callable[[Iteration], None]

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
    def start(self) -> str:
        """Where the free runs start that judge."""
        return default_start([*self.records, *self.validation])

    @cached_property
    def residual(self) -> Residual:
        """What is compared."""
        return residual_of(self.search, self.records)

    @cached_property
    def longest(self) -> int:
        """Steps of the longest record."""
        return max(len(e) for e in (*self.records, *self.validation)) - 1

    @cached_property
    def judging(self) -> Segments:
        """The validation records' free runs, laid out once for all scores."""
        return self.free_runs(self.validation)

    @property
    def first(self) -> str:
        """How initial states are treated until the last stage."""
        chosen = self.search.initial
        return "anchored" if chosen in ("choose", "unanchored") else chosen

    @cached_property
    def nominal(self) -> Discretised:
        """The system with its nominal values, for the layout of its states."""
        values = {name: jnp.asarray(x) for name, x in self.system.nominal().items()}
        return discretise(self.system.model(values), self.records[0].dt)

    def shape(self, space: Space) -> Shape:
        """What the compiled program is made for."""
        lanes = lanes_for(len(self.records))
        return Shape(self.system, space.searched, self.residual, lanes, self.longest)

    def segments(self, length: int | None, initial: str) -> Segments:
        """The records cut for a stage."""
        searched = initial in ("anchored", "unanchored")
        how = Cut(
            residual=self.residual,
            length=length,
            start="estimated" if searched else initial,
            anchored=initial != "unanchored",
            timestamps=self.search.times == "recorded",
        )
        return cut(self.records, self.nominal, how, self.picks(self.records))

    def free_runs(self, records: Sequence[Experiment]) -> Segments:
        """Free runs from the start by which models are judged; nothing is searched for."""
        how = Cut(residual=self.residual, start=self.start, timestamps=False)
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
        unexplained: what the equations of motion leave of the worst record.
        remarks: what there is to say.
    """

    space: Space
    vector: Searched
    substeps: int = 1
    variance: float = _FIRST_VARIANCE
    fitted: Fitted | None = None
    unexplained: float = 0.0
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class SearchStage:
    """A stage.

    Attributes:
        initial: how initial states are treated: anchored, unanchored, or a start.
        limits: when it ends.
        swings: length of the segments in quarters of a swing, None for whole records.
    """

    initial: str
    limits: Limits
    swings: int | None = None


def search(problem: Problem, state: State) -> tuple[State, str, float | None]:
    """All stages; the state at the end, how initial states were treated, the validation RMSE."""
    begun = reduce(
        lambda now, step: step(problem, now), (_without_confounded, _first_values), state
    )
    rough = _chosen_substeps(problem, _run_all(problem, begun, _first_stages(problem)))
    wanted, last = (
        problem.search.initial,
        Limits(problem.search.tolerance, problem.search.iterations),
    )
    if wanted == "choose":
        rough, wanted = _better(problem, rough)
    ended = _run(problem, rough, SearchStage(wanted, last))
    return ended, wanted, score(problem, ended) if problem.validation else None


def _first_stages(problem: Problem) -> list[SearchStage]:
    short = [s for s in _SWINGS if s * problem.motion.length < max(map(len, problem.records)) - 1]
    return [
        *(SearchStage(problem.first, Limits(0.1, 20), swings) for swings in short),
        SearchStage(problem.first, Limits(1e-2, 30)),
    ]


def _better(problem: Problem, rough: State) -> tuple[State, str]:
    """Anchored or not: the better free run on the validation records decides."""
    if not problem.validation:
        return rough, "anchored"
    loose = _run(problem, rough, SearchStage("unanchored", Limits(1e-2, 15)))
    found = ((rough, "anchored"), (loose, "unanchored"))
    return min(found, key=lambda entry: score(problem, entry[0]))


def _run_all(problem: Problem, state: State, stages: Sequence[SearchStage]) -> State:
    return reduce(lambda now, stage: _run(problem, now, stage), stages, state)


def _run(problem: Problem, state: State, stage: SearchStage) -> State:
    """The state after a stage."""
    length = stage.swings and stage.swings * problem.motion.length
    name = "whole records"
    if length is not None:
        name = f"segments of {length * problem.motion.dt:.2g} s"
    cost = Cost(
        problem.shape(state.space), state.space, problem.segments(length, stage.initial),
        prior(problem, state),
        # over a few swings the integration error stays far below what the first stages leave
        state.substeps if length is None else max(1, state.substeps // 2),
    )  # fmt: skip

    def told(iterations: int, value: float, damping: float) -> None:
        problem.told(Iteration(f"{name}, {stage.initial} start", iterations, value, damping))

    fitted = _METHODS[problem.search.method](cost, state.vector, stage.limits, told)
    known = fitted.cost / len(problem.records) if fitted.why != "diverged" else state.variance
    return replace(state, vector=fitted.vector, fitted=fitted, variance=known)


def refitted(problem: Problem, state: State, segments: Segments) -> Fitted:
    """The parameters that fit other segments best, sought from where a search is."""
    cost = Cost(
        problem.shape(state.space), state.space, segments, prior(problem, state), state.substeps
    )
    return _METHODS[problem.search.method](cost, state.vector, _REFIT)


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


def _without_confounded(problem: Problem, state: State) -> State:
    """One parameter of every set that the records cannot tell apart is fixed."""
    space, vector = state.space, state.vector
    s = problem.segments(_SWINGS[0] * problem.motion.length, problem.first)
    found = normal_products(problem.shape(space), space, vector, s.x0, s, 1)
    products = found.pp.sum(axis=0)
    if not np.isfinite(products).all():
        told = "the first values simulate to infinity; identifiability was not checked"
        return replace(state, remarks=(*state.remarks, told))
    directions = confounded(space, vector, products)
    if not directions:
        return state
    names = {direction.suggestion for direction in directions}
    numbers = space.numbers(vector)
    searched = tuple(p for p in space.searched if p.name not in names)
    if not searched:
        raise InputError(
            f"system '{problem.system.name}'",
            "; ".join(str(direction) for direction in directions),
            "records that say something of at least one parameter",
        )
    fewer = Space(searched, dict(space.fixed) | {name: numbers[name] for name in names})
    told = [f"{direction}; here it was fixed at its first value" for direction in directions]
    return replace(
        state, space=fewer, vector=fewer.vector(numbers), remarks=(*state.remarks, *told)
    )


def _first_values(problem: Problem, state: State) -> State:
    """Least squares on the equations of motion, and what they leave of the worst record."""
    found, shares = inverse_dynamics.first_values(
        problem.system, state.space, state.vector, problem.motion
    )
    left = float(shares.max())
    problem.told(Iteration("first values", 1, left, 0.0))
    return _chosen_substeps(problem, replace(state, vector=found, unexplained=left))


def _chosen_substeps(problem: Problem, state: State) -> State:
    """Integration steps in a period, by the error target, unless they are given."""
    if problem.search.substeps:
        return replace(state, substeps=problem.search.substeps)
    counts = [r for r in problem.records[0].channels.resolution if r]
    reach = max(float(np.abs(e.q - e.q[-1]).max()) for e in problem.records)
    target = _TARGET * min(counts) if counts else _TARGET_SPAN * reach
    probed = max(2, round(PROBED_SECONDS / problem.records[0].dt))
    parts = problem.free_runs([e[:probed] for e in problem.records])
    chosen = enough_substeps(lambda n: _errors(problem, state, parts, n), target)
    return replace(state, substeps=chosen)


def _errors(problem: Problem, state: State, runs: Segments, substeps: int) -> np.ndarray:
    """Simulated minus measured positions of free runs, 0 after their ends."""
    space = state.space
    found = normal_products(problem.shape(space), space, state.vector, runs.x0, runs, substeps)
    return found.error[..., problem.system.channels.position]


def score(problem: Problem, state: State) -> float:
    """Mean free-run RMSE of the validation records [rad or m]."""
    error = _errors(problem, state, problem.judging, state.substeps)
    squares = np.sum(error**2, axis=(1, 2)) / [len(e) for e in problem.validation]
    found = float(np.mean(np.sqrt(squares)))
    return found if np.isfinite(found) else np.inf


def model_of(problem: Problem, state: State) -> Discretised:
    """The model with the values of a state."""
    values = {name: jnp.asarray(x) for name, x in state.space.numbers(state.vector).items()}
    return discretise(problem.system.model(values), problem.records[0].dt, state.substeps)
