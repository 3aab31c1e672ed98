"""The mechanism that nobody has written down."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import CART, data_set, noises, records

import tustinnet as tn
from tustinnet.fits.fit import fit_request
from tustinnet.fits.request import FitRequest
from tustinnet.fitting.listener import SILENT
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.fitting.task import Origin
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import Parameter
from tustinnet.systems.mechanism import MECHANISM


def cart_records(seconds: float = 4.0) -> list[tn.Experiment]:
    """The cart moved by hand: positions and forces that it could have had."""
    t = np.arange(0.0, seconds, 0.01)
    q = np.stack([0.3 * np.sin(2 * t), 2.0 * np.cos(3 * t)], axis=1)
    return [
        tn.from_arrays(
            q,
            np.sin(5 * t)[:, None],
            dt=0.01,
            name="moved",
            coordinates=CART.coordinates,
            inputs=CART.inputs,
        )
    ]


def test_it_has_the_terms_that_the_coordinates_can_have():
    system = MECHANISM.for_records(cart_records())
    names = set(system.nominal())
    assert {"x.spring", "x.pull", "angle.gravity_cos", "x.coupling_angle_cos_angle"} <= names
    assert not {"x.gravity_cos", "x.gravity_sin"} & names, "a slide does not turn"
    assert "angle.inertia_cos_angle" not in names, "no inertia depends on its own angle"
    assert "angle.spring" in names, "it moves by 4 rad only"
    assert system.parameter("x.inertia").fixed
    always = {f"{c}.{name}" for c in ("x", "angle") for name in ("inertia", "viscous")}
    assert set(system.optional) == names - always
    assert system.parameter("x.spring").brings == ("cubic:x", "coulomb_by_position:x", "maxwell:x")


def test_a_coordinate_that_turns_around_has_no_spring():
    e = noises()[0]
    turned = replace(e, q=np.linspace(0, 5, len(e))[:, None], v=None, v_measured=False)
    assert "angle.spring" in MECHANISM.for_records([e]).nominal()
    assert "angle.spring" not in MECHANISM.for_records([turned]).nominal()


@pytest.mark.thorough
def test_with_the_right_values_it_moves_as_the_cart_does():
    """`CART` divided by the cart's inertia of 2 kg."""
    values = {
        "x.inertia": 1.0,
        "angle.inertia": 1.0,
        "x.coupling_angle_cos_angle": 0.5,
        "angle.gravity_cos": 0.5,
        "x.spring": 1.0,
        "x.viscous": 0.05,
        "angle.viscous": 0.05,
        "x.by_force": 0.5,
    }
    full = MECHANISM.for_records(cart_records())
    system = full.without([name for name in full.optional if name not in values])
    assert set(system.nominal()) == set(values)
    arrays = {name: jnp.asarray(x) for name, x in values.items()}
    zeros = {name: jnp.asarray(0.0) for name in full.optional}
    cart = CART.model({"mass": jnp.asarray(1.0)})
    for seed in range(5):
        x, u = jnp.asarray(np.random.default_rng(seed).normal(size=4)), jnp.array([0.7])
        wanted = cart.derivative(x, u)
        np.testing.assert_allclose(system.model(arrays).derivative(x, u), wanted, rtol=1e-5)
        whole = full.model(zeros | arrays).derivative(x, u)
        np.testing.assert_allclose(whole, wanted, rtol=1e-5, err_msg="with terms that are 0")


ARM = [tn.Coordinate("first", "angular"), tn.Coordinate("second", "angular")]
Q, V = jnp.array([0.4, 0.7]), jnp.array([1.1, -0.6])


@pytest.mark.parametrize(
    ("values", "energy"),
    [
        # a link on a link: 2 and 0.3 about their own joints, 0.5 together
        (
            {
                "first.inertia": 2.0,
                "second.inertia": 0.3,
                "first.coupling_second": 1.0,
                "first.inertia_along_second": 1.0,
                "first.coupling_second_cos_second": 0.5 / np.sqrt(2.0 * 0.3),
            },
            1.0 * V[0] ** 2
            + 0.15 * (V[0] + V[1]) ** 2
            + 0.5 * jnp.cos(Q[1]) * V[0] * (V[0] + V[1])
            - 0.15 * V[0] ** 2,
        ),
        # a pendulum of 0.3 on a turning arm
        (
            {"first.inertia": 2.0, "second.inertia": 0.3, "first.inertia_across_second": 1.0},
            1.0 * V[0] ** 2 + 0.15 * (V[1] ** 2 + (jnp.sin(Q[1]) * V[0]) ** 2),
        ),
    ],
    ids=["link", "arm"],
)
def test_with_usual_ratios_it_is_a_machine_of_rigid_links(values, energy):
    parameters = [Parameter(name, "", 0.0, -9.0, 9.0) for name in values]
    damping = [Parameter(f"{c.name}.viscous", "1/s", 0.0, 0.0, 1.0) for c in ARM]
    system = MECHANISM.restore(ARM, [], [*parameters, *damping])
    arrays = {name: jnp.asarray(x) for name, x in values.items()}
    np.testing.assert_allclose(system.kinetic(Q, V, arrays), energy, rtol=1e-6)


def test_equal_systems_share_their_functions_so_that_programs_serve_again():
    assert MECHANISM.for_records(records()) == MECHANISM.for_records(records())
    assert hash(MECHANISM.for_records(records())) == hash(MECHANISM.for_records(records()))


def test_what_nobody_could_identify_is_refused_by_name():
    e = noises()[0]
    still = replace(e, q=np.zeros_like(e.q), v=None, v_measured=False)
    with pytest.raises(tn.InputError, match="'angle': never moves in the records"):
        MECHANISM.for_records([still])
    axes = [tn.Coordinate(f"q{k}", "angular") for k in range(7)]
    seven = tn.from_arrays(
        np.random.default_rng(0).normal(size=(50, 7)),
        np.zeros((50, 1)),
        dt=0.01,
        coordinates=axes,
        inputs=e.inputs,
    )
    with pytest.raises(tn.InputError, match="7 coordinates; expected 6 at most"):
        MECHANISM.for_records([seven])


def test_four_angles_are_a_chain_of_links_in_a_plane():
    """Links of lengths 1, 0.8, 0.5 and 0.4 with a mass at the end of each; masses 1, 2, 3, 4."""
    axes = [tn.Coordinate(f"q{k}", "angular") for k in range(4)]
    lengths, masses = np.array([1.0, 0.8, 0.5, 0.4]), np.array([1.0, 2.0, 3.0, 4.0])
    behind = np.cumsum(masses[::-1])[::-1]
    inertias = behind * lengths**2
    values = {f"q{k}.inertia": x / inertias[0] for k, x in enumerate(inertias)}
    for i in range(4):
        for j in range(i + 1, 4):
            link = behind[j] * lengths[i] * lengths[j] / np.sqrt(inertias[i] * inertias[j])
            values[f"q{i}.link_q{j}"] = float(link)
    for k in range(4):
        name = "gravity_cos" if k == 0 else "gravity_cos_chain"
        values[f"q{k}.{name}"] = -9.81 * behind[k] * lengths[k] / inertias[k]
    parameters = [Parameter(name, "", 0.0, -99.0, 99.0) for name in values]
    damping = [Parameter(f"{c.name}.viscous", "1/s", 0.0, 0.0, 1.0) for c in axes]
    system = MECHANISM.restore(axes, [], [*parameters, *damping])
    q, v = jnp.array([0.4, 0.7, -1.2, 0.3]), jnp.array([1.1, -0.6, 0.2, 2.0])
    angle, speed = np.cumsum(q), np.cumsum(v)
    right = np.cumsum(lengths * np.cos(angle) * speed)
    up = np.cumsum(lengths * np.sin(angle) * speed)
    arrays = {name: jnp.asarray(x) for name, x in values.items()}
    energy = np.sum(masses * (right**2 + up**2)) / 2 / inertias[0]
    np.testing.assert_allclose(system.kinetic(q, v, arrays), energy, rtol=1e-6)
    assert system.potential is not None
    height = -9.81 * np.sum(masses * np.cumsum(lengths * np.cos(angle))) / inertias[0]
    np.testing.assert_allclose(system.potential(q, arrays), height, rtol=1e-6)
    moving = tn.from_arrays(
        np.random.default_rng(0).normal(size=(50, 4)),
        np.zeros((50, 0)),
        dt=0.01,
        coordinates=axes,
        inputs=(),
    )
    assert set(values) <= set(MECHANISM.for_records([moving]).nominal())


def test_two_wheels_on_a_shaft_may_be_elastic_and_a_ball_rolls_down_a_beam():
    t = np.arange(0.0, 4.0, 0.01)
    wheels = tn.from_arrays(
        np.stack([9 * np.sin(t), 9 * np.sin(t) + 0.1 * np.sin(7 * t)], axis=1),
        np.zeros((len(t), 0)),
        dt=0.01,
        coordinates=ARM,
        inputs=(),
    )
    system = MECHANISM.for_records([wheels])
    assert {"first.shaft_second", "first.shaft_viscous_second"} <= set(system.optional)
    assert "first.spring" not in system.nominal(), "they turn around"
    values = {name: jnp.asarray(0.0) for name in system.nominal()}
    values |= {"first.inertia": jnp.asarray(2.0), "first.shaft_second": jnp.asarray(3.0)}
    values |= {"first.shaft_viscous_second": jnp.asarray(0.5)}
    assert system.potential is not None
    assert system.dissipation is not None
    twist, slip = Q[0] - Q[1], V[0] - V[1]
    np.testing.assert_allclose(system.potential(Q, values), 2.0 * 3.0 * twist**2 / 2, rtol=1e-6)
    friction = system.dissipation(Q, V, values)
    np.testing.assert_allclose(friction, [2.0 * 0.5 * slip, -2.0 * 0.5 * slip], rtol=1e-6)

    slide = MECHANISM.for_records(cart_records())
    assert {"x.gravity_sin_angle", "angle.inertia_at_x"} <= set(slide.optional)
    values = {name: jnp.asarray(0.0) for name in slide.nominal()} | {
        "x.inertia": jnp.asarray(1.0),
        "angle.inertia": jnp.asarray(0.5),
        "x.gravity_sin_angle": jnp.asarray(9.81),
        "angle.inertia_at_x": jnp.asarray(1.0),
    }
    assert slide.potential is not None
    np.testing.assert_allclose(slide.potential(Q, values), 9.81 * Q[0] * jnp.sin(Q[1]), rtol=1e-6)
    energy = (V[0] ** 2 + (0.5 + Q[0] ** 2) * V[1] ** 2) / 2
    np.testing.assert_allclose(slide.kinetic(Q, V, values), energy, rtol=1e-6)


def test_a_fit_begins_within_the_ranges_of_its_own_records():
    """Those of forces, too, as the stiffness of stops, which follow from speed and travel."""
    slow = [replace(e, q=np.interp(e.t / 2, e.t, e.q[:, 0])[:, None], v=None) for e in noises()]
    slow = [replace(e, v_measured=False) for e in slow]
    wide, narrow = (
        with_added(MECHANISM.for_records(r), ("end_stops",), r, {}) for r in (noises(), slow)
    )
    stiffness = "angle.stop_stiffness"
    least = narrow.parameter(stiffness).lower
    assert least < wide.parameter(stiffness).lower
    values = {p.name: jnp.asarray(p.nominal) for p in narrow.parameters}
    values[stiffness] = jnp.asarray(least)
    origin = Origin(tn.discretise(narrow.model(values), 0.02))
    recipe = tn.read_recipe("mechanism + end_stops", "search.iterations=1")
    request = FitRequest(data_set([*noises()]), recipe, system=MECHANISM, origin=origin)
    (result,) = fit_request(request, SILENT)
    assert isinstance(result.model, Discretised)


def test_it_is_no_system_to_give_beside_a_model():
    with pytest.raises(tn.InputError, match="made for the records that it is identified from"):
        tn.load_system("mechanism")


def test_optional_parameters_belong_to_terms_that_can_be_left_out():
    with pytest.raises(tn.InputError, match="optional, and fixed"):
        Parameter("k", "N", 1.0, -2.0, 2.0, optional=True)
    spring = Parameter("spring", "N/m", 0.0, -1.0, 1.0, optional=True)
    with pytest.raises(tn.InputError, match=r"expected p.get\('spring', 0.0\)"):
        replace(
            CART,
            parameters=(*CART.parameters, spring),
            potential=lambda q, p: p["spring"] * q[0] ** 2,
        )
    may = replace(
        CART,
        parameters=(*CART.parameters, spring),
        potential=lambda q, p: p.get("spring", 0.0) * q[0] ** 2,
    )
    assert may.optional == ("spring",)
    assert may.without(["spring"]).optional == ()
    assert not jax.tree.leaves(may.without(["spring"]).parameters[1:])
