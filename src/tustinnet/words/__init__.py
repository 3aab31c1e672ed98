"""The sentences of findings, by code: all words in one room.

A sentence names values in braces, as `str.format` does. A part in double brackets is said where
all its values are there: `{mean:.3g}[[ ± {error:.2g}]] rad`. Formats beside those of Python:

* of a list: its items with commas; `quoted`, `or`, `or-of`, `and`, `each` (semicolons). Items may
  be findings, or lists of what belongs together;
* of a mapping: each name with its value in the format;
* of a number: `percent`, or `percent` and digits; of a count, a noun: `{count:record}` is
  `3 records`. True is nothing: its part is there.
"""

import re
import string
from collections.abc import Mapping, Sequence
from typing import Any

from tustinnet.wording import counted, percent
from tustinnet.words.check import CHECK
from tustinnet.words.identification import IDENTIFICATION
from tustinnet.words.preparation import PREPARATION
from tustinnet.words.selection import SELECTION
from tustinnet.words.sentence import Sentence

__all__ = ["WORDS", "put_in_words"]

WORDS: Mapping[str, Sentence] = {**CHECK, **PREPARATION, **IDENTIFICATION, **SELECTION}

_MOST_NAMES = 12  # that a line has room for
_PERCENT = "percent"
_LAST = {"or": " or ", "or-of": " or of ", "and": " and "}  # before the last one
_OPTIONAL = re.compile(r"\[\[(.*?)\]\]")


class _Formatter(string.Formatter):
    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, Mapping):
            return _listed([f"{n} {self.format_field(x, format_spec)}" for n, x in value.items()])
        if isinstance(value, Sequence) and not isinstance(value, str):
            return _listed(value, format_spec)
        if value is True:  # it only says that its part is there
            return ""
        if format_spec.startswith(_PERCENT):
            digits = format_spec.removeprefix(_PERCENT).strip(".g")
            return f"{percent(float(value), int(digits or 2))} %"
        if isinstance(value, int) and len(format_spec) > 1 and format_spec[:1].isalpha():
            return counted(value, format_spec)
        return super().format_field(value, format_spec)


def _listed(items: Sequence[Any], format_spec: str = "") -> str:
    words = format_spec.split()
    comma = "; " if "each" in words else ", "
    last = next((_LAST[word] for word in words if word in _LAST), comma)
    quote = "'" if "quoted" in words else ""
    texts = [
        _listed(item, f"{'quoted' if quote else ''} and")
        if isinstance(item, list | tuple)
        else f"{quote}{item}{quote}"
        for item in items[:_MOST_NAMES]
    ]
    if len(items) > _MOST_NAMES:
        return f"{comma.join(texts)} and {len(items) - _MOST_NAMES} more"
    return last.join(part for part in (comma.join(texts[:-1]), texts[-1]) if part)


_FORMATTER = _Formatter()


def put_in_words(template: str, values: Mapping[str, Any]) -> str:
    """A sentence with its values.

    Args:
        template: the sentence, see above.
        values: of all that it names; those that are None, False, NaN or empty leave their part out.
    """
    parts = _OPTIONAL.split(template)
    for k in range(1, len(parts), 2):
        names = [name for _, name, _, _ in _FORMATTER.parse(parts[k]) if name]
        if not all(_is_there(values[name]) for name in names):
            parts[k] = ""
    return _FORMATTER.vformat("".join(parts), (), values)


def _is_there(value: Any) -> bool:
    if isinstance(value, str | Sequence | Mapping):
        return len(value) > 0
    return not (value is None or value is False or value != value)  # as NaN is not
