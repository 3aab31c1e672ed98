"""Parameters as identified, fitted once more to free runs of whole records.

A search may find the initial state of a record along the whole of it, and minimises squares; a
free run has only its first samples for that. Where the model lacks physics, the parameters that
explain the records are not those that simulate them best. Both are told.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.fitting.free_runs import FreeRuns, free_runs
from tustinnet.fitting.listener import Iteration
from tustinnet.fitting.report import Identification, Refined
from tustinnet.fitting.shooting.problem import Problem, State, model_of, score
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel, Parameter
from tustinnet.simulate.rollout import rollout
from tustinnet.simulate.starts import Start

_ITERATIONS = 10
_ENOUGH = 1e-3  # converged: gained by an iteration, of the cost
_KNOWN = 2.0  # what a parameter that doubles costs: the mean RMSE of so many records
_LEAST = 0.01  # of its range: the size of a parameter that is nearly 0
_WELL = 0.25  # of the mean RMSE: below it a record counts by its square
_AT_ONCE = 8  # records simulated side by side
_MOST = 20_000_000  # of their derivatives in memory
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
        refined=account,
        findings=(*found.findings, _told(found, account, start)),
    )


def _told(found: Identification, account: Refined, start: Start) -> str:
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
        model: the model as identified.
        searched: the parameters.
        first: their values, (n_p,).
        unit: what a change of 1 is, (n_p,): the value, unless it is nearly 0.
        runs: free runs of the training records.
        pick: which of their values parameters per group have in each record, or None.
    """

    model: Discretised
    searched: Sequence[Parameter]
    first: Float[np.ndarray, " n_p"]
    unit: Float[np.ndarray, " n_p"]
    runs: FreeRuns
    pick: Int[np.ndarray, "records n_g"] | None

    def values(self, change: Float[np.ndarray, " n_p"]) -> Float[np.ndarray, " n_p"]:
        """The parameters after relative changes."""
        return self.first + self.unit * change

    def at(self, change: Float[np.ndarray, " n_p"]) -> "_Runs":
        """The free runs there."""
        names = tuple(p.name for p in self.searched)
        records = self.runs, self.pick
        found = _runs(self.model, names, self.values(change), self.unit, records)
        return _Runs(*map(np.asarray, found))


def _task(problem: Problem, ended: State, start: Start, searched: Sequence[Parameter]) -> _Task:
    model = model_of(problem, ended)
    horizon = None if ended.horizon is None else ended.horizon * problem.motion.dt
    numbers = ended.space.numbers(ended.vector)
    first = np.array([numbers[p.name] for p in searched])
    return _Task(
        model=model,
        searched=searched,
        first=first,
        unit=np.array([max(abs(x), _LEAST * (p.upper - p.lower))
                       for x, p in zip(first, searched, strict=True)]),
        runs=free_runs(model, problem.records, start, horizon),
        pick=problem.picks(problem.records) if problem.system.grouped else None,
    )  # fmt: skip


def _refined(
    problem: Problem, ended: State, start: Start, searched: Sequence[Parameter]
) -> Refined:
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
        problem.listener.iteration(Iteration(stage, count, now.mean, damping, start.name))
        if gained < _ENOUGH * cost(now, change):
            break
    names = [p.name for p in searched]
    values = dict(zip(names, task.values(change).tolist(), strict=True))
    return Refined(scale, now.mean, count, values)


class _Runs(NamedTuple):
    """Free runs, (records,) each, and their products by the parameters' relative changes."""

    rmse: Array | np.ndarray
    matrix: Array | np.ndarray
    gradient: Array | np.ndarray

    @property
    def mean(self) -> float:
        """Over the records."""
        return float(np.mean(np.asarray(self.rmse)))


def _normal(runs: _Runs, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """The Gauss-Newton matrix and the gradient of half the mean RMSE over the scale."""
    rmse = np.maximum(np.asarray(runs.rmse), _WELL * scale)
    weight = 1 / (2 * scale * rmse * len(rmse))
    matrix = np.einsum("r,rij->ij", weight, runs.matrix)
    return matrix, np.einsum("r,ri->i", weight, runs.gradient)


@eqx.filter_jit
def _runs(
    model: Discretised,
    names: tuple[str, ...],
    values: Float[Array | np.ndarray, " n_p"],
    unit: Float[Array | np.ndarray, " n_p"],
    records: tuple[FreeRuns, Int[Array | np.ndarray, "records n_g"] | None],
) -> _Runs:
    def errors(of: FreeRuns, pick: Array | None, change: Array) -> tuple[Array, Array]:
        here = _with_values(model, dict(zip(names, values + unit * change, strict=True)), pick)
        x0 = runs.start.states(here, of.material)
        simulated = jax.vmap(partial(rollout, here))(x0, of.u)[..., here.channels.position]
        # beyond a record's end the model may do anything, also overflow
        error = jnp.where(of.weight[..., None] > 0, simulated - of.q, 0.0)
        error = (error * jnp.sqrt(of.weight)[..., None]).ravel()
        return error, error

    def record(of: tuple[FreeRuns, Array | None]) -> _Runs:
        by, error = jax.jacfwd(partial(errors, *of), has_aux=True)(jnp.zeros(len(unit)))
        return _Runs(jnp.linalg.norm(error), by.T @ by, by.T @ error)

    runs, _ = records
    held = runs.q[0].size * len(unit)  # derivatives of a record
    return jax.lax.map(record, records, batch_size=max(1, min(_AT_ONCE, _MOST // held)))


def _with_values(model: Discretised, values: dict[str, Any], pick: Array | None) -> Discretised:
    """The model with other values, and of parameters per group with those of a record."""
    equations = model.continuous
    assert isinstance(equations, LagrangianModel)
    known = equations.values | values
    if pick is not None:
        known = equations.system.picked(known, pick)
    return replace(model, continuous=LagrangianModel(equations.system, known))
