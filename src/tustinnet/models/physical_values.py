"""The physical parameters inside a model, whatever is around its equations of motion."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.lagrangian import LagrangianModel


def _is_equations(node: Any) -> bool:
    """Whether a part of a model are equations of motion; those of committees are many in one."""
    return isinstance(node, LagrangianModel) and all(
        np.ndim(value) == 0 for value in node.values.values()
    )


def equations_in(model: Model | ContinuousModel) -> LagrangianModel | None:
    """The first equations of motion in a model, None where there are none."""
    nodes = jax.tree.leaves(model, is_leaf=_is_equations)
    return next((node for node in nodes if _is_equations(node)), None)


def physical_parameters(model: Model | ContinuousModel) -> list[tuple[str, str, float]]:
    """Name, unit and value of the physical parameters in a model; none of a network."""
    equations = equations_in(model)
    if equations is None:
        return []
    values = equations.values
    own = (p for p in equations.system.parameters if p.name in values)
    return [(p.name, p.unit, float(values[p.name])) for p in own]


def with_equations(model: Model, equations: LagrangianModel) -> Model:
    """A model with others in the place of its first equations of motion."""
    leaves, structure = jax.tree.flatten(model, is_leaf=_is_equations)
    place = next(i for i, leaf in enumerate(leaves) if _is_equations(leaf))
    return jax.tree.unflatten(structure, [*leaves[:place], equations, *leaves[place + 1 :]])


def with_values(model: Model, values: Mapping[str, Any]) -> Model:
    """A model with some other values of the parameters of its equations of motion."""
    equations = equations_in(model)
    if equations is None or not values:
        return model
    return with_equations(model, LagrangianModel(equations.system, equations.values | dict(values)))
