"""The files that a card names, and the names of their records."""

import os
import re
import warnings
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tustinnet.data.card import Card, FileCard
from tustinnet.data.readers import is_log
from tustinnet.errors import InputError, convert_errors, require_name

LINKS_VARIABLE = "TUSTINNET_FOLLOW_LINKS"  # of the environment


def list_record_files(folder: Path, card: Card) -> list[tuple[str | None, FileCard]]:
    """The files of a card with their splits, patterns resolved, every record with a name.

    Without splits these are all logs of the folder, by their endings, in natural order. Records
    have the names of their files, with folders and rows where names would be doubled.

    Raises:
        InputError: a file is missing or listed in two splits, or its name can be no record's.
    """
    entries: list[tuple[str | None, FileCard]] = [
        (split, entry)
        for split, split_entries in card.splits.items()
        for entry in _resolve_patterns(folder, split, split_entries, card)
    ]
    if not card.splits:
        # these files exist: their names need no check
        files = list_logs_in(folder)
        # JSON beside logs of another format are settings of the rig
        files = [file for file in files if not file.lower().endswith(".json")] or files
        entries = [(None, FileCard.model_construct(file=file)) for file in files]
    split_by_part: dict[tuple[str, str], str | None] = {}
    for split, entry in entries:
        other = split_by_part.setdefault((entry.file, entry.part), split)
        if other != split:
            raise InputError(
                entry.file, f"listed in the splits {other} and {split}", "one split a file"
            )
    stems = Counter(Path(entry.file).stem for _, entry in entries)
    counts = Counter(entry.file for _, entry in entries)
    result = []
    for split, entry in entries:
        name = entry.name
        if name is None:
            path = Path(entry.file)
            unique = stems[path.stem] == counts[entry.file]
            name = path.stem if unique else path.with_suffix("").as_posix().replace("/", "_")
            if entry.cell is not None or entry.record is not None or counts[entry.file] > 1:
                name += entry.part
            try:
                require_name(name, entry.file)
            except InputError as error:
                where, problem = str(error).split(": ", 1)
                hint = 'give the record another: `{ file = "...", name = "..." }` under [splits]'
                raise InputError(where, problem, "", hint) from None
        result.append((split, entry.model_copy(update={"name": name})))
    return result


def would_be_record(path: Path, folder: Path, card: Card) -> bool:
    """Whether a file that is written to a path would be read as a record of a card.

    Args:
        path: the file, which need not be there yet.
        folder: where the card's paths begin.
        card: the card.
    """
    place, base = path.resolve(), folder.resolve()
    if not place.is_relative_to(base):
        return False
    relative = place.relative_to(base)
    if not card.splits:
        return len(relative.parts) == 1 and is_log(path)
    patterns = [entry.file for entries in card.splits.values() for entry in entries]
    depth = len(relative.parts)
    return any(len(Path(p).parts) == depth and relative.match(p) for p in patterns)


def _resolve_patterns(
    folder: Path, split: str, entries: list[FileCard], card: Card
) -> list[FileCard]:
    """Entries with the files of patterns, in natural order, in their place; all must exist."""
    result: list[FileCard] = []
    missing: list[str] = []
    for entry in entries:
        if any(c in entry.file for c in "*?[") and not os.path.lexists(folder / entry.file):
            with convert_errors(folder / entry.file, "no usable pattern", "e.g. train/*.csv"):
                found = list(folder.glob(entry.file))
            paths = _without_folders(found)
            files = in_natural_order(p.relative_to(folder).as_posix() for p in paths)
            result += [entry.model_copy(update={"file": file}) for file in files]
            exists = bool(paths)
        else:
            path = folder / entry.file
            with convert_errors(path, "cannot be looked for", "a file below the card's folder"):
                exists = path.exists()
            result += [entry] if exists else []
        missing += [] if exists else [entry.file]
    if missing and not (split in card.optional_splits and not result):
        raise InputError(
            folder / missing[0],
            f"no such file ({len(missing)} of the card's {split} files missing)",
            f"the files of the card '{card.name}' below {folder}",
            "check the folder and the names under [splits]",
        )
    return result


def list_logs_in(folder: Path) -> list[str]:
    """Names of the logs in a folder, in natural order.

    Files that end in .log are some only where nothing else is: beside others they are messages.
    """
    with convert_errors(folder, "cannot be listed", "a folder of logs"):
        paths = _without_folders(p for p in folder.iterdir() if is_log(p))
    paths = [p for p in paths if p.suffix.lower() != ".log"] or paths
    return in_natural_order(p.name for p in paths)


def _without_folders(paths: Iterable[Path]) -> list[Path]:
    """The paths of files; warns of folders that are called like logs."""
    files = []
    for path in paths:
        with convert_errors(path, "cannot be looked at", "a file"):
            is_folder = path.is_dir()
        if not is_folder:
            files.append(path)
        elif is_log(path):
            warnings.warn(f"{path}: a folder, no record; it is left out", stacklevel=2)
    return files


def in_natural_order(files: Iterable[str]) -> list[str]:
    """Paths sorted, their numbers by value: run2 before run10."""
    return sorted(
        files,
        key=lambda file: [
            (int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", file)
        ],
    )


def require_inside(folder: Path, path: Path) -> None:
    """Raises unless a file, links followed, lies in the folder: a card names no other files.

    Where the variable TUSTINNET_FOLLOW_LINKS is 1, links may leave the folder.

    Raises:
        InputError: a link that leaves the folder, or one that cannot be followed.
    """
    if os.environ.get(LINKS_VARIABLE) == "1":
        return
    with convert_errors(path, "cannot be followed", "a file below the card's folder"):
        inside = path.resolve().is_relative_to(folder.resolve())
    if not inside:
        raise InputError(
            path,
            "a link that leaves the folder",
            f"a file below {folder}",
            f"copy the file there, or set {LINKS_VARIABLE}=1 if you would read it",
        )
