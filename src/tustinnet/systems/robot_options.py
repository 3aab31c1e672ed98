"""The options of `load_robot`: what each may be, and how a system file has them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any

import numpy as np

from tustinnet.errors import InputError

FRICTIONS = ("stribeck", "load", "curve")  # laws beside viscous and Coulomb friction


def _number(value: Any, least: float = -np.inf) -> float:
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not (is_number and least < float(value) < np.inf):
        raise ValueError
    return float(value)


def _positive(value: Any) -> float:
    return _number(value, 0.0)


def _not_zero(value: Any) -> float:
    if not _number(value):
        raise ValueError
    return float(value)


def _ends(value: Any) -> tuple[float, float]:
    lower, upper = (float(x) for x in value)
    if not (np.isfinite([lower, upper]).all() and lower < upper):
        raise ValueError
    return lower, upper


def _items(where: object, given: Any) -> list[tuple[str, Any]]:
    """The values by name of an option, in the order of the names."""
    if not isinstance(given, Mapping | None):
        raise InputError(where, f"an option {given!r}", "a value by name, as {'joint2': 0.0}")
    return sorted((given or {}).items())


def _by_name(
    read: Callable[[Any], Any], expected: str, remedy: Callable[[str], str] = lambda _: ""
) -> Any:
    """The field of an option that has a value by name, each read by a function."""

    def check(where: object, option: str, given: Any, _: Mapping[str, Any]) -> dict[str, Any]:
        checked = {}
        for name, value in _items(where, given):
            try:
                checked[name] = read(value)
            except (TypeError, ValueError):
                problem = f"{option}: {value!r} for '{name}'"
                raise InputError(where, problem, expected, remedy(name)) from None
        return checked

    return field(default_factory=dict, metadata={"check": check})


def _check_friction(where: object, _: str, given: Any, __: Mapping[str, Any]) -> tuple[str, ...]:
    names = (given,) if isinstance(given, str) else given
    if unknown := [name for name in names if name not in FRICTIONS]:
        raise InputError(
            where,
            f"friction '{unknown[0]}'",
            f"one of {', '.join(FRICTIONS)}",
            "viscous and Coulomb friction are always there",
        )
    return tuple(name for name in FRICTIONS if name in names)


def _check_encoders(where: object, _: str, given: Any, others: Mapping[str, Any]) -> dict[str, str]:
    """The elastic joints with encoders at the motor; at the link is what all others have."""
    elastic = others["elastic"]
    sides = dict.fromkeys(elastic or [""], given) if isinstance(given, str) else given
    for joint, side in _items(where, sides):
        of_joint = f" of '{joint}'" if joint else ""
        if side not in ("motor", "link"):
            raise InputError(where, f"encoders{of_joint}: {side!r}", "'motor' or 'link'")
        if joint not in elastic and sides != {"": "link"}:
            raise InputError(
                where,
                f"encoders{of_joint}: {side!r}, and no elastic gear there",
                f"one of {', '.join(elastic)}" if elastic else "joints with elastic gears",
                "give it a stiffness by elastic=; behind a rigid gear both encoders read alike",
            )
    return {joint: side for joint, side in _items(where, sides) if side == "motor"}


def _check_gravity(
    where: object, _: str, given: Any, __: Mapping[str, Any]
) -> tuple[float, ...] | None:
    if given is None:
        return None
    try:
        x, y, z = (_number(value) for value in given)
    except (TypeError, ValueError):
        expected = "three numbers [m/s^2] in the frame of the base"
        problem, of_ceiling = f"gravity: {given!r}", "gravity=(0.0, 0.0, 9.81) below a ceiling"
        raise InputError(where, problem, expected, of_ceiling) from None
    return x, y, z


@dataclass(frozen=True)
class RobotOptions:
    """The options of `load_robot`, which says what they mean, as far as they are used.

    They are in the order in which a system file has them, each with its check.
    """

    locked: Mapping[str, float] = _by_name(_number, "a number")
    motor_constants: Mapping[str, float] = _by_name(_not_zero, "a number other than 0")
    per: Mapping[str, str] = _by_name(str.strip, "the name of a group")
    friction: tuple[str, ...] = field(default=(), metadata={"check": _check_friction})
    elastic: Mapping[str, float] = _by_name(_positive, "a positive number")
    backlash: Mapping[str, float] = _by_name(_positive, "a positive number")
    encoders: Mapping[str, str] = field(default_factory=dict, metadata={"check": _check_encoders})
    default_density: float | None = None
    gravity: tuple[float, ...] | None = field(default=None, metadata={"check": _check_gravity})
    ranges: Mapping[str, tuple[float, float]] = _by_name(
        _ends,
        "two numbers, the smaller one first",
        lambda name: f"ranges={{'{name}': (0.0, 1.0)}}",
    )

    @classmethod
    def checked(cls, where: object, **given: Any) -> "RobotOptions":
        """The options that a user gave.

        Args:
            where: the robot's file, for messages.
            given: a value of each option; None and empty ones where it is not used.

        Raises:
            InputError: a value that is none of its option.
        """
        for option in fields(cls):
            if (check := option.metadata.get("check")) is not None:
                given[option.name] = check(where, option.name, given[option.name], given)
        return cls(**given)

    def call(self, file: str, more: Mapping[str, object]) -> str:
        """The line of a system file that loads a robot with these options.

        Args:
            file: name of the robot's file.
            more: options in place of these; what is given by name, and frictions, is added.
        """
        options: dict[str, Any] = {**vars(self), "friction": [*self.friction]}
        for name, value in more.items():
            if isinstance(value, Mapping):
                value = {**options[name], **value}
            elif isinstance(value, list):
                value = [*dict.fromkeys([*options[name], *value])]
            options[name] = value
        written = "".join(f", {name}={value!r}" for name, value in options.items() if value)
        return f"SYSTEM = tn.load_robot('{file}'{written})"
