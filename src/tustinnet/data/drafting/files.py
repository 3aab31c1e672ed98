"""The logs that a draft is made from, and the folder of its card."""

import os
from collections.abc import Sequence
from pathlib import Path

from tustinnet.data.card_files import list_logs_in
from tustinnet.data.readers import is_readable
from tustinnet.errors import InputError


def list_logs(paths: Sequence[Path]) -> tuple[Path, list[str]]:
    """The folder of a card for some logs, and the logs below it.

    Args:
        paths: a folder, whose logs are taken, or those of its subfolders where it has none itself;
            or files, of which the folder that holds all is taken.

    Raises:
        InputError: no such file or folder, a file that cannot be read, several folders, no logs.
    """
    for path in paths:
        if not path.exists():
            raise InputError(
                path, "no such file or folder", "a folder of logs, or some of its files"
            )
    folders = [path for path in paths if path.is_dir()]
    if folders and len(paths) > 1:
        raise InputError(
            folders[0], "a folder beside other arguments", "one folder, or files",
            "a card describes the logs of one folder",
        )  # fmt: skip
    if folders:
        (folder,) = folders
        files = list_logs_in(folder) or [
            f"{sub.name}/{file}"
            for sub in sorted(folder.iterdir())
            if sub.is_dir() and not sub.name.startswith(".")
            for file in list_logs_in(sub)
        ]
        if not files:
            raise InputError(
                folder, "no logs", "files of columns, such as .csv, .parquet or .mat",
                "check the folder; other formats: docs/how-to/add-a-reader.md",
            )  # fmt: skip
        return folder, files
    for path in paths:
        if not is_readable(path):
            raise InputError(path, f"ending '{path.suffix}'", "a log: .csv, .parquet, .mat, ...")
    if len({path.parent for path in paths}) == 1:
        return paths[0].parent, [path.name for path in paths]
    whole = [path.resolve() for path in paths]
    folder = Path(os.path.commonpath([path.parent for path in whole]))
    return folder, [path.relative_to(folder).as_posix() for path in whole]
