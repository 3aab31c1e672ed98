"""The records that a model is judged on, for the verbs that judge."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tustinnet.data.experiment import Experiment


def judged_records(
    data: str, card: Path | None, split: str | None, start: str | None
) -> "tuple[list[Experiment], str]":
    """The records of a split, or all, and where their free runs start."""
    from tustinnet.data.catalog import load
    from tustinnet.simulation.initial_state import default_start

    loaded = load(data, card)
    records = list(loaded.split(split) if split else loaded)
    return records, start or default_start(records)
