"""Coordinates that no sensor measures: dynamics, sensors' errors, and the rigid system."""

import re
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.lagrangian import Inertia, UnmeasuredCoordinates
from tustinnet.models.sensors import with_sensor_errors

# a pendulum on a cart by a spring: the cart's position is measured, the pendulum's angle is not
M, L, G, K = 0.8, 0.5, 9.81, 30.0


def kinetic(q, v, p):
    horizontal = v[0] + L * v[1] * jnp.cos(q[1])
    return p["cart"] * v[0] ** 2 / 2 + M * (horizontal**2 + (L * v[1] * jnp.sin(q[1])) ** 2) / 2


def potential(q, p):
    return K * q[0] ** 2 / 2 - M * G * L * jnp.cos(q[1])


HANGING = tn.LagrangianSystem(
    name="crane",
    coordinates=(tn.Coordinate("x", "linear"),),
    inputs=(tn.Input("force", "N"),),
    parameters=(tn.Parameter("cart", "kg", 2.0, 0.1, 10.0),),
    kinetic=kinetic,
    potential=potential,
    dissipation=lambda q, v, p: jnp.stack([0.5 * v[0], 0.1 * v[1]]),
    input_map=lambda q, v, u, p: jnp.stack([u[0], 0.0]),
    unmeasured=UnmeasuredCoordinates(("angle",), lambda q, p: 0.2 * jnp.sin(q)),
)
# the system with a sensor at the angle
MEASURED = replace(
    HANGING,
    coordinates=(*HANGING.coordinates, tn.Coordinate("angle", "angular")),
    unmeasured=None,
)
VALUES = {"cart": jnp.asarray(2.0)}


@pytest.mark.thorough
def test_the_motion_is_that_of_the_system_with_a_sensor():
    """States are in another order: measured positions and velocities come first."""
    q, h, v, w = 0.3, -0.4, 0.7, 1.1
    assert HANGING.internal == ("angle", "angle_speed")
    own = HANGING.model(VALUES).derivative(jnp.array([q, v, h, w]), jnp.array([2.0]))
    full = MEASURED.model(VALUES).derivative(jnp.array([q, h, v, w]), jnp.array([2.0]))
    np.testing.assert_allclose(own, full[jnp.array([0, 2, 1, 3])], rtol=1e-12)
    assert HANGING.model(VALUES).energy(jnp.array([q, v, h, w])) == pytest.approx(
        float(MEASURED.model(VALUES).energy(jnp.array([q, h, v, w])))
    )


def test_records_begin_where_unmeasured_coordinates_are_expected():
    model = HANGING.model(VALUES)
    begun = model.initial_internal(jnp.array([0.3, 0.7]), jnp.zeros(1))
    np.testing.assert_allclose(begun, [0.2 * np.sin(0.3), 0.2 * np.cos(0.3) * 0.7], rtol=1e-12)
    assert model.initial_needs_inputs
    assert model.searched_internal.tolist() == [True, True]
    np.testing.assert_array_equal(model.internal_spread, [1.0, 1.0])


@pytest.mark.thorough
@pytest.mark.parametrize("has_inertia", [False, True])
def test_the_rigid_system_moves_along_the_relation(has_inertia):
    """Against the energies of one coordinate, written by hand."""
    system = HANGING
    if has_inertia:
        plain = HANGING.model(VALUES)

        def coriolis(q, v, p):
            force = plain.conservative(q, v)
            return force - jnp.stack([-K * q[0], -M * G * L * jnp.sin(q[1])])

        inertia = Inertia(lambda q, p: plain.mass_matrix(q), coriolis)
        system = replace(HANGING, inertia=inertia)

    def follow(x):
        return 0.2 * jnp.sin(x)

    def full(x, v):
        return jnp.stack([x[0], follow(x[0])]), jnp.stack([v[0], 0.2 * jnp.cos(x[0]) * v[0]])

    by_hand = replace(
        HANGING,
        kinetic=lambda q, v, p: kinetic(*full(q, v), p),
        potential=lambda q, p: potential(full(q, q)[0], p),
        dissipation=lambda q, v, p: 0.5 * v + 0.1 * (0.2 * jnp.cos(q)) ** 2 * v,
        input_map=lambda q, v, u, p: u,
        unmeasured=None,
    )
    x, u = jnp.array([0.5, -0.9]), jnp.array([1.5])
    expected = by_hand.model(VALUES).derivative(x, u)
    np.testing.assert_allclose(
        rigid_system(system).model(VALUES).derivative(x, u), expected, rtol=1e-10
    )


def test_sensor_errors_are_those_of_measured_coordinates():
    sensors = (
        tn.Parameter("x.gain", "1", 1.0, 0.5, 2.0),
        tn.Parameter("x.bias", "m", 0.0, -1.0, 1.0),
        tn.Parameter("force.gain", "1", 1.0, 0.5, 2.0),
    )
    wrong = with_sensor_errors(HANGING, sensors)
    values = VALUES | {"x.gain": 2.0, "x.bias": 0.1, "force.gain": 3.0}
    q, h, v, w = 0.3, -0.4, 0.7, 1.1
    own = HANGING.model(VALUES).derivative(jnp.array([q, v, h, w]), jnp.array([3.0]))
    seen = wrong.model(values).derivative(jnp.array([2 * q + 0.1, 2 * v, h, w]), jnp.array([1.0]))
    np.testing.assert_allclose(seen, own * jnp.array([2.0, 2.0, 1.0, 1.0]), rtol=1e-10)
    begun = wrong.model(values).initial_internal(jnp.array([2 * q + 0.1, 2 * v]), jnp.ones(1))
    np.testing.assert_allclose(
        begun, HANGING.model(VALUES).initial_internal(jnp.array([q, v]), jnp.ones(1)), rtol=1e-10
    )


def test_shapes_of_the_functions_are_checked():
    with pytest.raises(InputError, match=re.escape("unmeasured follow: returns shape (2,)")):
        replace(
            HANGING,
            unmeasured=UnmeasuredCoordinates(("angle",), lambda q, p: jnp.stack([q[0], q[0]])),
        )
    with pytest.raises(InputError, match="dissipation: returns shape"):
        replace(HANGING, dissipation=lambda q, v, p: v[:1])


@pytest.mark.thorough
def test_a_model_is_identified_from_the_measured_coordinate_alone():
    """Records of the cart tell its mass, though the pendulum on it is seen by no sensor."""
    model = tn.discretise(HANGING.model({"cart": jnp.asarray(3.0)}), 0.02, 4)
    step, rng, records = tn.compiled_step(model), np.random.default_rng(0), []
    for k in range(2):
        force = 6 * np.sign(np.sin(np.arange(250) * 0.02 * (3 + k)) + 0.3 * rng.normal(size=250))
        force[:8] = 0.0  # it begins at rest
        states = [np.zeros(4)]
        for u in force[:-1]:
            states.append(step(states[-1], np.array([u])))
        records.append(
            tn.from_arrays(
                np.round(np.array(states)[:, :1] / 1e-4) * 1e-4,
                force[:, None],
                dt=0.02,
                coordinates=[tn.Coordinate("x", "linear", 1e-4)],
                name=f"run{k}",
                inputs=[tn.Input("force", "N", "zero-order", is_delay_declared=True)],
                split=("train", "validation")[k],
            )
        )
    result = tn.identify(tn.DataSet("cart", tuple(records)), HANGING, "grey")
    assert result.values["cart"] == pytest.approx(3.0, rel=2e-3)
    assert result.validation_rmse is not None
    # a thousandth of the motion: 20 samples, of which the last weigh most, say little of an angle
    # that is not measured
    assert result.validation_rmse < 1e-3 * 1.79
