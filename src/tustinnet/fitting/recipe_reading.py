"""Reading of recipes: packaged ones, TOML files and mappings, with single values changed."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from tustinnet.data.declaration import list_packaged, parse_toml, read_packaged, require_plain
from tustinnet.errors import InputError, convert_errors
from tustinnet.fitting.recipe import Recipe, declare_recipe
from tustinnet.registry import PUBLICATION, RECIPE_HOMES


def packaged_recipes() -> list[str]:
    """Names of the recipes that come with the package."""
    return list(list_packaged(RECIPE_HOMES))


def is_published(recipe: Recipe) -> bool:
    """Whether a recipe is one of the publication, which stays as it was published."""
    return recipe.name in list_packaged([PUBLICATION])


def split_forces(which: str) -> tuple[str, list[str]]:
    """The name or file of a recipe, and the forces after it: `NAME + FORCE + FORCE`."""
    parts = [which] if which.endswith(".toml") else which.split("+")
    name, *forces = (part.strip() for part in parts)
    return name, forces


def read_recipe(
    which: "str | Path | Mapping[str, Any] | Recipe", changes: Sequence[str] | str = ()
) -> Recipe:
    """A packaged recipe by name, or a recipe from a TOML file or a mapping.

    Args:
        which: the recipe; behind a name or file, forces that its model has beside its own, as
            `mechanism + lag`.
        changes: one or several of `KEY=VALUE`, the key with dots between tables, as
            `stages.0.epochs=20` or, in all stages, `stages.*.epochs=20`; the value as TOML has it,
            text also without quotes.

    Raises:
        InputError: no such recipe; an unknown key, one that is changed twice, or a wrong value.
    """
    changes = [changes] if isinstance(changes, str) else changes
    keys = [change.partition("=")[0].strip() for change in changes]
    for i, key in enumerate(keys):
        if key in keys[:i]:
            raise InputError("`changes=`", f"'{key}' twice", "once")
    if isinstance(which, Recipe):
        if not changes:
            return which
        content, where = which.content, f"recipe '{which.name}'"
    elif isinstance(which, Mapping):
        require_plain(which, "recipe")
        content, where = deepcopy(dict(which)), "recipe"
    else:
        name, forces = split_forces(str(which))
        content, where = read_packaged(name, RECIPE_HOMES)
        if forces and "model.forces" in keys:
            what = f"'model.forces', and forces in '{which}'"
            raise InputError("`changes=`", what, "one of them")
        if forces:
            where = f"recipe '{which}'"
            content["name"] = " + ".join((content.get("name", name), *forces))
            model = content.setdefault("model", {})
            model["forces"] = [*model.get("forces", ()), *forces]
    for change in changes:
        _apply_change(content, change)
    return declare_recipe(content, where)


def _apply_change(content: dict[str, Any], change: str) -> None:
    """Puts the value of `KEY=VALUE` into the content of a recipe."""
    key, equals, text = change.partition("=")
    if not equals or not key.strip():
        raise InputError(
            "`changes=`", f"'{change}'", "KEY=VALUE", "for instance stages.0.epochs=20"
        )
    # as TOML has them: dots within quotes are of a name, as of `"arm.mass[1.5kg]"`
    *path, last = (part.strip('"') for part in re.findall(r'"[^"]*"|[^."]+', key.strip()) or [""])
    places: list[Any] = [content]
    for part in path:
        inner = []
        for place in places:
            if isinstance(place, list):
                inner += [place[i] for i in _indices(place, part, change)]
            elif isinstance(place.setdefault(part, {}), dict | list):
                inner.append(place[part])
            else:
                raise InputError(
                    "`changes=`", f"'{change}': '{part}' is no table", "a key of a table"
                )
        places = inner
    for place in places:
        if isinstance(place, list):
            for index in _indices(place, last, change):
                place[index] = _parse_value(text)
        else:
            place[last] = _parse_value(text)


def _indices(place: Sequence[Any], part: str, change: str) -> Sequence[int]:
    """The indices that a part of a key names in a list."""
    if part == "*":
        return range(len(place))
    if not part.isdigit() or int(part) >= len(place):
        raise InputError(
            "`changes=`",
            f"'{change}': no place '{part}' in a list of {len(place)}",
            f"a number from 0 to {len(place) - 1}, or * for all",
        )
    return [int(part)]


def _parse_value(text: str) -> Any:
    """A value as TOML has it; a text also without quotes."""
    with convert_errors("`changes=`", f"'{text.strip()[:30]}'", "a value as TOML has it"):
        try:
            content = parse_toml(f"value = {text}")
        except tomllib.TOMLDecodeError:
            return text.strip()
        return content["value"] if len(content) == 1 else text.strip()
