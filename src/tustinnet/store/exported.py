"""Exports on disk: models in other forms, each in a folder with a card."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from tustinnet.errors import InputError
from tustinnet.export.check import CheckResult, check_export
from tustinnet.export.source import Source, make_source, require_stepping
from tustinnet.export.target import Files, NotRunnable, Target
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.program.numbers import run
from tustinnet.registry import TARGETS
from tustinnet.simulate.range import Range
from tustinnet.store.files import (
    PART,
    lock_folder,
    remove_partial_files,
    require_outputs,
    require_writable_folder,
    to_json,
    write_into,
)
from tustinnet.store.header import read_header
from tustinnet.store.model_file import package_versions

CARD = "card.json"
ALL = "all"
_MARK = "tustinnet-export"  # what a card says first

To = str | Target | Sequence[str | Target]


@dataclass(frozen=True)
class ExportResult:
    """A model that was exported.

    Attributes:
        target: what to.
        folder: where its files are.
        files: their names.
        checked: how they compare with the model.
        notes: remarks for those who use them.
    """

    target: str
    folder: Path
    files: tuple[str, ...]
    checked: CheckResult
    notes: tuple[str, ...]


def export_model(
    model: Model,
    to: To,
    out: str | Path,
    *,
    file: str | Path | None = None,
    groups: Mapping[str, str] | None = None,
    overwrite: bool = False,
) -> list[ExportResult]:
    """Writes a model in other forms, each compared with the model before it is written.

    Args:
        model: a model that steps from sample to sample.
        to: a target (`c`, `fmu`, `casadi`, `onnx`, `js`, `stablehlo`, `mat`, of robots `urdf` or
            `mjcf`), several, or `all` that fit any model; by name, or as `find_targets` makes it
            with an operating point.
        out: the folder; of several targets each gets a folder of its name in it.
        file: the model's file. From it the card takes data and scores, and the check takes the
            range of the training records.
        groups: for models with values by group: which to take, as `{"payload": "1kg"}`.
        overwrite: whether an export that is there may be replaced.

    Returns:
        What was written, one for each target.

    Raises:
        InputError: a target that is not known or whose packages are missing; a folder that holds
            something else, or an export that may not be replaced; a file of another kind of model;
            a model that the target cannot say; a step that differs from the model's. Nothing is
            written then.
    """
    targets = find_targets(to)
    _require_extras(targets)
    require_stepping(model)
    header = {} if file is None else read_header(file)
    if file is not None and header["kind"] != family_of(model).kind:
        raise InputError(
            file,
            f"the file of a model of the kind '{header['kind']}'",
            f"that of the model given, of the kind '{family_of(model).kind}'",
        )
    source = make_source(model, Range.from_header(header, model), groups, header)
    folders = [Path(out) / t.name if len(targets) > 1 else Path(out) for t in targets]
    with lock_folder(Path(out)):
        for folder in folders:
            require_export_folder(folder, overwrite=overwrite)
        exports = [
            _export(source, t, file, folder) for t, folder in zip(targets, folders, strict=True)
        ]
        for result, files in exports:
            write_export(result.folder, files)
    return [result for result, _ in exports]


def require_export_folder(folder: Path, *, overwrite: bool) -> None:
    """Raises unless an export may be written into a folder; asked before anything is computed.

    Raises:
        InputError: a folder that holds something else, or an export that may not be replaced.
    """
    entries = folder.iterdir() if folder.is_dir() else ()
    if any(not e.name.endswith(PART) for e in entries) and not _holds_export(folder):
        raise InputError(
            folder, "a folder that holds something else", "an empty folder", "choose another folder"
        )
    require_outputs([folder / CARD], overwrite=overwrite)


def write_export(folder: Path, files: Files) -> None:
    """Writes the files of an export in their order; an earlier export in the folder is replaced.

    Args:
        folder: the folder, for which `require_export_folder` was asked.
        files: the files by name, the card first: where writing is stopped, it says that the
            folder is an export's.
    """
    require_writable_folder(folder)
    remove_partial_files(folder)
    _remove_obsolete_files(folder, files)
    _write(folder, files)


def _require_extras(targets: Sequence[Target]) -> None:
    """Raises, for all targets together, unless the libraries that they need are installed."""
    lacking = []
    for target in targets:
        try:
            target.require_extra()
        except InputError as error:
            lacking.append((target, error))
    if len(lacking) == 1:
        raise lacking[0][1]
    if lacking:
        names = ", ".join(target.name for target, _ in lacking)
        extras = ",".join(target.extra[0] for target, _ in lacking if target.extra)
        raise InputError(
            "`to=`",
            f"packages for {names} are not installed",
            "them",
            f"pip install 'tustinnet[{extras}]'",
        )


def find_targets(to: To, at: Mapping[str, float] | None = None) -> list[Target]:
    """Targets by name; `all` that fit any model.

    Args:
        to: as for `export_model`.
        at: an operating point for those that have one (`mat`): values of states and inputs by name,
            as `{"theta": 0.1}`; those that are not named are 0.

    Raises:
        InputError: an unknown target, or one twice; an operating point for none that has one.
    """
    listed = [name.strip() for name in to.split(",")] if isinstance(to, str) else to
    requested = [listed] if isinstance(listed, Target) else list(listed)
    if ALL in requested and len(requested) > 1:
        raise InputError("`to=`", "'all' beside others", "all by itself, or targets by name")
    wants_all = requested == [ALL]
    requested = list(TARGETS.names()) if wants_all else requested
    targets: list[Target] = [r if isinstance(r, Target) else TARGETS[r] for r in requested]
    targets = [t for t in targets if t.fits_any_model or not wants_all]
    names = [target.name for target in targets]
    if not targets or len(set(names)) < len(names):
        raise InputError("`to=`", f"'{','.join(names)}'", "targets, none of them twice")
    if not at:
        return targets
    moved = [target.at_operating_point(at) for target in targets]
    if moved == targets:
        raise InputError(
            "`at=`",
            f"an operating point for {', '.join(names)}",
            "a target that has one",
            "leave it out, or add mat to `to=`",
        )
    return moved


def _holds_export(folder: Path) -> bool:
    try:
        return _MARK in (folder / CARD).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False


def _export(
    source: Source, target: Target, file: str | Path | None, folder: Path
) -> tuple[ExportResult, Files]:
    """The files of a target, compared with the model; the card among them."""
    files = target.files(source)
    with tempfile.TemporaryDirectory() as place:
        _write(Path(place), files)
        try:
            check = check_export(source, target, target.stepper(Path(place), source))
        except NotRunnable as unbuilt:
            alike = check_export(source, target, lambda x, u: run(source.step, x=x, u=u)["x"])
            note = f"not run here: {unbuilt}; what it is written from was compared"
            check = CheckResult(alike.steps, alike.difference, note)
    notes = (*source.notes, *target.notes(source))
    result = ExportResult(target.name, folder, (*files, CARD), check, notes)
    checked = {
        "steps": check.steps,
        "difference": check.difference,
        "bound": target.bound,
        "note": check.note,
    }
    return result, {CARD: make_card(source, target.name, files, checked, notes, file), **files}


def _remove_obsolete_files(folder: Path, files: Files) -> None:
    """Removes files of an earlier export that this one does not replace, if they are unchanged."""
    try:
        earlier = json.loads((folder / CARD).read_text(encoding="utf-8"))["files"].items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return
    for path, digest in ((folder / name, digest) for name, digest in earlier if name not in files):
        in_folder = path.parent == folder and path.is_file()
        if in_folder and sha256(path.read_bytes()).hexdigest() == digest:
            path.unlink()


def _write(folder: Path, files: Files) -> None:
    for name, content in files.items():
        write_into(folder, name, content)


def make_card(
    source: Source,
    target: str,
    files: Files,
    check: Mapping[str, Any],
    notes: Sequence[str],
    file: str | Path | None,
) -> str:
    """The card of an exported folder, in JSON.

    Args:
        source: the model.
        target: the name of the form.
        files: the files of the folder by name.
        check: what was compared with the model, by name.
        notes: remarks for those who use the files.
        file: the model's file, if known.
    """
    channels, limits = source.channels, source.range
    state_limits = [None] * source.n_x if limits is None else limits.states.tolist()
    input_limits = [None] * channels.n_u if limits is None else limits.inputs.tolist()
    contents = {k: v.encode() if isinstance(v, str) else v for k, v in files.items()}
    return to_json(
        {
            "form": _MARK,
            "target": target,
            "files": {name: sha256(content).hexdigest() for name, content in contents.items()},
            "model": None
            if file is None
            else {
                "file": Path(file).name,
                "sha256": sha256(Path(file).read_bytes()).hexdigest(),
                "kind": source.about["kind"],
            },
            "period": source.channels.dt,
            "states": [
                {"name": name, "unit": unit, "range": ends}
                for name, unit, ends in zip(source.states, source.units, state_limits, strict=True)
            ],
            "inputs": [
                {**i.as_header(), "hold": i.hold or "zero-order", "range": ends}
                for i, ends in zip(channels.inputs, input_limits, strict=True)
            ],
            "parameters": [
                {"name": name, "unit": unit, "value": value}
                for name, unit, value in source.parameters
            ],
            "samples": list(source.input_layout.offsets),
            "warm_up": source.model.warm_up,
            "scores": source.about.get("scores"),
            "check": dict(check),
            "notes": list(notes),
            "versions": package_versions(),
        }
    )
