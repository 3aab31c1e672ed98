"""`tustinnet show`: what a model file says of itself."""

from typing import Any

import typer

from tustinnet.cli import options, terminal


def show(model: options.Model, json: options.Json = False) -> None:
    """Print a model file's header: structure, coordinates, recipe, data, scores."""
    from tustinnet.artifact.model_file import load_model, read_header

    header = read_header(model)
    network = load_model(model)
    if json:
        terminal.print_json(header)
        return
    for key, value in _lines(header):
        typer.echo(f"{key:<14}{value}")
    names = ("position_offset", "position_scale", "velocity", "input", "acceleration")
    scaling = [f"{n} {[float(f'{v:.4g}') for v in getattr(network.scaling, n)]}" for n in names]
    typer.echo(f"{'scaling':<14}{', '.join(scaling)}")


def _lines(header: dict[str, Any]) -> list[tuple[str, str]]:
    structure = header["structure"]
    training = header.get("training", {})
    scores = header.get("scores")
    data = header.get("data", {})
    lines = [
        ("kind", f"{header['kind']}, format {header['format']}"),
        ("network", f"hidden {structure['hidden']}, {structure['activation']}, output "
                    f"{'with' if structure['output_bias'] else 'without'} bias"),
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
        mean = "diverged" if scores["mean"] is None else f"{scores['mean']:.4f} {scores['unit']}"
        told = f"{scores['split']} mean RMSE {mean}, start '{scores['start']}'"
        lines.append(("score", told))
        lines += [("", f"{name} {value:.4f}" if value is not None else f"{name} diverged")
                  for name, value in scores["rmse"].items()]  # fmt: skip
    lines.append(("versions", ", ".join(f"{k} {v}" for k, v in header["versions"].items())))
    return lines
