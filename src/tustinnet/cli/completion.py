"""What a shell may complete an option's value to: names that the package knows, else files."""

from collections.abc import Callable, Iterable


def _of(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Completes to names that are looked for only when a shell asks."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _recipes() -> Iterable[str]:
    from tustinnet.data.declaration import packaged
    from tustinnet.registry import RECIPE_HOMES

    return packaged(RECIPE_HOMES)


def _plans() -> Iterable[str]:
    from tustinnet.data.declaration import packaged

    return packaged(["tustinnet.selection"], "plan")


def _systems() -> Iterable[str]:
    from tustinnet.registry import SYSTEMS

    return SYSTEMS.names()


def _targets() -> Iterable[str]:
    from tustinnet.registry import TARGETS

    return TARGETS.names()


recipe, plan, system, target = _of(_recipes), _of(_plans), _of(_systems), _of(_targets)
split = _of(lambda: ("train", "validation", "test"))
start = _of(lambda: ("file", "derived-6", "model-20", "warm-up-20"))
