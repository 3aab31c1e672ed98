"""Simulation errors of segments and the products of their derivatives (normal equations).

`compute_products` simulates all segments with derivatives by the free parameters and the initial
states and returns what least squares needs of them, segment by segment: `NormalProducts`.
`add_anchors` adds what is known of the initial states, `eliminate_initial_states` leaves normal
equations of the parameters alone.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tustinnet.engine.engines import compare
from tustinnet.engine.runs import Directions, Runs, Samples
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import ParameterVector, SearchSpace
from tustinnet.models.lagrangian import LagrangianSystem


@dataclass(frozen=True)
class NormalProducts:
    """Products of the residuals and derivatives of every segment.

    With residuals `r`, derivatives `J` by the parameters and `X` by the initial state:

    Attributes:
        pp: `J'J`, (n_s, n_p, n_p).
        px: `J'X`, (n_s, n_p, n_x).
        xx: `X'X`, (n_s, n_x, n_x).
        gp: `J'r`, (n_s, n_p).
        gx: `X'r`, (n_s, n_x).
        cost: `r'r`, (n_s,); with the cost of the anchors where `add_anchors` has added it, which
            is in `xx` and `gx`, too.
        error: simulated minus measured positions of each, (its samples, n_q) [rad or m].
    """

    pp: Float[np.ndarray, "n_s n_p n_p"]
    px: Float[np.ndarray, "n_s n_p n_x"]
    xx: Float[np.ndarray, "n_s n_x n_x"]
    gp: Float[np.ndarray, "n_s n_p"]
    gx: Float[np.ndarray, "n_s n_x"]
    cost: Float[np.ndarray, " n_s"]
    error: tuple[Float[np.ndarray, "_ n_q"], ...]

    @property
    def is_finite(self) -> bool:
        """Whether all products are finite: the simulations did not diverge."""
        products = (self.pp, self.px, self.xx, self.gp, self.gx, self.cost)
        return all(np.isfinite(product).all() for product in products)


def compute_products(
    system: LagrangianSystem,
    residual: Residual,
    space: SearchSpace,
    vector: ParameterVector,
    x0: Float[np.ndarray, "n_s n_x"],
    segments: Segments,
    substeps: int,
    fit_states: "Callable[..., tuple[np.ndarray, np.ndarray]] | None" = None,
) -> NormalProducts:
    """Simulates segments and returns the products of their residuals and derivatives.

    Args:
        system: the system.
        residual: what is compared.
        space: the search space.
        vector: the parameters.
        x0: initial states, as `Segments` has them, (n_s, n_x).
        segments: the segments.
        substeps: integration steps in a sampling period.
        fit_states: function from the equations of motion, the parameters of the segments, their
            initial states and the derivatives of these by the free parameters to better states and
            their derivatives; None for the states as they are.
    """
    segments = segments.with_delays(space.to_values_in_range(vector))
    has_delays = segments.inputs_by_delay is not None
    equations = system_equations(system, space.names, has_delays=has_delays)
    parameter_rows = equations.parameter_rows(space.to_values(vector), segments.group_indices)
    # polynomials over every period, held inputs with one coefficient; derivatives by delays follow
    inputs = [segments.inputs, *([segments.inputs_by_delay] if has_delays else [])]
    parts = [x[:, None] if x.ndim == 2 else x for x in inputs]
    polynomials = np.concatenate(parts, axis=-1) if has_delays else parts[0]
    initial = equations.initial_states(
        x0, parameter_rows, segments.adds_expected, polynomials[segments.first_row]
    )
    states, by_parameter = initial.states, initial.by_parameter
    if fit_states is not None:
        states, by_parameter = fit_states(equations.motion, parameter_rows, states, by_parameter)
    runs = Runs(
        start=states,
        parameters=parameter_rows,
        steps=segments.steps,
        first=segments.first_row,
        periods=segments.periods,
        drive=polynomials,
    )
    by_state = segments.is_free[:, :, None] * initial.by_state
    directions = np.concatenate([by_parameter, by_state], axis=1)
    result = compare(
        equations.motion,
        residual.formula,
        runs,
        substeps,
        Directions(directions, parameters=True),
        Samples(segments.measurements, segments.weights),
    )
    # the engine differentiates by the equations' parameters, the search by its coordinates
    chain = equations.coordinate_derivatives(space, vector, segments.group_indices)
    free, n_p = equations.free_columns(space), equations.n_p
    by_free = result.products[:, free]
    return NormalProducts(
        pp=by_free[:, :, free] * chain[:, :, None] * chain[:, None, :],
        px=by_free[:, :, n_p:] * chain[:, :, None],
        xx=result.products[:, n_p:, n_p:],
        gp=result.gradient[:, free] * chain,
        gx=result.gradient[:, n_p:],
        cost=result.cost,
        error=tuple(
            np.split(result.error[:, system.channels.position], np.cumsum(segments.steps + 1)[:-1])
        ),
    )


class ReducedProducts(NamedTuple):
    """Normal equations of the parameters alone, segment by segment, initial states eliminated.

    Attributes:
        matrices: Schur complements, (n_s, n_p, n_p).
        gradients: reduced gradients, (n_s, n_p).
        state_step: step of the initial states where the parameters stay, (n_s, n_x).
        state_step_by_parameters: what the parameters' step adds to it, (n_s, n_x, n_p).
    """

    matrices: Float[np.ndarray, "n_s n_p n_p"]
    gradients: Float[np.ndarray, "n_s n_p"]
    state_step: Float[np.ndarray, "n_s n_x"]
    state_step_by_parameters: Float[np.ndarray, "n_s n_x n_p"]


def eliminate_initial_states(products: NormalProducts, damping: float = 0.0) -> ReducedProducts:
    """Eliminates every segment's initial state from the normal equations (Schur complement)."""
    diagonal = np.einsum("sii->si", products.xx)
    added = np.where(diagonal > 0, damping * diagonal, 1.0)  # 1: states that are not searched for
    inner = products.xx + np.einsum("si,ij->sij", added, np.eye(diagonal.shape[1]))
    # a state that no residual depends on any more must not make the block singular
    inner += 1e-13 * np.einsum("si,ij->sij", diagonal, np.eye(diagonal.shape[1]))
    state_step = -np.linalg.solve(inner, products.gx[:, :, None])[:, :, 0]
    by_parameters = -np.linalg.solve(inner, np.swapaxes(products.px, 1, 2))
    return ReducedProducts(
        matrices=products.pp + products.px @ by_parameters,
        gradients=products.gp + np.einsum("spx,sx->sp", products.px, state_step),
        state_step=state_step,
        state_step_by_parameters=by_parameters,
    )


def add_anchors(
    products: NormalProducts, segments: Segments, x0: Float[np.ndarray, "n_s n_x"], variance: float
) -> NormalProducts:
    """Adds to products the cost of initial states that depart from their measurements."""
    weight = variance * segments.share[:, None] * segments.precision**2
    departure = x0 - segments.x0
    return replace(
        products,
        xx=products.xx + np.einsum("sx,xy->sxy", weight, np.eye(x0.shape[1])),
        gx=products.gx + weight * departure,
        cost=products.cost + np.sum(weight * departure**2, axis=1),
    )
