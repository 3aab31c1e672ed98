"""The header of a model file, read without its model: no JAX is loaded for it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, Field

from tustinnet.channels import LONGEST_DT, Coordinate, Input
from tustinnet.data.declaration import Declaration, declare
from tustinnet.errors import convert_errors
from tustinnet.families.summaries import summarise
from tustinnet.registry import FAMILIES
from tustinnet.store.sealed import read_sealed

ORIGIN = "from"  # in headers: the model that a fit began with


class _Header(Declaration):
    """The keys in the header of every model file; the rest is its family's, and the fit's."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)

    format: int
    kind: str
    coordinates: list[Coordinate] = Field(min_length=1)
    inputs: list[Input]
    dt: float = Field(ge=0, le=LONGEST_DT)
    versions: dict[str, str] = Field(default_factory=dict)


class Judgement(Declaration):
    """The free runs by which a model was judged when it was fitted.

    Attributes:
        start: where they started.
        horizon: how long each lasted at most [s], None for whole records.
        split: split of the records; `left out` of a selection, whose folds left them out.
    """

    start: str
    horizon: float | None = Field(default=None, gt=0)
    split: str = ""


def judgement_in_header(header: Mapping[str, Any], path: str | Path) -> Judgement | None:
    """The free runs by which the model of a file was judged, None where the file says none.

    Raises:
        InputError: the file says something else there.
    """
    scores = header.get("scores")
    if not isinstance(scores, dict) or "start" not in scores:
        return None
    content = {key: scores[key] for key in Judgement.model_fields if key in scores}
    return declare(content, Judgement, f"{path}, scores")


def read_header(path: str | Path) -> dict[str, Any]:
    """The JSON header of a model file.

    Args:
        path: the file.

    Raises:
        InputError: as `load_model`.
    """
    return read_header_and_arrays(Path(path))[0]


def read_header_and_arrays(path: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a model file, the header as `_Header` has it.

    Raises:
        InputError: as `load_model`.
    """
    header, arrays = read_sealed(path, FAMILIES.names())
    declare(header, _Header, path)
    return header, arrays


def read_description(path: str | Path) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """The header of a model file, and the description of the model by its family.

    Raises:
        InputError: as `load_model`.
    """
    header, arrays = read_header_and_arrays(Path(path))
    with convert_errors(path, "header and arrays do not fit", "a file written by tustinnet"):
        return header, summarise(header, arrays)


def records_in_header(header: Mapping[str, Any]) -> dict[str, str]:
    """The records that a model was made from: names by checksum.

    A fit trains with the records of `train`, a selection with all but those of `test`; a committee
    was made from the records of all its parts.
    """
    listed = header.get("data", {}).get("records", ())
    selected = "selection" in header
    records = {
        record["sha256"]: record["name"]
        for record in listed
        if record["sha256"]
        and (record["split"] != "test" if selected else record["split"] == "train")
    }
    for part in header.get("files", ()):
        records |= records_in_header(part)
    return records | header.get(ORIGIN, {}).get("made_from", {})
