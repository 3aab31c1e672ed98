"""Simulation errors of segments and their exact derivatives, compiled once.

This is the package's second loop over time. It carries the derivatives by all parameters along
and takes as many steps as it is told, which `simulate.rollout` does not; docs/identification.md
has what that is worth.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tustinnet.cores import cores
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import Space
from tustinnet.models.integrate import between, runge_kutta_4
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

_LANES = 8  # segments side by side in one call: one vector of the processor


@dataclass(frozen=True)
class Shape:
    """What the compiled program is made for.

    Attributes:
        system: the system.
        searched: the parameters that are searched for.
        residual: what is compared.
        lanes: segments side by side.
        longest: steps of the longest record.
    """

    system: LagrangianSystem
    searched: tuple[Parameter, ...]
    residual: Residual
    lanes: int
    longest: int


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
        error: simulated minus measured, not weighted, (n_s, samples, n_y).
    """

    pp: Float[np.ndarray, "n_s n_p n_p"]
    px: Float[np.ndarray, "n_s n_p n_x"]
    xx: Float[np.ndarray, "n_s n_x n_x"]
    gp: Float[np.ndarray, "n_s n_p"]
    gx: Float[np.ndarray, "n_s n_x"]
    cost: Float[np.ndarray, " n_s"]
    error: Float[np.ndarray, "n_s samples n_y"]


def lanes_for(records: int) -> int:
    """How many segments side by side serve so many records well, a call for each core."""
    return min(_LANES, max(2, -(-records // cores())))


class _Lane(NamedTuple):
    """A segment as the compiled program takes it; see `Segments`."""

    x0: Any
    searched: Any
    drive: Any
    periods: Any
    target: Any
    weight: Any
    pick: Any


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
    # side by side stand segments of like length: a lane idles from its end to the longest's
    order = np.argsort(-segments.steps, kind="stable")
    fixed = space.fixed_arrays
    groups = [order[i : i + shape.lanes] for i in range(0, len(order), shape.lanes)]

    def run(rows: Int[np.ndarray, " lanes"]) -> list[np.ndarray]:
        s, longest = segments, shape.longest
        full = np.repeat(x0[rows[:1]], shape.lanes, axis=0)  # idle lanes repeat a sound state
        full[: len(rows)] = x0[rows]
        laid = partial(_laid, rows=rows, lanes=shape.lanes)
        lanes = _Lane(
            full, laid(s.searched, None), laid(s.drive, longest), laid(s.periods, longest),
            laid(s.target, longest + 1), laid(s.weight, longest + 1),
            laid(s.pick, None),
        )  # fmt: skip
        steps = int(s.steps[rows].max()), substeps
        return [np.asarray(p)[: len(rows)] for p in _products(shape, fixed, vector, lanes, steps)]

    with ThreadPoolExecutor(cores()) as pool:
        found = list(pool.map(run, groups))
    back = np.argsort(order, kind="stable")
    return Normal(
        *(np.concatenate([group[i] for group in found])[back] for i in range(len(fields(Normal))))
    )


def _laid(array: np.ndarray, length: int | None, *, rows: np.ndarray, lanes: int) -> np.ndarray:
    """Rows in an array of zeros: as many as there are lanes, as long as the longest record."""
    part = array[rows]
    inner = part.shape[1:] if length is None else (length, *part.shape[2:])
    padded = np.zeros((lanes, *inner))
    padded[: len(part), : part.shape[1]] = part
    return padded


@partial(jax.jit, static_argnums=0)
def _products(
    shape: Shape, fixed: dict[str, Array], vector: Array, lanes: _Lane, steps: tuple[Any, Any]
) -> tuple[Array, ...]:
    def model_of(lane: _Lane, p: Array) -> Any:
        values = Space(shape.searched, fixed).values(p)
        return shape.system.model(shape.system.picked(values, lane.pick))

    return jax.vmap(
        lambda lane: _segment(shape.residual, partial(model_of, lane), vector, lane, steps)
    )(lanes)


def _segment(
    residual: Residual,
    model_of: Callable[[Array], Any],
    vector: Array,
    lane: _Lane,
    count: tuple[Any, Any],
) -> tuple[Array, ...]:
    n_p, n_x, (samples, n_y) = len(vector), len(lane.x0), lane.target.shape
    steps, substeps = count
    # directions: every parameter, then every entry of the initial state
    by_parameter = jnp.concatenate([jnp.eye(n_p), jnp.zeros((n_x, n_p))])
    by_state = jnp.concatenate([jnp.zeros((n_p, n_x)), jnp.diag(lane.searched)])
    put = jax.lax.dynamic_update_index_in_dim

    def advance(j: Array, carried: tuple[Array, ...]) -> tuple[Array, ...]:
        x, dx, ys, dys = carried
        k, i = j // substeps, j % substeps

        def ahead(at: Array, p: Array) -> Array:
            inputs = between(lane.drive[k], i, substeps)
            return runge_kutta_4(model_of(p), at, inputs, lane.periods[k] / substeps)

        following, tangent = jax.linearize(ahead, x, vector)
        moved = jax.vmap(tangent)(dx, by_parameter)
        # every substep writes to the row of the sample ahead; the last one stays
        return (
            following,
            moved,
            put(ys, following[:n_y], k + 1, 0),
            put(dys, moved[:, :n_y], k + 1, 0),
        )

    ys = jnp.zeros((samples, n_y)).at[0].set(lane.x0[:n_y])
    dys = jnp.zeros((samples, n_p + n_x, n_y)).at[0].set(by_state[:, :n_y])
    carried = (lane.x0, by_state, ys, dys)
    _, _, ys, dys = jax.lax.fori_loop(0, steps * substeps, advance, carried)
    error = ys - lane.target
    bent, slope = residual.bent(error) * lane.weight, residual.slope(error) * lane.weight
    jacobian = dys * slope[:, None, :]
    products = jnp.einsum("kdj,kej->de", jacobian, jacobian)
    gradient = jnp.einsum("kdj,kj->d", jacobian, bent)
    return (
        products[:n_p, :n_p],
        products[:n_p, n_p:],
        products[n_p:, n_p:],
        gradient[:n_p],
        gradient[n_p:],
        jnp.sum(bent**2),
        jnp.where(lane.weight > 0, error, 0.0),
    )
