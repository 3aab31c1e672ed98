"""A controller with its estimator and model as C99, and a program that closes their loop."""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.control.computed_torque import inverse_dynamics
from tustinnet.control.ilqr import SHARES
from tustinnet.control.lqr import Feedback, Tracking, as_tracking
from tustinnet.control.mpc import ROUNDING, Mpc
from tustinnet.control.riccati import SWEEPS
from tustinnet.export.c import make_filter_code, make_model_files, markdown_cell, math_helpers
from tustinnet.export.c_text import Code, constant_array
from tustinnet.export.source import Source
from tustinnet.export.target import Files
from tustinnet.export.words import fill_template
from tustinnet.program.program import Program
from tustinnet.program.reading import read
from tustinnet.simulate.filtering import GATE, LOST_AFTER, FilterNoise

TEMPLATES = Path(__file__).parent / "templates"
LOOP_SOURCES = ("controller.c", "estimator.c", "model.c")
SOURCES = ("main.c", *LOOP_SOURCES)

_SCRIPTS = {
    "step.casadi": "a step of the model for CasADi, earlier inputs behind its states",
    "problem.py": "the control problem in CasADi, solved by ipopt",
    "acados_problem.py": "the problem for acados, which generates a solver in C",
    "do_mpc_controller.py": "a predictive controller by do-mpc",
}

Vector = Float[np.ndarray, " _"]


def make_code(
    controller: Feedback | Tracking | Mpc,
    source: Source,
    noise: FilterNoise,
    start: Vector,
    steps: int,
    lost_after: int = LOST_AFTER,
) -> Files:
    """The files in C, and a Makefile.

    Args:
        controller: the controller.
        source: the model, with a causal layout of its inputs.
        noise: the noise of the estimator.
        start: the state from which the loop in software begins, (n_x,).
        steps: the periods that it lasts.
        lost_after: samples in a row without use after which the estimate is lost.
    """
    return {
        **make_model_files(source, lost_after=lost_after),
        **estimator_files(source, noise),
        **controller_files(controller, source),
        "main.c": _main(source, start, steps),
        "Makefile": fill_template("Makefile", TEMPLATES),
    }


def estimator_files(source: Source, noise: FilterNoise) -> Files:
    """`estimator.h` and `estimator.c`."""
    channels = source.channels
    deviations = [
        constant_array("start_noise", np.asarray(noise.start)),
        constant_array("process_noise", np.asarray(noise.process)),
        constant_array("measurement_noise", np.asarray(noise.measured)),
    ]
    filter_code = make_filter_code("estimator.h", channels.angular.tolist())
    return {
        "estimator.h": fill_template("estimator.h", TEMPLATES, inputs=channels.n_u),
        "estimator.c": filter_code
        + fill_template("estimator.c", TEMPLATES, noise="".join(deviations)),
    }


def gains_of(controller: Feedback | Tracking | Mpc) -> Feedback | Tracking:
    """The feedback of a controller; that with which predictive control begins."""
    return controller.gains if isinstance(controller, Mpc) else controller


def controller_files(controller: Feedback | Tracking | Mpc, source: Source) -> Files:
    """`controller.h` and `controller.c`."""
    tracking = as_tracking(gains_of(controller))
    plan, final, recovery = tracking.plan, tracking.final, tracking.recovery
    settle = recovery.feedback if recovery else None
    own, none = tracking.by_acceleration, np.zeros(0)
    n_x, n_i = len(final.x0), len(final.integral)
    # integrals last, so that the gains of a plan, which has none, are in the same order
    order = [*range(n_x), *range(n_x + n_i, final.gain.shape[1]), *range(n_x, n_x + n_i)]
    numbers = {
        "gain": final.gain[:, order],
        "x0": final.x0,
        "u0": final.u0,
        "lower": final.lower,
        "upper": final.upper,
        "safe": _safe(final),
        "before": plan.before,
        "plan_x": plan.x if len(plan.u) else none,
        "plan_u": none if own else plan.u,
        "plan_gain": none if own else tracking.gains,
        **{
            f"settle_{name}": getattr(settle, name) if settle else none
            for name in ("gain", "x0", "u0")
        },
        "fallen_beyond": recovery.fallen_beyond if recovery else np.zeros(n_x),
        "settled_within": recovery.settled_within if recovery else np.zeros(n_x),
    }
    indices = {"integrated": final.integral, "periodic": final.periodic}
    tables = [
        *(_index_table(name, values) for name, values in indices.items()),
        *(constant_array(name, v if v.size else np.zeros(1)) for name, v in numbers.items()),
    ]
    law = Code()
    if own:
        law.add("required", _required_inputs(source))
        tables.append(constant_array("acceleration_gain", np.array(own)))
    return {
        "controller.h": fill_template(
            "controller.h",
            TEMPLATES,
            inputs=source.channels.n_u,
            integrals=n_i,
            previous=final.previous,
            periodic=len(final.periodic),
            steps=len(plan.u),
            recovers=int(recovery is not None),
            accelerates=int(own is not None),
            ahead=controller.steps if isinstance(controller, Mpc) else 0,
        ),
        "controller.c": fill_template(
            "controller.c",
            TEMPLATES,
            helpers=math_helpers(wrap=True),
            tables="".join(tables),
            required=law.text(),
            predict=_predictive_code(controller) if isinstance(controller, Mpc) else "",
        ),
    }


def _required_inputs(source: Source) -> Program:
    """The inverse dynamics as a program: `x` and `a` to the inputs `u`."""
    function = inverse_dynamics(source.model)
    sizes = {"x": source.n_x, "a": source.channels.n_q}
    return read(lambda x, a: {"u": function(x, a)}, sizes, "the inverse dynamics")


def _predictive_code(controller: Mpc) -> str:
    """The part of `controller.c` that plans ahead."""
    cost = controller.cost
    tables = {
        "goal_x": controller.goal,
        "ends": controller.ends,
        "state_weight": cost.states,
        "input_weight": cost.inputs,
        "least": cost.lower,
        "most": cost.upper,
        "penalty": cost.penalty,
        "shares": np.array(SHARES),
        "rounding": np.array(ROUNDING),
    }
    return fill_template(
        "predict.c",
        TEMPLATES,
        iterations=controller.iterations,
        sweeps=SWEEPS,
        tables="".join(constant_array(name, values) for name, values in tables.items()),
    )


def _safe(feedback: Feedback) -> Vector:
    """The inputs while the state is not known, (n_u,)."""
    return feedback.command(np.full(len(feedback.u0), np.nan))


def _index_table(name: str, values: Sequence[int]) -> str:
    """The definition of a table of indices."""
    text = ", ".join(str(i) for i in values or (0,))
    return f"static const int {name}[{max(len(values), 1)}] = {{{text}}};\n"


def _main(source: Source, start: Vector, steps: int) -> str:
    """`main.c`."""
    tables = [
        constant_array("start", start),
        constant_array("resolution", source.channels.resolution),
    ]
    return fill_template(
        "main.c",
        TEMPLATES,
        precision=fill_template("precision.c"),
        steps=steps,
        tables="".join(tables),
        header=_c_string(csv_header(source)),
    )


def csv_header(source: Source) -> str:
    """The names of the columns that the loop in software prints."""
    estimates = [f"estimated_{name}" for name in source.states]
    line = StringIO()
    inputs = [i.name for i in source.channels.inputs]
    csv.writer(line, lineterminator="").writerow(["time", *source.states, *estimates, *inputs])
    return line.getvalue()


def _c_string(text: str) -> str:
    """A text as a string of C; other bytes than letters and digits of ASCII by their numbers."""
    plain = set(b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-., ")
    return '"' + "".join(chr(b) if b in plain else f"\\{b:03o}" for b in text.encode()) + '"'


def make_readme(
    controller: Feedback | Tracking | Mpc,
    source: Source,
    scripts: Sequence[str],
    notes: Sequence[str],
) -> str:
    """`README.md` of the folder.

    Args:
        controller: the controller.
        source: the model.
        scripts: the files for solvers that are in the folder.
        notes: remarks.
    """
    gains = gains_of(controller)
    final = gains.final
    kind = "linear feedback about the goal"
    if isinstance(gains, Tracking):
        law = "computed torque" if gains.by_acceleration else "feedback"
        kind = f"a plan of {len(gains.plan.u)} periods with {law} along it, then {kind}"
        if gains.recovery is not None:
            kind += "; after a fall feedback about the plan's start, then the plan again"
    if isinstance(controller, Mpc):
        kind = f"predictive control, {controller.steps} periods ahead, which begins with {kind}"
    states = [
        f"| `x[{i}]` | {markdown_cell(name)} | {markdown_cell(unit)} | {x0:.6g} |"
        for i, (name, unit, x0) in enumerate(
            zip(source.states, source.units, final.x0.tolist(), strict=True)
        )
    ]
    columns = (final.lower, final.upper, final.u0, _safe(final))
    rows = np.stack(columns, axis=1).tolist()
    inputs = [
        f"| `u[{i}]` | {markdown_cell(channel.name)} | {markdown_cell(channel.unit)} "
        f"| {' | '.join(f'{value:.6g}' for value in row)} |"
        for i, (channel, row) in enumerate(zip(source.channels.inputs, rows, strict=True))
    ]
    return fill_template(
        "readme.md",
        TEMPLATES,
        title="A controller in C99",
        period=float(source.channels.dt),
        kind=kind,
        positions=source.channels.n_q,
        states="\n".join(states),
        inputs="\n".join(inputs),
        gate=f"{GATE:g}",
        scripts="\n".join(f"| `{name}` | {_SCRIPTS[name]} |" for name in scripts),
        notes="\n".join(f"- {note}" for note in notes) or "Nothing beyond this file.",
    )
