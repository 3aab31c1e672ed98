"""What was made of models, kept while they are in use."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])


def keep_latest(count: int) -> Callable[[Function], Function]:
    """A decorator of functions of a model and options, whose latest results are kept.

    Models are told apart by identity, as their arrays have no hash; options by their values, and
    are given by place.

    Args:
        count: how many results are kept.
    """

    def decorate(function: Function) -> Function:
        kept: list[tuple[Any, tuple[Any, ...], Any]] = []

        @wraps(function)
        def call(model: Any, *options: Any) -> Any:
            for known, known_options, result in kept:
                if known is model and known_options == options:
                    return result
            result = function(model, *options)
            kept.insert(0, (model, options, result))
            del kept[count:]
            return result

        return cast("Function", call)

    return decorate
