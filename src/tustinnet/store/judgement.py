"""Free runs by which models in files were judged: the defaults of those that come after."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import KEY, Calibration
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.start_rules import StoredStart, start_named
from tustinnet.store.header import judgement_in_header


def usual_split(data: DataSet) -> str | None:
    """The split whose records are simulated by default: test, else validation; else None for all.

    Args:
        data: the records.
    """
    return next((split for split in ("test", "validation") if split in data.splits), None)


def judged_free_runs(
    headers: Mapping[Path, Mapping[str, Any]],
    records: Sequence[Experiment],
    *,
    has_bands: bool = False,
) -> tuple[str | None, float | None]:
    """Start and horizon [s] by which files say that models were judged, or with bands calibrated.

    None where files say none or others, where no record or none without velocities can start so,
    or none is longer.

    Args:
        headers: the headers of the model files, by file.
        records: the records that are simulated.
        has_bands: whether the calibration of the models counts, where there is one.

    Raises:
        InputError: a file says something else there.
    """
    judged = [
        Calibration.from_header(dict(header), path)
        if has_bands and KEY in header
        else judgement_in_header(header)
        for path, header in headers.items()
    ]
    starts, horizons = ({getattr(j, key, None) for j in judged} for key in ("start", "horizon"))
    start = starts.pop() if len(starts) == 1 else None
    horizon = horizons.pop() if len(horizons) == 1 else None
    rule = start_named(start) if start else None
    lacks_velocities = isinstance(rule, StoredStart) and any(e.v is None for e in records)
    if rule is None or lacks_velocities or all(len(e) < rule.samples for e in records):
        start = None
    return start, effective_horizon(horizon, records)
