"""The files that a card names, and what their records are called."""

import re
from collections import Counter
from pathlib import Path

from tustinnet.data.card import Card, FileCard
from tustinnet.errors import InputError, convert_errors, require_name


def list_record_files(folder: Path, card: Card) -> list[tuple[str, FileCard]]:
    """The files of a card with their splits, patterns resolved, every record with a name.

    Raises:
        InputError: a file is missing or listed in two splits, or its name can be no record's.
    """
    return _named(
        [
            (split, entry)
            for split, listed in card.splits.items()
            for entry in _expand(folder, split, listed, card)
        ]
    )


def _expand(folder: Path, split: str, entries: list[FileCard], card: Card) -> list[FileCard]:
    """Patterns become files, in natural order; checks that each entry names a file."""
    found: list[FileCard] = []
    missing: list[str] = []
    for entry in entries:
        if any(c in entry.file for c in "*?["):
            with convert_errors(folder / entry.file, "no usable pattern", "e.g. train/*.csv"):
                paths = [p for p in folder.glob(entry.file) if not p.is_dir()]
            files = [p.relative_to(folder).as_posix() for p in paths]
            found += [
                entry.model_copy(update={"file": file}) for file in sorted(files, key=_natural)
            ]
            missing += [] if paths else [entry.file]
        elif _exists(folder / entry.file):
            found.append(entry)
        else:
            missing.append(entry.file)
    if missing and not (split in card.optional_splits and not found):
        raise InputError(
            folder / missing[0],
            f"no such file ({len(missing)} of the card's {split} files missing)",
            f"the files of the card '{card.name}' below {folder}",
            "check the folder and the names under [splits]",
        )
    return found


def _exists(path: Path) -> bool:
    with convert_errors(path, "cannot be looked for", "a file below the card's folder"):
        return path.exists()


def require_inside(folder: Path, path: Path) -> None:
    """Raises unless a file, links followed, lies in the folder: a card names no other files."""
    with convert_errors(path, "cannot be followed", "a file below the card's folder"):
        inside = path.resolve().is_relative_to(folder.resolve())
    if not inside:
        raise InputError(
            path, "a link that leaves the folder", f"a file below {folder}", "copy the file there"
        )


def _named(entries: list[tuple[str, FileCard]]) -> list[tuple[str, FileCard]]:
    """Names records after their files; by folder too, and by rows, where that would be doubled."""
    seen: dict[tuple[str, str], str] = {}
    for split, entry in entries:
        before = seen.setdefault((entry.file, entry.part), split)
        if before is not split:
            raise InputError(
                entry.file, f"listed in the splits {before} and {split}", "one split a file"
            )
    stems = Counter(Path(entry.file).stem for _, entry in entries)
    files = Counter(entry.file for _, entry in entries)
    named = []
    for split, entry in entries:
        name = entry.name
        if name is None:
            path, stem = Path(entry.file).with_suffix(""), Path(entry.file).stem
            same = stems[stem] == files[entry.file]
            name = stem if same else path.as_posix().replace("/", "_")
            if entry.cell is not None or files[entry.file] > 1:
                name += entry.part
            _require_default_name(name, entry.file)
        named.append((split, entry.model_copy(update={"name": name})))
    return named


def _require_default_name(name: str, file: str) -> None:
    try:
        require_name(name, file)
    except InputError as error:
        where, found = str(error).split(": ", 1)
        hint = 'give the record another: `{ file = "...", name = "..." }` under [splits]'
        raise InputError(where, found, "", hint) from None


def _natural(text: str) -> list[tuple[int, str]]:
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", text)]
