"""Inspection of a single file of columns without a card: guesses, and the draft of a card."""

from dataclasses import dataclass
from pathlib import Path

from tustinnet.data.drafting.draft import draft_card
from tustinnet.data.drafting.evidence import Role


@dataclass(frozen=True)
class ColumnReport:
    """The result of an inspection of one column.

    Attributes:
        name: name of the column.
        role: its probable meaning.
        range: smallest and largest finite value.
        distinct: number of different values.
        count: the step of its values, where it is quantised as an encoder is.
        remark: a few words on the guess.
        unit: the unit that its name or its numbers say, empty without one.
    """

    name: str
    role: Role
    range: tuple[float, float] | None = None
    distinct: int = 0
    count: float | None = None
    remark: str = ""
    unit: str = ""


@dataclass(frozen=True)
class FileReport:
    """The result of an inspection of a file of columns.

    Attributes:
        name: the file's name.
        rows: number of samples.
        dt: period [s], where there is a column of times.
        jitter: largest deviation of an interval from it [s], gaps aside.
        time_unit: the unit of the times, guessed.
        columns: a report for each column.
        notes: remarks on how the file was read.
        draft: a data card to start from, in TOML.
    """

    name: str
    rows: int
    dt: float | None
    jitter: float | None
    time_unit: str
    columns: tuple[ColumnReport, ...]
    notes: tuple[str, ...]
    draft: str


def inspect_file(path: Path) -> FileReport:
    """Inspects a file that no card describes; everything but the numbers is a guess.

    Args:
        path: the file.

    Raises:
        InputError: the file cannot be read, or has no column of numbers.
    """
    draft = draft_card(path.parent, [path.name], name=path.stem, has_splits=False)
    columns = [
        ColumnReport(
            c.name,
            c.role,
            c.numbers.range,
            c.numbers.distinct,
            c.numbers.count if c.role == "position" else None,
            c.because,
            c.unit,
        )
        for c in draft.columns
    ]
    columns += [ColumnReport(name, "no numbers", remark=text) for name, text in draft.texts.items()]
    has_clock = draft.clock.column is not None
    return FileReport(
        name=path.name,
        rows=draft.rows,
        dt=draft.dt if has_clock else None,
        jitter=draft.clock.worst if has_clock else None,
        time_unit=draft.clock.unit,
        columns=tuple(columns),
        notes=draft.notes,
        draft=draft.text,
    )
