"""TOML files that declare something (a data set, a recipe), read strictly."""

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from tustinnet.errors import InputError, convert_errors, require_name, require_text

_LARGEST = 1_000_000  # bytes of a text that somebody wrote
_DEEPEST = 20  # tables in tables
_INTEGERS = 2**63  # TOML has integers of 64 bits
# tomllib takes an hour for a key of half a million parts, so that these are refused before it
_LONG_KEY = re.compile(
    rf"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST}}}"""
)
_LONG_NUMBER = re.compile(r"\d{1001}")
_NESTED = f"nested deeper than {_DEEPEST}"


def _name(name: str) -> str:
    require_name(name, "")  # the message begins with the key
    return name


def _text(text: str) -> str:
    require_text(text, "")
    return text


def _sentence(text: str) -> str:
    words = text.split()
    for word in words:
        require_text(word, "")
    return " ".join(words)


Name = Annotated[str, AfterValidator(_name)]  # can be a file's name
Text = Annotated[str, AfterValidator(_text)]  # can be printed
Sentence = Annotated[str, AfterValidator(_sentence)]  # the same, of any length and on any lines


class Declaration(BaseModel):
    """A table of a TOML file: frozen, no key but the declared ones, numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


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
    text = read_source(path, "a TOML file")
    with convert_errors(path, "not valid TOML", "key = value lines"):
        return parse_toml(text)


def read_source(path: Path, what: str) -> str:
    """A text that somebody wrote: a file of at most 1 MB in UTF-8.

    Raises:
        InputError: no such file, no file at all, too large, or no text; `what` is expected.
    """
    with convert_errors(path, "cannot be read", f"{what} in UTF-8"):
        if not path.is_file():  # a pipe may never end
            raise InputError(path, "a folder or pipe" if path.exists() else "no such file", what)
        with path.open("rb") as file:
            content = file.read(_LARGEST + 1)
        if len(content) > _LARGEST:
            raise InputError(path, "more than 1 MB", what)
        return content.decode("utf-8-sig")


def parse_toml(text: str) -> dict[str, Any]:
    """What a text of TOML says.

    Raises:
        ValueError: no TOML, or nested too deep.
    """
    if _LONG_KEY.search(text):
        raise ValueError(_NESTED)
    if _LONG_NUMBER.search(text):
        raise ValueError("a number of more than 1,000 digits")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(_NESTED) from None


def list_packaged(packages: Sequence[str], what: str = "recipe") -> dict[str, str]:
    """The declarations in the folders `recipes`, or of another kind, of packages.

    Returns:
        Their names in order, and the package of each.
    """
    found = {
        file.name.removesuffix(".toml"): package
        for package in packages
        for file in (resources.files(package) / f"{what}s").iterdir()
        if file.name.endswith(".toml")
    }
    return dict(sorted(found.items()))


def read_packaged(
    name: str | Path, packages: Sequence[str], what: str = "recipe"
) -> tuple[dict[str, Any], object]:
    """A recipe or a plan that comes with one of some packages, by name, or one from a TOML file.

    Returns:
        Its content, and what to call it in messages.

    Raises:
        InputError: none of that name.
    """
    known = list_packaged(packages, what)
    if str(name) in known:
        place = resources.files(known[str(name)]) / f"{what}s" / f"{name}.toml"
        with resources.as_file(place) as path:
            return read_toml(path), f"{what} '{name}'"
    if Path(name).suffix == ".toml":
        return read_toml(Path(name)), name
    raise InputError(
        what,
        f"no {what} '{name}'",
        f"one of {', '.join(known)}, or a file ending in .toml",
    )


_OF_A_KEY = "[key]"  # where pydantic says that not a value but its key is wrong


def _names(error: Any) -> list[str]:
    """The keys that a table may have whose keys are names."""
    return re.findall(r"'([^']*)'", str(error.get("ctx", {}).get("expected", "")))


def declare(content: dict[str, Any], kind: type[Declared], where: object) -> Declared:
    """Validates a mapping as a declaration; `where` names it in errors."""
    require_plain(content, where)
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        # a misspelt key also makes the right one missing: the misspelling is the news
        found = error.errors()
        first = next((e for e in found if e["type"] == "extra_forbidden"), found[0])
        location = [str(part) for part in first["loc"]]
        key = ".".join(location) or "the file"
        named = location[-1:] == [_OF_A_KEY]  # a table whose keys are names
        if named:
            location = location[:-1]
            key = ".".join(location)
        if named or first["type"] == "extra_forbidden":
            known = _names(first) if named else _known_keys(kind, first["loc"][:-1])
            near = difflib.get_close_matches(location[-1], known, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(known)}"
            raise InputError(f"{where}, {key}", "unknown key", "", hint) from None
        if first["type"] == "missing":
            raise InputError(f"{where}, {key}", "missing", "a value for this key") from None
        message = first["msg"].removeprefix("Value error, ").removeprefix(": ")
        received = first.get("input")
        if isinstance(received, dict):  # a whole table: name it instead of printing it
            called = f" '{received['name']}'" if "name" in received else ""
            raise InputError(f"{where}, {key}{called}", message) from None
        if isinstance(first.get("ctx", {}).get("error"), InputError):  # it says what it was given
            raise InputError(f"{where}, {key}", message) from None
        raise InputError(f"{where}, {key}", f"{message} (got {repr(received)[:60]})") from None


def require_plain(content: Mapping[str, Any], where: object) -> None:
    """Raises unless a mapping could be that of a TOML file of moderate depth.

    Raises:
        InputError: tables or lists nested deeper than 20, or an integer of more than 64 bits.
    """
    level: list[Any] = [content]
    for _ in range(_DEEPEST + 1):
        if any(isinstance(x, int) and not -_INTEGERS <= x < _INTEGERS for x in level):
            raise InputError(where, "an integer of more than 64 bits", "a smaller number")
        inside = [x.values() if isinstance(x, Mapping) else x for x in level
                  if isinstance(x, Mapping | list | tuple)]  # fmt: skip
        if not inside:
            return
        level = [x for values in inside for x in values]
    raise InputError(where, _NESTED, "a few tables")


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
