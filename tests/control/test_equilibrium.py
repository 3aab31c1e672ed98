"""Equilibria under the limits of the inputs, and what is said of them."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example
from linear_machines import LinearMachine, double_integrator

import tustinnet as tn
from tustinnet.control import find_equilibrium
from tustinnet.control.dynamics import recorded_limits
from tustinnet.control.sticking import sticking_distances
from tustinnet.models.added import parse_forces, with_forces
from tustinnet.models.integrate import discretise
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.simulate.range import Range


@pytest.mark.thorough
def test_upright_is_unstable_and_hanging_is_stable():
    model = example("qube")
    up = find_equilibrium(model, {"alpha": 0.0})
    down = find_equilibrium(model, {"alpha": np.pi})
    np.testing.assert_allclose(up.x, 0, atol=1e-9)
    np.testing.assert_allclose(down.x, [0, np.pi, 0, 0], atol=1e-9)
    assert "unstable: alpha doubles in 0.055" in up.stability
    assert down.stability.startswith("stable: alpha is the slowest")
    assert (up.controllable, up.observable) == ("controllable", "observable")
    # the modes are those of the linearised model
    expected = np.linalg.eigvals(tn.linearize(model, up.x, up.u).a)
    found = [m.eigenvalue for m in up.modes]
    assert np.isclose(max(np.abs(expected)), abs(found[0]))


def test_inputs_that_hold_a_position_are_solved_for():
    point = find_equilibrium(example("qube"), {"theta": 0.5, "alpha": 0.0})
    assert point.x[0] == pytest.approx(0.5, abs=1e-6)
    # the voltage's torque is the cable's pull: back EMF is 0 at rest
    pull = 2e-3 * 0.5 - 1e-4 * 0.5**2
    assert abs(point.u[0]) == pytest.approx(pull * 8.4 / 0.042, rel=1e-5)


@pytest.mark.thorough
def test_the_nearest_equilibrium_is_named_where_there_is_none():
    with pytest.raises(tn.InputError, match=r"none at alpha = 0.5 .* nearest one, alpha = "):
        find_equilibrium(example("qube"), {"alpha": 0.5})
    with pytest.raises(tn.InputError, match=r"nearest one, theta = .* voltage = -?2\)"):
        find_equilibrium(example("qube"), {"theta": 40.0}, {"voltage": (-2.0, 2.0)})


@pytest.mark.thorough
def test_a_fitted_model_has_its_equilibrium_beside_the_position():
    class Crooked(LinearMachine):
        def step(self, x, u):
            # the pendulum's upright position, as a fit has it, is 0.03 rad aside
            v = x[1] + 0.01 * (40 * jnp.sin(x[0] - 0.03) + 0.0 * u[0])
            return jnp.stack([x[0] + 0.005 * (x[1] + v), v])

    channels = tn.Channels(
        (tn.Coordinate("alpha", "angular"),), (tn.Input("torque", "N m", None, (-1.0, 1.0)),), 0.01
    )
    model = Crooked(np.eye(2), np.eye(2), channels)
    point = find_equilibrium(model, {"alpha": 0.0})
    assert point.x[0] == pytest.approx(0.03, abs=1e-6)
    assert "not controllable from the inputs: the mode of alpha" in point.controllable
    with pytest.raises(tn.InputError, match=r"nearest one, alpha = 0\.03"):
        find_equilibrium(model, {"alpha": 0.0}, tolerance=0.01)


class Sticky(LinearMachine):
    def step(self, x, u):
        return super().step(x, u - jnp.clip(u, -0.5, 0.5))


@pytest.mark.parametrize("stiffness", [0.0, 2.0])
def test_an_input_inside_its_dead_zone_is_named(stiffness):
    whole = double_integrator()
    a = whole.a - stiffness * whole.b @ np.array([[1.0, 0.1]])
    model = Sticky(a, whole.b, whole.channels)
    point = find_equilibrium(model, {"s": 0.0})
    with pytest.raises(tn.InputError, match="gain of force at 0 N is 0, as inside a dead zone"):
        tn.control.lqr(model, point.x, point.u)


def test_an_equilibrium_beyond_a_dead_zone_is_reached_from_inside_it():
    whole = double_integrator()
    model = Sticky(whole.a - 2 * whole.b @ np.array([[1.0, 0.1]]), whole.b, whole.channels)
    point = find_equilibrium(model, {"s": 0.1})
    assert point.x[0] == pytest.approx(0.1, abs=1e-6)
    assert point.u == pytest.approx(0.5 + 0.2, abs=1e-6)


def test_an_unobservable_mode_is_named_by_its_state():
    # an internal state that nothing shows
    class Hidden(LinearMachine):
        internal = ("hidden",)  # pyright: ignore[reportAssignmentType, reportIncompatibleMethodOverride]

    whole = double_integrator()
    a = np.eye(3)
    a[:2, :2], a[2, 2] = whole.a, 0.9
    model = Hidden(a, np.array([[0.005], [0.1], [0.1]]), whole.channels)
    point = find_equilibrium(model, {"s": 0.0})
    assert "the mode of hidden with the eigenvalue 0.9 (stable)" in point.observable
    assert point.stability == "marginally stable: s stays where it is put"


@pytest.mark.parametrize(
    ("at", "words"),
    [({"beta": 0.0}, "no 'beta' among the coordinates"), ({"alpha": np.nan}, "a finite position")],
)
def test_positions_that_are_none_are_refused(at, words):
    with pytest.raises(tn.InputError, match=words):
        find_equilibrium(example("qube"), at)


def test_inputs_without_limits_are_refused():
    with pytest.raises(tn.InputError, match="input 'voltage': it has no limits"):
        find_equilibrium(example("physics"), {"angle": 0.0})
    with pytest.raises(tn.InputError, match="the smaller one first"):
        find_equilibrium(example("physics"), {"angle": 0.0}, {"voltage": (1.0, -1.0)})
    with pytest.raises(tn.InputError, match="no 'current' among the inputs"):
        find_equilibrium(example("qube"), {"alpha": 0.0}, {"current": (-1.0, 1.0)})


def test_small_machines_are_judged_by_the_size_of_their_motion():
    class Stage(LinearMachine):
        def step(self, x, u):
            v = x[1] + 0.01 * (0.7 * u[0] - 1750 * x[0])
            return jnp.stack([x[0] + 0.01 * v, v])

    channels = tn.Channels(
        (tn.Coordinate("z", "linear"),), (tn.Input("coil", "V", None, (-1.0, 1.0)),), 0.01
    )
    model = Stage(np.eye(2), np.eye(2), channels)
    point = find_equilibrium(model, {"z": 2e-4}, sizes=np.array([1e-3]))
    assert point.x[0] == pytest.approx(2e-4, rel=1e-4)  # it asks for half of the input
    assert find_equilibrium(model, {"z": 2e-4}).x[0] < 1.9e-4  # by 1 m nothing to speak of
    with pytest.raises(tn.InputError, match=r"none at z = 0\.001 .* nearest one, z = 0\.0004"):
        find_equilibrium(model, {"z": 1e-3}, sizes=np.array([1e-3]))


def test_rates_that_depend_on_one_another_stop_no_search():
    class Twins(LinearMachine):
        def step(self, x, u):
            force = u[0] - 4 * x[0]
            v = x[2:] + 0.01 * force * jnp.array([1.0, 2.0])
            return jnp.concatenate([x[:2] + 0.01 * v, v])

    coordinates = (tn.Coordinate("q", "linear"), tn.Coordinate("other", "linear"))
    channels = tn.Channels(coordinates, (tn.Input("u", "N", None, (-4.0, 4.0)),), 0.01)
    model = Twins(np.eye(4), np.zeros((4, 1)), channels)
    assert find_equilibrium(model, {"q": 0.5}).u[0] == pytest.approx(2.0)


def test_dry_friction_holds_up_to_its_share_of_the_feedback():
    class Dry(LinearMachine):
        def step(self, x, u):
            force = u[0] - 0.5 * jnp.tanh(x[1] / 0.01) - 0.3 * x[1]
            v = x[1] + 0.1 * force
            return jnp.stack([x[0] + 0.1 * v, v])

    whole = double_integrator()
    model, zero = Dry(whole.a, whole.b, whole.channels), np.zeros(2)
    ranges = Range(np.array([[-0.5, 0.5], [-1.0, 1.0]]), np.array([[-1.0, 1.0]]))
    held = tn.control.lqr(model, zero, np.zeros(1), range=ranges)
    assert sticking_distances(model, held) == {"s": pytest.approx(0.5 / held.gain[0, 0], rel=0.01)}
    summed = tn.control.lqr(model, zero, np.zeros(1), range=ranges, integral=["s"])
    assert sticking_distances(model, summed) == {}


@pytest.mark.parametrize(
    ("ends", "expected"),
    [((1e-5, 4.0), (0.0, 4.0)), ((-4.0, -0.1), (-4.0, 0.0)), ((3.0, 5.0), (3.0, 5.0))],
)
def test_an_input_that_came_near_0_may_be_off(ends, expected):
    free = replace(double_integrator().channels.inputs[0], limits=None)
    machine = double_integrator()
    model = replace(machine, channels=replace(machine.channels, inputs=(free,)))
    range = Range(np.array([[-0.5, 0.5], [-1.0, 1.0]]), np.array([ends]))
    assert recorded_limits(model, None, range) == {"force": expected}
    assert recorded_limits(model, {"force": (1.0, 2.0)}, range) == {"force": (1.0, 2.0)}


def test_dry_friction_with_a_memory_hides_no_equilibrium():
    system = LagrangianSystem(
        "hung",
        (tn.Coordinate("q", "angular"),),
        (tn.Input("u", "N m", None, (-3.0, 3.0)),),
        (),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
        potential=lambda q, p: -2 * jnp.cos(q[0]),
        input_map=lambda q, v, u, p: u,
    )
    needs = parse_forces(system, ["slip:q"])[0].brought
    parameters = tuple(Parameter(name, "N m", 0.1, 0.0, 9.0) for name in needs)
    rubbing = with_forces(system, ("slip:q",), parameters)
    values = {name: jnp.asarray(x) for name, x in rubbing.nominal().items()}
    point = find_equilibrium(discretise(rubbing.model(values), 0.01, 4), {"q": 1.0})
    assert point.x[0] == pytest.approx(1.0)
    assert point.u[0] == pytest.approx(2 * np.sin(1.0))  # friction could hold a part
