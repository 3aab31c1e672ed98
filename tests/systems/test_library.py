"""Packaged systems of common machines: their equations, drawings and twins."""

from importlib import import_module

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.registry import SYSTEMS
from tustinnet.systems.library import link_chain

PACKAGE = "tustinnet.systems.library."
PLACES = {
    name: place.partition(":")[0]
    for name, place in SYSTEMS.places.items()
    if isinstance(place, str) and place.startswith(PACKAGE)
}
MODULES = sorted({place.removeprefix(PACKAGE) for place in PLACES.values()})


def model(name: str) -> tn.LagrangianModel:
    system = tn.load_system(name)
    return system.model({n: jnp.asarray(x) for n, x in system.nominal().items()})


@pytest.mark.thorough
@pytest.mark.parametrize("module", MODULES)
def test_the_parameters_of_a_twin_are_recovered(module):
    twin = import_module(PACKAGE + module).TWIN
    result = tn.identify(
        twin.records(), twin.system, tn.read_recipe("grey", ["search.initial=anchored"])
    )
    delays = [e for e in result.estimates if e.name.endswith(".delay")]  # beside a lag
    assert all(abs(e.value) < 0.1 * result.model.dt for e in delays)
    physical = [e for e in result.estimates if e not in delays]
    values = {e.name: e.value for e in physical}
    # all that differs from the nominal values had to be found
    assert set(values) == set(twin.values)
    assert values == pytest.approx(dict(twin.values), rel=0.02)
    # over many seeds 95 % of the intervals contain the true values: benchmarks/library.py
    intervals = {e.name: e.interval or (np.nan, np.nan) for e in physical}
    inside = [low <= twin.values[name] <= high for name, (low, high) in intervals.items()]
    assert sum(inside) >= 0.75 * len(inside)
    assert all(high - low < 0.1 * twin.values[name] for name, (low, high) in intervals.items())


@pytest.mark.parametrize("name", PLACES)
def test_a_system_is_found_by_its_name_and_is_drawn_whole(name):
    system = tn.load_system(name)
    assert system.name == name
    assert {link.coordinate for link in system.links} == {c.name for c in system.coordinates}


def test_names_are_listed_where_one_is_unknown():
    with pytest.raises(tn.InputError, match=r"cart-pole, 2-link-chain, .*duffing"):
        tn.load_system("cart-pol")


def test_the_seed_of_a_twin_decides_everything():
    twin = import_module(PACKAGE + "duffing").TWIN
    one, again, other = (twin.records(seed, 1, 1, 1) for seed in (0, 0, 1))
    assert one.splits == ("train", "validation", "test")
    assert all(np.array_equal(a.q, b.q) for a, b in zip(one, again, strict=True))
    assert not np.array_equal(one[0].q, other[0].q)
    counts = one[0].q / twin.resolution[0]
    np.testing.assert_allclose(counts - counts[0], np.round(counts - counts[0]), atol=1e-6)


def test_a_chain_of_one_link_is_a_pendulum():
    system = link_chain.make_link_chain(1)
    pendulum = system.model({n: jnp.asarray(x) for n, x in system.nominal().items()})
    acceleration = pendulum.derivative(jnp.array([0.4, 2.0]), jnp.array([0.1]))[1]
    inertia = 2e-3 + 0.3 * 0.15**2
    torque = 0.1 - 0.3 * 9.81 * 0.15 * np.sin(0.4) - 2e-3 * 2.0
    assert acceleration == pytest.approx(torque / inertia, rel=1e-5)


def test_within_the_backlash_the_shaft_transmits_nothing():
    drive = model("two-mass-drive")
    # the load rests against a motor that moves by less than half of the backlash, 0.02 rad
    inside, beyond = (
        drive.derivative(jnp.array([q, 0.0, 0.0, 0.0]), jnp.zeros(1)) for q in (0.019, 0.03)
    )
    np.testing.assert_allclose(inside, 0.0, atol=1e-6)
    np.testing.assert_allclose(beyond[2:], [-2.0 * 0.01 / 4e-4, 2.0 * 0.01 / 1.5e-3], rtol=1e-4)


def test_the_thrust_is_that_of_the_speed_which_follows_the_command():
    twin = import_module(PACKAGE + "propeller_pendulum").TWIN
    values = {name: jnp.asarray(value) for name, value in twin.true_values().items()}
    found = twin.system.model(values).derivative(jnp.array([0.3, 0.5, -0.6]), jnp.array([0.9]))
    torque = -0.36 * 0.6**2 - 0.42 * np.sin(0.3) - 7e-3 * 0.5
    np.testing.assert_allclose(found, [0.5, torque / 0.02, 1.5 / 0.09], rtol=1e-6)


def test_a_propeller_is_expected_at_its_first_command_after_loading_too(tmp_path):
    file = tmp_path / "model.safetensors"
    tn.save(tn.discretise(model("propeller-pendulum"), 0.02, 4), file)
    again = tn.load_model(file)
    assert again.internal == ("spin",)
    np.testing.assert_allclose(again.initial_state(jnp.zeros(2), jnp.array([0.4])), [0, 0, 0.4])


def test_a_cart_under_a_leaning_pole_is_pushed_back():
    x = jnp.array([0.0, 0.1, 0.0, 0.0])
    cart, pole = model("cart-pole").derivative(x, jnp.zeros(1))[2:]
    # the pole falls on; its centre goes down, which pushes the cart the other way
    assert pole > 0
    assert cart < 0
