"""`tustinnet committee`: several models combined into one."""

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.files import list_input_files
from tustinnet.cli.models import kept_system
from tustinnet.errors import InputError
from tustinnet.simulate import range as training_ranges
from tustinnet.store import checkpoint, model_file
from tustinnet.store import files as disk
from tustinnet.store import kept_system as kept_systems
from tustinnet.systems import files as system_files


def committee(
    models: options.Models,
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File for the new model (.safetensors).")
    ],
    weights: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,..", help="Weight of each model in the average. Default: all equal."
        ),
    ] = None,
    system: options.System = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Combine models into one that averages their accelerations."""
    devices.prepare_jax()
    try:
        shares = None if weights is None else [float(part) for part in weights.split(",")]
    except ValueError:
        raise InputError("--weights", f"'{weights}'", "numbers, separated by commas") from None
    inputs = list_input_files(None, None, *models, system)
    disk.require_outputs([out], overwrite=overwrite, read=inputs, endings=model_file.ENDINGS)
    shared_system = (
        _find_shared_system(models) if system is None else system_files.find_system(system)
    )
    members = model_file.load_models(
        models, [] if shared_system is None else [shared_system], lambda path: None
    )
    _require_different(models, members)
    system_file = shared_system if isinstance(shared_system, system_files.SystemFile) else None
    kept_systems.require_copy_fits(system_file, out.parent, [out])
    headers = [tn.read_header(path) for path in models]
    files: list[dict[str, Any]] = []
    for path, header in zip(models, headers, strict=True):
        data = {} if header.get("data") is None else {"data": header["data"]}
        files.append({"file": str(path), "sha256": sha256(path.read_bytes()).hexdigest(), **data})
    content: dict[str, Any] = {"files": files}
    # the range of the training data is known where all members have one
    ranges = [
        training_ranges.Range.from_header(h, m) for h, m in zip(headers, members, strict=True)
    ]
    complete = [part for part in ranges if part is not None]
    if len(complete) == len(ranges):
        content[training_ranges.KEY] = training_ranges.join_ranges(
            complete, members[0].channels
        ).as_header()
    tn.save(
        tn.committee(members, shares), out, **content, **kept_systems.system_header(system_file)
    )
    if system_file is not None:
        kept_systems.write_system_copy(system_file, out.parent)
        terminal.remember_trust(system_file)
    terminal.messages().print(f"{len(members)} models: {out}")


def _require_different(paths: list[Path], models: "Sequence[tn.Model]") -> None:
    """Raises an error if two files have one model: it would only count twice."""
    earlier: dict[str, Path] = {}
    for path, model in zip(paths, models, strict=True):
        other = earlier.setdefault(checkpoint.model_digest(model), path)
        if other is not path:
            raise InputError(
                path,
                f"the same model as {other}",
                "different models",
                "give it once; --weights says how much it counts",
            )


def _find_shared_system(models: list[Path]) -> "system_files.SystemFile | None":
    """The system file that is stored with some of the models; different ones are refused."""
    copies = [copy for path in models if (copy := kept_system(path)) is not None]
    if len({copy.sha256 for copy in copies}) > 1:
        names = ", ".join(dict.fromkeys(str(copy.path) for copy in copies))
        raise InputError(
            "committee",
            f"models with different system files ({names})",
            "one system",
            "name it with --system FILE.py",
        )
    return copies[0] if copies else None
