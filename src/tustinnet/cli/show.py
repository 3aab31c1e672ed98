"""`tustinnet show`: what a model file says of itself."""

from typing import Any

import typer

from tustinnet.cli import options, terminal


def show(model: options.Model, system: options.System = None, json: options.Json = False) -> None:
    """Print a model file's header: structure or parameters, data, scores."""
    from tustinnet.artifact.model_file import load_model, read_header

    header = read_header(model)
    if json:
        terminal.print_json(header)
        return
    loaded = load_model(model, system)
    for key, value in _lines(header):
        typer.echo(f"{key:<14}{value}")
    for key, value in _of_network(loaded) if header["kind"] == "tustin-net" else _of_system(header):
        typer.echo(f"{key:<14}{value}")


def _of_network(network: Any) -> list[tuple[str, str]]:
    names = ("position_offset", "position_scale", "velocity", "input", "acceleration")
    scaling = [f"{n} {[float(f'{v:.4g}') for v in getattr(network.scaling, n)]}" for n in names]
    return [("scaling", ", ".join(scaling))]


def _of_system(header: dict[str, Any]) -> list[tuple[str, str]]:
    found = header.get("identification")
    if found is None:
        return [("parameters", ", ".join(header["parameters"]))]
    lines = [("parameters", "")]
    for e in found["estimates"]:
        error = "" if e["error"] is None else f" +- {e['error']:.2g}"
        bound = f", at the {e['bound']} end of its range" if e["bound"] else ""
        lines.append(("", f"{e['name']} {e['value']:.4g}{error} {e['unit']}{bound}"))
    lines += [("", f"{name} {value:.4g}, held") for name, value in found["held"].items()]
    lines.append(("outcome", found["outcome"]))
    return lines + [("finding", finding) for finding in found["findings"]]


def _lines(header: dict[str, Any]) -> list[tuple[str, str]]:
    training = header.get("training", {})
    scores = header.get("scores")
    data = header.get("data", {})
    lines = [
        ("kind", f"{header['kind']}, format {header['format']}"),
        _built_from(header),
        ("coordinates", ", ".join(f"{c['name']} ({c['kind']})" for c in header["coordinates"])),
        ("inputs", ", ".join(f"{i['name']} [{i['unit']}, {i['hold']}]" for i in header["inputs"])
                   or "none"),
        ("period", f"{header['dt']:g} s"),
    ]  # fmt: skip
    if training:
        lines.append(("recipe", f"{header['recipe']['name']}, seed {training['seed']}"))
        told = f"windows {training['windows']}, epochs {training['epochs']}"
        kept = f"epoch {training['kept_epoch']} kept, {training['outcome']}"
        lines.append(("training", f"{told}, {kept}"))
    if data:
        lines.append(("data", f"{data['name']}, {len(data['records'])} records"))
    if scores:
        mean = "diverged" if scores["mean"] is None else f"{scores['mean']:.4g} {scores['unit']}"
        told = f"{scores['split']} mean RMSE {mean}, start '{scores['start']}'"
        lines.append(("score", told))
        lines += [("", f"{name} {value:.4g}" if value is not None else f"{name} diverged")
                  for name, value in scores["rmse"].items()]  # fmt: skip
    lines.append(("versions", ", ".join(f"{k} {v}" for k, v in header["versions"].items())))
    return lines


def _built_from(header: dict[str, Any]) -> tuple[str, str]:
    if header["kind"] != "tustin-net":
        system = header["system"]
        told = f"{system['name']} ({system['file']}, {system['sha256'][:12]})"
        return "system", f"{told}, {header['substeps']} Runge-Kutta steps a period"
    structure = header["structure"]
    bias = "with" if structure["output_bias"] else "without"
    return "network", f"hidden {structure['hidden']}, {structure['activation']}, output {bias} bias"
