"""Designed records: errors that they are expected to bring, and their search."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import tustinnet as tn
from tustinnet.evaluate import record_design
from tustinnet.evaluate.record_design import (
    DesignOptions,
    design_record,
    gather_limits,
    prior_knowledge,
)
from tustinnet.fitting.inverse_dynamics.cutoff import compared_samples, cutoff_for
from tustinnet.models.motion_limits import MotionLimits
from tustinnet.report.record_design import sentences

SCARA = Path(__file__).parents[2] / "examples" / "robots" / "scara.urdf"
NOISE, DT = 0.3, 0.01
OPTIONS = DesignOptions(
    seconds=4.0, harmonics=3, dt=DT, noise=0.05, starts=2, iterations=8, budget=None
)


def slider(**changes) -> tn.LagrangianSystem:
    """Two masses on one rail, whose sum is all that the force tells, and a damper."""
    one, two = (
        tn.Parameter(name, "kg", 1.0, -50.0, 50.0, prior=p)
        for name, p in (("cart", 0.5), ("load", 1.0))
    )
    damper = tn.Parameter("damper", "N s/m", 2.0, -50.0, 50.0, prior=2.0)
    given = {
        "name": "slider",
        "coordinates": (tn.Coordinate("x", "linear"),),
        "inputs": (tn.Input("motor", "A", limits=(-6.0, 6.0)),),
        "parameters": (one, two, damper),
        "kinetic": lambda q, v, p: (p["cart"] + p["load"]) * v[0] ** 2 / 2,
        "dissipation": lambda q, v, p: p["damper"] * v,
        "input_map": lambda q, v, u, p: 4.0 * u + 1.0,
        "limits": (MotionLimits((-1.0, 3.0), 2.0),),
    }
    return tn.LagrangianSystem(**(given | changes))


@pytest.mark.thorough
def test_expected_errors_are_those_of_least_squares():
    system = slider()
    design = design_record(system, options=OPTIONS)
    a, v, u = design.a[:-1, 0], design.v[:-1, 0], design.u[:-1, 0]
    force = 2.0 * a + 2.0 * v
    assert 4.0 * u + 1.0 == pytest.approx(force, abs=1e-9)
    assert design.force[:-1, 0] == pytest.approx(force, abs=1e-9)
    noise = design.noise[0]
    assert 0.01 < noise / np.sqrt(np.mean(force**2)) < 0.05, "5 % of a smaller motion's"
    count = compared_samples(4.0, cutoff_for(3 / 4.0, DT))
    rows = np.stack([a, a, v], axis=1)
    matrix = count * rows.T @ rows / len(rows) / noise**2
    covariance = np.linalg.inv(matrix + np.diag(1 / np.array([0.5, 1.0, 2.0]) ** 2))
    found = {b.name: b for b in design.base_parameters}
    assert found.keys() == {"cart", "damper"}
    # the sum of both masses is named after the first
    assert found["cart"].terms == pytest.approx({"load": 1.0})
    both = np.array([1.0, 1.0, 0.0])
    assert found["cart"].file == pytest.approx(np.hypot(0.5, 1.0))
    assert found["cart"].expected == pytest.approx(np.sqrt(both @ covariance @ both), rel=1e-6)
    assert found["damper"].expected == pytest.approx(np.sqrt(covariance[2, 2]), rel=1e-6)
    assert found["damper"].known is None
    again = design_record(system, options=OPTIONS)
    assert np.array_equal(again.q, design.q), "by the seed"


@pytest.mark.thorough
def test_a_design_tells_more_than_random_motions_and_keeps_the_limits_of_actuators():
    system = tn.load_system(SCARA)
    within = {"roll": (-3.0, 3.0), "roll_dot": (-6.0, 6.0), "shoulder_ddot": (-9.0, 9.0)}
    inputs = {"roll_torque": (-0.03, 0.03), "shoulder_torque": (-3.0, 4.0)}
    steps = []
    design = design_record(
        system, within=within, limits=inputs, options=OPTIONS, on_progress=steps.append
    )
    assert design.by_random > 1.3
    assert {p.start for p in steps} == {1, 2}
    assert steps[-1].gain > 0
    assert not design.stopped
    shoulder, roll = design.u[:, 0], design.u[:, 3]
    assert np.abs(roll).max() <= 0.9 * 0.03 * (1 + 1e-9)
    assert np.abs(shoulder - 0.5).max() <= 0.9 * 3.5 * (1 + 1e-9)
    assert np.abs(design.a[:, 0]).max() <= 0.9 * 9.0 * (1 + 1e-9)
    # limits are what stop it
    assert np.abs(roll).max() > 0.8 * 0.03 or np.abs(shoulder).max() > 3.0


def test_the_derivatives_of_the_search_are_those_of_its_cost():
    system = tn.load_system(SCARA)
    limits = gather_limits(
        system,
        {"roll": (-3.0, 3.0), "roll_dot": (-6.0, 6.0)},
        {"roll_torque": (-1.0, 1.0)},
        system.channels,
    )
    dynamics = record_design._Dynamics(system, prior_knowledge(system, {}), {})
    motions = record_design._Motions(dynamics, limits, OPTIONS)
    problem = record_design._Problem(
        motions, np.eye(len(dynamics.units)), np.full(4, 1e3), np.arange(48) / 12
    )
    rng = np.random.default_rng(0)
    x, along, h = rng.normal(size=(motions.count, 4)), rng.normal(size=(motions.count, 4)), 1e-4
    for penalty in (0.0, 0.5):
        _, gradient = problem.cost(x, penalty)
        after, before = (problem.cost(x + side * h * along, penalty)[0] for side in (1, -1))
        assert gradient @ along.ravel() == pytest.approx((after - before) / (2 * h), rel=1e-4)


def test_a_length_between_two_samples_ends_at_rest_at_a_sample():
    system, options = slider(), replace(OPTIONS, seconds=1.0034, iterations=1)
    design = design_record(system, options=options)
    assert design.t[-1] == pytest.approx(1.0)
    assert design.motion.frequency == pytest.approx(1.0)
    assert np.abs(design.v[[0, -1]]).max() < 1e-9
    repeated = replace(OPTIONS, frequency=0.5, iterations=1)
    design = design_record(system, options=repeated)
    assert design.q[:200] == pytest.approx(design.q[200:400], abs=1e-9)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"input_map": lambda q, v, u, p: 0.0 * u}, "do not drive every coordinate"),
        ({"input_map": lambda q, v, u, p: u + u**3}, "does not act linearly"),
        ({"inputs": ()}, "0 inputs of 1 coordinate"),
        (
            {"memory": tn.Memory(("z",), lambda q, v, z, p: -z, lambda q, v, z, p: z)},
            "internal states",
        ),
        ({"inputs": (tn.Input("motor", "A"),)}, "no limits of the input 'motor' at 'x'"),
    ],
)
def test_what_cannot_be_designed_for_is_told(changes, problem):
    if "inputs" in changes and not changes["inputs"]:
        changes = changes | {"input_map": None}
    system = slider(**changes)
    with pytest.raises(tn.InputError, match=problem):
        design_record(system, options=OPTIONS)


def test_a_record_of_a_payload_says_which():
    system = tn.load_robot(SCARA, per={"spindle": "payload"}, locked={"roll": 0.0})
    with pytest.raises(tn.InputError, match=r"no group 'payload', which 'spindle\.mass' is per"):
        prior_knowledge(system, {})
    payload = {"payload": "2kg"}
    assert "spindle.mass[2kg]" in prior_knowledge(system, payload).space.names
    design = design_record(system, groups=payload, options=replace(OPTIONS, starts=1, budget=0.1))
    assert design.stopped
    names = {b.name for b in design.base_parameters} | {
        name for b in design.base_parameters for name in b.terms
    }
    assert any(name.startswith("spindle.") and name.endswith("[2kg]") for name in names)


def test_limits_of_a_system_are_one_for_each_coordinate():
    with pytest.raises(tn.InputError, match="limits of 2 coordinates"):
        slider(limits=(MotionLimits(), MotionLimits()))


def test_a_design_is_written_as_a_reference_for_a_controller(tmp_path):
    within = {"roll": (-3.0, 3.0), "roll_dot": (-6.0, 6.0), "elbow_ddot": (-8.0, 8.0)}
    design = tn.design_record(
        tn.load_robot(SCARA),
        within=within,
        limits={"roll_torque": (-2.0, 2.0)},
        options=replace(OPTIONS, starts=1, margin=0.2),
    )
    out = tmp_path / "motion"
    tn.write_design(design, out)
    files = {"motion.csv", "motion.png", "design.json", "design.md"}
    assert {path.name for path in out.iterdir()} == files
    table = pl.read_csv(out / "motion.csv")
    joints = ["shoulder", "elbow", "lift", "roll"]
    assert table.columns == [
        "time",
        *(name + end for name in joints for end in ("", "_dot", "_ddot")),
        "shoulder_torque",
        "elbow_torque",
        "lift_force",
        "roll_torque",
    ]
    assert len(table) == round(OPTIONS.seconds / DT) + 1
    for name, low, high in (
        ("shoulder", -2.3, 2.3),
        ("lift", -0.2, 0.0),
        ("roll_dot", -6, 6),
        ("elbow_dot", -6, 6),
        ("elbow_ddot", -8, 8),
        ("roll_torque", -2, 2),
        ("elbow_torque", -40, 40),
    ):
        middle, half = (low + high) / 2, 0.8 * (high - low) / 2  # less the margin
        values = table[name].to_numpy()
        assert np.abs(values - middle).max() <= half * (1 + 1e-9), name
        assert np.ptp(values) > 0
    for name in joints:
        for row in (0, -1):
            assert (table[f"{name}_dot"][row], table[f"{name}_ddot"][row]) == (0, 0)
        v = np.gradient(table[name].to_numpy(), DT)
        assert np.abs(v - table[f"{name}_dot"].to_numpy())[1:-1].max() < 0.02 * np.abs(v).max()
    text = (out / "design.md").read_text()
    assert "22 base parameters; by random motions within the same limits" in text
    assert "collisions are not looked at" in text
    assert "it begins and ends at rest at shoulder" in text
    plain = json.loads((out / "design.json").read_text())
    shares = [b["expected"] / b["file"] for b in plain["base_parameters"]]
    assert shares == sorted(shares)
    assert (len(shares), plain["margin"]) == (22, 0.2)
    with pytest.raises(tn.InputError, match="there already"):
        tn.write_design(design, out)
    tn.write_design(design, out, overwrite=True)


def test_a_design_adds_to_the_records_of_a_fit(identified, system):
    file = identified / "model.safetensors"
    model, header = tn.load_model(file, system), tn.read_header(file)
    within, limits = {"angle": (-2.0, 2.0), "angle_dot": (-4.0, 4.0)}, {"torque": (-9.0, 9.0)}
    options = DesignOptions(seconds=4.0, frequency=0.5, harmonics=3, starts=1, dt=model.dt)
    design = tn.design_record(model, header, within=within, limits=limits, options=options)
    found = {b.name: b for b in design.base_parameters}
    for e in header["identification"]["estimates"]:
        b = found[e["name"]]
        assert b.known == pytest.approx(e["error"], rel=1e-6)
        assert b.expected < e["error"]
    assert any("it makes the errors of the records so far" in s for s in sentences(design))


def test_limits_that_are_missing_or_wrong_are_refused(system, run_folder):
    equations = tn.load_system(system)
    both = {"angle": (-2.0, 2.0), "angle_dot": (-4.0, 4.0)}
    for within, limits, groups, problem in (
        ({}, {}, {}, r"no limits of the position of 'angle'.*`within=` \{'angle': \(-1, 1\)\}"),
        ({"angle": (-2.0, 2.0)}, {}, {}, "velocity of 'angle'"),
        (both, {}, {}, "no limits of the input 'torque' at 'angle'"),
        ({"angel": (-1.0, 1.0)}, {}, {}, "no 'angel'; expected one of angle"),
        ({}, {"angle": (-1.0, 1.0)}, {}, "no input 'angle'"),
        ({"angle_dot": (1.0, 2.0)}, {}, {}, "one direction alone"),
        (both, {"torque": (-0.01, 0.01)}, {}, "it needs"),
        (both, {}, {"payload": "1kg"}, "which nothing in the system is per"),
    ):
        with pytest.raises(tn.InputError, match=problem):
            tn.design_record(equations, within=within, limits=limits, groups=groups)
    with pytest.raises(tn.InputError, match="1 input of 2 coordinates"):
        tn.design_record(tn.load_robot(SCARA.parent / "double_pendulum.urdf"))
    with pytest.raises(tn.InputError, match="a model without equations of motion"):
        tn.design_record(tn.load_model(run_folder / "model.safetensors"))


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"seconds": -1.0}, "`seconds=`: -1"),
        ({"frequency": float("nan")}, "`frequency=`: nan"),
        ({"frequency": 0.05}, "0.5 periods in 10 s"),
        ({"frequency": 0.25}, "2.5 periods in 10 s"),
        ({"dt": 0.2}, "a tenth of the sampling rate"),
        ({"dt": 0.0}, "`dt=`: 0"),
        ({"margin": 1.0}, "`margin=`: 1"),
        ({"starts": 0}, "`starts=`: 0"),
        ({"seed": -1}, "`seed=`: -1"),
        ({"noise": 0.0}, "`noise=`: 0"),
    ],
)
def test_options_out_of_range_are_refused(options, problem):
    with pytest.raises(tn.InputError, match=problem):
        DesignOptions(**options)
