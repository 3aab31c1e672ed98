"""The coordinates in which parameters are searched for."""

import numpy as np
import pytest
from swinging import CREEPING, SWING, changed

import tustinnet as tn
from tustinnet.fitting.shooting.space import make_search_space

SPACE = make_search_space(CREEPING, {}, {})
VALUES = {"damping": 0.3, "gravity": 0.7, "gain": 0.02, "offset": -0.4}
VALUES |= {"stiffness": 5.0, "relaxation": 0.5}


def test_values_come_back_from_their_vector():
    numbers = SPACE.to_values_in_range(SPACE.to_vector(VALUES))
    assert numbers == pytest.approx(VALUES | {"inertia": 0.05})
    assert SPACE.names == tuple(VALUES)


def test_positive_parameters_are_searched_for_by_logarithms_and_others_in_units_of_their_range():
    vector = SPACE.to_vector(VALUES)
    assert vector[0] == pytest.approx(np.log(0.3))
    assert vector[3] == pytest.approx(-0.4 / 2.0)


def test_slopes_are_those_of_the_values():
    vector = SPACE.to_vector(VALUES)
    step = 1e-6
    for name, slope, way in zip(
        SPACE.names, SPACE.derivatives(vector), np.eye(len(vector)), strict=True
    ):
        above, below = (SPACE.to_values(vector + s * way)[name] for s in (step, -step))
        assert slope == pytest.approx((above - below) / (2 * step), rel=1e-8)


def test_the_box_is_the_parameters_ranges():
    low, high = SPACE.to_values_in_range(SPACE.lower), SPACE.to_values_in_range(SPACE.upper)
    for p in SPACE.free_parameters:
        assert (low[p.name], high[p.name]) == pytest.approx((p.lower, p.upper))
    wild = SPACE.to_vector(VALUES | {"damping": 50.0, "offset": -3.0})
    clipped = SPACE.to_values_in_range(SPACE.clip(wild))
    assert clipped == pytest.approx(VALUES | {"damping": 1.0, "offset": -1.0, "inertia": 0.05})


def test_parameters_at_an_end_of_their_range_are_named_with_the_end():
    vector = SPACE.to_vector(VALUES | {"damping": 1e-3, "offset": 1.0, "gravity": 0.1001})
    assert SPACE.active_bounds(vector) == {"damping": "lower", "offset": "upper"}
    assert SPACE.active_bounds(SPACE.to_vector(VALUES)) == {}


def test_fixed_parameters_keep_the_value_given_or_the_nominal_one():
    space = make_search_space(SWING, {"inertia": 0.1, "gravity": 2.0}, {"gain": 0.3})
    assert space.fixed_values == {"inertia": 0.1, "gain": 0.3}
    assert space.names == ("damping", "gravity")
    assert make_search_space(SWING, {}, {}).fixed_values == {"inertia": 0.05}


UNKNOWN = r"no parameter 'mass'; expected one of inertia, damp"
OUTSIDE = r"'gain': 2 N m/V; expected .* 0\.01\.\.1 N m/V"


@pytest.mark.parametrize(
    ("values", "fixed", "message"),
    [
        ({"mass": 1.0}, {}, UNKNOWN),
        ({}, {"mass": 1.0}, UNKNOWN),
        ({"gain": 2.0}, {}, OUTSIDE),
        ({}, {"gain": 2.0}, OUTSIDE),
        ({"gain": 0.1}, {"gain": 2.0}, OUTSIDE),
        ({"gain": np.nan}, {}, "'gain': nan"),
    ],
)
def test_values_that_cannot_be_are_refused(values, fixed, message):
    with pytest.raises(tn.InputError, match=message):
        make_search_space(SWING, values, fixed)


def test_nothing_to_search_for_is_refused():
    fixed_damping = changed("damping", fixed=True)
    with pytest.raises(tn.InputError, match="every parameter is fixed; expected at least one"):
        make_search_space(fixed_damping, {}, {"gravity": 1.0, "gain": 0.1})
