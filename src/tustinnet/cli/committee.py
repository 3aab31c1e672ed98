"""`tustinnet committee`: one model of several."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, terminal

if TYPE_CHECKING:
    from tustinnet.models.contract import Model
    from tustinnet.systems.files import SystemFile


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
    terminal.prepare_jax()
    from tustinnet.cli.request import files_of
    from tustinnet.families.committee import committee as put_together
    from tustinnet.store.files import require_outputs
    from tustinnet.store.kept_system import require_copy_fits, system_header, write_system_copy
    from tustinnet.store.model_file import ENDINGS, load_models, save
    from tustinnet.systems.files import SystemFile, find_system

    shares = None if weights is None else _numbers(weights)
    read = files_of(None, None, *models, system)
    require_outputs([out], overwrite=overwrite, read=read, endings=ENDINGS)
    given = _kept_with(models) if system is None else find_system(system)
    members = load_models(models, [] if given is None else [given], lambda path: None)
    copied = given if isinstance(given, SystemFile) else None
    if not overwrite:
        require_copy_fits(copied, out.parent)
    if any(model.encoder for model in members):
        terminal.messages().print("note: a committee does without the encoders of its members")
    header = {
        "files": [_file(path) for path in models],
        **_range(models, members),
        **system_header(copied),
    }
    save(put_together(members, shares), out, **header)
    if copied is not None:
        write_system_copy(copied, out.parent)
        terminal.remember_trust(copied)
    terminal.messages().print(f"{len(members)} models: {out}")


def _numbers(text: str) -> list[float]:
    from tustinnet.errors import InputError

    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--weights", f"'{text}'", "numbers, separated by commas") from None


def _kept_with(models: list[Path]) -> "SystemFile | None":
    """The system file that was kept with some of the models, one and the same with all of them."""
    from tustinnet.cli.request import kept_system
    from tustinnet.errors import InputError

    found = [copy for path in models if (copy := kept_system(path)) is not None]
    if len({copy.sha256 for copy in found}) > 1:
        kept = ", ".join(dict.fromkeys(str(copy.path) for copy in found))
        raise InputError(
            "committee", f"models with different system files ({kept})", "one system",
            "name it with --system FILE.py",
        )  # fmt: skip
    return found[0] if found else None


def _range(models: list[Path], members: "list[Model]") -> dict[str, Any]:
    """Where the training records of all members lie, where all files say it."""
    from tustinnet.simulate.range import KEY, Range, joined
    from tustinnet.store.header import read_header

    told = [
        Range.from_header(read_header(path), member)
        for path, member in zip(models, members, strict=True)
    ]
    known = [of for of in told if of is not None]
    return {KEY: joined(known, members[0].channels).as_header()} if len(known) == len(told) else {}


def _file(path: Path) -> dict[str, Any]:
    """What the header says of a model's file."""
    from hashlib import sha256

    from tustinnet.store.header import read_header

    of = {"file": str(path), "sha256": sha256(path.read_bytes()).hexdigest()}
    data = read_header(path).get("data")
    return of if data is None else {**of, "data": data}
