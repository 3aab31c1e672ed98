"""The model file: one safetensors file, arrays plus a JSON header; it knows no family."""

import hashlib
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from tustinnet.errors import InputError, convert_errors
from tustinnet.families.family import family_of, systems_in
from tustinnet.fitting.report import Stretch
from tustinnet.fitting.task import Origin
from tustinnet.models.contract import Model
from tustinnet.registry import FAMILIES
from tustinnet.store import kept_system
from tustinnet.store.files import nonfinite_to_none
from tustinnet.store.header import read_header, read_header_and_arrays, records_in_header
from tustinnet.store.sealed import SEAL, write_sealed
from tustinnet.systems.files import AnySystem, SystemFile
from tustinnet.systems.loading import load_system

ENDINGS = (".safetensors",)
_PACKAGES = ("tustinnet", "jax", "jaxlib", "equinox", "optax", "numpy")


def save(model: Model, path: str | Path, **header: Any) -> None:
    """Writes a model file, whole or not at all.

    Args:
        model: the model, of any registered kind.
        path: the file, usually ending in `.safetensors`.
        header: further entries of the file: recipe, data, scores.

    Raises:
        InputError: a model of no registered kind, or the file cannot be written.
    """
    family = family_of(model)
    described, arrays = family.describe(model)
    content = {
        "kind": family.kind,
        **described,
        **model.channels.as_header(),
        **header,
        "versions": package_versions(),
    }
    write_sealed(Path(path).parent, Path(path).name, nonfinite_to_none(content), arrays)


def package_versions() -> dict[str, str]:
    """The versions of the packages that models are computed with."""
    return {name: metadata.version(name) for name in _PACKAGES}


def copy_with_header(path: Path, out: Path, **more: Any) -> None:
    """Writes a copy of a model file whose header says more.

    Args:
        path: the model file.
        out: the copy.
        more: entries of its header beside those that it has, or instead.

    Raises:
        InputError: as `load_model` and `save`.
    """
    header, arrays = read_header_and_arrays(path)
    header.pop(SEAL, None)
    write_sealed(out.parent, out.name, nonfinite_to_none({**header, **more}), arrays)


def load_model(path: str | Path, system: AnySystem | None = None) -> Model:
    """Reads the model of a model file.

    Args:
        path: the file.
        system: for a grey-box model of a system of your own, the system, or the Python file that
            defines it, which is run; a model file itself never holds code. None for the copy that
            its run keeps: of a robot's file, or of a Python file that is trusted on this machine.

    Raises:
        InputError: no such file, cut short, changed since it was written, of another kind, or of
            a newer version; a system that is not known or has changed.
    """
    header, arrays = read_header_and_arrays(Path(path))
    if system is not None and not _systems_in(header, path):
        raise InputError(
            f"system for {path}",
            f"not applicable to a model of kind '{header['kind']}'",
            "a model of a system",
            "leave `system=` out",
        )
    if system is None and kept_system.HEADER in header and _systems_in(header, path):
        system = kept_system.find_trusted_copy(Path(path))
    with convert_errors(path, "header and arrays do not fit", "a file written by tustinnet"):
        return FAMILIES[header["kind"]].restore(header, arrays, system, Path(path))


def load_origin(path: Path, system: AnySystem | None = None) -> Origin:
    """A fitted model to begin a fit with.

    The files of the fit name its file, the SHA-256 of that, and the records that it was made from.

    Raises:
        InputError: as `load_model`.
    """
    model = load_model(path, system)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    made_from = records_in_header(read_header(path))
    return Origin(model, {"file": str(path), "sha256": digest, "made_from": made_from})


def load_models(
    paths: Sequence[Path],
    systems: Sequence[SystemFile | str],
    otherwise: Callable[[Path], AnySystem | None],
) -> list[Model]:
    """Reads several models; each takes its system by name and by what it computes.

    Args:
        paths: the model files.
        systems: packaged systems by name, or system files; each file is run once.
        otherwise: returns the system of a model that none of these is called like.

    Raises:
        InputError: as `load_model`; a model that none of its namesakes fits, a system that fits
            none of the models.
    """
    loaded = [(which, load_system(which)) for which in systems]
    used, models = set(), []
    for path in paths:
        name = read_system_name(path)
        matches, refusals = {}, []
        for i, (_, system) in enumerate(loaded):
            if system.name == name:
                try:
                    matches[i] = load_model(path, system)
                except InputError as error:
                    refusals.append(error)
        if refusals and not matches:
            raise refusals[0]
        used |= matches.keys()
        model = next(iter(matches.values())) if matches else load_model(path, otherwise(path))
        models.append(model)
    for i, (which, system) in enumerate(loaded):
        if i not in used:
            where = f"`system=` {which if isinstance(which, str) else which.path}"
            raise InputError(where, f"'{system.name}', which no model is of", "a model's system")
    return models


def read_system_name(path: str | Path) -> str:
    """The name of the system that a model file belongs to, or a part of its model; or ""."""
    return "".join(_systems_in(read_header(path), path)[:1])


def _systems_in(header: dict[str, Any], path: str | Path) -> tuple[str, ...]:
    with convert_errors(path, "a header that does not fit", "a file written by tustinnet"):
        return systems_in(header)


def read_downweighted(path: str | Path) -> list[Stretch]:
    """The stretches that weighed less than half in the identification of a file's model, if any.

    Raises:
        InputError: as `read_header`.
    """
    identification = read_header(path).get("identification", {})
    return [Stretch(**s) for s in identification.get("downweighted", ())]
