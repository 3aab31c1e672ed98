"""The rotary pendulum swings up: an optimal voltage for an exported model, found by CasADi.

The model here is the packaged rotary pendulum with nominal values. Of your own:

    tustinnet export MODEL.safetensors --to casadi --out DIR

and `casadi.Function.load("DIR/step.casadi")` is all that a program needs, without tustinnet.

    pip install 'tustinnet[casadi]'
    python examples/casadi_opti.py
"""

import tempfile
from pathlib import Path

import casadi
import jax
import jax.numpy as jnp
import numpy as np

import tustinnet as tn

STEPS, PERIOD, LIMIT = 75, 0.02, 10.0  # samples, s, V
HANGING = [0.0, np.pi, 0.0, 0.0]  # theta, alpha, der_theta, der_alpha; alpha is 0 upright


def exported(folder):
    """Writes the model as a CasADi function; loads that."""
    jax.config.update("jax_enable_x64", True)
    system = tn.load_system("qube-servo2")
    values = jax.tree.map(jnp.asarray, system.nominal())
    model = tn.discretise(system.model(values), PERIOD, 2)
    tn.export_model(model, "casadi", folder)
    return casadi.Function.load(str(Path(folder) / "step.casadi"))


def swing_up(step):
    """States and voltages from hanging to standing, with the least square of the voltage."""
    opti = casadi.Opti()
    x, u = opti.variable(4, STEPS + 1), opti.variable(1, STEPS)
    opti.minimize(casadi.sumsqr(u))
    opti.subject_to(x[:, 1:] == step.map(STEPS)(x[:, :-1], u))
    opti.subject_to(x[:, 0] == HANGING)
    opti.subject_to(x[:, -1] == [0, 0, 0, 0])
    opti.subject_to(opti.bounded(-LIMIT, u, LIMIT))
    opti.subject_to(opti.bounded(-2, x[0, :], 2))  # rad, what the cable allows
    opti.set_initial(x[1, :], np.linspace(np.pi, 0, STEPS + 1))
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    found = opti.solve()
    return found.value(x), found.value(u)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        states, voltages = swing_up(exported(folder))
    print(f"alpha goes from {states[1, 0]:.3f} to {states[1, -1]:.3f} rad")
    print(f"with at most {np.abs(voltages).max():.1f} V")
