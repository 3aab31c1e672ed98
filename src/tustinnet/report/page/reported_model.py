"""Models that a report shows, with the contents of their files and run folders."""

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
from tustinnet.store.run_folder import MODEL

History = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class ReportedModel:
    """A model that a report shows.

    Attributes:
        label: its name in the report.
        model: the model.
        header: the header of its file, empty of a model without a file.
        file: its file, if there is one.
        structure: descriptions of its parts, as pairs of name and text.
        histories: the lines of its training logs, by member that was trained.
        search: the log of its identification, empty of a model that was not identified.
        scores: scores of its free runs of the records, empty where they are not computed yet.
    """

    label: str
    model: Model
    header: Mapping[str, Any] = field(default_factory=dict)
    file: Path | None = None
    structure: Sequence[tuple[str, str]] = ()
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


def read_reported_models(files: Sequence[Path], models: Sequence[Model]) -> list[ReportedModel]:
    """Reads headers and logs of models for a report.

    Args:
        files: the model files.
        models: their models.

    Raises:
        InputError: a model file that is damaged.
    """
    reported = []
    for label, file, model in zip(short_labels(files), files, models, strict=True):
        header, structure = read_description(file)
        folder = file.parent
        # of a selection the logs are in the folder of the chosen candidate
        candidate_name = (header.get("selection") or {}).get("chosen")
        if isinstance(candidate_name, str) and Path(candidate_name).name == candidate_name:
            candidate = folder / CANDIDATES / candidate_name
            folder = candidate if candidate.is_dir() else folder
        # of a candidate that was identified, the search in all records
        search = read_search_log(folder) or read_search_log(folder / WHOLE)
        reported.append(
            ReportedModel(label, model, header, file, structure, _read_histories(folder), search)
        )
    return reported


def _read_histories(folder: Path) -> dict[str, History]:
    """Reads the training logs of a run, of one of its members, or of a candidate's folds."""
    places = {"": folder}
    places |= {log.parent.name: log.parent for log in sorted(folder.glob(f"seed-*/{LOG}"))}
    for log in sorted(folder.glob(f"fold-*/seed-*/{LOG}")):
        fold = log.parent.parent.name.split("-seed")[0]
        places[f"{fold}-{log.parent.name}"] = log.parent
    logs = {name: read_log(place) for name, place in places.items()}
    return {name: lines for name, lines in logs.items() if lines}


def short_labels(files: Sequence[Path]) -> list[str]:
    """Labels of model files: the names of their run folders, if these differ."""
    names = [f.resolve().parent.name if f.name == MODEL else f.stem for f in files]
    return names if len(set(names)) == len(names) else labels(files)


def labels(files: Sequence[Path]) -> list[str]:
    """Short labels that differ: the stems of the files, with as many folders as necessary."""
    parts = [[*f.resolve().parent.parts, f.stem] for f in files]
    for depth in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [f"{'/'.join(part[-2:])} ({i + 1})" for i, part in enumerate(parts)]
