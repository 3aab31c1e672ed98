"""Simulation errors of segments and their exact derivatives, compiled once.

This is the package's second loop over time. It carries the derivatives by all parameters along,
adds up their products sample by sample, so that no derivative is kept, and takes as many steps as
it is told, which `simulate.rollout` does not; docs/explanation/identification.md has what that is
worth.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.cores import cores
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.segments import Segments, beginning
from tustinnet.fitting.shooting.space import Space
from tustinnet.models.integrate import between, runge_kutta_4
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Parameter
from tustinnet.models.sensors import delay_of

_LANES = 8  # segments side by side in one call: one vector of the processor
_STRETCH = 512  # steps in one call; longer segments take several, one after the other


@dataclass(frozen=True)
class Shape:
    """What the compiled program is made for.

    Attributes:
        system: the system.
        searched: the parameters that are searched for.
        residual: what is compared.
        lanes: segments side by side.
    """

    system: LagrangianSystem
    searched: tuple[Parameter, ...]
    residual: Residual
    lanes: int

    def model(self, fixed: Mapping[str, Any], vector: Array, pick: Array) -> LagrangianModel:
        """The equations of motion of a segment; can be compiled, and differentiated."""
        values = Space(self.searched, fixed).values(vector)
        return self.system.model(self.system.picked(values, pick))


@dataclass(frozen=True)
class Normal:
    """What least squares needs of every segment: products of its residuals and derivatives.

    With residuals `r`, derivatives `J` by the parameters and `X` by the initial state:

    Attributes:
        pp: `J'J`, (n_s, n_p, n_p).
        px: `J'X`, (n_s, n_p, n_x).
        xx: `X'X`, (n_s, n_x, n_x).
        gp: `J'r`, (n_s, n_p).
        gx: `X'r`, (n_s, n_x).
        cost: `r'r`, (n_s,).
        error: simulated minus measured, not weighted, of each (its samples, n_y).
    """

    pp: Float[np.ndarray, "n_s n_p n_p"]
    px: Float[np.ndarray, "n_s n_p n_x"]
    xx: Float[np.ndarray, "n_s n_x n_x"]
    gp: Float[np.ndarray, "n_s n_p"]
    gx: Float[np.ndarray, "n_s n_x"]
    cost: Float[np.ndarray, " n_s"]
    error: tuple[Float[np.ndarray, "_ n_y"], ...]


def lanes_for(records: int) -> int:
    """How many segments side by side serve so many records well, a call for each core."""
    return min(_LANES, max(2, -(-records // cores())))


class _Lane(NamedTuple):
    """A stretch of a segment as the compiled program takes it; see `Segments`."""

    drive: Any
    later: Any
    periods: Any
    target: Any
    weight: Any
    pick: Any


class _Sums(NamedTuple):
    """The products so far; the directions are every parameter, then the initial state."""

    products: Any
    gradient: Any
    cost: Any


class _At(NamedTuple):
    """Where a segment's simulation stands: the state, its derivatives, what was added up."""

    x: Any
    dx: Any
    sums: _Sums


def normal_products(
    shape: Shape,
    space: Space,
    vector: Float[np.ndarray, " n_p"],
    x0: Float[np.ndarray, "n_s n_x"],
    segments: Segments,
    substeps: int,
) -> Normal:
    """Products of residuals and derivatives of segments, from the given initial states.

    One program serves segments of every length: it takes as many steps as the longest of those
    side by side. Calls run side by side, a core each: compiled programs release the GIL.

    Args:
        shape: what the program is made for.
        space: the parameters' coordinates.
        vector: the parameters.
        x0: initial states, (n_s, n_x).
        segments: the segments.
        substeps: integration steps in a period.
    """
    segments = segments.driven(space.numbers(vector))
    # side by side stand segments of like length: a lane idles from its end to the longest's
    order = np.argsort(-segments.steps, kind="stable")
    groups = [order[i : i + shape.lanes] for i in range(0, len(order), shape.lanes)]
    fixed = space.fixed_arrays

    def run(rows: Int[np.ndarray, " lanes"]) -> tuple[_Sums, list[np.ndarray]]:
        at, errors = _begun(shape, fixed, vector, (x0, segments, rows)), []
        steps = segments.steps[rows]
        for begin in range(0, int(steps.max()), _STRETCH):
            lanes, ahead = _laid(segments, rows, begin, shape.lanes), int(steps.max()) - begin
            count = min(ahead, _STRETCH), substeps
            at, error = _advanced(shape, fixed, vector, at, lanes, count)
            errors.append(np.asarray(error)[:, min(begin, 1) : count[0] + 1])
        whole = np.concatenate(errors, axis=1)
        return at.sums, [e[: n + 1] for e, n in zip(whole, steps, strict=False)]

    with ThreadPoolExecutor(cores()) as pool:
        found = list(pool.map(run, groups))
    back, n_p = np.argsort(order, kind="stable"), len(vector)
    products, gradient, cost = (
        np.concatenate([np.asarray(part) for part in parts])[back]  # only the last has idle lanes
        for parts in zip(*(sums for sums, _ in found), strict=True)
    )
    errors = [error for _, each in found for error in each]
    return Normal(
        pp=products[:, :n_p, :n_p],
        px=products[:, :n_p, n_p:],
        xx=products[:, n_p:, n_p:],
        gp=gradient[:, :n_p],
        gx=gradient[:, n_p:],
        cost=cost,
        error=tuple(errors[i] for i in back),
    )


def _begun(
    shape: Shape,
    fixed: dict[str, np.ndarray],
    vector: Float[np.ndarray, " n_p"],
    begins: tuple[np.ndarray, Segments, Int[np.ndarray, " lanes"]],
) -> _At:
    """Segments side by side before their first step; idle lanes repeat a sound state."""
    x0, segments, rows = begins
    rows = np.resize(rows, shape.lanes)
    n_d = len(vector) + x0.shape[1]
    sums = _Sums(
        np.zeros((shape.lanes, n_d, n_d)), np.zeros((shape.lanes, n_d)), np.zeros(shape.lanes)
    )
    lanes = x0[rows], segments.expected[rows], segments.pick[rows]
    x, by_parameter, by_state = _beginnings(shape, fixed, vector, lanes)
    searched = segments.searched[rows][:, :, None] * np.swapaxes(by_state, 1, 2)
    return _At(x, np.concatenate([np.swapaxes(by_parameter, 1, 2), searched], axis=1), sums)


@partial(jax.jit, static_argnums=0)
def _beginnings(
    shape: Shape, fixed: Mapping[str, Any], vector: Array, lanes: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """The states in which segments begin, and their derivatives by parameters and by `x0`."""

    def one(vector: Array, x0: Array, expected: Array, pick: Array) -> Array:
        return beginning(shape.model(fixed, vector, pick), x0, expected)

    every = (None, 0, 0, 0)
    by_parameter, by_state = (jax.vmap(jax.jacfwd(one, i), every) for i in (0, 1))
    at = vector, *lanes
    return jax.vmap(one, every)(*at), by_parameter(*at), by_state(*at)


def _laid(s: Segments, rows: Int[np.ndarray, " lanes"], begin: int, lanes: int) -> _Lane:
    """A stretch of some segments in arrays of zeros, as many lanes and steps as there may be."""
    laid = _Lane(
        np.zeros((lanes, _STRETCH, *s.drive.shape[1:])),
        None if s.later is None else np.zeros((lanes, _STRETCH, *s.drive.shape[1:])),
        np.zeros((lanes, _STRETCH)),
        np.zeros((lanes, _STRETCH + 1, s.target.shape[1])),
        np.zeros((lanes, _STRETCH + 1, s.target.shape[1])),
        s.pick[np.resize(rows, lanes)],
    )
    for lane, row in enumerate(rows):
        steps = min(int(s.steps[row]) - begin, _STRETCH)
        if steps > 0:
            a = int(s.first[row]) + begin
            laid.drive[lane, :steps] = s.drive[a : a + steps]
            if s.later is not None:
                laid.later[lane, :steps] = s.later[a : a + steps]
            laid.periods[lane, :steps] = s.periods[a : a + steps]
            laid.target[lane, : steps + 1] = s.target[a : a + steps + 1]
            laid.weight[lane, : steps + 1] = s.weight[a : a + steps + 1]
    if begin:
        laid.weight[:, 0] = 0.0  # counted at the end of the stretch before
    return laid


@partial(jax.jit, static_argnums=0)
def _advanced(
    shape: Shape,
    fixed: dict[str, Array],
    vector: Array,
    at: _At,
    lanes: _Lane,
    count: tuple[Any, Any],
) -> tuple[_At, Array]:
    def advanced(at: _At, lane: _Lane) -> tuple[_At, Array]:
        def model_of(p: Array) -> LagrangianModel:
            return shape.model(fixed, p, lane.pick)

        return _stretch(shape.residual, model_of, vector, (at, lane), count)

    return jax.vmap(advanced)(at, lanes)


def _stretch(
    residual: Residual,
    model_of: Callable[[Array], Any],
    vector: Array,
    begun: tuple[_At, _Lane],
    count: tuple[Any, Any],
) -> tuple[_At, Array]:
    """Where a segment stands after a stretch of it, and the errors there, (samples, n_y)."""
    (at, lane), (steps, substeps) = begun, count
    n_p, n_x, n_y = len(vector), len(at.x), lane.target.shape[1]
    by_parameter = jnp.concatenate([jnp.eye(n_p), jnp.zeros((n_x, n_p))])
    put = jax.lax.dynamic_update_index_in_dim

    def compared(at: _At, k: Array | int, counts: Array | float) -> tuple[_Sums, Array]:
        error, weight = at.x[:n_y] - lane.target[k], lane.weight[k] * counts
        bent, jacobian = (
            residual.bent(error) * weight,
            at.dx[:, :n_y] * residual.slope(error) * weight,
        )
        return _Sums(
            at.sums.products + jnp.sum(jacobian[:, None] * jacobian, axis=-1),
            at.sums.gradient + jnp.sum(jacobian * bent, axis=-1),
            at.sums.cost + jnp.sum(bent**2),
        ), jnp.where(lane.weight[k] > 0, error, 0.0)

    def advance(j: Array, carried: tuple[_At, Array]) -> tuple[_At, Array]:
        at, errors = carried
        k, i = j // substeps, j % substeps

        def ahead(x: Array, p: Array) -> Array:
            model = model_of(p)
            inputs = between(_acting(lane, model, k), i, substeps)
            return runge_kutta_4(model, x, inputs, lane.periods[k] / substeps)

        following, tangent = jax.linearize(ahead, at.x, vector)
        at = _At(following, jax.vmap(tangent)(at.dx, by_parameter), at.sums)
        # every substep writes to the row of the sample ahead; the last one stays, and counts
        sums, error = compared(at, k + 1, 1.0 * (i == substeps - 1))
        return at._replace(sums=sums), put(errors, error, k + 1, 0)

    sums, error = compared(at, 0, 1.0)
    errors = jnp.zeros_like(lane.target).at[0].set(error)
    return jax.lax.fori_loop(0, steps * substeps, advance, (at._replace(sums=sums), errors))


def _acting(lane: _Lane, model: LagrangianModel, k: Array) -> Array:
    """What drives a step; where delays are searched for, with its derivatives by them."""
    if lane.later is None:
        return lane.drive[k]
    delays = jnp.stack([jnp.asarray(model.values.get(delay_of(i), 0.0)) for i in model.inputs])
    return lane.drive[k] + lane.later[k] * (delays - jax.lax.stop_gradient(delays))
