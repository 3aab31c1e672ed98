"""The report that a fit leaves beside its models: on some of the records that judge them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tustinnet.data.experiment import Experiment
from tustinnet.report.page.subject import Subject, subjects_of
from tustinnet.report.page.write import Asked, written
from tustinnet.report.some import some_of
from tustinnet.selection.choice import Choice
from tustinnet.store.run import MODEL, REPORT, Run


def report_of_run(run: Run, command: str) -> Path:
    """The best model of a run on the validation records; without any on those that trained it.

    Args:
        run: the run, its files are written.
        command: what writes a report of all these records.
    """
    best, folder = run.best, run.folder
    subjects = subjects_of([folder / MODEL], [best.result.model])
    scored = [replace(of, scores=best.scores) for of in subjects]
    return report_of_scored(scored, run.roles.judging, folder / REPORT, command)


def report_of_scored(
    scored: Sequence[Subject], records: Sequence[Experiment], path: Path, command: str = ""
) -> Path:
    """A report of models whose free runs are known, on some of their records.

    Args:
        scored: the models, each with its free runs of all records.
        records: the records.
        path: the file.
        command: what writes a report of all of them.
    """
    first = scored[0].scores
    shown = some_of({score.experiment: score.rmse for score in first})
    subjects = [
        replace(of, scores=[s for s in of.scores if s.experiment in shown]) for of in scored
    ]
    asked = Asked(first[0].start, first[0].horizon, command=command, whole=len(records))
    return written(subjects, [e for e in records if e.name in shown], path, asked)


def report_of_choice(choice: Choice, command: str) -> Path:
    """The chosen model on records that it was made from: folds leave no others.

    Args:
        choice: the choice, its files are written.
        command: what writes a report of all these records.
    """
    folder, result = choice.context.folder, choice.result(choice.best)
    rmse = result.rmse()
    shown = some_of(rmse)
    records = [e for e in choice.context.data if e.name in shown]
    asked = Asked(
        result.starts[0], choice.context.scoring.horizon, command=command, whole=len(rmse)
    )  # fmt: skip
    subjects = subjects_of([folder / MODEL], [choice.model])
    return written(subjects, records, folder / REPORT, asked)
