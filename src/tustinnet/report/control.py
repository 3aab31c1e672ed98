"""Tables and figures of a controller: where, margins, robustness, closed loops."""

import textwrap
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tustinnet.channels import Channels, Input
from tustinnet.control.closed_loop import ClosedLoopResult
from tustinnet.control.design import ControlDesign
from tustinnet.control.dynamics import input_limits
from tustinnet.control.export.write import ControllerExport
from tustinnet.control.frequency import LoopResponses
from tustinnet.control.robustness import Robustness
from tustinnet.control.sticking import sticking_distances
from tustinnet.control.trial import Trial
from tustinnet.report.drawing import COLOURS, INPUT, MEASURED, figure_style, plot_line
from tustinnet.report.extrapolation import describe_extrapolation
from tustinnet.report.tables import Table
from tustinnet.wording import join_words

_NEGLIGIBLE = 0.05  # of the window of a goal: smaller distances from it are not reported


def point_table(design: ControlDesign) -> Table:
    """The equilibrium: values of all states and inputs, and the gains of the feedback there."""
    point, feedback = design.point, design.feedback
    channels = design.model.channels
    units = [c.unit for c in channels.coordinates] + [f"{c.unit}/s" for c in channels.coordinates]
    names = [*point.names, *design.estimated.internal[len(design.model.internal) :]]
    units += [""] * (len(names) - len(units))
    inputs = [i.name for i in channels.inputs]
    sizes = np.abs(feedback.gain)
    # what is so much smaller than other gains of an input is what rounding leaves of none
    gain = np.where(sizes > 1e-12 * sizes.max(axis=1, keepdims=True), feedback.gain, 0.0)
    rows = [
        [name, f"{value:.4g}", unit, *(f"{g:.4g}" for g in gain[:, j])]
        for j, (name, value, unit) in enumerate(zip(names, feedback.x0, units, strict=True))
    ]
    n_x = len(names)
    integrals = [channels.coordinates[i].name for i in feedback.integral]
    extra = [f"integral of {name}" for name in integrals]
    extra += [
        f"{i.name}, {k + 1} samples ago" if k else f"{i.name}, a sample ago"
        for k in range(feedback.previous)
        for i in channels.inputs
    ]
    rows += [
        [name, "0", "", *(f"{g:.4g}" for g in gain[:, n_x + j])] for j, name in enumerate(extra)
    ]
    return Table(
        ["state", "value", "unit", *(f"gain of {name}" for name in inputs)],
        rows,
        title="The equilibrium, and the feedback about it",
    )


def margins_table(design: ControlDesign) -> Table:
    """Gain, phase and delay margins of the loop at each input."""
    rows = [
        [
            m.input,
            _factor(m.gain_down),
            _factor(m.gain_up),
            f"{np.degrees(m.phase):.3g} deg" if np.isfinite(m.phase) else "any",
            f"{1e3 * m.delay:.3g} ms" if np.isfinite(m.delay) else "any",
            f"{m.crossover / (2 * np.pi):.3g} Hz" if np.isfinite(m.crossover) else "–",
        ]
        for m in design.margins.inputs
    ]
    peak = design.margins.sensitivity_peak
    has_estimator = design.margins.has_estimator
    what = "the loop with its estimator" if has_estimator else "a loop with all states known"
    if design.margins.needs_friction:
        what += ", which dry friction has to damp"
    return Table(
        ["loop at", "gain from", "gain to", "phase", "delay", "crossover"],
        rows,
        title=f"Margins of {what}; peak of the sensitivity {peak:.3g}",
    )


def _factor(value: float) -> str:
    return "any" if value in (0.0, np.inf) else f"{value:.3g}"


def robustness_table(robustness: Robustness, channels: Channels) -> Table:
    """Table of what the controller does on plants of every kind."""
    units = {c.name: c.unit for c in channels.coordinates}
    names = list(robustness.rows[0].worst)
    rows = []
    for row in robustness.rows:
        time = "–" if row.time_to_reach is None else f"{row.time_to_reach:.2f} s"
        worst = [f"{row.worst[name]:.3g} {units[name]}" for name in names]
        share = f"{row.successes} of {len(row.outcomes)}"
        rows.append([row.kind, row.help, share, *worst, f"{row.energy:.3g}", time])
    return Table(
        [
            "plants",
            "how they differ from the model",
            "succeed",
            *(f"worst {name}" for name in names),
            "energy",
            "held from",
        ],
        rows,
        title="The controller on plants that differ from the model",
    )


def closed_loop_figure(design: ControlDesign, runs: Mapping[str, ClosedLoopResult]) -> Figure:
    """Positions and inputs of closed loops over time, with the plan where there is one.

    Args:
        design: the controller.
        runs: closed loops by label, of which the first is drawn most prominently.
    """
    channels, plan = design.model.channels, design.plan
    n_q, n_u = channels.n_q, channels.n_u
    with figure_style():
        figure = Figure(figsize=(7.0, 1.75 * n_q + 1.4 * n_u + 0.5), layout="constrained")
        panels = figure.subplots(
            n_q + n_u, 1, sharex=True, squeeze=False, height_ratios=(5,) * n_q + (4,) * n_u
        )[:, 0]
        upper, lower = np.split(panels, [n_q])
        for j, (axes, c) in enumerate(zip(upper, channels.coordinates, strict=True)):
            if plan is not None:
                t = plan.dt * np.arange(len(plan.x))
                plot_line(axes, t, plan.x[:, j], color="#b0b0b0", label="plan", linewidth=2.6)
            if c.name in design.goal.at:
                goal = design.point.x[j] if plan is None else plan.goal[j]
                axes.axhline(goal, color=MEASURED, linewidth=0.8, linestyle=":", label="goal")
            for i, (label, run) in reversed([*enumerate(runs.items())]):
                t = run.dt * np.arange(len(run.states))
                plot_line(
                    axes,
                    t,
                    run.states[:, j],
                    color=COLOURS[i % len(COLOURS)],
                    label=label,
                    linewidth=1.4 if i == 0 else 1.0,
                )
            axes.set_ylabel(f"{c.name} [{c.unit}]")
        for j, (axes, i) in enumerate(zip(lower, channels.inputs, strict=True)):
            for k, (label, run) in reversed([*enumerate(runs.items())]):
                t = run.dt * np.arange(len(run.inputs))
                colour = INPUT if len(runs) == 1 else COLOURS[k % len(COLOURS)]
                plot_line(
                    axes,
                    t,
                    run.inputs[:, j],
                    color=colour,
                    label=label,
                    linewidth=0.8,
                    drawstyle="steps-post",
                )
            for end in (design.feedback.lower[j], design.feedback.upper[j]):
                axes.axhline(end, color=MEASURED, linewidth=0.6, linestyle=":")
            axes.set_ylabel(f"{i.name} [{i.unit}]" if i.unit else i.name)
        panels[0].legend(ncols=4, fontsize=7.5, loc="upper right")
        panels[-1].set_xlabel("time [s]")
        return figure


def frequency_figure(responses: LoopResponses, channels: Channels) -> Figure:
    """Bode and Nyquist plots of the loop, its sensitivity, and steps of the goals.

    Bands are of the loops with other values of the parameters.

    Args:
        responses: of the model, and of others.
        channels: the model's.
    """
    hertz = responses.frequencies / (2 * np.pi)
    with figure_style(), np.errstate(all="ignore"):
        figure = Figure(figsize=(7.0, 4.6), layout="constrained")
        (gain, nyquist), (phase, steps) = figure.subplots(2, 2)
        for j, channel in enumerate(channels.inputs):
            loops, colour = responses.loops[:, :, j], COLOURS[j % len(COLOURS)]
            angles = np.unwrap(np.angle(-loops), axis=1) - np.pi
            # of a turn more or less at the lowest frequency rounding decides
            angles -= 2 * np.pi * np.round(angles[:, :1] / (2 * np.pi) + 0.25)
            _banded(gain, hertz, _decibel(np.abs(loops)), colour, channel.name)
            _banded(phase, hertz, np.degrees(angles), colour, channel.name)
            for loop in loops[1:]:
                nyquist.plot(loop.real, loop.imag, color=colour, alpha=0.25, linewidth=0.6)
            nyquist.plot(loops[0].real, loops[0].imag, color=colour)
        _banded(gain, hertz, _decibel(responses.sensitivity), MEASURED, "sensitivity")
        for j, c in enumerate(channels.coordinates):
            rows = responses.steps[:, :, j]
            _banded(
                steps, responses.times, rows, COLOURS[j % len(COLOURS)], f"{c.name} by its goal"
            )
        shown = responses.steps[0]
        nyquist.plot([-1], [0], "+", color=MEASURED)
        nyquist.set(xlim=(-3, 1), ylim=(-2, 2), title="Nyquist plot of the loop, and -1")
        gain.set(title="gain of the loop, and its sensitivity [dB]", ylim=(-40, 40), xscale="log")
        phase.set(title="phase of the loop [deg]", xlabel="frequency [Hz]", xscale="log")
        ends = shown.min() - 0.2, shown.max() + 0.2
        steps.set(
            title="a coordinate after a step of its goal",
            xlabel="time [s]",
            ylabel="share of the step",
        )
        steps.set_ylim(*ends)
        gain.legend(fontsize=7.5)
        steps.legend(fontsize=7.5)
        return figure


def _decibel(size: Float[np.ndarray, "models n"]) -> Float[np.ndarray, "models n"]:
    return 20 * np.log10(size)


def _banded(
    axes: Axes,
    x: Float[np.ndarray, " n"],
    rows: Float[np.ndarray, "models n"],
    colour: str,
    label: str,
) -> None:
    """The first row as a line, all of them as a band."""
    axes.plot(x, rows[0], color=colour, label=label)
    if len(rows) > 1:
        axes.fill_between(x, rows.min(axis=0), rows.max(axis=0), color=colour, alpha=0.2)


def robustness_figure(robustness: Robustness) -> Figure:
    """Shares of the runs that met the goal, for plants of every kind."""
    rows = robustness.rows
    with figure_style():
        figure = Figure(figsize=(7.0, 0.28 * len(rows) + 0.9), layout="constrained")
        axes = figure.subplots()
        places = np.arange(len(rows))
        axes.barh(places, [row.share for row in rows], color=COLOURS[2], height=0.65)
        for place, row in enumerate(rows):
            axes.text(
                0.01,
                place,
                f"{row.successes} of {len(row.outcomes)}",
                va="center",
                color="white" if row.share > 0.2 else "black",
                fontsize=7.5,
            )
        labels = [textwrap.shorten(f"{row.kind}: {row.help}", 50) for row in rows]
        axes.set_yticks(places, labels)
        axes.invert_yaxis()
        axes.set_xlim(0, 1)
        axes.set_xlabel("share of the runs that reach and hold the goal")
        axes.grid(visible=False, axis="y")
        return figure


def sentences(design: ControlDesign) -> list[str]:
    """Sentences on what is known of a controller."""
    point, channels = design.point, design.model.channels
    place = ", ".join(
        f"{c.name} = {x:.4g} {c.unit}{_requested_position(design, c.name, x)}"
        for c, x in zip(channels.coordinates, point.x[channels.position], strict=True)
    )
    inputs = ", ".join(
        f"{i.name} = {u:.4g}{_unit(i)}" for i, u in zip(channels.inputs, point.u, strict=True)
    )
    lines = [
        f"equilibrium: {place}, with {inputs}",
        f"it is {point.stability}; {point.controllable}; {point.observable}",
        f"limits of inputs: {_limits(design)}",
        f"a run meets the goal where it ends {_windows(design)} for {design.goal.hold:.3g} s",
        *_sticking(design),
    ]
    if turning := [point.names[i] for i in design.feedback.periodic]:
        lines.append(f"held at the nearest whole turn: {join_words(turning)}")
    if design.mpc is not None:
        lines.append(
            f"predictive control: at every sample {design.mpc.steps} steps ahead, "
            f"{design.mpc.steps * design.model.dt:.3g} s; gains and margins are those of the "
            "feedback with which it begins"
        )
    elif (pid := design.feedback.pid) is not None:
        per, unit = channels.coordinates[0].unit, channels.inputs[0].unit or "1"
        lines.append(
            f"as a PID in parallel form: kp = {pid.proportional:.4g} {unit}/{per}, "
            f"ki = {pid.integral:.4g} {unit}/({per} s), "
            f"kd = {pid.derivative:.4g} {unit} s/{per}"
        )
    if (plan := design.plan) is not None:
        largest = np.abs(plan.u).max(axis=0)
        used = ", ".join(
            f"{i.name} up to {u:.3g}{_unit(i)}"
            for i, u in zip(channels.inputs, largest, strict=True)
        )
        how = (
            "by computed torque" if design.has_computed_torque else f"{plan.iterations} iterations"
        )
        lines.append(f"motion: {len(plan.u) * plan.dt:.3g} s, {used}, {how}")
    if design.beyond is not None:
        lines.append(f"motion: {describe_extrapolation(design.beyond, channels.dt, 'it')}")
    if design.plan is not None and design.point.is_unstable:
        lines.append(f"after a fall: {_recovery(design)}")
    if design.consistency is None:
        lines.append("estimator: no records were given (`data=`): its noise is a rough guess")
    else:
        lines += [f"estimator: {line}" for line in design.consistency.sentences]
    return lines


def _requested_position(design: ControlDesign, name: str, value: float) -> str:
    """The position that was named, in brackets, where the equilibrium is beside it."""
    goal = design.goal
    is_there = abs(value - goal.at.get(name, value)) <= _NEGLIGIBLE * goal.window.get(name, np.inf)
    return (
        "" if is_there else f" (asked: {goal.at[name]:.4g}, where the model does not stand still)"
    )


def _windows(design: ControlDesign) -> str:
    """Clause on the distances within which positions count as held."""
    units = {c.name: c.unit for c in design.model.channels.coordinates}
    windows = design.goal.window.items()
    return " and ".join(
        f"within {w:.3g} {units[name]} of {name} = {design.goal.at[name]:.4g}"
        for name, w in windows
    )


def _unit(channel: Input) -> str:
    """The unit of an input behind a number; empty where it has none."""
    return "" if channel.unit in ("", "1") else f" {channel.unit}"


def _limits(design: ControlDesign) -> str:
    """The limits of the inputs, with their units."""
    limits = input_limits(design.model, design.task.limits)
    return ", ".join(
        f"{i.name} {low:.4g} to {high:.4g}{_unit(i)}"
        for i, low, high in zip(design.model.channels.inputs, *limits, strict=True)
    )


def _sticking(design: ControlDesign) -> list[str]:
    """A sentence on where dry friction holds the machine, as simulations do not show it."""
    distances = sticking_distances(design.model, design.own_feedback, design.task.delay)
    units = {c.name: c.unit for c in design.model.channels.coordinates}
    large = [
        f"{name} up to {d:.2g} {units[name]}"
        for name, d in distances.items()
        if d > _NEGLIGIBLE * design.goal.window.get(name, np.inf)
    ]
    if not large:
        return []
    return [
        f"dry friction may hold {join_words(large)} from the goal, where simulations creep on to "
        "it; integral action (`integral=`) takes that away"
    ]


def errors_along(design: ControlDesign, trial: Trial) -> list[str]:
    """Sentences on how near a reference is followed: by the plan, and on plants of every kind."""
    if design.task.reference is None or design.plan is None:
        return []
    units = {c.name: c.unit for c in design.model.channels.coordinates}
    runs = {"plan": design.plan.x} | {kind: run.states for kind, run in trial.runs.items()}
    lines = ["largest errors along the reference, in a run on a plant of each kind:"]
    for kind, x in runs.items():
        errors = design.errors_along(x).items()
        lines.append(f"  {kind}: " + ", ".join(f"{n} {e:.3g} {units[n]}" for n, e in errors))
    return lines


def _recovery(design: ControlDesign) -> str:
    """Clause on the recovery: the course of things where the goal is lost."""
    recovery = design.recovery
    if recovery is None:
        return "the motion does not begin again, feedback about the goal goes on"
    fallen = " or ".join(
        f"{c.name} is more than {bound:.3g} {c.unit}"
        for c, bound in zip(design.model.channels.coordinates, recovery.fallen_beyond, strict=False)
        if bound > 0
    )
    return (
        f"where {fallen} from the goal, feedback about the start damps the motion, then the plan "
        "begins again"
    )


def summarise(
    design: ControlDesign, robustness: Robustness, export: ControllerExport | None
) -> dict[str, Any]:
    """A controller and its tests as plain values.

    Args:
        design: the controller.
        robustness: its tests.
        export: what was written of it, None where nothing was.
    """
    point, plan, mpc = design.point, design.plan, design.mpc
    inputs = [i.name for i in design.model.channels.inputs]
    return {
        "at": dict(design.task.at),
        "equilibrium": {
            "states": dict(zip(point.names, point.x.tolist(), strict=True)),
            "inputs": dict(zip(inputs, point.u.tolist(), strict=True)),
            "stability": point.stability,
            "controllable": point.controllable,
            "observable": point.observable,
        },
        "margins": {
            "inputs": [asdict(m) for m in design.margins.inputs],
            "sensitivity_peak": design.margins.sensitivity_peak,
            "peak_frequency": design.margins.peak_frequency,
        },
        "pid": None if mpc or design.feedback.pid is None else design.feedback.pid._asdict(),
        "predictive": None if mpc is None else {"steps": mpc.steps, "iterations": mpc.iterations},
        "motion": None
        if plan is None
        else {
            "seconds": len(plan.u) * plan.dt,
            "computed_torque": design.has_computed_torque,
            "iterations": plan.iterations,
            "cost": plan.cost,
            "largest_inputs": dict(zip(inputs, np.abs(plan.u).max(axis=0).tolist(), strict=True)),
            "begins_again_after_a_fall": design.recovery is not None,
        },
        "estimator": {
            "start": np.asarray(design.noise.start).tolist(),
            "process": np.asarray(design.noise.process).tolist(),
            "measured": np.asarray(design.noise.measured).tolist(),
            "tests": [] if design.consistency is None else list(design.consistency.sentences),
        },
        "robustness": [row.as_plain() for row in robustness.rows],
        "verdict": robustness.sentence,
        "problem": robustness.problem,
        "check": None
        if export is None
        else {"steps": export.checked.steps, "difference": export.checked.difference},
        "files": [] if export is None else list(export.files),
    }
