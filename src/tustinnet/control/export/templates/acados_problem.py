"""The control problem of `problem.py` for acados, which generates a solver in C.

    python acados_problem.py

It needs acados and its Python package acados_template, see
https://docs.acados.org/python_interface, and what `problem.py` needs.
"""

import casadi
import numpy as np
import problem

NAME = "controller"  # of the files that acados generates


def expressions():
    """Symbols of state and inputs, and the state one period later as an expression of them."""
    # the quicker kind where the step has no products of matrices
    kind = casadi.SX if problem.STEP.is_a("SXFunction") else casadi.MX
    x = kind.sym("x", len(problem.STATES))
    u = kind.sym("u", len(problem.INPUTS))
    return x, u, problem.STEP(x, u)


def make_solver(AcadosModel, AcadosOcp, AcadosOcpSolver):
    """The solver: weighted squares, limits of the inputs, Gauss-Newton steps of an SQP method."""
    n_x, n_u = len(problem.STATES), len(problem.INPUTS)
    ocp = AcadosOcp()
    ocp.model = AcadosModel()
    ocp.model.name = NAME
    ocp.model.x, ocp.model.u, ocp.model.disc_dyn_expr = expressions()

    # half of (y - yref)' W (y - yref) with y = [x, u]
    ocp.cost.cost_type = ocp.cost.cost_type_e = "LINEAR_LS"
    ocp.cost.Vx = np.eye(n_x + n_u, n_x)
    ocp.cost.Vu = np.eye(n_x + n_u, n_u, -n_x)
    ocp.cost.Vx_e = np.eye(n_x)
    ocp.cost.W = np.diag(np.concatenate([problem.STATE_WEIGHTS, problem.INPUT_WEIGHTS]))
    ocp.cost.W_e = problem.FINAL_WEIGHTS
    ocp.cost.yref = np.concatenate([problem.GOAL, problem.GOAL_INPUT])
    ocp.cost.yref_e = problem.GOAL

    ocp.constraints.idxbu = np.arange(n_u)
    ocp.constraints.lbu, ocp.constraints.ubu = problem.LOWER, problem.UPPER
    ocp.constraints.x0 = problem.START
    soft = np.flatnonzero((problem.PENALTY > 0) & np.isfinite(problem.MOST - problem.LEAST))
    if len(soft):
        # limits of states, with a slack that costs half of Z times its square
        slack = np.arange(len(soft))
        least, most = problem.LEAST[soft], problem.MOST[soft]
        weight, none = problem.PENALTY[soft], np.zeros(len(soft))
        con, cost = ocp.constraints, ocp.cost
        con.idxbx, con.lbx, con.ubx, con.idxsbx = soft, least, most, slack
        con.idxbx_e, con.lbx_e, con.ubx_e, con.idxsbx_e = soft, least, most, slack
        cost.Zl, cost.Zu, cost.zl, cost.zu = weight, weight, none, none
        cost.Zl_e, cost.Zu_e, cost.zl_e, cost.zu_e = weight, weight, none, none

    ocp.solver_options.N_horizon = problem.STEPS
    ocp.solver_options.tf = problem.STEPS * problem.PERIOD
    ocp.solver_options.integrator_type = "DISCRETE"
    # sums as in problem.py; by default acados multiplies the costs along the way by the period
    ocp.solver_options.cost_scaling = np.ones(problem.STEPS + 1)
    ocp.solver_options.nlp_solver_type = "SQP"
    ocp.solver_options.hessian_approx = "GAUSS_NEWTON"
    ocp.solver_options.globalization = "MERIT_BACKTRACKING"
    ocp.solver_options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    ocp.solver_options.nlp_solver_max_iter = 200
    return AcadosOcpSolver(ocp, json_file=f"{NAME}.json")


def main():
    """Generates the solver, compiles it and solves the problem from the first guess."""
    try:
        from acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver
    except ImportError as error:
        raise SystemExit(
            f"acados_template cannot be imported ({error}): install acados and its Python "
            "interface, see https://docs.acados.org/python_interface"
        ) from None
    solver = make_solver(AcadosModel, AcadosOcp, AcadosOcpSolver)
    states, inputs = problem.first_guess()
    for k, x in enumerate(states):
        solver.set(k, "x", x)
    for k, u in enumerate(inputs):
        solver.set(k, "u", u)
    solver.solve_for_x0(x0_bar=problem.START)
    solver.print_statistics()
    found = np.array([solver.get(k, "x") for k in range(problem.STEPS + 1)])
    for name, value in zip(problem.STATES, found[-1], strict=True):
        print(f"{name} ends at {value:.6g}")


if __name__ == "__main__":
    main()
