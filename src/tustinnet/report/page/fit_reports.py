"""Reports that are written after a fit: the new model on some of the records that score it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tustinnet.data.experiment import Experiment
from tustinnet.fits.run import Run
from tustinnet.report.page.reported_model import ReportedModel, read_reported_models
from tustinnet.report.page.write import ReportOptions, write_page
from tustinnet.report.shown_records import choose_shown_records
from tustinnet.selection.choice import Choice
from tustinnet.store.run_folder import MODEL, REPORT


def write_run_report(run: Run, command: str) -> Path:
    """Writes the report of a run's best model on the validation, else the training records.

    Args:
        run: the run, with its files written.
        command: command that writes a report of all these records.
    """
    best, folder = run.best, run.folder
    models = read_reported_models([folder / MODEL], [best.result.model])
    scored_models = [replace(m, scores=best.scores) for m in models]
    return write_scored_report(scored_models, run.roles.ranking, folder / REPORT, command)


def write_scored_report(
    models: Sequence[ReportedModel],
    records: Sequence[Experiment],
    path: Path,
    command: str = "",
) -> Path:
    """Writes a report of models that are scored already, on some of their records.

    Args:
        models: the models, each with the scores of its free runs of all records.
        records: the records.
        path: the file.
        command: command that writes a report of all of them.
    """
    scores = models[0].scores
    shown_names = choose_shown_records({score.experiment: score.rmse for score in scores})
    shown_models = [
        replace(m, scores=[s for s in m.scores if s.experiment in shown_names]) for m in models
    ]
    options = ReportOptions(
        scores[0].start, scores[0].horizon, command=command, total_records=len(records)
    )
    return write_page(shown_models, [e for e in records if e.name in shown_names], path, options)


def write_choice_report(choice: Choice, command: str) -> Path:
    """Writes the report of a selection's chosen model, on some of the scored records.

    Args:
        choice: the choice, with its files written.
        command: command that writes a report of all these records.
    """
    folder, result = choice.context.folder, choice.result(choice.best)
    rmse = result.rmse()
    shown_names = choose_shown_records(rmse)
    options = ReportOptions(
        result.start, choice.context.scoring.horizon, command=command, total_records=len(rmse)
    )
    models = read_reported_models([folder / MODEL], [choice.model])
    records = [e for e in choice.context.data if e.name in shown_names]
    return write_page(models, records, folder / REPORT, options)
