"""Designed records: errors that they are expected to bring, and their search."""

from dataclasses import replace
from pathlib import Path

import numpy as np
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


def test_expected_errors_are_those_of_least_squares():
    system = slider()
    limits = gather_limits(system, {}, {}, system.channels)
    design = design_record(system, prior_knowledge(system, {}), limits, OPTIONS)
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
    again = design_record(system, prior_knowledge(system, {}), limits, OPTIONS)
    assert np.array_equal(again.q, design.q), "by the seed"


def test_a_design_tells_more_than_random_motions_and_keeps_the_limits_of_actuators():
    system = tn.load_system(SCARA)
    within = {"roll": (-3.0, 3.0), "roll_dot": (-6.0, 6.0), "shoulder_ddot": (-9.0, 9.0)}
    inputs = {"roll_torque": (-0.03, 0.03), "shoulder_torque": (-3.0, 4.0)}
    limits = gather_limits(system, within, inputs, system.channels)
    steps = []
    design = design_record(
        system, prior_knowledge(system, {}), limits, OPTIONS, on_progress=steps.append
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
    shapes, box = record_design._Shapes(limits, OPTIONS), record_design._Box(limits, 0.1)
    problem = record_design._Problem(
        dynamics, shapes, box, np.eye(len(dynamics.units)), np.full(4, 1e3), np.arange(48) / 12
    )
    rng = np.random.default_rng(0)
    x, along, h = rng.normal(size=(shapes.count, 4)), rng.normal(size=(shapes.count, 4)), 1e-4
    for penalty in (0.0, 0.5):
        _, gradient = problem.cost(x, penalty)
        after, before = (problem.cost(x + side * h * along, penalty)[0] for side in (1, -1))
        assert gradient @ along.ravel() == pytest.approx((after - before) / (2 * h), rel=1e-4)


def test_a_length_between_two_samples_ends_at_rest_at_a_sample():
    system, options = slider(), replace(OPTIONS, seconds=1.0034, iterations=1)
    limits = gather_limits(system, {}, {}, system.channels)
    design = design_record(system, prior_knowledge(system, {}), limits, options)
    assert design.t[-1] == pytest.approx(1.0)
    assert design.motion.frequency == pytest.approx(1.0)
    assert np.abs(design.v[[0, -1]]).max() < 1e-9
    repeated = replace(OPTIONS, frequency=0.5, iterations=1)
    design = design_record(system, prior_knowledge(system, {}), limits, repeated)
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
    limits = gather_limits(system, {}, {}, system.channels)
    with pytest.raises(tn.InputError, match=problem):
        design_record(system, prior_knowledge(system, {}), limits, OPTIONS)


def test_a_record_of_a_payload_says_which():
    system = tn.load_robot(SCARA, per={"spindle": "payload"}, locked={"roll": 0.0})
    with pytest.raises(tn.InputError, match=r"no group 'payload', which 'spindle\.mass' is per"):
        prior_knowledge(system, {})
    knowledge = prior_knowledge(system, {"payload": "2kg"})
    assert "spindle.mass[2kg]" in knowledge.space.names
    limits = gather_limits(system, {}, {}, system.channels)
    design = design_record(
        system, knowledge, limits, replace(OPTIONS, starts=1, budget=0.1), groups={"payload": "2kg"}
    )
    assert design.stopped
    names = {b.name for b in design.base_parameters} | {
        name for b in design.base_parameters for name in b.terms
    }
    assert any(name.startswith("spindle.") and name.endswith("[2kg]") for name in names)


def test_limits_of_a_system_are_one_for_each_coordinate():
    with pytest.raises(tn.InputError, match="limits of 2 coordinates"):
        slider(limits=(MotionLimits(), MotionLimits()))
