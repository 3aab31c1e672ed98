"""Text files of columns."""

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from tustinnet.data.columns import (
    NUMBERED,
    Column,
    Columns,
    number_repeated,
    require_different,
)
from tustinnet.data.merged_topics import FEW_VALUES, NOTE, TIME, find_merged_topics
from tustinnet.data.text_dates import is_date, read_dates
from tustinnet.data.text_dialect import (
    BLANKS,
    HEADER_ROWS,
    HEXADECIMAL,
    LAST_ROWS,
    NUMBER,
    SAMPLE_LINES,
    Dialect,
    Header,
    Lines,
    comment_text,
    decode,
    find_dialect,
    find_table,
    find_units_above,
    find_units_in_comments,
    is_comment,
    is_unit,
    read_header,
)
from tustinnet.data.text_long import spread_signals
from tustinnet.data.text_pairs import Pairs, find_described, find_pairs
from tustinnet.errors import InputError, describe_error
from tustinnet.wording import counted

if TYPE_CHECKING:
    import polars as pl

DAMAGED_ROWS = "damaged rows left out"  # the note on such a file begins with their number
_LABELLED = re.compile(r"([^\W\d]\w*)\s?[:=]\s*([-+]?\d[\d.]*(?:[eE][-+]?\d+)?)(?=[\s,;]|$)")
_DECIMALS = re.compile(r"[-+]?\d+[.,]\d+")
_ID = re.compile(r"(?i)(?:^|[_ .])id$|(?<=[a-z])I[Dd]$")
_SECTION = re.compile(r"\d+\.Variable\s*;\s*(\S.*)")
NO_HEADER = "no header: the first row is a sample"  # the note on such a file

_NO_VALUE = r"(?i)^\s*(nan|null|none)?\s*$"  # a cell without a value
_COMMENT = "\tComment"  # a last column of LabVIEW, of which rows may have no cell
_PREAMBLE = 300  # lines above a table, at most
_EMPTY = " \t,;|"  # marks between cells: at the end of a file a row of nothing else
_END = re.compile("(?i)(eof|end of file)?")
_COLUMNS_ARE = re.compile(r"(?i)(col|spalt|field|feld|variab|header|format|names?)\w*\s*:")
_MARKUP = " `*"
_RULE = re.compile(r"[ |:]*-[-|: ]*\|[-|: ]*")  # below the head of a table in Markdown
_LIST = r"^\s*\[[-+.,;\deE\s]+\]\s*$"  # of numbers
_LIST_MARK = re.compile(r"^\s*(?:[*+-]|\d+[.)])*\s*")
_IS = re.compile(r"\s*[:=]\s+|\s+[-\u2013\u2014]\s+")  # between a name and what it means
_NUMBERED_NAME = re.compile(r"(?i)((?:col|name)\w*?\s*)?((?:\d+[\s,]*)+)[:.)=-]?\s*([^\W\d].*)")


def read_text(
    path: Path,
    *,
    header: bool | int | None = None,
    delimiter: str | None = None,
    decimal: str | None = None,
    encoding: str | None = None,
    skips_damaged: bool = False,
) -> Columns:
    """Reads the columns of a text file; see `read_columns`.

    Blank lines, empty cells at the end and comments are no rows. Every other line is one: a quote
    that would make one row of several lines is refused. Errors name the rows of the file as it is.
    """
    file = _find_rows(path, header, delimiter, decimal, encoding, skips_damaged=skips_damaged)
    lines, dialect, pairs = file.lines, file.dialect, file.pairs
    if header is not None and not isinstance(header, bool):
        header = True
    table = _spread_lists(_cells(path, lines, dialect))
    first = _texts(table, 0)
    # a date alone is no sample: it may stand above the table
    is_sample = any(map(dialect.is_number, first)) and _is_like_others(first, table, dialect)
    if header and is_sample:
        raise InputError(
            f"{path} row {lines[0][0]}",
            "only numbers where the names of the columns should be",
            "a header, as `header = true` says",
            "if the file has none, set `header = false` under [format], or leave it out",
        )
    numbered = [f"{NUMBERED}{number}" for number in range(1, table.width + 1)]
    found = Header(numbered, {}, 0)
    if file.header is not None:
        found = file.header
    elif (not is_sample) if header is None else header:
        rows = [_texts(table, k) for k in range(min(HEADER_ROWS, len(table)))]
        found = read_header(rows, dialect)
    elif header is None and (names := _names_in(file.comments, dialect, table.width)):
        found = Header(names, {}, 0)
    if len(lines) <= found.rows:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    numbers = [name for name in found.names if _DECIMALS.fullmatch(name)]
    # one number among names is what was logged at that time, and differs from file to file
    nameless = (
        {"", *numbers} if header is None and len(numbers) == 1 < len(found.names) - 1 else {""}
    )
    names = number_repeated(
        [b if a in nameless else a for a, b in zip(found.names, numbered, strict=True)]
    )
    require_different(names, path)
    repeated = [
        name
        for name, other in zip(names, found.names, strict=True)
        if other not in (*nameless, name)
    ]
    index = {name: column for column, name in enumerate(names)}
    first_row, rows = lines[0][0], [row for row, _ in lines[found.rows :]]
    dates = [n for n, cell in zip(names, _texts(table, found.rows), strict=True) if is_date(cell)]

    def read(requested: list[str]) -> list[Column]:
        numbers = (n for n in requested if NUMBER.fullmatch(n) and not HEXADECIMAL.fullmatch(n))
        doubtful = next(numbers, None)
        # names beside numbers, some of them used; above units they are names
        if header is None and doubtful is not None and found.rows == 1:
            raise InputError(
                f"{path} row {first_row}",
                f"names of columns and the number {doubtful}",
                "names or numbers only",
                "set `header = true` (names) or `header = false` (a sample) under [format]",
            )
        cells = table.slice(found.rows)
        if pairs is not None:
            return [_of_pair(cells, index[name], pairs, path, dialect, rows) for name in requested]
        return [
            _numbers(
                cells.to_series(index[name]), dialect, path, name, rows, has_header=found.rows > 0
            )
            for name in requested
        ]

    described = (
        dialect if delimiter is None else Dialect(",", dialect.decimal, dialect.thousands)
    ).describe()
    is_in_comment = is_sample and found.names != numbered and file.header is None
    is_bare = header is None and is_sample and names == numbered
    notes = [
        *([file.remark] if file.remark else []),
        *([described] if described and not _prefers_tabs(path) else []),
        *([f"{counted(file.skipped, 'row')} before the header skipped"] if file.skipped else []),
        *([f"{file.damaged} {DAMAGED_ROWS}"] if file.damaged else []),
        *([f"names and units in {found.rows} rows"] if found.rows > 1 else []),
        *(["pairs of columns, times and values"] if pairs is not None else []),
        *(["names of the columns in a comment"] if is_in_comment else []),
        *([NO_HEADER] if is_bare else []),
        *(f"a later column of the same name: '{name}'" for name in repeated),
        *(f"'{name}': dates or times of day, read as seconds since midnight" for name in dates),
    ]
    units = {} if file.header is not None else find_units_above(file.above, names)
    units |= find_units_in_comments(file.comments, names)
    units = units | found.units | dict.fromkeys(dates, "s")
    clocks = {} if pairs is None else pairs.clocks
    columns = Columns(names, read, rows, tuple(notes), clocks=clocks, units=units)
    return columns if clocks else _by_topic(columns, table, found.rows, dialect, path)


def _by_topic(
    columns: Columns, table: "pl.DataFrame", header_rows: int, dialect: Dialect, path: Path
) -> Columns:
    """The columns of a table, with times of their own where its rows are of several topics."""
    return (
        _spread_if_long(columns, table, header_rows, dialect)
        or _split_if_merged(columns, table.slice(header_rows), dialect, path)
        or columns
    )


def _spread_if_long(
    columns: Columns, table: "pl.DataFrame", header_rows: int, dialect: Dialect
) -> Columns | None:
    """The columns by signal of a long table of times, signals and values; None of another one.

    Signals are texts, or numbers below a name such as `motor_id`.
    """
    names = columns.names
    if not header_rows or len(names) < 3:
        return None
    texts = [
        n
        for n, cell in zip(names, _texts(table, header_rows), strict=True)
        if not (dialect.is_number(cell) or is_date(cell))
    ]
    for label in texts or [name for name in names[1:] if _ID.search(name)]:
        cells = table.slice(header_rows).to_series(names.index(label)).str.strip_chars()
        spread = spread_signals(columns, cells.fill_null("").to_list(), label, texts)
        if spread is not None:
            return spread
    return None


def _split_if_merged(
    columns: Columns, table: "pl.DataFrame", dialect: Dialect, path: Path
) -> Columns | None:
    """The columns with times of their own of a table of merged topics; None of another one."""
    import polars as pl

    cells = dict(zip(columns.names, table.get_columns(), strict=True))
    has_value = ~pl.all().fill_null("").str.contains(_NO_VALUE)
    present = {
        name: column.to_numpy()
        for name, column in zip(columns.names, table.select(has_value).get_columns(), strict=True)
    }
    topics = find_merged_topics(present, lambda name: columns[name])
    if not topics:
        return None
    rows = np.asarray(columns.rows)

    def read(name: str) -> Column:
        source, chosen = topics[name].source, topics[name].rows
        some = cells[source].filter(chosen)
        return _numbers(some, dialect, path, source, rows[chosen], has_header=True)

    return Columns(
        [*topics],
        lambda names: [read(name) for name in names],
        notes=(*columns.notes, NOTE),
        others=dict.fromkeys({*cells} - {*topics}, FEW_VALUES),
        clocks={name: topic.clock for name, topic in topics.items()},
        units={n: columns.units[t.source] for n, t in topics.items() if t.source in columns.units},
    )


@dataclass(frozen=True)
class _FoundRows:
    """The rows of a file, and how they are written.

    Attributes:
        lines: the rows and their text.
        comments: the comments before them, without their marks.
        dialect: the marks of the file.
        remark: on its encoding, and on names that are left out.
        skipped: number of rows above a header.
        above: the cells of these rows.
        damaged: number of rows that are no samples and are left out.
        header: the names and units that these rows say, None where they say none.
        pairs: the columns in pairs, if they are.
    """

    lines: Lines
    comments: Sequence[str]
    dialect: Dialect
    remark: str = ""
    skipped: int = 0
    above: Sequence[Sequence[str]] = ()
    damaged: int = 0
    header: Header | None = None
    pairs: Pairs | None = None


def _prefers_tabs(path: Path) -> bool:
    return path.suffix.lower() == ".tsv"


def _find_rows(
    path: Path,
    header: bool | int | None,
    delimiter: str | None,
    decimal: str | None,
    encoding: str | None,
    *,
    skips_damaged: bool,
) -> _FoundRows:
    """The rows of a file that are no comments nor blank, and no lines above a header."""
    first_row = 0 if header is None or isinstance(header, bool) else header
    text, remark = decode(path, encoding)
    lines, comments = _lines(text)
    if first_row:
        lines, comments = [(row, line) for row, line in lines if row >= first_row], []
    if not lines:
        raise InputError(path, "the file holds no samples", "rows of numbers")
    if header is None and delimiter is None:
        lines = _without_sections(_without_labels(lines))
    tabs = _prefers_tabs(path)
    dialect = find_dialect(lines, delimiter, decimal, prefers_tabs=tabs, where=path)
    if dialect.delimiter != "\t":  # empty cells between tabs are a row
        lines = [(row, line) for row, line in lines if line.strip()]
    lines = _with_ended_columns(lines, dialect)
    if dialect.delimiter == BLANKS:
        lines = _without_blanks_in_names(lines, dialect)
    lines, omission = _without_further_names(_without_last_marks(lines, dialect), dialect)
    remark = "; ".join(filter(None, (remark, omission)))
    skipped, above, described, pairs = 0, [], None, None
    if header is not False:
        shape = find_table([dialect.split(line) for _, line in lines[-LAST_ROWS:]], dialect)
        first = [dialect.split(line) for _, line in lines[:_PREAMBLE]]
        sample = shape.find_first_sample(first)
        if header is None and (pairs := find_pairs(first[:sample], shape)) is not None:
            described = Header([*pairs.names], pairs.units, 0)
        elif header is None:
            described = find_described(first[:sample], shape)
        skipped = shape.count_rows_above(first) if described is None else sample
        above = first[:skipped]
    lines = lines[skipped:]
    damaged = 0
    if skips_damaged:
        step = max(1, len(lines) // SAMPLE_LINES)
        shape = find_table([dialect.split(line) for _, line in lines[::step]], dialect)
        is_sample = [shape.is_complete(dialect.split(line)) for _, line in lines]
        begin = next((k for k, is_one in enumerate(is_sample) if is_one), 0)
        heading = [line for line in lines[:begin] if len(dialect.split(line[1])) == shape.width]
        samples = [line for line, is_one in zip(lines, is_sample, strict=True) if is_one]
        damaged = len(lines) - len(samples) - len(heading)
        lines = [*heading, *samples]
        if not samples:
            raise InputError(path, "no row of numbers", "rows of samples")
    return _FoundRows(lines, comments, dialect, remark, skipped, above, damaged, described, pairs)


def _lines(text: str) -> tuple[Lines, list[str]]:
    """The rows of a file, without comments and blank ones, and the comments before them."""
    lines: Lines = []
    comments: list[str] = []
    for row, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), start=1):
        if is_comment(line):
            comments += [] if lines else [comment_text(line)]
        elif line.strip() or "\t" in line:
            lines.append((row, line))
    while lines and _END.fullmatch(lines[-1][1].strip(_EMPTY)):
        lines.pop()
    for k, (row, line) in enumerate(lines[:_PREAMBLE]):
        if line.endswith(_COMMENT) and line.count("\t") > lines[-1][1].count("\t"):
            lines[k] = row, line.removesuffix(_COMMENT)
    return lines, comments


def _without_labels(lines: Lines) -> Lines:
    """Lines of labelled numbers, `pot:512 pwm:30` for a serial plotter, as a header and numbers.

    A number before the first label, as of a loop, is a column without a name.
    """

    def cells(line: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The labels of a line and its numbers; none where there is something else in it."""
        pairs = [(m[1], m[2]) for m in _LABELLED.finditer(line)]
        rest = _LABELLED.sub("", line).strip(_EMPTY)
        if pairs and NUMBER.fullmatch(rest) and line.lstrip().startswith(rest):
            pairs.insert(0, (f"{NUMBERED}1", rest))
        elif rest:
            pairs = []
        return tuple(label for label, _ in pairs), tuple(number for _, number in pairs)

    step = max(1, len(lines) // SAMPLE_LINES)
    labels = Counter(cells(line)[0] for _, line in lines[::step])
    usual, count = labels.most_common(1)[0]
    if not usual or 2 * count < labels.total():
        return lines
    rows = [(row, line, cells(line)) for row, line in lines]
    first = next(k for k, (_, _, (names, _)) in enumerate(rows) if names == usual)
    samples = [
        (row, "\t".join(numbers) if names == usual else line)
        for row, line, (names, numbers) in rows[first:]
    ]
    return [*lines[:first], (lines[first][0], "\t".join(usual)), *samples]


def _without_sections(lines: Lines) -> Lines:
    """Lines of a trace of CODESYS, which has a section for each variable, as a long table."""
    if not any(_SECTION.fullmatch(line.strip()) for _, line in lines[:_PREAMBLE]):
        return lines
    name, rows = "", list[tuple[int, str]]()
    for row, line in lines:
        if match := _SECTION.fullmatch(line.strip()):
            name = match[1]
        elif name and line.startswith(";"):
            _, time, value, *_ = (*line.split(";"), "")
            rows.append((row, f"{time};{name};{value}"))
    return [(lines[0][0], "time;signal;value"), *rows] if rows else lines


def _with_ended_columns(lines: Lines, dialect: Dialect) -> Lines:
    """Lines with empty cells where the last columns have ended before others, as slow channels."""
    mark = dialect.delimiter
    counts = [line.count(mark) for _, line in lines]
    first = max((k for k, (a, b) in enumerate(pairwise(counts), start=1) if a < b), default=0)
    rows, widest = Counter(counts[first:]), counts[first]
    if mark == BLANKS or len(rows) < 2 or min(rows.values()) < LAST_ROWS:
        return lines
    _, last = lines[first + rows[widest] - 1]
    if not all(dialect.is_number(cell) for cell in dialect.split(last) if cell):
        return lines  # lines above the table are wider
    ended = zip(lines[first:], counts[first:], strict=True)
    return [*lines[:first], *((row, line + (widest - n) * mark) for (row, line), n in ended)]


def _without_last_marks(lines: Lines, dialect: Dialect) -> Lines:
    """Lines without a mark at the end of each sample that the row of names has not."""
    cells = [dialect.split(line) for _, line in lines[:_PREAMBLE]]
    table = find_table(cells[-LAST_ROWS:], dialect)
    first = table.find_first_sample(cells)
    if not first or len(cells[first - 1]) != table.width - 1 or any(c[-1] for c in cells[first:]):
        return lines
    return [(row, line.rstrip().removesuffix(dialect.delimiter)) for row, line in lines]


def _without_further_names(lines: Lines, dialect: Dialect) -> tuple[Lines, str]:
    """Lines without the names for which there are no cells, where there are more; and a remark.

    They are the last ones, unless times rise with the first ones left out, as of a header that
    begins with the version of a format.
    """
    cells = [dialect.split(line) for _, line in lines[:_PREAMBLE]]
    table = find_table(cells[-LAST_ROWS:], dialect)
    first = table.find_first_sample(cells)
    names = cells[first - 1] if first else []
    more = len(names) - table.width
    if more < 1 or table.width < 2 or not all(names) or any(map(table.is_value, names)):
        return lines, ""
    samples = [row for row in cells[first:] if len(row) == table.width]
    clock = next((j for j, name in enumerate(names) if TIME.search(name)), 0)

    def rises(column: int) -> bool:
        values = [row[column] for row in samples] if 0 <= column < table.width else [""]
        is_number = all(map(dialect.is_number, values))
        numbers = [float(x.replace(dialect.decimal, ".")) for x in values] if is_number else [0, 0]
        return all(a < b for a, b in pairwise(numbers))

    begin = more if rises(clock - more) and not rises(clock) else 0
    kept = names[begin : begin + table.width]
    omitted = ", ".join(f"'{name}'" for name in names[:begin] + names[begin + table.width :])
    header = lines[first - 1][0], dialect.delimiter.join(kept)
    remark = f"more names than cells in a row: {omitted} left out"
    return [*lines[: first - 1], header, *lines[first:]], remark


def _without_blanks_in_names(lines: Lines, dialect: Dialect) -> Lines:
    """Lines whose header of names such as `angle (deg)`, far apart, has as many as the table."""
    width = len(dialect.split(lines[-1][1]))
    for k, (row, line) in enumerate(lines[:_PREAMBLE]):
        cells = dialect.split(line)
        if len(cells) == width and all(map(dialect.is_number, cells)):
            break
        names = re.split(r"\s{2,}|\t", line.strip())
        if len(cells) > width == len(names) > 1:
            joined = "\t".join(name.replace(" ", "_") for name in names)
            return [*lines[:k], (row, joined), *lines[k + 1 :]]
    return lines


def _is_like_others(first: Sequence[str], table: "pl.DataFrame", dialect: Dialect) -> bool:
    """Whether the first row has numbers or dates wherever most of the next rows have some."""
    rows = [_texts(table, k) for k in range(1, min(SAMPLE_LINES, len(table)))]
    numeric = find_table(rows, dialect).numeric if len(rows) >= 3 else range(len(first))
    return all(dialect.is_number(first[j]) or is_date(first[j]) for j in numeric if first[j])


def _texts(table: "pl.DataFrame", row: int) -> list[str]:
    return [(cell or "").strip() for cell in table.row(row)]


def _names_in(comments: Sequence[str], dialect: Dialect, width: int) -> list[str] | None:
    """The names of the columns in the last comment above the first sample, None without any.

    Also behind a word for them and a colon, as in `# Columns: t y u`, or in a comment for each.
    """
    comment = next(filter(None, reversed(comments)), "")
    ways = [dialect.split(comment), _announced_names(comment)]
    if dialect.delimiter == BLANKS:
        ways.insert(1, re.split(r"\s{2,}", comment))  # names of several words
    for names in ways:
        is_header = len(names) == width > 1 and all(names) and len({*names}) == width
        if is_header and not any(dialect.is_number(name) for name in names):
            return names
    return _numbered_names(comments, width)


def find_names(lines: Sequence[str], width: int) -> list[str] | None:
    """The names of some columns in lines of a text that describes them, None without any.

    In one line, as `format: t angle u`, in the head of a table in Markdown, or one each, as
    `2: angle [rad]` or `| 2 | angle | rad |`.
    """
    heads = [_cells_in_text(a) for a, b in pairwise(lines) if _RULE.fullmatch(b)]
    numbered = _numbered_names([_row_in_text(line) for line in lines], width)
    for names in (*map(_announced_names, lines), numbered or [], *heads):
        if len(names) == width > 1 and all(names) and len({*names}) == width:
            return names
    return None


def find_descriptions(lines: Sequence[str], names: Collection[str]) -> dict[str, str]:
    """Descriptions of columns by their names in lines of a text; empty where it has few.

    As ``- `d`: displacement (mm)``, `d = displacement` or `| d | displacement | mm |`.
    """
    texts: dict[str, str] = {}
    for line in lines:
        cells = _cells_in_text(line)
        if len(cells) < 2:
            plain = _LIST_MARK.sub("", line).strip()
            cells = [c.strip(_MARKUP) for c in _IS.split(plain, maxsplit=1)]
        cells = cells[cells[0].isdigit() :]
        if cells and cells[0] in names and any(cells[1:]):
            units = [cell for cell in cells[1:] if cell and is_unit(cell)]
            words = [cell for cell in cells[1:] if cell and cell not in units]
            unit = f" [{units[0]}]" if units else ""
            texts.setdefault(cells[0], (words[0] if words else "") + unit)
    return texts if len(texts) >= max(2, len(names) / 3) else {}


def _cells_in_text(line: str) -> list[str]:
    """The cells of a row of a table in Markdown."""
    return [cell.strip(_MARKUP) for cell in line.strip(" |").split("|")]


def _announced_names(line: str) -> list[str]:
    """The names behind a word for them and a colon; empty without one."""
    announced = _COLUMNS_ARE.match(line)
    return re.split(r"[\s,;]+", line[announced.end() :].strip()) if announced else []


def _row_in_text(line: str) -> str:
    """A row of a table in Markdown as a number, a name and its unit; other lines without marks."""
    number, name, unit, *_ = [*_cells_in_text(line), "", ""]
    if not (number.isdigit() and name):
        return line.strip(" \t*-#")
    return f"{number}: {name}" + (f" [{unit}]" if unit and is_unit(unit) else "")


def _numbered_names(comments: Sequence[str], width: int) -> list[str] | None:
    """Names behind the numbers of their columns, as in `# 2: angle [rad]`; None of few columns.

    What stands behind several numbers, `# 3 4 speed left, right`, is the name of each.
    """
    names: dict[int, str] = {}
    matches = [*filter(None, map(_NUMBERED_NAME.fullmatch, comments))]
    # what says that it is of a column, else of other numbers, as of chapters
    for match in [m for m in matches if m[1]] or matches:
        numbers = [int(number) for number in re.findall(r"\d+", match[2])]
        if names.keys() & {*numbers}:  # items of several lists
            return None
        names |= {n: f"{match[3]} {n}" if len(numbers) > 1 else match[3] for n in numbers}
    first = 0 if 0 in names else 1
    return labels_of_columns({n - first + 1: name for n, name in names.items()}, width)


def labels_of_columns(names: Mapping[int, str], width: int) -> list[str] | None:
    """The names of all columns by those of some, which are numbered from 1; None of few of them."""
    columns = [names.get(k, f"{NUMBERED}{k}") for k in range(1, width + 1)]
    named = sum(k in names for k in range(1, width + 1))
    return columns if named >= max(2, width / 3) and len({*columns}) == width else None


def _cells(path: Path, lines: Lines, dialect: Dialect) -> "pl.DataFrame":
    """The cells as text, a row for every line."""
    import polars as pl

    delimiter = dialect.delimiter
    if delimiter == BLANKS:
        lines, delimiter = [(row, "\t".join(line.split())) for row, line in lines], "\t"
    text = "\n".join(line for _, line in lines).encode()
    try:
        table = pl.read_csv(text, has_header=False, separator=delimiter, infer_schema=False)
        defect = None if len(table) == len(lines) else f"{len(lines)} lines make {len(table)} rows"
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        table, defect = pl.DataFrame(), f"cannot be read as text ({describe_error(error)})"
    if defect is None:
        return table
    first_row, width = lines[0][0], lines[0][1].count(delimiter) + 1
    unclosed = next((row for row, line in lines if line.count('"') % 2), None)
    counts = [(row, line.count(delimiter) + 1) for row, line in lines]
    ragged = next(((row, cells) for row, cells in counts if cells != width), None)
    if unclosed is not None:
        defect = f'row {unclosed} has a quote (") that is not closed'
    elif ragged is not None:
        defect = f"row {ragged[0]} has {ragged[1]} cells, row {first_row} has {width}"
    raise InputError(path, defect, f"rows of equal length separated by '{dialect.delimiter}'")


def _spread_lists(table: "pl.DataFrame") -> "pl.DataFrame":
    """The cells, of lists of numbers (`[1, 0]`, as Python writes them) a column for each element.

    Below the name `u` they become `u[1]`, `u[2]`.
    """
    import polars as pl

    spread: list[pl.Series] = []
    for column in table.get_columns():
        # most columns have none, as a single cell shows
        may_be_lists = (column[-1] or "").lstrip().startswith("[")
        is_list = column.str.contains(_LIST).fill_null(value=False) if may_be_lists else None
        if is_list is None or not is_list[-1] or is_list.sum() < len(column) - HEADER_ROWS:
            spread.append(column)
            continue
        elements = column.str.strip_chars("[] ").str.replace_all(r"[,;\s]+", " ").str.split(" ")
        for k in range(elements.list.len()[-1]):
            element = pl.when(is_list).then(elements.list.get(k, null_on_oob=True))
            cells = element.otherwise(column.str.strip_chars() + f"[{k + 1}]")
            spread.append(pl.select(cells.alias(f"{column.name}[{k + 1}]")).to_series())
    return pl.DataFrame(spread)


def _numbers(
    cells: "pl.Series",
    dialect: Dialect,
    path: Path,
    name: str,
    rows: Sequence[int] | Int[np.ndarray, " n"],
    *,
    has_header: bool,
) -> Column:
    """The numbers of the cells of a column; the message names its file, row and name."""
    import polars as pl

    is_plain = dialect.decimal == "." and not dialect.thousands
    numbers = cells.cast(pl.Float64, strict=False) if is_plain else pl.Series([None])
    if numbers.null_count():
        numbers = _plain(cells.str.strip_chars(), dialect).cast(pl.Float64, strict=False)
    if numbers.null_count() and HEXADECIMAL.fullmatch((cells[0] or "").strip()):
        digits = cells.str.strip_chars().str.replace("^0[xX]", "")
        numbers = digits.str.to_integer(base=16, strict=False).cast(pl.Float64)
    has_dates = len(cells) > 0 and is_date((cells[0] or "").strip())
    if has_dates and numbers.null_count():
        numbers = read_dates(cells)
    if numbers.null_count():
        if not _is_filled(cells).any():
            raise InputError(f"{path}, {name}", "empty in every row", "numbers")
        sample = int(np.flatnonzero(numbers.is_null().to_numpy())[0])
        text = (cells[sample] or "").strip()
        remedy = "correct or remove the row"
        if not (has_header or sample):
            remedy = "if the first row names the columns, set `header = true`"
        elif "," in text and not text.strip("+-0123456789.,"):
            remedy += ', or set `decimal = ","` or `"."` under [format]'
        raise InputError(
            f"{path} row {rows[sample]}, {name}",
            f"the text '{text[:40]}'" if text else "an empty cell",
            "a date or time, as in the first row" if has_dates else "a number",
            remedy,
        )
    return numbers.to_numpy()


def _is_filled(cells: "pl.Series") -> "pl.Series":
    """Which cells hold something."""
    return cells.str.strip_chars().fill_null("") != ""


def _of_pair(
    table: "pl.DataFrame",
    column: int,
    pairs: Pairs,
    path: Path,
    dialect: Dialect,
    rows: Sequence[int] | Int[np.ndarray, " n"],
) -> Column:
    """The numbers of a column of a pair, which may end before others; times in s if known."""
    cells = table.to_series(column)
    filled = np.flatnonzero(_is_filled(cells).to_numpy())
    cells = cells.head(int(filled[-1]) + 1 if len(filled) else 0)
    numbers = _numbers(cells, dialect, path, pairs.names[column], rows, has_header=True)
    return numbers if column % 2 or pairs.factor is None else numbers * pairs.factor


def _plain(cells: "pl.Series", dialect: Dialect) -> "pl.Series":
    """Numbers as Python writes them: a decimal point, exponents by e, nothing between thousands."""
    import polars as pl

    if dialect.thousands:
        grouped = cells.str.contains(dialect.thousands, literal=True)
        wrong = grouped & ~cells.str.contains(f"^(?:{dialect.grouped().pattern})$")
        cells = cells.str.replace_all(dialect.thousands, "", literal=True)
        cells = cells.set(wrong, None)
    if dialect.decimal != ".":
        wrong = cells.str.contains(".", literal=True)
        cells = cells.str.replace_all(dialect.decimal, ".", literal=True).set(wrong, None)
    cells = cells.str.replace("^\u2212", "-")  # the minus sign of typography
    return cells.str.replace("(?i)^([-+]?[0-9.]+)d([-+]?[0-9]+)$", "${1}e${2}").cast(pl.String)
