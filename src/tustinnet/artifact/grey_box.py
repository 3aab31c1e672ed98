"""Grey-box models on disk: the system's name and digest, and the parameters; never its code."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from tustinnet.errors import InputError
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.simulation.integrators import Discretised, discretise
from tustinnet.systems.registry import PACKAGED, load_system, source_of

KIND = "euler-lagrange"
VALUES = "values"  # the array of the parameters' values


def described(model: Discretised) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and arrays of a discretised Lagrangian model."""
    continuous = model.continuous
    if not isinstance(continuous, LagrangianModel):
        raise InputError("save", f"a {type(continuous).__name__}", "a LagrangianModel")
    file, digest = source_of(continuous.system)
    names = sorted(continuous.values)
    header = {
        "system": {"name": continuous.system.name, "file": file, "sha256": digest},
        "parameters": names,
        "substeps": model.substeps,
    }
    values = np.array([float(continuous.values[name]) for name in names])
    return header, {VALUES: values}


def built(
    path: Path,
    header: dict[str, Any],
    arrays: dict[str, np.ndarray],
    system: str | Path | LagrangianSystem | None,
) -> Discretised:
    """The model of a grey-box file.

    Args:
        path: the file, for messages.
        header: its header.
        arrays: its arrays.
        system: the system or its file, where the package does not have it.
    """
    belongs = header["system"]
    if system is None and belongs["name"] not in PACKAGED:
        raise InputError(
            path,
            f"a model of the system '{belongs['name']}', which the package does not have",
            f"its file ({belongs['file']})",
            f"add --system {belongs['file']} (in Python: load_model(path, system=...))",
        )
    found = load_system(belongs["name"] if system is None else system)
    _require_same(path, found, header)
    values = dict(zip(header["parameters"], jnp.asarray(arrays[VALUES]), strict=True))
    return discretise(LagrangianModel(found, values), header["dt"], header["substeps"])


def _require_same(path: Path, system: LagrangianSystem, header: dict[str, Any]) -> None:
    belongs = header["system"]
    if system.name != belongs["name"]:
        raise InputError(
            path, f"the system '{system.name}'", f"'{belongs['name']}', which the model is of"
        )
    if source_of(system)[1] != belongs["sha256"]:
        raise InputError(
            path,
            f"the code of the system '{system.name}' has changed since the model was identified",
            f"digest {belongs['sha256'][:12]}",
            "identify it again, or give the file as it was then with --system FILE.py",
        )
    if sorted(system.nominal()) != header["parameters"]:
        raise InputError(path, "parameters that the system does not have", "those of the system")
