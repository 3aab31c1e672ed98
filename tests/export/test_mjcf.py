"""The example in MuJoCo's format runs as the packaged system does."""

from importlib import import_module
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.systems.qube_servo2 import SYSTEM

EXAMPLE = Path(__file__).parents[2] / "examples" / "rotary_pendulum.xml"
DT, SAMPLES = 0.01, 200
SPRINGS = ('stiffness="2e-3"', 'stiffness="2e-3 -1e-4"')  # as the page on exports says


mujoco = import_module("mujoco")  # no types are known


def free_run(text: str, x0: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """What MuJoCo makes of voltages that are held from sample to sample, (samples + 1, 4)."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = x0[:2], x0[2:]
    states = [x0]
    for u in voltage:
        data.ctrl[:] = u
        mujoco.mj_step(model, data, round(DT / model.opt.timestep))
        states.append(np.concatenate([data.qpos, data.qvel]))
    return np.stack(states)


@pytest.mark.parametrize(
    ("x0", "level"),
    [
        ([0.0, np.pi, 0.0, 0.0], 3.0),  # hangs, driven
        ([0.0, 0.3, 0.0, 0.0], 0.0),  # falls
        ([0.8, 2.0, -3.0, 10.0], 20.0),  # beyond what the amplifier gives
    ],
)
@pytest.mark.parametrize("quadratic", [0.0, 1e-4])
def test_mujoco_runs_the_example_as_the_packaged_system_does(x0, level, quadratic):
    values, text = SYSTEM.nominal() | {"cable_quadratic": quadratic}, EXAMPLE.read_text()
    if quadratic:
        if not hasattr(mujoco.MjModel, "jnt_stiffnesspoly"):
            pytest.skip("this MuJoCo knows linear springs only")
        text = text.replace(*SPRINGS)
    known = {name: jnp.asarray(value) for name, value in values.items()}
    model = tn.discretise(SYSTEM.model(known), DT, 20)
    held = np.repeat(np.random.default_rng(0).uniform(-level, level, SAMPLES // 10), 10)
    expected = np.asarray(tn.rollout(model, np.array(x0), held[:, None]))
    found = free_run(text, np.array(x0), held)
    assert np.ptp(expected[:, 1]) > 0.5
    np.testing.assert_allclose(found[:, :2], expected[:, :2], rtol=0, atol=1e-6)
