"""What records say of parameters: their information, before anything is fitted to them."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.shooting.groups import known_by, picks
from tustinnet.fitting.shooting.least_squares import anchored, eliminated
from tustinnet.fitting.shooting.problem import Problem
from tustinnet.fitting.shooting.space import Space, make_space
from tustinnet.models.lagrangian import LagrangianSystem


def space_of(system: LagrangianSystem, values: Mapping[str, float], names: Sequence[str]) -> Space:
    """The coordinates in which some of a system's parameters are searched.

    Of a parameter per group there is one for each value of the group that `values` knows.
    """
    fixed = {name: x for name, x in values.items() if name not in names}
    there = {name: values[name] for name in names}
    return make_space(system, there, fixed, known_by(system, values))


def information(
    space: Space,
    system: LagrangianSystem,
    values: Mapping[str, float],
    records: Sequence[Experiment],
    substeps: int,
    deviation: float,
) -> Float[np.ndarray, "records n_p n_p"]:
    """Fisher information of records on parameters, in the coordinates of a search.

    Positions are compared over whole records; their beginnings are searched for, too, near what
    the encoders read, and eliminated.

    Args:
        space: the parameters.
        system: the system.
        values: of all parameters.
        records: the records; a model's own simulations will do.
        substeps: integration steps in a period.
        deviation: of a residual [rad or m].
    """
    how = SearchRecipe(initial="anchored", substeps=substeps)
    problem = Problem(system, tuple(records), (), how)
    segments = problem.segments(None, "anchored", {})
    # a simulation says its state at the beginning
    x0 = segments.x0.copy()
    x0[:, records[0].channels.measured] = [np.concatenate([e.q[0], e.velocities()[0]])
                                           for e in records]  # fmt: skip
    # the groups of the values, of which the records may have only some
    pick = picks(system, known_by(system, values), records)
    segments = replace(segments, x0=x0, pick=pick)
    segments = replace(segments, x0=x0)
    found = problem.products(space, space.vector(values), segments, substeps)
    matrices = eliminated(anchored(found, segments, x0, deviation**2))[0]
    return matrices / (segments.share * deviation**2)[:, None, None]
