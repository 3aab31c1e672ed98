"""Initial states that follow from the parameters, by the start with which free runs are judged.

A search may find the initial state of a record along the whole of it; a free run has only its first
samples for that. Where the model lacks physics, both differ, and parameters that suit the one need
not suit the other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.shooting.least_squares import Cost, Fitted
from tustinnet.fitting.shooting.normal import Normal
from tustinnet.fitting.shooting.problem import Problem, State
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

    def ended(self, fitted: Fitted) -> Fitted:
        """Where a search ended, with the initial states that follow from its parameters."""
        return replace(fitted, x0=self.begun(fitted.vector)[0])


def following(problem: Problem, state: State, cost: Cost, start: Start) -> Following:
    """A cost whose segments begin where a start says.

    Args:
        problem: the records.
        state: where the search is.
        cost: the cost with initial states of its own.
        start: a start that needs a model.

    Raises:
        InputError: a segment with fewer samples than the start needs.
    """
    whole = cost.segments
    free = replace(whole, searched=np.ones_like(whole.x0), precision=np.zeros_like(whole.precision))
    return Following(
        cost.shape, cost.space, free, cost.prior, cost.substeps,
        begun=_begun(problem, state, whole, start),
    )  # fmt: skip


def _begun(problem: Problem, state: State, segments: Segments, start: Start) -> Begun:
    heads = _heads(problem.records, segments, start.samples)
    inputs = problem.records[0].inputs
    # segments whose records share the values of all groups share a model
    _, kind = np.unique(segments.pick, axis=0, return_inverse=True)
    alike = [np.flatnonzero(kind.ravel() == k) for k in range(int(kind.max()) + 1)]
    materials = [start.material(problem.nominal, [heads[i] for i in rows]) for rows in alike]

    def states(vector: Array, pick: Array, material: Any) -> Array:
        values = problem.system.picked(state.space.values(vector), pick)
        model = discretise(problem.system.model(values), problem.motion.dt, state.substeps,
                           inputs=inputs)  # fmt: skip
        return start.states(model, material)

    found = jax.jit(lambda *at: (states(*at), jax.jacfwd(states)(*at)))

    def begun(vector: Float[np.ndarray, " n_p"]) -> tuple[np.ndarray, np.ndarray]:
        x0 = np.zeros_like(segments.x0)
        by = np.zeros((*x0.shape, len(vector)))
        for rows, material in zip(alike, materials, strict=True):
            pick = jnp.asarray(segments.pick[rows[0]])
            x0[rows], by[rows] = map(np.asarray, found(jnp.asarray(vector), pick, material))
        return x0, by

    return begun


def _heads(records: Sequence[Experiment], segments: Segments, samples: int) -> list[Experiment]:
    """The first samples of every segment."""
    begins = np.cumsum([0, *(len(e) for e in records)])
    found = []
    for record, first, steps in zip(segments.record, segments.first, segments.steps, strict=True):
        at = int(first - begins[record])
        found.append(records[record][at : at + min(samples, int(steps) + 1)])
    return found
