"""Forces and elastic energies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tustinnet.models import forces

SPEEDS = jnp.array([-30.0, -0.5, -0.02, 0.0, 0.02, 0.5, 30.0])


def number(value: float) -> jax.Array:
    return jnp.asarray(value)


def coulomb(v):
    return forces.coulomb(v, number(0.3), 0.1)


def stribeck(v):
    return forces.stribeck(v, number(0.3), number(0.8), number(0.5), 0.01)


def motor(voltage: float, speed: float, limit: float = 15.0) -> float:
    constants = {"torque_constant": 0.04, "resistance": 8.0, "back_emf": 0.05}
    return float(forces.dc_motor(number(voltage), number(speed), **constants, limit=limit))


def test_viscous_friction_is_proportional_to_speed():
    found = jax.vmap(lambda v: forces.viscous(v, number(0.2)))(SPEEDS)
    np.testing.assert_allclose(found, 0.2 * np.asarray(SPEEDS))


def test_viscous_friction_takes_a_damping_per_coordinate():
    found = forces.viscous(jnp.array([2.0, -3.0]), jnp.array([0.1, 0.5]))
    np.testing.assert_allclose(found, [0.2, -1.5])


@pytest.mark.thorough
@pytest.mark.parametrize("friction", [coulomb, stribeck])
def test_dry_friction_is_odd_and_smooth_through_rest(friction):
    found = np.asarray(jax.vmap(friction)(SPEEDS))
    np.testing.assert_allclose(found, -found[::-1], atol=1e-15)
    assert friction(number(0.0)) == 0.0
    assert np.isfinite(jax.grad(friction)(number(0.0)))
    assert jax.grad(friction)(number(0.0)) > 0


def test_coulomb_friction_has_76_percent_of_its_level_at_the_speed_of_its_width():
    assert coulomb(number(0.1)) == pytest.approx(0.3 * np.tanh(1.0))
    assert coulomb(number(30.0)) == pytest.approx(0.3)


def test_stribeck_friction_falls_from_breakaway_to_the_level_at_speed():
    assert stribeck(number(0.05)) == pytest.approx(0.8, rel=1e-2)
    assert stribeck(number(0.5)) == pytest.approx(0.3 + 0.5 * np.exp(-1))
    assert stribeck(number(30.0)) == pytest.approx(0.3)


def test_stribeck_friction_without_a_breakaway_of_its_own_is_coulombs():
    same = forces.stribeck(number(0.07), number(0.3), number(0.3), number(0.5), 0.1)
    assert same == pytest.approx(float(coulomb(number(0.07))))


@pytest.mark.parametrize(
    ("energy", "power"),
    [(forces.linear_spring, 1), (forces.quadratic_spring, 2), (forces.cubic_spring, 3)],
)
def test_the_slope_of_a_springs_energy_is_its_force(energy, power):
    for q in (-1.5, -0.2, 0.0, 0.7, 2.0):
        slope = jax.grad(energy)(number(q), number(3.0))
        assert slope == pytest.approx(3.0 * q**power)
    assert energy(number(0.0), number(3.0)) == 0.0


def test_a_quadratic_spring_pulls_to_the_same_side_from_both():
    slope = jax.grad(forces.quadratic_spring)
    assert slope(number(-0.5), number(2.0)) == slope(number(0.5), number(2.0)) > 0


def relaxing(seconds: float, speed: float) -> float:
    """The internal state of a Maxwell element of rate 4 that starts at 0.5."""
    h = 1e-3

    def advance(z, _):
        middle = z + h / 2 * forces.maxwell_rate(number(speed), z, number(4.0))
        return z + h * forces.maxwell_rate(number(speed), middle, number(4.0)), None

    return float(jax.lax.scan(advance, number(0.5), length=round(seconds / h))[0])


def test_a_maxwell_element_that_is_held_relaxes_at_its_rate():
    for seconds in (0.25, 0.5):
        z = relaxing(seconds, 0.0)
        assert z == pytest.approx(0.5 * np.exp(-4.0 * seconds), rel=1e-5)
        force = forces.maxwell_force(number(z), number(3.0))
        assert force == pytest.approx(-3.0 * z)


def test_a_maxwell_element_that_is_pulled_along_is_a_damper():
    z = relaxing(5.0, 0.8)
    force = forces.maxwell_force(number(z), number(3.0))
    assert force == pytest.approx(-(3.0 / 4.0) * 0.8, rel=1e-6)


def test_a_motor_at_standstill_gives_the_torque_of_its_current():
    assert motor(4.0, 0.0) == pytest.approx(0.04 * 4.0 / 8.0)
    assert motor(-4.0, 0.0) == -motor(4.0, 0.0)


def test_a_motor_saturates_at_the_supplys_limit():
    assert motor(40.0, 3.0) == motor(15.0, 3.0) > motor(14.0, 3.0)
    assert motor(-40.0, 3.0) == motor(-15.0, 3.0) < motor(-14.0, 3.0)
    assert motor(40.0, 3.0, np.inf) == pytest.approx(0.04 * (40.0 - 0.15) / 8.0)


def test_back_emf_brakes():
    assert motor(0.0, 10.0) < 0 < motor(0.0, -10.0)
    assert motor(3.0, 3.0 / 0.05) == pytest.approx(0.0, abs=1e-12)


def test_plain_numbers_will_do():
    assert forces.viscous(2.0, 0.25) == 0.5
    assert forces.coulomb(1e3, 0.3, 0.1) == pytest.approx(0.3)
    assert forces.cubic_spring(2.0, 0.5) == 2.0
    assert forces.dc_motor(20.0, 0.0, 0.04, 8.0, 0.05, 15.0) == pytest.approx(0.075)


# --- frictions with memory ---


def slid(rate, speed: float, travel: float) -> float:
    """The internal state of a friction after a travel at steady speed, from 0."""
    steps = 20_000
    period, v = abs(travel / speed) / steps, number(speed)
    move = jax.jit(lambda z: jax.lax.fori_loop(0, steps, lambda _, z: z + period * rate(v, z), z))
    return float(move(number(0.0)))


FRICTIONS = {
    "dahl": lambda v, z: forces.dahl_rate(v, z, 0.3, 30.0),
    "lugre": lambda v, z: forces.lugre_rate(v, z, 0.3, 0.3, 0.5, 30.0),
    "bouc_wen": lambda v, z: forces.bouc_wen_rate(v, z, 0.01, 1.0, 1.0),
}


@pytest.mark.parametrize("name", FRICTIONS)
def test_a_friction_with_memory_approaches_its_level_by_travel_alone(name):
    """Without a Stribeck curve, and with a and n of 1, all of them are Dahl friction."""
    with jax.enable_x64(True):
        for speed, travel in ((2.0, 0.01), (-0.5, -0.02)):
            expected = np.sign(travel) * 0.01 * (1 - np.exp(-abs(travel) / 0.01))
            assert slid(FRICTIONS[name], speed, travel) == pytest.approx(expected, rel=1e-3)
    assert forces.dahl_force(0.01, 30.0) == pytest.approx(-0.3)
    assert forces.bouc_wen_force(0.01, 0.01, 0.3) == pytest.approx(-0.3)


def test_bristles_settle_on_the_stribeck_curve():
    level = 0.3 + 0.5 * np.exp(-1)
    settled = level / 30.0
    rate = forces.lugre_rate(number(0.5), number(settled), 0.3, 0.8, 0.5, 30.0)
    assert float(rate) == pytest.approx(0.0, abs=1e-6)
    assert forces.lugre_force(settled, 0.0, 30.0, 0.2) == pytest.approx(-level)
    assert forces.lugre_force(0.0, 1.5, 30.0, 0.2) == pytest.approx(-0.3)


def test_hysteresis_turns_back_as_stiff_as_its_shape_says():
    d = 0.01
    for shape in (0.5, 1.0, 3.0):
        rate = float(forces.bouc_wen_rate(number(-1.0), number(d), d, shape, 2.0))
        assert rate == pytest.approx(-2 * shape, rel=1e-5)
        assert float(forces.bouc_wen_rate(number(1.0), number(d), d, shape, 2.0)) == pytest.approx(
            0.0, abs=1e-5
        )


def test_hysteresis_has_derivatives_where_it_is_at_rest():
    slopes = jax.grad(lambda x: forces.bouc_wen_rate(x[0], x[1], 0.01, 0.8, x[2]), allow_int=False)(
        jnp.array([0.0, 0.0, 1.5])
    )
    assert np.isfinite(slopes).all()


def test_a_spring_with_backlash_pulls_beyond_the_gap_alone():
    force = jax.grad(lambda q: forces.backlash_spring(q, 200.0, 0.02))
    found = [float(force(number(q))) for q in (-0.05, -0.01, 0.0, 0.02, 0.03)]
    np.testing.assert_allclose(found, [-6.0, 0.0, 0.0, 0.0, 2.0], atol=1e-5)
