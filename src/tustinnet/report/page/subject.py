"""The models that a report is about, with what their files and folders tell of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score
from tustinnet.models.contract import Model
from tustinnet.selection.final_models import WHOLE
from tustinnet.store.header import read_description
from tustinnet.store.kept_system import CANDIDATES
from tustinnet.store.log import LOG, is_stage_end, read_log, read_search_log
from tustinnet.store.run import MODEL

History = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Subject:
    """A model that is reported on.

    Attributes:
        label: what it is called.
        model: the model.
        header: what its file says, empty of a model that is in none.
        file: its file, if it is in one.
        told: what its family tells of the file, as words and what they say.
        histories: its training logs, by the member that was trained.
        search: the log of its identification, none of a model that was not identified.
        scores: its free runs of the records, none where they are not known yet.
    """

    label: str
    model: Model
    header: Mapping[str, Any] = field(default_factory=dict)
    file: Path | None = None
    told: Sequence[tuple[str, str]] = ()
    histories: Mapping[str, History] = field(default_factory=dict)
    search: History = ()
    scores: Sequence[Score] = ()

    @property
    def stages(self) -> list[Mapping[str, Any]]:
        """The ends of the stages of its identification, with the parameters there."""
        return [line for line in self.search if is_stage_end(line)]


def model_file(path: Path) -> Path:
    """The model file that a path names: the file itself, or that of a run folder.

    Raises:
        InputError: a folder without a model.
    """
    if not path.is_dir():
        return path
    if not (path / MODEL).is_file():
        raise InputError(path, f"a folder without {MODEL}", "a run folder, or a model file")
    return path / MODEL


def subjects_of(files: Sequence[Path], models: Sequence[Model]) -> list[Subject]:
    """Models with what their files and the folders of their runs tell.

    Args:
        files: the model files.
        models: their models.

    Raises:
        InputError: a model file that is damaged.
    """
    found = []
    for label, file, model in zip(short_labels(files), files, models, strict=True):
        header, told = read_description(file)
        folder = _made_in(file.parent, header)
        found.append(Subject(label, model, header, file, told, _histories(folder), _search(folder)))
    return found


def _made_in(folder: Path, header: Mapping[str, Any]) -> Path:
    """The folder that has the logs of a model: of a selection that of the chosen candidate."""
    chosen = (header.get("selection") or {}).get("chosen")
    if not isinstance(chosen, str) or Path(chosen).name != chosen:
        return folder
    below = folder / CANDIDATES / chosen
    return below if below.is_dir() else folder


def _histories(folder: Path) -> dict[str, History]:
    """The training logs of a run, of one of its members, or of a candidate's folds."""
    places = {"": folder}
    places |= {log.parent.name: log.parent for log in sorted(folder.glob(f"seed-*/{LOG}"))}
    for log in sorted(folder.glob(f"fold-*/seed-*/{LOG}")):
        fold = log.parent.parent.name.split("-seed")[0]
        places[f"{fold}-{log.parent.name}"] = log.parent
    logs = {name: read_log(place) for name, place in places.items()}
    return {name: lines for name, lines in logs.items() if lines}


def _search(folder: Path) -> History:
    """The log of an identification, of a candidate that from all records."""
    return read_search_log(folder) or read_search_log(folder / WHOLE)


def short_labels(files: Sequence[Path]) -> list[str]:
    """Names of model files: those of their run folders, where these differ."""
    names = [f.resolve().parent.name if f.name == MODEL else f.stem for f in files]
    return names if len(set(names)) == len(names) else labels(files)


def labels(files: Sequence[Path]) -> list[str]:
    """Short names that differ: the files' stems, with as many folders as it takes."""
    parts = [[*f.resolve().parent.parts, f.stem] for f in files]
    for depth in range(1, max(map(len, parts)) + 1):
        found = ["/".join(part[-depth:]) for part in parts]
        if len(set(found)) == len(found):
            return found
    return [f"{'/'.join(part[-2:])} ({i + 1})" for i, part in enumerate(parts)]
