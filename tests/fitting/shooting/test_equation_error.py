"""First values from the equations of motion on measured motion, and signs that are reversed."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import (
    FAR,
    SWING,
    TRUTH,
    changed,
    noises,
    read_by_encoder,
    records,
    simulated,
    voltage,
)

import tustinnet as tn
from tustinnet.fitting.shooting.equation_error import (
    collect_motion,
    estimate_by_equation_error,
    find_reversed_signs,
)
from tustinnet.fitting.shooting.space import make_search_space

SPACE = make_search_space(SWING, {}, {})
START = SPACE.to_vector(SWING.nominal() | FAR)


def reversed_record(e: tn.Experiment, *, angle: float = 1.0, volts: float = 1.0) -> tn.Experiment:
    assert e.v is not None
    return replace(e, q=angle * e.q, v=angle * e.v, u=volts * e.u)


def test_first_values_are_within_two_percent_on_clean_records():
    vector, unexplained = estimate_by_equation_error(SWING, SPACE, START, collect_motion(records()))
    values = SPACE.to_values_in_range(vector)
    assert values == pytest.approx(TRUTH, rel=0.02)
    assert unexplained.shape == (4,)
    assert unexplained.max() < 1e-3


def test_first_values_are_within_a_few_percent_as_an_encoder_reads():
    read = [read_by_encoder(e) for e in records()]
    values = SPACE.to_values_in_range(
        estimate_by_equation_error(SWING, SPACE, START, collect_motion(read))[0]
    )
    assert values == pytest.approx(TRUTH, rel=0.05)


def test_first_values_keep_to_the_box():
    narrow = changed("gravity", lower=2.0, upper=4.0, nominal=3.0)
    space = make_search_space(narrow, {}, {})
    vector, _ = estimate_by_equation_error(
        narrow, space, space.to_vector(narrow.nominal()), collect_motion(records())
    )
    assert space.active_bounds(vector)["gravity"] == "lower"


def test_first_values_follow_inputs_on_straight_lines():
    ramped = replace(SWING, inputs=(replace(SWING.inputs[0], hold="first-order"),))
    smooth = np.convolve(voltage(230, 3), np.ones(31) / 8, "valid")
    e = simulated("ramps", [0.1, 0.0], smooth, system=ramped)
    values = SPACE.to_values_in_range(
        estimate_by_equation_error(ramped, SPACE, START, collect_motion([e]))[0]
    )
    assert values == pytest.approx(TRUTH, rel=0.05)


def test_windows_lie_within_their_records():
    motion = collect_motion(records())
    ends = np.cumsum([len(e) for e in records()])
    of_begin = np.searchsorted(ends, motion.window_begins, side="right")
    of_end = np.searchsorted(ends, motion.window_begins + motion.quarter_swing - 1, side="right")
    np.testing.assert_array_equal(of_begin, of_end)
    assert set(of_begin) == {0, 1, 2, 3}
    assert len(motion.q) == len(motion.v) == len(motion.u) == 760


def test_a_window_is_a_quarter_of_a_swing():
    period = 2 * np.pi * np.sqrt(TRUTH["inertia"] / TRUTH["gravity"])  # of small swings
    small = simulated("small", [0.6, 0.0], np.zeros(200))
    assert collect_motion([small]).quarter_swing == pytest.approx(period / 4 / small.dt, abs=2)


def test_what_is_left_is_a_share_of_each_records_change_of_momentum():
    """Reversed, the voltage explains what it did not do: only the records that it moved suffer."""
    motion = collect_motion([reversed_record(e, volts=-1.0) for e in records()])
    unexplained = estimate_by_equation_error(SWING, SPACE, START, motion)[1]
    assert unexplained[:2].max() < 1e-3
    assert 0.1 < unexplained[2:].min() < unexplained.max() < 1.0


@pytest.mark.parametrize(
    ("signs", "expected"),
    [({}, ()), ({"volts": -1.0}, (("voltage",),)), ({"angle": -1.0}, (("angle",),))],
)
def test_a_reversed_sign_is_named(signs, expected):
    for experiments in (records(), list(noises())):
        motion = collect_motion([reversed_record(e, **signs) for e in experiments])
        assert find_reversed_signs(SWING, SPACE, START, motion) == expected


def test_a_sign_that_is_reversed_in_one_record_is_not_that_of_the_machine():
    driven = [simulated(f"noise{i}", [0.1, 0.0], voltage(200, i)) for i in range(4)]
    motion = collect_motion([reversed_record(driven[0], volts=-1.0), *driven[1:]])
    assert find_reversed_signs(SWING, SPACE, START, motion) == ()


def test_a_symmetric_system_has_alternatives():
    """Without its tilt the pendulum moves alike when both signs are reversed."""
    level = replace(SWING, potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]))
    experiments = [simulated(f"e{i}", [1.0, 0.0], voltage(200, i), system=level) for i in range(2)]
    motion = collect_motion([reversed_record(e, volts=-1.0) for e in experiments])
    assert find_reversed_signs(level, SPACE, START, motion) == (("angle",), ("voltage",))
