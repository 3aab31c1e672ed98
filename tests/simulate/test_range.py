"""Where records lie, told by model files."""

import numpy as np
import pytest
from every_family import example
from swinging import noises, records

import tustinnet as tn
from tustinnet.simulate.range import Range, join_ranges, recorded_range, training_support
from tustinnet.systems.qube_servo2_twin import twin


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["physics", "linear", "committee"])
def test_positions_velocities_internal_states_and_inputs_are_told(name):
    model = example(name)
    result = recorded_range(model, records())
    known = np.concatenate([e.measured_states() for e in records()])
    np.testing.assert_array_equal(result.states[:2], np.stack([known.min(0), known.max(0)], axis=1))
    assert (result.states[2:, 0] <= 0).all()  # internal states begin at 0
    assert (result.states[2:, 1] >= 0).all()
    again = Range.from_header({"range": result.as_header()}, model)
    assert again is not None
    np.testing.assert_array_equal(again.states, result.states)
    np.testing.assert_array_equal(again.inputs, result.inputs)
    assert again.recorded_states is not None
    assert 50 < len(again.recorded_states) <= 200
    assert (again.recorded_states[:, None] == known).all(axis=2).any(axis=1).all()


def test_internal_states_of_models_side_by_side_follow_one_another():
    members = [example("physics"), example("network taps"), example("linear")]
    both = join_ranges([recorded_range(m, records()) for m in members], members[0].channels)
    together = recorded_range(tn.committee(members), records())
    np.testing.assert_allclose(both.states, together.states, rtol=1e-6)
    np.testing.assert_array_equal(both.inputs, together.inputs)
    assert both.recorded_states is not None
    assert together.recorded_states is not None
    np.testing.assert_array_equal(both.recorded_states, together.recorded_states)
    parts = [recorded_range(members[0], [e]) for e in noises()]
    wider = join_ranges(parts, members[0].channels)
    np.testing.assert_array_equal(wider.inputs, recorded_range(members[0], noises()).inputs)


def test_what_is_not_told_or_no_number_is_unknown():
    model = example("network taps")
    assert Range.from_header({}, model) is None
    diverged = {"states": [[0.0, 1.0], [None, None]], "inputs": [[0.0, 1.0]]}
    assert Range.from_header({"range": diverged}, model) is None


@pytest.mark.parametrize("header", [5, {}, {"states": [[0, 1]], "inputs": [[0, 1]]}])
def test_what_is_no_range_of_the_model_is_refused(header):
    with pytest.raises(tn.InputError, match=r"range: no range of the model.* 2 states and 1 input"):
        Range.from_header({"range": header}, example("network taps"))


def driven(model: tn.Model, u: np.ndarray, x0: np.ndarray) -> np.ndarray:
    return np.asarray(tn.rollout(model, x0, u))


@pytest.mark.thorough
def test_free_runs_that_leave_the_records_are_told_and_others_are_not():
    data, model = twin(), example("qube")
    known = recorded_range(model, [e for e in data if e.split == "train"])
    t, rest = np.arange(600) * model.dt, np.zeros(4)
    high = float(known.inputs[0, 1])
    drives = [
        *(volts * high * np.ones((600, 1)) for volts in (1.3, -1.3, 2.0, -3.0)),
        *(1.4 * high * np.sin(w * t)[:, None] for w in (0.5, 2.0, 5.0, 9.0, 20.0)),
        # within the recorded voltages, which the recorded noise never held on to for so long
        *(sign * high * np.minimum(t, 1.0)[:, None] for sign in (1.0, -1.0)),
        *(0.95 * high * np.sign(np.sin(w * t))[:, None] for w in (0.5, 1.0, 1.5, 2.0)),
        *(level * high * np.ones((600, 1)) for level in (0.9, 0.95, -0.9, -0.95, 1.0)),
    ]
    assert len(drives) == 20
    for u in drives:
        result = known.extrapolation_point(model.channels, driven(model, u, rest)[:-1], u)
        assert result is not None
        assert 0 <= result.sample < 600
        assert not result.signal or not result.recorded[0] <= result.value <= result.recorded[1]
    alarms = [
        known.extrapolation_point(model.channels, e.measured_states(), e.u)
        for e in data
        if e.split == "test"
    ]
    assert not any(alarms)


def test_an_experiment_that_was_repeated_says_of_no_other_what_is_far():
    generator, t = np.random.default_rng(2), 0.02 * np.arange(500)
    course = np.stack([np.sin(2 * t), 2 * np.cos(2 * t)], axis=1)
    repeated = [
        tn.from_arrays(
            course[:, :1] + 1e-4 * generator.normal(size=(500, 1)),
            np.sin(2 * t + 1)[:, None],
            v=course[:, 1:],
            dt=0.02,
            name=f"r{i}",
            coordinates=[tn.Coordinate("s", "linear")],
            inputs=[tn.Input("force", "N")],
        )
        for i in range(3)
    ]
    channels = repeated[0].channels
    cloud = training_support(channels, repeated)
    ends = np.array([[-1.0, 1.0], [-2.0, 2.0]])
    known = Range(ends, np.array([[-1.0, 1.0]]), cloud)
    u = repeated[0].u
    assert known.extrapolation_point(channels, 0.97 * course, u) is None
    assert known.extrapolation_point(channels, course * [0.2, 1.0], u) is not None


def test_what_leaves_is_named_with_its_value():
    model = example("physics")
    known = recorded_range(model, records())
    calm = records()[0]
    states = np.pad(calm.measured_states(), ((0, 0), (0, 1)))
    assert known.extrapolation_point(model.channels, states, calm.u) is None
    fast = states.copy()
    fast[50:, 1] = 3 * known.states[1, 1]
    result = known.extrapolation_point(model.channels, fast, calm.u)
    assert result is not None
    assert (result.sample, result.signal) == (50, "der_angle")
    assert result.value == pytest.approx(3 * known.states[1, 1])
    turned = states + np.array([2 * np.pi, 0, 0])  # the same angle, a turn on
    assert known.extrapolation_point(model.channels, turned, calm.u) is None
    lost = states.copy()
    lost[20:] = np.nan
    result = known.extrapolation_point(model.channels, lost, calm.u)
    assert result is not None
    assert result.sample == 20
    # fast and far up, which no record of a damped pendulum was
    both = states.copy()
    both[30, :2] = np.pi, 0.99 * known.states[1, 1]
    result = known.extrapolation_point(model.channels, both, calm.u)
    assert result is not None
    assert (result.sample, result.signal) == (30, "")
