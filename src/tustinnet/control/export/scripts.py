"""A controller's task for solvers of optimal control: scripts for CasADi, acados and do-mpc."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from tustinnet.control.cost import Cost
from tustinnet.control.dynamics import ControlledModel
from tustinnet.control.lqr import Feedback, Tracking
from tustinnet.export.casadi import FILE, step_file
from tustinnet.export.target import Files
from tustinnet.export.words import fill_template
from tustinnet.program.reading import read

TEMPLATES = Path(__file__).parent / "templates"
SCRIPTS = ("problem.py", "acados_problem.py", "do_mpc_controller.py")

_STEPS = 100  # that a problem without a plan looks ahead

Vector = Float[np.ndarray, " _"]


def make_scripts(
    controller: Feedback | Tracking, system: ControlledModel, cost: Cost, start: Vector
) -> Files:
    """`step.casadi` and the scripts that use it.

    Their states are those of a controlled model: earlier inputs that a step depends on are behind
    the model's own.

    Args:
        controller: the controller, whose plan is the first guess.
        system: the model, with the delay of the controller.
        cost: what the scripts minimise, with a goal that does not move.
        start: the state from which the motion begins, (n_x,).
    """
    final, previous, n_u = controller.final, system.previous, system.n_u
    goal, before, steps, played = cost.x, final.u0, _STEPS, _STEPS
    if isinstance(controller, Tracking):
        plan = controller.plan
        start, goal, before, steps = plan.x[0], plan.goal, plan.before, len(plan.u)
        played = steps + 100
    inputs = [i.name for i in system.model.channels.inputs]
    earlier = [f"{name}_before_{k}" for k in range(1, previous + 1) for name in inputs]

    def with_earlier(of_states: Vector, of_inputs: Vector) -> str:
        return _numbers(np.concatenate([of_states, np.tile(of_inputs, previous)]))

    free = np.full(n_u, np.inf)
    values = {
        "states": repr([*system.names, *earlier]),
        "inputs": repr(inputs),
        "previous": previous,
        "period": repr(system.dt),
        "steps": steps,
        "start": with_earlier(start, before),
        "goal": with_earlier(goal, cost.u),
        "goal_input": _numbers(cost.u),
        "lower": _numbers(final.lower),
        "upper": _numbers(final.upper),
        "state_weights": with_earlier(cost.states, np.zeros(n_u)),
        "input_weights": _numbers(cost.inputs),
        "final_weights": _numbers(cost.end),
        "least": with_earlier(cost.lower, -free),
        "most": with_earlier(cost.upper, free),
        "penalty": with_earlier(cost.penalty, np.zeros(n_u)),
        "ahead": min(40, steps),
        "played": played,
    }
    step = read(lambda x, u: {"x": system.function(x, u)}, {"x": system.size, "u": n_u})
    scripts = {name: fill_template(f"{name}.in", TEMPLATES, **values) for name in SCRIPTS}
    return {FILE: step_file(step), **scripts}


def _numbers(values: np.ndarray) -> str:
    """An array as Python has it, each number in full."""
    return repr(np.asarray(values, np.float64).tolist()).replace("inf", "np.inf")
