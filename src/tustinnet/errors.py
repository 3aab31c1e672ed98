"""Errors whose messages are written for users."""

import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from numbers import Real
from typing import Any

_LONGEST_SENTENCE = 400  # characters of place, problem, expected, remedy; lists of keys need some
_LONGEST_FOREIGN = 150  # characters of a foreign library's message
_LONGEST_NAME = 100  # bytes in UTF-8; with an ending it is a file name everywhere
_UNPRINTED = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}  # categories of Unicode


class InputError(ValueError):
    """An input of the package cannot be used.

    The message is one line: the place, the problem, what was expected, what to do. Characters that
    would steer a terminal are escaped, and long parts are cut.
    The command prints it and exits with 1; a program can catch it as a `ValueError`.
    """

    def __init__(self, where: object, problem: str, expected: str = "", remedy: str = "") -> None:
        parts = [f"{where}: {problem}"]
        if expected:
            parts.append(f"expected {expected}")
        if remedy:
            parts.append(remedy)
        super().__init__("; ".join(to_printable(part, _LONGEST_SENTENCE) for part in parts))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled as its message, as a worker sends it."""
        return _restore, (type(self), str(self))


def _restore(kind: type[InputError], message: str) -> InputError:
    """The error of a message."""
    error = kind.__new__(kind)
    error.args = (message,)
    return error


def to_printable(text: str, longest: int) -> str:
    """Text on one line: white space as single blanks, other unprintable characters escaped, cut."""
    line = " ".join(text[: 4 * longest].split())  # the rest would be cut anyway
    escaped = escape_unprinted(line)
    return escaped if len(escaped) <= longest else f"{escaped[: longest - 4]} ..."


def escape_unprinted(text: str) -> str:
    r"""Text in which characters that are not printed, such as control characters, are escapes.

    A name from outside passes here when it enters, so that nothing that prints it has to.
    An escape character becomes `\x1b`, a line end `\n`.
    """
    return "".join(ascii(c)[1:-1] if unicodedata.category(c) in _UNPRINTED else c for c in text)


def describe_error(error: BaseException) -> str:
    """Kind and text of a foreign error, short, also of one whose text cannot be made."""
    try:
        text = str(error)
    except BaseException:
        text = "without a text"
    return to_printable(f"{type(error).__name__}: {text}", _LONGEST_FOREIGN)


def error_message(error: BaseException) -> str:
    """The message of an `InputError`; kind and text of any other error."""
    return str(error) if isinstance(error, InputError) else describe_error(error)


@contextmanager
def convert_errors(where: object, problem: str, expected: str, remedy: str = "") -> Iterator[None]:
    """Context in which errors of foreign libraries, of any kind, become an `InputError`.

    So do those that are no `Exception`, as a panic of a library in Rust. An `InputError` and Ctrl-C
    pass.

    Args:
        where: the file or object that is read.
        problem: its defect; the message of the foreign error follows in brackets.
        expected: its proper form.
        remedy: what to do.
    """
    try:
        yield
    except (InputError, KeyboardInterrupt):
        raise
    except MemoryError:
        raise InputError(
            where, f"{problem} (it does not fit into memory)", expected, remedy
        ) from None
    except BaseException as error:
        raise InputError(where, f"{problem} ({describe_error(error)})", expected, remedy) from error


def require_package(package: str, extra: str, where: object, alternative: str = "") -> None:
    """Raises unless a package is installed that an extra of this one brings.

    Args:
        package: name by which it is imported.
        extra: the extra.
        where: the function or option that requires it.
        alternative: another remedy, as ", or ...".

    Raises:
        InputError: it is not installed.
    """
    if find_spec(package) is None:
        raise InputError(
            where,
            f"the package {package} is not installed",
            package,
            f"pip install 'tustinnet[{extra}]'{alternative}",
        )


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
    if not isinstance(text, str):
        raise InputError(where, f"the name {text!r}", "text")
    unprinted = next((c for c in text if unicodedata.category(c) in _UNPRINTED), None)
    if unprinted is not None:
        raise InputError(where, f"'{text}' holds the character {unprinted!a}", "printable text")
    if len(text.encode()) > _LONGEST_NAME:
        raise InputError(
            where, f"'{text[:30]}...' of {len(text.encode())} bytes", f"at most {_LONGEST_NAME}"
        )


def require_number(value: object, where: object) -> None:
    """Raises unless a value is a real number, of Python or NumPy.

    Raises:
        InputError: something else.
    """
    if not isinstance(value, Real):
        raise InputError(where, f"{value!r}", "a number")
