"""Identified values in the files of robots: only numbers change, MuJoCo reads what was meant."""

import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from robot_twins import true_values

import tustinnet as tn
from tustinnet.export import robot
from tustinnet.models.added import parse_forces, with_forces

mujoco = import_module("mujoco")  # no types are known

ROBOTS = Path(__file__).parents[2] / "examples" / "robots"
NAMES = ("arm7.urdf", "scara.urdf", "gripper.urdf", "double_pendulum.urdf", "cart_pole.xml")
CHANGED = ("<origin", "<mass", "<inertia", "<dynamics", "<inertial", "</inertial", "<joint")


def moved(system, **others):
    """A model of a robot that is not just as its file says, and its values."""
    values = true_values(system, 3) | others
    return system.model({name: jnp.asarray(x) for name, x in values.items()}), values


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_what_is_written_is_read_again(name, tmp_path):
    system = tn.load_system(ROBOTS / name)
    model, values = moved(system)
    lacking = tn.write_robot(model, tmp_path / name)
    again = tn.load_system(tmp_path / name).nominal()
    kept = [key for key in values if key not in lacking]
    np.testing.assert_allclose(
        [again[k] for k in kept], [values[k] for k in kept], rtol=1e-9, atol=1e-12
    )
    formats = {"offset"} if name.endswith(".xml") else {"offset", "armature"}
    assert {key.rpartition(".")[2] for key in lacking} == formats


@pytest.mark.parametrize("name", NAMES)
def test_comments_order_and_all_else_stay(name, tmp_path):
    model, _ = moved(tn.load_system(ROBOTS / name))
    tn.write_robot(model, tmp_path / name)
    before, after = (
        [
            line
            for line in (place / name).read_text().splitlines()
            if not line.strip().startswith(CHANGED)
        ]
        for place in (ROBOTS, tmp_path)
    )
    assert before == after


def test_mujoco_simulates_what_the_model_does(tmp_path):
    system = tn.load_system(ROBOTS / "double_pendulum.urdf")
    none = {
        name: 0.0 for name in system.nominal() if name.endswith(("coulomb", "offset", "armature"))
    }
    model, _ = moved(system, **none)
    file = tmp_path / "identified.urdf"
    assert tn.write_robot(model, file) == ()
    spec = mujoco.MjSpec.from_string(file.read_text())
    spec.option.timestep = 5e-4
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    compiled = spec.compile()
    data = mujoco.MjData(compiled)
    step = tn.compiled_step(tn.discretise(model, 0.01, 20))
    x = np.array([0.6, -0.4, 0.0, 0.0])
    places = [compiled.joint(c.name).dofadr[0] for c in system.coordinates]
    data.qpos[places] = x[:2]
    for _ in range(200):
        x = step(x, np.zeros(len(system.inputs)))
        mujoco.mj_step(compiled, data, 20)
        np.testing.assert_allclose(data.qpos[places], x[:2], atol=1e-6)


def test_a_file_in_another_hand_keeps_its_ways(tmp_path):
    text = """<?xml version='1.0' encoding='utf-8'?>
<!-- Größe: 3 > 2 -->
<robot name="two"><link name='base'/><joint name="a" type="revolute"><parent link="base"/>
  <child link="arm"/><axis xyz="0 1 0"/></joint>
  <link name="arm"><inertial><inertia ixx='0.02' ixy='0' ixz='0' iyy='0.02' iyz='0'
    izz='0.002' note="a > b"/><mass   value = '1.5'/></inertial></link>
</robot>
"""
    (file := tmp_path / "two.urdf").write_text(text, encoding="utf-8")
    system = tn.load_system(file)
    model, values = moved(system)
    tn.write_robot(model, tmp_path / "new.urdf")
    written = (tmp_path / "new.urdf").read_text(encoding="utf-8")
    assert "<!-- Größe: 3 > 2 -->" in written
    assert 'note="a > b"' in written
    again = tn.load_system(tmp_path / "new.urdf").nominal()
    assert again["arm.mass"] == pytest.approx(values["arm.mass"])
    assert again["arm.center_x"] == pytest.approx(values["arm.center_x"])
    assert again["a.viscous"] == pytest.approx(values["a.viscous"])


@pytest.mark.parametrize("name", ["scara.urdf", "cart_pole.xml"])
def test_an_export_is_what_the_model_simulates(name, tmp_path):
    """Written, read again, checked step by step; what it cannot hold is said."""
    system = tn.load_system(ROBOTS / name)
    model, _ = moved(system)
    kind = "urdf" if name.endswith(".urdf") else "mjcf"
    late = [replace(i, delay=-0.01) for i in system.inputs]
    discrete = tn.discretise(model, 0.005, 2, inputs=late)
    (result,) = tn.export_model(discrete, kind, tmp_path / "out")
    assert result.checked.difference < 1e-9
    *_, note = result.notes
    assert f"{late[0].name}.delay (-0.01 s)" in note
    lacking = tn.write_robot(model, tmp_path / name)
    assert all(parameter in note for parameter in lacking)
    written = (tmp_path / "out" / f"robot{Path(name).suffix}").read_text()
    assert written == (tmp_path / name).read_text()
    if kind == "mjcf":
        with pytest.raises(tn.InputError, match=f"`to=` urdf: the robot was made from {name}"):
            tn.export_model(discrete, "urdf", tmp_path / "no")
    # the model of no robot, and one with a gear that the format has no word for
    pendulum = tn.load_system("2-link-chain")
    own = pendulum.model({key: jnp.asarray(x) for key, x in pendulum.nominal().items()})
    with pytest.raises(tn.InputError, match="not made from the file of a robot"):
        tn.export_model(tn.discretise(own, 0.005, inputs=pendulum.inputs), kind, tmp_path / "no")


@pytest.mark.parametrize("name", ["gripper.urdf", "double_pendulum.urdf"])
def test_a_urdf_is_written_in_mujocos_format_with_its_armatures(name, tmp_path):
    system = tn.load_system(ROBOTS / name)
    model, values = moved(system)
    lacking = tn.write_robot(model, tmp_path / "robot.xml")
    assert {key.rpartition(".")[2] for key in lacking} == {"offset"}
    again = tn.load_system(tmp_path / "robot.xml")
    assert [c.name for c in again.coordinates] == [c.name for c in system.coordinates]
    kept = [k for k in values if k not in lacking and not k.endswith("coulomb_speed")]
    np.testing.assert_allclose(
        [again.nominal()[k] for k in kept], [values[k] for k in kept], rtol=1e-9, atol=1e-12
    )
    assert [limits.position for limits in again.limits] == [x.position for x in system.limits]


@pytest.mark.thorough
def test_an_export_says_what_the_same_torques_do_without_an_armature(tmp_path):
    system = tn.load_system(ROBOTS / "double_pendulum.urdf")
    nominal = system.nominal()
    joint = system.coordinates[1].name
    values = {k: 0.0 if k.endswith(("viscous", "coulomb")) else x for k, x in nominal.items()}
    heavy = values | {f"{joint}.armature": 100 * nominal["lower.mass"]}
    made = system.model({k: jnp.asarray(x) for k, x in heavy.items()})
    discrete = tn.discretise(made, 0.005, 2, inputs=system.inputs)
    (urdf,), (mjcf,) = (tn.export_model(discrete, to, tmp_path / to) for to in ("urdf", "mjcf"))
    *_, note = urdf.notes
    size = 100 * nominal["lower.mass"]
    assert f"hold {joint}.armature ({size:.3g} kg m^2): left out; the same torques give" in note
    assert note.endswith("`to=` mjcf holds armatures")
    assert mjcf.checked.difference < 1e-9
    assert not any("cannot hold" in note for note in mjcf.notes)
    by_file, with_all = (
        float(x.split()[0]) for x in note.split(f"give {joint} ")[1].split(" and ")
    )
    assert abs(by_file) > 100 * abs(with_all)


def test_an_export_in_mujocos_format_is_compared_with_what_mujoco_computes(tmp_path, monkeypatch):
    """A file whose armatures MuJoCo would not have is refused, whatever the package reads in it."""
    system = tn.load_system(ROBOTS / "double_pendulum.urdf")
    model, _ = moved(system)
    discrete = tn.discretise(model, 0.005, 2, inputs=system.inputs)
    forces = robot.joint_forces

    def without_armatures(text, where, lead):
        return forces(re.sub('armature="[^"]*"', "", text), where, lead)

    monkeypatch.setattr(robot, "joint_forces", without_armatures)
    with pytest.raises(tn.InputError, match="a step differs from the model's by"):
        tn.export_model(discrete, "mjcf", tmp_path / "out")


@pytest.mark.parametrize("name", NAMES[:4])
def test_numbers_that_did_not_change_are_written_as_people_wrote_them(name, tmp_path):
    system = tn.load_system(ROBOTS / name)
    model = system.model({k: jnp.asarray(x) for k, x in system.nominal().items()})
    tn.write_robot(model, tmp_path / name)
    before, after = ((place / name).read_text() for place in (ROBOTS, tmp_path))
    assert after.count("0.35") == before.count("0.35")
    long = re.findall(r"[ \"](-?\d*\.\d{12,}[-e\d]*)[ \"]", after)
    assert [number for number in long if number not in before] == []


def test_what_options_add_is_left_out_and_said(tmp_path):
    robot = ROBOTS / "double_pendulum.urdf"
    joint = tn.load_system(robot).coordinates[0].name
    system = tn.load_robot(robot, elastic={joint: 50.0}, friction=["stribeck"])
    model, _ = moved(system)
    lacking = tn.write_robot(model, tmp_path / "new.urdf")
    assert {f"{joint}.gear_stiffness", f"{joint}.gear_damping"} <= {*lacking}
    assert f"{joint}.breakaway" not in lacking, "it is a friction of the joint"


@pytest.mark.parametrize("target", ["urdf", "mjcf"])
def test_dry_friction_that_was_added_is_friction_of_the_joint(target, tmp_path):
    plain = tn.load_system(ROBOTS / "double_pendulum.urdf")
    joint = plain.coordinates[0].name
    names = (f"curve:{joint}", f"slip:{joint}")
    brought = {k: x for f in parse_forces(plain, names) for k, x in f.brought.items()}
    assert f"{joint}.curve_1" not in brought, "the Coulomb friction of the robot"
    new = tuple(tn.Parameter(name, "N m", 0.0, 0.0, 9.0) for name in brought)
    system = with_forces(plain, names, new)
    values = dict.fromkeys(brought, 0.0) | {f"{joint}.slip_travel": 1e-3}
    values |= {f"{joint}.slip_2": 1.5, f"{joint}.curve_2": 0.5, f"{joint}.coulomb": 0.0}
    model = system.model({k: jnp.asarray(x) for k, x in (system.nominal() | values).items()})
    discrete = tn.discretise(model, 0.005, inputs=system.inputs)
    (export,) = tn.export_model(discrete, target, tmp_path)
    written = tn.load_system(next(tmp_path.glob("robot.*"))).nominal()
    assert written[f"{joint}.coulomb"] == pytest.approx(2.0, rel=0.03)
    (note,) = [note for note in export.notes if "slip" in note]
    assert "curve and slip in the file as" in note
    assert "N m of Coulomb" in note


def test_a_group_of_records_is_written_by_itself(tmp_path):
    system = tn.load_robot(ROBOTS / "scara.urdf", per={"spindle": "payload"})
    _, values = moved(system)
    groups = {
        f"{name}[{group}]": value * (2 if name == "spindle.mass" and group == "ball" else 1)
        for name, value in values.items()
        if name.startswith("spindle.")
        for group in ("none", "ball")
        if system.parameter(name).per
    }
    others = {n: x for n, x in values.items() if not system.parameter(n).per}
    model = system.model({name: jnp.asarray(x) for name, x in (others | groups).items()})
    with pytest.raises(tn.InputError, match="values by group"):
        tn.write_robot(model, tmp_path / "scara.urdf")
    lacking = tn.write_robot(model.for_groups({"payload": "ball"}, "here"), tmp_path / "scara.urdf")
    assert not [name for name in lacking if "spindle" in name]
    written = tn.load_system(tmp_path / "scara.urdf").nominal()
    assert written["spindle.mass"] == pytest.approx(2 * values["spindle.mass"])
    discrete = tn.discretise(model, 0.005, inputs=system.inputs)
    tn.export_model(discrete, "urdf", tmp_path / "none", groups={"payload": "none"})
    exported = tn.load_system(tmp_path / "none" / "robot.urdf").nominal()
    assert exported["spindle.mass"] == pytest.approx(values["spindle.mass"])
    # its file asks for the system with these groups, not for the file of the robot alone
    tn.save(discrete, tmp_path / "m.safetensors")
    line = r"SYSTEM = tn\.load_robot\('scara.urdf', per=\{'spindle': 'payload'\}\)"
    for given in (None, ROBOTS / "scara.urdf"):
        with pytest.raises(
            tn.InputError, match=rf"a Python file with {line}; add `?(system=|--sys)"
        ):
            tn.load_model(tmp_path / "m.safetensors", given)


def test_what_cannot_be_written_is_one_line(tmp_path):
    model, _ = moved(tn.load_system(ROBOTS / "scara.urdf"))
    with pytest.raises(tn.InputError, match=r"ending '.txt'; expected '.urdf' or '.xml' as of"):
        tn.write_robot(model, tmp_path / "scara.txt")
    cart, _ = moved(tn.load_system(ROBOTS / "cart_pole.xml"))
    with pytest.raises(tn.InputError, match=r"ending '.urdf'; expected '.xml' as of the robot"):
        tn.write_robot(cart, tmp_path / "cart_pole.urdf")
    tn.write_robot(model, tmp_path / "scara.urdf")
    with pytest.raises(tn.InputError, match=r"scara\.urdf"):
        tn.write_robot(model, tmp_path / "scara.urdf")
    tn.write_robot(model, tmp_path / "scara.urdf", overwrite=True)
    with pytest.raises(tn.InputError, match="read"):
        tn.write_robot(model, ROBOTS / "scara.urdf", overwrite=True)
    locked, _ = moved(tn.load_robot(ROBOTS / "gripper.urdf", locked={"left": 0.01}))
    with pytest.raises(tn.InputError, match="link 'left_finger': what it is fixed to weighs less"):
        tn.write_robot(locked, tmp_path / "gripper.xml")
    pendulum = tn.load_system("qube-servo2")
    values = {name: jnp.asarray(x) for name, x in pendulum.nominal().items()}
    with pytest.raises(tn.InputError, match="not made from a robot's file"):
        tn.write_robot(pendulum.model(values), tmp_path / "q.urdf")
