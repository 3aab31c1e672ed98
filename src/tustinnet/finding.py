"""Findings: what a computation found and its user should know, as data.

A finding has a code, values and where it is; `tustinnet.words` has the sentence of each code.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from tustinnet.words import WORDS, put_in_words
from tustinnet.words.sentence import SEVERITIES, Severity


@dataclass(frozen=True, repr=False)
class Finding:
    """A finding: its code, and the numbers and names that it is about.

    Attributes:
        code: what was found, a key of `tustinnet.words.WORDS`.
        values: numbers, names, lists of them, and findings that are a part of this one, by name.
        severity: `severe` (a fit would be wrong), `warning` (it is or would be worse, or something
            is probably not what it is taken for) or `note`.
        mend: what to do about it, as the line of the data card; empty where nothing is to be done.
        records: names of the records that have it, where it is about records.
        channel: name of the coordinate or input, empty where it concerns none.
        column: the column of the log, as the card names it.
        time: where it begins, from the first sample of the record on [s], or None.
    """

    code: str
    values: Mapping[str, Any]
    severity: Severity
    mend: str = ""
    records: tuple[str, ...] = ()
    channel: str = ""
    column: str = ""
    time: float | None = None

    @property
    def is_serious(self) -> bool:
        """Whether a strict check refuses records with it."""
        return self.severity != "note"

    @property
    def what(self) -> str:
        """The finding in words."""
        return put_in_words(WORDS[self.code].text, self._named)

    @property
    def size(self) -> str:
        """The sign of the finding, with numbers and units; empty where `what` has them."""
        return put_in_words(WORDS[self.code].size, self._named)

    @property
    def statement(self) -> str:
        """The finding and how it shows, as a sentence."""
        return f"{self.what} ({self.size})" if self.size else self.what

    @property
    def text(self) -> str:
        """The finding, how it shows, and what to do about it, as a sentence."""
        return f"{self.statement}; {self.mend}" if self.mend else self.statement

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Finding({self.code!r}: {self.text})"

    @property
    def _named(self) -> Mapping[str, Any]:
        return {"channel": self.channel, **self.values}

    def as_plain(self) -> dict[str, Any]:
        """The finding as plain values, as files and `--json` have it."""
        where = {
            "records": list(self.records),
            "channel": self.channel,
            "column": self.column,
            "time": self.time,
        }
        return {
            "code": self.code,
            "severity": self.severity,
            "text": self.text,
            "mend": self.mend,
            **{name: value for name, value in where.items() if value not in ([], "", None)},
            "values": _plain(self.values),
        }


def make_finding(code: str, /, **values: Any) -> Finding:
    """A finding by its code and values, of the severity that its sentence has."""
    sentence = WORDS[code]
    # numbers of numpy as those of Python: its True and False are neither in sentences
    values = {n: x.item() if getattr(x, "ndim", None) == 0 else x for n, x in values.items()}
    return Finding(code, values, sentence.severity, put_in_words(sentence.mend, values))


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sorts findings by severity; those of a severity keep their order."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def merge_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Merges findings that read alike but for record and time into one with all records."""
    by_content: dict[object, list[Finding]] = {}
    for f in findings:
        content = (f.code, f.severity, f.text, f.channel, f.column)
        by_content.setdefault(content, []).append(f)
    return tuple(
        replace(
            group[0],
            records=tuple(name for f in group for name in f.records),
            time=group[0].time if len(group) == 1 else None,
        )
        for group in by_content.values()
    )


def _plain(value: Any) -> Any:
    """Values of JSON: scalars of NumPy become those of Python, findings their code and values."""
    if isinstance(value, Mapping):
        return {name: _plain(x) for name, x in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(x) for x in value]
    if isinstance(value, Finding):
        return {"code": value.code, **_plain(value.values)}
    return value.item() if hasattr(value, "item") else value
