"""The check of records: all findings about them, the most severe first."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from tustinnet.check import between_splits, excitation, in_record
from tustinnet.check.assumed import assumed_keys
from tustinnet.check.between_records import compare_records
from tustinnet.check.scale_of_angles import scale_of_angles
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card
from tustinnet.data.experiment import Experiment
from tustinnet.finding import Finding, merge_findings, sort_findings

# findings in a record that explain all that records show against one another
_EXPLAINS = {"fast angle", "counter", "dead sensor"}


def check(records: Iterable[Experiment], card: Card | None = None) -> tuple[Finding, ...]:
    """Finds what is wrong with records before a model is fitted to them.

    Args:
        records: records of one machine, of the same channels.
        card: their data card, which the remedies speak of; None for records from arrays.

    Returns:
        Findings, the severe ones first, those of equal text merged.
    """
    views = [RecordView(_without_controller(e), card) for e in records]
    if not views:
        return ()
    findings = [f for view in views for f in check_view(view)]
    findings += [] if card is None else [*assumed_keys(views, card)]
    with np.errstate(all="ignore"):  # as in `check_view`; a generator would leave it at once
        findings += [*_check_together(views, findings)]
    return sort_findings(merge_findings(findings))


def _without_controller(e: Experiment) -> Experiment:
    """The record with the inputs of its system, where they were recorded."""
    return e.without_controller() if e.outputs is not None else e


def check_record(experiment: Experiment, card: Card | None = None) -> tuple[Finding, ...]:
    """Finds what is wrong with a record by itself.

    Args:
        experiment: the record.
        card: its data card, if it has one.
    """
    return sort_findings(check_view(RecordView(_without_controller(experiment), card)))


@np.errstate(all="ignore")  # numbers of damaged records overflow; they are findings, too
def check_view(view: RecordView) -> list[Finding]:
    """Runs the checks of a single record."""
    return [finding for look in in_record.CHECKS for finding in look(view)]


def _check_together(views: Sequence[RecordView], alone: Sequence[Finding]) -> Iterator[Finding]:
    """Runs the checks that need several records, or all of them."""
    for look in between_splits.CHECKS:
        yield from look(views)
    excited = [f for look in excitation.CHECKS for f in look(views)]
    yield from excited
    broken = {(f.channel, name) for f in alone if f.code in _EXPLAINS for name in f.records}
    sound = [v for v in views if not any(name == v.experiment.name for _, name in broken)]
    if len(sound) < max(1, len(views) / 2):
        return
    scales = list(scale_of_angles(sound))
    yield from scales
    # without its input, or in another unit, nothing can be asked of the motion
    if scales or any(f.code == "still input" for f in excited):
        return
    yield from compare_records(sound)
