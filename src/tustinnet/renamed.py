"""Old names that still work, with a message that says the new one; they go in version 0.4."""

import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, TypeVar, cast

from tustinnet.errors import InputError

Function = TypeVar("Function", bound=Callable[..., Any])

# public Python names, `tn.NAME`
NAMES: dict[str, str] = {
    "Asked": "SelectionOptions",
    "make_question": "make_cross_validation_options",
    "Drive": "InputSignal",
    "drive_of": "input_signal",
}
# methods of models
METHODS = {
    "of": "for_record",
    "of_groups": "for_groups",
    "seen": "step_inputs",
    "silent": "with_zero_output",
    "folded": "simplify",
    "beginning": "initial_state",
}
# forces of a recipe (`[model] forces`), and functions of `models.forces`
FORCES = {"rubbing": "coulomb_by_position"}


def refuse_outdated(cls: type, outdated: Mapping[str, str]) -> None:
    """Raises where a class of another package is written for an earlier version of this one.

    Its methods of old names would never be called.

    Args:
        cls: the class.
        outdated: what it has of the earlier version, and what is expected instead.

    Raises:
        InputError: anything is outdated.
    """
    if outdated:
        raise InputError(
            f"class {cls.__module__}.{cls.__qualname__}",
            f"written for an earlier version: {', '.join(outdated)}",
            ", ".join(dict.fromkeys(outdated.values())),
            "adapt it (docs/how-to/add-a-family.md), or uninstall its package",
        )


def current_name(name: str, names: dict[str, str], kind: str) -> str:
    """The present name of something, with a `FutureWarning` where an old one was given.

    Args:
        name: a name, old or new.
        names: new names by old ones.
        kind: kind of thing that has the name, for the message, as "key" or "function".
    """
    if name not in names:
        return name
    warnings.warn(
        f"the {kind} '{name}' is called '{names[name]}' now; the old name goes in version 0.4",
        FutureWarning,
        stacklevel=3,
    )
    return names[name]


def with_renamed_arguments(**names: str) -> Callable[[Function], Function]:
    """Decorator of a function whose keyword arguments have new names: old ones still work.

    Args:
        names: new names by old ones.
    """

    def decorate(function: Function) -> Function:
        @wraps(function)
        def call(*arguments: Any, **options: Any) -> Any:
            for name in names.keys() & options.keys():
                options[current_name(name, names, "argument")] = options.pop(name)
            return function(*arguments, **options)

        return cast(Function, call)

    return decorate
