"""`tustinnet show`: the contents of a model file."""

from typing import Any

from tustinnet.cli import options, terminal
from tustinnet.errors import to_printable
from tustinnet.store import header as file_header
from tustinnet.wording import counted, percent

_LONGEST_LINE = 1000  # characters
Lines = list[tuple[str, str]]


def show(model: options.Model, json: options.Json = False) -> None:
    """Print what a model file contains: structure, parameters, scores."""
    header, structure = file_header.read_description(model)
    if json:
        terminal.print_json(header)
        return
    versions = header.get("versions", {})
    lines = [
        *_channel_lines(header),
        *structure,
        *_fit_lines(header),
        *_identification_lines(header),
        *(("equation", line) for line in header.get("equations", ())),
        *_score_lines(header),
        *([("versions", ", ".join(f"{k} {v}" for k, v in versions.items()))] if versions else []),
    ]
    for key, value in lines:
        terminal.echo(f"{key:<14}{to_printable(str(value), _LONGEST_LINE)}")


def _channel_lines(header: dict[str, Any]) -> Lines:
    """Lines on kind, coordinates, inputs and sampling period."""
    coordinates = []
    for coordinate in header["coordinates"]:
        unit = f" [{coordinate['unit']}]" if coordinate.get("unit") else ""  # not rad or m
        coordinates.append(f"{coordinate['name']}{unit} ({coordinate['kind']})")
    inputs = ", ".join(
        f"{i['name']} [{i['unit']}, {i.get('hold') or 'zero-order'}"
        + (f", {i['delay']:.4g} s late]" if i.get("delay") else "]")
        for i in header["inputs"]
    )
    return [
        ("kind", f"{header['kind']}, format {header['format']}"),
        ("coordinates", ", ".join(coordinates)),
        ("inputs", inputs or "none"),
        ("period", f"{header['dt']:g} s"),
    ]


def _fit_lines(header: dict[str, Any]) -> Lines:
    """Lines on recipe, training and records."""
    lines, training = [], header.get("training", {})
    if "recipe" in header:
        seed = f", seed {training['seed']}" if "seed" in training else ""
        lines.append(("recipe", header["recipe"]["name"] + seed))
    texts = {
        "windows": "windows {}",
        "epochs": "epochs {}",
        "kept_epoch": "epoch {} kept",
        "outcome": "{}",
    }
    if parts := [text.format(training[key]) for key, text in texts.items() if key in training]:
        lines.append(("training", ", ".join(parts)))
    if "from" in header:
        origin = header["from"]
        lines.append(("begun with", f"{origin['file']}, sha256 {origin['sha256']}"))
    if "data" in header:
        data = header["data"]
        lines.append(("data", f"{data['name']}, {counted(len(data['records']), 'record')}"))
    return lines


def _identification_lines(header: dict[str, Any]) -> Lines:
    """Lines on parameters with their errors, the outcome and the findings."""
    findings = [("finding", finding["text"]) for finding in header.get("findings", ())]
    identification = header.get("identification")
    if identification is None:
        return findings
    lines = [("parameters", "")]
    refined = (identification.get("refined") or {}).get("values", {})
    for e in identification["estimates"]:
        name = e["name"]
        error = "" if e["error"] is None else f" +- {e['error']:.2g}"
        bound = f", at its {e['bound']} bound" if e["bound"] else ""
        final = f"; in the model {refined[name]:.4g}" if name in refined else ""
        lines.append(("", f"{name} {e['value']:.4g}{error} {e['unit']}{bound}{final}"))
    fixed = identification["fixed"].items()
    lines += [("", f"{name} {value:.4g}, fixed") for name, value in fixed]
    if "outcome" in identification:
        lines.append(("outcome", identification["outcome"]))
    return lines + findings


def _score_lines(header: dict[str, Any]) -> Lines:
    """Lines on the scores of the fit."""
    scores = header.get("scores")
    if not scores:
        return []
    unit, start = scores.get("unit", ""), scores.get("start", "")
    means = scores.get("mean_by_unit") or {unit: scores.get("mean")}
    mean = " and ".join(
        "diverged" if value is None else f"{value:.4g} {key}".strip()
        for key, value in means.items()
    )
    split = "records left out" if scores.get("split") == "left out" else scores.get("split")
    horizon = scores.get("horizon")
    length = "whole records" if horizon is None else f"segments of {horizon:g} s"
    parts = [split, f"mean RMSE {mean}", f"start '{start}'" if start else "", length]
    if (trivial := scores.get("reference")) and trivial["share"] is not None:
        parts.append(f"in the median {percent(trivial['share'])} % of {trivial['predictor']}")
    lines = [("score", ", ".join(part for part in parts if part))]
    norm = " (norm over all coordinates)" if " and " in unit else ""
    return lines + [
        ("", f"{name} {value:.4g}{norm}" if value is not None else f"{name} diverged")
        for name, value in scores.get("rmse", {}).items()
    ]
