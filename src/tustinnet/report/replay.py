"""Tables and sentences on logs that a controller was played along."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tustinnet.control.estimator import FilterConsistency
from tustinnet.control.replaying import Replay
from tustinnet.report.tables import Table
from tustinnet.wording import counted


def replay_table(replays: Sequence[Replay]) -> Table:
    """Differences of the inputs of records from those that the controller commands."""
    inputs = replays[0].record.inputs
    rows = []
    for one in replays:
        differs, size = (np.sqrt(np.mean(u**2, axis=0)) for u in (one.difference, one.record.u))
        largest = np.abs(one.difference).max(axis=0)
        columns = zip(size, differs, largest, one.disturbance, strict=True)
        numbers = [f"{value:.3g}" for column in columns for value in column]
        rows.append([one.record.name, *numbers, str(one.late), str(one.unused)])
    titles = [
        f"{i.name} {what}"
        for i in inputs
        for what in ("logged", "differs", "at most", "disturbance")
    ]
    return Table(
        ["record", *titles, "late", "unused"],
        rows,
        title="Inputs of the logs beside those of the controller (RMS, largest), in their units",
    )


def replay_sentences(replays: Sequence[Replay], consistency: FilterConsistency) -> list[str]:
    """Sentences on the replays of records."""
    lines = []
    if foreign := sum(one.is_foreign for one in replays):
        lines.append(
            f"inputs of {foreign} of {counted(len(replays), 'record')} differ from this "
            "controller's by more than half of their size: another controller made them, or none"
        )
    if late := {one.late for one in replays if not one.is_foreign} - {0}:
        most = counted(max(late), "sample")
        lines.append(
            f"inputs stand up to {most} later in the logs than the controller commands them: "
            "shifted columns, or a computer that is late (`delay=`)"
        )
    lost = sum(int(not np.isfinite(one.estimates).all()) for one in replays)
    if lost:
        lines.append(f"the estimator lost the state in {counted(lost, 'record')}")
    return [*lines, *(f"estimator: {line}" for line in consistency.sentences)]


def summarise(replays: Sequence[Replay], consistency: FilterConsistency) -> dict[str, Any]:
    """Replays as plain values."""
    names = [i.name for i in replays[0].record.inputs]
    return {
        "records": [
            {
                "name": one.record.name,
                "late": one.late,
                "foreign": one.is_foreign,
                "unused": one.unused,
                "inputs": {
                    name: {
                        "size": float(np.sqrt(np.mean(one.record.u[:, j] ** 2))),
                        "difference": float(np.sqrt(np.mean(one.difference[:, j] ** 2))),
                        "largest_difference": float(np.abs(one.difference[:, j]).max()),
                        "disturbance": float(one.disturbance[j]),
                    }
                    for j, name in enumerate(names)
                },
            }
            for one in replays
        ],
        "estimator": list(consistency.sentences),
    }
