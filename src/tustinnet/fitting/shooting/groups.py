"""Parameters that have a value for each group of records, and which record needs which."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Int

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.parameters import Parameter, require_group_value

Value = TypeVar("Value")


def expanded(system: LagrangianSystem, experiments: Sequence[Experiment]) -> tuple[Parameter, ...]:
    """The parameters of a system; of those per group one for each value among some records.

    Raises:
        InputError: a record without the group.
    """
    found: list[Parameter] = []
    for p in system.parameters:
        if p.per is None:
            found.append(p)
            continue
        values = [e.group(p.per) for e in experiments]
        if None in values:
            require_group_value(
                p, {}, sorted({v for v in values if v}), _where(experiments, values)
            )
        found += [p.for_group(value) for value in sorted({v for v in values if v})]
    return tuple(found)


def known_by(system: LagrangianSystem, values: Mapping[str, Any]) -> tuple[Parameter, ...]:
    """The parameters of a system; of those per group one for each value of it that some have."""
    return tuple(
        one
        for p in system.parameters
        for one in ([p] if p.per is None else map(p.for_group, p.by_group(values)))
    )


def _where(experiments: Sequence[Experiment], values: Sequence[str | None]) -> str:
    return f"record '{experiments[values.index(None)].name}'"


def picks(
    system: LagrangianSystem, parameters: Sequence[Parameter], experiments: Sequence[Experiment]
) -> Int[np.ndarray, "n_r n_g"]:
    """Per record, which of its values each parameter per group has there, (n_r, n_g).

    Args:
        system: the system, with n_g parameters per group.
        parameters: what `expanded` made of its parameters.
        experiments: the records.

    Raises:
        InputError: a record without a group, or of a value that no parameter is for.
    """
    known = dict.fromkeys(p.name for p in parameters)
    rows = [
        [
            options.index(require_group_value(p, dict(e.groups), options, f"record '{e.name}'"))
            for p in system.grouped
            for options in [tuple(p.by_group(known))]
        ]
        for e in experiments
    ]
    return np.array(rows, dtype=int).reshape(len(experiments), len(system.grouped))


def spread(
    system: LagrangianSystem, parameters: Sequence[Parameter], values: Mapping[str, Value]
) -> dict[str, Value]:
    """Values by the names of `expanded` parameters: `mass` says it of all, `mass[1kg]` of one.

    What is said of one counts for it, whatever is said of all.

    Raises:
        InputError: a name that no parameter has.
    """
    names = [p.name for p in parameters]
    of_all = {p.name: [p.for_group(v).name for v in p.by_group(dict.fromkeys(names))]
              for p in system.grouped}  # fmt: skip
    for name in values:
        if name not in names and name not in of_all:
            known = ", ".join([*of_all, *names])
            raise InputError(f"system '{system.name}'", f"no parameter '{name}'", f"one of {known}")
    found = {name: value for name, value in values.items() if name in names}
    for name, several in of_all.items():
        if name in values:
            found = dict.fromkeys(several, values[name]) | found
    return found
