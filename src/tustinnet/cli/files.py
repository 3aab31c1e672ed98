"""Files that verbs read and write."""

from collections.abc import Sequence
from pathlib import Path

from tustinnet.data import card_files, catalog
from tustinnet.errors import InputError
from tustinnet.store import files as disk


def list_input_files(data: str | None, card: Path | None, *others: Path | str | None) -> list[Path]:
    """Lists the files that a verb reads: those of a data set, and others that were named.

    The others may also be names of packaged systems or recipes.
    """
    files = [] if data is None else catalog.list_input_files(data, card)
    return [*files, *(Path(other) for other in others if other is not None)]


def require_figures(
    option: str, paths: Path | Sequence[Path] | None, inputs: Sequence[Path], *, overwrite: bool
) -> None:
    """Raises an error unless figures can be written, or on `overwrite` without figures.

    Args:
        option: the option that names the figures.
        paths: the files, None without the option.
        inputs: files that the verb reads, which are never replaced.
        overwrite: whether existing files may be replaced.
    """
    if paths is not None:
        files = [paths] if isinstance(paths, Path) else paths
        disk.require_outputs(files, overwrite=overwrite, read=inputs, endings=disk.FIGURE_ENDINGS)
        for folder in {path.parent for path in files}:
            disk.require_writable_folder(folder)
    elif overwrite:
        raise InputError(
            "--overwrite",
            "no figures that it could replace",
            "figures",
            f"add {option}, or omit it",
        )


def require_apart(out: Path, folder: Path) -> None:
    """Raises an error if the folder for results is the folder of the data."""
    if out.resolve() == folder.resolve():
        raise InputError(out, "the folder of the data", "another folder for the run")


def require_no_new_records(paths: Sequence[Path], data: str, card: Path | None) -> None:
    """Raises an error if files that are written would be read as records of the data."""
    folder, located_card = catalog.locate(data, card)
    for path in paths:
        if card_files.would_be_record(path, folder, located_card):
            raise InputError(
                path.parent,
                f"there {path.name} would be a record of '{located_card.name}'",
                "another folder",
            )
