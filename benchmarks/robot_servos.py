"""Twelve servos of legs that hang in the air: armature, friction and delay of each.

    python benchmarks/robot_servos.py [SEED]                 (default: 1)

MuJoCo's own solver makes two records of 10 s at 200 Hz: chirps of all joints at once, of which
only goals and positions (14 bits) are logged. Goals act 7 ms after they are logged. Links and gains
are known, as those of a legged robot are; armatures, dampings, friction and delays are searched for
from the same first values at every joint.
"""

import jax

jax.config.update("jax_enable_x64", True)

import sys
import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import numpy as np

import tustinnet as tn
from tustinnet.models.physical_values import equations_in

mujoco = import_module("mujoco")  # no types are known

CORNERS = ((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))
JOINTS = tuple(f"{part}{k}" for k in range(4) for part in ("hip", "thigh", "calf"))
KP, KV = 40.0, 1.0
DT, SECONDS, DELAY, COUNT = 0.005, 10.0, 0.007, 2 * np.pi / 2**14
FIRST = (0.01, 0.1, 0.1)  # armature, damping, friction
JOINT = '<joint name="{}_joint" axis="{}" armature="{}" damping="{}" frictionloss="{}"/>'
LEG = """<body name="hip{k}" pos="{x} {y} 0">{0}
  <inertial pos="0 {a} 0" mass="0.7" diaginertia="5e-4 8e-4 5e-4"/>
  <body name="thigh{k}" pos="0 {b} 0">{1}
    <inertial pos="0 0 -0.04" mass="1" diaginertia="5e-3 5e-3 1e-3"/>
    <body name="calf{k}" pos="0 0 -0.2">{2}
      <inertial pos="0 0 -0.1" mass="0.2" diaginertia="2e-3 2e-3 1e-4"/></body></body></body>"""


def describe(values: Sequence[Sequence[float]]) -> str:
    """The file of the legs, with armature, damping and friction of each joint."""
    axes = ("1 0 0", "0 1 0", "0 1 0") * 4
    joints = [JOINT.format(n, axis, *v) for n, axis, v in zip(JOINTS, axes, values, strict=True)]
    legs = "".join(
        LEG.format(*joints[3 * k : 3 * k + 3], k=k, x=x, y=y, a=0.2 * y, b=0.8 * y)
        for k, (x, y) in enumerate(CORNERS)
    )
    servos = "".join(
        f'<position name="{n}" joint="{n}_joint" kp="{KP}" kv="{KV}" forcerange="-25 25"/>'
        for n in JOINTS
    )
    return (
        '<mujoco model="legs"><compiler angle="radian"/><option timestep="0.00025"/>'
        f"<worldbody>{legs}</worldbody><actuator>{servos}</actuator></mujoco>"
    )


def record(
    name: str, values: np.ndarray, system: tn.LagrangianSystem, rng: np.random.Generator
) -> tn.Experiment:
    """A record of chirps of all joints, as MuJoCo simulates them."""
    model = mujoco.MjModel.from_xml_string(describe(values.tolist()))
    data, t = mujoco.MjData(model), np.arange(round(SECONDS / DT)) * DT
    ends = rng.uniform([[0.2], [4]], [[0.5], [7]], (2, 12))
    phases, sizes = rng.uniform([[0], [0.15]], [[2 * np.pi], [0.3]], (2, 12))
    turns = np.outer(t, ends[0]) + np.outer(t**2, ends[1] - ends[0]) / (2 * SECONDS)
    goals = sizes * (np.sin(2 * np.pi * turns + phases) - np.sin(phases))
    fine, late = round(DT / model.opt.timestep), round(DELAY / model.opt.timestep)
    q = np.zeros_like(goals)
    for k in range(len(t)):
        q[k] = np.round(data.qpos / COUNT) * COUNT
        for step in range(fine):
            data.ctrl[:] = goals[max((fine * k + step - late) // fine, 0)]
            mujoco.mj_step(model, data)
    return tn.from_arrays(
        q,
        goals,
        dt=DT,
        name=name,
        coordinates=system.coordinates,
        inputs=system.inputs,
        split="train",
    )


def main(seed: int) -> None:
    """Prints a row for each joint, and the time."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform([0.004, 0.05, 0.1], [0.02, 0.3, 0.4], (12, 3))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "legs.xml"
        file.write_text(describe([FIRST] * 12))
        system = tn.load_system(file)
    data = tn.DataSet("legs", tuple(record(f"run{k}", truth, system, rng) for k in range(2)))
    searched = ("armature", "viscous", "coulomb", "offset")
    known = {
        p.name: "nominal"
        for p in system.parameters
        if not p.fixed and p.name.rpartition(".")[2] not in searched
    }
    free = [f"{name}.delay" for name in JOINTS]
    model = {"kind": "euler-lagrange", "fixed": known, "free": free}
    result = tn.identify(data, system, {"name": "legs", "model": model, "search": {"horizon": 0.5}})
    equations = equations_in(result.model)
    assert equations is not None
    found = equations.values
    print("| joint | armature | damping | friction | delay [ms] |\n|---|---|---|---|---|")
    for name, own, i in zip(JOINTS, truth, result.model.channels.inputs, strict=True):
        kinds = ("armature", "viscous", "coulomb")
        errors = [
            100 * (float(found[f"{name}_joint.{kind}"]) / x - 1)
            for kind, x in zip(kinds, own, strict=True)
        ]
        shown = " | ".join(f"{e:+.1f} %" for e in errors)
        print(f"| {name} | {shown} | {1e3 * (i.delay or 0):.2f} (7) |")
    print(f"{result.seconds:.0f} s")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:] or ["1"]))
