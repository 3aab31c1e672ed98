"""The model file: one safetensors file, arrays plus a JSON header; it knows no family."""

import json
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.registry import FAMILIES
from tustinnet.store.files import finite, write_atomically
from tustinnet.systems.files import AnySystem

FORMAT = 2  # 1 had other names in the headers of hybrids and a digest of a system's code
KEY = "tustinnet"  # where the header stands in the safetensors metadata
_PACKAGES = ("tustinnet", "jax", "jaxlib", "equinox", "optax", "numpy")


def save(model: Model, path: str | Path, **header: Any) -> None:
    """Writes a model file, whole or not at all.

    Args:
        model: the model, of any registered kind.
        path: the file, usually ending in `.safetensors`.
        header: what else the file shall say: recipe, data, scores.

    Raises:
        InputError: a model of no registered kind, or the file cannot be written.
    """
    family = family_of(model)
    described, arrays = family.describe(model)
    content = {
        "format": FORMAT,
        "kind": family.kind,
        **described,
        **model.channels.as_header(),
        **header,
        "versions": {name: metadata.version(name) for name in _PACKAGES},
    }
    text = json.dumps(finite(content), ensure_ascii=False)
    write_atomically(Path(path), safetensors.numpy.save(arrays, {KEY: text}))


def load_model(path: str | Path, system: AnySystem | None = None) -> Model:
    """Reads the model of a model file.

    Args:
        path: the file.
        system: for a grey-box model of a system of your own, the system, or the Python file that
            defines it, which is run; a model file itself never holds code.

    Raises:
        InputError: no such file, cut short, of another kind, or of a newer version; a system that
            is not known or has changed.
    """
    header, arrays = read_file(Path(path), FAMILIES.names())
    if system is not None and not _system_in(header):
        raise InputError(
            f"system for {path}", f"means nothing to a model of kind '{header['kind']}'",
            "a model of a system", "leave --system out",
        )  # fmt: skip
    try:
        return FAMILIES[header["kind"]].restore(header, arrays, system, Path(path))
    except InputError:
        raise  # of the system, not of the file
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            path, f"header and arrays do not fit ({error})", "a file written by tustinnet"
        ) from error


def shown(path: str | Path) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """The header of a model file, and what the model's family tells of it.

    Raises:
        InputError: as `load_model`.
    """
    header, arrays = read_file(Path(path), FAMILIES.names())
    return header, FAMILIES[header["kind"]].shown(header, arrays)


def read_header(path: str | Path) -> dict[str, Any]:
    """The JSON header of a model file.

    Args:
        path: the file.

    Raises:
        InputError: as `load_model`.
    """
    return read_file(Path(path), FAMILIES.names())[0]


def read_file(path: Path, kinds: Sequence[str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a file of this package and of one of the given kinds."""
    kind = " or ".join(kinds)
    if path.is_dir():
        raise InputError(
            path, "a folder", "a model file", f"did you mean {path / 'model.safetensors'}?"
        )
    if not path.is_file():
        raise InputError(path, "no such file", "a model file (.safetensors)")
    try:
        with safetensors.safe_open(path, framework="numpy") as file:
            described = file.metadata() or {}
            # copied: a tensor may be a view into a mapping that is gone once the file is replaced
            arrays = {name: np.array(file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (safetensors.SafetensorError, OSError) as error:
        raise InputError(
            path,
            f"not a safetensors file, or cut short ({error})",
            f"a {kind} file",
            "copy or train it again",
        ) from error
    try:
        header = json.loads(described[KEY])
        found, version = header["kind"], int(header["format"])
    except (KeyError, ValueError, TypeError):
        raise InputError(
            path,
            "a safetensors file without a tustinnet header",
            f"a {kind} file",
            "give a file that tustinnet has written",
        ) from None
    if version > FORMAT:
        raise InputError(
            path, f"format version {version}", f"at most {FORMAT}", "upgrade tustinnet to read it"
        )
    if found not in kinds:
        raise InputError(path, f"a file of kind '{found}'", f"kind '{kind}'")
    return header, arrays


def system_of(path: str | Path) -> str:
    """The name of the system that a model file belongs to, also that a network corrects; or ""."""
    return _system_in(read_header(path))


def _system_in(header: dict[str, Any]) -> str:
    while "physics" in header:
        header = header["physics"]
    return str(header.get("system", {}).get("name", ""))
