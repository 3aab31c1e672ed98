"""Keys of the data card that were assumed, because nothing in the logs says them."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tustinnet.check.card_lines import coordinate_line, input_line, time_line, top_line
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card, CoordinateCard, InputCard, JoinCard, TimeCard
from tustinnet.finding import Finding

ASSUMED = "assumed"  # name of the check
_WORDS = {"counts_per_revolution": "counts in a turn", "dt": "sampling period [s]"}
_SILENT = "nothing in the logs says it"
_DELETE = "correct what is wrong, then delete the line `assumed`"


class _Assumption(NamedTuple):
    """A table of a card and what is assumed in it.

    Attributes:
        owner: its channel, empty for the times and the card itself.
        block: the table.
        mend: the line to delete.
        evidence: what the assumed values lead to.
        keys: the keys.
        texts: their values.
    """

    owner: str
    block: Card | TimeCard | JoinCard | CoordinateCard | InputCard
    mend: str
    evidence: str
    keys: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()


def assumed_keys(views: Sequence[RecordView], card: Card) -> Iterator[Finding]:
    """Units, kinds, scales and periods of a card that its key `assumed` names.

    Channels of which the same is assumed are in one finding.
    """
    alike: dict[tuple[str, ...], list[_Assumption]] = {}
    for table in _tables(views, card):
        if "starts_together" in table.block.assumed:
            column = str(getattr(table.block, "column", ""))
            owner, mend = table.owner, table.mend
            yield Finding("assumed together", {}, "note", mend, channel=owner, column=column)
        keys = [key for key in table.block.assumed if key != "starts_together"]
        entries = [getattr(table.block, key) for key in keys]
        texts = [e if isinstance(e, str) else f"{e:.6g}" for e in entries]
        if keys:
            alike.setdefault((*keys, *texts, type(table.block).__name__), []).append(
                table._replace(keys=tuple(keys), texts=tuple(texts))
            )
    for first, *others in alike.values():
        owners = ["the times" if t.block is card.time else t.owner for t in (first, *others)]
        is_one = len(first.keys) == 1 and "counts_per_revolution" not in first.keys
        values = {
            "keys": [_WORDS.get(key, key) for key in first.keys],
            "owner": [owner for owner in owners if owner],
            "verb": "was" if is_one else "were",
            "values": list(first.texts),
            "evidence": _SILENT if others else first.evidence,
        }
        mend = f"under each of them: {_DELETE}" if others else first.mend
        column = "" if others else str(getattr(first.block, "column", ""))
        channel = "" if others else first.owner
        yield Finding(ASSUMED, values, "note", mend, channel=channel, column=column)


def _tables(views: Sequence[RecordView], card: Card) -> Iterator[_Assumption]:
    """The tables of a card."""
    dt = f"samples {card.dt} s apart; no file has times"
    yield _Assumption("", card, top_line(_DELETE), dt)
    if card.time is not None:
        seconds = sum(view.experiment.seconds for view in views)
        lasts = f"the records then last {seconds:.4g} s together"
        yield _Assumption("", card.time, time_line(_DELETE), lasts)
    for label, join in card.join.items():
        times = f"the times of its files are in {join.unit}"
        yield _Assumption(label, join, f"under [join.{label}]: {_DELETE}", times)
    first = views[0].experiment
    for j, c in enumerate(card.coordinates):
        extent = _range_text([v.experiment.q[:, j] for v in views], first.coordinates[j].unit)
        yield _Assumption(c.name, c, coordinate_line(c.name, _DELETE), extent)
    for k, i in enumerate(card.inputs):
        extent = _range_text([v.experiment.u[:, k] for v in views], i.unit)
        yield _Assumption(i.name, i, input_line(i.name, _DELETE), extent)


def _range_text(columns: Sequence[np.ndarray], unit: str) -> str:
    """The range of a channel in all records."""
    low, high = min(c.min() for c in columns), max(c.max() for c in columns)
    range_text = f"from {low:.4g} to {high:.4g} {unit if unit != '1' else ''}".rstrip()
    return f"{_SILENT}; {range_text}"
