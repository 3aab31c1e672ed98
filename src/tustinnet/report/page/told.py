"""What a report says in words and tables."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.errors import refusing
from tustinnet.evaluate.scores import mean_rmse
from tustinnet.families.family import family_of
from tustinnet.fitting.report import Estimate
from tustinnet.report.comparison import comparison_table
from tustinnet.report.fits import (
    ESTIMATE_COLUMNS,
    estimate_cells,
    estimates_table,
    estimates_title,
    place,
)
from tustinnet.report.leaving import left_words
from tustinnet.report.page.judged import Judged
from tustinnet.report.page.subject import Subject
from tustinnet.report.tables import Table, number, numbers
from tustinnet.selection.jobs import LEFT_OUT
from tustinnet.simulate.horizon import over
from tustinnet.store.header import records_in_header
from tustinnet.store.model_file import package_versions

_SHOWN = 12  # digits of a checksum


@dataclass(frozen=True)
class Parameters:
    """The parameters of a model.

    Attributes:
        label: the model.
        title: where the errors are from.
        table: names, values and, where they are known, errors.
        places: of each row where its interval and value stand in its range, 0..1: low, value,
            high; None of a row without a range.
    """

    label: str
    title: str
    table: Table
    places: Sequence[tuple[float, float, float] | None]


def what_it_is(subject: Subject) -> str:
    """What a model is, as a heading."""
    family = family_of(subject.model)
    kind = family.spelt or family.kind
    return f"{_article(kind)} {kind} model of {listed(_names(subject.model.channels))}"


def described(channels: Channels) -> str:
    """Inputs and sampling period, as the sentence below the heading."""
    inputs = [f"{i.name} ({i.unit})" if i.unit else i.name for i in channels.inputs]
    driven = f"Driven by {listed(inputs)}" if inputs else "Without inputs"
    return f"{driven}, in steps of {channels.dt * 1e3:g} ms."


def verdict(of: Judged, records: Sequence[Experiment], whole: int | None = None) -> str:
    """How good a model is, and on which records, in one sentence.

    Args:
        of: the model.
        records: the records that judged it.
        whole: how many records these were taken from, None where they are all.
    """
    unit, scores = records[0].channels.unit, of.scores
    worst, best = max(scores, key=lambda s: s.rmse), min(scores, key=lambda s: s.rmse)
    mean, high, low = numbers([mean_rmse(scores), worst.rmse, best.rmse])
    spread = f" ({low} on {best.experiment}, {high} on {worst.experiment})" if scores[1:] else ""
    begin = "Simulated from its start alone" + over(scores[0].horizon)
    return (
        f"{begin}, it is off by {mean} {unit} {'on average over' if scores[1:] else 'on'} "
        f"{_records(of.subject, records, whole)}{spread}."
    )


def left_out(subject: Subject, records: Sequence[Experiment]) -> str:
    """What models of the same kind came to on records left out of their fits, where folds say it.

    Of a model that was fitted to all of its records, nothing else tells how good it is elsewhere.
    """
    told = subject.header.get("scores") or {}
    if told.get("split") != LEFT_OUT or not trained_on(subject, records):
        return ""
    if told.get("mean") is None:
        return (
            "Models made in the same way leave all bounds on some records that they were not "
            "fitted to."
        )
    with refusing(subject.label, "scores that are damaged", "those that `fit` writes"):
        mean, error = float(told["mean"]), told.get("standard_error")
        spread = f" ± {error:.2g}" if error else ""
        off = f"{number(mean)}{spread} {told['unit']}"
        many = len(told["rmse"])
    return (
        "On records that they were not fitted to, models made in the same way are off by "
        f"{off} on average ({many} records, on folds)."
    )


def _records(subject: Subject, records: Sequence[Experiment], whole: int | None) -> str:
    """Which records, and whether the model was fitted to them."""
    splits = list(dict.fromkeys(e.split for e in records if e.split))
    kind = f"{' and '.join(splits)} " if splits else ""
    of = f"of {whole} " if whole is not None and whole > len(records) else ""
    many = f"{len(records)} {of}{kind}record{'s' if records[1:] or of else ''}"
    if not subject.header.get("data") and not subject.header.get("files"):
        return many
    made = trained_on(subject, records)
    if not made:
        return f"{many} that it was not fitted to"
    return f"{many}, {'all' if len(made) == len(records) else len(made)} of which it was fitted to"


def trained_on(subject: Subject, records: Sequence[Experiment]) -> list[str]:
    """The names of those records that a model was fitted to, by their checksums."""
    known = records_in_header(subject.header)
    return [e.name for e in records if e.sha256 and e.sha256 in known]


def about_bands(found: Sequence[Judged]) -> str:
    """Which bands are drawn; nothing where there are none."""
    each = [f"{100 * of.bands[0].level:.3g} % ({of.subject.label})" for of in found if of.bands]
    return f"Shaded: bands that hold {listed(each)} of the time." if each else ""


def scores_table(found: Sequence[Judged], records: Sequence[Experiment]) -> Table:
    """RMSE of every record, a column a model."""
    scores = {of.subject.label: of.scores for of in found}
    return comparison_table(records, scores, found[0].scores[0].start)


def coordinates_table(found: Sequence[Judged], channels: Channels) -> Table:
    """RMSE, NRMSE and fit of every coordinate, means over the records."""
    rows = []
    for of in found:
        figures = [
            np.mean([getattr(s, name) for s in of.scores], axis=0).tolist()
            for name in ("coordinate_rmse", "nrmse", "fit_percent")
        ]
        for c, rmse, nrmse, fit in zip(channels.coordinates, *figures, strict=True):
            told = [f"{number(rmse)} {c.unit}", number(nrmse), number(fit, 1)]
            rows.append([of.subject.label, c.name, *told])
    return Table(
        ["model", "coordinate", "RMSE", "NRMSE", "fit [%]"], rows, "Means over the records"
    )


def parameters_of(subject: Subject) -> Parameters | None:
    """The parameters of a model, with both errors where it was identified."""
    found = subject.header.get("identification")
    values = family_of(subject.model).parameters(subject.model)
    units = {name: unit for name, unit, _ in values}
    if found is None:
        rows = [[name, f"{value:.4g}", unit] for name, unit, value in values]
        table = Table(ESTIMATE_COLUMNS[:3], rows)
        return Parameters(subject.label, "values", table, [None] * len(rows)) if rows else None
    with refusing(subject.label, "an account of its identification that is damaged", "estimates"):
        estimates = [
            Estimate(**of | {"interval": of["interval"] and tuple(of["interval"])})
            for of in found["estimates"]
        ]
        refined = (found.get("refined") or {}).get("values")
        title = estimates_title(found["trust"], refined)
        fixed = [[name, f"{value:.4g}", units.get(name, ""), "fixed", "", "", ""]
                 for name, value in found["fixed"].items()]  # fmt: skip
    rows = [*map(estimate_cells, estimates), *fixed]
    places = []
    for e in estimates:
        low, high = e.interval or (e.value, e.value)
        places.append((place(e, low), place(e, e.value), place(e, high)))
    table = estimates_table(rows, refined)
    return Parameters(subject.label, title, table, [*places, *[None] * len(fixed)])


def stages_table(found: Sequence[Judged]) -> Table:
    """The stages of every identification, and how they ended."""
    rows = []
    for of in found:
        rows += [
            [of.subject.label, f"{i}: {stage['stage']}", str(stage["iterations"]),
             "–" if stage["cost"] is None else f"{stage['cost']:.4g}", stage["why"]]
            for i, stage in enumerate(of.subject.stages, 1)
        ]  # fmt: skip
    columns = ["model", "stage", "iterations", "cost", "ended"]
    return Table(columns, rows)


def notes_of(found: Sequence[Judged], records: Sequence[Experiment]) -> list[str]:
    """What one should know before believing it."""
    notes = []
    for of in found:
        notes += [f"{of.subject.label}: {note}" for note in of.notes]
        notes += [
            f"{of.subject.label}, {e.name}: {left_words(left, e)}"
            for e, left in zip(records, of.left, strict=True)
            if left is not None
        ]
        identified = of.subject.header.get("identification") or {}
        notes += [f"{of.subject.label}: {finding}" for finding in identified.get("findings", ())]
    return notes


def models_table(found: Sequence[Judged], records: Sequence[Experiment]) -> Table:
    """Where the models are from."""
    rows = []
    for of in found:
        header, file = of.subject.header, of.subject.file
        recipe, training = header.get("recipe") or {}, header.get("training") or {}
        seed = f", seed {training['seed']}" if "seed" in training else ""
        made = len(records_in_header(header))
        rows.append([
            of.subject.label,
            family_of(of.subject.model).kind,
            f"{recipe['name']}{seed}" if recipe else "–",
            f"{made} records of {header['data']['name']}" if header.get("data") else "–",
            _digest(file.read_bytes()) if file else "–",
            " ".join(f"{k} {v}" for k, v in (header.get("versions") or {}).items()) or "–",
        ])  # fmt: skip
    return Table(["model", "kind", "recipe", "fitted to", "SHA-256", "made with"], rows)


def structure_table(found: Sequence[Judged]) -> Table:
    """What the models consist of."""
    rows = [[of.subject.label, key, value] for of in found for key, value in of.subject.told
            if key != "values"]  # fmt: skip
    return Table(["model", "part", "what it is"], rows)


def records_table(found: Sequence[Judged], records: Sequence[Experiment]) -> Table:
    """Where the records are from, and which models were fitted to them."""
    made = {of.subject.label: trained_on(of.subject, records) for of in found}
    rows = [
        [
            e.name, e.split or "–", str(len(e)), f"{e.seconds:.4g}",
            ", ".join(label for label, names in made.items() if e.name in names) or "–",
            e.sha256[:_SHOWN] or "–",
        ]
        for e in records
    ]  # fmt: skip
    columns = ["record", "split", "samples", "length [s]", "models fitted to it", "SHA-256"]
    return Table(columns, rows)


def versions() -> str:
    """The packages that this report was computed with."""
    return ", ".join(f"{name} {version}" for name, version in package_versions().items())


def listed(names: Sequence[str]) -> str:
    """`a, b and c`."""
    return f"{', '.join(names[:-1])} and {names[-1]}" if names[1:] else "".join(names)


def _names(channels: Channels) -> list[str]:
    return [c.name for c in channels.coordinates]


def _article(word: str) -> str:
    return "An" if word[:1].lower() in "aeiou" else "A"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_SHOWN]
