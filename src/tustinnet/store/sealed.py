"""Sealed files: arrays and a JSON header in one safetensors file, with a SHA-256 of both."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from tustinnet.errors import InputError, convert_errors
from tustinnet.store.files import write_into

FORMAT = 4
KEY = "tustinnet"  # where the header stands in the safetensors metadata
SEAL = "sha256"  # of header and arrays, within the header

Arrays = Mapping[str, np.ndarray]


def write_sealed(folder: Path, name: str, header: Mapping[str, Any], arrays: Arrays) -> None:
    """Writes a file of this format, whole or not at all.

    Args:
        folder: the output folder.
        name: the file in it.
        header: JSON with `kind`, on the arrays.
        arrays: by name.

    Raises:
        InputError: the file cannot be written.
    """
    content = {"format": FORMAT, **header}
    sealed = {SEAL: _digest(content, arrays), **content}
    text = json.dumps(sealed, ensure_ascii=False)
    write_into(folder, name, safetensors.numpy.save(dict(arrays), {KEY: text}))


def read_sealed(path: Path, kinds: Sequence[str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of one of some kinds, as they were written.

    Raises:
        InputError: no such file, cut short, not of this package, of another kind, of an earlier
            or a newer version, or changed since it was written.
    """
    kind, remedy = "model", "copy or train it again"
    if len(kinds) == 1:
        (kind,), remedy = kinds, "start anew with `overwrite=`"
    if path.is_dir():
        raise InputError(
            path, "a folder", "a model file", f"did you mean {path / 'model.safetensors'}?"
        )
    if not path.is_file():
        obstacle = "a pipe or device" if path.exists() else "no such file"
        raise InputError(path, obstacle, f"a {kind} file (.safetensors)")
    with (
        convert_errors(path, "not a safetensors file, or cut short", f"a {kind} file", remedy),
        safetensors.safe_open(path, framework="numpy") as file,
    ):
        metadata = file.metadata() or {}
        # copied: a tensor may be a view into a mapping that is gone once the file is replaced
        arrays = {name: np.array(file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118 (not a dict)
    with convert_errors(
        path,
        "a safetensors file without a tustinnet header",
        f"a {kind} file",
        "give a file that tustinnet has written",
    ):
        header = json.loads(metadata[KEY])
        file_kind, version = str(header["kind"]), int(header["format"])
    if version > FORMAT:
        raise InputError(
            path, f"format version {version}", f"at most {FORMAT}", "upgrade tustinnet to read it"
        )
    if version < FORMAT:
        raise InputError(path, "written by an earlier version", f"format {FORMAT}", "fit again")
    if file_kind not in kinds:
        raise InputError(path, f"a file of kind '{file_kind}'", f"kind {' or '.join(kinds)}")
    if header.pop(SEAL, None) != _digest(header, arrays):
        raise InputError(
            path,
            "changed since it was written (its SHA-256 is another one)",
            "the file as it was",
            remedy,
        )
    return header, arrays


def _digest(header: Mapping[str, Any], arrays: Arrays) -> str:
    digest = hashlib.sha256(json.dumps(header, ensure_ascii=False).encode(errors="replace"))
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype} {arrays[name].shape}".encode(errors="replace"))
        digest.update(array.tobytes())
    return digest.hexdigest()
