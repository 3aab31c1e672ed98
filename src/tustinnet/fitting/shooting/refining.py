"""Parameters as identified, fitted once more to free runs of whole records.

A search may find the initial state of a record along the whole of it, and minimises squares; a
free run has only its first samples for that. Where the model lacks physics, the parameters that
explain the records are not those that simulate them best. Both are told.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from tustinnet.data.experiment import Experiment
from tustinnet.engine.runs import Directions, Runs, Samples, compare
from tustinnet.fitting.listener import Iteration
from tustinnet.fitting.report import Identification, Refit
from tustinnet.fitting.shooting.equations import SystemEquations, system_equations
from tustinnet.fitting.shooting.problem import Problem, State, model_of, score
from tustinnet.fitting.shooting.space import Space
from tustinnet.models.integrate import Discretised
from tustinnet.models.parameters import Parameter
from tustinnet.simulate.horizon import horizon_samples, pieces
from tustinnet.simulate.input_signal import input_signal
from tustinnet.simulate.start_rules import FittedStart, Start
from tustinnet.simulate.state_fits import fit_states_with_derivatives, position_residual

_ITERATIONS = 10
_ENOUGH = 1e-3  # converged: gained by an iteration, of the cost
_KNOWN = 2.0  # what a parameter that doubles costs: the mean RMSE of so many records
_LEAST = 0.01  # of its range: the size of a parameter that is nearly 0
_WELL = 0.25  # of the mean RMSE: below it a record counts by its square
_DIFFERENCE = 1e-6  # of a parameter, of which derivatives are made where there is no better way
_DAMPING, _MOST_DAMPING = 1e-2, 1e6
_MOVED = 3  # parameters that moved most


def with_refined(
    problem: Problem, ended: State, start: Start, found: Identification
) -> Identification:
    """The identification with the model refined; what it says of the parameters stays."""
    if ended.fitted is None or ended.fitted.why == "diverged":
        return found
    # a delay is in the inputs, which free runs take as they are
    searched = [p for p in ended.space.searched if p.name not in problem.delays]
    short = ended.horizon is not None and ended.horizon < start.samples
    if short or not searched:
        why = f"segments shorter than {start.name} needs" if short else "nothing but delays is free"
        return replace(found, findings=(*found.findings, f"not fitted once more: {why}"))
    account = _refined(problem, ended, start, searched)
    if not np.isfinite(account.before):
        why = "free runs leave the range of numbers; `horizon` in the table [search] shortens them"
        return replace(found, findings=(*found.findings, f"not fitted once more: {why}"))
    space = ended.space
    numbers = space.numbers(ended.vector) | account.values
    state = replace(ended, vector=space.clipped(space.vector(numbers)))
    return replace(
        found,
        model=model_of(problem, state),
        validation_rmse=score(problem, state) if problem.validation else None,
        refit=account,
        findings=(*found.findings, _told(found, account, start)),
    )


def _told(found: Identification, account: Refit, start: Start) -> str:
    before, after = found.values, account.values
    moved = {name: abs(x / before[name] - 1) for name, x in after.items() if before[name]}
    most = sorted(moved, key=lambda name: -moved[name])[:_MOVED]
    told = ", ".join(f"{name} {before[name]:.3g} -> {after[name]:.3g}" for name in most)
    return (
        "the model has other values than the search found, fitted once more to free runs of the "
        f"training records from {start.name}: their mean RMSE went from {account.before:.3g} to "
        f"{account.after:.3g}; {told} moved most"
    )


@dataclass(frozen=True)
class _Task:
    """What parameters are fitted once more to.

    Attributes:
        space: the parameters that are searched for.
        first: their values, (n_p,).
        unit: what a change of 1 is, (n_p,): the value, unless it is nearly 0.
        model: the model as identified, with the inputs as they act.
        equations: its equations, with derivatives by these parameters.
        start: where the free runs start.
        pieces: the records, or their segments end to end over a horizon.
        record: index of the record of each of them, (n_s,).
        pick: which of their values parameters per group have in each, (n_s, n_g).
    """

    space: Space
    first: Float[np.ndarray, " n_p"]
    unit: Float[np.ndarray, " n_p"]
    model: Discretised
    equations: SystemEquations
    start: Start
    pieces: tuple[Experiment, ...]
    record: Int[np.ndarray, " n_s"]
    pick: Int[np.ndarray, "n_s n_g"]

    def values(self, change: Float[np.ndarray, " n_p"]) -> Float[np.ndarray, " n_p"]:
        """The parameters after relative changes."""
        return self.first + self.unit * change

    def at(self, change: Float[np.ndarray, " n_p"]) -> "_Runs":
        """The free runs there, and their products by the relative changes."""
        equations = self.equations
        named = dict(zip(self.space.names, self.values(change).tolist(), strict=True))
        values = equations.values(dict(self.space.fixed) | named, self.pick)
        x0, by_parameter = self._starts(values)
        lengths = self._lengths
        runs = Runs(
            start=x0,
            parameters=values,
            steps=lengths - 1,
            first=np.cumsum(lengths) - lengths,
            drive=self._drive,
            periods=np.full(len(self._drive), self.model.dt),
        )
        result = compare(
            equations.motion, position_residual(self.model.channels.n_q), runs, self.model.substeps,
            Directions(by_parameter, parameters=True), self._samples,
        )  # fmt: skip
        base = equations.base(self.space)
        chain = self.unit * equations.acts(self.space, self.pick)
        with np.errstate(over="ignore", invalid="ignore"):  # of what diverged
            matrix = result.products[:, base][:, :, base] * chain[:, :, None] * chain[:, None]
            gradient = result.gradient[:, base] * chain
            begins = np.flatnonzero(np.diff(self.record, prepend=-1))
            sums = [np.add.reduceat(x, begins) for x in (result.cost, matrix, gradient)]
        return _Runs(np.sqrt(sums[0]), sums[1], sums[2])

    # what stays the same from iteration to iteration

    @cached_property
    def _material(self) -> Any:
        """What the start needs of the records."""
        return self.start.start_data(self.model, self.pieces)

    @cached_property
    def _lengths(self) -> Int[np.ndarray, " n_s"]:
        """Samples of every free run."""
        return np.array([len(piece) - self.start.first for piece in self.pieces])

    @cached_property
    def _drive(self) -> Float[np.ndarray, "rows order n_u"]:
        """What acts between the samples, run after run, a row of zeros at the end of each."""
        first = self.start.first
        drives = [np.asarray(input_signal(self.model, e).u)[first:] for e in self.pieces]
        drive = np.concatenate([np.concatenate([u, np.zeros_like(u[:1])]) for u in drives])
        return drive[:, None] if drive.ndim == 2 else drive

    @cached_property
    def _samples(self) -> Samples:
        """Measured positions; every record counts the same, however long."""
        lengths = self._lengths
        of_record = np.bincount(self.record, lengths)
        weight = np.repeat(1 / np.sqrt(of_record[self.record]), lengths)
        q = np.concatenate([piece[self.start.first :].q for piece in self.pieces])
        return Samples(q, np.tile(weight[:, None], q.shape[1]))

    def _starts(
        self, values: Float[np.ndarray, "n_s n_c"]
    ) -> tuple[Float[np.ndarray, "n_s n_x"], Float[np.ndarray, "n_s n_b n_x"]]:
        """States in which the free runs start, and their derivatives by the parameters."""
        material = self._material
        if isinstance(self.start, FittedStart):
            guess, drive, q = material
            x0, by_guess = self._expected(guess, values)
            return fit_states_with_derivatives(
                self.model, self.equations.motion, values, x0, by_guess, drive, q
            )
        if not self.start.first:
            return self._expected(np.asarray(material), values)
        return self._differences(values)

    def _expected(
        self, measured: Float[np.ndarray, "n_s n_m"], values: Float[np.ndarray, "n_s n_c"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Measured states with the internal ones that are expected there."""
        n_z = len(self.model.internal)
        x0 = np.concatenate([measured, np.zeros((len(measured), n_z))], axis=1)
        begin, by_parameter, _ = self.equations.beginnings(x0, values, np.ones(len(x0)))
        return begin, by_parameter

    def _differences(self, values: Float[np.ndarray, "n_s n_c"]) -> tuple[np.ndarray, np.ndarray]:
        """States at the end of a warm-up; their derivatives by central differences."""
        material = self._material
        n_b = self.equations.n_p

        def states(values: np.ndarray) -> np.ndarray:
            made = [
                self.start.numeric_states(
                    model, jax.tree.map(lambda a, i=i: a[i : i + 1], material)
                )
                for i, model in enumerate(self.equations.models(self.model, values))
            ]
            return np.concatenate(made)

        slopes = []
        for i in range(n_b):
            step = _DIFFERENCE * np.maximum(np.abs(values[:, i]), _DIFFERENCE)
            above, below = values.copy(), values.copy()
            above[:, i] += step
            below[:, i] -= step
            slopes.append((states(above) - states(below)) / (2 * step[:, None]))
        return states(values), np.stack(slopes, axis=1)


def _task(problem: Problem, ended: State, start: Start, searched: Sequence[Parameter]) -> _Task:
    model, space = model_of(problem, ended), ended.space
    horizon = None if ended.horizon is None else ended.horizon * problem.motion.dt
    samples = horizon_samples(horizon, problem.records, start)
    cut = [pieces(e, samples, start) for e in problem.records]
    numbers = space.numbers(ended.vector)
    kept = {p.name for p in searched}
    fixed = {name: x for name, x in numbers.items() if name not in kept}
    first = np.array([numbers[p.name] for p in searched])
    record = np.repeat(np.arange(len(cut)), list(map(len, cut)))
    return _Task(
        space=Space(tuple(searched), fixed),
        first=first,
        unit=np.array([max(abs(x), _LEAST * (p.upper - p.lower))
                       for x, p in zip(first, searched, strict=True)]),
        model=model,
        equations=system_equations(problem.system, tuple(p.name for p in searched)),
        start=start,
        pieces=tuple(piece for of in cut for piece in of),
        record=record,
        pick=problem.picks(problem.records)[record],
    )  # fmt: skip


def _refined(problem: Problem, ended: State, start: Start, searched: Sequence[Parameter]) -> Refit:
    """Minimises the mean over the records of their RMSE, not of its square.

    A record that no parameter explains then pulls no more than others. A parameter's change
    relative to its value has a prior, so that what the records do not say stays as it was
    identified; the more records there are, the less it weighs. Initial states follow from the
    parameters, as they do in the free runs that judge.

    Levenberg-Marquardt, each record's squares weighed by one over its RMSE.

    Returns:
        What came of it; the values as they were where some free run leaves all numbers.
    """
    task = _task(problem, ended, start, searched)
    low, high = ((np.array([getattr(p, end) for p in searched]) - task.first) / task.unit
                 for end in ("lower", "upper"))  # fmt: skip
    change, damping, count = np.zeros(len(searched)), _DAMPING, 0
    now = task.at(change)
    scale, known = now.mean, _KNOWN / len(problem.records)

    def cost(of: _Runs, change: np.ndarray) -> float:
        return of.mean / scale + known * float(change @ change)

    usable = 0 < scale < np.inf
    while usable and count < _ITERATIONS and damping < _MOST_DAMPING:
        matrix, gradient = _normal(now, scale)
        matrix, gradient = matrix + known * np.eye(len(change)), gradient + known * change
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), -gradient)
        tried = np.clip(change + step, low, high)
        there = task.at(tried)
        gained = cost(now, change) - cost(there, tried)
        if not gained > 0:  # also where it is not a number
            damping *= 10
            continue
        change, now, damping, count = tried, there, damping / 10, count + 1
        stage = f"refining, free runs from {start.name}"
        problem.listener.on_iteration(Iteration(stage, count, now.mean, damping, start.name))
        if gained < _ENOUGH * cost(now, change):
            break
    names = [p.name for p in searched]
    values = dict(zip(names, task.values(change).tolist(), strict=True))
    return Refit(scale, now.mean, count, values)


class _Runs(NamedTuple):
    """Free runs, (records,) each, and their products by the parameters' relative changes."""

    rmse: Float[np.ndarray, " records"]
    matrix: Float[np.ndarray, "records n_p n_p"]
    gradient: Float[np.ndarray, "records n_p"]

    @property
    def mean(self) -> float:
        """Over the records."""
        return float(np.mean(self.rmse))


def _normal(runs: _Runs, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """The Gauss-Newton matrix and the gradient of half the mean RMSE over the scale."""
    rmse = np.maximum(runs.rmse, _WELL * scale)
    weight = 1 / (2 * scale * rmse * len(rmse))
    matrix = np.einsum("r,rij->ij", weight, runs.matrix)
    return matrix, np.einsum("r,ri->i", weight, runs.gradient)
