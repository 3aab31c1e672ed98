"""L-BFGS within a box: for systems with so many parameters that forward derivatives are dear."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from tustinnet.fitting.shooting.least_squares import (
    Cost,
    Fitted,
    Limits,
    Told,
    anchor_weight,
    prior_deviation,
)
from tustinnet.fitting.shooting.normal import Normal, Shape
from tustinnet.fitting.shooting.segments import Segments, beginning
from tustinnet.models.integrate import discretise
from tustinnet.simulate.drive import Drive
from tustinnet.simulate.rollout import rollout


def minimise_by_gradient(
    cost: Cost,
    vector: Float[np.ndarray, " n_p"],
    limits: Limits,
    told: Told = lambda iterations, cost, damping: None,
) -> Fitted:
    """Minimises the same cost as `minimise`, by reverse-mode gradients; see there for arguments.

    An iteration costs a few simulations whatever the number of parameters, and there are many
    more of them: five times as many are allowed.

    References:
        Byrd, Lu, Nocedal, Zhu (1995), A limited memory algorithm for bound constrained
        optimization.
    """
    space, segments = cost.space, cost.segments
    vector = space.clipped(vector)
    begin = cost.products(vector, segments.x0)
    size = float(begin.cost.sum())
    if not np.isfinite(size):
        return Fitted(vector, segments.x0, begin, np.inf, 0, 1, "diverged")
    scaled, count = _Scaled(cost, begin, size or 1.0), 0

    def followed(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        nonlocal count
        count += 1
        told(count, scaled.size * float(intermediate_result.fun), 0.0)

    n_p, n_states = len(vector), int(scaled.searched.sum())
    found = scipy.optimize.minimize(
        scaled,
        np.concatenate([vector, np.zeros(n_states)]) / scaled.unit,
        jac=True,
        method="L-BFGS-B",
        bounds=[
            *zip(space.lower / scaled.unit[:n_p], space.upper / scaled.unit[:n_p], strict=True),
            *[(None, None)] * n_states,
        ],
        callback=followed,
        options={
            "maxiter": 5 * limits.iterations, "maxcor": 30, "gtol": 1e-12,
            "ftol": limits.tolerance * 1e-2,
        },
    )  # fmt: skip
    point = found.x * scaled.unit
    best, x0 = space.clipped(point[:n_p]), scaled.states(point)
    return Fitted(
        best,
        x0,
        cost.products(best, x0),
        scaled.size * float(found.fun),
        int(found.nit),
        int(found.nfev),
        {0: "converged", 1: "limit"}.get(found.status, "stalled"),
    )


class _Scaled:
    """The cost and its gradient as the library takes them.

    Every variable is in the unit in which it changes the cost as much as any other at the start,
    the cost in units of its first value: the library's tolerance is absolute for costs below 1.
    """

    def __init__(self, cost: Cost, begin: Normal, size: float) -> None:
        self.cost, self.size, self.searched = cost, size, cost.segments.searched > 0
        by_states = np.einsum("sxx->sx", begin.xx)[self.searched]
        weights = np.concatenate([begin.pp.sum(axis=0).diagonal(), by_states])
        self.unit = 1 / np.sqrt(np.maximum(weights, 1e-8 * weights.max()))
        self._n_p = len(weights) - int(self.searched.sum())

    def states(self, point: np.ndarray) -> np.ndarray:
        """The initial states at a point."""
        x0 = self.cost.segments.x0.copy()
        x0[self.searched] += point[self._n_p :]
        return x0

    def __call__(self, scaled: np.ndarray) -> tuple[float, np.ndarray]:
        cost, prior, segments = self.cost, self.cost.prior, self.cost.segments
        point = scaled * self.unit
        vector, x0 = point[: self._n_p], self.states(point)
        value, (by_vector, by_state) = _squares(
            cost.shape, cost.substeps, cost.space.fixed_arrays, (vector, x0), _material(segments)
        )
        deviation, slope = prior_deviation(prior, cost.space, vector)
        weight, off = anchor_weight(segments, prior.variance), x0 - segments.x0
        total = float(value) + prior.weight * np.sum(deviation**2) + np.sum(weight * off**2)
        gradient = np.asarray(by_vector) + 2 * prior.weight * deviation * slope
        shift = (np.asarray(by_state) + 2 * weight * off)[self.searched]
        return float(total) / self.size, np.concatenate([gradient, shift]) * self.unit / self.size


def _material(
    segments: Segments,
) -> tuple[Drive, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """What drives the segments, what they are compared with, the weights.

    Last the groups' values, and which internal states are expected.
    """
    drive, periods, target, weight = (
        segments.side_by_side(array)
        for array in (segments.drive, segments.periods, segments.target, segments.weight)
    )
    each = segments.pick, segments.expected
    return Drive(drive[:, :-1], periods[:, :-1]), target, weight, each


@partial(jax.jit, static_argnums=(0, 1))
def _squares(
    shape: Shape,
    substeps: int,
    fixed: dict[str, Array],
    point: tuple[Array, Array],
    material: tuple[Drive, Array, Array, tuple[Array, Array]],
) -> tuple[Array, tuple[Array, Array]]:
    """The sum of squared residuals, and its gradient by parameters and initial states."""
    drive, target, weight, (picks, expected) = material

    def total(point: tuple[Array, Array]) -> Array:
        vector, x0 = point

        def one(x: Array, u: Drive, pick: Array, expected: Array) -> Array:
            model = shape.model(fixed, vector, pick)
            begin = beginning(model, x, expected)
            # the drive says how long each period is
            return rollout(discretise(model, 1.0, substeps), begin, u)

        x = jax.vmap(one)(x0, drive, picks, expected)
        error = x[..., : target.shape[2]] - target
        return jnp.sum((shape.residual.bent(error) * weight) ** 2)

    return jax.value_and_grad(total)(point)
