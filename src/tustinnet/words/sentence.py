"""A sentence on what was found, and what to do about it."""

from typing import Literal, NamedTuple

Severity = Literal["severe", "warning", "note"]

SEVERITIES: tuple[Severity, ...] = ("severe", "warning", "note")


class Sentence(NamedTuple):
    """A sentence, with names of values in braces.

    Attributes:
        severity: whether something is wrong, or worth knowing, unless the finding says otherwise.
        text: what was found.
        mend: what to do about it; empty where there is nothing to do, or the finding says it.
        size: how it shows, where `text` does not say it.
    """

    severity: Severity
    text: str
    mend: str = ""
    size: str = ""


def note(text: str, mend: str = "", size: str = "") -> Sentence:
    """A sentence on what is worth knowing."""
    return Sentence("note", text, mend, size)


def warning(text: str, mend: str = "", size: str = "") -> Sentence:
    """A sentence on what makes things worse, or is probably not what it is taken for."""
    return Sentence("warning", text, mend, size)


def severe(text: str, mend: str = "", size: str = "") -> Sentence:
    """A sentence on what makes a fit wrong."""
    return Sentence("severe", text, mend, size)
