"""Fisher information of records on parameters, before anything is fitted to them.

`fisher_information` takes a search space, values of the parameters and records, which may be
simulated, and returns a matrix for every record.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.shooting.groups import expand_parameters_by_values, group_indices
from tustinnet.fitting.shooting.normal import add_anchors, eliminate_initial_states
from tustinnet.fitting.shooting.problem import Problem
from tustinnet.fitting.shooting.space import SearchSpace, make_search_space
from tustinnet.models.lagrangian import LagrangianSystem


def search_space_for(
    system: LagrangianSystem, values: Mapping[str, float], names: Sequence[str]
) -> SearchSpace:
    """The search space in which some of a system's parameters are free.

    Args:
        system: the system.
        values: all parameters; of those per group one for each value of the group.
        names: the parameters that are free.
    """
    fixed = {name: x for name, x in values.items() if name not in names}
    initial = {name: values[name] for name in names}
    return make_search_space(system, initial, fixed, expand_parameters_by_values(system, values))


def fisher_information(
    space: SearchSpace,
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
        space: the search space.
        system: the system.
        values: the values of all parameters.
        records: the records; a model's own simulations will do.
        substeps: integration steps in a sampling period.
        deviation: standard deviation of a residual [rad or m].
    """
    options = SearchRecipe(initial="anchored", substeps=substeps)
    problem = Problem(system, tuple(records), (), options)
    segments = problem.segments(None, "anchored", {}).without_velocities(system.channels)
    # in a simulation the state at the beginning is exact
    x0 = segments.x0.copy()
    x0[:, records[0].channels.measured] = [
        np.concatenate([e.q[0], e.velocities()[0]]) for e in records
    ]
    # the groups of the values, of which the records may have only some
    indices = group_indices(system, expand_parameters_by_values(system, values), records)
    segments = replace(segments, x0=x0, group_indices=indices)
    products = problem.products(space, space.to_vector(values), segments, substeps)
    products = add_anchors(products, segments, x0, deviation**2)
    matrices = eliminate_initial_states(products).matrices
    return matrices / (segments.share * deviation**2)[:, None, None]
