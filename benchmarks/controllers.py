"""How quick and how good controllers are.

python benchmarks/controllers.py plan
python benchmarks/controllers.py mpc
python benchmarks/controllers.py estimator

`plan`: a swing-up of 450 steps of 10 ms, planned in a process of its own for every model: the first
time, machine code included, the median of five more times, and from a plan for another start. Of
networks, which are not trained here, only the time of an iteration. Times are of the processor, as
other programs take their turns. `mpc`: 200 periods of 40 steps
ahead, from a disturbed start to the balance of the same model. IPOPT, by CasADi on the exported
step, solves the problem of every period to its end, and starts from its last solution.
`estimator`: an update of the extended Kalman filter.
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable
from functools import partial

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.control import Mpc, ilqr, lqr
from tustinnet.control.cost import Cost
from tustinnet.control.dynamics import controlled, input_limits
from tustinnet.control.estimator import ExtendedKalmanFilter, usual_noise
from tustinnet.control.ilqr import Solver, make_cost
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import Scaling
from tustinnet.report.tables import Table
from tustinnet.systems.qube_servo2 import SYSTEM, WITH_MEMORY

DT = 0.01
LIMITS = {"voltage": (-10.0, 10.0)}
STEPS, AHEAD, PERIODS = 450, 40, 200
START = np.array([0.3, 0.25, 0.0, 0.0])  # of predictive control


def grey_box(system: tn.LagrangianSystem, substeps: int) -> tn.Model:
    """Equations of motion with nominal parameters."""
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    return tn.discretise(system.model(values), DT, substeps)


def network(hidden: tuple[int, ...]) -> tn.TustinNet:
    """A network with random weights."""
    one = jnp.ones(2, jnp.float32)
    units = Scaling(jnp.zeros(0), jnp.zeros(0), 5 * one, one[:1], 30 * one, jnp.zeros(0))
    channels = grey_box(SYSTEM, 1).channels
    return random_tustin_net(channels, units, jax.random.key(0), hidden=hidden)


MODELS: dict[str, Callable[[], tn.Model]] = {
    "grey box": lambda: grey_box(SYSTEM, 1),
    "grey box with memory": lambda: grey_box(WITH_MEMORY, 4),
    "hybrid, network of 40, 40": lambda: tn.HybridModel(
        grey_box(WITH_MEMORY, 2), network((40, 40))
    ),
    "network of 100, 100": lambda: network((100, 100)),
}


def seconds(function: Callable[[], object], times: int = 5) -> float:
    """The median processor time of a function [s]."""
    measured = []
    for _ in range(times):
        begin = time.process_time()
        function()
        measured.append(time.process_time() - begin)
    return float(np.median(measured))


def plan_row(name: str) -> list[str]:
    """The times of one model."""
    model = MODELS[name]()
    hanging, upright = np.zeros(model.state_size), np.zeros(model.state_size)
    hanging[1] = np.pi
    system, limits = controlled(model), input_limits(model, LIMITS)
    if "network" not in name:
        begin = time.process_time()
        plan = ilqr(model, hanging, upright, STEPS, limits=LIMITS)
        cold = time.process_time() - begin
        again = seconds(lambda: ilqr(model, hanging, upright, STEPS, limits=LIMITS))
        other = hanging + 0.05 * (np.arange(len(hanging)) < 2)
        warm = seconds(lambda: ilqr(model, other, upright, STEPS, limits=LIMITS, guesses=[plan]))
        verdict = "reached" if plan.reached and plan.converged else "not reached"
        times = [f"{cold:.2f}", f"{again:.2f}", f"{warm:.2f}", verdict]
    else:
        times = ["", "", "", ""]
    n_x = system.n_x
    cost = Cost(
        x=upright,
        u=np.zeros(1),
        states=np.ones(n_x),
        inputs=np.ones(1),
        end=np.eye(n_x),
        lower=np.full(n_x, -np.inf),
        upper=np.full(n_x, np.inf),
        penalty=np.zeros(n_x),
    )
    solver = Solver(system, limits, cost)
    motion = solver.begin(hanging, np.zeros((STEPS, 1)))
    policy = solver.policy(motion, 1.0)
    each = seconds(lambda: solver.improve(motion, solver.policy(motion, 1.0)), 30)
    assert np.isfinite(policy.expected)
    return [name, *times, f"{1e3 * each:.2f}"]


def measure_plans() -> None:
    """Prints the table of plans."""
    rows = []
    for name in MODELS:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            rows.append(pool.apply(plan_row, [name]))
    head = ("model", "first [s]", "again [s]", "from a plan [s]", "goal", "iteration [ms]")
    print(Table(head, rows, f"A swing-up of {STEPS} steps").markdown())


def make_ipopt(model: tn.Model, cost: Cost) -> Callable[[np.ndarray], tuple[float, float]]:
    """A function from a state to the least cost and the time that IPOPT takes for it [s]."""
    import casadi

    step = tn.casadi_step(model)
    n_x = len(cost.x)
    opti = casadi.Opti()
    x, u, start = opti.variable(n_x, AHEAD + 1), opti.variable(1, AHEAD), opti.parameter(n_x)
    error = x - casadi.repmat(cost.x, 1, AHEAD + 1)
    total = casadi.dot(casadi.diag(cost.states) @ error[:, :-1], error[:, :-1])
    total += casadi.sumsqr(u) * cost.inputs[0] + error[:, -1].T @ cost.end @ error[:, -1]
    opti.minimize(total / 2)
    opti.subject_to(x[:, 1:] == step.map(AHEAD)(x[:, :-1], u))
    low, high = LIMITS["voltage"]
    opti.subject_to(opti.bounded(low, u, high))
    opti.subject_to(x[:, 0] == start)
    quiet = {"print_level": 0, "sb": "yes", "warm_start_init_point": "yes"}
    opti.solver("ipopt", {"print_time": False, "expand": True}, quiet)

    def solve(state: np.ndarray) -> tuple[float, float]:
        opti.set_value(start, state)
        begin = time.process_time()
        solution = opti.solve()
        taken = time.process_time() - begin
        opti.set_initial(solution.value_variables())
        opti.set_initial(opti.lam_g, solution.value(opti.lam_g))
        return float(solution.value(total)) / 2, taken

    return solve


def measure_mpc() -> None:
    """Prints the table of predictive control."""
    model = grey_box(SYSTEM, 1)
    step, goal = tn.compiled_step(model), np.zeros(4)
    limits = input_limits(model, LIMITS)
    cost, _ = make_cost(
        controlled(model), limits, goal, np.zeros(1), deviations=None, range=None, within=None
    )
    feedback = lqr(model, goal, np.zeros(1), limits=LIMITS)
    rows = []
    for iterations in (1, 2, 5):
        mpc = Mpc(model, feedback, steps=AHEAD, iterations=iterations)
        x, times, states, costs = START, [], [], []
        for k in range(PERIODS):
            begin = time.process_time()
            u = mpc.inputs(k, x)
            times.append(time.process_time() - begin)
            assert mpc.motion is not None
            states.append(x)
            costs.append(mpc.motion.cost)
            x = step(x, u)
        solve = make_ipopt(model, cost)
        least, ipopt = np.array([solve(state) for state in states[:50]]).T
        excess = np.array(costs[:50]) / least - 1
        ms = 1e3 * np.array(times)
        rows.append(
            [
                f"{iterations}",
                f"{np.median(ms):.2f}",
                f"{np.quantile(ms, 0.99):.2f}",
                f"{1e3 * np.median(ipopt):.1f}",
                f"{1e3 * np.median(ipopt) / np.median(ms):.0f}",
                f"{excess[0]:.1e}",
                f"{excess[1:].max():.1e}",
            ]
        )
    head = (
        "iterations",
        "period [ms]",
        "99 % [ms]",
        "IPOPT [ms]",
        "ratio",
        "first excess",
        "later",
    )
    print(Table(head, rows, f"{AHEAD} steps ahead, the grey box").markdown())


def measure_estimators() -> None:
    """Prints the table of estimators."""
    rows = []
    for name, make in MODELS.items():
        model = make()
        estimator = ExtendedKalmanFilter(model, usual_noise(model))
        y, u = np.zeros(2), np.zeros(1)
        estimator.reset(y)
        each = seconds(partial(estimator.update, y, u), 300)
        rows.append([name, f"{1e6 * each:.0f}"])
    print(Table(("model", "update [us]"), rows, "Extended Kalman filters").markdown())


PARTS = {"plan": measure_plans, "mpc": measure_mpc, "estimator": measure_estimators}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="How quick and how good controllers are.")
    parser.add_argument("part", choices=[*PARTS])
    PARTS[parser.parse_args().part]()
