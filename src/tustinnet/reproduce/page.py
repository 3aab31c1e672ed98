"""The report of Table 1: the most accurate models on the records of the table."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tustinnet.data.experiment import Experiment
from tustinnet.report.page.fit_reports import write_scored_report
from tustinnet.report.page.reported_model import ReportedModel, read_reported_models
from tustinnet.report.page.write import MAX_MODELS
from tustinnet.reproduce.figures import median_rows
from tustinnet.reproduce.table1 import START, Row


def choose_reported_rows(rows: Sequence[Row]) -> list[Row]:
    """Chooses the rows that the report has room for, the most accurate first.

    Of several seeds it takes the median. Models with another start than the table are left out,
    as all free runs of a page have the same start.
    """
    same_start = [row for row in median_rows(rows).values() if row.start == START]
    return sorted(same_start or list(rows)[:1], key=lambda row: row.mean)[:MAX_MODELS]


def write_rows_report(
    rows: Sequence[Row], records: Sequence[Experiment], path: Path, command: str
) -> Path:
    """Writes the report of rows of the table.

    Args:
        rows: the rows, see `choose_reported_rows`.
        records: the records of the table.
        path: the file.
        command: command that writes a report of those models that are in files.
    """
    models = []
    for row in rows:
        if row.file is None:
            models.append(ReportedModel(row.name, row.model, scores=row.scores))
        else:
            (reported,) = read_reported_models([row.file], [row.model])
            models.append(replace(reported, label=row.name, scores=row.scores))
    return write_scored_report(models, records, path, command)
