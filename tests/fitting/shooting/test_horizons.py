"""How long a record can be simulated before errors have grown."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, SWING, TRUTH, noises, simulated

import tustinnet as tn
from tustinnet.fitting.shooting.horizons import find_horizons, steps_before_growth
from tustinnet.fitting.shooting.space import make_search_space


def test_errors_about_an_unstable_equilibrium_grow_by_their_eigenvalue():
    rate, dt = 8.0, 0.01
    a = np.broadcast_to([[0.0, 1.0], [rate**2, 0.0]], (1000, 2, 2))
    unit = np.array([1.0, rate])
    steps = steps_before_growth(a / unit[:, None] * unit, dt, 5)
    assert steps == pytest.approx(np.log(300) / rate / dt, abs=10)
    assert steps_before_growth(a * [[1.0, 1.0], [-1.0, 1.0]], dt, 5) is None
    assert steps_before_growth(a[:20], dt, 5) is None
    assert steps_before_growth(10 * a, dt, 5) == 10  # half a swing at least


def test_a_record_that_stays_upright_has_a_horizon_and_one_that_swings_has_none():
    space = make_search_space(SWING, {}, {})
    vector = space.to_vector(SWING.nominal() | TRUTH)
    picks = np.zeros((3, 0), int)  # no parameter per group
    top = 0.4 + np.pi  # where the swing's potential is highest
    still = simulated("upright", [top, 0.0], np.zeros(200))
    assert find_horizons(SWING, space, vector, [still], picks[:1], 8) == {}  # nothing holds it
    driven = replace(still, u=1e-3 * np.arange(200.0)[:, None])
    horizons = find_horizons(SWING, space, vector, [driven, *noises()], picks, 8)
    rate = np.sqrt(TRUTH["gravity"] / TRUTH["inertia"]) - TRUTH["damping"] / TRUTH["inertia"] / 2
    assert set(horizons) == {"upright"}
    assert horizons["upright"] * still.dt == pytest.approx(np.log(300) / rate, rel=0.25)


RADIUS = 0.02  # m, of the belt's pulley: coordinates in rad and m have different sizes
BELT = tn.LagrangianSystem(
    name="belt drive",
    coordinates=(tn.Coordinate("motor", "angular"), tn.Coordinate("carriage", "linear")),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        tn.Parameter("inertia", "kg m^2", 5e-4, 1e-5, 1e-1),
        tn.Parameter("mass", "kg", 2.0, 0.1, 10.0),
        tn.Parameter("stiffness", "N/m", 27e3, 1e2, 1e8),  # resonance at 30 Hz
        tn.Parameter("damping", "N s/m", 5.0, 0.0, 100.0),
    ),
    kinetic=lambda q, v, p: (p["inertia"] * v[0] ** 2 + p["mass"] * v[1] ** 2) / 2,
    potential=lambda q, p: p["stiffness"] * (RADIUS * q[0] - q[1]) ** 2 / 2,
    dissipation=lambda q, v, p: jnp.stack([1e-3 * v[0], p["damping"] * v[1]]),
    input_map=lambda q, v, u, p: jnp.stack([u[0], 0.0 * u[0]]),
)
OSCILLATOR = tn.LagrangianSystem(
    name="oscillator",
    coordinates=(tn.Coordinate("x", "linear"),),
    inputs=(tn.Input("force", "N"),),
    parameters=(tn.Parameter("stiffness", "N/m", 100.0, 1.0, 1e4),),
    kinetic=lambda q, v, p: v[0] ** 2 / 2,
    potential=lambda q, p: p["stiffness"] * q[0] ** 2 / 2,
    dissipation=lambda q, v, p: 0.05 * v,
    input_map=lambda q, v, u, p: u,
)
DOUBLE = tn.LagrangianSystem(
    name="double pendulum",
    coordinates=(tn.Coordinate("first", "angular"), tn.Coordinate("second", "angular")),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(tn.Parameter("length", "m", 0.3, 0.1, 1.0),),
    kinetic=lambda q, v, p: (
        p["length"] ** 2 * (v[0] ** 2 + v[1] ** 2 / 2 + v[0] * v[1] * jnp.cos(q[0] - q[1]))
    ),
    potential=lambda q, p: -9.81 * p["length"] * (2 * jnp.cos(q[0]) + jnp.cos(q[1])),
    dissipation=lambda q, v, p: 0.0 * v,
    input_map=lambda q, v, u, p: jnp.stack([0.0 * u[0], 0.0 * u[0]]),
)


def horizon(
    system: tn.LagrangianSystem, q: np.ndarray, dt: float, block: int, **values: float
) -> float | None:
    """The horizon [s] of a record with some motion and an input that changes."""
    e = tn.from_arrays(
        q,
        np.cos(np.arange(len(q))),
        dt=dt,
        coordinates=system.coordinates,
        inputs=system.inputs,
        name="record",
    )
    space = make_search_space(system, {}, {})
    vector = space.to_vector(system.nominal() | values)
    steps = find_horizons(system, space, vector, [e], np.zeros((1, 0), int), block)
    return steps["record"] * dt if steps else None


@pytest.mark.parametrize("block", [20, 40, 160, 500])
@pytest.mark.parametrize("stiffness", [2.7e3, 27e3, 27e5])  # resonances at 10, 30, 300 Hz
def test_a_stable_stiff_plant_has_no_horizon(stiffness, block):
    carriage = 0.25 * np.sin(2 * np.pi * 0.4 * np.arange(0.0, 10.0, 1e-3))  # half a metre
    q = np.stack([carriage / RADIUS, carriage], axis=1)
    assert horizon(BELT, q, 1e-3, block, stiffness=stiffness) is None


def test_a_lightly_damped_oscillator_has_no_horizon():
    t = np.arange(0.0, 60.0, 0.01)
    assert horizon(OSCILLATOR, 0.1 * np.sin(10 * t)[:, None], 0.01, 16) is None


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_noise_may_not_grow_to_a_third_of_the_motion(noise):
    t = DT * np.arange(1000)
    motion = 0.1 * np.sin(5 * t) + noise * 0.1 / np.sqrt(2) * np.random.default_rng(0).normal(
        size=1000
    )
    seconds = horizon(SWING, 0.4 + np.pi + motion[:, None], DT, 2, **TRUTH)
    rate = np.sqrt(TRUTH["gravity"] / TRUTH["inertia"]) - TRUTH["damping"] / TRUTH["inertia"] / 2
    assert seconds == pytest.approx(np.log(0.3 / noise) / rate, abs=0.1)


def test_a_double_pendulum_that_tumbles_has_a_horizon():
    dt = 0.005
    model = tn.discretise(DOUBLE.model({"length": jnp.asarray(0.3)}), dt, 4)
    states = np.asarray(tn.rollout(model, np.array([2.5, 2.0, 0.0, 0.0]), np.zeros((4000, 1))))
    seconds = horizon(DOUBLE, states[:, :2], dt, 40)
    assert seconds is not None
    assert 0.8 <= seconds < 10.0


def test_a_stiff_part_does_not_hide_an_unstable_one():
    rate, resonance, dt = 8.0, 2 * np.pi * 30, 1e-3
    a = np.zeros((3000, 4, 4))
    a[:, :2, :2] = [[0.0, rate], [rate, 0.0]]
    alone = steps_before_growth(a[:, :2, :2], dt, 20)
    # velocities in units that suit the unstable part
    a[:, 2:, 2:] = [[0.0, rate], [-(resonance**2) / rate, 0.0]]
    a[:, 1, 2] = rate
    both = steps_before_growth(a, dt, 20)
    assert alone is not None
    assert both is not None
    assert both == pytest.approx(alone, rel=0.1)


FREE_MASS = tn.LagrangianSystem(
    name="free mass",
    coordinates=(tn.Coordinate("x", "linear"),),
    inputs=(tn.Input("force", "N"),),
    parameters=(tn.Parameter("mass", "kg", 1.0, 0.1, 10.0),),
    kinetic=lambda q, v, p: p["mass"] * v[0] ** 2 / 2,
    potential=lambda q, p: 0.0 * q[0],
    dissipation=lambda q, v, p: 0.0 * v,
    input_map=lambda q, v, u, p: u,
)


def test_a_free_mass_has_no_horizon_however_long_it_is_shaken_and_however_noisy():
    t = np.arange(0.0, 20.0, 0.01)
    noisy = np.sin(20 * t) + 0.1 * np.random.default_rng(0).normal(size=len(t))
    assert horizon(FREE_MASS, noisy[:, None], 0.01, 8) is None
