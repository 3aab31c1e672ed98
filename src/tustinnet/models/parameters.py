"""Physical parameters, and those that differ between groups of records."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tustinnet.errors import InputError, require_name, require_number


@dataclass(frozen=True)
class Parameter:
    """A physical parameter of a system.

    Attributes:
        name: what it is called.
        unit: its SI unit.
        nominal: its nominal value.
        lower: smallest value that makes sense (the paper's set Xi).
        upper: largest.
        fixed: whether identification leaves it alone.
        prior: standard deviation of prior knowledge about the nominal value, or None.
        per: the group of the records, as `payload`, for each value of which it has a value of its
            own; None where all records share one.
        optional: whether the term that it scales is left out unless the records need it. The
            functions of the system are then called without it, too: `p.get(name, 0.0)`.
        usual: values that an optional parameter has in most machines, as the ratio of two inertias
            of one body: it is fixed there unless the records need another one.
        brings: forces of `models.added` that come with its term, as `cubic:theta`, if the records
            need it: a spring that is there may stiffen, rub and relax.
        basis: where its range is from, in words, for messages; empty where a person chose it.
    """

    name: str
    unit: str
    nominal: float
    lower: float
    upper: float
    fixed: bool = False
    prior: float | None = None
    per: str | None = None
    optional: bool = False
    usual: tuple[float, ...] = ()
    brings: tuple[str, ...] = ()
    basis: str = ""

    def __post_init__(self) -> None:
        where = f"parameter '{self.name}'"
        for value in (self.nominal, self.lower, self.upper):
            require_number(value, where)
        limits = f"{self.lower:g}..{self.upper:g}"
        if self.per is not None:
            require_name(self.per, f"{where}, per")
            if self.fixed:
                raise InputError(
                    where,
                    f"fixed, and one per {self.per}",
                    "one of both",
                    "a recipe's `fixed` may hold the value of each",
                )
        if self.optional and (self.nominal or self.fixed or self.per is not None):
            raise InputError(
                where,
                "optional, and fixed, one per group or with another nominal value than 0",
                "a nominal value of 0: without its term a system is as if it were 0",
            )
        if outside := [x for x in self.usual if not self.lower <= x <= self.upper or not x]:
            expected = f"values within {limits} beside 0"
            raise InputError(where, f"the usual value {outside[0]:g}", expected)
        if (self.usual or self.brings) and not self.optional:
            what = "usual values" if self.usual else "forces that it brings"
            raise InputError(where, what, "an optional parameter")
        if not self.lower <= self.upper:
            raise InputError(where, f"range {limits}", "lower first")
        if not self.lower <= self.nominal <= self.upper:
            problem = f"nominal value {self.nominal:g} {self.unit}"
            raise InputError(where, problem, f"a value within {limits}")
        if not (self.fixed or self.lower < self.upper):
            raise InputError(where, "an empty range", "lower < upper, or fixed")
        if not (self.fixed or math.isfinite(self.upper - self.lower)):
            raise InputError(where, "a range without an end", "finite ends")
        if self.prior is not None and not self.prior > 0:
            raise InputError(where, f"prior {self.prior:g}", "a positive standard deviation")

    @property
    def positive(self) -> bool:
        """Whether all of its range is positive; it is then searched for by its logarithm."""
        return self.lower > 0

    def for_group(self, group: str) -> "Parameter":
        """The parameter of the records of one group: `mass[1kg]`."""
        return replace(self, name=f"{self.name}[{group}]")

    def by_group(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The values of the parameter by group, sorted by group: that of `mass[1kg]` by `1kg`."""
        prefix = f"{self.name}["
        names = sorted(name for name in values if name.startswith(prefix) and name.endswith("]"))
        return {name[len(prefix) : -1]: values[name] for name in names}


def require_group_value(
    p: Parameter, groups: Mapping[str, str], valued: Sequence[str], where: object
) -> str:
    """The group of a record by which a parameter has its value: of `mass`, `1kg`.

    Args:
        p: a parameter with values by group.
        groups: the groups of the record.
        valued: the groups that the parameter has values for.
        where: what the record is called, for messages.

    Raises:
        InputError: the group is missing, or has another value.
    """
    choices, value = f"one of {', '.join(valued)}" if valued else "", groups.get(str(p.per))
    if value is None:
        raise InputError(
            where,
            f"no group '{p.per}', which '{p.name}' is per",
            choices,
            f'in the card (or the proposal), give the record `groups = {{ {p.per} = "..." }}`; '
            f"of an export add `group=` {p.per}=...",
        )
    if value not in valued:
        raise InputError(
            where,
            f"{p.per} '{value}', for which '{p.name}' has no value",
            choices,
            f"identify with training records of that {p.per}",
        )
    return value
