"""The report of the table's models: the most accurate ones on the records of the table."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tustinnet.data.experiment import Experiment
from tustinnet.report.page.fit_reports import write_scored_report
from tustinnet.report.page.reported_model import Subject, read_reported_models
from tustinnet.report.page.write import MOST
from tustinnet.reproduce.figures import median_rows
from tustinnet.reproduce.table1 import START, Row


def reported(rows: Sequence[Row]) -> list[Row]:
    """The models that the report has room for, the most accurate first.

    Of several seeds the one in the middle; of models that start otherwise than the table none, as
    all free runs of a page start alike.
    """
    alike = [row for row in median_rows(rows).values() if row.start == START]
    return sorted(alike or list(rows)[:1], key=lambda row: row.mean)[:MOST]


def write_rows_report(
    rows: Sequence[Row], records: Sequence[Experiment], path: Path, command: str
) -> Path:
    """Writes the report.

    Args:
        rows: see `reported`.
        records: those of the table.
        path: the file.
        command: what writes a report of those that are in files.
    """
    return write_scored_report([_subject(row) for row in rows], records, path, command)


def _subject(row: Row) -> Subject:
    if row.file is None:
        return Subject(row.model, row.what, scores=row.scores)
    (found,) = read_reported_models([row.file], [row.what])
    return replace(found, label=row.model, scores=row.scores)
