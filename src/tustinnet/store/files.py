"""Writing files so that nothing is ever half-written, nor outside of the output folder."""

import glob
import json
import math
import os
import re
import secrets
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from tustinnet.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: two runs in one folder are not kept apart there
    fcntl = None

FIGURE_ENDINGS = (".png", ".svg", ".pdf")  # formats of figures
PART = ".part"  # how the name of a file ends while it is written
_HALF_WRITTEN = re.compile(r"\.(.+\.\d+(\.[0-9a-f]{8})?|shared-[0-9a-f]{32})\.part")


def write_into(folder: Path, name: str, content: bytes | str) -> None:
    """Writes a file below a folder that is either whole or as it was before.

    Args:
        folder: the output folder that the user named.
        name: the file, relative to the folder.
        content: text or bytes.

    Raises:
        InputError: the file would be outside of the folder, or it cannot be written.
    """
    path = folder / name
    payload = content.encode() if isinstance(content, str) else content
    temporary = _part_of(path)
    try:
        if not path.parent.resolve().is_relative_to(folder.resolve()):
            raise InputError(path, "outside of the output folder", f"a file below {folder}")
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(path)
        try:
            with temporary.open("xb") as file:
                file.write(payload)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable_error(path, error) from error


def _part_of(path: Path) -> Path:
    """The name of a file while it is written, which nobody can guess and plant a link under."""
    return path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}{PART}")


def _remove_abandoned(path: Path) -> None:
    """Removes what processes that were killed had written of a file."""
    if fcntl is None:  # Windows, where asking after a process would end it
        return
    for part in path.parent.glob(f".{glob.escape(path.name)}.*{PART}"):
        number = part.name[len(path.name) + 2 :].partition(".")[0]
        if number.isdecimal() and not _is_running(int(number)):
            part.unlink(missing_ok=True)


def _is_running(number: int) -> bool:
    """Whether there is a process of a number on this machine."""
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # of another user
    return True


def require_writable_folder(folder: Path) -> None:
    """Makes a folder and raises `InputError` unless files can be written into it."""
    probe = _part_of(folder / "writable")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch(exist_ok=False)
        probe.unlink()
    except OSError as error:
        raise unwritable_error(folder, error) from error


def remove_partial_files(folder: Path) -> None:
    """Removes half-written files of killed processes in a folder and those in it."""
    for pattern in (f".*{PART}", f"*/.*{PART}"):
        for path in folder.glob(pattern):
            if _HALF_WRITTEN.fullmatch(path.name):
                path.unlink(missing_ok=True)


def remove_below(folder: Path, names: Collection[str]) -> None:
    """Removes the files of some names below a folder, and the folders that are empty then."""
    for path in sorted(folder.rglob("*"), reverse=True):  # what is in a folder before the folder
        if path.name in names and path.is_file():
            path.unlink()
        elif path.is_dir() and not path.is_symlink() and not any(path.iterdir()):
            path.rmdir()


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Locks a folder for the one run that writes into it; makes it where it is not there.

    Half-written files of killed runs are removed. The lock is on the folder itself: it leaves no
    file, and ends with the process however that ends. A folder that it made goes with it where
    nothing was written.

    Raises:
        InputError: another run has the folder, or files cannot be written into it.
    """
    is_new = not folder.exists()
    require_writable_folder(folder)
    descriptor = None
    try:
        if fcntl is not None:
            descriptor = os.open(folder, os.O_RDONLY)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor or 0)
        raise InputError(
            folder,
            "another run is writing there",
            "a folder of its own for every run",
            "wait until it ends, or choose another folder",
        ) from None
    except OSError:
        pass  # a file system without locks
    try:
        remove_partial_files(folder)
        yield
    finally:
        if is_new:
            with suppress(OSError):  # not empty
                folder.rmdir()
        if descriptor is not None:
            os.close(descriptor)


def require_outputs(
    paths: Iterable[Path],
    *,
    overwrite: bool,
    read: Iterable[Path] = (),
    endings: Sequence[str] = (),
) -> None:
    """Raises unless files may be written; asked before anything is computed.

    Args:
        paths: the files.
        overwrite: whether those that are there may be replaced.
        read: what they are made from, which is never replaced, under whatever name it is given.
        endings: those that the files may have; () where no user names them.

    Raises:
        InputError: a file that is read, another ending, a folder of a file's name, or a file that
            is there and may not be replaced.
    """
    # `os.path`, for which what cannot be looked at is not there
    listed = list(paths)
    existing = [path for path in listed if os.path.exists(path)]  # noqa: PTH110
    sources = [source for source in read if os.path.exists(source)]  # noqa: PTH110
    for path in listed:
        if listed.count(path) > 1:
            raise InputError(path, "two results that would be written there", "one for each file")
        if path in existing and any(path.samefile(source) for source in sources):
            raise InputError(path, "what the command reads", "another file for what it writes")
        if endings and path.suffix.lower() not in endings:
            raise InputError(
                path, f"ending '{path.suffix}'", f"a file that ends in {' or '.join(endings)}"
            )
        if endings and path.is_dir():
            raise InputError(path, "a folder", "a file")
    if existing and not overwrite:
        more = f" and {len(existing) - 1} more" if len(existing) > 1 else ""
        raise InputError(
            existing[0],
            f"there already{more}",
            "a new file",
            "choose another place, or add `overwrite=`",
        )


def to_json(content: Any) -> str:
    """JSON for people and programs: indented; arrays as lists, null for what is not finite."""
    return json.dumps(nonfinite_to_none(content), indent=1, ensure_ascii=False) + "\n"


def nonfinite_to_none(content: Any) -> Any:
    """Content with lists for arrays, and None where a number is not finite: what JSON can say."""
    if hasattr(content, "tolist"):  # of NumPy, which is not loaded for this
        content = content.tolist()
    if isinstance(content, dict):
        return {key: nonfinite_to_none(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [nonfinite_to_none(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


def unwritable_error(path: Path, error: OSError) -> InputError:
    """The error of a file that cannot be written."""
    blocked = isinstance(error, FileExistsError | NotADirectoryError)
    reason = "a file stands where a folder is needed" if blocked else error.strerror or str(error)
    return InputError(
        path,
        f"cannot be written ({reason})",
        "a folder you may write to, with room in it",
        "make room or choose another place",
    )
