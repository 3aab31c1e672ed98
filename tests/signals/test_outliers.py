"""Jumps of positions and spikes of inputs."""

import numpy as np
import pytest
import scipy.ndimage

from tustinnet.signals.outliers import _rank_filter, find_jumps, find_spikes

DT = 0.01
COUNT = 2 * np.pi / 4096
T = np.arange(2000) * DT
SWING = np.exp(-0.3 * T) * np.cos(6 * T)


def found(q: np.ndarray, count: float = 0.0) -> list[int]:
    q = np.round(q / count) * count if count else q
    return find_jumps(np.arange(len(q)) * DT, q, count).tolist()


def bouncing() -> np.ndarray:
    """A ball's height; it bounces until it lies."""
    height, speed, seen = 1.0, 0.0, []
    for k in range(2000 * 20):
        speed -= 9.81 * DT / 20
        height += speed * DT / 20
        if height < 0:
            height, speed = -height, -0.8 * speed
        if k % 20 == 0:
            seen.append(height)
    return np.array(seen)


SOUND = {
    "a swing": SWING,
    "a ramp": 3 * T,
    "fast rotation": 60 * T,
    "a release in the middle": np.where(T < 5, 1.0, np.cos(6 * np.maximum(T - 5, 0))),
    "impacts": bouncing(),
    "stick and slip": np.cumsum(0.01 * (np.sin(T) > 0.9)),
    "white noise": np.random.default_rng(0).normal(size=2000),
    "a random walk": np.cumsum(np.random.default_rng(1).normal(size=2000)),
    "noise of the sensor": SWING + 1e-3 * np.random.default_rng(2).normal(size=2000),
    "a log three times as fast as its sensor": np.repeat(SWING[::3], 3),
    "a log nine times as fast as its sensor": np.repeat(SWING[::9], 9),
    "four samples": np.array([0.0, 1.0, 0.0, 5.0]),
}


@pytest.mark.parametrize("count", [0.0, COUNT])
@pytest.mark.parametrize("name", SOUND)
def test_no_motion_is_a_jump(name: str, count: float) -> None:
    assert found(SOUND[name], count) == []


@pytest.mark.parametrize("samples", [60, 2000])
@pytest.mark.parametrize("size", [0.3, 1000.0, -1000.0])
@pytest.mark.parametrize("count", [0.0, COUNT])
def test_bad_rows_and_lost_counts_are_jumps(samples: int, size: float, count: float) -> None:
    there_and_back, stays = SWING[:samples].copy(), SWING[:samples].copy()
    there_and_back[33] += size
    stays[33:] += size
    assert found(there_and_back, count) == [33, 34]
    assert found(stays, count) == [33]


def test_jumps_at_rest_and_at_the_ends_are_found() -> None:
    still = np.zeros(500)
    still[200:] += 6 * COUNT
    assert found(still, COUNT) == [200]
    first, last = SWING.copy(), SWING.copy()
    first[0], last[-1] = 0.0, 5.0
    assert found(first, COUNT) == [1]
    assert found(last, COUNT) == [len(T) - 1]


def test_a_gap_in_time_is_no_jump() -> None:
    t, q = np.delete(T, slice(700, 720)), np.delete(SWING, slice(700, 720))
    assert find_jumps(t, q, 0.0).tolist() == []


@pytest.mark.parametrize(
    "u",
    [
        np.random.default_rng(0).normal(size=60),
        np.random.default_rng(0).standard_t(3, size=2000),
        (np.arange(60) > 30) * 5.0,
        (np.arange(60) == 30) * 5.0,
        np.sign(np.sin(T)),
        np.sin(T**2),
        np.zeros(10),
        np.array([1.0]),
    ],
)
def test_no_excitation_has_spikes(u: np.ndarray) -> None:
    assert find_spikes(u).tolist() == []


@pytest.mark.parametrize("samples", [60, 2000])
def test_a_spike_is_huge_and_short(samples: int) -> None:
    u = np.random.default_rng(0).normal(size=samples)
    u[17] = 1000.0
    assert find_spikes(u).tolist() == [17]
    u[40:42] = -500.0
    assert find_spikes(u).tolist() == [17, 40, 41]
    u[50:53] = 500.0
    assert find_spikes(u).tolist() == []


@pytest.mark.parametrize("n", [5, 6, 12, 40, 25_001])
@pytest.mark.parametrize(("width", "rank"), [(5, 2), (11, 10), (31, 24)])
def test_the_rank_filter_is_that_of_scipy(n, width, rank):
    x = np.random.default_rng(0).normal(size=n).round(1)
    expected = scipy.ndimage.rank_filter(x, rank, width, mode="mirror")
    np.testing.assert_array_equal(_rank_filter(x, width, rank), expected)
