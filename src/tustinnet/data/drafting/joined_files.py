"""Records that are spread over several files: which files belong together, by names and times.

An encoder and a motor may be logged by programs of their own, as in `enc_01.csv` and `volt_01.csv`.
The words that all files of a kind have, and those of another kind have not, are its label; what
remains of the names is equal in the files of a record.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tustinnet.data.columns import NUMBERED
from tustinnet.data.drafting.logs import Clock, JoinedFile, Log, find_clock, read_names
from tustinnet.data.drafting.names import INPUTS, read_name
from tustinnet.data.drafting.numbers import Values
from tustinnet.data.units import TIME
from tustinnet.wording import counted

_SAYS = 2.0  # weights of words and units that say a quantity

_HELP = "docs/reference/data.md#records-of-several-files"

Key = tuple[str, ...]


class _Kind(NamedTuple):
    """Files of one kind: their logs by what their names have of their own, and their clock."""

    words: frozenset[str]
    logs: dict[Key, Log]
    clock: Clock


def join_logs(logs: Sequence[Log], on_message: Callable[[str], None]) -> list[Log]:
    """Logs in which files that are parts of one record are one.

    Files with a position and no input are joined with those of another kind that have inputs or
    further positions, where names pair them and their times overlap; so are files of as many rows
    whose columns have no names.

    Args:
        logs: the logs of all files.
        on_message: called with a sentence on files that are joined, or why they are not.
    """
    kinds = _find_kinds(logs)
    are_parts = _are_side_by_side(kinds)
    if are_parts:  # row by row, whatever rises in them
        kinds = [kind._replace(clock=Clock(None)) for kind in kinds]
    first = max(kinds, key=_width if are_parts else _position_weight, default=None)
    is_of_positions = first is not None and _position_weight(first) >= _SAYS
    if first is None or len(kinds) < 2 or not (are_parts or is_of_positions) or _has_input(first):
        return [*logs]
    joined: dict[Key, Log] = dict(first.logs)
    used: set[str] = set()
    for other in kinds:
        has_quantity = _has_input(other) or _position_weight(other) >= _SAYS
        if other is first or not (has_quantity or are_parts):
            continue
        label = "_".join(sorted(other.words - first.words)) or "other"
        pairs = {
            key: (log, other.logs[key]) for key, log in first.logs.items() if key in other.logs
        } or _pair_by_dates(first, other)
        names = f"{next(iter(first.logs.values())).file}, {next(iter(other.logs.values())).file}"
        if not pairs:
            on_message(f"{names}: not joined, their names do not pair; {_HELP}")
            continue
        together = _start_together(pairs, first.clock, other.clock)
        if together is None:
            on_message(
                f"{names}: not joined, their times have nothing in common and differ in length; "
                f"{_HELP}"
            )
            continue
        for key, (_, part) in pairs.items():
            joined[key] = _join(joined[key], part, label, first.clock, other.clock, together)
        used |= {part.file for _, part in pairs.values()}
        how = "as if they began together" if together else "by their times"
        if other.clock.column is None:
            how = "row by row"
        on_message(
            f"{names}: {counted(len(pairs), 'record')} of two files, joined {how}; columns of the "
            f"second are called '{label}/...'"
        )
    in_place = {log.file: log for log in joined.values()}
    return [in_place.get(log.file, log) for log in logs if log.file not in used]


def _width(kind: _Kind) -> int:
    """The number of columns of files of a kind."""
    return len(next(iter(kind.logs.values())).values)


def _are_side_by_side(kinds: Sequence[_Kind]) -> bool:
    """Whether files without names of columns are parts of tables: of every record as many rows."""
    keys = {frozenset(kind.logs) for kind in kinds}
    if len(keys) != 1 or len({*map(_width, kinds)}) < 2:
        return False
    return all(
        len({len(kind.logs[key]) for kind in kinds}) == 1
        and all(kind.logs[key].has_header is False for kind in kinds)
        for key in next(iter(keys))
    )


def _find_kinds(logs: Sequence[Log]) -> list[_Kind]:
    """The kinds of files: of equal columns, and of equal words where a file has one quantity."""
    groups: dict[tuple[object, ...], list[Log]] = {}
    for log in logs:
        if log.cell is not None or log.record is not None or log.clocks:
            return []  # one file is not one record
        # files of times and values may have the same header, whatever they measure
        words = frozenset(w for w in _words(log.file) if not w.isdigit())
        few = len(log.values) <= 2 and not _quantities([log], "")
        groups.setdefault((tuple(log.values), words if few else None), []).append(log)
    common = {
        key: frozenset.intersection(*(frozenset(_words(log.file)) for log in group))
        for key, group in groups.items()
    }
    kinds: list[_Kind] = []
    for key, group in groups.items():
        others = [words for other, words in common.items() if other != key]
        own = common[key] - frozenset.intersection(*others) if others else common[key]
        own = frozenset(w for w in own if not w.isdigit())
        by_rest = {tuple(w for w in _words(log.file) if w not in own): log for log in group}
        if len(by_rest) == len(group):
            kinds.append(_Kind(own, by_rest, find_clock(group, read_names(group))))
    return kinds


def _words(file: str) -> list[str]:
    """Words and numbers of a path without its ending; numbers without zeros before them."""
    words = re.findall(r"[^\W\d_]+|\d+", re.sub(r"\.\w+$", "", file).lower())
    return [w.lstrip("0") or "0" if w.isdigit() else w for w in words]


def _quantities(logs: Sequence[Log], label: str) -> dict[str, float]:
    """The largest weight of each quantity among the columns of files that are no times."""
    weights: dict[str, float] = {}
    for name in logs[0].values:
        text = "" if name.startswith(NUMBERED) else logs[0].labels.get(name, name)
        reading = read_name(f"{label} {text}".strip(), logs[0].units.get(name, ""))
        if "time" in read_name(text).quantities:
            continue
        for quantity, weight in reading.quantities.items():
            # a commanded position is none
            if reading.qualifier != "command" or quantity in INPUTS:
                weights[quantity] = max(weights.get(quantity, 0.0), weight)
    return weights


def _position_weight(kind: _Kind) -> float:
    weights = _quantities([*kind.logs.values()], " ".join(kind.words))
    return weights.get("position", 0.0) - max(weights.get(q, 0.0) for q in INPUTS)


def _has_input(kind: _Kind) -> bool:
    weights = _quantities([*kind.logs.values()], " ".join(kind.words))
    return max(weights.get(q, 0.0) for q in INPUTS) >= _SAYS


def _start_together(
    pairs: Mapping[Key, tuple[Log, Log]], first: Clock, other: Clock
) -> bool | None:
    """Whether files begin together, False where their times overlap; None where neither is so."""
    if first.column is None or other.column is None:
        return False if all(len(a) == len(b) for a, b in pairs.values()) else None
    overlap, alike = [], []
    for a, b in pairs.values():
        s, t = _seconds(a, first), _seconds(b, other)
        spans = s[-1] - s[0], t[-1] - t[0]
        overlap.append(_overlap(s, t))
        # records of two clocks that may have begun together
        alike.append(abs(spans[0] - spans[1]) < 0.2 * max(spans))
    return False if all(overlap) else True if all(alike) else None


def _pair_by_dates(first: _Kind, other: _Kind) -> dict[Key, tuple[Log, Log]]:
    """Files whose names do not pair by the times since 1970 that they have in common."""
    pairs: dict[Key, tuple[Log, Log]] = {}
    if first.clock.column is None or other.clock.column is None:
        return pairs
    for key, log in first.logs.items():
        t = _seconds(log, first.clock)
        for part in other.logs.values():
            # times from 1970 are later than 1e8 s
            if t[0] > 1e8 and _overlap(_seconds(part, other.clock), t):
                pairs[key] = log, part
    return pairs if len({part.file for _, part in pairs.values()}) == len(pairs) else {}


def _overlap(s: Values, t: Values) -> bool:
    """Whether two clocks have most of the shorter record in common."""
    common = min(s[-1], t[-1]) - max(s[0], t[0])
    return bool(common > 0.5 * min(s[-1] - s[0], t[-1] - t[0]))


def _seconds(log: Log, clock: Clock) -> Values:
    assert clock.column is not None
    return log.values[clock.column] * TIME[clock.unit]


def _join(
    log: Log, part: Log, label: str, clock: Clock, other: Clock, starts_together: bool
) -> Log:
    """A log with the columns of another file, held at the times of its own."""
    names = {name: f"{label}/{name}" for name in part.values}
    values, clock_of, spans = dict(log.values), dict(log.clock_of), dict(log.spans)
    clocks, factor = log.clocks, log.factor
    if clock.column is None or other.column is None:
        values |= {names[name]: column for name, column in part.values.items()}
    else:
        t, times = _seconds(log, clock), _seconds(part, other)
        times = times - times[0] + t[0] if starts_together else times
        last = np.clip(np.searchsorted(times, t, "right") - 1, 0, len(times) - 1)
        values |= {names[name]: column[last] for name, column in part.values.items()}
        if not clocks:
            clocks, factor = (clock.column,), TIME[clock.unit]
            clock_of = dict.fromkeys(log.values, clock.column)
            spans = {clock.column: (float(t[0]), float(t[-1]))}
        clocks = (*clocks, names[other.column])
        clock_of |= dict.fromkeys(names.values(), names[other.column])
        spans |= {names[other.column]: (float(times[0]), float(times[-1]))}
    file = JoinedFile(
        part.file,
        other.column,
        other.unit,
        other.sure,
        starts_together,
        part.has_header,
        part.has_damaged_rows,
    )
    return replace(
        log,
        values=values,
        clocks=clocks,
        clock_of=clock_of,
        spans=spans,
        factor=factor,
        texts={**log.texts, **{f"{label}/{n}": text for n, text in part.texts.items()}},
        notes=(*log.notes, *(f"{label}: {note}" for note in part.notes)),
        units={**log.units, **{names[n]: u for n, u in part.units.items() if n in names}},
        labels={**log.labels, **{names[n]: x for n, x in part.labels.items() if n in names}},
        joined={**log.joined, label: file},
    )
