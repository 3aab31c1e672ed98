"""Initial states that follow from the parameters, by the start with which free runs are judged.

A search may find the initial state of a record along the whole of it; a free run has only its first
samples for that. Where the model lacks physics, both differ, and parameters that suit the one need
not suit the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Input
from tustinnet.data.experiment import Experiment
from tustinnet.fitting.shooting.least_squares import Cost, Fitted
from tustinnet.fitting.shooting.normal import Normal, Shape
from tustinnet.fitting.shooting.problem import Problem
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.models.integrate import discretise
from tustinnet.simulate.starts import Start

Begun = Callable[[Float[np.ndarray, " n_p"]], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Following(Cost):
    """The cost where initial states follow from the parameters.

    Attributes:
        begun: initial states by the parameters, (n_s, n_x), and their derivatives,
            (n_s, n_x, n_p).
    """

    begun: Begun

    def products(self, vector: Float[np.ndarray, " n_p"], x0: np.ndarray) -> Normal:
        """The products by the parameters alone; nothing is left to search for in the states.

        With the derivative `B` of the initial states, residuals change by `J + X B`.
        """
        states, by = self.begun(vector)
        n = super().products(vector, states)
        across, turned = n.px @ by, np.swapaxes(by, 1, 2)
        return replace(
            n,
            pp=n.pp + across + np.swapaxes(across, 1, 2) + turned @ n.xx @ by,
            gp=n.gp + np.einsum("sxp,sx->sp", by, n.gx),
            px=np.zeros_like(n.px), xx=np.zeros_like(n.xx), gx=np.zeros_like(n.gx),
        )  # fmt: skip

    def ended(self, fitted: Fitted) -> tuple[Fitted, Segments]:
        """The same with the states that follow from the parameters; from here on they are given."""
        x0 = self.begun(fitted.vector)[0]
        return replace(fitted, x0=x0), self.segments.beginning_at(x0)


def following(problem: Problem, cost: Cost, start: Start) -> Following:
    """A cost whose segments begin where a start says.

    Args:
        problem: the records.
        cost: the cost with initial states of its own.
        start: a start that needs a model.

    Raises:
        InputError: a segment with fewer samples than the start needs.
    """
    whole, shape, fixed = cost.segments, cost.shape, cost.space.fixed_arrays
    material = start.material(problem.nominal, _heads(problem.records, whole, start.samples))
    how = _How(start, problem.motion.dt, problem.records[0].inputs, cost.substeps)

    def begun(vector: Float[np.ndarray, " n_p"]) -> tuple[np.ndarray, np.ndarray]:
        found, by = _started(shape, how, fixed, vector, (whole.pick, material))
        return np.asarray(found), np.asarray(by)

    free = replace(whole.beginning_at(whole.x0), searched=np.ones_like(whole.x0))
    return Following(shape, cost.space, free, cost.prior, cost.substeps, begun=begun)


class _How(NamedTuple):
    """What the compiled program of the initial states is made for, beside a `Shape`."""

    start: Start
    dt: float
    inputs: tuple[Input, ...]
    substeps: int


@partial(jax.jit, static_argnums=(0, 1))
def _started(
    shape: Shape, how: _How, fixed: dict[str, Array], vector: Array, segments: tuple[Array, Any]
) -> tuple[Array, Array]:
    """Where segments begin, and the derivatives by the parameters."""

    def one(vector: Array, pick: Array, material: Any) -> Array:
        physics = shape.model(fixed, vector, pick)
        model = discretise(physics, how.dt, how.substeps, inputs=how.inputs)
        return how.start.states(model, jax.tree.map(lambda a: jnp.asarray(a)[None], material))[0]

    def every(vector: Array) -> Array:
        return jax.vmap(partial(one, vector))(*segments)

    return every(vector), jax.jacfwd(every)(vector)


def _heads(records: Sequence[Experiment], segments: Segments, samples: int) -> list[Experiment]:
    """The first samples of every segment."""
    first = segments.first - segments.first[segments.begins][segments.record]
    counts = np.minimum(samples, segments.steps + 1)
    return [
        records[record][at : at + count]
        for record, at, count in zip(segments.record, first, counts, strict=True)
    ]
