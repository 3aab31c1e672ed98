"""What the command says of itself: the steps of a typical use, versions for a bug report."""

import os
import platform
import re
import sys
from collections.abc import Iterator
from importlib import metadata

NAME = "tustinnet"
STEPS = """\
tustinnet: from logs of a mechanical system to a model that simulates it

  1  describe  LOGS/dataset.toml names the columns: time, coordinates, inputs, units
  2  look      tustinnet inspect LOGS --figure records.png
  3  fit       tustinnet fit LOGS --budget 10min --out RUN     (--system arm.py: your physics too)
  4  judge     tustinnet report RUN LOGS --out report.html     (a page that moves; or: evaluate)
  5  use       tustinnet export RUN/model.safetensors --to c --out model-c     (or: simulate)

Without logs of your own: tustinnet demo --out demo
All commands: tustinnet --help; of one: tustinnet fit --help; Tab completes: --install-completion
"""


def version() -> str:
    """Name and version."""
    return f"{NAME} {metadata.version(NAME)}"


def versions() -> Iterator[str]:
    """Lines for a bug report: versions of what computes, extras, devices."""
    import jax

    from tustinnet.cores import count_cores

    yield version()
    yield f"Python {platform.python_version()} at {sys.prefix}"
    yield f"{platform.platform()}, {count_cores()} cores for this process"
    needed, extras = _requirements()
    yield f"needs: {_found(['jaxlib', *needed])}"
    for extra, packages in extras.items():
        yield f"extra '{extra}': {_found(packages)}"
    for device in jax.devices():
        yield f"device {device.id}: {device.platform}, {device.device_kind}"
    told = {name: os.environ[name] for name in sorted(os.environ) if _matters(name)}
    yield "environment: " + (", ".join(f"{k}={v}" for k, v in told.items()) or "nothing of ours")


def _matters(name: str) -> bool:
    return name.startswith(("JAX_", "XLA_", "TUSTINNET_", "CUDA_VISIBLE"))


def _requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Packages that are always needed, and those of each extra that a user may ask for."""
    needed: list[str] = []
    extras: dict[str, list[str]] = {}
    for requirement in metadata.requires(NAME) or []:
        name = re.split(r"[^\w.-]", requirement)[0]
        extra = re.search(r"extra == ['\"]([\w-]+)['\"]", requirement)
        if extra is None:
            needed.append(name)
        elif extra[1] not in ("dev", "bench", "docs"):
            extras.setdefault(extra[1], []).append(name)
    return needed, extras


def _found(packages: list[str]) -> str:
    return ", ".join(_version_of(name) for name in packages)


def _version_of(package: str) -> str:
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return f"{package} is not installed"
