"""Wording of messages that is the same everywhere."""

from collections.abc import Iterable


def counted(number: int, noun: str) -> str:
    """A number of things in words: `1 record`, `3 records`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def join_words(words: Iterable[str], last: str = "and") -> str:
    """Words as `a, b and c`."""
    *first, end = words
    return f"{', '.join(first)} {last} {end}" if first else end


def percent(share: float) -> str:
    """Hundredths of a share, two digits of a small one."""
    return f"{100 * share:.2g}" if share < 0.1 else f"{100 * share:.0f}"
