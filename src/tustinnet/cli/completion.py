"""Completion of option values in a shell: names that the package knows, else files."""

from collections.abc import Callable, Iterable

from tustinnet.data import declaration
from tustinnet.registry import RECIPE_HOMES, SYSTEMS, TARGETS
from tustinnet.simulate.start_names import START_NAMES

ALL = "all"  # records of every split
SPLITS = ("train", "validation", "test", ALL)


def _completer(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Decorator: a completer to names that are looked up only when a shell needs them."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


@_completer
def recipe() -> Iterable[str]:
    """Names of packaged recipes."""
    return declaration.list_packaged(RECIPE_HOMES)


@_completer
def plan() -> Iterable[str]:
    """Names of packaged plans."""
    return declaration.list_packaged(["tustinnet.selection"], "plan")


@_completer
def start() -> Iterable[str]:
    """Names of starts with their usual numbers of samples."""
    return [kind.usual for kind in START_NAMES]


system, target = _completer(SYSTEMS.names), _completer(TARGETS.names)
split = _completer(lambda: SPLITS)
