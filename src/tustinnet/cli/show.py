"""`tustinnet show`: what a model file says of itself."""

from typing import Any

import typer

from tustinnet.cli import options, terminal

_LONGEST_LINE = 1000  # characters


def show(model: options.Model, json: options.Json = False) -> None:
    """Print what a model file contains: structure, parameters, scores."""
    from tustinnet.errors import printable, refusing
    from tustinnet.store.header import read_description

    header, own = read_description(model)
    if json:
        terminal.print_json(header)
        return
    with refusing(model, "its header says something else than fits write", "a run's model file"):
        lines = [*_channels(header), *own, *_fit(header), *_identified(header), *_scores(header)]
    for key, value in lines:
        typer.echo(f"{key:<14}{printable(str(value), _LONGEST_LINE)}")


def _channels(header: dict[str, Any]) -> list[tuple[str, str]]:
    inputs = ", ".join(f"{i['name']} [{i['unit']}, {i['hold']}]" for i in header["inputs"])
    return [
        ("kind", f"{header['kind']}, format {header['format']}"),
        ("coordinates", ", ".join(map(_coordinate, header["coordinates"]))),
        ("inputs", inputs or "none"),
        ("period", f"{header['dt']:g} s"),
    ]


def _coordinate(of: dict[str, Any]) -> str:
    unit = f" [{of['unit']}]" if of.get("unit") else ""  # where it is neither rad nor m
    return f"{of['name']}{unit} ({of['kind']})"


def _fit(header: dict[str, Any]) -> list[tuple[str, str]]:
    """The recipe, the training, the records."""
    lines, training = [], header.get("training")
    recipe = header.get("recipe")
    if recipe:
        seed = f", seed {training['seed']}" if training else ""
        lines.append(("recipe", recipe["name"] + seed))
    if training:
        told = f"windows {training['windows']}, epochs {training['epochs']}"
        kept = f"epoch {training['kept_epoch']} kept, {training['outcome']}"
        lines.append(("training", f"{told}, {kept}"))
    if "from" in header:
        lines.append(("begun with", f"{header['from']['file']}, sha256 {header['from']['sha256']}"))
    if "data" in header:
        data = header["data"]
        lines.append(("data", f"{data['name']}, {len(data['records'])} records"))
    return lines


def _identified(header: dict[str, Any]) -> list[tuple[str, str]]:
    """Parameters with their errors, the outcome, findings."""
    found = header.get("identification")
    if found is None:
        return []
    lines = [("parameters", "")]
    refined = (found.get("refined") or {}).get("values", {})
    for e in found["estimates"]:
        error = "" if e["error"] is None else f" +- {e['error']:.2g}"
        bound = f", at the {e['bound']} end of its range" if e["bound"] else ""
        name = e["name"]
        now = f"; in the model {refined[name]:.4g}" if name in refined else ""
        lines.append(("", f"{name} {e['value']:.4g}{error} {e['unit']}{bound}{now}"))
    fixed = found.get("fixed", found.get("held", {}))  # files of format 1 say `held`
    lines += [("", f"{name} {value:.4g}, fixed") for name, value in fixed.items()]
    lines.append(("outcome", found["outcome"]))
    return lines + [("finding", finding) for finding in found["findings"]]


def _scores(header: dict[str, Any]) -> list[tuple[str, str]]:
    lines, scores = [], header.get("scores")
    if scores:
        mean = "diverged" if scores["mean"] is None else f"{scores['mean']:.4g} {scores['unit']}"
        split = "records left out" if scores["split"] == "left out" else scores["split"]
        told = f"{split}, mean RMSE {mean}, start '{scores['start']}'"
        lines.append(("score", told))
        lines += [("", f"{name} {value:.4g}" if value is not None else f"{name} diverged")
                  for name, value in scores["rmse"].items()]  # fmt: skip
    return [*lines, ("versions", ", ".join(f"{k} {v}" for k, v in header["versions"].items()))]
