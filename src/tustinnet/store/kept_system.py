"""The copy of a system file that a run keeps, and which copies the user trusts.

A copy is Python code, and a run folder may come from anybody. What is remembered is the SHA-256 of
each copy that the user has consented to, a file of that name in the user's configuration folder.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import platformdirs

from tustinnet.data.declaration import read_source
from tustinnet.errors import InputError
from tustinnet.store.files import write_into
from tustinnet.store.header import read_header
from tustinnet.systems.files import SystemFile

COPY = "system.py"  # what the copy is called in a run folder
CANDIDATES = "candidates"  # the folder of a selection that has one for each candidate
HEADER = "system_copy"  # what the header of a model says of it
CONFIG_VARIABLE = "TUSTINNET_CONFIG"  # names another configuration folder


def header_of(system: SystemFile | None) -> dict[str, Any]:
    """What the model files of a run say of the copy that the run keeps."""
    return {} if system is None else {HEADER: {"file": COPY, "sha256": system.sha256}}


def keep(system: SystemFile, folder: Path) -> None:
    """Writes the copy into a run folder.

    Raises:
        InputError: it cannot be written.
    """
    write_into(folder, COPY, system.text)


def require_room(system: SystemFile | None, folder: Path) -> None:
    """Raises unless the copy can be written without replacing another file.

    Raises:
        InputError: another `system.py` is there.
    """
    path = folder / COPY
    if system is not None and path.exists() and _text_of(path) != system.text:
        raise InputError(
            path, f"another file than {system.path}, a copy of which is kept there", "a new folder",
            "choose another place, or add --overwrite",
        )  # fmt: skip


def kept_with(model: Path) -> SystemFile | None:
    """The copy that was kept with a model file, read but not run; None where there is none.

    The models of seeds, folds and candidates lie some folders below the copy.

    Raises:
        InputError: the model file or the copy cannot be read.
    """
    if HEADER not in read_header(model):
        return None
    for path in (folder / COPY for folder in _folders_of_run(model.parent)):
        if path.exists():
            return SystemFile(path, _text_of(path))
    return None


def _folders_of_run(folder: Path) -> Iterator[Path]:
    """The folder of a model and those above it, up to that of the run or selection it is from."""
    yield folder
    name, above = folder.resolve().name, folder.parent if folder.name else Path("..")
    of_fit = name.startswith(("seed-", "fold-", "all-records")) or name == CANDIDATES
    if of_fit or above.resolve().name == CANDIDATES:
        yield from _folders_of_run(above)


def is_trusted(system: SystemFile) -> bool:
    """Whether the user has consented to run just this text."""
    return (_trusted_folder() / system.sha256).is_file()


def trust(system: SystemFile) -> None:
    """Remembers that the user consents to run this text.

    Raises:
        InputError: the configuration folder cannot be written.
    """
    write_into(_trusted_folder(), system.sha256, f"{system.path.resolve()}\n")


def _trusted_folder() -> Path:
    named = os.environ.get(CONFIG_VARIABLE)
    return Path(named or platformdirs.user_config_dir("tustinnet")) / "trusted-systems"


def _text_of(path: Path) -> str:
    return read_source(path, "the Python file that was kept with the model")
