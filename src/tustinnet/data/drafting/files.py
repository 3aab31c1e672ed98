"""The logs that a draft is made from, and the folder of its card."""

import os
from collections.abc import Sequence
from pathlib import Path

from tustinnet.data.card_files import in_natural_order, list_logs_in, require_inside
from tustinnet.data.formats.parquet import LEROBOT_INFO
from tustinnet.data.readers import is_readable
from tustinnet.errors import InputError, convert_errors, escape_unprinted


def list_logs(paths: Sequence[Path]) -> tuple[Path, list[str]]:
    """The folder of a card for some logs, and the logs below it.

    Args:
        paths: a folder, whose logs are taken, or those of the nearest folders below it where it
            has none itself, of a LeRobot data set its episodes; or files, of which the folder that
            holds all is taken.

    Raises:
        InputError: no such file or folder, a file that cannot be read, several folders, no logs,
            a link that leaves the folder, a name that cannot be printed.
    """
    folder, files = _list_all(paths)
    for file in files:
        if escape_unprinted(file) != file:
            raise InputError(
                folder / file,
                "characters in a file's name that are not printed",
                "a name that can be printed",
                "rename it",
            )
        require_inside(folder, folder / file)
    return folder, files


def _list_all(paths: Sequence[Path]) -> tuple[Path, list[str]]:
    """The folder of a card for some logs, and the logs below it, links among them."""
    for path in paths:
        if not path.exists():
            raise InputError(
                path, "no such file or folder", "a folder of logs, or some of its files"
            )
    folders = [path for path in paths if path.is_dir()]
    if folders and len(paths) > 1:
        raise InputError(
            folders[0],
            "a folder beside other arguments",
            "one folder, or files",
            "a card describes the logs of one folder",
        )
    if folders:
        (folder,) = folders
        if (folder / LEROBOT_INFO).is_file():
            found = (p.relative_to(folder).as_posix() for p in folder.glob("data/*/*.parquet"))
            files = in_natural_order(found)
        else:
            files = _list_logs_below(folder)
        if not files:
            raise InputError(
                folder,
                "no logs",
                "files of columns, such as .csv, .parquet or .mat",
                "check the folder, add .txt to text files without an ending; other formats: "
                "docs/how-to/add-a-reader.md",
            )
        return folder, files
    for path in paths:
        if not is_readable(path):
            raise InputError(path, f"ending '{path.suffix}'", "a log: .csv, .parquet, .mat, ...")
    if len({path.parent for path in paths}) == 1:
        return paths[0].parent, [path.name for path in paths]
    whole = [path.resolve() for path in paths]
    folder = Path(os.path.commonpath([path.parent for path in whole]))
    return folder, [path.relative_to(folder).as_posix() for path in whole]


def _list_logs_below(folder: Path) -> list[str]:
    """The logs of a folder, or of all folders of the first depth at which there are some."""
    level = [folder]
    for _ in range(10):  # nobody's logs lie deeper
        logs = [f"{p.relative_to(folder).as_posix()}/{n}" for p in level for n in list_logs_in(p)]
        if logs:
            return [log.removeprefix("./") for log in logs]
        with convert_errors(folder, "its folders cannot be listed", "a folder of logs"):
            level = [
                below
                for parent in level
                for below in sorted(parent.iterdir())
                if below.is_dir() and not below.name.startswith(".")
            ]
    return []
