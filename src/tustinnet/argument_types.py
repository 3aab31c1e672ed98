"""Types of the arguments of public functions: another one is said in a line, as other bad input is.

Annotations are what is checked, as far as a class decides: shapes of arrays, literal texts and
protocols are left to the function. Nothing is checked before it fails.
"""

import types
import typing
from collections.abc import Callable, Iterable, Mapping
from functools import cache, wraps
from inspect import signature
from numbers import Integral, Real
from typing import Any

from tustinnet.errors import InputError

_NUMBERS: dict[Any, type] = {float: Real, int: Integral}  # those of NumPy, too


def check_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that says which argument is of another type than it declares where it fails.

    What works is taken, of whatever type. What the function says itself stays as it is.

    Args:
        function: a function whose arguments have annotations.
    """

    @wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except InputError:
            raise
        except Exception as error:
            misfit = _find_misfit(function, args, named)
            if misfit is None:
                raise
            raise misfit from error

    return call


def _find_misfit(
    function: Callable[..., Any], args: Iterable[Any], named: Mapping[str, Any]
) -> InputError | None:
    """The mistake of the first argument of another type than declared; None without one."""
    try:
        given = signature(function).bind_partial(*args, **named).arguments
    except TypeError:  # which says what there is too much
        return None
    for name, hint in _hints(function).items():
        if name in given and not _fits(given[name], hint):
            found = type(given[name]).__name__.replace("NoneType", "None")
            model = getattr(given[name], "model", None)
            remedy = "" if model is None or not _fits(model, hint) else "give its `model`"
            owner = function.__qualname__.removesuffix(".__init__")
            place, expected = f"{owner}, {name}", " or ".join(_words(hint))
            other = next((n for n, h in _hints(function).items() if _is_of(given[name], h)), "")
            remedy = remedy or (f"give it as `{other}=`" if other else "")
            return InputError(place, found, expected, remedy)
    return None


@cache
def _hints(function: Callable[..., Any]) -> dict[str, Any]:
    """The annotations of the arguments that have one each; none where names are not at hand."""
    try:
        hints = typing.get_type_hints(function)
    except NameError:
        return {}
    kinds = signature(function).parameters
    several = [n for n, p in kinds.items() if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    return {name: hint for name, hint in hints.items() if name not in ("return", *several)}


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value can be of a type; so it is where no class decides."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, part) for part in inner)
    if origin is not None:
        if not isinstance(origin, type):
            return True
        if not issubclass(origin, Iterable):
            return isinstance(value, origin)
        if issubclass(origin, Mapping):
            return isinstance(value, Mapping)
        is_whole = not isinstance(value, str | Mapping) and isinstance(value, Iterable)
        is_read = isinstance(value, list | tuple) or getattr(value, "shape", ())
        elements = value if is_read and inner else ()
        return is_whole and all(_fits(element, inner[0]) for element in elements)
    is_class = (
        isinstance(hint, type)
        and hint is not Any
        and hint.__module__.partition(".")[0] != "jaxtyping"
    )
    if not is_class or getattr(hint, "_is_protocol", False):
        return True
    return isinstance(value, typing.cast("type", _NUMBERS.get(hint, hint)))


def _is_of(value: Any, hint: Any) -> bool:
    """Whether a value is of a class of the package that a type names."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return any(_is_of(value, part) for part in typing.get_args(hint))
    own = isinstance(hint, type) and hint.__module__.startswith(f"{__package__}.")
    return own and not getattr(hint, "_is_protocol", False) and isinstance(value, hint)


def _words(hint: Any) -> list[str]:
    """The types that are taken, for a message."""
    inner = typing.get_args(hint)
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return list(dict.fromkeys(word for part in inner for word in _words(part)))
    name = getattr(hint, "__name__", str(hint))
    if inner and (parts := [word for part in inner[:1] for word in _words(part)]):
        return [f"{name} of {' or '.join(parts)}"]
    return ["None" if hint is type(None) else name]
