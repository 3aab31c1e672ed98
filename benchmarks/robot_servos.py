"""Twelve servos of legs that hang in the air: armature, friction and delay of each.

    python benchmarks/robot_servos.py [SEED] [--sysid [STEP]]      (default: seed 1)

MuJoCo's own solver makes two records of 10 s at 200 Hz: chirps of all joints at once, of which
only goals and positions (14 bits) are logged. Goals act 7 ms after they are logged. Links and gains
are known, as those of a legged robot are; armatures, dampings, friction and delays are searched for
from the same first values at every joint.

`--sysid` has `mujoco.sysid` search for the same values in the same records, within the same ranges,
by steps of STEP seconds (default: 0.001), and prints both side by side. It simulates whole records
from rest, as they begin, and delays each position: as long as each goal where all delays are alike,
as they are here. Its iterations end by its own defaults. Needs `mujoco[sysid]`.
"""

import jax

jax.config.update("jax_enable_x64", True)

import argparse
import contextlib
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

import tustinnet as tn
from tustinnet.models.physical_values import equations_in

mujoco = import_module("mujoco")  # no types are known

CORNERS = ((0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1))
JOINTS = tuple(f"{part}{k}" for k in range(4) for part in ("hip", "thigh", "calf"))
KP, KV = 40.0, 1.0
DT, SECONDS, DELAY, COUNT = 0.005, 10.0, 0.007, 2 * np.pi / 2**14
KINDS = ("armature", "viscous", "coulomb")
FIRST = (0.01, 0.1, 0.1)  # of these kinds
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


def fit_by_mujoco(
    sysid: Any, data: tn.DataSet, ranges: Mapping[str, tuple[float, float]], step: float
) -> dict[str, float]:
    """Values by name of a parameter, as `mujoco.sysid` finds them in these ranges."""
    spec = mujoco.MjSpec.from_string(describe([FIRST] * 12))
    spec.option.timestep = step
    parameters, transform = sysid.ParameterDict(), sysid.SignalTransform()
    for name in JOINTS:
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=f"{name}_joint",
        )
        for kind, first in zip(KINDS, FIRST, strict=True):

            def write(s: Any, own: Any, name: str = name, kind: str = kind) -> None:
                joint, value = s.joint(f"{name}_joint"), own.value[0]
                if kind == "viscous":
                    joint.damping[0] = value
                else:
                    setattr(joint, "frictionloss" if kind == "coulomb" else kind, value)

            key = f"{name}_joint.{kind}"
            parameters.add(sysid.Parameter(key, first, *ranges[key], modifier=write))
        delay = sysid.Parameter(f"{name}.delay", 0.0, *ranges[f"{name}.delay"])
        parameters.add(delay)
        transform.delay(name, delay)
    parameters.move_off_bounds()  # its own advice
    model, names = spec.compile(), [e.name for e in data]
    rest = sysid.create_initial_state(model, np.zeros(12), np.zeros(12))
    # it takes inputs between its steps from a line: goals that are held are given at every step
    fine = np.arange(round(SECONDS / step)) * step
    held = np.arange(len(fine)) // round(DT / step)
    goals = [sysid.TimeSeries(fine, e.u[held]) for e in data]
    positions = [sysid.TimeSeries.from_names(e.t, e.q, model, list(JOINTS)) for e in data]
    sequences = sysid.ModelSequences("legs", spec, names, [rest] * len(names), goals, positions)
    residuals = sysid.build_residual_fn(
        models_sequences=[sequences], modify_residual=transform.apply
    )
    with contextlib.redirect_stdout(sys.stderr):  # it prints its iterations
        optimum, _ = sysid.optimize(parameters, residuals, verbose=False)
    return {name: float(p.value[0]) for name, p in optimum.items()}


def errors(found: Mapping[str, float], truth: np.ndarray) -> np.ndarray:
    """Errors of armature, damping, friction [%] and delay [ms] of each joint, (12, 4)."""
    values = np.array([[found[f"{name}_joint.{kind}"] for kind in KINDS] for name in JOINTS])
    late = np.array([found[f"{name}.delay"] for name in JOINTS]) - DELAY
    return np.column_stack([100 * (values / truth - 1), 1000 * late])


def main(seed: int, step: float | None) -> None:
    """Prints errors of each joint, the largest of each kind, and seconds, of each way to fit.

    Args:
        seed: of motions and true values.
        step: of `mujoco.sysid` [s]; None leaves it out.
    """
    sysid = None if step is None else import_module("mujoco.sysid")
    if step is not None and not hasattr(sysid, "optimize"):  # it hides that packages are missing
        raise SystemExit("no mujoco.sysid: pip install 'mujoco[sysid]>=3.5'")
    rng = np.random.default_rng(seed)
    truth = rng.uniform([0.004, 0.05, 0.1], [0.02, 0.3, 0.4], (12, 3))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "legs.xml"
        file.write_text(describe([FIRST] * 12))
        system = tn.load_system(file)
    data = tn.DataSet("legs", tuple(record(f"run{k}", truth, system, rng) for k in range(2)))
    known = {
        p.name: "nominal"
        for p in system.parameters
        if not p.fixed and p.name.rpartition(".")[2] not in (*KINDS, "offset")
    }
    free = [f"{name}.delay" for name in JOINTS]
    model = {"kind": "euler-lagrange", "fixed": known, "free": free}
    recipe = {"name": "legs", "model": model, "search": {"horizon": 0.5}}
    ranges = {p.name: (p.lower, p.upper) for p in system.parameters}
    ranges |= dict.fromkeys(free, (-DT, 10 * DT))  # as this package has them

    def fit_here() -> Mapping[str, float]:
        model = tn.identify(data, system, recipe).model
        equations = equations_in(model)
        assert equations is not None
        return {n: float(x) for n, x in equations.values.items()} | {
            f"{i.name}.delay": i.delay or 0.0 for i in model.channels.inputs
        }

    ways = {"tustinnet": fit_here}
    if step is not None:
        ways["mujoco.sysid"] = lambda: fit_by_mujoco(sysid, data, ranges, step)
    print("| by | joint | armature [%] | damping [%] | friction [%] | delay [ms] |")
    print("|---|---|---|---|---|---|")
    for way, fit in ways.items():
        begin, own_begin = time.perf_counter(), time.process_time()
        found = errors(fit(), truth)
        seconds, own = time.perf_counter() - begin, time.process_time() - own_begin
        for name, row in [*zip(JOINTS, found, strict=True), ("largest", np.abs(found).max(0))]:
            print(f"| {way} | {name} | {' | '.join(f'{x:+.2f}' for x in row)} |")
        print(f"| {way} | {seconds:.0f} s, {own:.0f} s of CPU |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--sysid", type=float, nargs="?", const=0.001, metavar="STEP")
    arguments = parser.parse_args()
    main(arguments.seed, arguments.sysid)
