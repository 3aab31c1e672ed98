"""Forces that are added to a system by name."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import CART, CREEPING, LAGGING, SWING

import tustinnet as tn
from tustinnet.models import forces
from tustinnet.models.added import parse_forces, with_forces
from tustinnet.models.forces import LAWS
from tustinnet.models.integrate import discretise
from tustinnet.models.lagrangian import LagrangianSystem, Parameter

BARE = LagrangianSystem(
    name="bare",
    coordinates=CART.coordinates,
    inputs=(),
    parameters=CART.parameters,
    kinetic=CART.kinetic,
)
X, V, U = jnp.array([0.4, 0.9]), jnp.array([0.7, -1.1]), jnp.array([2.0])
VALUES = {
    "coulomb": 0.3,
    "breakaway": 0.5,
    "stribeck_speed": 0.8,
    "smooth_speed": 0.1,
    "viscous": 0.2,
    "rubbing": 0.7,
    "spring": 1.5,
    "cubic": 2.5,
    "maxwell": 3.0,
    "relaxation": 4.0,
    "turned": 0.2,
    "lag": 0.5,
    "initial_share": 0.7,
    "constant": 0.4,
    "sticking": 0.6,
    "presliding": 0.4,
    "bristle_damping": 0.3,
    "hysteresis_shape": 0.8,
    "hysteresis_exponent": 2.0,
    "load_friction": 0.2,
    **{f"{law}_{i}": 0.1 * i for law in ("curve", "slip") for i in (1, 2, 3, 4, 5)},
    "slip_travel": 0.4,
    "armature": 0.3,
    "lower_end": 0.1,
    "upper_end": 0.6,
    "stop_stiffness": 2.0,
    "stop_damping": 0.5,
    "dead_zone": 0.4,
}
Z = 0.25  # deflection of a spring that relaxes, or of a friction with memory
LUGRE_RATE = -1.1 - 1.1 * Z * (0.6 / 0.4) / (0.6 + 0.5 * np.exp(-((1.1 / 0.8) ** 2)))
AGAINST = {  # what each law does against the motion of the angle
    "coulomb": forces.coulomb(V[1], 0.3, 0.1),
    "stribeck": forces.stribeck(V[1], 0.3, 0.8, 0.8, 0.1),
    "viscous": 0.2 * V[1],
    "curve": sum(0.1 * i * np.tanh(-11.0 / w) for i, w in enumerate((1, 1, 3, 10, 30, 100))),
    "slip": 0.1 + 0.2 + 0.3 * Z / 0.4 + 0.4 * Z / 1.2 + 0.5 * Z / 4.0,
    "load": forces.coulomb(V[1], 0.2 * jnp.sin(X[1]), 0.1),
    "coulomb_by_position": forces.coulomb(V[1], 0.7 * X[1], 0.1),
    "end_stops": 2.0 * (X[1] - 0.6) * (1 + 0.5 * V[1]),
    "spring": 1.5 * X[1],
    "cubic": 2.5 * X[1] ** 3,
    "constant": 0.4,
    "maxwell": 3.0 * Z,
    "dahl": 0.6 * Z / 0.4,
    "lugre": 0.6 * Z / 0.4 + 0.3 * LUGRE_RATE,
    "bouc_wen": 0.6 * Z / 0.4,
}
# its bearings have Coulomb friction by parameters of their own
RUBBING = replace(
    CART,
    name="rubbing cart",
    parameters=(
        *CART.parameters,
        Parameter("x.coulomb", "N", 0.4, 0.0, 5.0),
        Parameter("x.coulomb_speed", "m/s", 0.05, 0.01, 1.0, fixed=True),
        Parameter("angle.coulomb", "1", 0.4, 0.0, 5.0),
    ),
    dissipation=lambda q, v, p: jnp.stack(
        [
            forces.coulomb(v[0], p["x.coulomb"], p["x.coulomb_speed"]),
            p["angle.coulomb"] * v[1] ** 3,
        ]
    ),
)
WITH_MEMORY = ("maxwell", "dahl", "lugre", "bouc_wen", "slip")


def declared(names: list[str]) -> tuple[Parameter, ...]:
    return tuple(Parameter(n, "", VALUES[n.rpartition(".")[2]], 0.0, 9.0) for n in names)


def added(system: LagrangianSystem, *names: str) -> LagrangianSystem:
    """The system with forces whose values are those above."""
    needs = dict.fromkeys(need for force in parse_forces(system, names) for need in force.brought)
    return with_forces(system, names, declared(list(needs)))


def nominal(system: LagrangianSystem) -> tn.LagrangianModel:
    return system.model({name: jnp.asarray(x) for name, x in system.nominal().items()})


@pytest.mark.thorough
@pytest.mark.parametrize("base", [CART, BARE], ids=lambda s: s.name)
@pytest.mark.parametrize("law", AGAINST)
def test_a_force_acts_on_its_coordinate_alone(base, law):
    if law == "load" and base is BARE:
        with pytest.raises(tn.InputError, match="'load:angle': the system 'bare' has no potential"):
            added(base, f"{law}:angle")
        return
    system = added(base, f"{law}:angle")
    u = U[: len(base.inputs)]
    with_it, without = nominal(system), nominal(base)
    x = jnp.concatenate([X, V, jnp.full(len(system.internal), Z)])
    change = with_it.acceleration(x, u) - without.acceleration(x[:4], u)
    moved = with_it.mass_matrix(X) @ change
    np.testing.assert_allclose(moved, [0.0, -AGAINST[law]], rtol=1e-5, atol=1e-6)
    names = [f"slip:angle:{i}" for i in (1, 2, 3, 4, 5)] if law == "slip" else [f"{law}:angle"]
    assert system.internal == (tuple(names) if law in WITH_MEMORY else ())
    assert system.added_parameters == tuple(f"angle.{p.name}" for p in LAWS[law].parameters)


def test_every_law_at_a_coordinate_is_tried():
    at_coordinates = {name for name, law in LAWS.items() if not law.is_at_input}
    assert {*AGAINST, "armature"} == at_coordinates


@pytest.mark.thorough
@pytest.mark.parametrize("factor", [1.0, -1.0, 0.5])
def test_a_motor_may_turn_with_two_coordinates(factor):
    channel = {1.0: "x+angle", -1.0: "x-angle", 0.5: "x+0.5*angle"}[factor]
    system = added(CART, f"armature:{channel}", f"viscous:{channel}")
    assert system.added_parameters == (f"{channel}.armature", f"{channel}.viscous")
    both, alone, direction = nominal(system), nominal(CART), np.array([1.0, factor])
    more = both.mass_matrix(X) - alone.mass_matrix(X)
    np.testing.assert_allclose(more, 0.3 * np.outer(direction, direction), atol=1e-6)
    x = jnp.concatenate([X, V])
    turning = float(direction @ V)
    energy = float(both.energy(x) - alone.energy(x))
    assert energy == pytest.approx(0.3 * turning**2 / 2, rel=1e-4)
    found = both.mass_matrix(X) @ both.acceleration(x, U)
    wanted = alone.mass_matrix(X) @ alone.acceleration(x, U) - 0.2 * turning * direction
    np.testing.assert_allclose(found, wanted, rtol=1e-4)


def test_what_slips_winds_up_holds_and_is_cut_to_its_travel():
    """Against the definition by hand: z follows the motion and is cut at each sample."""
    base = replace(SWING, input_map=None, inputs=(), potential=None)
    system = added(base, "slip:angle")
    step = eqx.filter_jit(discretise(nominal(system), 0.01).step)
    x, z = jnp.array([0.0, 30.0, 0, 0, 0, 0, 0.0]), np.zeros(5)
    travels = 0.4 * np.array([0.1, 0.3, 1.0, 3.0, 10.0])
    for _ in range(100):
        following = step(x, jnp.zeros(0))
        z = np.clip(z, -travels, travels) + float(following[0] - x[0])
        np.testing.assert_allclose(following[2:], z, atol=1e-4)
        x = following
    # it has turned back: the small elements slip one way, the large ones still hold the other
    assert x[1] < 0
    assert x[2] < 0 < x[6]


def test_ends_of_travel_push_back_and_never_pull():
    ends = forces.end_stops
    assert ends(0.3, 5.0, 0.1, 0.6, 2.0, 0.5) == 0.0
    assert ends(0.7, 1.0, 0.1, 0.6, 2.0, 0.5) == pytest.approx(0.2 * 1.5)
    assert ends(0.0, -1.0, 0.1, 0.6, 2.0, 0.5) == pytest.approx(-0.2 * 1.5)
    assert ends(0.7, -3.0, 0.1, 0.6, 2.0, 0.5) == 0.0, "it leaves faster than the end follows"


def test_within_a_dead_zone_an_input_does_nothing():
    system = nominal(added(CART, "dead_zone"))
    assert system.internal == ()
    assert system.system.added_parameters == ("force.dead_zone",)
    x, plain = jnp.concatenate([X, V]), nominal(CART)
    for u, acts in ((0.3, 0.0), (-0.4, 0.0), (2.0, 1.6), (-1.0, -0.6)):
        found = system.derivative(x, jnp.array([u]))
        np.testing.assert_allclose(found, plain.derivative(x, jnp.array([acts])), rtol=1e-6)
    # of what a lag has reached
    lagging = nominal(added(CART, "lag", "dead_zone"))
    found = lagging.derivative(jnp.concatenate([x, jnp.array([0.3])]), jnp.array([2.0]))
    np.testing.assert_allclose(found[:4], plain.derivative(x, jnp.zeros(1)), rtol=1e-6)
    np.testing.assert_allclose(found[4], (2.0 - 0.3) / 0.5, rtol=1e-6)


@pytest.mark.thorough
def test_behind_a_lag_a_system_moves_by_what_the_actuator_has_reached():
    lagging, plain = nominal(added(CART, "lag")), nominal(CART)
    assert lagging.internal == ("lag:force",)
    assert lagging.system.added_parameters == ("force.lag", "force.initial_share")
    x, reached = jnp.concatenate([X, V]), jnp.array([0.6])
    found = lagging.derivative(jnp.concatenate([x, reached]), U)
    np.testing.assert_allclose(found[:4], plain.derivative(x, reached), rtol=1e-6)
    np.testing.assert_allclose(found[4:], (U - reached) / 0.5, rtol=1e-6)
    np.testing.assert_allclose(lagging.initial_state(x, U)[4:], 0.7 * U, rtol=1e-6)
    np.testing.assert_allclose(lagging.balanced_internal(X, V, U), U, rtol=1e-6)


@pytest.mark.thorough
def test_a_lag_stands_beside_other_memory():
    both, base = added(CREEPING, "lag", "maxwell"), nominal(CREEPING)
    assert both.internal == ("creep", "lag:voltage", "maxwell:angle")
    x, z, reached = jnp.array([0.3, -0.8]), jnp.array([0.2, 2.0, 0.1]), jnp.array([2.0])
    found = nominal(both).derivative(jnp.concatenate([x, z]), jnp.array([1.0]))
    alone = base.derivative(jnp.concatenate([x, z[:1]]), reached)
    alone = alone + jnp.array([0.0, -3.0 * 0.1 / 0.05, 0.0])
    np.testing.assert_allclose(found[:3], alone, rtol=1e-5)
    np.testing.assert_allclose(found[3:], [(1.0 - 2.0) / 0.5, -0.8 - 4.0 * 0.1], rtol=1e-6)
    # what no input drives is left at 0
    balanced = nominal(both).balanced_internal(x[:1], x[1:], reached)
    np.testing.assert_allclose(balanced, [0.0, 2.0, 0.0], atol=1e-6)


@pytest.mark.thorough
def test_a_lag_may_stand_before_an_actuator_of_the_system():
    twice = nominal(added(LAGGING, "lag"))
    x, z, u = jnp.array([0.3, -0.8]), jnp.array([0.5, 1.5]), jnp.array([2.0])
    rate = twice.derivative(jnp.concatenate([x, z]), u)[2:]
    np.testing.assert_allclose(rate, [(1.5 - 0.5) / 0.05, (2.0 - 1.5) / 0.5], rtol=1e-5)
    np.testing.assert_allclose(twice.initial_state(x, u)[2:], [0.8 * 1.4, 1.4], rtol=1e-6)
    np.testing.assert_allclose(twice.balanced_internal(x[:1], x[1:], u), [2.0, 2.0], rtol=1e-5)


def test_the_spring_that_relaxes_follows_its_coordinate():
    system = added(CART, "maxwell")
    assert system.internal == ("maxwell:x", "maxwell:angle")
    x = jnp.concatenate([X, V, jnp.array([0.1, 0.2])])
    rate = nominal(system).derivative(x, U)[4:]
    np.testing.assert_allclose(rate, V - 4.0 * jnp.array([0.1, 0.2]), rtol=1e-6)


def test_a_system_that_remembers_keeps_its_memory_beside_the_added_one():
    both = added(CREEPING, "maxwell", "viscous")
    assert both.internal == ("creep", "maxwell:angle")
    x, u = jnp.array([0.3, -0.8, 0.2, 0.1]), jnp.array([1.0])
    found, alone = nominal(both).derivative(x, u), nominal(CREEPING).derivative(x[:3], u)
    inertia = 0.05
    pulled = (-3.0 * 0.1 - 0.2 * -0.8) / inertia
    np.testing.assert_allclose(found[:3], alone + jnp.array([0.0, pulled, 0.0]), rtol=1e-5)
    np.testing.assert_allclose(found[3], -0.8 - 4.0 * 0.1, rtol=1e-6)


def test_a_law_without_a_coordinate_is_one_at_each():
    system = added(CART, "coulomb", "spring:x")
    assert system.added == ("coulomb:x", "coulomb:angle", "spring:x")
    assert list(system.nominal()) == [
        "mass",
        "x.coulomb",
        "x.smooth_speed",
        "angle.coulomb",
        "angle.smooth_speed",
        "x.spring",
    ]


@pytest.mark.thorough
def test_dry_frictions_of_a_coordinate_share_the_speed_at_which_they_turn():
    system = added(SWING, "coulomb", "coulomb_by_position")
    assert system.added_parameters == ("angle.coulomb", "angle.smooth_speed", "angle.rubbing")
    laws = ("coulomb", "coulomb_by_position")
    both, each = nominal(system), [nominal(added(SWING, law)) for law in laws]
    x, u = jnp.array([0.9, 0.05]), jnp.array([1.0])
    alone = nominal(SWING).acceleration(x, u)
    wanted = sum(model.acceleration(x, u) - alone for model in each)
    np.testing.assert_allclose(both.acceleration(x, u) - alone, wanted, rtol=1e-4)


def test_without_forces_a_system_is_the_same_and_with_the_same_forces_one():
    assert with_forces(CART, (), ()) is CART
    assert added(CART, "cubic") is added(CART, "cubic")


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["glue"], "no force 'glue'; expected one of viscous, coulomb, stribeck, curve, load"),
        (["cubic:tilt"], "'cubic:tilt': no coordinate 'tilt'; expected one of x, angle"),
        (["cubic:"], "'cubic:': no coordinate ''"),
        (["cubic", "cubic:x"], "'cubic:x' twice"),
        (
            ["coulomb:x", "stribeck:x"],
            "'stribeck:x' brings 'x.coulomb', which 'coulomb:x' has already",
        ),
        (["lag:x"], "'lag:x': no input 'x'; expected one of force"),
        (["lag", "lag:force"], "'lag:force' twice"),
    ],
)
def test_what_cannot_be_added_is_refused_by_name(names, told):
    with pytest.raises(tn.InputError) as refused:
        added(CART, *names)
    assert told in " ".join(str(refused.value).split())


def test_a_lag_requires_an_input():
    with pytest.raises(tn.InputError, match="'lag': the system has no inputs"):
        added(BARE, "lag")


def test_a_force_that_a_system_has_already_is_refused():
    once = added(SWING, "viscous")
    told = "'viscous:angle' brings 'angle.viscous', which the system 'swing' has already"
    with pytest.raises(tn.InputError, match=told):
        added(once, "viscous")


def test_friction_adds_to_the_level_that_a_system_has_itself():
    system = added(RUBBING, "stribeck:x", "load:x")
    assert system.added_parameters == ("x.breakaway", "x.stribeck_speed", "x.load_friction")
    assert system.dissipation is not None
    assert RUBBING.potential is not None
    values = system.nominal()
    for speed in (0.02, -0.3, 2.0):
        v = jnp.array([speed, 0.0])
        stribeck = forces.stribeck(v[0], 0.4, 0.4 + 0.5, 0.8, 0.05)
        found = system.dissipation(X, v, values)
        load = jax.grad(RUBBING.potential)(X, values)[0]
        by_load = forces.coulomb_by_load(load, v[0], 0.2, 0.05)
        np.testing.assert_allclose(found, [stribeck + by_load, 0.0], rtol=1e-5)
    # added to what it has already
    assert with_forces(RUBBING, system.added, system.parameters[-3:]) is system
    assert parse_forces(system, system.added) == parse_forces(RUBBING, system.added)


def test_a_width_alone_is_no_friction_of_the_system():
    width = Parameter("x.coulomb_speed", "m/s", 0.05, 0.01, 1.0, fixed=True)
    (load,) = parse_forces(replace(CART, parameters=(*CART.parameters, width)), ["load:x"])
    assert load.parameter_names[-1] == "x.smooth_speed"
    assert load.own == ()


def test_what_is_called_a_level_and_is_none_is_refused():
    told = "'stribeck:angle' adds to a Coulomb friction of the level 'angle.coulomb', and that of"
    with pytest.raises(tn.InputError, match=told):
        added(RUBBING, "stribeck:angle")
    with pytest.raises(tn.InputError, match=r"'coulomb:x' brings 'x\.coulomb', which the system"):
        added(RUBBING, "coulomb:x")
    once = added(CART, "coulomb:x")
    with pytest.raises(tn.InputError, match=r"'stribeck:x' brings 'x\.coulomb', which the system"):
        added(once, "stribeck:x")


@pytest.mark.thorough
@pytest.mark.parametrize(
    # laws that share parameters exclude one another
    "laws",
    [
        [n for n in LAWS if n not in ("coulomb", "dahl", "lugre", "bouc_wen")],
        ["dahl"],
        ["lugre"],
        ["bouc_wen"],
    ],
    ids="-".join,
)
def test_forces_have_derivatives_at_rest(laws):
    system = added(CART, *laws)
    model = nominal(system)
    at_rest = jnp.zeros(model.state_size)
    slope = jax.jacfwd(model.derivative)(at_rest, U)
    assert np.isfinite(slope).all()
