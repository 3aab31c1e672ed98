"""Forces of the library, identified with the parameters of a system that lacks them."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import (
    CART,
    DT,
    SWING,
    TRUTH,
    changed,
    data_set,
    driven_again,
    falls,
    records,
    simulated,
    voltage,
)

import tustinnet as tn
from tustinnet.families.hybrid import HybridModel
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.models import forces
from tustinnet.models.blocks import Scaling
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

KNOWN_GAIN = changed("gain", nominal=TRUTH["gain"], fixed=True)
RUBBED = {"angle.coulomb": 0.06, "angle.cubic": 0.1}  # N m, N m/rad^3
STRIBECK = {"angle.coulomb": 0.06, "angle.breakaway": 0.1, "angle.stribeck_speed": 0.5}
RELAXING = {"angle.maxwell": 0.3, "angle.relaxation": 2.0}


def recipe(*forces: str, **fixed: float) -> tn.Recipe:
    table = {"kind": "euler-lagrange", "forces": list(forces), "fixed": fixed}
    return tn.read_recipe({"name": "forces", "model": table, "search": {"initial": "anchored"}})


def rubbed() -> list[tn.Experiment]:
    return driven_again(with_added(SWING, ["coulomb", "cubic"], records(), {}), RUBBED)


@pytest.fixture(scope="module")
def result() -> tn.Identification:
    usual = tn.read_recipe(recipe("coulomb", "cubic:angle"), ["search.initial=choose"])
    return tn.identify(data_set(rubbed()), KNOWN_GAIN, usual)


@pytest.mark.thorough
def test_dry_friction_and_a_cubic_spring_are_found_with_the_parameters(result):
    values = {e.name: (e.value, e.unit) for e in result.estimates}
    assert values["angle.coulomb"] == (pytest.approx(RUBBED["angle.coulomb"], rel=0.005), "N m")
    assert values["angle.cubic"] == (pytest.approx(RUBBED["angle.cubic"], rel=1e-3), "N m/rad^3")
    assert values["damping"][0] == pytest.approx(TRUTH["damping"], rel=0.01)
    assert values["gravity"][0] == pytest.approx(TRUTH["gravity"], rel=1e-3)
    assert "angle.smooth_speed" in result.fixed
    assert result.outcome.startswith("converged")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("force", "truth"), [("stribeck", STRIBECK), ("maxwell:angle", RELAXING)], ids=str
)
def test_other_laws_are_found_too(force, truth):
    rested = {"angle.turned": 0.0} if force.startswith("maxwell") else {}
    made = driven_again(with_added(SWING, [force], records(), {}), truth | rested)
    result = tn.identify(data_set(made), KNOWN_GAIN, recipe(force, **rested))
    values = {e.name: e.value for e in result.estimates}
    assert {name: values[name] for name in truth} == pytest.approx(truth, rel=0.1)


@pytest.mark.thorough
def test_stribeck_friction_is_found_beside_the_level_of_the_system():
    rubbing = replace(
        KNOWN_GAIN,
        name="rubbing swing",
        parameters=(
            *KNOWN_GAIN.parameters,
            Parameter("angle.coulomb", "N m", 0.02, 0.0, 1.0),
            Parameter("angle.coulomb_speed", "rad/s", 0.05, 0.01, 1.0, fixed=True),
        ),
        dissipation=lambda q, v, p: (
            p["damping"] * v + forces.coulomb(v, p["angle.coulomb"], p["angle.coulomb_speed"])
        ),
    )
    made = driven_again(with_added(rubbing, ["stribeck"], records(), {}), STRIBECK)
    result = tn.identify(data_set(made), rubbing, recipe("stribeck"))
    assert result.system.added_parameters == ("angle.breakaway", "angle.stribeck_speed")
    # well above the width of the smoothed sign, of which there are two: by the motion and its own
    speed, (at_rest,) = result.system.parameter("angle.stribeck_speed"), rubbing.parameters[-1:]
    assert speed.lower <= 2 * at_rest.nominal
    assert speed.upper >= 100 * at_rest.nominal
    values = {e.name: e.value for e in result.estimates}
    assert {name: values[name] for name in STRIBECK} == pytest.approx(STRIBECK, rel=0.1)


@pytest.mark.thorough
def test_a_curve_is_friction_that_grows_with_the_speed_and_is_kept_in_a_file(tmp_path):
    truth = {"angle.coulomb": 0.06}
    true = with_added(SWING, ["coulomb"], records(), {})
    result = tn.identify(data_set(driven_again(true, truth)), KNOWN_GAIN, recipe("curve"))
    assert true.dissipation is not None
    assert result.system.dissipation is not None
    values, q = true.nominal() | TRUTH | truth, jnp.zeros(1)
    for speed in (0.3, -1.0, 3.0):
        v = jnp.array([speed])
        found = result.system.dissipation(q, v, result.values)
        np.testing.assert_allclose(found, true.dissipation(q, v, values), rtol=0.1)
    tn.save(result.model, tmp_path / "m.safetensors")
    again: Any = tn.load_model(tmp_path / "m.safetensors", KNOWN_GAIN)
    assert again.continuous.system.parameters == result.system.parameters


@pytest.mark.thorough
def test_the_lag_of_an_actuator_is_found_and_kept_in_a_file(tmp_path):
    truth = {"voltage.lag": 0.08, "voltage.initial_share": 1.0}
    made = driven_again(with_added(SWING, ["lag"], records(), {}), truth)
    result = tn.identify(data_set(made), KNOWN_GAIN, recipe("lag"))
    values = {e.name: (e.value, e.unit) for e in result.estimates}
    assert values["voltage.lag"] == (pytest.approx(0.08, rel=0.02), "s")
    assert values["gravity"][0] == pytest.approx(TRUTH["gravity"], rel=0.01)
    assert result.fixed["voltage.initial_share"] == 1.0
    tn.save(result.model, tmp_path / "m.safetensors")
    again: Any = tn.load_model(tmp_path / "m.safetensors", KNOWN_GAIN)
    x, u = jnp.array([0.3, -1.0, 0.7]), jnp.array([2.0])
    np.testing.assert_allclose(again.step(x, u), result.model.step(x, u), rtol=1e-12)
    np.testing.assert_allclose(again.initial_state(x[:2], u), [0.3, -1.0, 2.0])


@pytest.mark.thorough
def test_ends_of_travel_are_found():
    """Of a link that a motor drives from one end to the other, where it hardly bounces."""
    driven = [simulated(f"driven{k}", [0.0, 0.0], 5 * voltage(200, k)) for k in (1, 2, 3)]
    truth = {"angle.lower_end": -0.35, "angle.upper_end": 0.25}
    hard = {"angle.stop_stiffness": 60.0, "angle.stop_damping": 2.0}
    made = driven_again(with_added(SWING, ["end_stops"], driven, {}), truth | hard, driven)
    result = tn.identify(data_set(made), KNOWN_GAIN, recipe("end_stops"))
    values = {e.name: (e.value, e.unit) for e in result.estimates}
    for name, end in truth.items():
        assert values[name] == (pytest.approx(end, abs=0.03), "rad")
    assert values["gravity"][0] == pytest.approx(TRUTH["gravity"], rel=0.05)


@pytest.mark.thorough
def test_the_dead_zone_of_an_input_is_found_and_kept_in_a_file(tmp_path):
    truth = {"voltage.dead_zone": 0.4}
    made = driven_again(with_added(SWING, ["dead_zone"], records(), {}), truth)
    result = tn.identify(data_set(made), KNOWN_GAIN, recipe("dead_zone"))
    values = {e.name: (e.value, e.unit) for e in result.estimates}
    assert values["voltage.dead_zone"] == (pytest.approx(0.4, rel=0.02), "V")
    assert values["gravity"][0] == pytest.approx(TRUTH["gravity"], rel=0.01)
    tn.save(result.model, tmp_path / "m.safetensors")
    again: Any = tn.load_model(tmp_path / "m.safetensors", KNOWN_GAIN)
    x = jnp.array([0.3, -1.0])
    for u in (0.2, 2.0):
        found, wanted = (m.step(x, jnp.array([u])) for m in (again, result.model))
        np.testing.assert_allclose(found, wanted, rtol=1e-12)


def test_the_lag_of_an_input_that_never_changes_is_refused():
    with pytest.raises(tn.InputError, match="'lag:voltage': 'voltage' never changes"):
        with_added(SWING, ["lag"], falls(), {})


@pytest.mark.thorough
def test_a_friction_that_is_not_there_is_told():
    findings = tn.identify(data_set(records()), KNOWN_GAIN, recipe("coulomb")).findings
    assert any("'angle.coulomb' is 0, its lower bound" in f.text for f in findings)


def test_a_file_keeps_the_forces(result, tmp_path):
    path = tmp_path / "m.safetensors"
    tn.save(result.model, path)
    again: Any = tn.load_model(path, KNOWN_GAIN)
    x, u = jnp.array([0.3, -1.0]), jnp.array([2.0])
    np.testing.assert_allclose(again.step(x, u), result.model.step(x, u), rtol=1e-12)
    assert again.continuous.system.parameters == result.model.continuous.system.parameters
    stiff = replace(KNOWN_GAIN, potential=lambda q, p: -1.01 * p["gravity"] * jnp.cos(q[0]))
    with pytest.raises(tn.InputError, match="has changed since the model was identified"):
        tn.load_model(path, stiff)
    has_one = replace(
        KNOWN_GAIN, parameters=(*KNOWN_GAIN.parameters, Parameter("angle.cubic", "", 0.0, 0.0, 1.0))
    )
    with pytest.raises(tn.InputError, match=r"brings 'angle\.cubic', which the system 'swing' has"):
        tn.load_model(path, has_one)


def test_a_hybrids_physics_keeps_its_forces_and_their_internal_states(tmp_path):
    system = with_added(SWING, ["maxwell", "coulomb"], records(), {})
    values = system.nominal() | RELAXING
    physics = tn.discretise(system.model({k: jnp.asarray(x) for k, x in values.items()}), DT)
    one, none = jnp.ones(1, jnp.float32), jnp.zeros(0, jnp.float32)
    network = random_tustin_net(
        physics.channels,
        Scaling(none, none, 5 * one, one, one, none),
        jax.random.key(0),
        hidden=(4,),
    )
    model = HybridModel(physics, network)
    tn.save(model, tmp_path / "h.safetensors")
    again = tn.load_model(tmp_path / "h.safetensors", SWING)
    assert again.internal == ("maxwell:angle",)
    x, u = jnp.array([0.3, -1.0, 0.1]), jnp.array([2.0])
    np.testing.assert_allclose(again.step(x, u), model.step(x, u), rtol=1e-6)


def test_the_search_begins_at_the_plain_system():
    forces = ["stribeck", "viscous", "coulomb_by_position", "spring", "cubic", "maxwell"]
    system = with_added(SWING, forces, records(), {})
    at, plain = (
        s.model({k: jnp.asarray(x) for k, x in s.nominal().items()}) for s in (system, SWING)
    )
    x, u = jnp.array([1.2, -2.0, 0.2]), jnp.array([3.0])
    np.testing.assert_allclose(at.derivative(x, u)[:2], plain.derivative(x[:2], u), rtol=2e-2)


def test_ranges_grow_with_the_system_and_its_motion():
    """A system a million times as strong, and a thousandth as large, in motion a hundredth."""
    strong = replace(
        SWING,
        parameters=tuple(
            replace(p, nominal=1e6 * p.nominal, lower=1e6 * p.lower, upper=1e6 * p.upper)
            for p in SWING.parameters
        ),
    )
    forces = ["stribeck", "viscous", "coulomb_by_position", "spring", "cubic", "maxwell"]
    usual, large = (
        {p.name: p for p in with_added(s, forces, falls(), {}).parameters if "." in p.name}
        for s in (SWING, strong)
    )
    same = {f"angle.{n}" for n in ("stribeck_speed", "smooth_speed", "relaxation", "turned")}
    for name, p in usual.items():
        by = 1.0 if name in same else 1e6
        assert large[name].upper == pytest.approx(by * p.upper)
        assert large[name].nominal == pytest.approx(by * p.nominal)
    slow = [
        replace(e, t=2 * e.t, v=e.velocities() / 2, channels=replace(e.channels, dt=2 * DT))
        for e in falls()
    ]
    later = {p.name: p for p in with_added(SWING, ["stribeck", "maxwell"], slow, {}).parameters}
    for name in ("angle.stribeck_speed", "angle.smooth_speed", "angle.relaxation"):
        assert later[name].upper == pytest.approx(usual[name].upper / 2)


def test_values_that_a_recipe_knows_better_set_the_scale():
    heavy = {"gravity": 10.0}  # ten times the nominal one
    systems = [with_added(SWING, ["coulomb"], falls(), values) for values in ({}, heavy)]
    usual, strong = (s.parameter("angle.coulomb").upper for s in systems)
    assert 5 * usual < strong <= 10 * usual


def test_units_are_those_of_the_coordinate():
    cart = LagrangianSystem(
        name="cart",
        coordinates=(tn.Coordinate("x", "linear"), tn.Coordinate("u_c", "linear", unit="V")),
        inputs=(),
        parameters=(Parameter("mass", "kg", 1.0, 0.1, 5.0),),
        kinetic=lambda q, v, p: p["mass"] * jnp.sum(v**2),
    )
    q = np.sin(np.arange(100.0)[:, None] * [0.1, 0.2])
    e = tn.from_arrays(q, np.zeros((100, 0)), dt=0.1, coordinates=cart.coordinates, inputs=())
    system = with_added(cart, ["stribeck", "viscous", "cubic", "maxwell"], [e], {})
    units = {p.name: p.unit for p in system.parameters}
    assert units["x.coulomb"] == "N"
    assert units["x.stribeck_speed"] == "m/s"
    assert units["x.viscous"] == "N s/m"
    assert units["x.cubic"] == "N/m^3"
    assert units["x.maxwell"] == "N/m"
    assert units["x.relaxation"] == "1/s"
    assert units["u_c.viscous"] == "J/V s/V"


def test_a_coordinate_that_never_moves_is_refused():
    still = [replace(e, q=0 * e.q, v=0 * e.velocities()) for e in falls()]
    with pytest.raises(tn.InputError, match="'coulomb:angle': 'angle' never moves"):
        with_added(SWING, ["coulomb"], still, {})


def test_springs_of_no_coordinate_are_added_where_none_turns_around():
    time = np.arange(0, 4, 0.01)
    q = np.stack([0.3 * np.sin(2 * time), 3.0 * np.cos(3 * time)], axis=1)
    e = tn.from_arrays(
        q, np.sin(time)[:, None], dt=0.01, coordinates=CART.coordinates, inputs=CART.inputs
    )
    system = with_added(CART, ["coulomb", "cubic", "maxwell"], [e], {})
    assert system.added == ("coulomb:x", "coulomb:angle", "cubic:x", "maxwell:x")
    assert with_added(CART, ["cubic:angle"], [e], {}).added == ("cubic:angle",)
    whole_turns = replace(falls()[0], q=3 * falls()[0].q, v=None, v_measured=False)
    with pytest.raises(tn.InputError, match="'spring': every coordinate turns around"):
        with_added(SWING, ["spring"], [whole_turns], {})


@pytest.mark.thorough
def test_their_parameters_are_fixed_and_begun_like_any_other():
    some = recipe("coulomb", "cubic", **{"angle.cubic": 0.1, "angle.smooth_speed": 0.05})
    result = tn.identify(data_set(rubbed()), KNOWN_GAIN, some, begin={"angle.coulomb": 0.01})
    assert result.fixed["angle.cubic"] == 0.1
    assert result.fixed["angle.smooth_speed"] == 0.05
    assert "angle.coulomb" in {e.name for e in result.estimates}
    with pytest.raises(tn.InputError, match=r"no parameter 'angle\.viscous'"):
        tn.identify(data_set(rubbed()), KNOWN_GAIN, recipe("cubic", **{"angle.viscous": 0.1}))


@pytest.mark.thorough
def test_a_system_with_values_per_group_takes_forces():
    per = changed("damping", KNOWN_GAIN, per="oil")
    made = [replace(e, groups=(("oil", "thin"),)) for e in rubbed()]
    values = {
        e.name: e.value
        for e in tn.identify(data_set(made), per, recipe("coulomb", "cubic")).estimates
    }
    assert values["angle.cubic"] == pytest.approx(RUBBED["angle.cubic"], rel=0.01)
    assert values["damping[thin]"] == pytest.approx(TRUTH["damping"], rel=0.01)


@pytest.mark.thorough
def test_forces_and_sensors_go_together():
    made = [replace(e, q=e.q + 0.03) for e in rubbed()]
    some = recipe("coulomb", "cubic").model_copy()
    both = some.model_copy(
        update={"model": some.model.model_copy(update={"free": ("angle.bias",)})}
    )
    result = tn.identify(data_set(made), KNOWN_GAIN, both)
    values = {e.name: e.value for e in result.estimates}
    assert values["angle.bias"] == pytest.approx(0.03, abs=2e-3)
    assert values["angle.cubic"] == pytest.approx(RUBBED["angle.cubic"], rel=0.02)


def test_kinds_with_weights_do_not_know_the_key():
    with pytest.raises(tn.InputError, match="forces"):
        tn.read_recipe("standard", ['model.forces=["coulomb"]'])
