"""The copy of a system file that a run keeps, and which copies the user trusts.

A copy of a Python file is code, and a run folder may come from anybody. The SHA-256 of each copy
that the user has consented to is kept, a file of that name in the user's configuration folder.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tustinnet.data.declaration import read_source
from tustinnet.errors import InputError
from tustinnet.store.files import write_into
from tustinnet.store.header import read_header
from tustinnet.systems.files import SystemFile
from tustinnet.systems.robot_reading import ROBOT_ENDINGS
from tustinnet.user_folders import config_folder

COPY = "system"  # what the copy is called in a run folder, before the ending of the file
CANDIDATES = "candidates"  # the folder of a selection that has one for each candidate
HEADER = "system_copy"  # its key in the header of a model
CONFIG_VARIABLE = "TUSTINNET_CONFIG"  # names another configuration folder


def system_header(system: SystemFile | None) -> dict[str, Any]:
    """The entry in the model files of a run on the copy that the run keeps."""
    if system is None:
        return {}
    beside = {robot.path.name: robot.sha256 for robot in system.robots}
    entry = {"file": _copy_name(system), "sha256": system.sha256}
    return {HEADER: entry | ({"robots": beside} if beside else {})}


def write_system_copy(system: SystemFile, folder: Path) -> None:
    """Writes the copy into a run folder, with the files of robots that its code names.

    Raises:
        InputError: it cannot be written.
    """
    for robot in system.robots:
        write_into(folder, robot.path.name, robot.text)
    write_into(folder, _copy_name(system), system.text)


def require_copy_fits(
    system: SystemFile | None, folder: Path, replaced: Sequence[Path] = ()
) -> None:
    """Raises unless the copy can be written without replacing another file.

    Args:
        system: the file of the system, if there is one.
        folder: where the copy is kept.
        replaced: files of an earlier run that are replaced too. A copy whose SHA-256 one of them
            names is theirs.

    Raises:
        InputError: another file of the copy's name is there.
    """
    if system is None:
        return
    kept = [(_copy_name(system), system), *((robot.path.name, robot) for robot in system.robots)]
    for name, file in kept:
        path = folder / name
        if not path.exists() or (text := _read_copy(path)) == file.text:
            continue
        digest = SystemFile(path, text).sha256.encode()
        if not any(digest in earlier.read_bytes() for earlier in replaced if earlier.is_file()):
            raise InputError(
                path,
                f"another file than {file.path}, a copy of which is kept there",
                "a new folder",
                "choose another place, or move that file away",
            )


def find_system_copy(model: Path) -> SystemFile | None:
    """The copy that was kept with a model file, read but not run; None where there is none.

    The models of seeds, folds and candidates lie some folders below the copy.

    Raises:
        InputError: the model file or the copy cannot be read.
    """
    if HEADER not in read_header(model):
        return None
    for folder in _run_folders(model.parent):
        for path in (folder / f"{COPY}{ending}" for ending in (".py", *ROBOT_ENDINGS)):
            if path.exists():
                return SystemFile(path, _read_copy(path))
    return None


def find_trusted_copy(
    model: Path, has_consent: Callable[[SystemFile], bool] = lambda copy: False
) -> SystemFile | None:
    """The copy that was kept with a model file, if it may be run; None where there is none.

    Args:
        model: the model file.
        has_consent: asks whether to run a Python file that is not trusted; a yes is remembered.

    Raises:
        InputError: the copy is Python code that is not trusted; see also `find_system_copy`.
    """
    copy = find_system_copy(model)
    if copy is None or is_trusted(copy):
        return copy
    if not has_consent(copy):
        raise InputError(
            model,
            f"a model of the system in {copy.path}, Python code that its run keeps",
            "your consent",
            f"to run it, give that file as the system: load_model(path, system={str(copy.path)!r})",
        )
    trust(copy)
    return copy


def _run_folders(folder: Path) -> Iterator[Path]:
    """The folder of a model and those above it, up to that of the run or selection it is from."""
    yield folder
    name, above = folder.resolve().name, folder.parent if folder.name else Path("..")
    is_fit = name.startswith(("seed-", "fold-", "all-records")) or name == CANDIDATES
    if is_fit or above.resolve().name == CANDIDATES:
        yield from _run_folders(above)


def is_trusted(system: SystemFile) -> bool:
    """Whether the user has consented to run just this text; a robot file runs nothing."""
    return not system.is_code or (_trusted_folder() / system.sha256).is_file()


def trust(system: SystemFile) -> None:
    """Records that the user consents to run this text.

    Raises:
        InputError: the configuration folder cannot be written.
    """
    write_into(_trusted_folder(), system.sha256, f"{system.path.resolve()}\n")


def _copy_name(system: SystemFile) -> str:
    return f"{COPY}{system.path.suffix}"


def _trusted_folder() -> Path:
    return Path(os.environ.get(CONFIG_VARIABLE) or config_folder()) / "trusted-systems"


def _read_copy(path: Path) -> str:
    return read_source(path, "the system file that was kept with the model")
