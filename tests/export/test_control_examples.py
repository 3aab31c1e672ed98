"""The examples of optimal and predictive control run and end where they should."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from every_family import nominal

import tustinnet as tn
from tustinnet.systems.qube_servo2 import SYSTEM

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.thorough
def test_the_pendulum_swings_up(capsys):
    found = runpy.run_path(str(EXAMPLES / "casadi_opti.py"), run_name="__main__")
    states, voltages = found["states"].T, found["voltages"]
    np.testing.assert_allclose(states[[0, -1]], [[0, np.pi, 0, 0], [0, 0, 0, 0]], atol=1e-6)
    assert np.abs(voltages).max() < 10.001
    model = tn.discretise(nominal(SYSTEM, 1).continuous, 0.02, 2)  # pyright: ignore[reportAttributeAccessIssue]
    swung = np.asarray(tn.rollout(model, states[0], voltages[:, None]))
    np.testing.assert_allclose(swung, states, atol=1e-3)
    assert "alpha goes from 3.142 to" in capsys.readouterr().out


# what do-mpc says of itself when it is loaded and when it calls CasADi
@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::UserWarning:do_mpc")
@pytest.mark.filterwarnings("ignore::FutureWarning:casadi")
def test_the_pendulum_is_held_by_predictive_control(capsys):
    found = runpy.run_path(str(EXAMPLES / "do_mpc_pendulum.py"), run_name="__main__")
    assert found["angles"][0] == 0.25
    assert np.abs(found["angles"][-10:]).max() < 0.02
    assert "in 60 samples" in capsys.readouterr().out
