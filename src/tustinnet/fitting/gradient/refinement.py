"""Physics that is corrected, fitted once more with its correction as it is.

Windows teach a correction what the next second needs. Over whole records small errors of the
physics add up that no window shows; a few parameters are enough to mend them, and too few to learn
the records by heart.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.gradient.material import FreeRuns
from tustinnet.fitting.recipe import Refine
from tustinnet.models.contract import Model, require_float64
from tustinnet.models.lagrangian import LagrangianModel, Parameter
from tustinnet.simulate.rollout import rollout

AnyModel = TypeVar("AnyModel", bound=Model)
Told = Callable[[int, float, float], None]

_ITERATIONS = 10
_ENOUGH = 1e-3  # converged: gained by an iteration, of the cost
_KNOWN = 0.125  # what a parameter that doubles costs, of the mean RMSE
_LEAST = 0.01  # of its range: the size of a parameter that is nearly 0
_WELL = 0.25  # of the mean RMSE: below it a record counts by its square
_AT_ONCE = 8  # records simulated side by side
_DAMPING, _MOST_DAMPING = 1e-2, 1e6


@dataclass(frozen=True)
class Refined:
    """What a refinement came to.

    Attributes:
        before: mean free-run RMSE of the training records before it [rad or m].
        after: the same after it.
        iterations: how many steps were taken.
        values: the parameters that were searched for, by name.
    """

    before: float
    after: float
    iterations: int
    values: dict[str, float]


def refines(model: Model, asked: Refine, where: str) -> bool:
    """Whether a model is refined, as a recipe asks for it.

    Raises:
        InputError: it is to be and cannot, because it corrects no equations of motion or because
            all their parameters are fixed; or JAX computes in single precision.
    """
    if asked is False:
        return False
    equations = family_of(model).equations(model)
    possible = equations is not None and bool(_searched(equations))
    if possible:
        require_float64(where)
    elif asked is True:
        has = "physics without parameters" if equations is None else "all of its parameters fixed"
        raise InputError(
            where, f"refine = true, and {has}", "physics with parameters to search for",
            'set `refine` to "automatic" or leave it out',
        )  # fmt: skip
    return possible


def refined(model: AnyModel, runs: FreeRuns, told: Told) -> tuple[AnyModel, Refined]:
    """Fits the parameters of the physics to free runs, the correction as it is.

    Minimises the mean over the records of their RMSE, not of its square: a record that no
    parameter explains then pulls no more than others. A parameter's change relative to its value
    has a prior, so that what the records do not say stays as it was identified. Initial states
    follow from the parameters, as they do in the free runs that judge.

    Levenberg-Marquardt, each record's squares weighed by one over its RMSE.

    Args:
        model: corrects equations of motion, see `refines`.
        runs: free runs of the training records.
        told: called with the number, the mean RMSE and the damping of every iteration.

    Returns:
        The model, and what came of it. The model as it is where some free run leaves all numbers,
        or where nothing is left to explain.
    """
    equations = _equations(model)
    searched = _searched(equations)
    names = tuple(p.name for p in searched)
    lower, upper = (np.array([getattr(p, end) for p in searched]) for end in ("lower", "upper"))
    first = np.array([float(equations.values[name]) for name in names])
    unit = np.maximum(np.abs(first), _LEAST * (upper - lower))
    low, high = (lower - first) / unit, (upper - first) / unit

    def at(change: np.ndarray) -> _Runs:
        found = _runs(model, names, jnp.asarray(first), jnp.asarray(unit), change, runs)
        return _Runs(*map(np.asarray, found))

    change, damping, count = np.zeros(len(names)), _DAMPING, 0
    now = at(change)
    scale = float(now.rmse.mean())

    def account() -> Refined:
        values = dict(zip(names, (first + unit * change).tolist(), strict=True))
        return Refined(scale, float(now.rmse.mean()), count, values)

    if not 0 < scale < np.inf:
        return model, account()

    def cost(of: _Runs, change: np.ndarray) -> float:
        return float(of.rmse.mean()) / scale + _KNOWN * float(change @ change)

    while count < _ITERATIONS and damping < _MOST_DAMPING:
        matrix, gradient = _normal(now, scale, change)
        step = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), -gradient)
        tried = np.clip(change + step, low, high)
        there = at(tried)
        gained = cost(now, change) - cost(there, tried)
        if not gained > 0:  # also where it is not a number
            damping *= 10
            continue
        change, now, damping, count = tried, there, damping / 10, count + 1
        told(count, float(now.rmse.mean()), damping)
        if gained < _ENOUGH * cost(now, change):
            break
    return _with_values(model, names, jnp.asarray(first + unit * change)), account()


class _Runs(NamedTuple):
    """Free runs, (records,) each, and their products by the parameters' relative changes."""

    rmse: Array | np.ndarray
    matrix: Array | np.ndarray
    gradient: Array | np.ndarray


def _normal(runs: _Runs, scale: float, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The Gauss-Newton matrix and the gradient of half the cost."""
    rmse = np.maximum(np.asarray(runs.rmse), _WELL * scale)
    weight = 1 / (2 * scale * rmse * len(rmse))
    matrix = np.einsum("r,rij->ij", weight, runs.matrix) + _KNOWN * np.eye(len(change))
    return matrix, np.einsum("r,ri->i", weight, runs.gradient) + _KNOWN * change


@eqx.filter_jit
def _runs(
    model: Model,
    names: tuple[str, ...],
    first: Float[Array, " n_p"],
    unit: Float[Array, " n_p"],
    change: Float[Array | np.ndarray, " n_p"],
    runs: FreeRuns,
) -> _Runs:
    def errors(of: FreeRuns, change: Array) -> tuple[Array, Array]:
        here = _with_values(model, names, first + unit * change)
        x0 = runs.start.states(here, of.material)
        simulated = jax.vmap(partial(rollout, here))(x0, of.u)[..., here.channels.position]
        # beyond a record's end the model may do anything, also overflow
        error = jnp.where(of.weight[..., None] > 0, simulated - of.q, 0.0)
        error = (error * jnp.sqrt(of.weight)[..., None]).ravel()
        return error, error

    def record(of: FreeRuns) -> _Runs:
        by, error = jax.jacfwd(partial(errors, of), has_aux=True)(jnp.asarray(change))
        return _Runs(jnp.linalg.norm(error), by.T @ by, by.T @ error)

    return jax.lax.map(record, runs, batch_size=_AT_ONCE)


def _equations(model: Model) -> LagrangianModel:
    found = family_of(model).equations(model)
    assert found is not None
    return found


def _searched(equations: LagrangianModel) -> tuple[Parameter, ...]:
    """The parameters that identification would search for, those of groups as they are."""
    return tuple(
        p for p in equations.system.parameters if not p.fixed and p.name in equations.values
    )


def _with_values(model: AnyModel, names: tuple[str, ...], values: Array) -> AnyModel:
    def where(of: Any) -> list[Any]:  # also of a model whose leaves stand for themselves
        known = _equations(of).values
        return [known[name] for name in names]

    return eqx.tree_at(where, model, list(values))
