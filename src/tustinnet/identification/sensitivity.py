"""Simulation errors of segments and their exact derivatives, compiled once."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from tustinnet.identification.segments import Segments
from tustinnet.identification.space import Space
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Parameter
from tustinnet.simulation.integrators import substep

_LANES = 8  # segments side by side in one call
_POOL = ThreadPoolExecutor(2)  # calls side by side: compiled programs let go of the interpreter


@dataclass(frozen=True)
class Shape:
    """What the compiled program is made for.

    Attributes:
        system: the system.
        free: the parameters that are searched for.
        periodic: residual channels compared by the periodic distance of angles.
        lanes: segments side by side.
        longest: steps of the longest record.
    """

    system: LagrangianSystem
    free: tuple[Parameter, ...]
    periodic: tuple[bool, ...]
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
    """How many segments side by side serve so many records well."""
    return min(_LANES, max(2, -(-records // 2)))


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
    side by side.

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
    held = space.held_arrays
    groups = [order[i : i + shape.lanes] for i in range(0, len(order), shape.lanes)]

    def run(rows: Int[np.ndarray, " lanes"]) -> list[np.ndarray]:
        s, lanes = segments, shape.lanes
        full = np.repeat(x0[rows[:1]], lanes, axis=0)  # idle lanes repeat a state that is sound
        full[: len(rows)] = x0[rows]
        laid = [_laid(a[rows], lanes, n) for a, n in (
            (s.free, None), (s.drive, shape.longest), (s.periods, shape.longest),
            (s.target, shape.longest + 1), (s.weight, shape.longest + 1),
        )]  # fmt: skip
        steps = int(s.steps[rows].max())
        products = _products(shape, held, vector, full, *laid, steps, substeps)
        return [np.asarray(part)[: len(rows)] for part in products]

    found = list(_POOL.map(run, groups))
    back = np.argsort(order, kind="stable")
    return Normal(
        *(np.concatenate([group[i] for group in found])[back] for i in range(len(fields(Normal))))
    )


def _laid(rows: np.ndarray, lanes: int, length: int | None) -> np.ndarray:
    """Rows in an array of zeros: as many as there are lanes, as long as the longest record."""
    inner = rows.shape[1:] if length is None else (length, *rows.shape[2:])
    padded = np.zeros((lanes, *inner))
    padded[: len(rows), : rows.shape[1]] = rows
    return padded


@partial(jax.jit, static_argnums=0)
def _products(shape, held, vector, x0, searched, drive, periods, target, weight, steps, substeps):  # noqa: ANN001, ANN202
    def segment(x, *rest):  # noqa: ANN001, ANN002, ANN202
        return _segment(shape, Space(shape.free, held), vector, steps, substeps, x, *rest)

    return jax.vmap(segment)(x0, searched, drive, periods, target, weight)


def _segment(shape, space, vector, steps, substeps, x0, searched, drive, periods, target, weight):  # noqa: ANN001, ANN202
    n_p, n_x, n_y = len(vector), len(x0), target.shape[1]
    # directions: every parameter, then every entry of the initial state
    by_parameter = jnp.concatenate([jnp.eye(n_p), jnp.zeros((n_x, n_p))])
    by_state = jnp.concatenate([jnp.zeros((n_p, n_x)), jnp.diag(searched)])
    put = jax.lax.dynamic_update_index_in_dim

    def advance(j, carried):  # noqa: ANN001, ANN202
        x, dx, ys, dys = carried
        k, i = j // substeps, j % substeps

        def ahead(at, p):  # noqa: ANN001, ANN202
            model = LagrangianModel(shape.system, space.values(p))
            return substep(model, at, drive[k], i, substeps, periods[k] / substeps)

        following, tangent = jax.linearize(ahead, x, vector)
        moved = jax.vmap(tangent)(dx, by_parameter)
        # every substep writes to the row of the sample ahead; the last one stays
        return (
            following,
            moved,
            put(ys, following[:n_y], k + 1, 0),
            put(dys, moved[:, :n_y], k + 1, 0),
        )

    samples = target.shape[0]
    ys = jnp.zeros((samples, n_y)).at[0].set(x0[:n_y])
    dys = jnp.zeros((samples, n_p + n_x, n_y)).at[0].set(by_state[:, :n_y])
    _, _, ys, dys = jax.lax.fori_loop(0, steps * substeps, advance, (x0, by_state, ys, dys))
    error, periodic = ys - target, jnp.array(shape.periodic)
    # periodic distance 2 (1 - cos e) = (2 sin(e / 2))^2
    residual = jnp.where(periodic, 2 * jnp.sin(error / 2), error) * weight
    slope = jnp.where(periodic, jnp.cos(error / 2), 1.0) * weight
    jacobian = dys * slope[:, None, :]
    products = jnp.einsum("kdj,kej->de", jacobian, jacobian)
    gradient = jnp.einsum("kdj,kj->d", jacobian, residual)
    return (
        products[:n_p, :n_p],
        products[:n_p, n_p:],
        products[n_p:, n_p:],
        gradient[:n_p],
        gradient[n_p:],
        jnp.sum(residual**2),
        jnp.where(weight > 0, error, 0.0),
    )
