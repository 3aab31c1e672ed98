"""Lines on what the check of records finds."""

from collections.abc import Iterable, Sequence
from pathlib import Path

import tustinnet as tn
from tustinnet.check import assumed
from tustinnet.cli.about import data_words
from tustinnet.data import spoiled
from tustinnet.errors import InputError
from tustinnet.finding import Finding
from tustinnet.signals import equilibria
from tustinnet.wording import counted

_MOST_NAMED, _FIRST_NAMED = 6, 3  # records that a line names: all of so many, or the first ones
_MOST_LINES = 12  # of findings before a fit


def describe_findings(findings: Iterable[Finding], total: int) -> list[str]:
    """Lines about findings in some records: what, how it shows, where, and the line of the card."""
    lines = []
    for finding in findings:
        lines.append(f"{finding.severity}: {finding.what}")
        lines.append(f"    {finding.size}")
        if place := _place(finding, total):
            lines.append(f"    in {place}")
        lines.append(f"    mend: {finding.mend}")
    return lines


def _place(finding: Finding, total: int) -> str:
    """The records, of so many in total, the column and the time of a finding."""
    parts = [_list_records(finding.records, total)] if finding.records else []
    parts += [f"column {finding.column}"] if finding.column else []
    parts += [f"from {finding.time:.4g} s on"] if finding.time is not None else []
    return ", ".join(parts)


def warning_lines(
    findings: Iterable[Finding], total: int, data: str, card: Path | None
) -> list[str]:
    """Lines about severe findings and warnings, for commands that go on; of many the first ones.

    Args:
        findings: the findings.
        total: number of all records.
        data: the data set as `inspect` takes it.
        card: its card, if it was named.
    """
    serious = [f for f in findings if f.is_serious]
    lines = []
    for finding in serious[:_MOST_LINES]:
        place = _place(finding, total)
        lines.append(f"{finding.severity}: {finding.statement}" + (f"  [{place}]" if place else ""))
    if serious:
        more = len(serious) - len(lines)
        counted = f"{more} more findings, and how" if more else "how"
        command = f"tustinnet inspect {data_words(data, card)}"
        lines.append(f"note: {counted} to mend them: {command}")
    return lines


def assumed_lines(findings: Iterable[Finding]) -> list[str]:
    """A line about what a card assumes, for commands that go on; none where it assumes nothing."""
    facts = [f.what for f in findings if f.code.startswith(assumed.ASSUMED)]
    if not facts:
        return []
    more = len(facts) - _MOST_NAMED
    named = "; ".join(facts[:_MOST_NAMED]) + (f"; and {more} more" if more > 0 else "")
    return [f"note: {named}: check the card, then delete `assumed` there"]


def spoiled_lines(
    records: "Iterable[tn.Experiment]", held: "Iterable[equilibria.HeldEquilibrium | None]"
) -> list[str]:
    """Lines about parts of records that spoil a fit and show without a model.

    Args:
        records: the records.
        held: the unstable equilibrium that is held to the end of each, if any.
    """
    return [
        f"spoiled: {part.sentence}"
        for e, equilibrium in zip(records, held, strict=True)
        for part in spoiled.find_without_model(e, equilibrium)
    ]


def require_sound(findings: Iterable[Finding]) -> None:
    """Raises an error with the first severe finding or warning, if there are any."""
    for finding in findings:
        if finding.is_serious:
            where = f"record '{finding.records[0]}'" if finding.records else "records"
            raise InputError(
                where,
                finding.statement,
                "records without severe findings and warnings",
                f"{finding.mend}; or omit --strict",
            )


def merge_remarks(kind: str, remarks: Iterable[tuple[str, str]], total: int) -> list[str]:
    """Lines of remarks: one line for each text, with its records.

    Args:
        kind: what the lines begin with.
        remarks: pairs of record and text.
        total: number of all records.
    """
    by_text: dict[str, list[str]] = {}
    for name, text in remarks:
        by_text.setdefault(text, []).append(name)
    return [
        f"{kind}: {text}  [{_list_records(names, total)}]"
        for text, names in sorted(by_text.items())
    ]


def _list_records(names: Sequence[str], total: int) -> str:
    """Names of records in a line; of many the first ones, and how many others."""
    if len(names) <= _MOST_NAMED:
        return ", ".join(names)
    if len(names) == total:
        return f"all {counted(total, 'record')}"
    return f"{', '.join(names[:_FIRST_NAMED])} and {len(names) - _FIRST_NAMED} others"
