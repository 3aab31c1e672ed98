"""Records."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.channels import Hold

DT = 0.02
COUNT = 2e-3


def swing(samples: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of a damped swing."""
    t = np.arange(samples) * DT
    z = np.exp((-0.5 + 6j) * t)
    return np.real(z), np.real((-0.5 + 6j) * z)


def record(
    samples: int = 200, *, hold: Hold = "zero-order", k_bar: int | None = None
) -> tn.Experiment:
    """A swing with an input that changes every fourth sample."""
    q, _ = swing(samples)
    e = tn.from_arrays(
        q,
        np.arange(samples) // 4 % 3,
        dt=DT,
        coordinates=[tn.Coordinate("angle", "angular", COUNT)],
        inputs=[tn.Input("torque", "N m", hold)],
        t=5.0 + np.arange(samples) * DT,
    )
    return replace(e, k_bar=k_bar)


def with_velocities(v: np.ndarray, *, measured: bool = True) -> tn.Experiment:
    q, _ = swing(len(v))
    return tn.from_arrays(q, dt=DT, coordinates={"angle": "angular"}, v=v, v_measured=measured)


# --- what a record must be ---


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("part", "message"),
    [
        ({"q": np.zeros((10, 2))}, r"q has shape \(10, 2\); expected \(10, 1\)"),
        ({"q": np.zeros((9, 1))}, r"q has shape \(9, 1\); expected \(10, 1\)"),
        ({"u": np.zeros((10, 3))}, r"u has shape \(10, 3\); expected \(10, 1\).*inputs"),
        ({"u": np.zeros((12, 1))}, r"u has shape \(12, 1\)"),
        ({"v": np.zeros((10, 2))}, r"v has shape \(10, 2\)"),
        ({"t": np.zeros((10, 1))}, r"t has shape \(10, 1\)"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(part: dict[str, np.ndarray], message: str) -> None:
    with pytest.raises(tn.InputError, match=message):
        replace(record(10), **part)


@pytest.mark.parametrize("attribute", ["t", "q", "u", "v"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_is_refused_with_its_sample(
    attribute: str, value: float
) -> None:
    e = replace(record(10), v=np.ones((10, 1)))
    broken = getattr(e, attribute).copy()
    broken[7] = value
    with pytest.raises(tn.InputError, match=f"experiment: {attribute} is not finite at sample 7"):
        replace(e, **{attribute: broken})


@pytest.mark.parametrize("attribute", ["t", "q", "u", "v"])
def test_a_number_whose_square_overflows_is_refused_with_its_sample(attribute: str) -> None:
    e = replace(record(10), v=np.ones((10, 1)))
    broken = getattr(e, attribute).copy()
    broken[7] = -1e200
    with pytest.raises(tn.InputError, match=rf"{attribute} is -1e\+200 at sample 7; .*at most 1e"):
        replace(e, **{attribute: broken})


def test_a_grid_far_longer_than_the_record_is_refused() -> None:
    e = record(10)
    wild = replace(e, t=np.arange(10) + np.where(np.arange(10) < 6, 0, 1e6))
    with pytest.raises(
        tn.InputError, match=r"experiment, sample 6: a grid of 0\.02 s makes 5e\+07"
    ):
        wild.resample(DT)
    with pytest.raises(tn.InputError, match=r"a grid of 1e-300 s makes"):
        e.resample(1e-300)
    assert len(e.resample(DT / 8)) == 73


@pytest.mark.parametrize(("times", "sample"), [([0, 1, 1, 2], 2), ([0, 1, 2, 1.5], 3)])
def test_times_that_repeat_or_go_back_are_refused_with_their_sample(
    times: list[float], sample: int
) -> None:
    with pytest.raises(tn.InputError, match=f"of sample {sample} does not follow"):
        tn.from_arrays([1.0, 2, 3, 4], t=times, dt=1.0, coordinates={"angle": "angular"})


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_a_period_that_is_no_time_is_refused(dt: float) -> None:
    with pytest.raises(tn.InputError, match="sampling period"):
        tn.from_arrays([1.0, 2], t=[0.0, 1.0], dt=dt, coordinates={"angle": "angular"})


def test_a_single_sample_is_no_record() -> None:
    with pytest.raises(tn.InputError, match="1 sample; expected at least 2"):
        tn.from_arrays([1.0], dt=DT, coordinates={"angle": "angular"})


def test_a_field_that_from_arrays_does_not_take_is_refused_by_name():
    with pytest.raises(TypeError, match="no 'splits'; of a record it takes t, v, v_measured, name"):
        tn.from_arrays([1.0, 2], dt=DT, coordinates={"angle": "angular"}, splits="train")  # pyright: ignore[reportCallIssue]


@pytest.mark.parametrize("k_bar", [-1, 11])
def test_k_bar_outside_the_record_is_refused(k_bar: int) -> None:
    with pytest.raises(tn.InputError, match=f"k_bar {k_bar}; expected a sample index from 0 to 10"):
        record(10, k_bar=k_bar)


def test_arrays_are_read_only_copies() -> None:
    q = np.zeros(10)
    e = tn.from_arrays(
        q, np.zeros(10), v=q, dt=DT, coordinates={"angle": "angular"}, inputs={"voltage": "V"}
    )
    q[3] = 1.0
    assert not e.q.any()
    for array in (e.t, e.q, e.u, e.v):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0  # pyright: ignore[reportOptionalSubscript]


def test_units_follow_the_kind_of_the_coordinate() -> None:
    assert tn.Coordinate("angle", "angular").unit == "rad"
    assert tn.Coordinate("cart", "linear").unit == "m"


# --- parts of a record ---


def test_a_slice_keeps_times_period_transient_and_row_true() -> None:
    e = record(100, k_bar=60)
    part = e[20:80]
    np.testing.assert_array_equal(part.t, e.t[20:80])
    np.testing.assert_array_equal(part.q, e.q[20:80])
    np.testing.assert_array_equal(part.u, e.u[20:80])
    assert (part.dt, part.k_bar, part.first_row) == (DT, 40, 20)
    assert part[5:].first_row == 25


@pytest.mark.parametrize(
    ("part", "k_bar"), [(slice(0, 30), 30), (slice(70, 100), 0), (slice(-50, None), 10)]
)
def test_the_transient_of_a_slice_lies_within_it(part: slice, k_bar: int) -> None:
    assert record(100, k_bar=60)[part].k_bar == k_bar


def test_a_slice_with_a_step_has_the_longer_period() -> None:
    e = record(100, k_bar=61)
    part = e[0:100:4]
    np.testing.assert_array_equal(part.t, e.t[::4])
    np.testing.assert_array_equal(part.u, e.u[::4])
    np.testing.assert_allclose(np.diff(part.t), part.dt)
    assert part.dt == pytest.approx(4 * DT)
    assert part.k_bar == 16  # the first kept sample that is not before sample 61


@pytest.mark.parametrize(("part", "sample"), [(slice(0, 100, 3), 4), (slice(1, 100, 4), 4)])
def test_a_step_that_would_lose_an_input_change_is_refused_with_its_sample(
    part: slice, sample: int
) -> None:
    with pytest.raises(tn.InputError, match=f"input's change at sample {sample}; .*`resample`"):
        record(100)[part]


def test_a_step_that_would_bend_the_ramp_of_a_first_order_hold_is_refused() -> None:
    with pytest.raises(tn.InputError, match="`resample`"):
        record(100, hold="first-order")[::4]


def test_a_slice_backwards_is_refused() -> None:
    with pytest.raises(tn.InputError, match="positive step"):
        record(10)[::-1]


def test_trimming_counts_from_the_first_sample_and_includes_both_ends() -> None:
    e = record(100)
    part = e.trim(0.2, 1.0)
    np.testing.assert_allclose(part.t[[0, -1]] - e.t[0], [0.2, 1.0])
    assert len(part) == 41
    assert len(e.trim()) == 100


def test_trimming_to_nothing_is_refused_with_the_times_there_are() -> None:
    with pytest.raises(tn.InputError, match=r"leaves 0 samples; expected times within 0\.\.1\.98"):
        record(100).trim(50.0)


def test_excluding_a_span_leaves_the_parts_around_it() -> None:
    before, after = record(100, k_bar=90).exclude(30, 40)
    assert (before.name, after.name) == ("experiment[0:30]", "experiment[40:100]")
    assert (len(before), len(after)) == (30, 60)
    assert (after.first_row, after.k_bar, before.k_bar) == (40, 50, 30)


def test_excluding_an_end_leaves_one_part() -> None:
    (only,) = record(100).exclude(0, 10)
    assert only.name == "experiment[10:100]"


@pytest.mark.parametrize("span", [(0, 100), (-5, 10), (90, 101), (20, 20)])
def test_excluding_what_is_not_a_part_is_refused(span: tuple[int, int]) -> None:
    with pytest.raises(tn.InputError, match="excluding samples"):
        record(100).exclude(*span)


# --- another period ---


def test_resampling_gives_a_regular_record_of_the_same_motion() -> None:
    e = record(200)
    fine = e.resample(0.008)
    np.testing.assert_allclose(np.diff(fine.t), 0.008)
    assert (fine.dt, fine.t[0]) == (0.008, e.t[0])
    elapsed = fine.t - fine.t[0]
    truth = np.exp((-0.5 + 6j) * elapsed).real
    np.testing.assert_allclose(fine.q[:, 0], truth, atol=1e-4)


def test_resampling_keeps_the_impulse_of_a_held_input() -> None:
    e = record(200)
    coarse = e.resample(0.05)
    assert coarse.u.sum() * coarse.dt == pytest.approx(e.u.sum() * e.dt, abs=2 * 0.05)
    whole = slice(0, 40)  # 2 s in both
    np.testing.assert_allclose(coarse.u[whole].sum() * 0.05, e.u[:100].sum() * DT, atol=1e-9)


def test_resampling_interpolates_a_first_order_held_input_and_velocities() -> None:
    t = np.arange(50) * DT
    e = tn.from_arrays(
        np.sin(t),
        3 * t,
        v=2 * t,
        dt=DT,
        coordinates={"angle": "angular"},
        inputs=[tn.Input("force", "N", "first-order")],
    )
    fine = e.resample(DT / 3)
    np.testing.assert_allclose(fine.u[:, 0], 3 * fine.t, atol=1e-12)
    assert fine.v is not None
    np.testing.assert_allclose(fine.v[:, 0], 2 * fine.t, atol=1e-12)


@pytest.mark.parametrize("dt", [DT, DT / 2, 2.5 * DT])
def test_resampling_keeps_the_time_at_which_the_transient_ends(dt: float) -> None:
    e = record(200, k_bar=50)
    fine = e.resample(dt)
    assert fine.k_bar is not None
    assert fine.t[fine.k_bar] == pytest.approx(e.t[50], abs=1e-9)


@pytest.mark.parametrize("dt", [DT, DT / 2])
def test_resampling_keeps_a_record_that_never_settles_unsettled(dt: float) -> None:
    fine = record(200, k_bar=200).resample(dt)
    assert fine.k_bar == len(fine)


@pytest.mark.parametrize("dt", [0.0, -0.1, 4.0])
def test_resampling_to_a_period_that_does_not_fit_is_refused(dt: float) -> None:
    with pytest.raises(tn.InputError, match=r"less than 3\.98 s"):
        record(200).resample(dt)


# --- inputs ---


def test_a_zero_order_hold_applies_the_sample_and_a_first_order_hold_the_mean() -> None:
    u = np.array([[1.0, 1.0], [3.0, 3.0], [0.0, 0.0]])
    e = tn.from_arrays(
        [1.0, 2, 3],
        u,
        dt=DT,
        coordinates={"angle": "angular"},
        inputs=[tn.Input("held", "V"), tn.Input("ramp", "V", "first-order")],
    )
    np.testing.assert_array_equal(e.held_inputs, [[1.0, 2.0], [3.0, 1.5]])


def test_a_period_has_a_slope_where_an_input_follows_a_straight_line() -> None:
    u = np.array([[1.0, 1.0], [3.0, 3.0], [0.0, 0.0]])
    e = tn.from_arrays(
        [1.0, 2, 3],
        u,
        dt=DT,
        coordinates={"angle": "angular"},
        inputs=[tn.Input("held", "V"), tn.Input("ramp", "V", "first-order")],
    )
    pieces = e.excitation().pieces
    np.testing.assert_array_equal(pieces, [[[1, 1], [0, 2]], [[3, 3], [0, -3]]])


def test_a_band_limited_input_is_interpolated_once_for_each_timing() -> None:
    u = np.random.default_rng(0).normal(size=60)
    inputs = [tn.Input("torque", "N m", "band-limited")]
    e = tn.from_arrays(np.cumsum(u), u, dt=DT, inputs=inputs, coordinates={"angle": "angular"})
    first = e.excitation()
    assert e.excitation() is first
    late = e.excitation([replace(inputs[0], delay=0.4 * DT)])
    assert np.abs(late.samples - first.samples).max() > 0.1
    again = e.excitation()
    np.testing.assert_array_equal(again.pieces, first.pieces)
    with pytest.raises(ValueError, match="read-only"):
        again.samples[0] = 1.0
    assert e[:30].excitation().samples.shape == (30, 1)


def test_a_record_without_inputs_has_no_excitation() -> None:
    e = tn.from_arrays([1.0, 2, 3], dt=DT, coordinates={"angle": "angular"})
    assert e.excitation().pieces.shape == (2, 1, 0)


def test_a_record_is_forced_where_an_input_changes() -> None:
    assert record().forced
    assert not tn.from_arrays(swing()[0], dt=DT, coordinates={"angle": "angular"}).forced
    constant = tn.from_arrays(
        swing(9)[0], np.full(9, 2.0), dt=DT, coordinates={"a": "angular"}, inputs={"u": "V"}
    )
    assert not constant.forced


# --- velocities ---


def zero_ends(v: np.ndarray) -> np.ndarray:
    v = v.copy()
    v[:2] = v[-3:] = 0
    return v


def at_rest_between(v: np.ndarray) -> np.ndarray:
    v = v.copy()
    v[50:60] = 0
    return v


@pytest.mark.parametrize(
    ("change", "padded"),
    [(zero_ends, (2, 3)), (at_rest_between, (0, 0)), (np.zeros_like, (200, 200))],
)
def test_zero_velocities_at_the_ends_of_a_moving_record_are_padding(
    change: Callable[[np.ndarray], np.ndarray], padded: tuple[int, int]
) -> None:
    assert with_velocities(change(swing()[1])).padded_rows == padded


def test_zero_velocities_while_nothing_moves_are_no_padding() -> None:
    q = np.concatenate([np.zeros(20), swing(100)[0] - 1, np.full(20, 0.5)])
    v = np.concatenate([np.zeros(19), np.ones(102), np.zeros(19)])
    assert tn.from_arrays(q, v=v, dt=DT, coordinates={"a": "angular"}).padded_rows == (0, 0)


@settings(max_examples=30, deadline=None)
@given(
    noise=st.sampled_from([0.0, 1e-6, 1e-4, 1e-3]),
    rest=st.integers(2, 400),
    moves=st.booleans(),
    seed=st.integers(0, 10),
)
def test_readings_that_flicker_at_rest_are_no_padding(
    noise: float, rest: int, moves: bool, seed: int
) -> None:
    rng, t = np.random.default_rng(seed), np.arange(300) * DT
    q = np.concatenate([np.zeros(rest), moves * (1 - np.cos(2 * t))])
    v = np.concatenate([np.zeros(rest), moves * 2 * np.sin(2 * t)])
    q += noise * rng.normal(size=len(q))
    e = tn.from_arrays(q, v=v, v_measured=True, dt=DT, coordinates={"a": "angular"})
    assert e.padded_rows == (0, 0)
    np.testing.assert_array_equal(e.velocities()[:, 0], v)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_zeros_of_velocities_while_an_arm_creeps_on_are_padding(noise: float) -> None:
    t = np.arange(400) * DT
    q, v = np.sin(2 * t), 2 * np.cos(2 * t)
    v[:60] = 0.0
    q = q + noise * np.random.default_rng(0).normal(size=400)
    assert tn.from_arrays(q, v=v, dt=DT, coordinates={"a": "angular"}).padded_rows == (60, 0)


def test_a_release_from_rest_is_no_padding() -> None:
    t = np.arange(100) * DT
    e = tn.from_arrays(np.cos(6 * t), v=-6 * np.sin(6 * t), dt=DT, coordinates={"a": "angular"})
    assert e.v is not None
    assert e.v[0, 0] == 0
    assert e.padded_rows == (0, 0)


def test_auto_takes_measured_velocities_from_the_file() -> None:
    _, v = swing()
    np.testing.assert_array_equal(with_velocities(v).velocities()[:, 0], v)


@pytest.mark.parametrize("measured", [True, False])
def test_auto_takes_the_stencil_where_velocities_are_padded_or_were_not_measured(
    measured: bool,
) -> None:
    v = swing()[1]
    e = with_velocities(zero_ends(v) if measured else v, measured=measured)
    np.testing.assert_array_equal(e.velocities("auto"), e.velocities("stencil"))


def test_file_takes_the_columns_as_they_are() -> None:
    v = zero_ends(swing()[1])
    e = with_velocities(v, measured=False)
    np.testing.assert_array_equal(e.velocities("file")[:, 0], v)


def test_file_without_columns_is_refused() -> None:
    with pytest.raises(tn.InputError, match=r"no velocity columns.*stencil"):
        record().velocities("file")


def test_kalman_uses_the_counts_of_the_coordinates() -> None:
    q, v = swing()
    coordinate = tn.Coordinate("angle", "angular", COUNT)
    e = tn.from_arrays(np.round(q / COUNT) * COUNT, dt=DT, coordinates=[coordinate])
    error = e.velocities("kalman")[:, 0] - v
    assert np.sqrt(np.mean(error**2)) < 0.02
    with pytest.raises(tn.InputError, match="resolution"):
        with_velocities(v).velocities("kalman")


def test_the_text_of_a_record_says_what_it_is() -> None:
    assert repr(record()) == "Experiment('experiment', 200 samples of 0.02 s, angle)"


@pytest.mark.parametrize("hold", ["zero-order", "first-order", "band-limited"])
def test_a_part_of_a_record_has_the_inputs_of_the_record(hold):
    u = np.random.default_rng(0).normal(size=(200, 1))
    voltage = tn.Input("u", "V", hold=hold, delay=0.025)
    q = np.zeros((200, 1))
    e = tn.from_arrays(q, u, dt=0.01, coordinates={"x": "linear"}, inputs=[voltage])
    part = e[60:75][3:9]  # fewer samples than a band-limited input is interpolated from
    whole = e.excitation()
    np.testing.assert_array_equal(part.excitation().samples, whole.samples[63:69])
    np.testing.assert_array_equal(part.excitation().pieces, whole.pieces[63:68])
