"""L-BFGS within a box: for systems with so many parameters that forward derivatives are dear."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from tustinnet.identification.least_squares import (
    Fitted,
    Iteration,
    Prior,
    anchor_weight,
    anchored,
    prior_deviation,
)
from tustinnet.identification.segments import Segments
from tustinnet.identification.sensitivity import Shape, normal_products
from tustinnet.identification.space import Space
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.simulation.integrators import substep


def minimise_by_gradient(
    shape: Shape,
    space: Space,
    vector: np.ndarray,
    segments: Segments,
    prior: Prior,
    *,
    substeps: int,
    tolerance: float,
    most: int,
    told: Callable[[Iteration], None] = lambda _: None,
    stage: str = "",
) -> Fitted:
    """Minimises the same cost as `minimise`, by reverse-mode gradients; see there for arguments.

    An iteration costs a few simulations whatever the number of parameters, and there are many
    more of them: five times as many are allowed.

    References:
        Byrd, Lu, Nocedal, Zhu (1995), A limited memory algorithm for bound constrained
        optimization.
    """
    searched = segments.free > 0
    vector, n_p = space.clipped(vector), len(vector)
    # every variable in the unit in which it changes the cost as much as any other at the start
    begin = normal_products(shape, space, vector, segments.x0, segments, substeps)
    begin = anchored(begin, segments, segments.x0, prior.variance)
    size = float(begin.cost.sum())
    if not np.isfinite(size):
        return Fitted(vector, segments.x0, begin, np.inf, 0, 1, "diverged")
    size = size or 1.0  # the library's tolerance is absolute for costs below 1
    weights = np.concatenate(
        [begin.pp.sum(axis=0).diagonal(), np.einsum("sxx->sx", begin.xx)[searched]]
    )
    unit = 1 / np.sqrt(np.maximum(weights, 1e-8 * weights.max()))
    held = space.held_arrays
    arrays = (segments.drive, segments.periods, segments.target, segments.weight)

    def states(point: np.ndarray) -> np.ndarray:
        x0 = segments.x0.copy()
        x0[searched] += point[n_p:]
        return x0

    def cost(scaled: np.ndarray) -> tuple[float, np.ndarray]:
        point = scaled * unit
        x0 = states(point)
        value, (by_vector, by_state) = _cost(shape, substeps, held, point[:n_p], x0, *arrays)
        deviation, slope = prior_deviation(prior, space, point[:n_p])
        weight = anchor_weight(segments, prior.variance)
        off = x0 - segments.x0
        total = float(value) + prior.weight * np.sum(deviation**2) + np.sum(weight * off**2)
        gradient = np.asarray(by_vector) + 2 * prior.weight * deviation * slope
        shift = (np.asarray(by_state) + 2 * weight * off)[searched]
        return float(total) / size, np.concatenate([gradient, shift]) * unit / size

    count = 0

    def followed(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        nonlocal count
        count += 1
        told(Iteration(stage, count, size * float(intermediate_result.fun), 0.0))

    n_states = int(searched.sum())
    found = scipy.optimize.minimize(
        cost,
        np.concatenate([vector, np.zeros(n_states)]) / unit,
        jac=True,
        method="L-BFGS-B",
        bounds=[
            *zip(space.lower / unit[:n_p], space.upper / unit[:n_p], strict=True),
            *[(None, None)] * n_states,
        ],
        callback=followed,
        options={"maxiter": 5 * most, "maxcor": 30, "ftol": tolerance * 1e-2, "gtol": 1e-12},
    )
    best, x0 = space.clipped(found.x[:n_p] * unit[:n_p]), states(found.x * unit)
    normal = normal_products(shape, space, best, x0, segments, substeps)
    return Fitted(
        best,
        x0,
        anchored(normal, segments, x0, prior.variance),
        size * float(found.fun),
        int(found.nit),
        int(found.nfev),
        {0: "converged", 1: "limit"}.get(found.status, "stalled"),
    )


@partial(jax.jit, static_argnums=(0, 1))
def _cost(shape, substeps, held, vector, x0, drive, periods, target, weight):  # noqa: ANN001, ANN202
    def run(model, start, drive, periods):  # noqa: ANN001, ANN202
        def advance(x, now):  # noqa: ANN001, ANN202
            u, period = now
            for i in range(substeps):
                x = substep(model, x, u, i, substeps, period / substeps)
            return x, x

        return jnp.concatenate([start[None], jax.lax.scan(advance, start, (drive, periods))[1]])

    def total(vector, x0):  # noqa: ANN001, ANN202
        model = LagrangianModel(shape.system, Space(shape.free, held).values(vector))
        x = jax.vmap(lambda *each: run(model, *each))(x0, drive, periods)
        error = x[..., : target.shape[2]] - target
        residual = jnp.where(jnp.array(shape.periodic), 2 * jnp.sin(error / 2), error) * weight
        return jnp.sum(residual**2)

    return jax.value_and_grad(total, argnums=(0, 1))(vector, x0)
