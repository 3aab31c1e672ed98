"""Equations of motion from energies."""

from dataclasses import replace
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.models.integrate import discretise
from tustinnet.models.lagrangian import (
    LagrangianModel,
    LagrangianSystem,
    Memory,
    Parameter,
    solve_positive,
)
from tustinnet.systems import qube_servo2

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
    acceleration = eqx.filter_jit(model().acceleration)
    for _ in range(50):
        q, v = generator.uniform(-4, 4, 2), generator.uniform(-10, 10, 2)
        torque = generator.uniform(-0.05, 0.05)
        found = acceleration(jnp.concatenate([q, v]), jnp.array([torque]))
        np.testing.assert_allclose(found, hand_derived(q, v, torque), rtol=1e-10, atol=1e-10)


def test_the_mass_matrix_is_symmetric_and_positive_definite():
    mass_matrix = eqx.filter_jit(model().mass_matrix)
    for alpha in np.linspace(-4, 4, 17):
        mass = np.asarray(mass_matrix(jnp.array([0.3, alpha])))
        np.testing.assert_allclose(mass, mass.T)
        assert np.linalg.eigvalsh(mass).min() > 0


@pytest.mark.thorough
def test_energy_is_kept_without_damping_and_input():
    """To 1e-8 of m g l over 10 s at steps of half a millisecond."""
    free = model(b1=0.0, b2=0.0)
    x = tn.rollout(discretise(free, 5e-4), jnp.array([0.1, 0.4, 0.5, -0.3]), jnp.zeros((20_000, 1)))
    energy = np.asarray(jax.vmap(free.energy)(x[::50]))
    p = FURUTA.nominal()
    assert np.abs(energy - energy[0]).max() < 1e-8 * p["mass"] * G * p["centre"]


@pytest.mark.thorough
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
        x[:, :2],
        held,
        dt=0.01,
        t=t,
        v=x[:, 2:],
        coordinates=FURUTA.coordinates,
        inputs=FURUTA.inputs,
    )
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


# --- what a system must be ---


def vector(q, v, p):
    return v


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"kinetic": vector}, r"furuta', kinetic: returns shape \(2,\); expected a scalar"),
        ({"potential": lambda q, p: q}, r"potential: returns shape \(2,\); expected a scalar"),
        (
            {"dissipation": lambda q, v, p: p["b1"] * v[0]},
            r"dissipation: returns shape \(\); expected \(2,\)",
        ),
        (
            {"dissipation": lambda q, v, p: jnp.zeros(3)},
            r"dissipation: returns shape \(3,\); expected \(2,\)",
        ),
        (
            {"input_map": lambda q, v, u, p: u},
            r"input_map: returns shape \(1,\); expected \(2,\); .*a value per coordinate",
        ),
        (
            {"memory": Memory(("z",), lambda q, v, z, p: v, lambda q, v, z, p: v)},
            r"memory rate: returns shape \(2,\); expected \(1,\)",
        ),
        (
            {"memory": Memory(("z",), lambda q, v, z, p: z, lambda q, v, z, p: z)},
            r"memory force: returns shape \(1,\); expected \(2,\)",
        ),
    ],
)
def test_a_function_of_the_wrong_shape_is_refused_by_its_name(part, message):
    with pytest.raises(tn.InputError, match=message):
        replace(FURUTA, **part)


def test_a_parameter_that_was_not_declared_is_named():
    with pytest.raises(
        tn.InputError, match=r"furuta', potential: asks for the parameter 'stiffness'; .*arm, len"
    ):
        replace(FURUTA, potential=lambda q, p: p["stiffness"] * q[0] ** 2)


def test_a_function_that_is_not_written_with_jax_is_refused_with_what_to_do():
    with pytest.raises(tn.InputError, match=r"potential: fails with .*jax\.numpy"):
        replace(FURUTA, potential=lambda q, p: np.cos(q[1]).item())


@pytest.mark.parametrize("what", ["parameters", "coordinates", "inputs"])
def test_a_name_that_is_given_twice_is_refused(what):
    listed = getattr(FURUTA, what)
    with pytest.raises(tn.InputError, match=f"two .* '{listed[0].name}'"):
        replace(FURUTA, **{what: (*listed, listed[0])})


def test_a_system_without_coordinates_is_refused():
    with pytest.raises(tn.InputError, match="no coordinates; expected at least one"):
        LagrangianSystem("nothing", (), (), (), kinetic=lambda q, v, p: 0.0)


def test_an_empty_range_is_refused_unless_the_parameter_is_fixed():
    with pytest.raises(tn.InputError, match="parameter 'b': an empty range"):
        Parameter("b", "N m s", 1.0, 1.0, 1.0)
    assert Parameter("b", "N m s", 1.0, 1.0, 1.0, fixed=True).fixed


@pytest.mark.parametrize(("lower", "upper"), [(0.1, np.inf), (-np.inf, 2.0)])
def test_a_range_without_an_end_is_refused(lower, upper):
    with pytest.raises(tn.InputError, match="parameter 'b'"):
        Parameter("b", "N m s", 1.0, lower, upper)


@pytest.mark.parametrize("prior", [0.0, -0.1, np.nan])
def test_a_prior_that_is_no_deviation_is_refused(prior):
    with pytest.raises(tn.InputError, match="parameter 'b': prior"):
        Parameter("b", "N m s", 1.0, 0.5, 2.0, prior=prior)


def test_a_parameter_is_positive_where_all_of_its_range_is():
    assert Parameter("b", "", 1.0, 0.1, 2.0).positive
    assert not Parameter("b", "", 1.0, 0.0, 2.0).positive
    assert not Parameter("b", "", 1.0, -1.0, 2.0).positive


def test_an_unknown_parameter_is_refused_with_the_known_ones():
    assert FURUTA.parameter("mass").unit == "kg"
    with pytest.raises(tn.InputError, match=r"no parameter 'weight'; expected one of arm, length"):
        FURUTA.parameter("weight")


# --- systems of other kinds ---


CART = LagrangianSystem(
    name="cart",
    coordinates=(tn.Coordinate("x", "linear"),),
    inputs=(),
    parameters=(Parameter("mass", "kg", 2.0, 0.1, 10.0),),
    kinetic=lambda q, v, p: p["mass"] * v[0] ** 2 / 2,
)
STICKY_CART = replace(
    CART,
    inputs=(tn.Input("force", "N"),),
    input_map=lambda q, v, u, p: u,
    memory=Memory(
        ("creep", "heat"),
        lambda q, v, z, p: jnp.stack([v[0] - 3.0 * z[0], v[0] ** 2]),
        lambda q, v, z, p: -7.0 * z[:1],
    ),
)


def test_a_body_without_forces_keeps_its_velocity():
    free = LagrangianModel(CART, {"mass": jnp.asarray(2.0)})
    x = jnp.array([0.3, 1.5])
    np.testing.assert_allclose(free.derivative(x, jnp.zeros(0)), [1.5, 0.0])
    assert free.energy(x) == pytest.approx(2.25)
    assert free.internal == ()


def test_memory_adds_states_with_rates_and_a_force():
    sticky = LagrangianModel(STICKY_CART, {"mass": jnp.asarray(2.0)})
    found = sticky.derivative(jnp.array([0.3, 1.5, 0.2, 9.0]), jnp.array([4.0]))
    np.testing.assert_allclose(found, [1.5, (4.0 - 7.0 * 0.2) / 2.0, 1.5 - 3.0 * 0.2, 2.25])
    assert sticky.internal == ("creep", "heat")
    discrete = discretise(sticky, 0.01)
    assert discrete.internal == ("creep", "heat")
    assert discrete.state_size == 4
    assert discretise(model(), 0.01).state_size == 4


def pushed(names: tuple[str, ...], rate, force=lambda q, v, z, p: z[:1], initial=None):
    """A cart that is driven by internal states alone."""
    memory = Memory(names, rate, force, initial)
    return replace(CART, inputs=(tn.Input("force", "N"),), memory=memory)


def test_a_rate_and_a_force_may_take_the_inputs():
    system = pushed(
        ("fan",),
        lambda q, v, z, u, p: (u - z) / 0.25,
        lambda q, v, z, u, p: z * u,
        lambda q, v, u, p: 0.5 * u + q,
    )
    fan = LagrangianModel(system, {"mass": jnp.asarray(2.0)})
    found = fan.derivative(jnp.array([0.3, 1.5, 3.0]), jnp.array([4.0]))
    np.testing.assert_allclose(found, [1.5, 3.0 * 4.0 / 2.0, (4.0 - 3.0) / 0.25])
    begin = jnp.array([0.3, 1.5])
    assert fan.initial_needs_inputs
    np.testing.assert_allclose(fan.initial_state(begin, jnp.array([4.0])), [0.3, 1.5, 2.3])
    np.testing.assert_allclose(fan.initial_state(begin), [0.3, 1.5, 0.3])
    assert not LagrangianModel(STICKY_CART, {"mass": jnp.asarray(2.0)}).initial_needs_inputs


@pytest.mark.parametrize(
    ("names", "rate", "expected"),
    [
        (("a", "b"), lambda q, v, z, u, p: jnp.stack([3.0 * (u[0] - z[0]), z[0] - z[1]]), [2, 2]),
        (("x", "w"), lambda q, v, z, u, p: jnp.stack([z[1], 9.0 * (u[0] - z[0]) - z[1]]), [2, 0]),
        (("creep", "a"), lambda q, v, z, u, p: jnp.stack([v[0] - z[0], u[0] - z[1]]), [0, 2]),
        (("sum",), lambda q, v, z, u, p: u, [0]),
        (("creep",), lambda q, v, z, p: v - z, [0]),
    ],
    ids=["chain", "second order", "beside a spring", "integrator", "without inputs"],
)
def test_states_that_follow_inputs_are_balanced_at_once(names, rate, expected):
    model = LagrangianModel(pushed(names, rate), {"mass": jnp.asarray(2.0)})
    found = model.balanced_internal(jnp.array([0.1]), jnp.array([0.7]), jnp.array([2.0]))
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_memory_of_another_form_is_refused_with_the_forms():
    with pytest.raises(tn.InputError) as refused:
        pushed(("fan",), lambda q, z, p: z)
    told = (
        "system 'cart', memory rate: the arguments (q, z, p); expected (q, v, z, p) or "
        "(q, v, z, u, p); q are positions, v velocities, u inputs, p the parameters by name"
    )
    assert " ".join(str(refused.value).split()) == told


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_positive_definite_systems_of_any_size_are_solved(n):
    generator = np.random.default_rng(n)
    root = generator.normal(size=(n, n))
    matrix, right = root @ root.T + 0.1 * np.eye(n), generator.normal(size=n)
    found = solve_positive(jnp.asarray(matrix), jnp.asarray(right))
    np.testing.assert_allclose(found, np.linalg.solve(matrix, right), rtol=1e-9)


# --- the packaged rotary pendulum ---


def qube_acceleration(q, v, voltage, p):
    """The Qube's acceleration, derived by hand with the arm counted the way the voltage drives."""
    turn, swing, turned = -v[0], v[1], -q[0]
    arm = p["rotor_inertia"] + p["hub_mass"] * p["hub_radius"] ** 2 / 2
    a1 = arm + (p["arm_mass"] / 3 + p["pendulum_mass"]) * p["arm_length"] ** 2
    a2 = p["pendulum_mass"] * p["pendulum_centre"] ** 2 + p["pendulum_inertia"]
    a3 = p["pendulum_mass"] * p["arm_length"] * p["pendulum_centre"]
    s, c = np.sin(q[1]), np.cos(q[1])
    supplied = np.clip(voltage, -15.0, 15.0)
    motor = p["torque_constant"] * (supplied - p["back_emf"] * turn) / p["resistance"]
    cable = p["cable_stiffness"] * turned + p["cable_quadratic"] * turned**2
    friction = p["arm_damping"] * turn
    on_arm = motor - friction - cable - 2 * a2 * s * c * turn * swing + a3 * s * swing**2
    gravity = p["pendulum_mass"] * G * p["pendulum_centre"] * s
    on_pendulum = gravity + a2 * s * c * turn**2 - p["pendulum_damping"] * swing
    mass = np.array([[a1 + a2 * s**2, a3 * c], [a3 * c, a2]])
    return np.linalg.solve(mass, [on_arm, on_pendulum]) * [-1.0, 1.0]


def test_the_packaged_rotary_pendulum_moves_as_derived_by_hand():
    system = qube_servo2.SYSTEM
    generator = np.random.default_rng(1)
    acceleration = jax.jit(lambda x, u, p: LagrangianModel(system, p).acceleration(x, u))
    for _ in range(30):
        p = {b.name: generator.uniform(b.lower, b.upper) for b in system.parameters}
        q, v = generator.uniform(-4, 4, 2), generator.uniform(-20, 20, 2)
        voltage = generator.uniform(-20, 20)
        values = {name: jnp.asarray(value) for name, value in p.items()}
        found = acceleration(jnp.concatenate([q, v]), jnp.array([voltage]), values)
        expected = qube_acceleration(q, v, voltage, p)
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


def test_a_positive_voltage_drives_the_recorded_arm_angle_negative():
    values = {k: jnp.asarray(v) for k, v in qube_servo2.SYSTEM.nominal().items()}
    hanging = jnp.array([0.0, np.pi, 0.0, 0.0])
    at_rest = LagrangianModel(qube_servo2.SYSTEM, values)
    moved = eqx.filter_jit(at_rest.acceleration)(hanging, jnp.array([1.0]))
    assert moved[0] < 0


def test_a_wound_cable_rubs_in_proportion_to_its_deflection():
    rubbing, plain = (
        {k: jnp.asarray(x) for k, x in s.nominal().items()}
        for s in (qube_servo2.WITH_CABLE_FRICTION, qube_servo2.WITH_MEMORY)
    )

    def more(theta: float, speed: float) -> np.ndarray:
        q, v = jnp.array([theta, 3.0]), jnp.array([speed, 0.4])
        found = qube_servo2.damping_and_cable_friction(q, v, rubbing)
        return np.asarray(found - qube_servo2.damping_and_dry_friction(q, v, plain))

    np.testing.assert_allclose(more(1.0, 5.0), [1e-4, 0.0], rtol=1e-3)
    np.testing.assert_allclose(more(-2.0, 5.0), [2e-4, 0.0], rtol=1e-3)
    np.testing.assert_allclose(more(1.0, -5.0), [-1e-4, 0.0], rtol=1e-3)
    assert abs(more(0.0, 5.0)[0]) < 2e-6
    assert tn.load_system("qube-servo2-rubbing") is qube_servo2.WITH_CABLE_FRICTION


def test_a_turned_cable_begins_with_a_part_of_the_arms_angle():
    turned = tn.load_system("qube-servo2-turned")
    assert turned is qube_servo2.WITH_INITIAL_DEFLECTION
    values = {k: jnp.asarray(x) for k, x in turned.nominal().items()}
    begun = turned.model(values | {"cable_turned": jnp.asarray(0.25)}).initial_state(
        jnp.array([2.0, 3.0, 0.1, 0.2])
    )
    np.testing.assert_allclose(begun, [2.0, 3.0, 0.1, 0.2, 0.5])


def test_the_packaged_mass_matrix_is_positive_definite_at_all_corners_of_the_ranges():
    system = qube_servo2.SYSTEM
    names = [
        "rotor_inertia",
        "hub_mass",
        "hub_radius",
        "arm_mass",
        "arm_length",
        "pendulum_mass",
        "pendulum_centre",
        "pendulum_inertia",
    ]
    ranges = [system.parameter(name) for name in names]
    corners = np.array(list(product(*[(p.lower, p.upper) for p in ranges])))

    def smallest(corner, alpha):
        values = {k: jnp.asarray(v) for k, v in system.nominal().items()}
        values |= {name: corner[i] for i, name in enumerate(names)}
        mass = LagrangianModel(system, values).mass_matrix(jnp.array([0.2, alpha]))
        unit = jnp.sqrt(jnp.diag(mass))
        return jnp.linalg.eigvalsh(mass / jnp.outer(unit, unit))[0]

    angles = jnp.linspace(0, np.pi, 9)
    every = jax.vmap(jax.vmap(smallest, (None, 0)), (0, None))
    assert float(jnp.min(jax.jit(every)(jnp.asarray(corners), angles))) > 1e-6
