"""Identification from the initial states by which models are judged.

The package searches for the initial state of every record, over the whole record; a free run begins
where a start, as `model-20`, finds it from the first samples. Here the search is for parameters
alone: initial states follow from them by that start, and the derivatives go through it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.fitting.shooting.least_squares import Cost, Limits, minimise
from tustinnet.fitting.shooting.normal import Normal
from tustinnet.fitting.shooting.problem import Problem, State, model_of, prior
from tustinnet.fitting.shooting.space import Space
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.simulate.starts import start_named

LIMITS = Limits(1e-3, 12)
SUBSTEPS = 2

Started = tuple[np.ndarray, np.ndarray]  # (n_s, n_x), (n_s, n_x, n_p)


@dataclass(frozen=True)
class Following(Cost):
    """The cost where initial states follow from the parameters.

    Attributes:
        begun: initial states by the parameters, and their derivatives.
    """

    begun: Callable[[np.ndarray], Started] | None = None

    def products(self, vector: np.ndarray, x0: np.ndarray) -> Normal:
        """The products by the parameters alone; nothing is left to search for in the states."""
        assert self.begun is not None
        states, by = self.begun(vector)
        n = super().products(vector, states)
        across = n.px @ by
        turned = np.swapaxes(by, 1, 2)
        return replace(
            n,
            pp=n.pp + across + np.swapaxes(across, 1, 2) + turned @ n.xx @ by,
            gp=n.gp + np.einsum("sxp,sx->sp", by, n.gx),
            px=np.zeros_like(n.px), xx=np.zeros_like(n.xx), gx=np.zeros_like(n.gx),
        )  # fmt: skip


def identified(
    model: Discretised, records: Sequence[tn.Experiment], start: str, loss: str
) -> Discretised:
    """The model with parameters that fit best from the initial states of a start.

    Args:
        model: a Lagrangian system as it was identified, where the search begins.
        records: the records to identify from.
        start: where every record's free run begins, as `model-20`.
        loss: `position` or `state`.
    """
    physics = model.continuous
    assert isinstance(physics, LagrangianModel)
    recipe: Any = tn.read_recipe("best-grey", [f"search.loss={loss}"])
    problem = Problem(physics.system, tuple(records), (), recipe.search)
    values = {name: float(x) for name, x in physics.values.items()}
    searched = tuple(p for p in physics.system.parameters if not p.fixed)
    names = {p.name for p in searched}
    space = Space(searched, {name: x for name, x in values.items() if name not in names})
    state = State(space, space.clipped(space.vector(values)), substeps=SUBSTEPS)
    rule = start_named(start)
    material = rule.material(problem.nominal, records)

    def begin(vector: jax.Array) -> jax.Array:
        system = physics.system.model(space.values(vector))
        return rule.states(tn.discretise(system, model.dt, 1, inputs=records[0].inputs), material)

    both = jax.jit(lambda vector: (begin(vector), jax.jacfwd(begin)(vector)))

    def begun(vector: np.ndarray) -> Started:
        states, by = both(jnp.asarray(vector))
        return np.asarray(states), np.asarray(by)

    whole = problem.segments(None, "derived-6", {})
    whole = replace(whole, searched=np.ones_like(whole.x0), precision=np.zeros_like(whole.x0))
    cost = Following(
        problem.shape(space), space, whole, prior(problem, state), SUBSTEPS, begun=begun
    )
    fitted = minimise(cost, state.vector, LIMITS)
    return model_of(problem, replace(state, vector=fitted.vector, fitted=fitted))
