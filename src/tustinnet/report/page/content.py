"""The numbers of a report as plain values, for the scripts that draw them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.residuals import ResidualReport
from tustinnet.models.kinematics import Link, parent_indices
from tustinnet.models.physical_values import physical_parameters
from tustinnet.report.page.model_result import ModelResult
from tustinnet.report.page.reported_model import History, ReportedModel
from tustinnet.report.page.signals import bounded, pack, thin
from tustinnet.simulate.range import Range
from tustinnet.store.log import is_stage_end

# numbers of points of a signal that are tried, the most that a screen shows first
_POINTS = (2000, 1700, 1400, 1200, 1000, 850, 700, 600, 500, 400, 300, 200, 150, 100)
_POINT_BYTES, _SIGNAL_BYTES = 8 / 3, 80.0  # of a point in base64, of the keys of a signal
DRAWN_INPUTS = 3  # with whose correlations the residuals of a coordinate are drawn, at most


@dataclass(frozen=True)
class Thinning:
    """Thinning of the signals of a page.

    Attributes:
        points: largest number of points of a signal.
        records: number of records that had more samples.
    """

    points: int
    records: int


def choose_thinning(
    results: Sequence[ModelResult], records: Sequence[Experiment], room: float
) -> Thinning:
    """Chooses the number of points with which all signals together have room.

    Args:
        results: the models with their results.
        records: the records.
        room: space for the signals in the page [bytes].
    """
    c = records[0].channels
    signals = 1 + c.measured.stop + c.n_u
    for result in results:
        signals += c.n_q * (3 if result.bands else 1) + (2 if result.energies else 0)

    def size(points: int) -> float:
        total = sum(min(len(e), points) for e in records)
        return signals * (_POINT_BYTES * total + _SIGNAL_BYTES * len(records))

    points = next((p for p in _POINTS if size(p) <= room), _POINTS[-1])
    return Thinning(points, sum(len(e) > points for e in records))


def make_content(
    results: Sequence[ModelResult],
    records: Sequence[Experiment],
    links: Sequence[Link],
    points: int,
) -> dict[str, Any]:
    """Makes the plain values of everything that is drawn.

    Args:
        results: the models with their results.
        records: the records.
        links: links that draw the mechanism, empty where they are unknown.
        points: largest number of points of a signal.
    """
    c = records[0].channels
    return {
        **mechanism_content(c, links),
        "truth": "measured",
        "models": [_model_content(result) for result in results],
        "records": [_record_content(i, e, results, points) for i, e in enumerate(records)],
        **range_content([result.range for result in results], c),
    }


def mechanism_content(channels: Channels, links: Sequence[Link]) -> dict[str, Any]:
    """Coordinates, inputs and links of a mechanism."""
    names = [coordinate.name for coordinate in channels.coordinates]
    return {
        "dt": channels.dt,
        "unit": channels.unit,
        "units": list(channels.units),
        "coordinates": [
            {"name": q.name, "kind": q.kind, "unit": q.unit} for q in channels.coordinates
        ],
        "inputs": [
            {"name": i.name, "unit": i.unit, "limits": i.limits, "hold": i.hold}
            for i in channels.inputs
        ],
        "links": [
            {
                "coordinate": names.index(link.coordinate),
                "axis": link.axis,
                "reach": link.reach,
                "parent": parent,
                "at": link.at,
                "shape": link.shape,
            }
            for link, parent in zip(links, parent_indices(links), strict=True)
        ],
    }


def _model_content(result: ModelResult) -> dict[str, Any]:
    reported = result.reported
    return {
        "label": reported.label,
        "warmUp": reported.model.warm_up,
        "energyUnit": result.energy_unit,
        "ahead": [pack(errors) for errors in result.ahead.T],
        "residuals": [
            {
                "coordinate": r.coordinate,
                "sentence": r.sentence,
                "own": pack(r.autocorrelation),
                "bound": r.white_bound,
                "cross": [
                    {
                        "input": k,
                        "values": pack(r.cross[k]),
                        "bound": float(r.cross_bound[k]),
                    }
                    for k in _drawn_inputs(r)
                ],
            }
            for r in result.residuals
        ],
        "search": _search_content(reported),
        "training": [_training_content(name, log) for name, log in reported.histories.items()],
    }


def _drawn_inputs(residuals: ResidualReport) -> list[int]:
    """The inputs with whose correlations are drawn: those that most exceed their bounds."""
    if not len(residuals.cross):
        return []
    peaks = np.max(np.abs(residuals.cross), axis=1) / residuals.cross_bound
    return sorted(int(k) for k in np.argsort(-peaks)[:DRAWN_INPUTS])


def _search_content(reported: ReportedModel) -> dict[str, Any] | None:
    """Costs by iteration of every stage, and the parameters that moved, at the ends of stages."""
    ends = reported.stages
    if not ends:
        return None
    costs: list[list[float]] = [[]]
    for line in reported.search:
        if is_stage_end(line):
            costs.append([])
        else:
            costs[-1].append(math.nan if line["cost"] is None else line["cost"])
    names = [name for name in ends[0]["parameters"] if all(name in s["parameters"] for s in ends)]
    series = {name: [stage["parameters"][name] for stage in ends] for name in names}
    parameters = physical_parameters(reported.model)
    units = {name: unit for name, unit, _ in parameters}
    return {
        "stages": [
            {"name": stage["stage"], "cost": cost or [stage["cost"]]}
            for stage, cost in zip(ends, costs, strict=False)
        ],
        "parameters": [
            {"name": name, "unit": units.get(name, ""), "values": values}
            for name, values in series.items()
            if len(set(values)) > 1
        ],
    }


def _training_content(name: str, lines: History) -> dict[str, Any]:
    """Logarithms of loss and validation score by epoch, thinned without losing peaks."""
    values = np.array([[e["loss"], e["validation"]] for e in lines], float)  # None becomes NaN
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.log10(values)
    epochs = thin(values, 400)  # points of a curve
    loss, validation = values[epochs].T
    return {
        "name": name,
        "epoch": pack(epochs + 1.0),
        "loss": pack(loss),
        "validation": pack(validation),
    }


def _record_content(
    i: int, e: Experiment, results: Sequence[ModelResult], points: int
) -> dict[str, Any]:
    """The signals of record `i`, all at the same times."""
    c, t = e.channels, e.t - e.t[0]
    columns: dict[str, np.ndarray] = {"q": e.q, "v": e.measured_states()[:, c.velocity], "u": e.u}
    for k, result in enumerate(results):
        simulated = bounded(result.scores[i].simulated[:, c.position], e.q)
        columns[f"{k} error"] = simulated - e.q
        if result.bands:
            band = result.bands[i]
            after = (np.arange(len(e)) >= band.prediction.first)[
                :, None
            ]  # of the start there is none
            ends = [np.where(after, bounded(x, e.q), np.nan) for x in (band.low, band.high)]
            columns[f"{k} band"] = np.concatenate(ends, axis=1)
        if result.energies:
            measured, energy = (energies[i] for energies in result.energies)
            columns[f"{k} energy"] = np.stack([measured, bounded(energy, measured)], axis=1)
    samples = thin(np.concatenate(list(columns.values()), axis=1), points)
    parts = {
        key: [pack(column) for column in signals[samples].T] for key, signals in columns.items()
    }
    return {
        "name": e.name,
        "split": e.split,
        "t": pack(t[samples]),
        **{key: parts[key] for key in ("q", "v", "u")},
        "runs": [
            {
                part: parts[f"{k} {part}"]
                for part in ("error", "band", "energy")
                if f"{k} {part}" in parts
            }
            | {"rmse": list(result.scores[i].rmse_by_unit(c).values())}
            for k, result in enumerate(results)
        ],
    }


def range_content(training_ranges: Sequence[Range | None], channels: Channels) -> dict[str, Any]:
    """Ranges of the training data of each model, and point clouds, which models may share."""
    ranges: list[dict[str, Any] | None] = []
    clouds: list[dict[str, Any]] = []
    for training_range in training_ranges:
        if training_range is None:
            ranges.append(None)
            continue
        support = None
        if (points := training_range.support) is not None:
            support = {
                "points": points.points.tolist(),
                "spread": points.spread.tolist(),
                "reach": points.reach,
            }
            if support not in clouds:
                clouds.append(support)
        ranges.append(
            {
                "q": training_range.states[channels.position].tolist(),
                "v": training_range.states[channels.velocity].tolist(),
                "u": training_range.inputs.tolist(),
                "cloud": None if support is None else clouds.index(support),
            }
        )
    return {"ranges": ranges, "clouds": clouds}
