"""Servos of files in MuJoCo's format: forces as MuJoCo has them, gains that are parameters."""

from importlib import import_module
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError

mujoco = import_module("mujoco")  # no types are known

LEG = """<mujoco model="leg"><compiler angle="radian"/><worldbody>
<body name="thigh"><joint name="hip" axis="0 1 0" damping="0.1" armature="0.01"/>
  <inertial pos="0 0 -0.1" mass="1" diaginertia="0.004 0.004 0.001"/>
  <body name="shank" pos="0 0 -0.2"><joint name="knee" axis="0 1 0" actuatorfrcrange="-2 3"/>
    <inertial pos="0 0 -0.1" mass="0.6" diaginertia="0.002 0.002 0.001"/>
    <body name="foot"><joint name="toe" type="slide" axis="0 0 1" damping="2"/>
      <inertial pos="0 0.02 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/></body></body></body>
</worldbody><actuator>{actuators}</actuator></mujoco>"""
SERVOS = (
    '<position name="a" joint="hip" kp="20" kv="0.5" forcerange="-4 3" ctrlrange="-1 0.5"/>'
    '<position joint="knee" kp="30" gear="-2"/>'
    '<velocity name="c" joint="knee" kv="3" forcerange="-5 5"/>'
    '<general name="d" joint="toe" gainprm="50" biastype="affine" biasprm="1 -40 -2"/>',
    '<motor name="a" joint="hip" gear="3" ctrlrange="-1 0.5" forcerange="-0.4 2"/>'
    '<velocity name="b" joint="knee" kv="0.8" gear="4"/>'
    '<position name="c" joint="toe" kp="200" dampratio="0.7" forcerange="-4 3"/>',
)


def load(folder: Path, actuators: str):
    """The system of a leg, and MuJoCo's own model of it."""
    (file := folder / "leg.xml").write_text(LEG.format(actuators=actuators))
    return tn.load_system(file), mujoco.MjModel.from_xml_path(str(file))


def accelerations(model, system, points: np.ndarray) -> np.ndarray:
    """Accelerations of a model by points [q, v, u]."""
    n = 2 * len(system.coordinates)
    formula = Formula(lambda x: model.acceleration(x[:n], x[n:]), points.shape[1])
    return np.asarray(evaluate(formula, points))


def accelerations_in_mujoco(there, points: np.ndarray) -> np.ndarray:
    data, n, found = mujoco.MjData(there), there.nv, []
    for x in points:
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[:n], x[n : 2 * n], x[2 * n :]
        mujoco.mj_forward(there, data)
        found.append(data.qacc.copy())
    return np.stack(found)


@pytest.mark.parametrize("actuators", SERVOS)
def test_servos_accelerate_as_in_mujoco_and_are_written(actuators, tmp_path):
    """Within and beyond all limits, with the values of the file and with others."""
    system, there = load(tmp_path, actuators)
    rng = np.random.default_rng(4)
    points = rng.normal(size=(40, 2 * there.nv + there.nu)) * 1.5
    values = system.nominal()
    model = system.model({name: jnp.asarray(x) for name, x in values.items()})
    expected = accelerations_in_mujoco(there, points)
    np.testing.assert_allclose(accelerations(model, system, points), expected, rtol=1e-9)
    gains = [name for name in values if name.endswith((".kp", ".kv", ".gain"))]
    values |= {name: values[name] * rng.uniform(0.5, 2) for name in gains}
    model = system.model({name: jnp.asarray(x) for name, x in values.items()})
    assert tn.write_robot(model, tmp_path / "written.xml") == ()
    there = mujoco.MjModel.from_xml_path(str(tmp_path / "written.xml"))
    expected = accelerations_in_mujoco(there, points)
    np.testing.assert_allclose(accelerations(model, system, points), expected, rtol=1e-9)


def test_gains_have_plain_names_and_inputs_the_unit_of_the_goal(tmp_path):
    system, _ = load(tmp_path, SERVOS[0])
    gains = {p.name: p.nominal for p in system.parameters if p.name.endswith(("kp", "kv", "gain"))}
    assert gains == {
        "hip.kp": 20.0,
        "hip.kv": 0.5,
        "knee.kp": 30.0,
        "c.kv": 3.0,
        "toe.kp": 40.0,
        "toe.kv": 2.0,
        "toe.gain": 50.0,
    }
    assert [i.unit for i in system.inputs] == ["rad", "1", "rad/s", "1"]
    assert not system.parameter("hip.kp").fixed
    system, _ = load(tmp_path, SERVOS[1])
    names = system.nominal()
    assert "hip.gain" not in names, "the gain of a motor sets the scale of all masses"
    assert [i.unit for i in system.inputs] == ["1", "1", "m"]


def test_servos_without_equations_are_refused(tmp_path):
    cases = {
        '<intvelocity name="a" joint="hip" kp="5" actrange="-2 2"/>': "integrates its input",
        '<position name="a" joint="hip" kp="5" timeconst="0.1"/>': "states of its own",
        '<motor name="a" joint="hip" armature="0.1"/>': "armatures of actuators",
    }
    for actuator, message in cases.items():
        with pytest.raises(InputError, match=message):
            load(tmp_path, actuator)


def test_torques_and_currents_are_no_goals(tmp_path):
    system, _ = load(tmp_path, SERVOS[1])
    torques = [tn.Input(i.name, "N m" if i.unit == "1" else "N") for i in system.inputs]
    with pytest.raises(InputError, match=r"input 'c' in N; expected m; where forces.* <motor>"):
        system.for_channels(system.coordinates, torques, "the card")
    with pytest.raises(InputError, match="the joint 'toe' has no motor"):
        tn.load_robot(tmp_path / "leg.xml", motor_constants={"toe": 2.0})
