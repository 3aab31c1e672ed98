"""The control problem in CasADi, solved by ipopt.

    python problem.py

It needs casadi and NumPy, and the files `step.casadi` and `controller.json` beside it. Numbers may
be changed here; `acados_problem.py` and `do_mpc_controller.py` take them from here.
"""

import json
from pathlib import Path

import casadi
import numpy as np

HERE = Path(__file__).resolve().parent
CONTROLLER = json.loads((HERE / "controller.json").read_text(encoding="utf-8"))
# (x, u) -> x one period later; u is held
STEP = casadi.Function.load(str(HERE / "step.casadi"))

STATES = @states@
INPUTS = @inputs@
PERIOD = @period@  # s
STEPS = @steps@  # periods that the problem looks ahead
START = np.array(@start@)
GOAL = np.array(@goal@)  # the state in which the motion ends
GOAL_INPUT = np.array(@goal_input@)  # the input that holds it
LOWER, UPPER = np.array(@lower@), np.array(@upper@)  # limits of the inputs
# weights of squared differences from the goal along the way, and their matrix at the end
STATE_WEIGHTS = np.array(@state_weights@)
INPUT_WEIGHTS = np.array(@input_weights@)
FINAL_WEIGHTS = np.array(@final_weights@)
# states beyond these limits cost a weight times the square of what is beyond
LEAST, MOST = np.array(@least@), np.array(@most@)
PENALTY = np.array(@penalty@)


def first_guess():
    """States, (STEPS + 1, n_x), and inputs, (STEPS, n_u): the plan, held at its end.

    Without a plan a straight line from the start to the goal.
    """
    plan = CONTROLLER.get("plan")
    if plan is None:
        line = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
        return START + line * (GOAL - START), np.tile(GOAL_INPUT, (STEPS, 1))
    states = np.array(plan["x"])[np.minimum(np.arange(STEPS + 1), len(plan["u"]))]
    inputs = np.array(plan["u"])[:STEPS]
    rest = np.tile(GOAL_INPUT, (STEPS - len(inputs), 1))
    return states, np.concatenate([inputs, rest])


def penalty(x):
    """The cost of a state beyond its limits, (n_x, 1)."""
    total = casadi.DM(0)
    for i in np.flatnonzero(PENALTY):
        if np.isfinite(MOST[i]):
            total += PENALTY[i] * casadi.fmax(x[i] - MOST[i], 0) ** 2 / 2
        if np.isfinite(LEAST[i]):
            total += PENALTY[i] * casadi.fmax(LEAST[i] - x[i], 0) ** 2 / 2
    return total


def step_cost(x, u, goal=GOAL):
    """The cost of a step, from the state (n_x, 1) and the input (n_u, 1)."""
    error, effort = x - goal, u - GOAL_INPUT
    squares = casadi.sum1(STATE_WEIGHTS * error**2) + casadi.sum1(INPUT_WEIGHTS * effort**2)
    return squares / 2 + penalty(x)


def final_cost(x, goal=GOAL):
    """The cost of the state at the end, (n_x, 1)."""
    error = x - goal
    return error.T @ FINAL_WEIGHTS @ error / 2 + penalty(x)


def cost(states, inputs):
    """The cost of a motion: states (n_x, STEPS + 1), inputs (n_u, STEPS), a column for a sample."""
    steps = [step_cost(states[:, k], inputs[:, k]) for k in range(STEPS)]
    return sum(steps) + final_cost(states[:, -1])


def solve(start=START):
    """States, (STEPS + 1, n_x), inputs, (STEPS, n_u), and what ipopt says of them."""
    problem = casadi.Opti()
    states = problem.variable(len(STATES), STEPS + 1)
    inputs = problem.variable(len(INPUTS), STEPS)
    problem.minimize(cost(states, inputs))
    problem.subject_to(states[:, 0] == start)
    problem.subject_to(states[:, 1:] == STEP.map(STEPS)(states[:, :-1], inputs))
    for i in range(len(INPUTS)):
        problem.subject_to(problem.bounded(LOWER[i], inputs[i, :], UPPER[i]))
    guessed_states, guessed_inputs = first_guess()
    problem.set_initial(states, guessed_states.T)
    problem.set_initial(inputs, guessed_inputs.T)
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    solution = problem.solve()
    found = [np.reshape(solution.value(v), v.shape).T for v in (states, inputs)]
    return *found, solution.stats()


if __name__ == "__main__":
    guess = [array.T for array in first_guess()]
    states, inputs, stats = solve()
    print(f"cost of the first guess {float(cost(*guess)):.6g}")
    print(f"cost {float(cost(states.T, inputs.T)):.6g}, {stats['return_status']}, "
          f"{stats['iter_count']} iterations")
    for name, value in zip(STATES, states[-1], strict=True):
        print(f"{name} ends at {value:.6g}")
