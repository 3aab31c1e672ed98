"""The paper's free-run figures, drawn from our models."""

from collections.abc import Sequence
from pathlib import Path

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluation.free_run import Score
from tustinnet.paper.table1 import Row
from tustinnet.report.figures import free_run_figure, write_figure

# the paper's colours: Algorithm 1 in red, dash-dotted; the others by their place in the table
_STYLES = {
    "tustin-transfer": ("#c0392b", "-."),
    "tustin-standard": ("#e08e0b", "--"),
    "authors-transfer": ("#7d3c98", ":"),
    "authors-standard": ("#5d6d7e", (0, (5, 2, 1, 2))),
    "tustin-text-transfer": ("#2e8b57", "-."),
    "tustin-text-standard": ("#a04000", "--"),
}
_DEFAULT_RECORDS = ("fallTest4", "fallVal4")


def choose_experiment(data: DataSet, split: str, wanted: str | None) -> str:
    """The record of the figures: the one asked for, else the paper's, else the split's first."""
    names = [e.name for e in data.split(split)]
    if wanted is not None:
        if wanted not in names:
            raise InputError("--experiment", f"no record '{wanted}'", f"one of {', '.join(names)}")
        return wanted
    return next((name for name in _DEFAULT_RECORDS if name in names), names[0])


def draw(data: DataSet, rows: Sequence[Row], split: str, chosen: str, folder: Path) -> list[Path]:
    """Draws the free runs of every record, and Figure 4 on the chosen one, as PNG and SVG.

    Of several seeds the one with the median mean RMSE is drawn. Figure 4 compares standard
    training with Algorithm 1: our trainings, or the authors' weights where ours are not there.
    """
    shown = _median_rows(rows)
    standard = next((m for m in ("tustin-standard", "authors-standard") if m in shown), None)
    transfer = next((m for m in ("tustin-transfer", "authors-transfer") if m in shown), None)
    pair = [m for m in (standard, transfer) if m is not None]
    written = []
    for e in data.split(split):
        runs = {m: _of(row, e.name) for m, row in shown.items() if m in _STYLES}
        written += _write(e.name, runs, data, folder / f"free_run_{e.name}")
        if e.name == chosen and len(pair) == 2:
            compared = {m: _of(shown[m], e.name) for m in pair}
            written += _write(e.name, compared, data, folder / "figure4")
    return written


def _median_rows(rows: Sequence[Row]) -> dict[str, Row]:
    by_model: dict[str, list[Row]] = {}
    for row in rows:
        by_model.setdefault(row.model, []).append(row)
    return {
        model: sorted(group, key=lambda row: row.mean)[(len(group) - 1) // 2]
        for model, group in by_model.items()
    }


def _of(row: Row, experiment: str) -> Score:
    return next(score for score in row.scores if score.experiment == experiment)


def _write(name: str, runs: dict[str, Score], data: DataSet, stem: Path) -> list[Path]:
    figure = free_run_figure(data[name], runs, _STYLES)
    paths = [stem.with_name(f"{stem.name}{ending}") for ending in (".png", ".svg")]
    for path in paths:
        write_figure(figure, path)
    return paths
