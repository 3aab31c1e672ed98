"""TOML files that declare something (a data set, a recipe), read strictly."""

import difflib
import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from tustinnet.errors import InputError


class Declaration(BaseModel):
    """A table of a TOML file: frozen, no key but the declared ones."""

    model_config = ConfigDict(extra="forbid", frozen=True)


Declared = TypeVar("Declared", bound=Declaration)


def read_declaration(path: Path, kind: type[Declared]) -> Declared:
    """Reads a TOML file as a declaration.

    Raises:
        InputError: no such file, no TOML, an unknown key (with the nearest known one), a value
            of the wrong kind; the message names the key.
    """
    return declare(read_toml(path), kind, path)


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: no such file, or no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "no such file", "a TOML file") from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "a TOML file") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, f"not valid TOML ({error})", "key = value lines") from error


def packaged_names(package: str) -> list[str]:
    """Names of the declarations in the folder `recipes` of a package."""
    folder = resources.files(package) / "recipes"
    return sorted(
        f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")
    )


def read_packaged(name: str | Path, packages: Sequence[str]) -> tuple[dict[str, Any], object]:
    """A recipe that comes with one of some packages, by name, or one from a TOML file.

    Returns:
        Its content, and what to call it in messages.

    Raises:
        InputError: no such recipe.
    """
    known = {found: home for home in packages for found in packaged_names(home)}
    if str(name) in known:
        place = resources.files(known[str(name)]) / "recipes" / f"{name}.toml"
        with resources.as_file(place) as path:
            return read_toml(path), f"recipe '{name}'"
    if Path(name).suffix == ".toml":
        return read_toml(Path(name)), name
    raise InputError(
        "recipe",
        f"no recipe '{name}'",
        f"one of {', '.join(sorted(known))}, or a file ending in .toml",
    )


def declare(content: dict[str, Any], kind: type[Declared], where: object) -> Declared:
    """Validates a mapping as a declaration; `where` names it in errors."""
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        # a misspelt key also makes the right one missing: the misspelling is the news
        found = error.errors()
        first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
        location = [str(part) for part in first["loc"]]
        key = ".".join(location) or "the file"
        if first["type"] == "extra_forbidden":
            known = _known_keys(kind, first["loc"][:-1])
            near = difflib.get_close_matches(location[-1], known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(known)}"
            raise InputError(f"{where}, {key}", "unknown key", "", hint) from None
        if first["type"] == "missing":
            raise InputError(f"{where}, {key}", "missing", "a value for this key") from None
        message = first["msg"].removeprefix("Value error, ")
        received = first.get("input")
        if isinstance(received, dict):  # a whole table: name it instead of printing it
            called = f" '{received['name']}'" if "name" in received else ""
            raise InputError(f"{where}, {key}{called}", message) from None
        raise InputError(f"{where}, {key}", f"{message} (got {repr(received)[:60]})") from None


def _known_keys(kind: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """The keys of the table at a location: follows field types, through lists and unions."""
    models = [kind]
    for part in location:
        if isinstance(part, str):
            fields = [m.model_fields[part].annotation for m in models if part in m.model_fields]
            # a part that is no field is a union's tag or a mapping's key: the models stay
            models = [m for field in fields for m in _models_in(field)] if fields else models
    return sorted({name for model in models for name in model.model_fields})


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]
