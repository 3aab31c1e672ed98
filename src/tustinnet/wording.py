"""Wording of messages that is the same everywhere."""

from collections.abc import Iterable


def counted(number: int, noun: str) -> str:
    """A number of things in words: `1 record`, `3 records`."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def join_words(words: Iterable[str], last: str = "and") -> str:
    """Words as `a, b and c`."""
    *first, end = words
    return f"{', '.join(first)} {last} {end}" if first else end


def percent(share: float, digits: int = 2) -> str:
    """Hundredths of a share: so many digits of a small one, whole numbers up to 9999."""
    value = 100 * share
    is_whole = 10**digits - 1 < value < 9999.5
    return f"{value:.0f}" if is_whole else f"{value:.{digits}g}"
