"""Writing files so that nothing is ever half-written."""

import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tustinnet.errors import InputError


def write_atomically(path: Path, content: bytes | str) -> None:
    """Writes a file that is either whole or not there.

    Raises:
        InputError: the file cannot be written.
    """
    payload = content.encode() if isinstance(content, str) else content
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open("wb") as file:
                file.write(payload)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from error


def require_writable_folder(folder: Path) -> None:
    """Makes a folder and raises `InputError` unless files can be written into it."""
    probe = folder / f".writable.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise _unwritable(folder, error) from error


def require_new(paths: Iterable[Path], *, overwrite: bool) -> None:
    """Raises `InputError` when a file is there already and must not be replaced."""
    there = [path for path in paths if path.exists()]
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise InputError(
            there[0],
            f"there already{more}",
            "a new file",
            "choose another place, or add --overwrite",
        )


def to_json(content: Any) -> str:
    """JSON for people and programs: indented; numbers that are not finite become null."""
    return json.dumps(finite(content), indent=1, ensure_ascii=False) + "\n"


def finite(content: Any) -> Any:
    """The same content with None where a number is not finite, which JSON cannot say."""
    if isinstance(content, dict):
        return {key: finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [finite(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


def _unwritable(path: Path, error: OSError) -> InputError:
    blocked = isinstance(error, FileExistsError | NotADirectoryError)
    reason = "a file stands where a folder is needed" if blocked else error.strerror or str(error)
    return InputError(
        path, f"cannot be written ({reason})", "a folder you may write to", "choose another place"
    )
