"""Keys of the data card that were assumed, because nothing in the logs says them."""

from collections.abc import Iterator, Sequence

import numpy as np

from tustinnet.check.card_lines import coordinate_line, input_line, time_line, top_line
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card, CoordinateCard, InputCard, JoinCard, TimeCard
from tustinnet.finding import Finding

ASSUMED = "assumed"  # name of the check
_WORDS = {"counts_per_revolution": "counts in a turn", "dt": "sampling period [s]"}
_DELETE = "correct what is wrong, then delete the line `assumed`"


def assumed_keys(views: Sequence[RecordView], card: Card) -> Iterator[Finding]:
    """Units, kinds, scales and periods of a card that its key `assumed` names."""
    for owner, block, mend, evidence in _tables(views, card):
        column = str(getattr(block, "column", ""))
        if "starts_together" in block.assumed:
            yield Finding("assumed together", {}, "note", mend, channel=owner, column=column)
        keys = [key for key in block.assumed if key != "starts_together"]
        if not keys:
            continue
        entries = [getattr(block, key) for key in keys]
        is_one = len(keys) == 1 and "counts_per_revolution" not in keys
        values = {
            "keys": [_WORDS.get(key, key) for key in keys],
            "owner": "the times" if block is card.time else owner,
            "verb": "was" if is_one else "were",
            "values": [e if isinstance(e, str) else f"{e:.6g}" for e in entries],
            "evidence": evidence,
        }
        yield Finding(ASSUMED, values, "note", mend, channel=owner, column=column)


def _tables(
    views: Sequence[RecordView], card: Card
) -> Iterator[tuple[str, Card | TimeCard | JoinCard | CoordinateCard | InputCard, str, str]]:
    """Tables of a card: their channels, blocks, lines to delete, and what their keys lead to."""
    yield "", card, top_line(_DELETE), f"samples {card.dt} s apart; no file has times"
    if card.time is not None:
        seconds = sum(view.experiment.seconds for view in views)
        yield "", card.time, time_line(_DELETE), f"the records then last {seconds:.4g} s together"
    for label, join in card.join.items():
        times = f"the times of its files are in {join.unit}"
        yield label, join, f"under [join.{label}]: {_DELETE}", times
    first = views[0].experiment
    for j, c in enumerate(card.coordinates):
        extent = _range_text([v.experiment.q[:, j] for v in views], first.coordinates[j].unit)
        yield c.name, c, coordinate_line(c.name, _DELETE), extent
    for k, i in enumerate(card.inputs):
        extent = _range_text([v.experiment.u[:, k] for v in views], i.unit)
        yield i.name, i, input_line(i.name, _DELETE), extent


def _range_text(columns: Sequence[np.ndarray], unit: str) -> str:
    """The range of a channel in all records."""
    low, high = min(c.min() for c in columns), max(c.max() for c in columns)
    range_text = f"from {low:.4g} to {high:.4g} {unit if unit != '1' else ''}".rstrip()
    return f"nothing in the logs says it; {range_text}"
