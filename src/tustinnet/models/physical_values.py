"""The physical parameters inside a model, whatever is around its equations of motion."""

from collections.abc import Mapping
from typing import Any

import jax

from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.lagrangian import LagrangianModel


def _is_equations(node: Any) -> bool:
    """Whether a part of a model are equations of motion."""
    return isinstance(node, LagrangianModel)


def equations_in(model: Model | ContinuousModel) -> LagrangianModel | None:
    """The equations of motion in a model, None of none or of several, as in committees."""
    found = [x for x in jax.tree.leaves(model, is_leaf=_is_equations) if _is_equations(x)]
    return found[0] if len(found) == 1 else None


def physical_parameters(model: Model | ContinuousModel) -> list[tuple[str, str, float]]:
    """Name, unit and value of the physical parameters in a model; none of a network."""
    equations = equations_in(model)
    if equations is None:
        return []
    values = equations.values
    own = (p for p in equations.system.parameters if p.name in values)
    return [(p.name, p.unit, float(values[p.name])) for p in own]


def with_equations(model: Model, equations: LagrangianModel) -> Model:
    """A model with others in the place of its equations of motion."""
    leaves, structure = jax.tree.flatten(model, is_leaf=_is_equations)
    place = next(i for i, leaf in enumerate(leaves) if _is_equations(leaf))
    return jax.tree.unflatten(structure, [*leaves[:place], equations, *leaves[place + 1 :]])


def with_values(model: Model, values: Mapping[str, Any]) -> Model:
    """A model with some other values of the parameters of its equations of motion."""
    equations = equations_in(model)
    if equations is None or not values:
        return model
    return with_equations(model, LagrangianModel(equations.system, equations.values | dict(values)))
