"""`tustinnet compare`: several models on the same records."""

from pathlib import Path
from typing import Annotated

import typer

from tustinnet.cli import options, terminal


def compare(
    models: Annotated[
        list[Path], typer.Argument(metavar="MODEL...", help="Model files (.safetensors).")
    ],
    data: options.Data,
    split: options.Split = None,
    start: options.Start = None,
    card: options.Card = None,
    system: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FILE.py", help="File of a system that models are of; may be repeated."
        ),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw every record with all free runs.")
    ] = None,
    json: options.Json = False,
) -> None:
    """Compare the free runs of several models: one table, one overlay a record."""
    terminal.prepare_jax()
    from tustinnet.artifact.model_file import load_model, read_header
    from tustinnet.cli.records import judged_records
    from tustinnet.data.experiment import position_unit
    from tustinnet.evaluation.free_run import evaluate, mean_rmse
    from tustinnet.report.figures import free_run_figure, write_figure
    from tustinnet.report.tables import Table, number
    from tustinnet.systems.registry import load_system

    records, begin = judged_records(data, card, split, start)
    own = {found.name: found for found in map(load_system, system or [])}
    scores = {}
    for label, path in zip(_labels(models), models, strict=True):
        name = read_header(path).get("system", {}).get("name")
        scores[label] = evaluate(load_model(path, own.get(name)), records, begin)
    if figures is not None:
        for i, e in enumerate(records):
            runs = {label: found[i] for label, found in scores.items()}
            write_figure(free_run_figure(e, runs), figures / f"{e.name}.png")
        terminal.messages().print(f"figures: {figures}")
    means = {label: mean_rmse(found) for label, found in scores.items()}
    if json:
        content = {
            "start": begin,
            "models": {
                label: {
                    "file": str(path),
                    "mean": means[label],
                    "rmse": {s.experiment: s.rmse for s in scores[label]},
                }
                for label, path in zip(scores, models, strict=True)
            },
        }
        terminal.print_json(content)
        return
    rows = [
        [e.name, e.split or "all", *[number(found[i].rmse) for found in scores.values()]]
        for i, e in enumerate(records)
    ]
    for name in dict.fromkeys(e.split or "all" for e in records):
        inside = [i for i, e in enumerate(records) if (e.split or "all") == name]
        groups = [mean_rmse([found[i] for i in inside]) for found in scores.values()]
        rows.append(["mean", name, *map(number, groups)])
    unit = position_unit(records[0].coordinates)
    title = f"Free-run RMSE [{unit}], start '{begin}'"
    terminal.print_tables(Table(["record", "split", *scores], rows, title=title))


def _labels(paths: list[Path]) -> list[str]:
    """Short names that differ: the files' stems, with as many folders as it takes."""
    parts = [[*p.resolve().parent.parts, p.stem] for p in paths]
    for depth in range(1, max(map(len, parts)) + 1):
        labels = ["/".join(part[-depth:]) for part in parts]
        if len(set(labels)) == len(labels):
            return labels
    return [f"{'/'.join(part[-2:])} ({i + 1})" for i, part in enumerate(parts)]
