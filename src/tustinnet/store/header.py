"""The header of a model file, read and checked without its model.

Whatever is read from a header is declared here, or by the family as its `description`, and is
checked when the file is read. A header that passes can be used by every verb as it is.
"""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from tustinnet.channels import ColumnUnit
from tustinnet.data.declaration import declare
from tustinnet.data.experiment import Experiment
from tustinnet.data.fingerprint import FINGERPRINT, is_among
from tustinnet.errors import InputError, convert_errors
from tustinnet.families.descriptions import Entries, check_description
from tustinnet.registry import FAMILIES
from tustinnet.store.sealed import read_sealed

ORIGIN = "from"  # in headers: the model that a fit began with
_LARGEST_NUMBER = 1e150  # of a number: its square is finite

Number = Annotated[float, Field(ge=-_LARGEST_NUMBER, le=_LARGEST_NUMBER)]
Size = Annotated[float, Field(ge=0, le=_LARGEST_NUMBER)]
Positive = Annotated[float, Field(gt=0, le=_LARGEST_NUMBER)]
Duration = Annotated[float, Field(gt=0, le=1e12)]
Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=-1 - 1e-6, le=1 + 1e-6)]
Interval = tuple[Number, Number]


class _Exact(Entries):
    """A table with no further keys."""

    model_config = ConfigDict(extra="forbid")


class _Estimate(_Exact):
    """An identified parameter, see `fitting.report.Estimate`."""

    name: str
    unit: str
    value: Number
    error: Size | None
    naive_error: Size | None
    interval: Interval | None
    lower: Number
    upper: Number
    bound: Literal["", "lower", "upper"]
    is_informed: bool

    @model_validator(mode="after")
    def _check_range(self) -> "_Estimate":
        if not self.lower < self.upper:
            raise ValueError("`lower` is not below `upper`")
        return self


class _Stretch(_Exact):
    """Samples that weigh little, see `fitting.report.Stretch`."""

    record: str
    begin: Number
    end: Number
    weight: Number


class _Finding(Entries):
    """A finding in a header, see `finding.Finding.as_plain`."""

    code: str
    text: str


class _Refit(Entries):
    """A second fit of parameters, see `fitting.report.Refit`."""

    values: dict[str, Number] = Field(default_factory=dict)


class _ForceError(Entries):
    """The missing force at a coordinate, see `fitting.report.ForceError`."""

    cutoff: Positive


class _Identification(Entries):
    """An identification, see `fitting.report.Identification.as_plain`."""

    estimates: list[_Estimate]
    correlation: list[list[Share | None]]
    fixed: dict[str, Number]
    trust: str
    outcome: str = ""
    residual_rmse: dict[str, Size | None] = Field(default_factory=dict)
    downweighted: list[_Stretch] = Field(default_factory=list)
    force_errors: list[_ForceError] = Field(default_factory=list)
    refined: _Refit | None = None

    @model_validator(mode="after")
    def _check_sizes(self) -> "_Identification":
        n = len(self.estimates)
        if [len(row) for row in self.correlation] != [n] * n:
            raise ValueError(f"`correlation` is not of {n} by {n}, as there are estimates")
        if len({e.name for e in self.estimates}) < n:
            raise ValueError("two estimates of one name")
        return self


class _Training(Entries):
    """A training, see `fitting.report.FitResult.details`."""

    seed: int | None = None
    outcome: str = ""
    windows: list[Count] = Field(default_factory=list)
    epochs: list[Count] = Field(default_factory=list)
    kept_epoch: Count | None = None


class _Recipe(Entries):
    """The recipe of a fit; its reader checks the rest."""

    name: str


class _Record(Entries):
    """A record that a model was made from."""

    name: str
    sha256: str
    split: str | None
    source: str
    rows: Annotated[list[Count], Field(min_length=2, max_length=2)]
    groups: dict[str, str] = Field(default_factory=dict)
    fingerprint: str = Field(pattern=FINGERPRINT)


class _Data(Entries):
    """The records that a model was made from."""

    name: str
    records: list[_Record]
    quanta: list[Positive]
    columns: dict[str, tuple[str, Positive]]


class _Origin(Entries):
    """The model that a fit began with."""

    file: str
    sha256: str
    made_from: dict[str, str]


class _Selection(Entries):
    """The selection that a model was chosen by."""

    plan: str
    chosen: str


class _Sources(Entries):
    """Sources of a model: what it was made from."""

    data: _Data | None = None
    files: list["_File"] = Field(default_factory=list)
    origin: _Origin | None = Field(default=None, alias=ORIGIN)
    selection: _Selection | None = None

    @model_validator(mode="after")
    def _check_tables(self) -> Self:
        for name in type(self).model_fields.keys() & self.model_fields_set:
            if getattr(self, name) is None:
                raise ValueError(f"`{ORIGIN if name == 'origin' else name}` is null; no such key")
        return self


class _File(_Sources):
    """A model that a committee was made from."""

    file: str
    sha256: str


class _Support(Entries):
    """The points that came together in records, see `simulate.range.TrainingSupport`."""

    points: list[list[Number]] = Field(min_length=1)
    spread: list[Positive]
    reach: Positive


class _Range(Entries):
    """The range of records, see `simulate.range.Range`.

    Internal states of a model that diverged along its records are no numbers.
    """

    states: list[tuple[Number | None, Number | None]]
    inputs: list[Interval]
    cloud: _Support | None = None
    recorded_states: list[list[Number]] | None = Field(default=None, min_length=1)

    @model_validator(mode="after")
    def _check_order(self) -> "_Range":
        for low, high in (*self.states, *self.inputs):
            if low is not None and high is not None and low > high:
                raise ValueError("a smallest value above the largest")
        return self


class _Band(Entries):
    """The band of a coordinate, see `evaluate.bands.Part`."""

    floor: Positive
    factors: list[Size] = Field(min_length=1)
    records: list[Size] = Field(min_length=1)
    unit: Positive


class _Bands(Entries):
    """Bands, see `evaluate.bands.Calibration`."""

    start: str
    horizon: Duration | None
    records: list[str] = Field(min_length=1)
    moving: list[_Band]
    resting: list[_Band]

    @model_validator(mode="after")
    def _check_records(self) -> "_Bands":
        if any(len(b.records) != len(self.records) for b in (*self.moving, *self.resting)):
            raise ValueError(f"bands of another number than the {len(self.records)} records")
        return self


class Judgement(Entries):
    """The free runs by which a model was judged when it was fitted.

    Attributes:
        start: where they started.
        horizon: how long each lasted at most [s], None for whole records.
        split: split of the records; `left out` of a selection, whose folds left them out.
    """

    start: str = ""
    horizon: Duration | None = None
    split: str = ""


class _Reference(Entries):
    """The trivial predictor, and the median share of its error that the model's is."""

    predictor: str
    share: Size | None


class _Scores(Judgement):
    """The scores of a model; those that are not finite are None."""

    unit: str = ""
    rmse: dict[str, Size | None] = Field(default_factory=dict)
    mean: Size | None = None
    mean_by_unit: dict[str, Size | None] | None = None
    standard_error: Size | None = None
    reference: _Reference | None = None


class _SpoiledPart(Entries):
    """A part of a record that spoils a fit, see `data.spoiled.SpoiledPart`."""

    sentence: str


class _Spoiled(Entries):
    """The parts of records that spoil a fit, and findings on those that it left out."""

    parts: list[_SpoiledPart] = Field(default_factory=list)
    left_out: list[_Finding] = Field(default_factory=list)


class _Copy(Entries):
    """The copy of a system file that a run keeps."""

    file: str
    sha256: str


class _Header(_Sources):
    """The entries of a header beside the description of its model; further keys are allowed."""

    format: int = Field(ge=1)
    versions: dict[str, str] = Field(default_factory=dict)
    recipe: _Recipe | None = None
    training: _Training | None = None
    findings: list[_Finding] = Field(default_factory=list)
    identification: _Identification | None = None
    range: _Range | None = None
    scores: _Scores | None = None
    bands: _Bands | None = None
    spoiled: _Spoiled | None = None
    system_copy: _Copy | None = None


def check_header(header: Mapping[str, Any], where: object) -> None:
    """Raises unless the header of a model file can be used as it is, by every verb.

    Args:
        header: the header.
        where: the file.

    Raises:
        InputError: an entry that is missing, of another type, out of range, or of another size
            than the model's channels.
    """
    check_description(header, where)
    content = declare(dict(header), _Header, where, strict=True)
    n_q = len(header["coordinates"])
    for name in ("moving", "resting"):
        bands = [] if content.bands is None else getattr(content.bands, name)
        if content.bands is not None and len(bands) != n_q:
            raise InputError(
                f"{where}, bands.{name}", f"{len(bands)} bands", f"{n_q}, one for each coordinate"
            )


def judgement_in_header(header: Mapping[str, Any]) -> Judgement | None:
    """The free runs by which the model of a file was judged, None where the file says none."""
    scores = header.get("scores", {})
    if "start" not in scores:
        return None
    return Judgement(**{key: scores[key] for key in Judgement.model_fields if key in scores})


def doubt_in_header(header: Mapping[str, Any]) -> str:
    """Why the free runs of a file's model speak against it; "" where they do not."""
    reference = header.get("scores", {}).get("reference")
    share = reference and reference["share"]
    if reference is None or (share is not None and share < 1):
        return ""
    how_far = (
        "diverges"
        if share is None
        else f"is {share:.3g} times as far off as {reference['predictor']}"
    )
    return f"its model {how_far}, on half of the records that judged it or more"


def cutoff_in_header(header: Mapping[str, Any]) -> float | None:
    """The frequency up to which the fit of a file's model compared forces [Hz]; None for none."""
    errors = header.get("identification", {}).get("force_errors", ())
    return next((e["cutoff"] for e in errors), None)


def read_header(path: str | Path) -> dict[str, Any]:
    """The JSON header of a model file.

    Args:
        path: the file.

    Raises:
        InputError: as `load_model`.
    """
    return read_header_and_arrays(Path(path))[0]


def read_header_and_arrays(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a model file, the header as `check_header` has it.

    Raises:
        InputError: as `load_model`.
    """
    header, arrays = read_sealed(path, FAMILIES.names())
    check_header(header, path)
    return header, arrays


def read_description(path: str | Path) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """The header of a model file, and the description of the model by its family.

    Raises:
        InputError: as `load_model`.
    """
    header, arrays = read_header_and_arrays(Path(path))
    with convert_errors(path, "header and arrays do not fit", "a file written by tustinnet"):
        return header, FAMILIES[header["kind"]].summarise(header, arrays)


def columns_in_header(header: Mapping[str, Any]) -> dict[str, ColumnUnit]:
    """The units of the columns of the records that a model was made from, by coordinate."""
    columns: dict[str, ColumnUnit] = {}
    for part in (*header.get("files", ()), header):
        entries = part.get("data", {}).get("columns", {})
        columns |= {name: ColumnUnit(*entry) for name, entry in entries.items()}
    return columns


def records_in_header(header: Mapping[str, Any]) -> dict[str, str]:
    """The records that a model was made from: names by checksum.

    A fit trains with the records of `train`, a selection with all but those of `test`; a committee
    was made from the records of all its parts.
    """
    records = {r["sha256"]: r["name"] for r in _fitted_entries(header) if r["sha256"]}
    for part in header.get("files", ()):
        records |= records_in_header(part)
    return records | header.get(ORIGIN, {}).get("made_from", {})


def find_fitted(header: Mapping[str, Any], records: Iterable[Experiment]) -> list[str]:
    """Names of the records that a model was made from, among some.

    A record is one of them where it shares rows of an identical file, or where its samples are
    those of a copy: with other times, line ends or digits, or a part of it. Of records that a model
    was made from which the fit began with, the whole file counts.

    Args:
        header: the header of the model's file.
        records: the records.
    """
    fingerprints = _fingerprints(header)
    return [
        e.name
        for e in records
        if _shares_rows(e, header)
        or any(is_among(e, texts, quanta) for quanta, texts in fingerprints.items())
    ]


def _shares_rows(experiment: Experiment, header: Mapping[str, Any]) -> bool:
    """Whether a record is of a file that a model was made from, and of rows of it that were."""
    first, stop = experiment.logged_rows
    element = experiment.name.partition("[")[2]
    rows = [
        r["rows"]
        for r in _fitted_entries(header)
        # elements of a MAT file are other arrays
        if (r["sha256"], r["name"].partition("[")[2]) == (experiment.sha256, element)
    ]
    if experiment.sha256 in header.get(ORIGIN, {}).get("made_from", {}):
        rows.append((0, math.inf))
    return bool(experiment.sha256) and (
        any(first < end and begin < stop for begin, end in rows)
        or any(_shares_rows(experiment, part) for part in header.get("files", ()))
    )


def _fitted_entries(header: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The entries of a header on records that its model was fitted to, without its parts."""
    listed = header.get("data", {}).get("records", ())
    if "selection" in header:
        return [r for r in listed if r.get("split") != "test"]
    return [r for r in listed if r.get("split") == "train"]


def _fingerprints(header: Mapping[str, Any]) -> dict[tuple[float, ...], list[str]]:
    """Different fingerprints of the records that a model was made from, by their units."""
    fingerprints: dict[tuple[float, ...], list[str]] = {}
    for part in (header, *header.get("files", ())):
        quanta = tuple(part.get("data", {}).get("quanta", ()))
        texts = [text for r in _fitted_entries(part) if (text := r.get("fingerprint"))]
        if texts and quanta:
            merged = dict.fromkeys([*fingerprints.get(quanta, ()), *texts])
            fingerprints[quanta] = list(merged)
    return fingerprints
