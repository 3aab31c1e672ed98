"""The steps of a typical use, and versions for a bug report."""

import os
import platform
import re
import shlex
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import tustinnet as tn
from tustinnet.cli import devices
from tustinnet.cores import count_cores
from tustinnet.families import euler_lagrange
from tustinnet.models import physical_values

NAME = "tustinnet"
STEPS = """\
tustinnet: from logs of a mechanical system to a model that simulates it

  1  describe  tustinnet init LOGS     (writes LOGS/dataset.toml: times, coordinates, inputs, units)
  2  look      tustinnet inspect LOGS --figure records.png
  3  fit       tustinnet fit LOGS --out RUN     (4 minutes; --system arm.py: your physics too)
  4  judge     tustinnet report RUN LOGS --out report.html     (a page that moves; or: evaluate)
  5  use       tustinnet export RUN/model.safetensors --to c --out model-c     (or: simulate)

Without logs of your own: tustinnet demo --out demo
All commands: tustinnet --help; of one: tustinnet fit --help; Tab completes: --install-completion
"""
_VARIABLES = ("JAX_", "XLA_", "TUSTINNET_", "CUDA_VISIBLE")  # beginnings of the names that matter


def next_steps(path: Path, data: str, model: "tn.Model", *, follows: bool, by_forces: bool) -> str:
    """Commands to go on with after a fit.

    Args:
        path: the model's file.
        data: the records as the user named them, in words of a shell.
        model: the model; that of a robot's file has steps of its own.
        follows: whether the model follows the records better than a trivial predictor; where not,
            there is nothing to use it for.
        by_forces: whether forces were compared, and nothing was simulated.
    """
    file = shlex.quote(str(path))
    is_robot = False
    if euler_lagrange.FAMILY.owns(model):
        equations = physical_values.equations_in(model)
        is_robot = equations is not None and equations.system.source is not None
    test = "--forces (the torques it misses)" if is_robot else "--residuals (test its errors)"
    steps = [f"tustinnet evaluate {file} {data} {test}"]
    if by_forces:
        # whole records are far longer than an arm's simulation keeps to them
        refit = f"tustinnet fit {data} --recipe grey --from {file} --set search.horizon=0.5"
        steps.append(f"{refit} --out simulator (fits what it simulates)")
    if not follows:
        steps.append(f"tustinnet inspect {data} (look at the records)")
    else:
        target = "mjcf --out robot" if is_robot else "c --out model-c"
        steps.append(f"tustinnet export {file} --to {target} (use it elsewhere)")
        if model.inputs:
            steps.append(f"tustinnet control {file} --data {data} --at NAME=VALUE --out controller")
    return ", ".join(steps)


def data_words(data: str, card: Path | None = None) -> str:
    """The arguments by which verbs find records, for a shell: DATA, and a card that was named."""
    return shlex.join([data, *(() if card is None else ("--card", str(card)))])


def version() -> str:
    """Name and version of the package."""
    return f"{NAME} {metadata.version(NAME)}"


def versions() -> Iterator[str]:
    """Lines for a bug report: versions of packages, cores, devices, environment variables."""
    yield version()
    yield f"Python {platform.python_version()} at {sys.prefix}"
    yield f"{platform.platform()}, {count_cores()} cores for this process"
    needs: list[str] = ["jaxlib"]
    extras: dict[str, list[str]] = {}
    for requirement in metadata.requires(NAME) or []:
        package = re.split(r"[^\w.-]", requirement)[0]
        extra = re.search(r"extra == ['\"]([\w-]+)['\"]", requirement)
        if extra is None:
            needs.append(package)
        elif extra[1] not in ("dev", "bench", "docs"):
            extras.setdefault(extra[1], []).append(package)
    yield f"needs: {', '.join(map(_package_version, needs))}"
    for extra, packages in extras.items():
        yield f"extra '{extra}': {', '.join(map(_package_version, packages))}"
    yield from devices.describe_devices()
    variables = [f"{k}={os.environ[k]}" for k in sorted(os.environ) if k.startswith(_VARIABLES)]
    yield "environment: " + (", ".join(variables) or "nothing of ours")


def _package_version(package: str) -> str:
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return f"{package} is not installed"
