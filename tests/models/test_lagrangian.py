"""Equations of motion from energies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Parameter
from tustinnet.simulation.integrators import discretise

G = 9.81


def furuta_kinetic(q, v, p):
    """A rotary arm with a pendulum at its end, alpha 0 upright."""
    sine, cosine = jnp.sin(q[1]), jnp.cos(q[1])
    along = p["length"] * v[0] + p["centre"] * cosine * v[1]
    across = (p["centre"] * sine) ** 2 * (v[0] ** 2 + v[1] ** 2)
    spin = p["inertia"] * (v[1] ** 2 + (sine * v[0]) ** 2)
    arm = p["arm"] * v[0] ** 2
    return 0.5 * (arm + p["mass"] * (along**2 + across) + spin)


def furuta_potential(q, p):
    return p["mass"] * G * p["centre"] * jnp.cos(q[1])


FURUTA = LagrangianSystem(
    name="furuta",
    coordinates=(tn.Coordinate("theta", "angular"), tn.Coordinate("alpha", "angular")),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        Parameter("arm", "kg m^2", 2.3e-4, 1e-5, 1e-2),
        Parameter("length", "m", 0.085, 0.01, 1.0),
        Parameter("mass", "kg", 0.024, 0.001, 1.0),
        Parameter("centre", "m", 0.0645, 0.01, 1.0),
        Parameter("inertia", "kg m^2", 3.3e-5, 1e-7, 1e-2),
        Parameter("b1", "N m s", 1e-4, 0.0, 1.0),
        Parameter("b2", "N m s", 5e-5, 0.0, 1.0),
    ),
    kinetic=furuta_kinetic,
    potential=furuta_potential,
    dissipation=lambda q, v, p: jnp.array([p["b1"], p["b2"]]) * v,
    input_map=lambda q, v, u, p: jnp.array([u[0], 0.0]),
)


def model(**changes: float) -> LagrangianModel:
    values = FURUTA.nominal() | changes
    return LagrangianModel(FURUTA, {k: jnp.asarray(v, jnp.float64) for k, v in values.items()})


def hand_derived(q, v, torque):
    """The Furuta pendulum's acceleration, derived by hand."""
    p = FURUTA.nominal()
    a1 = p["arm"] + p["mass"] * p["length"] ** 2
    a2 = p["mass"] * p["centre"] ** 2 + p["inertia"]
    a3 = p["mass"] * p["length"] * p["centre"]
    s, c = np.sin(q[1]), np.cos(q[1])
    mass = np.array([[a1 + a2 * s**2, a3 * c], [a3 * c, a2]])
    right = np.array(
        [
            torque - p["b1"] * v[0] - 2 * a2 * s * c * v[0] * v[1] + a3 * s * v[1] ** 2,
            -p["b2"] * v[1] + a2 * s * c * v[0] ** 2 + p["mass"] * G * p["centre"] * s,
        ]
    )
    return np.linalg.solve(mass, right)


def test_the_acceleration_is_that_of_the_hand_derived_furuta_equations():
    generator = np.random.default_rng(0)
    for _ in range(50):
        q, v = generator.uniform(-4, 4, 2), generator.uniform(-10, 10, 2)
        torque = generator.uniform(-0.05, 0.05)
        found = model().acceleration(jnp.concatenate([q, v]), jnp.array([torque]))
        np.testing.assert_allclose(found, hand_derived(q, v, torque), rtol=1e-10, atol=1e-10)


def test_the_mass_matrix_is_symmetric_and_positive_definite():
    for alpha in np.linspace(-4, 4, 17):
        mass = np.asarray(model().mass_matrix(jnp.array([0.3, alpha])))
        np.testing.assert_allclose(mass, mass.T)
        assert np.linalg.eigvalsh(mass).min() > 0


def test_energy_is_kept_without_damping_and_input():
    """To 1e-8 of m g l over 10 s at steps of half a millisecond."""
    free = model(b1=0.0, b2=0.0)
    x = tn.rollout(discretise(free, 5e-4), jnp.array([0.1, 0.4, 0.5, -0.3]), jnp.zeros((20_000, 1)))
    energy = np.asarray(jax.vmap(free.energy)(x[::50]))
    p = FURUTA.nominal()
    assert np.abs(energy - energy[0]).max() < 1e-8 * p["mass"] * G * p["centre"]


def test_the_integrator_is_of_fourth_order():
    x0, u = jnp.array([0.2, 2.5, 3.0, 6.0]), jnp.full((5, 1), 0.01)

    def end(substeps: int) -> jax.Array:
        return tn.rollout(discretise(model(), 0.02, substeps), x0, u)[-1]

    exact = end(128)
    errors = np.array([float(jnp.linalg.norm(end(n) - exact)) for n in (4, 8, 16)])
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.abs(orders - 4).max() < 0.2


def test_a_grey_box_model_is_scored_like_any_other():
    t = np.arange(60) * 0.01
    held = np.zeros((60, 1))
    x = np.asarray(
        tn.rollout(discretise(model(), 0.01, 4), jnp.array([0.0, 0.4, 0.0, 0.0]), held[1:])
    )
    e = tn.from_arrays(
        x[:, :2], held, dt=0.01, t=t, v=x[:, 2:],
        coordinates=FURUTA.coordinates, inputs=FURUTA.inputs,
    )  # fmt: skip
    assert tn.evaluate(discretise(model(), 0.01, 4), [e], "file")[0].rmse < 1e-12
    assert tn.evaluate(discretise(model(b2=1e-3), 0.01, 4), [e], "file")[0].rmse > 1e-3


def test_a_nominal_value_outside_its_range_is_refused():
    with pytest.raises(
        tn.InputError, match=r"parameter 'mass': nominal value 2 kg; expected .*0\.\.1"
    ):
        Parameter("mass", "kg", 2.0, 0.0, 1.0)


def test_meaningless_steps_are_refused():
    with pytest.raises(tn.InputError, match="discretise"):
        discretise(model(), 0.01, 0)
