"""The check of records: all findings about them, the most severe first."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from tustinnet.check import in_record
from tustinnet.check.assumed import assumed_keys
from tustinnet.check.between_records import compare_records
from tustinnet.check.between_splits import copies, overlapping_rows
from tustinnet.check.excitation import same_sensors, still_inputs
from tustinnet.check.scale_of_angles import scale_of_angles
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card
from tustinnet.data.experiment import Experiment
from tustinnet.finding import Finding, merge_findings, sort_findings

# findings in a record that explain all that records show against one another
_EXPLAINS = {"fast angle", "counter", "dead sensor", "spike"}


def check(
    records: Iterable[Experiment] | Experiment, card: Card | None = None
) -> tuple[Finding, ...]:
    """Finds what is wrong with records before a model is fitted to them.

    Args:
        records: records of one machine, of the same channels, or one.
        card: their data card, which the remedies speak of; None for records from arrays.

    Returns:
        Findings, the severe ones first, those of equal text merged.
    """
    records = [records] if isinstance(records, Experiment) else records
    return check_views([view_record(e, card) for e in records])


def view_record(e: Experiment, card: Card | None = None) -> RecordView:
    """The view of a record, with the inputs of its system where they were recorded."""
    return RecordView(e.without_controller() if e.outputs is not None else e, card)


@np.errstate(all="ignore")  # numbers of damaged records overflow; they are findings, too
def check_views(views: Sequence[RecordView]) -> tuple[Finding, ...]:
    """Finds what is wrong with records of one machine that have one card, as `check` does."""
    if not views:
        return ()
    findings = [f for view in views for look in in_record.CHECKS for f in look(view)]
    findings += [] if views[0].card is None else [*assumed_keys(views, views[0].card)]
    findings += [*_check_together(views, findings)]
    return sort_findings(merge_findings(findings))


def _check_together(views: Sequence[RecordView], alone: Sequence[Finding]) -> Iterator[Finding]:
    """Runs the checks that need several records, or all of them."""
    yield from overlapping_rows(views)
    yield from copies(views)
    still = list(still_inputs(views))
    yield from still
    yield from same_sensors(views)
    broken = {name for f in alone if f.code in _EXPLAINS for name in f.records}
    sound = [v for v in views if v.experiment.name not in broken]
    if len(sound) < max(1, len(views) / 2):
        return
    scales = list(scale_of_angles(sound))
    yield from scales
    # without its input, or in another unit, nothing can be asked of the motion
    if scales or still:
        return
    yield from compare_records(sound)
