"""A controller's task for solvers of optimal control: scripts for CasADi, acados and do-mpc."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.control.cost import Cost
from tustinnet.control.lqr import Feedback, Tracking
from tustinnet.export.casadi import TARGET
from tustinnet.export.source import InputLayout, Source
from tustinnet.export.target import Files
from tustinnet.export.words import fill_template

TEMPLATES = Path(__file__).parent / "templates"
SCRIPTS = ("problem.py", "acados_problem.py", "do_mpc_controller.py")

_STEPS = 100  # that a problem without a plan looks ahead
_AHEAD = 40  # that the controller by do-mpc looks ahead
_AFTER = 100  # that it is played after the plan

Vector = Float[np.ndarray, " _"]


def make_scripts(
    controller: Feedback | Tracking, source: Source, cost: Cost, start: Vector
) -> Files:
    """`step.casadi` and the scripts that use it.

    Their step holds the inputs and knows no delays.

    Args:
        controller: the controller, whose plan is the first guess.
        source: the model.
        cost: what the scripts minimise, with a goal that does not move.
        start: the state from which the motion begins, (n_x,).
    """
    n_x = source.n_x
    final = controller.final
    if isinstance(controller, Tracking):
        start, steps = controller.plan.x[0], len(controller.plan.u)
        goal, played = controller.plan.goal, steps + _AFTER
    else:
        goal, steps, played = cost.x, _STEPS, _STEPS
    values = {
        "states": repr(list(source.states)),
        "inputs": repr([i.name for i in source.channels.inputs]),
        "period": repr(float(source.channels.dt)),
        "steps": steps,
        "start": _numbers(start),
        "goal": _numbers(goal),
        "goal_input": _numbers(cost.u),
        "lower": _numbers(final.lower),
        "upper": _numbers(final.upper),
        "state_weights": _numbers(cost.states),
        "input_weights": _numbers(cost.inputs),
        "final_weights": _numbers(cost.end[:n_x, :n_x]),  # without previous commands
        "least": _numbers(cost.lower),
        "most": _numbers(cost.upper),
        "penalty": _numbers(cost.penalty),
        "ahead": min(_AHEAD, steps),
        "played": played,
    }
    step = TARGET.files(held_source(source))
    return {**step, **{name: fill_template(f"{name}.in", TEMPLATES, **values) for name in SCRIPTS}}


def held_source(source: Source) -> Source:
    """The model with a step whose inputs are those of the sample, held, (n_u,)."""
    n_u = source.channels.n_u
    return replace(source, layout=InputLayout((0,), np.eye(n_u), (n_u,)))


def _numbers(values: np.ndarray) -> str:
    """An array as Python has it, each number in full."""
    return repr(np.asarray(values, np.float64).tolist()).replace("inf", "np.inf")
