"""Free runs that verbs compute: records, start, horizon and bands."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tustinnet as tn
from tustinnet.cli import terminal
from tustinnet.cli.completion import ALL
from tustinnet.cli.records import leave_out_short, records_of_split
from tustinnet.errors import InputError
from tustinnet.evaluate import bands
from tustinnet.evaluate import scores as scoring
from tustinnet.simulate import starts
from tustinnet.simulate.start_names import DERIVED
from tustinnet.store import header as file_header
from tustinnet.store import judgement

_MAX_NAMED = 6  # records that a note names


@dataclass(frozen=True)
class FreeRunRequest:
    """The free runs that a verb computes.

    Attributes:
        records: the records.
        split: name of their split, or `all`.
        start: where the free runs start.
        horizon: how long each lasts at most [s], None for whole records.
        fitted: names of the records that one of the models was fitted to.
        notes: sentences on defaults that were used, and on records that were fitted to.
    """

    records: "list[tn.Experiment]"
    split: str
    start: str
    horizon: float | None
    fitted: list[str]
    notes: list[str]

    def as_plain(self) -> dict[str, Any]:
        """Split, start, horizon and the names of fitted records as plain values."""
        return {
            "split": self.split,
            "start": self.start,
            "horizon": self.horizon,
            "fitted_to": self.fitted,
        }

    def print_notes(self) -> None:
        """Prints the notes, a line each."""
        for note in self.notes:
            terminal.messages().print(f"note: {note}")


def choose_free_runs(
    data: "tn.DataSet",
    models: "Mapping[Path, tn.Model]",
    split: str | None,
    start: str | None,
    horizon: float | None,
    *,
    names: Sequence[str] = (),
    has_bands: bool = False,
) -> FreeRunRequest:
    """Chooses records, start and horizon of free runs: as given, else as the models were judged.

    Args:
        data: the records.
        models: the models that simulate them, by file.
        split: the split, None for the usual one: test, else validation, else all.
        start: name of the start, None for that of the files where they agree, else the usual one.
        horizon: longest duration [s], infinite for whole records, None for that of the files where
            they agree, else whole records.
        names: some of the records, () for all; others that are too short for the start are left
            out with a message.
        has_bands: whether start and horizon are by default those of the models' calibration.
    """
    headers = {path: tn.read_header(path) for path in models}
    defaults = []
    if split is None and not names:
        split = judgement.usual_split(data) or ALL
        defaults.append(f"{split} records (--split)")
    selected = records_of_split(data, split)
    records = [selected[name] for name in names] if names else list(selected)
    file_start, file_horizon = judgement.judged_free_runs(headers, records, has_bands=has_bands)
    if start is None and file_start is not None:
        defaults.append(f"start '{file_start}' as in the model's file (--start)")
    start = file_start if start is None else start
    if start is None:
        usual = [e for e in records if len(e) >= DERIVED.usual_samples] or records
        start = starts.default_start(usual, *models.values())
        if len(models) > 1:
            defaults.append(f"start '{start}', as the models' files name no common one (--start)")
    if horizon is None and file_horizon is not None:
        defaults.append(f"segments of {file_horizon:g} s as in the model's file (--horizon)")
    horizon = file_horizon if horizon is None else None if horizon == math.inf else horizon
    records = leave_out_short(records, start, names)
    notes = [f"default: {', '.join(defaults)}"] if defaults else []
    used = {
        name for header in headers.values() for name in file_header.find_fitted(header, records)
    }
    fitted = [e.name for e in records if e.name in used]
    if fitted:
        count = "all records" if len(fitted) == len(records) else f"{len(fitted)} of the records"
        more = ", ..." if len(fitted) > _MAX_NAMED else ""
        named = ", ".join(fitted[:_MAX_NAMED]) + more
        notes.append(f"fitted to {count}, whose scores are optimistic: {named}")
    return FreeRunRequest(records, split or ALL, start, horizon, fitted, notes)


def compute_bands(
    path: Path,
    model: "tn.Model",
    records: "Sequence[tn.Experiment]",
    scores: "Sequence[scoring.Score]",
    band_options: "bands.BandOptions",
) -> "list[bands.Band]":
    """Computes the bands around the free runs of a model in a file, by its calibration."""
    header = tn.read_header(path)
    others = bands.find_alternatives(model, header, path)
    calibration = bands.Calibration.from_header(header, path)
    return bands.make_bands(calibration, band_options, model, others, records, scores)


def make_band_options(level: float | None, *, whole: bool) -> "bands.BandOptions | None":
    """Makes the options of bands from `--band` and `--whole-records`; None without bands."""
    if level is None:
        if whole:
            raise InputError("--whole-records", "no band", "a band", "add --band LEVEL")
        return None
    bands.require_share(level)
    return bands.BandOptions(level, "record" if whole else "time")
