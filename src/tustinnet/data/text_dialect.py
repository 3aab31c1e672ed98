"""Dialects of text files: encoding, marks between columns and in numbers, rows of names and units.

Programs and countries write tables differently. What a file does is found from a sample of its
lines; the keys under `[format]` of a card decide instead where they are given.
"""

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tustinnet.data.text_dates import is_date
from tustinnet.data.units import ANGLE, LENGTH, TIME
from tustinnet.errors import InputError, describe_error

BLANKS = " "  # as a delimiter: any number of blanks and tabs
_DELIMITERS = (",", ";", "\t", "|", BLANKS)
HEADER_ROWS = 4  # first rows that may be names, names, units and a sample
LAST_ROWS = 5  # at the end of a table, which are samples
SAMPLE_LINES = 60  # lines at the beginning, and as many throughout the file, that are looked at
_COMMENTS = ("#", "//", "% ", "%\t", "%%")

_DIGITS = r"(\d+\.?\d*|\.\d+)"
HEXADECIMAL = re.compile(r"0x[0-9a-f]+", re.IGNORECASE)
NUMBER = re.compile(
    rf"[-+]?({_DIGITS}([ed][-+]?\d+)?|nan|inf|infinity)|{HEXADECIMAL.pattern}", re.IGNORECASE
)
_NOT_A_NUMBER = {"nan", "+nan", "-nan"}
# in any country: thousands are separated by a mark, and the other one begins the decimals
_GROUPED = (
    r"\d{1,3}(,\d{3})+(\.\d*)?|\d{1,3}(\.\d{3})+(,\d+)?"
    r"|\d{1,3}([' \u00a0\u202f]\d{3})+([.,]\d+)?"
)
_ANYWHERE = re.compile(
    rf"[-+\u2212]?(({_GROUPED}|\d+,\d+|,\d+|{_DIGITS})([ed][-+]?\d+)?|nan|inf|infinity)|{HEXADECIMAL.pattern}",
    re.IGNORECASE,
)
_MARKS = "' \u00a0\u202f"  # other marks between thousands

_UNITS = {
    *ANGLE,
    *LENGTH,
    *TIME,
    "v",
    "mv",
    "kv",
    "a",
    "ma",
    "n",
    "kn",
    "nm",
    "mnm",
    "hz",
    "khz",
    "w",
    "kw",
    "kg",
    "g",
    "pa",
    "kpa",
    "mpa",
    "bar",
    "psi",
    "k",
    "c",
    "degc",
    "ohm",
    "f",
    "j",
    "rpm",
    "%",
    "-",
    "\u00b0",
    "\u00b0c",
    "\u00b5s",
    "\u00b5m",
    "count",
    "counts",
    "ticks",
    "1",
    "bool",
    "sec",
    "min",
    "h",
    "second",
    "seconds",
    "degree",
    "degrees",
    "radian",
    "radians",
    "volt",
    "volts",
    "amp",
    "amps",
    "ampere",
    "amperes",
    "meter",
    "meters",
    "metre",
    "metres",
    "newton",
    "newtons",
    "km",
    "inch",
    "inches",
}

Lines = list[tuple[int, str]]  # rows of the file, counted from 1, and their text


@dataclass(frozen=True)
class Dialect:
    """The marks of a text file.

    Attributes:
        delimiter: mark between columns; a blank stands for any number of blanks and tabs.
        decimal: mark before the decimals of a number.
        thousands: mark between groups of three digits, empty without one.
    """

    delimiter: str
    decimal: str = "."
    thousands: str = ""

    def split(self, line: str) -> list[str]:
        """The cells of a line, without blanks and quotes around them."""
        return _split(line, self.delimiter)

    def is_number(self, cell: str) -> bool:
        """Whether a cell is a number."""
        if self.thousands:
            if self.thousands in cell and not self.grouped().fullmatch(cell):
                return False
            cell = cell.replace(self.thousands, "")
        if self.decimal != ".":
            if "." in cell:
                return False
            cell = cell.replace(self.decimal, ".")
        return NUMBER.fullmatch(cell.replace("\u2212", "-")) is not None

    def grouped(self) -> re.Pattern[str]:
        """The pattern of a number whose thousands are separated."""
        mark, point = re.escape(self.thousands), re.escape(self.decimal)
        pattern = rf"[-+\u2212]?\d{{1,3}}({mark}\d{{3}})+({point}\d*)?([eEdD][-+]?\d+)?"
        return re.compile(pattern)

    def describe(self) -> str:
        """The unusual marks of the dialect in words; empty for commas and decimal points."""
        names = {"\t": "tabs", BLANKS: "blanks", ",": ""}
        mark = names.get(self.delimiter, f"'{self.delimiter}'")
        parts = [f"separated by {mark}"] if mark else []
        parts += ["decimal comma"] if self.decimal == "," else []
        parts += [f"'{self.thousands}' between thousands"] if self.thousands else []
        return ", ".join(parts)


def decode(path: Path, encoding: str | None) -> tuple[str, str]:
    """The text of a file, and a remark on its encoding unless it is UTF-8.

    Raises:
        InputError: bytes that are no text in the encoding.
    """
    content = path.read_bytes()
    if encoding is not None:
        try:
            return content.decode(encoding), ""
        except UnicodeError as error:
            raise InputError(
                path,
                f"not a text file in {encoding} ({describe_error(error)})",
                "the encoding of the file",
                "correct `encoding` under [format], or leave it out",
            ) from None
    wide = _utf16(content)
    if wide is not None:
        text = content.decode(wide, "replace").removeprefix("\ufeff")
        if "\0" not in text and "\ufffd" not in text:
            return text, "in UTF-16"
    # a few of them are damaged rows, as of a log that lost power
    if content.count(0) > len(content) // 100 or wide is not None:
        raise InputError(
            path, "not a text file in UTF-8", "rows of numbers as text", "save it as UTF-8"
        )
    content = content.replace(b"\0", b"?")
    try:
        return content.decode("utf-8-sig"), ""
    except UnicodeDecodeError:
        return content.decode("latin-1"), "not in UTF-8, read as Latin-1"


def _utf16(content: bytes) -> str | None:
    """The order of bytes of a text in UTF-16, None of another text."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    head = content[:2000]
    even, odd = head[::2].count(0), head[1::2].count(0)
    if odd > len(head) / 4 and not even:
        return "utf-16-le"
    return "utf-16-be" if even > len(head) / 4 and not odd else None


def is_comment(line: str) -> bool:
    """Whether a line begins with a mark of comments: #, //, %% or % and a blank; or is of JSON."""
    return line.startswith(_COMMENTS) or (line.startswith("{") and line.rstrip().endswith("}"))


def comment_text(line: str) -> str:
    """A comment without its marks."""
    return line.lstrip("#/%").strip()


def find_dialect(
    lines: Lines, delimiter: str | None, decimal: str | None, *, prefers_tabs: bool, where: object
) -> Dialect:
    """The dialect of some lines.

    Args:
        lines: rows and their text.
        delimiter: mark between columns, None to find it.
        decimal: mark before the decimals, None to find it.
        prefers_tabs: whether tabs are more likely than commas.
        where: the file, for messages.

    Raises:
        InputError: numbers that mean different things in different countries.
    """
    step = max(1, len(lines) // SAMPLE_LINES)
    sample = [line for _, line in (*lines[:SAMPLE_LINES], *lines[SAMPLE_LINES::step])]
    if delimiter is None:
        candidates = ("\t", *_DELIMITERS) if prefers_tabs else _DELIMITERS
        delimiter = max(candidates, key=lambda mark: _score(sample, mark))  # the first of equals
    cells = {cell for line in sample for cell in _split(line, delimiter)}
    mark, thousands = _number_marks({c for c in cells if _ANYWHERE.fullmatch(c)}, decimal, where)
    return Dialect(delimiter, mark, thousands)


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == BLANKS:
        return [cell.strip('"') for cell in line.split()]
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]
        except (csv.Error, StopIteration):
            pass
    return [cell.strip() for cell in line.split(delimiter)]


def _score(sample: list[str], delimiter: str) -> tuple[float, bool]:
    """The score of a delimiter: rows of one length times cells that are numbers."""
    rows = [_split(line, delimiter) for line in sample]
    (width, count), *_ = Counter(map(len, rows)).most_common(1)
    cells = [cell for row in rows if len(row) == width for cell in row if cell]
    pattern = _ANYWHERE if width > 1 else NUMBER  # "1,5" alone is two columns
    numbers = sum(pattern.fullmatch(cell) is not None or is_date(cell) for cell in cells)
    return round(count / len(rows) * numbers / max(len(cells), 1), 2), width > 1


def _number_marks(cells: set[str], decimal: str | None, where: object) -> tuple[str, str]:
    """The mark before decimals and that between thousands, by cells that are numbers somewhere."""
    other = next((mark for mark in _MARKS for cell in cells if mark in cell), "")
    commas = {cell for cell in cells if "," in cell}
    points = {cell for cell in cells if "." in cell}
    if decimal is None:
        decimal = _decimal_mark(commas, points, where)
    grouping = commas if decimal == "." else points
    return decimal, ("," if decimal == "." else ".") if grouping else other


def _decimal_mark(commas: set[str], points: set[str], where: object) -> str:
    both = commas & points
    if both:
        later = {max(cell.rfind(","), cell.rfind(".")) == cell.rfind(",") for cell in both}
        if len(later) == 1:
            return "," if later.pop() else "."
    elif not commas:
        return "."
    elif not points:
        return "." if any(cell.count(",") > 1 for cell in commas) else ","
    else:
        groups_by_comma = all(re.fullmatch(r"[-+]?\d{1,3}(,\d{3})+", cell) for cell in commas)
        groups_by_point = all(re.fullmatch(r"[-+]?\d{1,3}(\.\d{3})+", cell) for cell in points)
        if groups_by_comma != groups_by_point:
            return "." if groups_by_comma else ","
    raise InputError(
        where,
        f"'{min(commas)}' and '{min(points or commas)}' do not say which mark is decimal",
        "one mark",
        'set `decimal = "."` or `","` under [format]',
    )


# --- rows of names and units ---


@dataclass(frozen=True)
class Header:
    """The names of the columns, units by name, and the number of rows that they take."""

    names: list[str]
    units: dict[str, str]
    rows: int


def read_header(rows: Sequence[Sequence[str]], dialect: Dialect) -> Header:
    """The header in the first rows of a table, the first of which has names.

    A second row of names, without numbers, makes names `motor/angle`; a row of units makes none.

    Args:
        rows: cells of the first rows, four if there are as many.
        dialect: how numbers are written.
    """
    names, units, count = [*rows[0]], {}, 1

    def is_header(k: int) -> bool:
        """Whether row k has no numbers, and the next one has some below its texts."""
        if k + 1 >= len(rows) or any(dialect.is_number(cell) for cell in rows[k]):
            return False
        pairs = zip(rows[k], rows[k + 1], strict=False)
        return any(text and dialect.is_number(below) for text, below in pairs)

    is_second = len(rows) > 1 and not any(dialect.is_number(c) for c in rows[1]) and any(rows[1])
    if is_second and (is_header(1) or is_header(2)) and not _are_units(rows[1]):
        filled = ""
        for j, (upper, lower) in enumerate(zip(rows[0], rows[1], strict=False)):
            filled = upper or filled
            names[j] = f"{filled}/{lower}" if filled and lower else lower or upper
        count = 2
    if is_header(count) and _are_units(rows[count]):
        # a name that is doubled is refused later
        units = {
            n: unit.strip("[]() ") for n, unit in zip(names, rows[count], strict=False) if unit
        }
        count += 1
    return Header(
        names, {name: unit for name, unit in units.items() if unit not in ("", "-")}, count
    )


@dataclass(frozen=True)
class Table:
    """The shape of the samples of a table.

    Attributes:
        width: number of cells of a row.
        numeric: columns that are numbers or dates, counted from 0.
        dialect: how numbers are written.
    """

    width: int
    numeric: tuple[int, ...]
    dialect: Dialect

    def is_value(self, cell: str) -> bool:
        """Whether a cell is a number or a date."""
        return self.dialect.is_number(cell) or is_date(cell)

    def is_sample(self, row: Sequence[str], *, is_whole: bool = False) -> bool:
        """Whether a row has numbers where the others have some; if `is_whole`, in every column."""
        cells = self._cells(row)
        if is_whole:
            return bool(cells) and all(map(self.is_value, cells))
        return any(cells) and all(not cell or self.is_value(cell) for cell in cells)

    def is_complete(self, row: Sequence[str]) -> bool:
        """Whether a row has a finite number, or a date, in every column of numbers."""
        lacks_some = any(cell.lower() in _NOT_A_NUMBER for cell in self._cells(row))
        return self.is_sample(row, is_whole=True) and not lacks_some

    def _cells(self, row: Sequence[str]) -> list[str]:
        """The cells of a row in the columns of numbers; empty where it has another length."""
        return [row[j] for j in self.numeric] if len(row) == self.width else []

    def is_remark(self, row: Sequence[str]) -> bool:
        """Whether only the first cells have texts: a title, or a setting and its value."""
        filled = [j for j, cell in enumerate(row) if cell]
        if len(row) != self.width or not filled:
            return True
        return self.width > 2 and filled[-1] < (2 if self.width > 3 else 1)

    def find_first_sample(self, rows: Sequence[Sequence[str]]) -> int:
        """The first row that is a sample; 0 without one."""
        return next((k for k, row in enumerate(rows) if self.is_sample(row)), 0)

    def count_rows_above(self, rows: Sequence[Sequence[str]]) -> int:
        """The number of rows above the header: titles and settings of a measurement.

        Args:
            rows: the first rows of the file.

        Returns:
            The number; 0 where no header is found, so that a message names what does not fit.
        """
        top = sample = self.find_first_sample(rows)
        while top > 0 and not self.is_remark(rows[top - 1]):
            has_values = any(map(self.is_value, rows[top - 1]))
            # above a row of units also names such as 1 and 2, of channels
            is_named = (
                top == sample - 1
                and _are_units(rows[top])
                and not self.is_sample(rows[top - 1], is_whole=True)
            )
            if top < sample and has_values and not is_named:
                break
            top -= 1
        return 0 if top == sample else top


def find_table(rows: Sequence[Sequence[str]], dialect: Dialect) -> Table:
    """The shape of a table by some rows, most of which are samples."""
    width = Counter(map(len, rows)).most_common(1)[0][0]
    samples = [row for row in rows if len(row) == width]
    table = Table(width, tuple(range(width)), dialect)
    numeric = [
        j for j in range(width) if 2 * sum(table.is_value(row[j]) for row in samples) > len(samples)
    ]
    return Table(width, tuple(numeric), dialect)


def find_units_above(rows: Sequence[Sequence[str]], names: Sequence[str]) -> dict[str, str]:
    """Units by name, from a row above the header that begins with a word such as `Y_Unit_Label`."""
    for row in rows:
        is_labelled = len(row) == len(names) > 1 and re.search(r"(?i)unit|einheit", row[0])
        if is_labelled and any(row[1:]) and _are_units(row[1:]):
            pairs = zip(names[1:], row[1:], strict=True)
            return {name: unit.strip("[]() ") for name, unit in pairs if unit and unit != "-"}
    return {}


def find_units_in_comments(comments: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Units by name, from comments of a name and its unit, as `# angle: rad`."""
    pairs = [comment.strip().partition(":") for comment in comments]
    units = {name.strip(): text.strip() for name, colon, text in pairs if colon and text.strip()}
    return {name: text for name, text in units.items() if name in names and is_unit(text)}


def _are_units(cells: Sequence[str]) -> bool:
    """Whether most cells of a row are units of measurement."""
    texts = [cell for cell in cells if cell]
    return sum(map(is_unit, texts)) * 2 > len(texts)


def is_unit(text: str) -> bool:
    """Whether a text is a unit of measurement, or in brackets."""
    if re.fullmatch(r"\[.*\]|\(.*\)", text):
        return True
    parts = re.split(r"[/*\u00b7\s^]+|(?<=\w)-?[1-9]$", text.strip().lower())
    return len(text) <= 20 and all(part in _UNITS for part in parts if part)
