"""Texts beside logs: READMEs that describe their columns, and scripts that read them."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from tustinnet.channels import LONGEST_DT, SHORTEST_DT
from tustinnet.data.columns import are_numbers
from tustinnet.data.drafting.logs import Log
from tustinnet.data.text_dialect import decode
from tustinnet.data.text_file import find_descriptions, find_names, labels_of_columns
from tustinnet.data.text_rate import period_in_prose, period_in_script
from tustinnet.errors import InputError

_LONGEST = 100_000  # characters of a text
_NOTES, _SCRIPTS = ("[Rr][Ee][Aa][Dd][Mm][Ee]*", "*.md", "*.txt"), ("*.m", "*.py")
_TEXT = r"""(?:"[^"\n]*"|'[^'\n]*')"""
_IN_BRACKETS = re.compile(r"\s*(?:\[[^]]*\]|\([^)]*\))$")
_COLUMN_OF_MATRIX = re.compile(r"\w+\[\d+\]")
# `{'time', 'voltage', 'angle'}`, but what a legend has
_LIST = re.compile(rf"(?<!legend\()[\[{{]\s*({_TEXT}(?:[\s,;.]+{_TEXT})+)\s*[\]}}]")
# `q = data(:, 2:3)` of MATLAB, `q = data[:, 1:3]` of Python
_TAKEN = re.compile(
    r"(?m)^[ \t]*(\w+)\s*=\s*\w[\w.]*([\[(])\s*:\s*,\s*(\d{1,3})(?:\s*:\s*(\d{1,3}))?\s*[\])]"
)
# `u = data["Channel 4"]`
_TAKEN_BY_NAME = re.compile(rf"(?m)^[ \t]*(\w+)\s*=\s*\w[\w.]*[\[(]\s*({_TEXT})\s*[\])]")


def name_as_described(
    folder: Path, logs: Sequence[Log], on_message: Callable[[str], None]
) -> Sequence[Log]:
    """The logs with what a text or a script in their folder says of their columns.

    Names of columns that have none, or descriptions of those that have.

    Args:
        folder: the folder of the card.
        logs: the logs, of the same columns.
        on_message: called with a sentence on what is from the text.
    """
    names = [*logs[0].values, *logs[0].texts]
    is_bare = are_numbers(names) and all(log.has_header is False for log in logs)
    if is_bare or all(map(_COLUMN_OF_MATRIX.fullmatch, names)):
        names.sort(key=lambda name: int(re.findall(r"\d+", name)[-1]))
        is_bare = len({name.split("[")[0] for name in names}) == 1 or is_bare
    for path, text in _read_notes(folder, {log.file for log in logs}):
        lines = text.splitlines()
        if is_bare and (labels := find_names(lines, len(names))):
            columns = dict(zip(labels, names, strict=True))
            texts = {columns[n]: text for n, text in find_descriptions(lines, labels).items()}
            described = [replace(log, descriptions=texts) for log in logs]
            return _label(described, path, {n: a for a, n in columns.items()}, on_message)
        if not is_bare and (texts := _descriptions(lines, names)):
            return _describe(logs, path, texts, on_message)
    for path, text in _read_scripts(folder):
        if is_bare and (labels := _names_in_script(text, len(names))):
            return _label(logs, path, dict(zip(names, labels, strict=True)), on_message)
        taken = {quoted[1:-1]: name for name, quoted in _TAKEN_BY_NAME.findall(text)}
        if texts := {name: taken[name] for name in names if name in taken}:
            return _describe(logs, path, texts, on_message)
    return logs


def period_beside(folder: Path, files: Collection[str]) -> tuple[float, str] | None:
    """The sampling period [s] that texts in a folder say, with the reason; None where none does.

    Of several they say the same.
    """
    by_text = {path.name: period_in_script(text) for path, text in _read_scripts(folder)}
    by_text |= {path.name: period_in_prose(text) for path, text in _read_notes(folder, files)}
    periods = {name: x for name, x in by_text.items() if x and SHORTEST_DT <= x <= LONGEST_DT}
    if len({*periods.values()}) != 1:
        return None
    name, period = next(iter(periods.items()))
    return period, f"as {name} has it"


def _descriptions(lines: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Descriptions of columns by their names without units; of a matrix one behind another."""
    columns: dict[str, list[str]] = {}
    for name in names:
        columns.setdefault(_IN_BRACKETS.sub("", name), []).append(name)
    described: dict[str, str] = {}
    for name, text in find_descriptions(lines, columns).items():
        parts = text.split(", ") if len(columns[name]) > 1 else [text]
        if len(parts) == len(columns[name]):
            described |= zip(columns[name], parts, strict=True)
    return described


def _label(
    logs: Sequence[Log], path: Path, labels: Mapping[str, str], on_message: Callable[[str], None]
) -> Sequence[Log]:
    on_message(f"names of columns by {path.name}: {', '.join(labels.values())}")
    return [replace(log, labels=labels) for log in logs]


def _describe(
    logs: Sequence[Log], path: Path, texts: Mapping[str, str], on_message: Callable[[str], None]
) -> Sequence[Log]:
    on_message(f"described by {path.name}: {', '.join(texts)}")
    return [replace(log, descriptions=texts) for log in logs]


def _read(folder: Path, patterns: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """The texts in a folder whose names are like these."""
    for path in sorted({path for pattern in patterns for path in folder.glob(pattern)}):
        if not path.is_file():  # a pipe would be waited for
            continue
        with suppress(OSError, InputError):
            yield path, decode(path, None)[0][:_LONGEST]


def _read_notes(folder: Path, files: Collection[str]) -> Iterator[tuple[Path, str]]:
    """The texts in a folder that people wrote about its logs, which are none of these files."""
    return ((path, text) for path, text in _read(folder, _NOTES) if path.name not in files)


def _read_scripts(folder: Path) -> Iterator[tuple[Path, str]]:
    """The scripts in a folder, without their comments of whole lines."""
    for path, text in _read(folder, _SCRIPTS):
        yield path, re.sub(r"(?m)^[ \t]*[%#].*$", "", text)


def _names_in_script(text: str, width: int) -> list[str] | None:
    """Names of columns in a script: in a list of as many, or of variables that take columns."""
    for match in _LIST.finditer(text):
        names = [quoted[1:-1].strip() for quoted in re.findall(_TEXT, match[1])]
        if len(names) == width > 2 and all(names) and len({*names}) == width:
            return names
    taken: dict[int, str] = {}
    for name, bracket, first, last in _TAKEN.findall(text):
        start = int(first) + (bracket == "[")  # the ends of both count the same: `1:3` is `2:3`
        for k in range(start, int(last or start) + 1):
            taken.setdefault(k, f"{name}{k - start + 1}" if last else name)
    return labels_of_columns(taken, width) if max(taken, default=0) <= width else None
