"""Model files that are made of model files: committees, and models with bands."""

import math
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.bands import KEY, Calibration, calibrate_bands, find_alternatives, predict
from tustinnet.families.committee import Committee, Weights, committee
from tustinnet.models.contract import Model
from tustinnet.simulate import range as training_ranges
from tustinnet.simulate.starts import default_start
from tustinnet.store import kept_system
from tustinnet.store.checkpoint import model_digest
from tustinnet.store.files import require_outputs
from tustinnet.store.header import find_fitted, read_header
from tustinnet.store.judgement import judged_free_runs
from tustinnet.store.model_file import ENDINGS, copy_with_header, load_model, load_models, save
from tustinnet.systems.files import AnySystem, SystemFile, find_system


def save_committee(
    models: Sequence[str | Path],
    file: str | Path,
    weights: Weights | None = None,
    *,
    system: str | Path | None = None,
    overwrite: bool = False,
) -> Committee:
    """Combines the models of several files into one that averages their accelerations.

    The new file names the files of its members and their records, so that scores on these count as
    optimistic. See `committee` for models that are in memory.

    Args:
        models: the model files, of any kinds with the same channels.
        file: the file for the new model (.safetensors).
        weights: weight of each model in the average; all equal by default.
        system: the system of the members that have one, its name or its file. By default the copy
            that is stored with them.
        overwrite: whether a file that is there may be replaced.

    Returns:
        The new model.

    Raises:
        InputError: one model twice, models with different system files; see also `committee` and
            `load_model`.
    """
    paths, file = [Path(path) for path in models], Path(file)
    require_outputs([file], overwrite=overwrite, read=paths, endings=ENDINGS)
    shared = _find_shared_system(paths) if system is None else find_system(system)
    members = load_models(paths, [] if shared is None else [shared], lambda path: None)
    _require_different(paths, members)
    system_file = shared if isinstance(shared, SystemFile) else None
    kept_system.require_copy_fits(system_file, file.parent, [file])
    headers = [read_header(path) for path in paths]
    sources: list[dict[str, Any]] = []
    for path, header in zip(paths, headers, strict=True):
        data = {} if header.get("data") is None else {"data": header["data"]}
        sources.append({"file": str(path), "sha256": sha256(path.read_bytes()).hexdigest(), **data})
    content: dict[str, Any] = {"files": sources}
    # the range of the training data is known where all members have one
    ranges = [
        training_ranges.Range.from_header(header, member)
        for header, member in zip(headers, members, strict=True)
    ]
    complete = [part for part in ranges if part is not None]
    combined = committee(members, weights)
    if len(complete) == len(ranges):
        joined = training_ranges.join_ranges(complete, combined.channels)
        content[training_ranges.KEY] = joined.as_header()
    save(combined, file, **content, **kept_system.system_header(system_file))
    if system_file is not None:
        kept_system.write_system_copy(system_file, file.parent)
    return combined


def calibrate(
    model: str | Path,
    data: DataSet | Sequence[Experiment],
    file: str | Path,
    *,
    start: str | None = None,
    horizon: float | None = None,
    system: AnySystem | None = None,
    overwrite: bool = False,
) -> Calibration:
    """Gives the model of a file bands around its free runs, and writes it as a new file.

    The width of the bands follows from the errors on records that were not used to fit the model.

    Args:
        model: the model file.
        data: these records.
        file: the file for the model with bands (.safetensors).
        start: initial states of the free runs; by default as the model was judged, else the usual.
        horizon: longest duration of a free run [s], infinite for whole records; by default as the
            model was judged, else whole records.
        system: the system of the model, its name or its file; by default the copy that is stored
            with it.
        overwrite: whether a file that is there may be replaced.

    Returns:
        The calibration. `highest_level` is the highest level that so many records can promise.

    Raises:
        InputError: records that the model was fitted to, a model that has neither members nor
            errors of its parameters, fewer than two records; see also `load_model`.
    """
    path, file, records = Path(model), Path(file), list(data)
    if not records:
        raise InputError("calibrate", "no records", "at least 2")
    require_outputs([file], overwrite=overwrite, read=[path], endings=ENDINGS)
    copy = kept_system.find_system_copy(path)
    kept_system.require_copy_fits(copy, file.parent, [file])
    simulator = load_model(path, system)
    header = read_header(path)
    alternatives = find_alternatives(simulator, header, path)
    if fitted := find_fitted(header, records):
        raise InputError(
            "calibrate",
            f"{', '.join(fitted[:3])}, which {path} was fitted to",
            "records that it was not fitted to",
            "for instance data.split('test')",
        )
    judged_start, judged_horizon = judged_free_runs({path: header}, records)
    start = start or judged_start or default_start(records, simulator)
    horizon = judged_horizon if horizon is None else None if horizon == math.inf else horizon
    predictions = predict(simulator, alternatives, records, start, horizon=horizon)
    calibration = calibrate_bands(predictions, records, start, horizon)
    copy_with_header(path, file, **{KEY: calibration.as_header()})
    if copy is not None:
        kept_system.write_system_copy(copy, file.parent)
    return calibration


def _require_different(paths: Sequence[Path], models: Sequence[Model]) -> None:
    """Raises an error if two files have one model: it would only count twice."""
    earlier: dict[str, Path] = {}
    for path, model in zip(paths, models, strict=True):
        other = earlier.setdefault(model_digest(model), path)
        if other is not path:
            raise InputError(
                path,
                f"the same model as {other}",
                "different models",
                "give it once, with a larger weight",
            )


def _find_shared_system(paths: Sequence[Path]) -> SystemFile | None:
    """The system file that is stored with some of the models; different ones are refused."""
    copies = [copy for path in paths if (copy := kept_system.find_trusted_copy(path)) is not None]
    if len({copy.sha256 for copy in copies}) > 1:
        names = ", ".join(dict.fromkeys(str(copy.path) for copy in copies))
        raise InputError(
            "save_committee",
            f"models with different system files ({names})",
            "one system",
            "name it: `system=` FILE.py",
        )
    return copies[0] if copies else None
