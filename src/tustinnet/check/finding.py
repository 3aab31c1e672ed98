"""Findings of the check: what is wrong, where, how it shows, and the line of the card for it."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

Severity = Literal["severe", "warning", "note"]

SEVERITIES: tuple[Severity, ...] = ("severe", "warning", "note")


@dataclass(frozen=True)
class Finding:
    """A property of records that a fit suffers from, or that its user should know.

    Attributes:
        check: name of the check, as in the reference page of findings.
        severity: `severe` (a fit would be wrong), `warning` (it would be worse, or the records are
            probably not what the card says) or `note`.
        what: the property, in words.
        size: how it shows, with numbers and units.
        remedy: the line of the data card that mends it, or what to do where no line does.
        records: names of the records that have it.
        channel: name of the coordinate or input, empty where it concerns none.
        column: the column of the log, as the card names it.
        time: where it begins, from the first sample of the record on [s], or None.
    """

    check: str
    severity: Severity
    what: str
    size: str
    remedy: str
    records: tuple[str, ...] = ()
    channel: str = ""
    column: str = ""
    time: float | None = None

    @property
    def is_serious(self) -> bool:
        """Whether a strict check refuses records with it."""
        return self.severity != "note"

    @property
    def text(self) -> str:
        """What was found and its size, as a sentence."""
        return f"{self.what} ({self.size})"


def sort_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sorts findings by severity; those of a severity keep their order."""
    return tuple(sorted(findings, key=lambda f: SEVERITIES.index(f.severity)))


def merge_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Merges findings that differ in nothing but record and time into one with all records."""
    by_content: dict[Finding, list[Finding]] = {}
    for finding in findings:
        by_content.setdefault(replace(finding, records=(), time=None), []).append(finding)
    return tuple(
        replace(
            content,
            records=tuple(name for f in group for name in f.records),
            time=group[0].time if len(group) == 1 else None,
        )
        for content, group in by_content.items()
    )
