"""The errors that people are meant to read."""

import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

_LONGEST_PART = 400  # characters of where, found, expected, remedy; what lists keys needs some
_LONGEST_FOREIGN = 150  # characters of what a foreign library says
_LONGEST_NAME = 100  # bytes in UTF-8; with an ending it is a file name everywhere
_UNPRINTED = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}  # categories of Unicode


class InputError(ValueError):
    """Something given to the package cannot be used.

    The message is one line: where, what was found, what was expected, what to do. Characters that
    would steer a terminal are escaped, and long parts are cut.
    The command prints it and exits with 1; a program can catch it as a `ValueError`.
    """

    def __init__(self, where: object, found: str, expected: str = "", remedy: str = "") -> None:
        parts = [f"{where}: {found}"]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__("; ".join(to_printable(part, _LONGEST_PART) for part in parts))


def to_printable(text: str, longest: int) -> str:
    """Text on one line: white space as single blanks, other unprintable characters escaped, cut."""
    line = " ".join(text[: 4 * longest].split())  # the rest would be cut anyway
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
    return shown if len(shown) <= longest else f"{shown[: longest - 4]} ..."


def describe_error(error: BaseException) -> str:
    """Kind and text of a foreign error, short, also of one whose text cannot be made."""
    try:
        text = str(error)
    except BaseException:
        text = "without a text"
    return to_printable(f"{type(error).__name__}: {text}", _LONGEST_FOREIGN)


def error_message(error: Exception) -> str:
    """Why something could not be done: what an `InputError` says; kind and text of others."""
    return str(error) if isinstance(error, InputError) else describe_error(error)


@contextmanager
def convert_errors(where: object, found: str, expected: str, remedy: str = "") -> Iterator[None]:
    """Whatever a foreign library raises inside, of any kind, becomes an `InputError`.

    Also what is no `Exception`, as a panic of a library in Rust. An `InputError` and Ctrl-C pass.

    Args:
        where: what is being read.
        found: what is wrong with it; the error's own words follow in brackets.
        expected: what it should be.
        remedy: what to do.
    """
    try:
        yield
    except (InputError, KeyboardInterrupt):
        raise
    except MemoryError:
        raise InputError(
            where, f"{found} (it does not fit into memory)", expected, remedy
        ) from None
    except BaseException as error:
        raise InputError(where, f"{found} ({brief(error)})", expected, remedy) from error


def require_package(package: str, extra: str, where: object, otherwise: str = "") -> None:
    """Raises unless a package is installed that an extra of this one brings.

    Args:
        package: what it is imported as.
        extra: the extra.
        where: what needs it.
        otherwise: what else could be done, as ", or ...".

    Raises:
        InputError: it is not installed.
    """
    if find_spec(package) is None:
        raise InputError(
            where, f"the package {package} is not installed", package,
            f"pip install 'tustinnet[{extra}]'{otherwise}",
        )  # fmt: skip


def require_name(name: str, where: object) -> None:
    """Raises unless a name can be a file's name and be printed.

    Not empty, no separator of paths, no leading dot, no control characters, at most 100 bytes.

    Raises:
        InputError: another name.
    """
    require_text(name, where)
    if not name.strip() or name.startswith(".") or "/" in name or "\\" in name:
        raise InputError(
            where, f"the name '{name}'", "a name without / and \\ that does not begin with a dot"
        )


def require_text(text: str, where: object) -> None:
    """Raises unless a text can be printed: no control characters, at most 100 bytes in UTF-8.

    Raises:
        InputError: another text.
    """
    bad = next((c for c in text if unicodedata.category(c) in _UNPRINTED), None)
    if bad is not None:
        raise InputError(where, f"'{text}' holds the character {bad!a}", "printable text")
    if len(text.encode()) > _LONGEST_NAME:
        raise InputError(
            where, f"'{text[:30]}...' of {len(text.encode())} bytes", f"at most {_LONGEST_NAME}"
        )
