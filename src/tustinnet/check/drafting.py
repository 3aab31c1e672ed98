"""Drafts of data cards for folders of logs; the motion decides scales that nothing else says."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from tustinnet.check.draft_scales import find_scales
from tustinnet.data.drafting.draft import Draft, draft_examined, examine_logs
from tustinnet.data.drafting.files import list_logs
from tustinnet.data.drafting.system_columns import SystemChannels


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
        InputError: there are no logs, or none has a column that could be a position.
    """
    folder, files = list_logs([Path(logs)])
    made = draft_files(folder, files, answers, system=system)
    made.require_readable(folder)
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
