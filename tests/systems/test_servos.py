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
from tustinnet.simulate.input_signal import input_signals
from tustinnet.simulate.simulation import simulate_runs

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
    '<intvelocity name="a" joint="hip" kp="20" kv="0.5" ctrlrange="-1 1" actrange="-0.5 0.6"/>'
    '<intvelocity name="b" joint="knee" kp="15" gear="-2" forcerange="-3 3" actrange="-0.9 1"/>'
    '<general joint="toe" dyntype="integrator" gainprm="50" biastype="affine" biasprm="0 -50 -2"/>',
)


def load(folder: Path, actuators: str):
    """The system of a leg, and MuJoCo's own model of it."""
    (file := folder / "leg.xml").write_text(LEG.format(actuators=actuators))
    return tn.load_system(file), mujoco.MjModel.from_xml_path(str(file))


def accelerations(model, system, points: np.ndarray) -> np.ndarray:
    """Accelerations of a model by points [q, v, z, u]."""
    n = 2 * len(system.coordinates) + len(system.internal)
    formula = Formula(lambda x: model.acceleration(x[:n], x[n:]), points.shape[1])
    return np.asarray(evaluate(formula, points))


def accelerations_in_mujoco(there, points: np.ndarray) -> np.ndarray:
    data, n, found = mujoco.MjData(there), there.nv, []
    for x in points:
        data.qpos[:], data.qvel[:], data.ctrl[:] = x[:n], x[n : 2 * n], x[2 * n + there.na :]
        data.act[:] = x[2 * n : 2 * n + there.na]
        if there.actuator_actlimited.any():  # MuJoCo limits what it integrates, not what is set
            data.act[:2] = np.clip(data.act[:2], *there.actuator_actrange[:2].T)
        mujoco.mj_forward(there, data)
        found.append(data.qacc.copy())
    return np.stack(found)


@pytest.mark.thorough
@pytest.mark.parametrize("actuators", SERVOS)
def test_servos_accelerate_as_in_mujoco_and_are_written(actuators, tmp_path):
    """Within and beyond all limits, with the values of the file and with others."""
    system, there = load(tmp_path, actuators)
    rng = np.random.default_rng(4)
    points = rng.normal(size=(40, 2 * there.nv + there.na + there.nu)) * 1.5
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
        '<general name="a" joint="hip" dyntype="integrator" gainprm="5"/>': "no goal of a position",
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


def play(there, period: float, q0: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Positions of servos that integrate, as MuJoCo simulates them from rest at their goals."""
    data, q = mujoco.MjData(there), np.zeros((len(speeds), there.nv))
    data.qpos[:], data.act[:] = q0, there.actuator_gear[:, 0] * q0
    for k, u in enumerate(speeds):
        q[k], data.ctrl[:] = data.qpos, u
        for _ in range(round(period / there.opt.timestep)):
            mujoco.mj_step(there, data)
    return q


@pytest.mark.thorough
def test_goals_are_integrals_as_in_mujoco(tmp_path):
    """Goals reach both ends of their ranges; MuJoCo's error is that of its steps of 0.02 ms."""
    system, there = load(tmp_path, SERVOS[2])
    assert system.internal == ("hip.goal", "knee.goal", "toe.goal")
    assert [i.unit for i in system.inputs] == ["rad/s", "1", "m/s"]
    there.opt.timestep = 2e-5
    t = 0.005 * np.arange(200)[:, None]
    speeds = np.sign(np.sin(2 * np.pi * np.array([0.7, 1.1, 2.0]) * t + 0.3)) * [1.5, 2.0, 0.1]
    q = play(there, 0.005, np.array([0.1, -0.2, 0.02]), speeds)
    channels = {"coordinates": system.coordinates, "inputs": system.inputs}
    record = tn.from_arrays(q, speeds, dt=0.005, name="legs", **channels)
    values = {name: jnp.asarray(x) for name, x in system.nominal().items()}
    model = tn.discretise(system.model(values), 0.005, substeps=8)
    start = model.initial_state(jnp.asarray([*q[0], 0.0, 0.0, 0.0]))
    (run,) = simulate_runs(model, np.asarray(start)[None], input_signals(model, [record]))
    np.testing.assert_allclose(run[:, :3], q, atol=1e-5)


ARM = """<mujoco model="arm"><compiler angle="radian"/><option timestep="0.0002"/><worldbody>
<body name="arm"><joint name="hinge" axis="0 1 0" armature="0.02"/>
  <inertial pos="0 0 -0.15" mass="1" diaginertia="0.01 0.01 0.001"/></body></worldbody>
<actuator><intvelocity name="servo" joint="hinge" kp="{kp}" kv="{kv}" actrange="-1 1"/></actuator>
</mujoco>"""


def test_a_fit_finds_the_gains_of_a_servo_that_integrates(tmp_path):
    """From values off by a factor of 2, of records whose first goals nobody knows."""
    there, rng = mujoco.MjModel.from_xml_string(ARM.format(kp=12, kv=0.4)), np.random.default_rng(1)
    (file := tmp_path / "arm.xml").write_text(ARM.format(kp=6, kv=0.8))
    system, records = tn.load_system(file), []
    for k in range(2):
        speeds = np.repeat(rng.uniform(-3, 3, (20, 1)), 20, axis=0)
        # at rest first, where gravity pulls the arm away from its goal
        waiting = np.zeros((200, 1))
        q = play(there, 0.01, rng.uniform(-0.5, 0.5, 1), np.concatenate([waiting, speeds]))
        channels = {"coordinates": system.coordinates, "inputs": system.inputs}
        q = np.round(q[200:] / 1e-4) * 1e-4
        records.append(tn.from_arrays(q, speeds, dt=0.01, name=f"r{k}", split="train", **channels))
    known = ("arm.", "hinge.viscous", "hinge.offset")
    fixed = {name: "nominal" for name in system.nominal() if name.startswith(known)}
    model = {"kind": "euler-lagrange", "fixed": fixed}
    result = tn.identify(tn.DataSet("arm", tuple(records)), system, {"name": "arm", "model": model})
    found = {e.name: e for e in result.estimates}
    low, high = found["hinge.kp"].interval or (0.0, 0.0)
    assert low < 12.0 < high < 12.01
    # MuJoCo's steps count as inertia
    assert found["hinge.kv"].value == pytest.approx(0.4, rel=1e-3)
    assert found["hinge.armature"].value == pytest.approx(0.02, rel=5e-3)
