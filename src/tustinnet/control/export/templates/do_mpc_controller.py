"""A predictive controller of the problem of `problem.py` by do-mpc, played on the model itself.

    python do_mpc_controller.py

It needs do-mpc and what `problem.py` needs. In a laboratory the state comes from an estimator.
"""

import do_mpc
import numpy as np
import problem

AHEAD = @ahead@  # periods that the controller looks ahead
PLAYED = @played@  # periods that are played


def reference():
    """The states that the controller follows, one for each sample: the plan, then the goal."""
    if problem.CONTROLLER.get("plan") is None:
        return np.tile(problem.GOAL, (PLAYED + AHEAD + 1, 1))
    states, _ = problem.first_guess()
    rest = np.tile(problem.GOAL, (max(0, PLAYED + AHEAD + 1 - len(states)), 1))
    return np.concatenate([states, rest])


def make_controller(states):
    """The controller, which follows some states, (samples, n_x)."""
    model = do_mpc.model.Model("discrete")
    x = model.set_variable("_x", "x", (len(problem.STATES), 1))
    u = model.set_variable("_u", "u", (len(problem.INPUTS), 1))
    follow = model.set_variable("_tvp", "follow", (len(problem.STATES), 1))
    model.set_rhs("x", problem.STEP(x, u))
    model.setup()

    mpc = do_mpc.controller.MPC(model)
    mpc.set_param(n_horizon=AHEAD, t_step=problem.PERIOD, store_full_solution=False)
    mpc.settings.supress_ipopt_output()
    mpc.set_objective(
        mterm=problem.final_cost(x, follow), lterm=problem.step_cost(x, u, follow)
    )
    mpc.set_rterm(u=0.0)
    mpc.bounds["lower", "_u", "u"] = problem.LOWER
    mpc.bounds["upper", "_u", "u"] = problem.UPPER
    template = mpc.get_tvp_template()

    def followed(now):
        first = round(np.asarray(now).item() / problem.PERIOD)
        for k in range(AHEAD + 1):
            template["_tvp", k, "follow"] = states[min(first + k, len(states) - 1)]
        return template

    mpc.set_tvp_fun(followed)
    mpc.setup()
    return mpc


def play(steps=PLAYED):
    """States, (steps + 1, n_x), and inputs, (steps, n_u), of the model under the controller."""
    mpc = make_controller(reference())
    mpc.x0 = problem.START
    mpc.set_initial_guess()
    states, inputs = [problem.START], []
    for _ in range(steps):
        inputs.append(mpc.make_step(states[-1][:, None]).ravel())
        states.append(problem.STEP(states[-1], inputs[-1]).full().ravel())
    return np.array(states), np.array(inputs)


if __name__ == "__main__":
    states, inputs = play()
    for name, first, last in zip(problem.STATES, states[0], states[-1], strict=True):
        print(f"{name} goes from {first:.4g} to {last:.4g} in {len(inputs)} periods")
