"""Type checks of functions within functions, made once instead of at every call of the outer one.

The import hook of jaxtyping decorates every function where it is defined. One that is defined
within another is defined, and its checks are compiled, whenever the outer one is called: a tenth of
the time of all tests. Here the checks are kept by the function's code and annotations.
"""

import functools
import inspect
import threading
from collections.abc import Callable
from types import FunctionType
from typing import Any, get_args

import jaxtyping

_decorate: Any = jaxtyping.jaxtyped
_kept: dict[tuple[object, ...], Callable[..., Any]] = {}


class _Running(threading.local):
    """Functions whose checks are running in a thread, the innermost last."""

    def __init__(self) -> None:
        self.functions: list[Callable[..., Any]] = []


_running = _Running()


def _make_checks(fn: FunctionType, typechecker: Any) -> Callable[..., Any]:
    """Checks of a function's arguments and result, around whichever function is running."""

    def innermost(*args: Any, **kwargs: Any) -> Any:
        return _running.functions[-1](*args, **kwargs)

    # in the function's own module, where names in quoted annotations are looked up
    stand_in = FunctionType(innermost.__code__, fn.__globals__ | {"_running": _running})
    stand_in.__name__, stand_in.__qualname__ = fn.__name__, fn.__qualname__
    stand_in.__module__, stand_in.__annotations__ = fn.__module__, fn.__annotations__
    vars(stand_in)["__signature__"] = inspect.signature(fn)
    return _decorate(stand_in, typechecker=typechecker)


def _key(annotation: Any) -> object:
    """A key of an annotation; jaxtyping makes a new class whenever it is asked for the same one."""
    is_class = isinstance(annotation, type) and not issubclass(annotation, jaxtyping.AbstractArray)
    return annotation if is_class and not get_args(annotation) else repr(annotation)


def jaxtyped(fn: Any = None, *, typechecker: Any) -> Any:
    """Decorates as `jaxtyping.jaxtyped` does; checks of inner functions are made once."""
    if fn is None:
        return functools.partial(jaxtyped, typechecker=typechecker)
    if not isinstance(fn, FunctionType) or "<locals>" not in fn.__qualname__:
        return _decorate(fn, typechecker=typechecker)
    key = (fn.__code__, typechecker, *map(_key, fn.__annotations__.values()))
    checks = _kept.get(key)
    if checks is None:
        checks = _kept[key] = _make_checks(fn, typechecker)

    @functools.wraps(fn)
    def checked(*args: Any, **kwargs: Any) -> Any:
        _running.functions.append(fn)
        try:
            return checks(*args, **kwargs)
        finally:
            _running.functions.pop()

    return checked


jaxtyping.jaxtyped = jaxtyped  # for the modules that are imported from here on
