"""Servos from goals and positions alone: the card, the gains, what sets their scale, the file."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from test_verbs import tustinnet

import tustinnet as tn

mujoco = import_module("mujoco")  # no types are known

SERVO = """<mujoco model="servo"><compiler angle="radian"/><option timestep="0.0001"/><worldbody>
<body name="arm"><joint name="hinge" axis="{axis}" damping="{}" armature="{}" frictionloss="{}"/>
  <inertial pos="0.1 0 0" mass="0.3" diaginertia="4e-4 4e-4 4e-4"/></body></worldbody>
<actuator><position name="goal" joint="hinge" kp="{}" kv="{}" {limit}/></actuator></mujoco>"""
TRUE, GUESSED = (0.25, 0.02, 0.12, 9, 0.4), (0.1, 0.01, 0.05, 5, 0.2)
DT, COUNT = 0.01, 2 * np.pi / 4096


def write_logs(folder: Path, header: str, *, axis: str, limit: str, size: float) -> Path:
    """Logs that MuJoCo's own solver makes of a servo, and its file with first guesses."""
    (folder / "logs").mkdir()
    (folder / "servo.xml").write_text(SERVO.format(*GUESSED, axis=axis, limit=limit))
    model = mujoco.MjModel.from_xml_string(SERVO.format(*TRUE, axis=axis, limit=limit))
    rng, t = np.random.default_rng(0), np.arange(400) * DT
    for run in range(4):
        rates, phases, sizes = rng.uniform([[0.3], [0], [0.1]], [[3], [6], [size]], (3, 5))
        goal = np.sin(2 * np.pi * np.outer(t, rates) + phases) @ sizes
        data, rows = mujoco.MjData(model), []
        for k in range(len(t)):
            rows.append((t[k], np.round(data.qpos[0] / COUNT) * COUNT, goal[k]))
            data.ctrl[:] = goal[k]
            mujoco.mj_step(model, data, round(DT / model.opt.timestep))
        file = folder / "logs" / f"run{run}.csv"
        np.savetxt(file, rows, "%.6f", ",", header=header, comments="")
    return folder / "logs"


def fit(capsys, logs: Path) -> str:
    """What the command says of a fit to logs whose card it drafts."""
    system, run = logs.parent / "servo.xml", logs.parent / "run"
    code, _, err = tustinnet(capsys, "init", logs, "--system", system, "--yes")
    assert code == 0, err
    assert f"--recipe grey --system {system} --out RUN" in err
    assert "not matched" not in err
    command = ["fit", logs, "--recipe", "grey", "--system", system, "--out", run, "--no-report"]
    code, out, err = tustinnet(capsys, *command)
    assert code == 0, err
    return out + err


@pytest.mark.thorough
def test_gains_are_found_from_goals_and_positions(tmp_path, capsys):
    header = "t,present_position_rad,goal_position_rad"
    limit = 'forcerange="-4 4"'
    logs = write_logs(tmp_path, header, axis="0 1 0", limit=limit, size=0.6)
    text = fit(capsys, logs)
    assert "moved by a hand" not in text
    model = tn.load_model(tmp_path / "run" / "model.safetensors")
    lacking = tn.write_robot(model, tmp_path / "found.xml")
    assert lacking == ("hinge.offset",)
    written = mujoco.MjModel.from_xml_path(str(tmp_path / "found.xml"))
    assert written.actuator_gainprm[0, 0] == pytest.approx(9, rel=0.01)
    assert written.dof_armature[0] == pytest.approx(0.02, rel=0.02)
    assert written.dof_frictionloss[0] == pytest.approx(0.12, rel=0.05)
    assert written.actuator_forcerange[0].tolist() == [-4, 4]


def test_without_gravity_and_limits_only_ratios_are_known(tmp_path, capsys):
    logs = write_logs(tmp_path, "t,hinge_rad,hinge_goal", axis="0 0 1", limit="", size=0.3)
    text = fit(capsys, logs)
    (line,) = [line for line in text.splitlines() if "errors are those beside" in line]
    # of four that only their ratios are known of one is fixed
    gains = ("kp", "viscous", "armature", "coulomb")
    assert sum(f"hinge.{gain} +- " in line for gain in gains) == 3
    assert "records with a known load" in line
