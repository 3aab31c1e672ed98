"""Scales of angles that a draft of a card assumed, and that the motion of the records shows."""

import re
from pathlib import Path

from tustinnet.check.check import check_records
from tustinnet.data.card import Card
from tustinnet.data.declaration import declare, parse_toml
from tustinnet.data.drafting.draft import Draft
from tustinnet.data.loading import load_folder
from tustinnet.errors import InputError

_UNIT = re.compile(r'unit = "(deg|rad)"$')
_COUNTS = re.compile(r"counts_per_revolution = ([\d.]+)$")


def find_scales(draft: Draft, folder: Path, *, follow_links: bool = False) -> dict[str, str]:
    """Units and counts in a turn that gravity shows in the records, where a draft assumed others.

    Args:
        draft: the draft.
        folder: the folder of the logs.
        follow_links: whether links to files outside of the folder are read.

    Returns:
        Answers to questions of the draft, by their keys, as `draft_card` takes them.
    """
    assumed = {c.name: c for c in draft.choice.coordinates if c.assumed and c.kind == "angular"}
    if not assumed or not draft.is_readable:
        return {}
    card = declare(parse_toml(draft.text), Card, folder)
    try:
        records = load_folder(folder, card, on_message=lambda _: None, follow_links=follow_links)
    except InputError:  # which the caller meets when it reads the records itself
        return {}
    scales: dict[str, str] = {}
    for finding in check_records(records, card):
        coordinate = assumed.get(finding.channel)
        if finding.check != "angle unit" or coordinate is None:
            continue
        if "unit" in coordinate.assumed and (match := _UNIT.search(finding.remedy)):
            scales[f"unit {coordinate.column}"] = match[1]
        counts_match = _COUNTS.search(finding.remedy)
        if "counts_per_revolution" in coordinate.assumed and counts_match:
            scales[f"counts {coordinate.column}"] = counts_match[1]
    return scales
