"""The sentences and tables of a report."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import KEY as SPOILED
from tustinnet.evaluate.scores import mean_rmse, mean_rmse_by_unit
from tustinnet.families.family import family_of
from tustinnet.fitting.report import BaseParameterEstimate, Estimate, ForceError
from tustinnet.models.physical_values import physical_parameters
from tustinnet.models.written_equations import equations_header
from tustinnet.report.extrapolation import describe_extrapolation
from tustinnet.report.fits import (
    ESTIMATE_COLUMNS,
    base_parameter_table,
    estimate_cells,
    estimates_table,
    estimates_title,
    force_errors_table,
    is_many,
    position_in_range,
    split_informed,
)
from tustinnet.report.page.model_result import ModelResult
from tustinnet.report.page.reported_model import ReportedModel
from tustinnet.report.tables import Table, amounts, number, numbers
from tustinnet.selection.jobs import LEFT_OUT
from tustinnet.simulate.horizon import horizon_words
from tustinnet.store.header import find_fitted, records_in_header
from tustinnet.wording import counted, join_words, percent

_CHECKSUM_DIGITS = 12  # of a checksum


@dataclass(frozen=True)
class ParameterGroup:
    """The parameters of a model, for a table.

    Attributes:
        label: label of the model.
        title: source of the errors.
        is_collapsed: whether the table is shown only on request.
        table: names, values and, where they are known, errors.
        places: position of interval and value of each row in its range, 0..1: low, value, high;
            None of a row without a range.
    """

    label: str
    title: str
    table: Table
    places: Sequence[tuple[float, float, float] | None]
    is_collapsed: bool = False


# --- sentences ---


def model_title(reported: ReportedModel) -> str:
    """Heading of the report: the kind of the model and its coordinates."""
    family = family_of(reported.model)
    kind = family.title or family.kind
    article = "An" if kind[:1].lower() in "aeiou" else "A"
    return f"{article} {kind} model of {join_words(c.name for c in reported.model.coordinates)}"


def describe_inputs(channels: Channels) -> str:
    """Sentence on inputs and sampling period, below the heading."""
    inputs = [f"{i.name} ({i.unit})" if i.unit else i.name for i in channels.inputs]
    driven = f"Driven by {join_words(inputs)}" if inputs else "Without inputs"
    return f"{driven}, in steps of {channels.dt * 1e3:g} ms."


def describe_accuracy(
    result: ModelResult, records: Sequence[Experiment], total_records: int | None = None
) -> str:
    """Sentence on the accuracy of a model, with the records that it refers to.

    Args:
        result: results of the model.
        records: the records that it was scored on.
        total_records: number of records that these were chosen from, None where they are all.
    """
    channels, scores, reported = records[0].channels, result.scores, result.reported
    if len(channels.units) == 1:
        worst, best = max(scores, key=lambda s: s.rmse), min(scores, key=lambda s: s.rmse)
        mean, high, low = numbers([mean_rmse(scores), worst.rmse, best.rmse])
        mean, measure = f"{mean} {channels.unit}", ""
    else:
        mean = amounts(mean_rmse_by_unit(scores, channels))
        worst = max(scores, key=lambda s: s.mean_nrmse)
        best = min(scores, key=lambda s: s.mean_nrmse)
        low, high = (f"{percent(s.mean_nrmse)} %" for s in (best, worst))
        measure = " of the motion's standard deviation"
    spread = ""
    if scores[1:]:
        spread = f" ({low}{measure} on {best.experiment}, {high} on {worst.experiment})"
    splits = " and ".join(dict.fromkeys(e.split for e in records if e.split))
    is_shortened = total_records is not None and total_records > len(records)
    record_text = (
        f"{len(records)} {f'of {total_records} ' if is_shortened else ''}"
        f"{f'{splits} ' if splits else ''}record{'s' if records[1:] or is_shortened else ''}"
    )
    if reported.header.get("data") or reported.header.get("files"):
        trained = len(trained_on(reported, records))
        if not trained:
            record_text += " that it was not fitted to"
        else:
            count = "all" if trained == len(records) else trained
            record_text += f", {count} of which it was fitted to"
    return (
        f"Simulated from its start alone{horizon_words(scores[0].horizon)}, "
        f"it is off by {mean} "
        f"{'on average over' if scores[1:] else 'on'} {record_text}{spread}."
        f"{_describe_whole(result, channels)}"
    )


def _describe_whole(result: ModelResult, channels: Channels) -> str:
    """Sentence on free runs of whole records where those that are shown restart; else empty."""
    if result.scores[0].horizon is None:
        return ""
    diverging = [s for s in result.whole if not np.isfinite(s.rmse)]
    if diverging:
        return f" Without restarts, it diverges on {len(diverging)} of {len(result.whole)}."
    return f" Without restarts, it is off by {amounts(mean_rmse_by_unit(result.whole, channels))}."


def describe_fold_scores(reported: ReportedModel, records: Sequence[Experiment]) -> str:
    """Sentence on the scores of models of other folds, for a model that was fitted to all records.

    Nothing else says how accurate such a model is on other records. Empty for other models.
    """
    scores = reported.header.get("scores") or {}
    if scores.get("split") != LEFT_OUT or not trained_on(reported, records):
        return ""
    if scores.get("mean") is None:
        return "Models made in the same way diverge on some records that they were not fitted to."
    error, unit, count = (scores.get(k) for k in ("standard_error", "unit", "rmse"))
    spread = f" ± {error:.2g}" if error else ""
    size = f"{number(scores['mean'])}{spread} {unit or ''}".strip()
    if " and " in (unit or ""):
        size += " (norm over all coordinates)"
    return (
        f"On records that they were not fitted to{horizon_words(scores.get('horizon'))}, models "
        f"made in the same way are off by {size} on average "
        f"({counted(len(count or ()), 'record')}, on folds)."
    )


def trained_on(reported: ReportedModel, records: Sequence[Experiment]) -> list[str]:
    """Names of those records that a model was fitted to."""
    return find_fitted(reported.header, records)


def describe_bands(results: Sequence[ModelResult]) -> str:
    """Sentence on the bands that are drawn; empty where there are none."""
    levels = [
        f"{100 * result.bands[0].level:.3g} % ({result.reported.label})"
        for result in results
        if result.bands
    ]
    return f"Shaded: bands that contain {join_words(levels)} of the time." if levels else ""


def list_notes(results: Sequence[ModelResult], records: Sequence[Experiment]) -> list[str]:
    """Lists warnings on the results: missing results, extrapolations, findings of the search."""
    notes = []
    for result in results:
        label = result.reported.label
        notes += [f"{label}: {note}" for note in result.notes]
        notes += [
            f"{label}, {e.name}: {describe_extrapolation(point, e.dt)}"
            for e, point in zip(records, result.extrapolations, strict=True)
            if point is not None
        ]
        notes += [f"{label}: {f['text']}" for f in result.reported.header.get("findings", ())]
        spoiled = result.reported.header.get(SPOILED) or {}
        notes += [f"{label}: spoiled: {part['sentence']}" for part in spoiled.get("parts", ())]
        notes += [f"{label}: {f['text']}" for f in spoiled.get("left_out", ())]
    return list(dict.fromkeys(notes))


# --- tables ---


def coordinates_table(results: Sequence[ModelResult], channels: Channels) -> Table:
    """Table of RMSE, NRMSE and fit of every coordinate, means over the records."""
    rows = []
    for result in results:
        measures = [
            np.mean([getattr(s, name) for s in result.scores], axis=0).tolist()
            for name in ("coordinate_rmse", "nrmse", "fit_percent")
        ]
        for c, rmse, nrmse, fit in zip(channels.coordinates, *measures, strict=True):
            cells = [f"{number(rmse)} {c.unit}", number(nrmse), number(fit, 1)]
            rows.append([result.reported.label, c.name, *cells])
    return Table(
        ["model", "coordinate", "RMSE", "NRMSE", "fit [%]"], rows, "Means over the records"
    )


def parameters_of(reported: ReportedModel) -> list[ParameterGroup]:
    """The parameters of a model, with both kinds of errors if it was identified.

    Of many parameters those that the records tell little about are a group of their own.
    """
    identification = reported.header.get("identification")
    values = physical_parameters(reported.model)
    units = {name: unit for name, unit, _ in values}
    if identification is None:
        rows = [[name, f"{value:.4g}", unit] for name, unit, value in values]
        table = Table(ESTIMATE_COLUMNS[:3], rows)
        places = [None] * len(rows)
        return [ParameterGroup(reported.label, "values", table, places)] if rows else []
    estimates = [
        Estimate(**e | {"interval": e["interval"] and tuple(e["interval"])})
        for e in identification["estimates"]
    ]
    refined = (identification.get("refined") or {}).get("values")
    title = estimates_title(identification["trust"], refined)
    fixed = [
        [name, f"{value:.4g}", units.get(name, ""), "fixed", "", "", ""]
        for name, value in identification["fixed"].items()
    ]
    shown, others = split_informed(estimates)
    few_fixed, many_fixed = ([], fixed) if is_many([*estimates, *fixed]) else (fixed, [])
    table = estimates_table([*map(estimate_cells, shown), *few_fixed], refined)
    places = [*map(_place, shown), *[None] * len(few_fixed)]
    groups = [ParameterGroup(reported.label, title, table, places)]
    if others or many_fixed:
        table = estimates_table([*map(estimate_cells, others), *many_fixed], refined)
        parts = [
            *([f"{len(others)} that the records tell little about"] if others else []),
            *([f"{len(many_fixed)} that are fixed"] if many_fixed else []),
        ]
        title = f"other parameters: {' and '.join(parts)}"
        places = [*map(_place, others), *[None] * len(many_fixed)]
        groups.append(ParameterGroup(reported.label, title, table, places, is_collapsed=True))
    return groups


def equations_of(results: Sequence[ModelResult]) -> list[tuple[str, tuple[str, ...]]]:
    """The equations of motion of each model that has some which can be read, by its label."""
    written = {r.reported.label: equations_header(r.reported.model) for r in results}
    return [(label, header["equations"]) for label, header in written.items() if header]


def _place(e: Estimate) -> tuple[float, float, float]:
    """Position of interval and value of a parameter in its range: low, value, high."""
    low, high = e.interval or (e.value, e.value)
    low, value, high = (position_in_range(e, x) for x in (low, e.value, high))
    return low, value, high


def base_parameter_tables(results: Sequence[ModelResult]) -> list[Table]:
    """Tables of the base parameters of the models that were identified by inverse dynamics."""
    tables = []
    for result in results:
        identification = result.reported.header.get("identification") or {}
        estimates = [
            BaseParameterEstimate(**b | {"interval": b["interval"] and tuple(b["interval"])})
            for b in identification.get("base_parameters", ())
        ]
        if estimates:
            title = f"{result.reported.label}: {counted(len(estimates), 'base parameter')}"
            tables.append(base_parameter_table(estimates, title))
    return tables


def forces_table(results: Sequence[ModelResult]) -> Table | None:
    """Table of the forces that are missing at each coordinate; None without inverse dynamics."""
    errors: dict[str, list[ForceError]] = {}
    for result in results:
        identification = result.reported.header.get("identification") or {}
        for e in identification.get("force_errors", ()):
            errors.setdefault(f"{result.reported.label}, {e['split']}", []).append(ForceError(**e))
    return force_errors_table(errors) if errors else None


def stages_table(results: Sequence[ModelResult]) -> Table:
    """Table of the stages of every identification, and how they ended."""
    rows = []
    for result in results:
        rows += [
            [
                result.reported.label,
                f"{i}: {stage['stage']}",
                str(stage["iterations"]),
                "–" if stage["cost"] is None else f"{stage['cost']:.4g}",
                stage["why"],
            ]
            for i, stage in enumerate(result.reported.stages, 1)
        ]
    return Table(["model", "stage", "iterations", "cost", "ended"], rows)


def models_table(results: Sequence[ModelResult], records: Sequence[Experiment]) -> Table:
    """Table of the sources of the models: recipe, records, file, versions."""
    rows = []
    for reported in (result.reported for result in results):
        header, file = reported.header, reported.file
        recipe, training = header.get("recipe") or {}, header.get("training") or {}
        seed = f", seed {training['seed']}" if "seed" in training else ""
        count = len(records_in_header(header))
        rows.append(
            [
                reported.label,
                family_of(reported.model).kind,
                f"{recipe['name']}{seed}" if recipe else "–",
                f"{counted(count, 'log')} of {header['data']['name']}"
                if header.get("data")
                else "–",
                hashlib.sha256(file.read_bytes()).hexdigest()[:_CHECKSUM_DIGITS] if file else "–",
                " ".join(f"{k} {v}" for k, v in (header.get("versions") or {}).items()) or "–",
            ]
        )
    return Table(["model", "kind", "recipe", "fitted to", "SHA-256", "made with"], rows)


def structure_table(results: Sequence[ModelResult]) -> Table:
    """Table of the parts of the models."""
    rows = [
        [result.reported.label, part, text]
        for result in results
        for part, text in result.reported.structure
        if part != "values"
    ]
    return Table(["model", "part", "what it is"], rows)


def records_table(results: Sequence[ModelResult], records: Sequence[Experiment]) -> Table:
    """Table of the records, with the models that were fitted to them."""
    trained = {r.reported.label: trained_on(r.reported, records) for r in results}
    rows = [
        [
            e.name,
            e.split or "–",
            str(len(e)),
            f"{e.seconds:.4g}",
            ", ".join(label for label, names in trained.items() if e.name in names) or "–",
            e.sha256[:_CHECKSUM_DIGITS] or "–",
        ]
        for e in records
    ]
    columns = ["record", "split", "samples", "length [s]", "models fitted to it", "SHA-256"]
    return Table(columns, rows)
