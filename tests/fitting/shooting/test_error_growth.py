"""How long a record can be simulated before errors have grown."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import SWING, TRUTH, noises, simulated

from tustinnet.fitting.shooting.error_growth import find_horizons, steps_before_growth
from tustinnet.fitting.shooting.space import make_search_space


def test_errors_about_an_unstable_equilibrium_grow_by_their_eigenvalue():
    rate, dt = 8.0, 0.01
    a = np.broadcast_to([[0.0, 1.0], [rate**2, 0.0]], (1000, 2, 2))
    unit = np.array([1.0, rate])
    steps = steps_before_growth(a / unit[:, None] * unit, dt, 5)
    assert steps == pytest.approx(np.log(1000) / rate / dt, abs=10)
    assert steps_before_growth(a * [[1.0, 1.0], [-1.0, 1.0]], dt, 5) is None
    assert steps_before_growth(a[:20], dt, 5) is None
    assert steps_before_growth(10 * a, dt, 5) == 20  # a swing at least


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
    assert horizons["upright"] * still.dt == pytest.approx(np.log(1000) / rate, rel=0.25)
