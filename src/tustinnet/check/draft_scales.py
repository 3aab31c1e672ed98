"""Scales of angles that a draft of a card assumed, and that the motion of the records shows."""

from pathlib import Path

from tustinnet.check.scale_of_angles import find_scale_of_angles
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card
from tustinnet.data.declaration import declare, parse_toml
from tustinnet.data.drafting.draft import Draft
from tustinnet.data.loading import load_folder
from tustinnet.errors import InputError

_QUESTIONS = {"unit": "unit", "counts_per_revolution": "counts"}  # of drafts, by keys of a card


def find_scales(draft: Draft, folder: Path) -> dict[str, str]:
    """Units and counts in a turn that gravity shows in the records, where a draft assumed others.

    Args:
        draft: the draft.
        folder: the folder of the logs.

    Returns:
        Answers to questions of the draft, by their keys, as `draft_examined` takes them.
    """
    assumed = {c.name: c for c in draft.choice.coordinates if c.assumed and c.kind == "angular"}
    if not assumed or not draft.is_readable:
        return {}
    card = declare(parse_toml(draft.text), Card, folder)
    try:
        records = load_folder(folder, card, on_message=lambda _: None)
    except InputError:  # which the caller meets when it reads the records itself
        return {}
    names = [c.name for c in card.coordinates]
    views = [RecordView(e.without_controller(), card) for e in records]
    evidence = find_scale_of_angles(views)
    return {
        f"{_QUESTIONS[scale.key]} {assumed[names[scale.index]].column}": scale.value
        for scale in (evidence.scales if evidence and evidence.is_clear else ())
        if names[scale.index] in assumed and scale.key in assumed[names[scale.index]].assumed
    }
