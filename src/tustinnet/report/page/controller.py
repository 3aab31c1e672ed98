"""The HTML page of a controller: the mechanism under control, margins, robustness, a playground."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from tustinnet.control.closed_loop import ClosedLoopResult
from tustinnet.control.design import ControlDesign
from tustinnet.control.export.gains import controller_json
from tustinnet.control.trial import Trial
from tustinnet.errors import InputError
from tustinnet.export.javascript import MODULE, TARGET
from tustinnet.export.source import make_source
from tustinnet.families.family import family_of
from tustinnet.report.control import (
    margins_table,
    point_table,
    robustness_table,
    sentences,
)
from tustinnet.report.page import text_and_tables as text
from tustinnet.report.page.content import mechanism_content, range_content
from tustinnet.report.page.render import render
from tustinnet.report.page.signals import bounded, pack, thin
from tustinnet.simulate.range import Range
from tustinnet.store.files import write_into
from tustinnet.store.model_file import package_versions
from tustinnet.wording import join_words

_ESTIMATE, _PLAN = "estimate", "plan"


def write_control_page(
    design: ControlDesign,
    trial: Trial,
    path: Path,
    *,
    training_range: Range | None = None,
    command: str = "",
) -> Path:
    """Writes the page of a controller: one HTML file that needs no server and no network.

    Args:
        design: the controller.
        trial: its closed loops.
        path: the file.
        training_range: the range of the model's training records.
        command: the command that made the controller.
    """
    model = design.model
    equations = family_of(model).equations(model)
    links = () if equations is None else equations.system.links
    labels = [_ESTIMATE, *([] if design.plan is None else [_PLAN])]
    content = {
        **mechanism_content(model.channels, links),
        "truth": "plant",
        # the lines that are drawn beside the plant, as the models of a report
        "models": [{"label": label, "warmUp": model.warm_up} for label in labels],
        "records": [_run_content(label, run, design) for label, run in trial.runs.items()],
        "controller": _controller_content(design),
        **range_content([training_range] * len(labels), model.channels),
    }
    modules: dict[int, str] = {}
    with suppress(InputError):  # the page is without its playground then
        modules[0] = str(TARGET.files(make_source(model, training_range))[MODULE])
    rows = trial.robustness.rows
    context = {
        "title": f"{join_words(c.name for c in model.coordinates)} under control",
        "verdict": trial.robustness.sentence[:1].upper() + trial.robustness.sentence[1:] + ".",
        "inputs": text.describe_inputs(model.channels),
        "records": [*trial.runs],
        "models": labels,
        "hold": design.goal.hold,
        "robustness": robustness_table(trial.robustness, model.channels),
        "failures": [f"{row.kind}: {row.failures}" for row in rows if row.failures],
        "sentences": sentences(design),
        "point": point_table(design),
        "margins": margins_table(design),
        "versions": ", ".join(f"{name} {v}" for name, v in package_versions().items()),
        "command": command,
        "has": {
            "playground": bool(modules),
            "plan": design.plan is not None,
            "recovery": design.recovery is not None,
            "predictive": design.mpc is not None,
            "range": training_range is not None,
        },
    }
    write_into(path.parent, path.name, render(context, content, modules, "control.html"))
    return path


def _run_content(label: str, run: ClosedLoopResult, design: ControlDesign) -> dict[str, Any]:
    """The signals of a closed loop, all at the same times."""
    channels, plan = design.model.channels, design.plan
    n, positions = len(run.states), channels.position
    q, v = run.states[:, positions], run.states[:, channels.velocity]
    u = np.concatenate([run.inputs, run.inputs[-1:]]) if len(run.inputs) else np.zeros((n, 0))
    lines = [run.estimates[:, positions]]
    if plan is not None:
        at_goal = np.repeat(plan.goal[None], max(0, n - len(plan.x)), axis=0)
        lines.append(np.concatenate([plan.x, at_goal])[:n, positions])
    errors = [bounded(line, q) - q for line in lines]
    # a thousand samples of a run are drawn
    samples = thin(np.concatenate([q, v, u, *errors], axis=1), 1000)
    t = run.dt * np.arange(n)
    by_unit = channels.places_by_unit.values()

    def packed(signals: np.ndarray) -> list[dict[str, Any]]:
        return [pack(column) for column in signals[samples].T]

    return {
        "name": label,
        "split": None,
        "t": pack(t[samples]),
        "q": packed(q),
        "v": packed(v),
        "u": packed(u),
        "runs": [
            {"error": packed(error), "rmse": [_rms(error[:, places]) for places in by_unit]}
            for error in errors
        ],
    }


def _rms(errors: np.ndarray) -> float:
    """Root mean square of the numbers that are not NaN, NaN where there are none."""
    numbers = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(numbers**2))) if len(numbers) else np.nan


def _controller_content(design: ControlDesign) -> dict[str, Any]:
    content = json.loads(controller_json(design.gains, design.model.channels))
    content["feedback"]["period"] = content["period"]
    return content
