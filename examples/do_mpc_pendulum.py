"""The rotary pendulum is caught and held upright by model predictive control (do-mpc).

The exported CasADi function is do-mpc's discrete model. Here the same function also plays the
pendulum; in a laboratory the state comes from the encoders.

    pip install 'tustinnet[casadi]' do-mpc
    python examples/do_mpc_pendulum.py
"""

import do_mpc
import jax
import jax.numpy as jnp
import numpy as np

import tustinnet as tn

PERIOD, LIMIT = 0.02, 10.0  # s, V
LEANING = np.array([0.0, 0.25, 0.0, 0.0])  # theta, alpha, der_theta, der_alpha; alpha is 0 upright


def pendulum():
    """The packaged rotary pendulum with nominal values, as a CasADi function."""
    jax.config.update("jax_enable_x64", True)
    system = tn.load_system("qube-servo2")
    return tn.casadi_step(
        tn.discretise(system.model(jax.tree.map(jnp.asarray, system.nominal())), PERIOD, 2)
    )


def controller(step):
    """A controller that looks 20 samples ahead."""
    model = do_mpc.model.Model("discrete")
    x = model.set_variable("_x", "x", (4, 1))
    u = model.set_variable("_u", "voltage")
    model.set_rhs("x", step(x, u))
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.set_param(n_horizon=20, t_step=PERIOD, store_full_solution=False)
    mpc.settings.supress_ipopt_output()
    cost = x[0] ** 2 + 10 * x[1] ** 2 + 0.01 * (x[2] ** 2 + x[3] ** 2)
    mpc.set_objective(mterm=10 * cost, lterm=cost)
    mpc.set_rterm(voltage=1e-3)
    mpc.bounds["lower", "_u", "voltage"], mpc.bounds["upper", "_u", "voltage"] = -LIMIT, LIMIT
    mpc.setup()
    return mpc


def held(step, mpc, steps=60):
    """The angles of the pendulum under the controller [rad]."""
    state = mpc.x0 = LEANING
    mpc.set_initial_guess()
    angles = [state[1]]
    for _ in range(steps):
        state = step(state, mpc.make_step(state)).full()
        angles.append(float(state[1, 0]))
    return angles


if __name__ == "__main__":
    step = pendulum()
    angles = held(step, controller(step))
    print(f"alpha goes from {angles[0]:.3f} to {angles[-1]:.3f} rad in {len(angles) - 1} samples")
