"""TOML files that declare something (a data set, a recipe), read strictly."""

import difflib
import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from tustinnet.errors import InputError, convert_errors, require_name, require_text
from tustinnet.old_names import KEYS

_LARGEST_FILE = 1_000_000  # bytes of a text file that is written by hand
_DEEPEST_TABLE = 20  # tables in tables
_INTEGERS = 2**63  # TOML has integers of 64 bits
# tomllib takes an hour for a key of half a million parts; these are refused beforehand
_LONG_KEY = re.compile(
    rf"""(?<![\w"'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST_TABLE}}}"""
)
_LONG_NUMBER = re.compile(r"\d{1001}")
_NESTED = f"nested deeper than {_DEEPEST_TABLE}"
_OF_A_KEY = "[key]"  # pydantic's mark of a wrong key, not a wrong value
_UNKNOWN = {"extra_forbidden", "unexpected_keyword_argument"}  # keys, of a model, of a dataclass


def _checked(require: Callable[[str, object], None]) -> AfterValidator:
    """The check of a text by a function that raises; the message begins with the key."""

    def check(text: str) -> str:
        require(text, "")
        return text

    return AfterValidator(check)


def _check_sentence(text: str) -> str:
    words = text.split()
    for word in words:
        require_text(word, "")
    return " ".join(words)


Name = Annotated[str, _checked(require_name)]  # can be a file's name
Text = Annotated[str, _checked(require_text)]  # can be printed
Sentence = Annotated[str, AfterValidator(_check_sentence)]  # Text of any length, on any lines


class Declaration(BaseModel):
    """A table of a TOML file: frozen, no key but the declared ones, numbers finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


DeclarationType = TypeVar("DeclarationType", bound=Declaration)


def read_declaration(path: Path, kind: type[DeclarationType]) -> DeclarationType:
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


def read_source(path: Path, expected: str) -> str:
    """The content of a text file of at most 1 MB in UTF-8.

    Args:
        path: the file.
        expected: kind of file, for the message.

    Raises:
        InputError: no such file, no file at all, too large, or no text.
    """
    with convert_errors(path, "cannot be read", f"{expected} in UTF-8"):
        if not path.is_file():  # a pipe may never end
            problem = "a folder or pipe" if path.exists() else "no such file"
            raise InputError(path, problem, expected)
        with path.open("rb") as file:
            content = file.read(_LARGEST_FILE + 1)
        if len(content) > _LARGEST_FILE:
            raise InputError(path, "more than 1 MB", expected)
        return content.decode("utf-8-sig")


def quote(text: str) -> str:
    """A text as TOML and JSON have it; TOML has no character 127."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def bare_key(key: str) -> str:
    """A key of a table, in quotation marks where TOML wants them."""
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else quote(key)


def parse_toml(text: str) -> dict[str, Any]:
    """The content of a text of TOML.

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


def list_packaged(packages: Sequence[str], kind: str = "recipe") -> dict[str, str]:
    """The declarations of a kind that come with packages, in their folders `recipes`, `plans`, ...

    Returns:
        The names in order, and the package of each.
    """
    names = {
        file.name.removesuffix(".toml"): package
        for package in packages
        for file in (resources.files(package) / f"{kind}s").iterdir()
        if file.name.endswith(".toml")
    }
    return dict(sorted(names.items()))


def read_packaged(
    name: str | Path, packages: Sequence[str], kind: str = "recipe"
) -> tuple[dict[str, Any], object]:
    """A recipe or a plan that comes with one of some packages, by name, or one from a TOML file.

    Returns:
        Its content, and its name for messages.

    Raises:
        InputError: none of that name.
    """
    homes = list_packaged(packages, kind)
    if str(name) in homes:
        place = resources.files(homes[str(name)]) / f"{kind}s" / f"{name}.toml"
        with resources.as_file(place) as path:
            return read_toml(path), f"{kind} '{name}'"
    if Path(name).suffix == ".toml":
        return read_toml(Path(name)), name
    near = difflib.get_close_matches(str(name), homes, n=1)
    raise InputError(
        kind,
        f"no {kind} '{name}'",
        f"one of {', '.join(homes)}, or a file ending in .toml",
        f"did you mean '{near[0]}'?" if near else "",
    )


def declare(
    content: dict[str, Any],
    kind: type[DeclarationType],
    where: object,
    *,
    strict: bool = False,
) -> DeclarationType:
    """Validates a mapping as a declaration.

    Args:
        content: the mapping.
        kind: the declaration.
        where: its name in errors.
        strict: whether it is from JSON, whose types are taken as they are: "1" is no number.

    Raises:
        InputError: see `read_declaration`.
    """
    require_plain(content, where)
    try:
        if strict:
            return kind.model_validate_json(json.dumps(content), strict=True)
        return kind.model_validate(content)
    except ValidationError as error:
        # a misspelt key also makes the right one missing: the misspelling is the news
        errors = error.errors()
        first = next((e for e in errors if e["type"] in _UNKNOWN), errors[0])
        location = [str(part) for part in first["loc"]]
        key = ".".join(location) or "the file"
        keys: list[str] | None = None
        if location[-1:] == [_OF_A_KEY]:  # a table whose keys are names, which the error lists
            location = location[:-1]
            key = ".".join(location)
            keys = re.findall(r"'([^']*)'", str(first.get("ctx", {}).get("expected", "")))
        elif first["type"] in _UNKNOWN:
            keys = _table_keys(kind, first["loc"][:-1])
        if keys is not None:
            near = difflib.get_close_matches(location[-1], keys, n=1)
            hint = KEYS.get(location[-1], f"known keys: {', '.join(keys)}")
            hint = f"did you mean '{near[0]}'?" if near else hint
            raise InputError(f"{where}, {key}", "unknown key", "", hint) from None
        if first["type"] == "missing":
            raise InputError(f"{where}, {key}", "missing", "a value for this key") from None
        message = first["msg"].removeprefix("Value error, ").removeprefix(": ")
        if first["type"] == "too_long":
            message = "{actual_length} values, expected at most {max_length} items".format(
                **first.get("ctx", {})
            )
        received = first.get("input")
        if isinstance(received, dict):  # a whole table: name it instead of printing it
            name = f" '{received['name']}'" if "name" in received else ""
            raise InputError(f"{where}, {key}{name}", message) from None
        if isinstance(first.get("ctx", {}).get("error"), InputError):  # it contains the value
            raise InputError(f"{where}, {key}", message) from None
        raise InputError(f"{where}, {key}", f"{message} (got {repr(received)[:60]})") from None


def require_plain(content: Mapping[str, Any], where: object) -> None:
    """Raises unless a mapping could be that of a TOML file of moderate depth.

    Raises:
        InputError: tables or lists nested deeper than 20, or an integer of more than 64 bits.
    """
    level: list[Any] = [content]
    for _ in range(_DEEPEST_TABLE + 1):
        if any(isinstance(x, int) and not -_INTEGERS <= x < _INTEGERS for x in level):
            raise InputError(where, "an integer of more than 64 bits", "a smaller number")
        inside = [
            x.values() if isinstance(x, Mapping) else x
            for x in level
            if isinstance(x, Mapping | list | tuple)
        ]
        if not inside:
            return
        level = [x for values in inside for x in values]
    raise InputError(where, _NESTED, "a few tables")


def _table_keys(kind: type, location: tuple[int | str, ...]) -> list[str]:
    """The keys of the table at a location; field types are followed through lists and unions."""
    tables = [_keys(kind)]
    for part in location:
        if isinstance(part, str):
            found = [keys[part] for keys in tables if part in keys]
            # a part that is no key is a union's tag or a mapping's key: the tables stay
            tables = [keys for field in found for keys in _tables_in(field)] if found else tables
    return sorted({name for keys in tables for name in keys})


def _keys(kind: type) -> dict[str, Any]:
    """The keys of a table with their types; none of what is no table."""
    if issubclass(kind, BaseModel):
        return {name: field.annotation for name, field in kind.model_fields.items()}
    return {f.name: f.type for f in fields(kind) if f.compare} if is_dataclass(kind) else {}


def _tables_in(annotation: Any) -> list[dict[str, Any]]:
    inside = [keys for part in get_args(annotation) for keys in _tables_in(part)]
    own = _keys(annotation) if isinstance(annotation, type) else {}
    return [own] if own else inside
