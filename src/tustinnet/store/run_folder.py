"""Folders of runs: the files that a fit or a selection leaves there, and those of earlier ones.

folder/model.safetensors              the model, of several members the best one's
folder/summary.json                   the account: every member and the spread
folder/question.json                  the specification: recipe, records, system
folder/system.py, .urdf or .xml       a copy of the system's file, where one was given
folder/report.html                    the page of it, written by the command when all else is there
folder/log.jsonl                      of identifications: one line an iteration and a stage
folder/seed-0/model.safetensors       of trainings: the best weights of that seed
folder/seed-0/log.jsonl               one line an epoch
folder/seed-0/checkpoint.safetensors  for `resume`, of all members that train together

Members whose rates have a factor have folders like seed-0-rate-0.5.
"""

import json
import math
from contextlib import suppress
from pathlib import Path
from typing import Literal

from tustinnet.errors import InputError
from tustinnet.store.files import remove_below, require_outputs
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.log import DAMAGED, LOG
from tustinnet.store.specification import (
    SPECIFICATION,
    Specification,
    require_same_specification,
)

MODEL = "model.safetensors"
SUMMARY = "summary.json"
REPORT = "report.html"  # written by rooms above this one; discarded here with the rest
FIGURES = "figures"  # drawn by rooms above this one
SCORES = "scores.json"  # of a job of a selection
BASE_PARAMETERS = "base_parameters.csv"  # of an identification by inverse dynamics
TABLE = "candidates.md"  # of a selection
CHECKPOINT = "checkpoint.safetensors"
OWN = (MODEL, SUMMARY, LOG, REPORT, SPECIFICATION, TABLE, BASE_PARAMETERS)  # in a run's folder
WRITTEN = (MODEL, LOG, DAMAGED, CHECKPOINT)  # into the folder of a member

Earlier = Literal["refuse", "resume", "discard"]  # the treatment of a run that is there


def prepare_run_folder(
    folder: Path, earlier: Earlier, specification: Specification, *, resumable: bool
) -> None:
    """Refuses, discards or keeps the files of an earlier run in a folder."""
    if earlier == "resume" and not resumable:
        raise InputError(
            "`resume=`", "a fit that is no training is not resumed", "a training", "leave it out"
        )
    if earlier == "resume":
        require_same_specification(folder, specification, MODEL)
        (folder / REPORT).unlink(missing_ok=True)  # of the model as it was
        return
    places = _find_seed_folders(folder)
    if earlier == "discard":
        discard_results(folder)
    elif places:
        raise InputError(
            folder,
            f"holds an earlier run ({places[0].name}, ...)",
            "a new folder",
            "add `resume=` to go on with it, `overwrite=` to discard it, or choose another folder",
        )
    files = [folder / name for name in (MODEL, SUMMARY, BASE_PARAMETERS, LOG, REPORT, FIGURES)]
    require_outputs(files, overwrite=earlier == "discard")


def find_rivals(model: Path, *, as_good: bool = False) -> list[Path]:
    """The model files of the other candidates of the selection that chose a model.

    Of those only that follow the records better than a trivial predictor, or, if they are to be
    `as_good`, at most twice as far off as the chosen one. None of other models.
    """
    folder = model.parent
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        means = {
            candidate["name"]: next(iter(candidate["starts"].values()))["mean"]
            for candidate in summary["candidates"]
            if candidate.get("starts")
        }
        most = 2 * means[summary["best"]] if as_good else summary["reference"]["mean"]
        return [
            folder / file
            for candidate in summary["candidates"]
            if candidate["name"] != summary["best"]
            if means.get(candidate["name"], math.inf) < most
            for file in candidate["models"]
            if (folder / file).is_file()
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return []  # no selection, or an account that is damaged


def _find_seed_folders(folder: Path) -> list[Path]:
    """The folders of the members of a training in the folder of a run."""
    return sorted(place for place in folder.glob("seed-*") if (place / LOG).exists())


def discard_results(folder: Path) -> None:
    """Removes the files that a run or a selection has written into a folder, and no others."""
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        starts = [s for c in summary.get("candidates", []) for s in c.get("starts", {}).values()]
        records = {record for start in starts for record in start["rmse"]}
        records |= {record for seed in summary.get("seeds", []) for record in seed["rmse"]}
        drawn = {f"{name}.png" for name in (CANDIDATES, "training", "correlation", *records)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        drawn = set[str]()  # nobody knows which figures are its own
    remove_below(folder / FIGURES, drawn)
    remove_below(folder / CANDIDATES, {*WRITTEN, SCORES})
    for place in _find_seed_folders(folder):
        remove_below(place, WRITTEN)
        with suppress(OSError):  # other files are in it
            place.rmdir()
    for name in OWN:
        (folder / name).unlink(missing_ok=True)
