"""The numbers of a report as plain values, which the page draws."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.bands import Band
from tustinnet.families.family import family_of
from tustinnet.models.kinematics import Link, carriers
from tustinnet.report.page.judged import Judged
from tustinnet.report.page.signals import bounded, kept, packed
from tustinnet.report.page.subject import History
from tustinnet.simulate.range import Cloud
from tustinnet.store.log import is_stage_end

# points of a signal that are tried, the most that a screen shows first
_POINTS = (2000, 1700, 1400, 1200, 1000, 850, 700, 600, 500, 400, 300, 200, 150, 100)
_BYTES, _NAMED = 8 / 3, 80.0  # of a point in base64, of what is said of a signal
_EPOCHS = 400  # points of a training curve


@dataclass(frozen=True)
class Thinning:
    """How signals were thinned.

    Attributes:
        points: of a signal, at most.
        records: how many records had more samples.
    """

    points: int
    records: int


def thinning_of(found: Sequence[Judged], records: Sequence[Experiment], room: float) -> Thinning:
    """So many points that all signals together have room.

    Args:
        found: the models and what was found of them.
        records: the records.
        room: of the signals in the page [bytes].
    """
    c = records[0].channels
    drawn = 1 + c.measured.stop + c.n_u
    for of in found:
        drawn += c.n_q * (3 if of.bands else 1) + (2 if of.energies else 0)

    def size(points: int) -> float:
        each = sum(min(len(e), points) for e in records)
        return drawn * (_BYTES * each + _NAMED * len(records))

    points = next((p for p in _POINTS if size(p) <= room), _POINTS[-1])
    return Thinning(points, sum(len(e) > points for e in records))


def content_of(
    found: Sequence[Judged], records: Sequence[Experiment], links: Sequence[Link], points: int
) -> dict[str, Any]:
    """All that is drawn.

    Args:
        found: the models and what was found of them.
        records: the records.
        links: how the mechanism is drawn, none where nobody said.
        points: of a signal, at most.
    """
    c = records[0].channels
    names = [of.name for of in c.coordinates]
    return {
        "dt": c.dt,
        "unit": c.unit,
        "coordinates": [
            {"name": of.name, "kind": of.kind, "unit": of.unit} for of in c.coordinates
        ],
        "inputs": [
            {"name": i.name, "unit": i.unit, "limits": i.limits, "hold": i.hold} for i in c.inputs
        ],
        "links": [
            {
                "coordinate": names.index(link.coordinate),
                "axis": link.axis,
                "reach": link.reach,
                "parent": parent,
                "at": link.at,
            }
            for link, parent in zip(links, carriers(links), strict=True)
        ],
        "models": [_model(of) for of in found],
        "records": [_record(i, e, found, points) for i, e in enumerate(records)],
        **_ranges(found, c),
    }


def _model(of: Judged) -> dict[str, Any]:
    return {
        "label": of.subject.label,
        "warmUp": of.subject.model.warm_up,
        "ahead": packed(of.ahead),
        "residuals": [
            {
                "coordinate": r.coordinate,
                "sentence": r.sentence,
                "own": packed(r.autocorrelation),
                "bound": r.white_bound,
                "cross": [
                    {"values": packed(values), "bound": float(bound)}
                    for values, bound in zip(r.cross, r.cross_bound, strict=True)
                ],
            }
            for r in of.residuals
        ],
        "search": _searched(of),
        "training": [_curve(name, lines) for name, lines in of.subject.histories.items()],
    }


def _searched(of: Judged) -> dict[str, Any] | None:
    """Costs by iteration of every stage, and the parameters that moved, at the ends of stages."""
    lines = of.subject.search
    ended = of.subject.stages
    if not ended:
        return None
    costs: list[list[float]] = [[]]
    for line in lines:
        if is_stage_end(line):
            costs.append([])
        else:
            costs[-1].append(math.nan if line["cost"] is None else line["cost"])
    names = [name for name in ended[0]["parameters"] if all(name in s["parameters"] for s in ended)]
    values = {name: [stage["parameters"][name] for stage in ended] for name in names}
    known = family_of(of.subject.model).parameters(of.subject.model)
    units = {name: unit for name, unit, _ in known}
    return {
        "stages": [
            {"name": stage["stage"], "cost": cost or [stage["cost"]]}
            for stage, cost in zip(ended, costs, strict=False)
        ],
        "parameters": [
            {"name": name, "unit": units.get(name, ""), "values": each}
            for name, each in values.items()
            if len(set(each)) > 1
        ],
    }


def _curve(name: str, lines: History) -> dict[str, Any]:
    """Loss and validation figure by epoch, logarithmic: thinned, peaks kept."""
    values = np.array([[e["loss"], e["validation"]] for e in lines], float)  # None becomes NaN
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.log10(values)
    at = kept(values, _EPOCHS)
    loss, validation = values[at].T
    return {"name": name, "epoch": packed(at + 1.0), "loss": packed(loss),
            "validation": packed(validation)}  # fmt: skip


def _record(i: int, e: Experiment, found: Sequence[Judged], points: int) -> dict[str, Any]:
    """The signals of one record, all at the same times."""
    c, t = e.channels, e.t - e.t[0]
    columns: dict[str, np.ndarray] = {
        "q": e.q, "v": e.measured_states()[:, c.velocity], "u": e.u,
    }  # fmt: skip
    for k, of in enumerate(found):
        run = bounded(of.scores[i].simulated[:, c.position], e.q)
        columns |= {f"{k} error": run - e.q, **_around(k, of, i, e.q)}
    samples = kept(np.concatenate(list(columns.values()), axis=1), points)
    parts = {key: _packed(part[samples]) for key, part in columns.items()}
    return {
        "name": e.name,
        "split": e.split,
        "t": packed(t[samples]),
        **{key: parts[key] for key in ("q", "v", "u")},
        "runs": [
            {part: parts[f"{k} {part}"]
             for part in ("error", "band", "energy") if f"{k} {part}" in parts}
            | {"rmse": of.scores[i].rmse}
            for k, of in enumerate(found)
        ],
    }  # fmt: skip


def _around(k: int, of: Judged, i: int, q: np.ndarray) -> dict[str, np.ndarray]:
    """Band and energies of a record."""
    found = {}
    if of.bands:
        found[f"{k} band"] = np.concatenate(_ends(of.bands[i], q), axis=1)
    if of.energies:
        measured, simulated = (energies[i] for energies in of.energies)
        found[f"{k} energy"] = np.stack([measured, bounded(simulated, measured)], axis=1)
    return found


def _ends(band: Band, q: np.ndarray) -> list[np.ndarray]:
    """Lower and upper ends, from where the free run begins."""
    after = (np.arange(len(q)) >= band.prediction.first)[:, None]
    return [np.where(after, bounded(end, q), np.nan) for end in (band.low, band.high)]


def _packed(columns: np.ndarray) -> list[dict[str, Any]]:
    return [packed(column) for column in columns.T]


def _ranges(found: Sequence[Judged], channels: Channels) -> dict[str, Any]:
    """Where the training records of each model lie: ends, and clouds, which models may share."""
    ranges: list[dict[str, Any] | None] = []
    clouds: list[dict[str, Any]] = []
    for of in found:
        if (known := of.range) is None:
            ranges.append(None)
            continue
        cloud = None if known.cloud is None else _cloud(known.cloud)
        if cloud is not None and cloud not in clouds:
            clouds.append(cloud)
        ranges.append({
            "q": known.states[channels.position].tolist(),
            "v": known.states[channels.velocity].tolist(),
            "u": known.inputs.tolist(),
            "cloud": None if cloud is None else clouds.index(cloud),
        })  # fmt: skip
    return {"ranges": ranges, "clouds": clouds}


def _cloud(cloud: Cloud) -> dict[str, Any]:
    """See `tustinnet.simulate.range.Cloud`."""
    return {
        "points": cloud.points.tolist(), "spread": cloud.spread.tolist(), "reach": cloud.reach,
    }  # fmt: skip
