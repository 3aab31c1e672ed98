"""Where training windows begin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tustinnet.signals.windows import random_windows, strided_windows

FALLS = [786, 785, 779, 745, 732, 799, 775, 752, 760, 716]
NOISE = [1499, 1500, 1500, 1499, 1500]
PUBLISHED = [*FALLS, *NOISE]  # samples of the paper's training records

lengths = st.lists(st.integers(2, 400), min_size=1, max_size=8)


@pytest.mark.parametrize(
    ("length", "step", "part", "count"),
    [(50, 5, 0.25, 726), (75, 20, 1.0, 709), (50, 5, 1.0, 2879)],
)
def test_the_published_records_give_the_published_numbers_of_windows(
    length: int, step: int, part: float, count: int
) -> None:
    assert len(strided_windows(PUBLISHED, length, step, part)) == count


@given(lengths, st.integers(1, 60), st.integers(1, 30), st.floats(0.05, 1.0))
@settings(deadline=None, max_examples=30)
def test_strided_windows_lie_inside_their_records(
    records: list[int], length: int, step: int, part: float
) -> None:
    windows = strided_windows(records, length, step, part)
    assert (windows[:, 1] >= 0).all()
    assert (windows[:, 1] + length < np.array(records)[windows[:, 0]]).all()


def test_strided_windows_begin_at_the_first_row_and_every_step_from_there() -> None:
    windows = strided_windows([20, 8, 16], length=10, step=4)
    assert windows.tolist() == [[0, 0], [0, 4], [0, 8], [2, 0], [2, 4]]


def test_the_last_possible_window_is_used() -> None:
    assert strided_windows([12], length=10, step=1).tolist() == [[0, 0], [0, 1]]


@pytest.mark.parametrize("records", [[], [10, 3]])
def test_no_record_long_enough_gives_no_strided_windows(records: list[int]) -> None:
    assert strided_windows(records, length=10, step=1).shape == (0, 2)


@given(lengths, st.integers(1, 60), st.integers(0, 1000), st.data())
@settings(deadline=None, max_examples=30)
def test_random_windows_begin_from_2_to_end_minus_2_and_fit(
    records: list[int], length: int, seed: int, data: st.DataObject
) -> None:
    ends = [data.draw(st.integers(0, n)) for n in records]
    windows = random_windows(records, length, 50, np.random.default_rng(seed), ends)
    first, n, end = windows[:, 1], np.array(records)[windows[:, 0]], np.array(ends)[windows[:, 0]]
    assert (first >= 2).all()
    assert (first <= end - 2).all()
    assert (first + length <= n - 2).all()


def test_random_windows_reach_both_ends_of_their_range() -> None:
    first = random_windows([30], 10, 500, np.random.default_rng(0), [14])[:, 1]
    assert (first.min(), first.max()) == (2, 12)
    first = random_windows([30], 10, 500, np.random.default_rng(0))[:, 1]
    assert (first.min(), first.max()) == (2, 18)


def test_random_windows_are_reproducible_for_a_seed() -> None:
    def draw(seed: int) -> np.ndarray:
        return random_windows(PUBLISHED, 50, 100, np.random.default_rng(seed))

    np.testing.assert_array_equal(draw(1), draw(1))
    assert (draw(1) != draw(2)).any()


def test_records_too_short_for_a_random_window_are_left_out() -> None:
    windows = random_windows([13, 300, 14], 10, 200, np.random.default_rng(0))
    assert set(windows[:, 0]) == {1, 2}
    assert set(windows[windows[:, 0] == 2, 1]) == {2}


def test_random_windows_choose_records_evenly_whatever_their_length() -> None:
    record = random_windows([100, 1000], 10, 2000, np.random.default_rng(0))[:, 0]
    assert np.mean(record) == pytest.approx(0.5, abs=0.05)


def test_no_record_long_enough_gives_no_random_windows() -> None:
    assert random_windows([10, 12], 10, 5, np.random.default_rng(0)).shape == (0, 2)
