"""Completion of option values in a shell: names that the package knows, else files."""

from collections.abc import Callable, Iterable

SPLITS = ("train", "validation", "test")


def _make_completer(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Makes a completer to names that are looked up only when a shell needs them."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _recipes() -> Iterable[str]:
    from tustinnet.data.declaration import list_packaged
    from tustinnet.registry import RECIPE_HOMES

    return list_packaged(RECIPE_HOMES)


def _plans() -> Iterable[str]:
    from tustinnet.data.declaration import list_packaged

    return list_packaged(["tustinnet.selection"], "plan")


def _systems() -> Iterable[str]:
    from tustinnet.registry import SYSTEMS

    return SYSTEMS.names()


def _targets() -> Iterable[str]:
    from tustinnet.registry import TARGETS

    return TARGETS.names()


def _starts() -> Iterable[str]:
    from tustinnet.simulate.start_rules import STARTS

    return [kind.usual_name() for kind in STARTS]


recipe, plan = _make_completer(_recipes), _make_completer(_plans)
system, target = _make_completer(_systems), _make_completer(_targets)
split, start = _make_completer(lambda: SPLITS), _make_completer(_starts)
