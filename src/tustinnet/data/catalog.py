"""Data sets by name, by card or by folder."""

import difflib
import hashlib
import os
import shlex
import tempfile
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from tustinnet.data.card import Card, FileCard
from tustinnet.data.card_files import list_logs_in, list_record_files
from tustinnet.data.dataset import DataSet
from tustinnet.data.declaration import read_declaration
from tustinnet.data.loading import load_folder
from tustinnet.data.readers import is_log
from tustinnet.errors import InputError, describe_error
from tustinnet.user_folders import cache_folder

CARD_NAME = "dataset.toml"
DATA_VARIABLE = "TUSTINNET_DATA"


@dataclass(frozen=True)
class PublishedDataSet:
    """A published data set whose card and checksums are part of the package.

    Attributes:
        name: name in the catalog.
        stem: name of the packaged card and checksum file.
        address: URL of the folder with its files.
    """

    name: str
    stem: str
    address: str

    def card(self) -> Card:
        """The packaged data card."""
        with resources.as_file(self._resource(".toml")) as path:
            return read_declaration(path, Card)

    def checksums(self) -> dict[str, str]:
        """SHA-256 of every file, by path below the data set's folder."""
        lines = self._resource(".sha256").read_text(encoding="utf-8").split("\n")
        return {file: digest for digest, file in (line.split() for line in lines if line)}

    def cache(self) -> Path:
        """The folder of downloaded files."""
        return cache_folder() / self.stem

    def changed_files(self, folder: Path) -> list[str]:
        """Files that are in a folder but are not the published ones."""
        return [
            file
            for file, digest in self.checksums().items()
            if (folder / file).is_file()
            and hashlib.sha256((folder / file).read_bytes()).hexdigest() != digest
        ]

    def is_in(self, folder: Path) -> bool:
        """Whether a folder holds files with the names of this data set's."""
        return any((folder / file).is_file() for file in self.checksums())

    def _resource(self, ending: str) -> Traversable:
        return resources.files("tustinnet.data") / "cards" / f"{self.stem}{ending}"


QUBE_SERVO2 = PublishedDataSet(
    name="qube-servo2",
    stem="qube_servo2",
    address="https://raw.githubusercontent.com/svanesch/tustinNetTransferLearning/"
    "178ba573691489d9f79a504b2010247663ed3bc2/data/",
)
CATALOG = {entry.name: entry for entry in (QUBE_SERVO2,)}


def load(data: str | Path, card: str | Path | None = None) -> DataSet:
    """Reads a data set.

    Args:
        data: a name of the catalog (`qube-servo2`), a data card, a folder that holds
            `dataset.toml` or the files of a data set of the catalog, or one log of such a folder.
        card: a data card for the folder `data`, or that of the log, where it has none of its own.

    Raises:
        InputError: no data set there; the message says what was expected.
    """
    return load_folder(*locate(data, card))


def locate(data: str | Path, card: str | Path | None = None) -> tuple[Path, Card]:
    """The folder and the card that a name, card, folder or log stands for (see `load`)."""
    path = Path(data)
    if path.is_file() and is_log(path):
        above = [] if card else [p for p in list(path.parents)[:2] if (p / CARD_NAME).is_file()]
        folder, of_folder = locate(above[0] if above else path.parent, card)
        return folder, _keep_only(path.relative_to(folder).as_posix(), folder, of_folder)
    if card is not None:
        folder = find_folder(CATALOG[str(data)]) if str(data) in CATALOG else path
        _require_folder(folder)
        return folder, _for_folder(folder, read_declaration(Path(card), Card))
    if str(data) in CATALOG:
        entry = CATALOG[str(data)]
        return find_folder(entry), entry.card()
    if path.suffix == ".toml":
        return path.parent, read_declaration(path, Card)
    _require_folder(path)
    if (path / CARD_NAME).is_file():
        return path, read_declaration(path / CARD_NAME, Card)
    for entry in CATALOG.values():
        if entry.is_in(path):
            return path, entry.card()
    logs = (file for pattern in ("*", "*/*") for file in sorted(path.glob(pattern)))
    if not any(is_log(file) for file in logs):
        raise InputError(
            path,
            f"no logs and no {CARD_NAME}",
            "files of columns, such as .csv, .parquet or .mat",
            "check the folder (other formats: docs/how-to/add-a-reader.md), or give `card=` FILE",
        )
    raise InputError(
        path,
        f"no {CARD_NAME} and no data set of the catalog in this folder",
        "a data card that says what the columns mean",
        f"`tustinnet init {shlex.quote(str(path))}` writes one, or give `card=` FILE",
    )


def _for_folder(folder: Path, card: Card) -> Card:
    """A card for a folder: where none of its files are there, all logs are test records."""
    if not card.splits or _list_there(folder, card):
        return card
    files = [FileCard(file=file) for file in list_logs_in(folder)]
    return card.model_copy(update={"splits": {"test": files}}) if files else card


def _list_there(folder: Path, card: Card) -> list[tuple[str | None, FileCard]]:
    """The files of a card with their splits, as far as they are there."""
    all_optional = card.model_copy(update={"optional_splits": [*card.splits]})
    return list_record_files(folder, all_optional) if card.splits else []


def _keep_only(file: str, folder: Path, card: Card) -> Card:
    """A card of one log: as it is named there, or a test record where it is not."""
    named = _list_there(folder, card)
    kept = {split: [e for s, e in named if s == split and e.file == file] for split, _ in named}
    splits = {split: entries for split, entries in kept.items() if entries}
    return card.model_copy(update={"splits": splits or {"test": [FileCard(file=file)]}})


def lacks_card(data: str | Path) -> bool:
    """Whether `data` is a folder of logs that neither a card in it nor the catalog describes."""
    path = Path(data)
    if str(data) in CATALOG or not path.is_dir() or (path / CARD_NAME).is_file():
        return False
    if any(entry.is_in(path) for entry in CATALOG.values()):
        return False
    return any(is_log(file) for pattern in ("*", "*/*") for file in path.glob(pattern))


def list_input_files(data: str | Path, card: str | Path | None = None) -> list[Path]:
    """The files that `load` reads: card and records.

    Raises:
        InputError: as `load`.
    """
    folder, content = locate(data, card)
    path = Path(data)
    default = path if path.suffix == ".toml" else folder / CARD_NAME
    entries = [entry for _, entry in list_record_files(folder, content)]
    records = [folder / file for e in entries for file in (e.file, *e.join.values())]
    return [default if card is None else Path(card), *records]


def find_folder(entry: PublishedDataSet) -> Path:
    """The folder of a published data set: TUSTINNET_DATA, else the cache, else a download."""
    value = os.environ.get(DATA_VARIABLE)
    if value:
        for folder in (Path(value), Path(value) / entry.stem, Path(value) / entry.name):
            if entry.is_in(folder):
                return folder
        raise InputError(
            f"{DATA_VARIABLE}={value}",
            f"no files of '{entry.name}' there",
            f"a folder with {_describe_files(entry)}",
            f"correct or unset {DATA_VARIABLE}",
        )
    return _download(entry)


def _download(entry: PublishedDataSet) -> Path:
    """Downloads the files that the cache lacks, each checked against its checksum."""
    # imported here: it takes longer to load than `tustinnet --help` may
    from http.client import HTTPException
    from urllib.error import HTTPError, URLError
    from urllib.request import urlopen

    cache, changed = entry.cache(), entry.changed_files(entry.cache())
    for file, digest in entry.checksums().items():
        path = cache / file
        if path.is_file() and file not in changed:
            continue
        try:
            with urlopen(f"{entry.address}{file}", timeout=30) as reply:
                content = reply.read()
            if hashlib.sha256(content).hexdigest() != digest:
                raise ValueError("its checksum is another one")
            path.parent.mkdir(parents=True, exist_ok=True)
            # whole or not at all, and nothing is left where it cannot be written
            with tempfile.TemporaryDirectory(dir=path.parent) as folder:
                part = Path(folder, path.name)
                part.write_bytes(content)
                part.replace(path)
        except (OSError, ValueError, HTTPException) as error:
            is_offline = isinstance(error, URLError) and not isinstance(error, HTTPError)
            reason = "no connection" if is_offline else describe_error(error)
            raise InputError(
                f"data set '{entry.name}'",
                f"{entry.address}{file} could not be fetched ({reason})",
                f"{len(entry.checksums())} files ({_describe_files(entry)})",
                f"put them into {cache} in these subfolders, or give their folder with "
                f"`data=` PATH or {DATA_VARIABLE}=PATH",
            ) from error
    return cache


def _describe_files(entry: PublishedDataSet) -> str:
    files = sorted(entry.checksums())
    folders = sorted({Path(file).parent.as_posix() for file in files})
    return f"{files[0]}, ... in the subfolders {', '.join(folders)}"


def _require_folder(path: Path) -> None:
    if path.is_dir():
        return
    near = difflib.get_close_matches(str(path), CATALOG, n=1)
    raise InputError(
        path,
        "a file" if path.exists() else "no such folder",
        f"a folder, a log, a data card or a name of the catalog ({', '.join(CATALOG)})",
        f"did you mean '{near[0]}'?" if near else "",
    )
