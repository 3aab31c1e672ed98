"""Keys of the data card that were assumed, because nothing in the logs says them."""

from collections.abc import Iterator, Sequence

import numpy as np

from tustinnet.check.card_lines import coordinate_line, input_line, time_line, top_line
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card, TimeCard
from tustinnet.data.declaration import Declaration
from tustinnet.finding import Finding

ASSUMED = "assumed"  # name of the check
_WORDS = {"counts_per_revolution": "counts in a turn", "dt": "sampling period [s]"}
_DELETE = "correct what is wrong, then delete the line `assumed`"


def assumed_keys(views: Sequence[RecordView], card: Card) -> Iterator[Finding]:
    """Units, kinds, scales and periods of a card that its key `assumed` names."""
    first = views[0].experiment
    if card.assumed:
        size = f"samples {card.dt:.4g} s apart; no file has times"
        yield _finding("", card, card.assumed, size, top_line(_DELETE))
    if card.time is not None and card.time.assumed:
        seconds = sum(view.experiment.seconds for view in views)
        size = f"the records then last {seconds:.4g} s together"
        yield _finding("", card.time, card.time.assumed, size, time_line(_DELETE))
    for label, join in card.join.items():
        mend = f"under [join.{label}]: {_DELETE}"
        if "unit" in join.assumed:
            size = f"the times of its files are in {join.unit}"
            yield _finding(label, join, ("unit",), size, mend)
        if "starts_together" in join.assumed:
            yield Finding(
                "assumed together", {}, "note", mend, channel=label, column=str(join.column)
            )
    for j, c in enumerate(card.coordinates):
        if c.assumed:
            size = _range_text([v.experiment.q[:, j] for v in views], first.coordinates[j].unit)
            yield _finding(c.name, c, c.assumed, size, coordinate_line(c.name, _DELETE))
    for k, i in enumerate(card.inputs):
        if i.assumed:
            size = _range_text([v.experiment.u[:, k] for v in views], i.unit)
            yield _finding(i.name, i, i.assumed, size, input_line(i.name, _DELETE))


def _finding(
    channel: str, block: Declaration, keys: Sequence[str], size: str, mend: str
) -> Finding:
    """The finding about the assumed keys of one table of the card."""
    entries = [getattr(block, key) for key in keys]
    values = {
        "keys": [_WORDS.get(key, key) for key in keys],
        "owner": channel or ("the times" if isinstance(block, TimeCard) else ""),
        "verb": "was" if len(keys) == 1 and "counts_per_revolution" not in keys else "were",
        "values": [e if isinstance(e, str) else f"{e:.6g}" for e in entries],
        "evidence": size,
    }
    column = str(getattr(block, "column", ""))
    return Finding(ASSUMED, values, "note", mend, channel=channel, column=column)


def _range_text(columns: Sequence[np.ndarray], unit: str) -> str:
    """The range of a channel in all records."""
    low, high = min(c.min() for c in columns), max(c.max() for c in columns)
    range_text = f"from {low:.4g} to {high:.4g} {unit if unit != '1' else ''}".rstrip()
    return f"nothing in the logs says it; {range_text}"
