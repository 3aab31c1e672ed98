"""The figures of the publication: two drawings that are kept, and free runs of our models."""

from collections.abc import Sequence
from pathlib import Path

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.evaluate.scores import Score
from tustinnet.reproduce.table1 import Row
from tustinnet.store.files import write_into

# the paper's colours and lines: Algorithm 1 red and dash-dotted, Euler-Lagrange orange and dashed,
# without spring purple and dotted; the others by their place in the table
_STYLES = {
    "tustin-transfer": ("#c0392b", "-."),
    "tustin-standard": ("#2e8b57", "--"),
    "euler-lagrange": ("#e08e0b", "--"),
    "euler-lagrange-naive": ("#7d3c98", ":"),
    "authors-transfer": ("#922b21", (0, (1, 1))),
    "authors-standard": ("#5d6d7e", (0, (5, 2, 1, 2))),
    "tustin-text-transfer": ("#d98880", "-."),
    "tustin-text-standard": ("#a04000", "--"),
}
# the models that each figure compares: our networks, or the authors' where ours are missing
_COMPARED = {
    "figure3": (("euler-lagrange",), ("euler-lagrange-naive",)),
    "figure4": (("tustin-standard", "authors-standard"), ("tustin-transfer", "authors-transfer")),
    "figure5": (("euler-lagrange",), ("tustin-transfer", "authors-transfer")),
}
_NAMES = {
    "euler-lagrange": "Euler-Lagrange",
    "euler-lagrange-naive": "Euler-Lagrange, no spring",
    "tustin-transfer": "Tustin-Net, Algorithm 1",
    "tustin-standard": "Tustin-Net, standard",
    "authors-transfer": "authors' weights, Algorithm 1",
    "authors-standard": "authors' weights, standard",
    "tustin-text-transfer": "Algorithm 1 as in the text",
    "tustin-text-standard": "standard as in the text",
}
_DRAWINGS = Path(__file__).parent / "drawn"
_DEFAULT_RECORDS = ("fallTest4", "fallVal4")


def choose_experiment(data: DataSet, split: str, name: str | None) -> str:
    """Chooses the record of the figures: by name, else the paper's, else the first of the split."""
    names = [e.name for e in data.split(split)]
    if name is not None:
        if name not in names:
            raise InputError("`experiment=`", f"no record '{name}'", f"one of {', '.join(names)}")
        return name
    return next((default for default in _DEFAULT_RECORDS if default in names), names[0])


def draw(data: DataSet, rows: Sequence[Row], split: str, record: str, folder: Path) -> list[Path]:
    """Draws the paper's five figures and every record's free runs, as PNG and SVG.

    Figures 1 and 2, the apparatus and the Tustin-Net, are copied (SVG); 3, 4 and 5 are free runs of
    one record.
    Of several seeds the one with the median mean RMSE is drawn. Figure 3 compares the
    Euler-Lagrange model with and without spring, Figure 4 standard training with Algorithm 1,
    Figure 5 the Euler-Lagrange model with Algorithm 1; each only if both models are there.

    Args:
        data: all splits.
        rows: the rows of the table.
        split: the split whose records are drawn.
        record: name of the record of figures 3 to 5.
        folder: folder for the figures.
    """
    rows_by_model, paths = median_rows(rows), list[Path]()
    for drawing in sorted(_DRAWINGS.glob("*.svg")):
        write_into(folder, drawing.name, drawing.read_bytes())
        paths.append(folder / drawing.name)
    for e in data.split(split):
        runs = {m: _find_score(row, e.name) for m, row in rows_by_model.items() if m in _STYLES}
        paths += _write_runs(e.name, runs, data, folder / f"free_run_{e.name}")
    for name, sides in _COMPARED.items():
        pair = [next((m for m in side if m in rows_by_model), None) for side in sides]
        compared = {m: _find_score(rows_by_model[m], record) for m in pair if m is not None}
        if len(compared) == len(sides):
            paths += _write_runs(record, compared, data, folder / name)
    return paths


def median_rows(rows: Sequence[Row]) -> dict[str, Row]:
    """The row with the median mean RMSE of each model, by name of the model."""
    by_model: dict[str, list[Row]] = {}
    for row in rows:
        by_model.setdefault(row.name, []).append(row)
    return {
        model: sorted(group, key=lambda row: row.mean)[(len(group) - 1) // 2]
        for model, group in by_model.items()
    }


def _find_score(row: Row, experiment: str) -> Score:
    return next(score for score in row.scores if score.experiment == experiment)


def _write_runs(name: str, runs: dict[str, Score], data: DataSet, stem: Path) -> list[Path]:
    # the verb reads this module before the table is printed, and matplotlib takes half a second
    from tustinnet.report.drawing import write_figure
    from tustinnet.report.figures import free_run_figure

    styles = {_NAMES[model]: _STYLES[model] for model in runs}
    named = {_NAMES[model]: score for model, score in runs.items()}
    figure = free_run_figure(data[name], named, styles)
    paths = [stem.with_name(f"{stem.name}{ending}") for ending in (".png", ".svg")]
    for path in paths:
        write_figure(figure, path.parent, path.name)
    return paths
