"""`tustinnet show`: the contents of a model file."""

from typing import Any

import typer

from tustinnet.cli import options, terminal

_LONGEST_LINE = 1000  # characters
Lines = list[tuple[str, str]]


def show(model: options.Model, json: options.Json = False) -> None:
    """Print what a model file contains: structure, parameters, scores."""
    from tustinnet.errors import convert_errors, to_printable
    from tustinnet.store.header import read_description

    header, structure = read_description(model)
    if json:
        terminal.print_json(header)
        return
    with convert_errors(model, "its header is not one that fits write", "a run's model file"):
        lines = [
            *_channel_lines(header), *structure, *_fit_lines(header),
            *_identification_lines(header), *_score_lines(header),
            ("versions", ", ".join(f"{k} {v}" for k, v in header["versions"].items())),
        ]  # fmt: skip
    for key, value in lines:
        typer.echo(f"{key:<14}{to_printable(str(value), _LONGEST_LINE)}")


def _channel_lines(header: dict[str, Any]) -> Lines:
    """Lines on kind, coordinates, inputs and sampling period."""
    coordinates = []
    for coordinate in header["coordinates"]:
        unit = f" [{coordinate['unit']}]" if coordinate.get("unit") else ""  # not rad or m
        coordinates.append(f"{coordinate['name']}{unit} ({coordinate['kind']})")
    inputs = ", ".join(
        f"{i['name']} [{i['unit']}, {i['hold'] or 'zero-order'}]" for i in header["inputs"]
    )
    return [
        ("kind", f"{header['kind']}, format {header['format']}"),
        ("coordinates", ", ".join(coordinates)),
        ("inputs", inputs or "none"),
        ("period", f"{header['dt']:g} s"),
    ]


def _fit_lines(header: dict[str, Any]) -> Lines:
    """Lines on recipe, training and records."""
    lines, training = [], header.get("training")
    recipe = header.get("recipe")
    if recipe:
        seed = f", seed {training['seed']}" if training else ""
        lines.append(("recipe", recipe["name"] + seed))
    if training:
        sizes = f"windows {training['windows']}, epochs {training['epochs']}"
        end = f"epoch {training['kept_epoch']} kept, {training['outcome']}"
        lines.append(("training", f"{sizes}, {end}"))
    if "from" in header:
        origin = header["from"]
        lines.append(("begun with", f"{origin['file']}, sha256 {origin['sha256']}"))
    if "data" in header:
        data = header["data"]
        lines.append(("data", f"{data['name']}, {len(data['records'])} records"))
    return lines


def _identification_lines(header: dict[str, Any]) -> Lines:
    """Lines on parameters with their errors, the outcome and the findings."""
    identification = header.get("identification")
    if identification is None:
        return []
    lines = [("parameters", "")]
    refined = (identification.get("refined") or {}).get("values", {})
    for e in identification["estimates"]:
        name = e["name"]
        error = "" if e["error"] is None else f" +- {e['error']:.2g}"
        bound = f", at its {e['bound']} bound" if e["bound"] else ""
        final = f"; in the model {refined[name]:.4g}" if name in refined else ""
        lines.append(("", f"{name} {e['value']:.4g}{error} {e['unit']}{bound}{final}"))
    # files of format 1 say `held`
    fixed = identification.get("fixed", identification.get("held", {}))
    lines += [("", f"{name} {value:.4g}, fixed") for name, value in fixed.items()]
    lines.append(("outcome", identification["outcome"]))
    return lines + [("finding", finding) for finding in identification["findings"]]


def _score_lines(header: dict[str, Any]) -> Lines:
    """Lines on the scores of the fit."""
    scores = header.get("scores")
    if not scores:
        return []
    mean = "diverged" if scores["mean"] is None else f"{scores['mean']:.4g} {scores['unit']}"
    split = "records left out" if scores["split"] == "left out" else scores["split"]
    horizon = scores.get("horizon")
    length = "whole records" if horizon is None else f"segments of {horizon:g} s"
    lines = [("score", f"{split}, mean RMSE {mean}, start '{scores['start']}', {length}")]
    return lines + [("", f"{name} {value:.4g}" if value is not None else f"{name} diverged")
                    for name, value in scores["rmse"].items()]  # fmt: skip
