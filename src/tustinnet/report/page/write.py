"""The report: made of models and records, written as one file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.export.javascript import MODULE, TARGET
from tustinnet.export.source import make_source
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model, require_fit
from tustinnet.models.kinematics import Link
from tustinnet.report.page import told
from tustinnet.report.page.content import Thinning, content_of, thinning_of
from tustinnet.report.page.judged import Judged, judged
from tustinnet.report.page.render import rendered
from tustinnet.report.page.subject import Subject, model_file, subjects_of
from tustinnet.simulate.starts import default_start
from tustinnet.store.files import require_outputs, write_into
from tustinnet.store.model_file import load_model

ENDINGS = (".html", ".htm")
_LARGEST, _REST = 1_000_000, 250_000  # bytes of a page, and of it what is no signal and no model
_MODULES = 650_000  # bytes of all models in the playground, which leaves signals their room
MOST = 5  # models; more lines than that nobody tells apart


@dataclass(frozen=True)
class Asked:
    """How a report is made.

    Attributes:
        start: where the free runs start, None for the usual start.
        horizon: how long they last at most [s], None for whole records.
        links: how the mechanism is drawn where no model says it.
        command: what makes the report again, of all records.
        whole: how many records those given were taken from, None where they are all.
    """

    start: str | None = None
    horizon: float | None = None
    links: tuple[Link, ...] = ()
    command: str = ""
    whole: int | None = None


def write_report(
    models: Mapping[str, Model] | Sequence[str | Path],
    records: Sequence[Experiment] | Experiment,
    out: str | Path,
    *,
    start: str | None = None,
    horizon: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Writes a report of models on records: one HTML file that needs no server and no network.

    Args:
        models: model files or run folders, whose accounts of data, training and parameters are
            shown too; or models by what they are called. The first is what the report is about.
        records: the records that are simulated.
        out: the file.
        start: where the free runs start, as `evaluate` takes it; None for the usual start.
        horizon: how long a free run lasts at most [s], see `free_run`; None for whole records.
        overwrite: whether a file that is there may be replaced.

    Returns:
        The file.

    Raises:
        InputError: no models or records, or too many models; a model that is not there; records of
            other channels than the models'; a file that is there, or that ends otherwise; see also
            `evaluate`.
    """
    path = Path(out)
    files = [] if isinstance(models, Mapping) else [model_file(Path(of)) for of in models]
    require_outputs([path], overwrite=overwrite, read=files, endings=ENDINGS)
    if isinstance(models, Mapping):
        subjects = [Subject(label, model) for label, model in models.items()]
    else:
        subjects = subjects_of(files, [load_model(file) for file in files])
    listed = [records] if isinstance(records, Experiment) else list(records)
    return written(subjects, listed, path, Asked(start, horizon))


def written(
    subjects: Sequence[Subject], records: Sequence[Experiment], path: Path, asked: Asked
) -> Path:
    """Writes the report of some models, see `write_report`."""
    if not 0 < len(subjects) <= MOST:
        raise InputError("report", f"{len(subjects)} models", f"1 to {MOST}")
    if not records:
        raise InputError("report", "no records", "at least one")
    for of in subjects:
        for e in records:
            require_fit(of.model, e)
    models = [of.model for of in subjects]
    start = default_start(records, *models) if asked.start is None else asked.start
    found = [judged(of, records, start, asked.horizon) for of in subjects]
    write_into(path.parent, path.name, page_of(found, records, asked))
    return path


def page_of(found: Sequence[Judged], records: Sequence[Experiment], asked: Asked) -> str:
    """The page of models that were judged.

    Args:
        found: the models.
        records: the records that judged them.
        asked: how the report is made.
    """
    links = _links(found) or asked.links
    modules, silent = _modules(found, records)
    room = _LARGEST - _REST - sum(map(len, modules.values()))
    thinning = thinning_of(found, records, room)
    content = content_of(found, records, links, thinning.points)
    return rendered(_context(found, records, thinning, silent, asked), content, modules)


def _context(
    found: Sequence[Judged], records: Sequence[Experiment], thinning: Thinning,
    silent: Sequence[str], asked: Asked,
) -> dict[str, Any]:  # fmt: skip
    """What the template says."""
    first, channels = found[0], records[0].channels
    parameters = [told.parameters_of(of.subject) for of in found]
    return {
        "title": told.what_it_is(first.subject),
        "about": (first.subject.header.get("data") or {}).get("name", ""),
        "described": told.described(channels),
        "verdict": told.verdict(first, records, asked.whole),
        "left_out": told.left_out(first.subject, records),
        "models": [of.subject.label for of in found],
        "records": [e.name for e in records],
        "channels": channels,
        "start": first.scores[0].start,
        "scores": told.scores_table(found, records),
        "by_coordinate": told.coordinates_table(found, channels),
        "parameters": [of for of in parameters if of],
        "stages": told.stages_table(found),
        "bands": told.about_bands(found),
        "notes": [*told.notes_of(found, records), *silent],
        "about_models": told.models_table(found, records),
        "structure": told.structure_table(found),
        "about_records": told.records_table(found, records),
        "versions": told.versions(),
        "command": asked.command,
        "thinning": thinning,
        "some": asked.whole is not None and asked.whole > len(records),
        "whole": asked.whole,
        "every": max(of.every for of in found),
        "has": {
            "residuals": any(of.residuals for of in found),
            "crossed": any(len(r.cross) for of in found for r in of.residuals),
            "ahead": any(len(of.ahead) for of in found),
            "energy": any(of.energies for of in found),
            "search": any(of.subject.search for of in found),
            "training": any(of.subject.histories for of in found),
            "structure": any(of.subject.told for of in found),
            "range": any(of.range for of in found),
            "playground": len(silent) < len(found),
        },
    }


def _links(found: Sequence[Judged]) -> tuple[Link, ...]:
    """How the first model that knows it says that the mechanism is drawn."""
    for of in found:
        equations = family_of(of.subject.model).equations(of.subject.model)
        if equations is not None and equations.system.links:
            return equations.system.links
    return ()


def _modules(
    found: Sequence[Judged], records: Sequence[Experiment]
) -> tuple[dict[int, str], list[str]]:
    """The models as JavaScript by their place, and why others are not among them."""
    modules: dict[int, str] = {}
    silent = []
    for i, of in enumerate(found):
        try:
            source = make_source(of.subject.model.for_record(records[0]), of.range)
            text = str(TARGET.files(source)[MODULE])
            if len(text) + sum(map(len, modules.values())) > _MODULES:
                size = f"{len(text) / 1000:.0f} kB"
                raise InputError("its size", size, "room beside the others in a page of 1 MB")
            modules[i] = text
        except InputError as error:
            silent.append(f"{of.subject.label}: not in the playground: {error}")
    return modules, silent
