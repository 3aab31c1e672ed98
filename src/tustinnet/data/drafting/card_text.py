"""The text of a drafted card, with comments that say why."""

from collections.abc import Callable, Mapping, Sequence

from tustinnet.data.columns import NUMBERED
from tustinnet.data.declaration import bare_key, quote
from tustinnet.data.drafting.findings import Choice, CoordinateChoice, InputChoice
from tustinnet.data.drafting.logs import Clock, JoinedFile
from tustinnet.data.drafting.splits import DraftRecord, Splits

_PERIOD_TOLERANCE = 0.05  # of the period, as cards accept without a key


def write_card(
    name: str,
    clock: Clock,
    dt: float,
    choice: Choice,
    splits: Splits | None,
    *,
    has_header: bool | None,
    has_damaged_rows: bool,
    column_numbers: Mapping[str, int],
    texts: Mapping[str, str],
    joined: Mapping[str, JoinedFile],
    period_reason: str,
) -> str:
    """The text of a data card.

    Args:
        name: name of the data set.
        clock: the time base.
        dt: sampling period [s].
        choice: coordinates, inputs and columns that are not used.
        splits: the records; None where all logs beside the card are records.
        has_header: whether files without names of columns have a header; None with names.
        has_damaged_rows: whether files have rows that are no samples.
        column_numbers: the numbers of the columns, where only some files name them.
        texts: columns that hold no numbers, and what they hold.
        joined: other files of each record, by their labels.
        period_reason: why this is the period; empty where nothing in the files says it.
    """
    key = _key_of(has_header, column_numbers)
    why = period_reason or "assumed; check: how far apart are the samples?"
    lines = [
        "# drafted from the logs; what is marked `check` is assumed",
        "# every key: docs/reference/data.md",
        f"name = {quote(name)}",
        f"dt = {dt!r}  # s, {why}",
        *_assumed(() if period_reason else ("dt",)),
    ]
    if has_header is not None or has_damaged_rows:
        lines += ["", "[format]"]
    if has_header is not None:
        lines.append(f"header = {str(has_header).lower()}")
    if has_damaged_rows:
        lines.append('damaged_rows = "skip"  # some rows are no samples')
    if clock.column is not None:
        doubt = "" if clock.sure else "; check the unit"
        lines += [
            "",
            f"# {quote(clock.column)}: {clock.because}{doubt}",
            "[time]",
            f"column = {key(clock.column)}",
            f"unit = {quote(clock.unit)}",
            *_assumed(() if clock.sure else ("unit",)),
        ]
        if clock.worst > _PERIOD_TOLERANCE * dt:
            share = f"{100 * clock.worst / dt:.0f} %"
            lines.append(f'irregular = "resample"  # intervals deviate by up to {share} of dt')
    lines += [line for label, file in joined.items() for line in _joined(label, file)]
    lines += [line for coordinate in choice.coordinates for line in _coordinate(coordinate, key)]
    if not choice.coordinates:
        lines += ["", "# [[coordinates]]: no column could be a position"]
    lines += [line for channel in choice.inputs for line in _input(channel, key)]
    if not choice.inputs:
        lines += ["", "# no column looks like an input: a motion that something drives needs one"]
    unused = {**choice.unused, **clock.others, **texts}
    lines += [""] if unused or choice.missing else []
    lines += [f"# {sentence}" for sentence in choice.missing]
    lines += [f"# not used: {quote(column)}: {why}" for column, why in unused.items()]
    return "\n".join([*lines, *_splits(splits)]) + "\n"


def _joined(label: str, file: JoinedFile) -> list[str]:
    """The table of other files of the records."""
    lines = ["", f"# columns of other files of the records are called {quote(label + '/...')}"]
    if file.starts_together:
        lines.append("# check that both files begin at one instant: their clocks say nothing of it")
    lines.append(f"[join.{bare_key(label)}]")
    if file.column is not None:
        key = _key_of(file.has_header, {})
        lines += [f"column = {key(file.column)}", f"unit = {quote(file.unit)}"]
    lines += ["starts_together = true"] if file.starts_together else []
    assumed = [] if file.is_sure else ["unit"]
    lines += _assumed([*assumed, *(["starts_together"] if file.starts_together else [])])
    form = [] if file.has_header is None else [f"header = {str(file.has_header).lower()}"]
    form += ['damaged_rows = "skip"'] if file.has_damaged_rows else []
    return [*lines, *([f"format = {{ {', '.join(form)} }}"] if form else [])]


def _key_of(has_header: bool | None, numbers: Mapping[str, int]) -> Callable[[str], str]:
    """The key of a column in a card: its number where no file has names, or only some have."""
    if numbers:
        return lambda column: str(numbers[column])
    # those of joined files are called `label/column 1`
    return lambda column: (
        column.removeprefix(NUMBERED)
        if has_header is not None and column.startswith(NUMBERED)
        else quote(column)
    )


def _coordinate(c: CoordinateChoice, key: Callable[[str], str]) -> list[str]:
    lines = ["", f"# {quote(c.column)} as a coordinate: {'; '.join(c.because)}"]
    lines += [f"# check {doubt}" for doubt in c.doubts]
    lines += [
        "[[coordinates]]",
        f"name = {quote(c.name)}",
        f"column = {key(c.column)}",
        f"kind = {quote(c.kind)}",
        f"unit = {quote(c.unit)}",
    ]
    if c.sine is not None:
        lines.append(f"sine = {key(c.sine)}  # its cosine is in `column`")
    if not c.wraps:
        lines.append("unwrap = false  # its jumps are no turns")
    if c.counts is not None:
        lines.append(f"counts_per_revolution = {c.counts}")
    if c.resolution is not None:
        lines.append(f"resolution = {c.resolution!r}  # the step of its values")
    if c.velocity is not None:
        entry = f", unit = {quote(c.velocity.unit)}" if c.velocity.unit else ""
        measured = str(c.velocity.measured).lower()
        column = key(c.velocity.column)
        lines += [
            f"# {quote(c.velocity.column)}: {c.velocity.because}",
            f"velocity = {{ column = {column}{entry}, measured = {measured} }}",
        ]
    return [*lines, *_assumed(c.assumed)]


def _input(c: InputChoice, key: Callable[[str], str]) -> list[str]:
    lines = ["", f"# {quote(c.column)} as an input: {'; '.join(c.because)}"]
    lines += [f"# check {doubt}" for doubt in c.doubts]
    return [
        *lines,
        "[[inputs]]",
        f"name = {quote(c.name)}",
        f"column = {key(c.column)}",
        f"unit = {quote(c.unit)}",
        *([] if c.scale == 1 else [f"scale = {c.scale!r}  # {c.unit} in one unit of the column"]),
        *_assumed(c.assumed),
    ]


def _assumed(keys: Sequence[str]) -> list[str]:
    """The line of a table with the keys that nothing in the logs says, if there are any."""
    names = ", ".join(map(quote, keys))
    return [f"assumed = [{names}]  # check these keys, then delete this line"] if keys else []


def _splits(splits: Splits | None) -> list[str]:
    if splits is None:
        return [
            "",
            "# all logs beside this card are records; to choose some and what they are for:",
            "# [splits]",
            '# train = ["this file"]',
            '# validation = ["another file"]',
        ]
    lines = ["", *(f"# {sentence}" for sentence in splits.sentences)]
    by_split: dict[str, list[DraftRecord]] = {}
    for record in splits.records:
        by_split.setdefault(record.split or "train", []).append(record)
    lines.append("[splits]")
    for split in ("train", "validation", "test"):
        if records := by_split.get(split):
            lines.append(f"{split} = [")
            lines += [f"    {entry}," for entry in _entries(records)]
            lines.append("]")
    return lines


def _entries(records: Sequence[DraftRecord]) -> list[str]:
    """The entries of a split; files that are whole by their name."""
    entries = []
    for record in records:
        piece = record.piece
        keys = [f"file = {quote(piece.log.file)}"]
        keys += [] if piece.log.cell is None else [f"cell = {piece.log.cell}"]
        keys += [] if piece.log.record is None else [f"record = {quote(piece.log.record)}"]
        files = (f"{bare_key(k)} = {quote(f.file)}" for k, f in piece.log.joined.items())
        keys += [f"join = {{ {', '.join(files)} }}"] if piece.log.joined else []
        keys += [] if piece.whole else [f"rows = [{piece.rows[0]}, {piece.rows[1]}]"]
        entries.append(quote(piece.log.file) if len(keys) == 1 else f"{{ {', '.join(keys)} }}")
    return entries
