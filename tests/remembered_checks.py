"""Checks of types and shapes, made at little cost and remembered.

The import hook of jaxtyping has arguments checked before a call and once more, beside the result,
after it, by functions which it makes of text, and binds them to names at every call: nearly half of
the time of all tests. Here beartype checks arguments and result around the call. Where types,
shapes and dtypes are all that is checked, those that were right once are right again. Checks are
made at the first call: most functions of the package are never called in one worker. Functions
within functions are defined whenever the outer one is called: their checks are kept by the
function's code and annotations.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from types import FunctionType, UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin

import jaxtyping
from jaxtyping import _decorator, _storage

_decorate: Any = jaxtyping.jaxtyped


class _Checks(NamedTuple):
    """The checks of a function.

    Attributes:
        function: the function with its checks.
        has_shapes: whether there are shapes among them: sizes have to be kept by name.
        seen: what was right, see `_look`; None where more is checked.
    """

    function: Any
    has_shapes: bool
    seen: set[object] | None


_kept: dict[tuple[object, ...], _Checks] = {}
_is_array: dict[type, bool] = {}


def _look(value: Any) -> object:
    """What a check of types and shapes sees of a value."""
    kind = type(value)
    if kind not in _is_array:
        _is_array[kind] = hasattr(value, "shape") and hasattr(value, "dtype")
    return (kind, value.shape, value.dtype) if _is_array[kind] else kind


def _sees_all(annotation: Any) -> bool:
    """Whether a check of an annotation depends on nothing that `_look` does not see."""
    if get_origin(annotation) in (Union, UnionType):
        return all(map(_sees_all, get_args(annotation)))
    if annotation in (Any, None) or get_origin(annotation) is Callable:
        return True
    if not isinstance(annotation, type) or get_args(annotation):
        return False
    return "jaxtyping" not in repr(annotation) or issubclass(annotation, jaxtyping.AbstractArray)


def _key(annotation: Any) -> object:
    """A key of an annotation; jaxtyping makes a new class whenever it is asked for the same one."""
    is_class = isinstance(annotation, type) and not issubclass(annotation, jaxtyping.AbstractArray)
    return annotation if is_class and not get_args(annotation) else repr(annotation)


def _make_checks(fn: FunctionType, typechecker: Any) -> _Checks:
    """The checks of a function."""
    copy = FunctionType(fn.__code__, fn.__globals__, fn.__name__, fn.__defaults__, fn.__closure__)
    copy.__kwdefaults__, copy.__module__ = fn.__kwdefaults__, fn.__module__
    copy.__qualname__ = fn.__qualname__
    # names that are not known yet, or to type checkers alone, stand for anything
    annotations = copy.__annotations__ = {
        name: _decorator._destring_annotation(annotation, fn.__globals__)
        for name, annotation in fn.__annotations__.items()
    }
    has_shapes = any("jaxtyping" in repr(a) for a in annotations.values())
    seen = set[object]() if all(map(_sees_all, annotations.values())) else None
    return _Checks(typechecker(copy), has_shapes, seen)


def _checks_of(fn: FunctionType, typechecker: Any) -> _Checks:
    """The checks of a function, those kept of a function within a function."""
    if "<locals>" not in fn.__qualname__:
        return _make_checks(fn, typechecker)
    key = (fn.__code__, typechecker, *map(_key, fn.__annotations__.values()))
    if key not in _kept:
        _kept[key] = _make_checks(fn, typechecker)
    return _kept[key]


def _checks_around(checks: _Checks, fn: Callable[..., Any]) -> Callable[..., Any]:
    """Another function with the same checks: what beartype calls is a default of its own."""
    kept: Any = checks.function
    assert "__beartype_func" in kept.__kwdefaults__
    own = FunctionType(kept.__code__, kept.__globals__, kept.__name__, kept.__defaults__)
    own.__kwdefaults__ = kept.__kwdefaults__ | {"__beartype_func": fn}
    return own


def _check(fn: FunctionType, checks: _Checks) -> Callable[..., Any]:
    """A function with checks, itself where there is nothing to check."""
    if checks.function.__code__ is fn.__code__:
        return fn
    around = _checks_around(checks, fn)
    if not checks.has_shapes:
        return around
    seen = checks.seen

    def keep_sizes(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        _storage.push_shape_memo({})
        try:
            return function(*args, **kwargs)
        finally:
            _storage.pop_shape_memo()

    if seen is None:
        return functools.partial(keep_sizes, around)

    def remembered(*args: Any, **kwargs: Any) -> Any:
        looks = (*map(_look, args), *kwargs, *map(_look, kwargs.values()))
        if looks not in seen:
            out = keep_sizes(around, *args, **kwargs)
            seen.add(looks)
            seen.add((looks, _look(out)))
            return out
        out = fn(*args, **kwargs)
        both = (looks, _look(out))
        if both not in seen:
            keep_sizes(_checks_around(checks, lambda *_, **__: out), *args, **kwargs)
            seen.add(both)
        return out

    return remembered


def jaxtyped(fn: Any = None, *, typechecker: Any) -> Any:
    """Decorates as `jaxtyping.jaxtyped` does."""
    if fn is None:
        return functools.partial(jaxtyped, typechecker=typechecker)
    if inspect.isclass(fn) and dataclasses.is_dataclass(fn):
        if not hasattr(fn.__init__, "is_checked"):
            fn.__init__ = jaxtyped(fn.__init__, typechecker=typechecker)
        return fn
    if not isinstance(fn, FunctionType) or inspect.isgeneratorfunction(fn):
        return _decorate(fn, typechecker=typechecker)
    if not fn.__annotations__:
        return fn
    with_checks: Callable[..., Any] | None = None

    @functools.wraps(fn)
    def checked(*args: Any, **kwargs: Any) -> Any:
        nonlocal with_checks
        if jaxtyping.config.jaxtyping_disable:
            return fn(*args, **kwargs)
        if with_checks is None:
            with_checks = _check(fn, _checks_of(fn, typechecker))
        return with_checks(*args, **kwargs)

    vars(checked)["is_checked"] = True
    return checked


jaxtyping.jaxtyped = jaxtyped  # for the modules that are imported from here on
