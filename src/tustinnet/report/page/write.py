"""The HTML report of models on records, written as one file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.export.javascript import MODULE, TARGET
from tustinnet.export.source import make_source
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model, require_fit
from tustinnet.models.kinematics import Link
from tustinnet.report.comparison import comparison_table
from tustinnet.report.page import text_and_tables as text
from tustinnet.report.page.content import DRAWN_INPUTS, Thinning, choose_thinning, make_content
from tustinnet.report.page.model_result import ModelResult, compute_model_result
from tustinnet.report.page.render import render
from tustinnet.report.page.reported_model import ReportedModel, model_file, read_reported_models
from tustinnet.simulate.starts import default_start
from tustinnet.store.files import require_outputs, write_into
from tustinnet.store.judgement import judged_free_runs, usual_split
from tustinnet.store.model_file import load_model, package_versions

ENDINGS = (".html", ".htm")
_ALL = "all"  # in the place of a split: all records
# bytes of a page, and of that for everything except signals and models
_MAX_PAGE, _FRAME = 1_000_000, 250_000
_MAX_MODULES = 650_000  # bytes of all models in the playground, so that signals have room
MAX_MODELS = 5  # the lines of more cannot be told apart


@dataclass(frozen=True)
class ReportOptions:
    """Options of a report.

    Attributes:
        start: where the free runs start, None for the usual start.
        horizon: longest duration of a free run [s], None for whole records.
        links: links that draw the mechanism where no model has any.
        command: command that writes the report again, of all records.
        total_records: number of records that those shown were chosen from, None where all are
            shown.
    """

    start: str | None = None
    horizon: float | None = None
    links: tuple[Link, ...] = ()
    command: str = ""
    total_records: int | None = None


def write_report(
    models: Mapping[str, Model] | Sequence[str | Path],
    records: DataSet | Sequence[Experiment] | Experiment,
    out: str | Path,
    *,
    split: str | None = None,
    start: str | None = None,
    horizon: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Writes a report of models on records: one HTML file that needs no server and no network.

    Split, start and horizon are by default those of the command `report`: what the files say.

    Args:
        models: model files or run folders, whose data, training and parameters are also shown;
            or models by label. The report is about the first.
        records: the records that are simulated.
        out: the file.
        split: the split of a data set, `all` for all of its records; None for `test`, else
            `validation`, else all.
        start: where the free runs start, as for `evaluate`; None for that by which the files say
            that the models were judged, else the usual start.
        horizon: longest duration of a free run [s], see `free_run`; infinite for whole records,
            None for that of the files, else whole records.
        overwrite: whether an existing file may be replaced.

    Returns:
        The file.

    Raises:
        InputError: no models or records, or too many models; a model that does not exist; records
            of other channels than the models'; a split of records that are no data set; a file
            that exists, or that has another ending; see also `evaluate`.
    """
    path = Path(out)
    files = [] if isinstance(models, Mapping) else [model_file(Path(model)) for model in models]
    require_outputs([path], overwrite=overwrite, read=files, endings=ENDINGS)
    if isinstance(models, Mapping):
        reported = [ReportedModel(label, model) for label, model in models.items()]
    else:
        reported = read_reported_models(files, [load_model(file) for file in files])
    record_list = _choose_records(records, split)
    headers = {m.file: m.header for m in reported if m.file is not None}
    if headers:
        file_start, file_horizon = judged_free_runs(headers, record_list)
        start = file_start if start is None else start
        horizon = file_horizon if horizon is None else horizon
    horizon = None if horizon == math.inf else horizon
    return write_page(reported, record_list, path, ReportOptions(start, horizon))


def _choose_records(
    records: Sequence[Experiment] | DataSet | Experiment, split: str | None
) -> list[Experiment]:
    """The records of a split of a data set, by default the usual one; others as they are."""
    if isinstance(records, DataSet):
        split = split or usual_split(records) or _ALL
        return [*records] if split == _ALL else [*records.split(split)]
    if split is not None:
        raise InputError("split", f"'{split}' of records that are no data set", "a DataSet")
    return [records] if isinstance(records, Experiment) else [*records]


def write_page(
    models: Sequence[ReportedModel],
    records: Sequence[Experiment],
    path: Path,
    options: ReportOptions,
) -> Path:
    """Computes the results of models on records and writes the report, see `write_report`."""
    if not 0 < len(models) <= MAX_MODELS:
        raise InputError("report", f"{len(models)} models", f"1 to {MAX_MODELS}")
    if not records:
        raise InputError("report", "no records", "at least one")
    for reported in models:
        for e in records:
            require_fit(reported.model, e)
    start = options.start
    if start is None:
        start = default_start(records, *[reported.model for reported in models])
    results = [compute_model_result(m, records, start, options.horizon) for m in models]
    write_into(path.parent, path.name, make_page(results, records, options))
    return path


def make_page(
    results: Sequence[ModelResult], records: Sequence[Experiment], options: ReportOptions
) -> str:
    """Makes the page as HTML.

    Args:
        results: the models with their results.
        records: the records.
        options: options of the report.
    """
    equations = [family_of(r.reported.model).equations(r.reported.model) for r in results]
    model_links = [e.system.links for e in equations if e is not None and e.system.links]
    links = model_links[0] if model_links else options.links
    modules, refusals = _export_models(results, records)
    room = _MAX_PAGE - _FRAME - sum(map(len, modules.values()))
    thinning = choose_thinning(results, records, room)
    content = make_content(results, records, links, thinning.points)
    return render(_make_context(results, records, thinning, refusals, options), content, modules)


def _make_context(
    results: Sequence[ModelResult],
    records: Sequence[Experiment],
    thinning: Thinning,
    refusals: Sequence[str],
    options: ReportOptions,
) -> dict[str, Any]:
    """Makes the variables of the template."""
    first, channels = results[0], records[0].channels
    start, scores = first.scores[0].start, {r.reported.label: r.scores for r in results}
    reported, total = first.reported, options.total_records
    parameters = [text.parameters_of(result.reported) for result in results]
    return {
        "title": text.model_title(reported),
        "data_name": (reported.header.get("data") or {}).get("name", ""),
        "inputs": text.describe_inputs(channels),
        "inputs_count": channels.n_u,
        "drawn_inputs": DRAWN_INPUTS,
        "verdict": text.describe_accuracy(first, records, total),
        "fold_scores": text.describe_fold_scores(reported, records),
        "models": [result.reported.label for result in results],
        "records": [e.name for e in records],
        "channels": channels,
        "start": start,
        "horizon": first.scores[0].horizon,
        "scores": comparison_table(records, scores, start),
        "by_coordinate": text.coordinates_table(results, channels),
        "parameters": [group for groups in parameters for group in groups],
        "equations": text.equations_of(results),
        "base_parameters": text.base_parameter_tables(results),
        "forces": text.forces_table(results),
        "stages": text.stages_table(results),
        "bands": text.describe_bands(results),
        "notes": [*text.list_notes(results, records), *refusals],
        "model_sources": text.models_table(results, records),
        "structure": text.structure_table(results),
        "record_sources": text.records_table(results, records),
        "versions": ", ".join(f"{name} {v}" for name, v in package_versions().items()),
        "command": options.command,
        "thinning": thinning,
        "is_shortened": total is not None and total > len(records),
        "total_records": total,
        "every": max(result.every for result in results),
        "has": {
            "residuals": any(result.residuals for result in results),
            "crossed": any(len(r.cross) for result in results for r in result.residuals),
            "ahead": any(len(result.ahead) for result in results),
            "energy": any(result.energies for result in results),
            "search": any(result.reported.stages for result in results),
            "training": any(result.reported.histories for result in results),
            "structure": any(result.reported.structure for result in results),
            "range": any(result.range for result in results),
            "playground": len(refusals) < len(results),
        },
    }


def _export_models(
    results: Sequence[ModelResult], records: Sequence[Experiment]
) -> tuple[dict[int, str], list[str]]:
    """Exports the models to JavaScript, by their index; also returns why others are missing."""
    modules: dict[int, str] = {}
    refusals = []
    for i, result in enumerate(results):
        try:
            source = make_source(result.reported.model.for_record(records[0]), result.range)
            module = str(TARGET.files(source)[MODULE])
            if len(module) + sum(map(len, modules.values())) > _MAX_MODULES:
                size = f"{len(module) / 1000:.0f} kB"
                raise InputError("its size", size, "room beside the others in a page of 1 MB")
            modules[i] = module
        except InputError as error:
            refusals.append(f"{result.reported.label}: not in the playground: {error}")
    return modules, refusals
