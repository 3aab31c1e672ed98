"""`tustinnet evaluate`: score a model on records."""

from dataclasses import asdict
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tustinnet.cli import options, request, terminal

if TYPE_CHECKING:
    import numpy as np

    from tustinnet.channels import Channels
    from tustinnet.data.experiment import Experiment
    from tustinnet.evaluate.bands import Band, BandOptions
    from tustinnet.evaluate.coverage import Coverage
    from tustinnet.evaluate.scores import Score
    from tustinnet.report.tables import Table


_AHEAD_FIGURE = "ahead"
_Ahead = Annotated[
    int | None,
    typer.Option(min=1, metavar="K", help="Also score predictions k steps ahead, for k = 1..K."),
]
_Figures = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Folder for a figure of every free run.")
]


def evaluate(
    model: options.Model,
    data: options.Data,
    split: options.Split = None,
    start: options.Start = None,
    horizon: options.Horizon = None,
    card: options.Card = None,
    system: options.System = None,
    ahead: _Ahead = None,
    figures: _Figures = None,
    band: options.Band = None,
    whole_records: options.WholeRecords = False,
    overwrite: options.Redraw = False,
    json: options.Json = False,
) -> None:
    """Score the free runs of a model: RMSE, NRMSE, fit in percent.

    A free run begins at an initial state (--start) and then uses only the logged inputs.
    """
    terminal.prepare_jax()
    from tustinnet.evaluate.ahead import rmse_ahead
    from tustinnet.evaluate.coverage import compute_coverage
    from tustinnet.evaluate.scores import Score
    from tustinnet.evaluate.scores import evaluate as score_records

    asked = request.band_asked(band, whole=whole_records)
    judged = request.model_of(model, system)
    records, begin = request.judged_records(data, card, split, start, [judged])
    names = [e.name for e in records] + ([] if ahead is None else [_AHEAD_FIGURE])
    drawn = None if figures is None else [figures / f"{name}.png" for name in names]
    read = request.files_of(data, card, model, system)
    request.require_figures("--figures", drawn, read, overwrite=overwrite)
    scores = score_records(judged, records, begin, horizon=horizon)
    runs = list(zip(records, scores, strict=True))
    by_split: dict[str, list[Score]] = {}
    for e, score in runs:
        by_split.setdefault(e.split or "all", []).append(score)
    bands = [] if asked is None else request.bands_of(model, judged, records, scores, asked)
    shares = compute_coverage(records, bands) if bands else []
    errors = None if ahead is None else rmse_ahead(judged, records, ahead)
    if json:
        content = _content(judged.channels, runs, by_split, horizon)
        if asked is not None:
            content["band"] = {"level": asked.level, "of": asked.scope,
                               "covered": [asdict(of) for of in shares]}  # fmt: skip
        if errors is not None:
            content["ahead"] = {"dt": judged.dt, "rmse": errors.tolist()}
        terminal.print_json(content)
    else:
        terminal.print_tables(_score_table(by_split, judged.channels, begin))
        if asked is not None:
            terminal.print_tables(_band_table(shares, asked, judged.channels))
        if errors is not None:
            terminal.print_tables(_ahead_table(errors.tolist(), judged.channels))
    if figures is not None:
        _draw(figures, model.stem, runs, bands)
        if errors is not None:
            _draw_ahead(figures, model.stem, errors, judged.channels)
        terminal.messages().print(f"figures: {figures}")


def _content(
    channels: "Channels",
    runs: "list[tuple[Experiment, Score]]",
    by_split: dict[str, list["Score"]],
    horizon: float | None,
) -> dict[str, Any]:
    from tustinnet.evaluate.scores import mean_rmse

    return {
        "start": runs[0][1].start,
        "horizon": horizon,
        "coordinates": [c.name for c in channels.coordinates],
        "experiments": [{**_plain(score), "split": e.split} for e, score in runs],
        "mean": mean_rmse([score for _, score in runs]),
        "means": {name: mean_rmse(group) for name, group in by_split.items()},
    }


def _draw(
    folder: Path, label: str, runs: "list[tuple[Experiment, Score]]", bands: "list[Band]"
) -> None:
    from tustinnet.report.figures import free_run_figure, write_figure

    for i, (e, score) in enumerate(runs):
        around = {label: bands[i]} if bands else {}
        write_figure(free_run_figure(e, {label: score}, bands=around), folder, f"{e.name}.png")


def _draw_ahead(folder: Path, label: str, errors: "np.ndarray", channels: "Channels") -> None:
    from tustinnet.report.figures import ahead_figure, write_figure

    write_figure(ahead_figure({label: errors}, channels), folder, f"{_AHEAD_FIGURE}.png")


def _ahead_table(errors: list[float], channels: "Channels") -> "Table":
    from tustinnet.report.tables import Table, number

    marks = sorted({k for k in (1, 2, 5, 10, 20, 50, 100, 200, 500) if k < len(errors)})
    rows = [[str(k), f"{k * channels.dt:g}", number(errors[k - 1], 4)]
            for k in [*marks, len(errors)]]  # fmt: skip
    columns = ["k", "horizon [s]", f"RMSE [{channels.unit}]"]
    return Table(columns, rows, title="k steps ahead")


def _band_table(shares: "list[Coverage]", asked: "BandOptions", channels: "Channels") -> "Table":
    from tustinnet.report.tables import Table, number

    units = {c.name: c.unit for c in channels.coordinates}
    rows = []
    for of in shares:
        low, high = (f"{100 * end:.0f}" for end in of.interval)
        rows.append([
            of.coordinate, of.part, f"{100 * of.inside:.1f}", f"{low} to {high}",
            f"{of.whole} of {of.records}", f"{number(of.width)} {units[of.coordinate]}",
            number(of.width / of.rmse, 1) if of.rmse else "", number(of.crps),
        ])  # fmt: skip
    columns = ["coordinate", "part", "inside [%]", "95 % interval", "records all inside",
               "width", "width / RMSE", "CRPS"]  # fmt: skip
    what = "of the time" if asked.scope == "time" else "of whole records"
    return Table(columns, rows, title=f"Bands of {100 * asked.level:g} % {what}")


def _plain(score: "Score") -> dict[str, Any]:
    return {
        "experiment": score.experiment,
        "rmse": score.rmse,
        "rmse_after": score.rmse_after,
        "coordinate_rmse": list(score.coordinate_rmse),
        "nrmse": list(score.nrmse),
        "fit_percent": list(score.fit_percent),
    }


def _score_table(by_split: dict[str, list["Score"]], channels: "Channels", start: str) -> "Table":
    from tustinnet.evaluate.scores import mean_rmse
    from tustinnet.report.tables import Table, number
    from tustinnet.simulate.horizon import over
    from tustinnet.simulate.starts import start_named

    fitted = start_named(start).fitted
    # what the start was fitted to is simulated well by any model
    after = [f"from sample {fitted}"] if fitted else []
    columns = ["record", "split", f"RMSE [{channels.unit}]", *after]
    for c in channels.coordinates:
        columns += [f"{c.name} [{c.unit}]", "NRMSE", "fit [%]"]
    rows = []
    for split, scores in by_split.items():
        for s in scores:
            row = [s.experiment, split, number(s.rmse), *[number(s.rmse_after) for _ in after]]
            for error, relative, percent in zip(
                s.coordinate_rmse, s.nrmse, s.fit_percent, strict=True
            ):
                row += [number(error), number(relative), number(percent, 1)]
            rows.append(row)
    # training records flatter a model: their mean stands apart from the others'
    for split, scores in by_split.items():
        means = [mean_rmse(scores), *[fmean(s.rmse_after for s in scores) for _ in after]]
        rows.append(["mean", split, *map(number, means), *[""] * (3 * channels.n_q)])
    horizon = over(next(iter(by_split.values()))[0].horizon)
    return Table(columns, rows, title=f"Free runs, start '{start}'{horizon}")
