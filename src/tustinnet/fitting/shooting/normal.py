"""Simulation errors of segments and their derivatives: what least squares needs of them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.engine.runs import Directions, Runs, Samples, compare
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.segments import Segments
from tustinnet.fitting.shooting.space import Searched, Space
from tustinnet.models.lagrangian import LagrangianSystem


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


def normal_products(
    system: LagrangianSystem,
    residual: Residual,
    space: Space,
    vector: Searched,
    x0: Float[np.ndarray, "n_s n_x"],
    segments: Segments,
    substeps: int,
) -> Normal:
    """Products of residuals and derivatives of segments, from the given initial states.

    Args:
        system: the system.
        residual: what is compared.
        space: the parameters' coordinates.
        vector: the parameters.
        x0: initial states, as `Segments` has them, (n_s, n_x).
        segments: the segments.
        substeps: integration steps in a period.
    """
    segments = segments.driven(space.numbers(vector))
    equations = system_equations(system, space.names, delays=segments.later is not None)
    values = equations.values(space.values(vector), segments.pick)
    start, by_parameter, by_state = equations.beginnings(x0, values, segments.expected)
    runs = Runs(
        start=start,
        parameters=values,
        steps=segments.steps,
        first=segments.first,
        drive=_polynomials(segments),
        periods=segments.periods,
    )
    seeds = np.concatenate([by_parameter, segments.searched[:, :, None] * by_state], axis=1)
    result = compare(
        equations.motion, residual.formula, runs, substeps,
        Directions(seeds, parameters=True), Samples(segments.target, segments.weight),
    )  # fmt: skip
    # from the parameters of each segment to the coordinates of the search
    chain = equations.chain(space, vector, segments.pick)
    base, n_p = equations.base(space), equations.n_p
    by_base = result.products[:, base]
    with np.errstate(over="ignore", invalid="ignore"):  # of what diverged
        return Normal(
            pp=by_base[:, :, base] * chain[:, :, None] * chain[:, None, :],
            px=by_base[:, :, n_p:] * chain[:, :, None],
            xx=result.products[:, n_p:, n_p:],
            gp=result.gradient[:, base] * chain,
            gx=result.gradient[:, n_p:],
            cost=result.cost,
            error=tuple(np.split(result.error, np.cumsum(segments.steps + 1)[:-1])),
        )


def _polynomials(segments: Segments) -> Float[np.ndarray, "rows order n_u"]:
    """Inputs over every period as polynomials, held ones with one coefficient.

    Behind them stands how delays change them, where these are searched for.
    """
    parts = [segments.drive, *([] if segments.later is None else [segments.later])]
    return np.concatenate([x[:, None] if x.ndim == 2 else x for x in parts], axis=-1)
