"""Parameters per group: a value for each group of records, as `mass[1kg]` and `mass[2kg]`.

`expand_parameters` makes one parameter for each value of a group, `expand_values` does so for
values by name, and `group_indices` says which of them applies to which record.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Int

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.parameters import Parameter, require_group_value

Value = TypeVar("Value")


def expand_parameters(
    system: LagrangianSystem, experiments: Sequence[Experiment]
) -> tuple[Parameter, ...]:
    """Parameters of a system; of those per group one for each value among some records.

    Raises:
        InputError: a record without the group.
    """
    expanded: list[Parameter] = []
    for p in system.parameters:
        if p.per is None:
            expanded.append(p)
            continue
        values = [e.group(p.per) for e in experiments]
        distinct = sorted({v for v in values if v})
        if None in values:
            where = f"record '{experiments[values.index(None)].name}'"
            require_group_value(p, {}, distinct, where)  # raises
        expanded += [p.for_group(value) for value in distinct]
    return tuple(expanded)


def expand_parameters_by_values(
    system: LagrangianSystem, values: Mapping[str, Any]
) -> tuple[Parameter, ...]:
    """Parameters of a system; of those per group one for each group that `values` names."""
    return tuple(
        expanded
        for p in system.parameters
        for expanded in ([p] if p.per is None else map(p.for_group, p.by_group(values)))
    )


def group_indices(
    system: LagrangianSystem, parameters: Sequence[Parameter], experiments: Sequence[Experiment]
) -> Int[np.ndarray, "n_r n_g"]:
    """Index, for every record and parameter per group, of the value that applies, (n_r, n_g).

    Args:
        system: the system, with n_g parameters per group.
        parameters: its expanded parameters, see `expand_parameters`.
        experiments: the records.

    Raises:
        InputError: a record without a group, or of a value that no parameter is for.
    """
    names = dict.fromkeys(p.name for p in parameters)
    rows = [
        [
            options.index(require_group_value(p, dict(e.groups), options, f"record '{e.name}'"))
            for p in system.grouped
            for options in [tuple(p.by_group(names))]
        ]
        for e in experiments
    ]
    return np.array(rows, dtype=int).reshape(len(experiments), len(system.grouped))


def expand_values(
    system: LagrangianSystem, parameters: Sequence[Parameter], values: Mapping[str, Value]
) -> dict[str, Value]:
    """Values by the names of expanded parameters: `mass` is for all groups, `mass[1kg]` for one.

    A value for one group takes precedence over that for all.

    Raises:
        InputError: a name that no parameter has.
    """
    names = [p.name for p in parameters]
    members = {
        p.name: [p.for_group(v).name for v in p.by_group(dict.fromkeys(names))]
        for p in system.grouped
    }
    for name in values:
        if name not in names and name not in members:
            expected = ", ".join([*members, *names])
            raise InputError(
                f"system '{system.name}'", f"no parameter '{name}'", f"one of {expected}"
            )
    expanded = {name: value for name, value in values.items() if name in names}
    for name, group_names in members.items():
        if name in values:
            expanded = dict.fromkeys(group_names, values[name]) | expanded
    return expanded
