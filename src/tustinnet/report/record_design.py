"""Tables, sentences, figure and files of a designed record."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tustinnet.evaluate.record_design import BaseParameter, RecordDesign
from tustinnet.report.drawing import INPUT, MEASURED, figure_style, write_figure
from tustinnet.report.tables import Table
from tustinnet.store.files import lock_folder, require_outputs, to_json, write_into
from tustinnet.store.motion_file import write_motion
from tustinnet.wording import counted

_FILES = ("motion.csv", "motion.png", "design.json", "design.md")
_SHOWN = 5  # of the best and of the worst determined base parameters


def write_design(design: RecordDesign, folder: str | Path, *, overwrite: bool = False) -> None:
    """Writes the files of a designed record into a folder.

    `motion.csv` is the reference for a controller: a row for each sample with time, position,
    velocity and acceleration of each coordinate, and the inputs that are expected. `motion.png`
    draws it. `design.md` says which limits it uses and what it tells, `design.json` has all
    numbers.

    Args:
        design: the designed record.
        folder: the folder.
        overwrite: whether an earlier design in it may be replaced.

    Raises:
        InputError: an earlier design, or a folder that cannot be written.
    """
    folder = Path(folder)
    require_outputs([folder / name for name in _FILES], overwrite=overwrite)
    motion, figure, numbers, text = _FILES
    tables = "\n".join(t.markdown() for t in (motion_table(design), error_table(design)))
    lines = "".join(f"* {sentence}\n" for sentence in sentences(design))
    with lock_folder(folder):
        write_motion(folder, motion, design)
        write_into(folder, numbers, to_json(design.as_plain()))
        write_into(folder, text, f"{tables}\n{lines}")
        write_figure(design_figure(design), folder, figure)


def motion_table(design: RecordDesign) -> Table:
    """Table of the largest values of each coordinate, and of the limits that they keep."""
    rows = []
    for j, c in enumerate(design.channels.coordinates):
        own, q = design.limits.motion[j], design.q[:, j]
        assert own.position is not None
        cells = [f"{q.min():.3g}..{q.max():.3g} of {own.position[0]:.3g}..{own.position[1]:.3g}"]
        for values, limit in (
            (design.v, own.velocity),
            (design.a, own.acceleration),
            (design.force, own.force),
        ):
            largest = np.abs(values[:, j]).max()
            cells.append(f"{largest:.3g}" + ("" if limit is None else f" of {limit:.3g}"))
        rows.append([f"{c.name} [{c.unit}]", *cells])
    title = "Largest values, and the limits (SI units)"
    return Table(["coordinate", "position", "velocity", "acceleration", "force"], rows, title=title)


def error_table(design: RecordDesign) -> Table:
    """Table of the expected standard errors of the best and worst determined base parameters."""
    parameters = design.base_parameters
    shown = parameters
    if len(parameters) > 2 * _SHOWN + 1:
        shown = *parameters[:_SHOWN], *parameters[-_SHOWN:]
    has_records = any(b.known is not None for b in parameters)
    rows = [
        [
            _label(b),
            b.unit,
            f"{b.file:.3g}",
            *([f"{b.known:.3g}"] if b.known is not None else []),
            f"{b.expected:.3g}",
            f"{100 * b.remaining:.2g} %",
        ]
        for b in shown
    ]
    if len(shown) < len(parameters):
        rows.insert(_SHOWN, [f"({len(parameters) - len(shown)} more)", *[""] * (len(rows[0]) - 1)])
    before = ["records so far"] if has_records else []
    columns = ["base parameter", "unit", "file", *before, "with this record", "of the file's"]
    title = "Standard errors of base parameters, the best determined one first"
    return Table(columns, rows, title=title)


def _label(b: BaseParameter) -> str:
    return b.name if not b.terms else f"{b.name} with {counted(len(b.terms), 'other')}"


def sentences(design: RecordDesign) -> list[str]:
    """Sentences on what the record is worth, where it begins, and what was not looked at."""
    names = [c.name for c in design.channels.coordinates]
    start = ", ".join(f"{name} {x:.4g}" for name, x in zip(names, design.q[0], strict=True))
    periods = round(design.options.seconds * design.motion.frequency)
    has_records = design.base_parameters[0].known is not None
    noise = ", ".join(
        f"{name} {x:.2g} {unit}"
        for name, x, unit in zip(names, design.noise, design.force_units, strict=True)
    )
    lines = [
        f"{counted(len(design.base_parameters), 'base parameter')}; by random motions within the "
        f"same limits the errors would be {design.by_random:.2f} times as large (geometric mean)",
        f"{design.options.seconds:g} s, {counted(periods, 'period')} of "
        f"{counted(len(design.motion.sine), 'harmonic')} of {design.motion.frequency:.4g} Hz; "
        f"it begins and ends at rest at {start}: move there first",
    ]
    if has_records:
        better = [b.known / b.expected for b in design.base_parameters if b.known is not None]
        mean = float(np.exp(np.mean(np.log(better))))
        lines.insert(
            1,
            f"it makes the errors of the records so far {mean:.2f} times smaller (geometric mean)",
        )
    lines.append(f"forces that are taken to stay unexplained: {noise}")
    if design.stopped:
        lines.append("the time ended before the search: `budget=` gives it more")
    lines.append(
        "collisions are not looked at: play the motion in a simulation of the cell, then slowly, "
        "before it is recorded"
    )
    return lines


def design_figure(design: RecordDesign) -> Figure:
    """Figure of the motion: position, velocity, acceleration and force of each coordinate.

    Dashed lines are limits, dotted ones what the margin leaves of them.
    """
    n = design.channels.n_q
    with figure_style():
        figure = Figure(figsize=(10.5, 1.25 * n + 0.9), layout="constrained")
        panels = figure.subplots(n, 4, sharex=True, squeeze=False)
        for j, c in enumerate(design.channels.coordinates):
            own = design.limits.motion[j]
            rates = [
                None if x is None else (-x, x) for x in (own.velocity, own.acceleration, own.force)
            ]
            for axes, values, ends, what in zip(
                panels[j],
                (design.q, design.v, design.a, design.force),
                (own.position, *rates),
                (
                    f"position [{c.unit}]",
                    f"velocity [{c.unit}/s]",
                    f"acceleration [{c.unit}/s²]",
                    f"force [{design.force_units[j]}]",
                ),
                strict=True,
            ):
                colour = INPUT if values is design.force else MEASURED
                axes.plot(design.t, values[:, j], color=colour)
                axes.set_title(what if j == 0 or c.kind == "linear" else "", loc="left", fontsize=8)
                if ends is None:
                    continue
                reach, middle = np.abs(values[:, j] - np.mean(ends)).max(), np.mean(ends)
                half = (ends[1] - ends[0]) / 2
                if reach < half / 4:  # a limit that far away would flatten the line
                    continue
                for size, style in ((half, "--"), ((1 - design.options.margin) * half, ":")):
                    for side in (-1, 1):
                        axes.axhline(middle + side * size, color="0.5", linestyle=style, lw=0.8)
            panels[j, 0].set_ylabel(c.name)
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        figure.align_ylabels()
        title = "dashed: limits, where the motion comes near; dotted: what the margin leaves"
        figure.suptitle(title, fontsize=8)
        return figure
