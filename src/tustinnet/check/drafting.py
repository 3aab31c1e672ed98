"""Drafts of data cards for folders of logs; the motion decides scales that nothing else says."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from tustinnet.check.scale_of_angles import find_scale_of_angles
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card
from tustinnet.data.declaration import declare, parse_toml
from tustinnet.data.drafting.draft import (
    ANSWERED,
    PERIOD,
    Draft,
    draft_examined,
    examine_logs,
)
from tustinnet.data.drafting.files import list_logs
from tustinnet.data.drafting.system_columns import SystemChannels
from tustinnet.data.loading import load_folder
from tustinnet.errors import InputError

_QUESTIONS = {"unit": "unit", "counts_per_revolution": "counts"}  # of drafts, by keys of a card


def draft(
    logs: str | Path,
    answers: Mapping[str, str] | None = None,
    *,
    system: SystemChannels | None = None,
) -> Draft:
    """Drafts the data card of a folder of logs, as `tustinnet init --yes` does; writes nothing.

    Args:
        logs: the folder, or one of its files.
        answers: answers to questions of an earlier draft, by their keys, as
            `{"role servo_deg": "input"}`.
        system: coordinates and inputs that the card has to have; by default those that the columns
            show.

    Returns:
        The draft: the card is its `text`, the reasons and margins of all columns are in
        `columns`, and `questions` says what was assumed.

    Raises:
        InputError: there are no logs, or none has a column that could be a position; an answer to
            no question, or one that a card cannot have.
    """
    folder, files = list_logs([Path(logs)])
    made = draft_files(folder, files, answers, system=system)
    made.require_readable(folder)
    keys = {PERIOD, *(f"{what} {c.name}" for what in ANSWERED for c in made.columns)}
    if unknown := [key for key in answers or {} if key not in keys]:
        expected = ", ".join([f"'{what} COLUMN'" for what in ANSWERED])
        raise InputError("answers", f"an answer to '{unknown[0]}'", f"{expected}, '{PERIOD}'")
    declare(parse_toml(made.text), Card, "answers" if answers else folder)
    return made


def draft_files(
    folder: Path,
    files: Sequence[str],
    answers: Mapping[str, str] | None = None,
    *,
    system: SystemChannels | None = None,
) -> Draft:
    """The draft for some files of a folder, which may have no coordinates.

    Args:
        folder: the folder of the card.
        files: the logs, below it.
        answers: as those of `draft`.
        system: as that of `draft`.
    """
    examination = examine_logs(folder, files, answers)
    made = draft_examined(examination, system=system)
    by_motion = find_scales(made, folder)
    return draft_examined(examination, by_motion, system=system) if by_motion else made


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
        for scale in (evidence.scales if evidence else ())
        if names[scale.index] in assumed and scale.key in assumed[names[scale.index]].assumed
    }
