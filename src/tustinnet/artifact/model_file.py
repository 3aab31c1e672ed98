"""The model file: one safetensors file, arrays plus a JSON header."""

import dataclasses
import json
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import safetensors
import safetensors.numpy

from tustinnet.artifact import grey_box
from tustinnet.artifact.files import finite, write_atomically
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Coordinate, Input, position_unit
from tustinnet.errors import InputError
from tustinnet.evaluation.free_run import Score, mean_rmse
from tustinnet.models.base import DiscreteModel
from tustinnet.models.hybrid import HybridModel, hybrid
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.network import Affine
from tustinnet.models.tustin import Scaling, TustinNet
from tustinnet.simulation.integrators import Discretised

FORMAT = 1
KEY = "tustinnet"  # where the header stands in the safetensors metadata
NETWORK = "tustin-net"
HYBRID = "hybrid"
KINDS = (NETWORK, grey_box.KIND, HYBRID)
_RESIDUAL = "residual."  # before the names of a hybrid's network arrays
_PACKAGES = ("tustinnet", "jax", "jaxlib", "equinox", "optax", "numpy")


def save(model: DiscreteModel, path: str | Path, **header: Any) -> None:
    """Writes a model file, whole or not at all.

    Args:
        model: the model.
        path: the file, usually ending in `.safetensors`.
        header: what else the file shall say: recipe, data, scores.

    Raises:
        InputError: neither a Tustin-Net nor a discretised system nor a hybrid of both, a system
            that is written in no file, or the file cannot be written.
    """
    if isinstance(model, TustinNet):
        kind, described = NETWORK, {"structure": _structure(model)}
        arrays = {name: np.asarray(array) for name, array in _named_arrays(model).items()}
    elif isinstance(model, Discretised):
        kind = grey_box.KIND
        described, arrays = grey_box.described(model)
    elif isinstance(model, HybridModel) and isinstance(model.physics, Discretised):
        kind = HYBRID
        described, arrays = grey_box.described(model.physics)
        described["structure"] = _structure(model.residual)
        described["structure"]["fades_at_rest"] = model.fades_at_rest
        for name, array in _named_arrays(model.residual).items():
            arrays[_RESIDUAL + name] = np.asarray(array)
    else:
        raise InputError(
            path, f"a model of type {type(model).__name__}",
            "a Tustin-Net, a discretised system, or a hybrid of both",
        )  # fmt: skip
    content = {
        "format": FORMAT,
        "kind": kind,
        **described,
        "coordinates": [dataclasses.asdict(c) for c in model.coordinates],
        "inputs": [dataclasses.asdict(i) for i in model.inputs],
        "dt": model.dt,
        **header,
        "versions": {name: metadata.version(name) for name in _PACKAGES},
    }
    text = json.dumps(finite(content), ensure_ascii=False)
    write_atomically(Path(path), safetensors.numpy.save(arrays, {KEY: text}))


def load_model(
    path: str | Path, system: str | Path | LagrangianSystem | None = None
) -> TustinNet | Discretised | HybridModel:
    """Reads the model of a model file.

    Args:
        path: the file.
        system: for a grey-box model of a system of your own, the system, or the Python file that
            defines it, which is run; a model file itself never holds code.

    Raises:
        InputError: no such file, cut short, of another kind, or of a newer version; a system that
            is not known or has changed.
    """
    header, arrays = read_file(Path(path), KINDS)
    try:
        if header["kind"] == NETWORK:
            return _build(header, arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise _unfit(path, error) from error
    try:
        physics = grey_box.built(Path(path), header, arrays, system)
        if header["kind"] == grey_box.KIND:
            return physics
        inner = {
            name.removeprefix(_RESIDUAL): array
            for name, array in arrays.items()
            if name.startswith(_RESIDUAL)
        }
        fades = bool(header["structure"].get("fades_at_rest", False))
        return hybrid(physics, _build(header, inner), fades_at_rest=fades)
    except InputError:
        raise  # of the system, not of the file
    except (KeyError, TypeError, ValueError) as error:
        raise _unfit(path, error) from error


def _unfit(path: str | Path, error: Exception) -> InputError:
    return InputError(
        path, f"header and arrays do not fit ({error})", "a file written by tustinnet"
    )


def read_header(path: str | Path) -> dict[str, Any]:
    """The JSON header of a model file.

    Args:
        path: the file.

    Raises:
        InputError: as `load_model`.
    """
    return read_file(Path(path), KINDS)[0]


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


def data_header(data: DataSet) -> dict[str, Any]:
    """The records a model was made from, with their checksums."""
    return {
        "name": data.name,
        "records": [
            {"name": e.name, "split": e.split, "source": e.source, "sha256": e.sha256} for e in data
        ],
    }


def scores_header(
    data: DataSet, judged: str, start: str, scores: Sequence[Score]
) -> dict[str, Any]:
    """How a model simulates the records it is judged by."""
    return {
        "split": judged,
        "start": start,
        "unit": position_unit(data.coordinates),
        "rmse": {score.experiment: score.rmse for score in scores},
        "mean": mean_rmse(scores),
    }


def _structure(model: TustinNet) -> dict[str, Any]:
    return {
        "hidden": [layer.weight.shape[0] for layer in model.hidden],
        "stem": None if model.stem is None else model.stem.weight.shape[0],
        "activation": model.activation,
        "output_bias": model.output.bias is not None,
        "relaxation_times": list(model.relaxation_times),
    }


def _named_arrays(model: TustinNet) -> dict[str, Any]:
    paths = jax.tree_util.tree_leaves_with_path(eqx.filter(model, eqx.is_array))
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in paths}


def _build(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> TustinNet:
    structure = header["structure"]

    def affine(name: str, *, bias: bool = True) -> Affine:
        weight = jnp.asarray(arrays[f"{name}.weight"])
        return Affine(weight, jnp.asarray(arrays[f"{name}.bias"]) if bias else None)

    limits = [tuple(i["limits"]) if i["limits"] else None for i in header["inputs"]]
    # of memory, files say nothing that were written before there was any
    scaling = {
        f.name: jnp.asarray(arrays[f"scaling.{f.name}"])
        for f in dataclasses.fields(Scaling)
        if f.name != "memory" or structure.get("relaxation_times")
    }
    return TustinNet(
        stem=affine("stem") if structure["stem"] else None,
        hidden=tuple(affine(f"hidden.{m}") for m in range(len(structure["hidden"]))),
        output=affine("output", bias=structure["output_bias"]),
        scaling=Scaling(**scaling),
        activation=structure["activation"],
        coordinates=tuple(Coordinate(**c) for c in header["coordinates"]),
        inputs=tuple(
            Input(**{**i, "limits": limit})
            for i, limit in zip(header["inputs"], limits, strict=True)
        ),
        dt=header["dt"],
        relaxation_times=tuple(structure.get("relaxation_times", ())),
    )
