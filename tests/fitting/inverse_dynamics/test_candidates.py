"""Forces that a system lacks are found by what left-out records ask for, and no others."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from robot_twins import record_in_loop, true_values

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.fitting.inverse_dynamics.along import filter_record, find_obstacle
from tustinnet.fitting.inverse_dynamics.cutoff import choose_cutoff
from tustinnet.fitting.inverse_dynamics.linear_forces import LinearForces
from tustinnet.fitting.inverse_dynamics.solver import least_squares
from tustinnet.fitting.inverse_dynamics.sums import Columns, sum_up
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.models.added import parse_forces

SCARA = Path(__file__).parents[3] / "examples" / "robots" / "scara.urdf"


@pytest.fixture(scope="module")
def system() -> tn.LagrangianSystem:
    return tn.load_system(SCARA)


def twin(system: tn.LagrangianSystem, *names: str, **values: float) -> tn.DataSet:
    """Records of the arm with further forces, of some values by the ends of their names."""
    plain = record_in_loop(system, system.nominal(), 2, 2.0)
    richer = with_added(system, names, list(plain), {})
    truth = true_values(system, 4) | {
        name: richer.nominal()[name] for name in richer.nominal() if name not in system.nominal()
    }
    truth |= {name: values.get(name.rpartition(".")[2], x) for name, x in truth.items()}
    return record_in_loop(richer, truth, 3, 4.0)


@pytest.fixture(scope="module")
def slipping(system) -> tn.DataSet:
    """Records with a dry friction that has a memory."""
    return twin(system, "slip:shoulder", slip_2=1.0, slip_4=1.5)


@pytest.fixture(scope="module")
def without(system, slipping):
    """What is found in them by the forces of the file alone."""
    recipe = tn.read_recipe("inverse-dynamics", ["search.candidates=[]"])
    return tn.identify(slipping, system, recipe)


def test_dry_friction_with_a_memory_is_found_and_simulated(system, slipping, without):
    data = slipping
    result = tn.identify(data, system, "inverse-dynamics")
    assert "slip:shoulder" in result.system.added
    (finding,) = [f for f in result.findings if f.code == "holds at rest"]
    (dry,) = [f.values for f in finding.values["joints"] if f.values["joint"] == "shoulder"]
    truth = 2.5 + true_values(system, 4)["shoulder.coulomb"]
    assert dry["dry"] == pytest.approx(truth, rel=0.1)
    assert 0 < dry["error"] < 0.1 * truth
    with_it, alone = (
        next(e.share for e in r.force_errors if e.split == "validation") for r in (result, without)
    )
    assert with_it < 0.8 * alone
    # it stands in the model, whose free runs are better for it
    records = list(data.split("validation"))
    better, worse = (
        tn.mean_rmse(tn.evaluate(r.model, records, "model-20", horizon=0.5))
        for r in (result, without)
    )
    assert better < worse


@pytest.mark.thorough
def test_a_motor_that_turns_with_two_joints_is_found(system):
    channel = "elbow+roll"
    data = twin(system, f"armature:{channel}", f"viscous:{channel}", armature=0.05, viscous=0.3)
    result = tn.identify(data, system, "inverse-dynamics")
    assert f"armature:{channel}" in result.system.added
    assert result.values[f"{channel}.armature"] == pytest.approx(0.05, rel=0.1)
    (sentence,) = [s.text for s in result.findings if s.code == "forces tried"]
    assert f"armature:{channel} kept" in sentence


def test_the_forces_of_the_model_are_those_that_were_fitted(system):
    """Columns beside a system, and the same forces within one, which remember."""
    data = twin(system, "slip", slip_1=0.2, slip_5=0.3)
    parts = tuple(filter_record(e.without_controller(), 8.0) for e in data[:2])
    richer = with_added(system, ["slip", "armature:shoulder-elbow"], list(data), {})
    space = make_search_space(system, {}, {})
    beside = parse_forces(system, richer.added)
    brought = [richer.parameter(name) for name in richer.added_parameters]
    forces = LinearForces(system, space, parts).with_forces(beside, brought)
    assert find_obstacle(richer, [e.without_controller() for e in data]) is None
    within = LinearForces(richer, forces.space, parts)
    values = forces.space.nominal | {p.name: 0.3 * p.upper for p in brought if not p.fixed}
    vector = forces.space.to_vector(values)
    for one, other in zip(forces.missing(vector), within.missing(vector), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())
    for one, other in zip(forces.columns(vector), within.columns(vector), strict=True):
        np.testing.assert_allclose(one.slopes, other.slopes, atol=1e-7 * np.abs(other.slopes).max())


def test_forces_of_a_model_act_with_its_delay_whatever_a_card_says(system):
    (record, _) = record_in_loop(system, system.nominal(), 2, 2.0)
    late = tuple(replace(i, delay=-0.02) for i in record.inputs)
    alone = system.model({name: jnp.asarray(x) for name, x in system.nominal().items()})
    model = tn.discretise(alone, record.dt, inputs=late)
    shifted = replace(record, channels=replace(record.channels, inputs=late))
    one, other = (tn.inverse_dynamics(model, e, 5.0).applied for e in (record, shifted))
    np.testing.assert_array_equal(one, other)
    plain = tn.discretise(alone, record.dt, inputs=record.inputs)
    assert np.abs(tn.inverse_dynamics(plain, record, 5.0).applied - one).max() > 0.1


def test_what_is_not_linear_in_its_levels_is_no_candidate(system):
    data = record_in_loop(system, system.nominal(), 2, 2.0)
    recipe = tn.read_recipe("inverse-dynamics", ['search.candidates=["stribeck"]'])
    with pytest.raises(InputError, match="whose parameters do not all multiply a force"):
        tn.identify(data, system, recipe)


@pytest.mark.thorough
def test_the_cutoff_is_not_fooled_by_noise_of_positions(system):
    """At 1 kHz with counts of an encoder and stamps that jitter, of a motion of 1 Hz."""
    data = record_in_loop(system, true_values(system, 1), 2, 4.0, dt=0.001)
    rng = np.random.default_rng(0)
    records = [
        replace(e.without_controller(), q=e.q + 0.0003 * rng.normal(size=e.q.shape)) for e in data
    ]
    assert 3.0 < choose_cutoff(system, records) < 40.0


@pytest.mark.real
def test_the_wrist_of_a_measured_arm_is_found(real_data):
    """Staubli TX40: the motor of joint 5 turns joint 6, too; 60 % of its torque was missing."""
    folder = real_data.parent / "measured" / "tx40"
    if not folder.is_dir():
        pytest.skip("the records of a measured arm are not at hand (measured/tx40)")
    data, system = tn.load(folder), tn.load_system(folder / "tx40.urdf")
    result = tn.identify(data, system, "inverse-dynamics")
    assert "armature:joint_5+joint_6" in result.system.added
    pairs = [name for name in result.system.added if name.startswith("armature:")]
    assert len(pairs) == 1
    held_out = [e.share for e in result.force_errors if e.split == "validation"]
    assert np.mean(held_out) < 0.15


@pytest.mark.thorough
def test_forces_of_a_record_are_those_that_a_fit_names(slipping, without):
    data, result = slipping, without
    (record,) = data.split("validation")
    forces = tn.inverse_dynamics(result.model, record, training=list(data.split("train")))
    named = [e for e in result.force_errors if e.split == "validation"]
    for own, error in zip(forces.errors, named, strict=True):
        assert (own.coordinate, own.unit, own.split) == (error.coordinate, error.unit, "validation")
        assert own.cutoff == pytest.approx(error.cutoff), "that of the fit"
        assert own.share == pytest.approx(error.share, rel=1e-3)
        assert own.moving == pytest.approx(error.moving, rel=1e-3)
        assert own.by_file == pytest.approx(error.by_file, rel=1e-3)
        assert own.by_least_squares == pytest.approx(error.by_least_squares, rel=0.02)
    assert np.allclose(forces.missing, forces.needed - forces.applied)
    assert len(forces.t) == len(forces.needed)
    assert np.ptp(np.diff(forces.t)) < 1e-9
    assert record.t[0] < forces.t[0] < forces.t[-1] < record.t[-1]
    chosen = tn.inverse_dynamics(result.model, record, 5.0)
    assert chosen.cutoff == 5.0
    assert chosen.errors[0].by_least_squares is None, "there were no training records"
    network = tn.fit(data, "linear").model
    with pytest.raises(InputError, match="a model without equations of motion"):
        tn.inverse_dynamics(network, record)


def test_least_squares_with_a_gain_that_is_known_leave_what_is_missing():
    a, noise = np.random.default_rng(3).normal(size=(2, 400, 1))
    u = (3.0 * a + 0.1 * noise) / 2.0  # a mass of 3, a gain of 2
    slopes = np.stack([a, -u], axis=2)
    columns = Columns(slopes, np.zeros_like(u), 2 * u, 3 * a, np.abs(a), 1.0)
    assert not least_squares(sum_up([columns])).any(), "without both nothing is missing"
    assert least_squares(sum_up([columns]), {1: 2.0}) == pytest.approx([3.0, 2.0], rel=0.01)
