"""Where records lie, told by model files."""

import numpy as np
import pytest
from every_family import example
from swinging import noises, records

import tustinnet as tn
from tustinnet.simulate.range import Range, joined, range_of


@pytest.mark.parametrize("name", ["physics", "linear", "committee"])
def test_positions_velocities_internal_states_and_inputs_are_told(name):
    model = example(name)
    found = range_of(model, records())
    known = np.concatenate([e.measured_states() for e in records()])
    np.testing.assert_array_equal(found.states[:2], np.stack([known.min(0), known.max(0)], axis=1))
    assert (found.states[2:, 0] <= 0).all()  # internal states begin at 0
    assert (found.states[2:, 1] >= 0).all()
    again = Range.from_header({"range": found.as_header()}, model)
    assert again is not None
    np.testing.assert_array_equal(again.states, found.states)
    np.testing.assert_array_equal(again.inputs, found.inputs)


def test_internal_states_of_models_side_by_side_follow_one_another():
    members = [example("physics"), example("network taps"), example("linear")]
    both = joined([range_of(m, records()) for m in members], members[0].channels)
    together = range_of(tn.committee(members), records())
    np.testing.assert_allclose(both.states, together.states, rtol=1e-6)
    np.testing.assert_array_equal(both.inputs, together.inputs)
    parts = [range_of(members[0], [e]) for e in noises()]
    wider = joined(parts, members[0].channels)
    np.testing.assert_array_equal(wider.inputs, range_of(members[0], noises()).inputs)


def test_what_is_not_told_or_no_number_is_unknown():
    model = example("network taps")
    assert Range.from_header({}, model) is None
    diverged = {"states": [[0.0, 1.0], [None, None]], "inputs": [[0.0, 1.0]]}
    assert Range.from_header({"range": diverged}, model) is None


@pytest.mark.parametrize("told", [5, {}, {"states": [[0, 1]], "inputs": [[0, 1]]}])
def test_what_is_no_range_of_the_model_is_refused(told):
    with pytest.raises(tn.InputError, match=r"range: no range of the model.* 2 states and 1 input"):
        Range.from_header({"range": told}, example("network taps"))
