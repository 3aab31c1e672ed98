"""Folders of identifications: the model, its parameters with errors, what was found.

folder/model.safetensors   the model
folder/summary.json        parameters, errors, correlations, findings, scores
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tustinnet.artifact.files import require_new, require_writable_folder, to_json, write_atomically
from tustinnet.artifact.model_file import data_header, save, scores_header
from tustinnet.artifact.run import MODEL, SUMMARY
from tustinnet.data.dataset import DataSet
from tustinnet.evaluation.free_run import Score
from tustinnet.identification.result import Identification


def require_free_folder(folder: Path, *, overwrite: bool) -> None:
    """Raises unless a folder can be written and holds no earlier model."""
    require_new([folder / MODEL, folder / SUMMARY], overwrite=overwrite)
    require_writable_folder(folder)


def write_identification(
    folder: Path,
    data: DataSet,
    result: Identification,
    judged: str,
    start: str,
    scores: Sequence[Score],
) -> dict[str, Any]:
    """Writes model and summary of an identification; returns the summary.

    Args:
        folder: where to.
        data: the records it was made from.
        result: the identification.
        judged: the split whose free runs judge it.
        start: where these start.
        scores: the scores of these free runs.
    """
    header = identification_header(data, result, judged, start, scores)
    save(result.model, folder / MODEL, **header)
    summary = {"system": result.system.name, **header}
    write_atomically(folder / SUMMARY, to_json(summary))
    return summary


def identification_header(
    data: DataSet, result: Identification, judged: str, start: str, scores: Sequence[Score]
) -> dict[str, Any]:
    """What a model file and a summary say of an identification."""
    return {
        "identification": {
            "outcome": result.outcome,
            "converged": result.converged,
            "findings": list(result.findings),
            "trust": result.trust,
            "condition": result.condition,
            "initial": result.initial,
            "iterations": result.iterations,
            "substeps": result.substeps,
            "seconds": result.seconds,
            "estimates": [dataclasses.asdict(e) for e in result.estimates],
            "held": dict(result.held),
            "correlation": result.correlation.tolist(),
            "residual_rmse": dict(result.rmse),
            "residual_autocorrelation": list(result.autocorrelation),
            "initial_states": {name: list(x) for name, x in result.initial_states.items()},
        },
        "data": data_header(data),
        "scores": scores_header(data, judged, start, scores),
    }
