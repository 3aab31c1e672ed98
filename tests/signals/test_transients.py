"""Where the transient of a record ends."""

import numpy as np
import pytest

from tustinnet.signals.transients import RestThresholds, is_at_rest, rest_thresholds, settling_index

DT = 0.01
NO_COUNT = np.zeros(1)


def decay(rate: float, samples: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of a damped oscillation about 0.4."""
    t = np.arange(samples) * DT
    z = np.exp((-rate + 8j) * t)
    return 0.4 + np.real(z)[:, None], np.real((-rate + 8j) * z)[:, None]


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_damped_oscillation_settles_when_its_envelope_passes_the_threshold(rate: float) -> None:
    q, v = decay(rate)
    k = settling_index(q, v, rest_thresholds(q, v, NO_COUNT, DT))
    # speeds and excursions fall to 5 % of their largest together, half a swing apart at most
    assert k * DT == pytest.approx(np.log(20) / rate, abs=np.pi / 8)


def test_after_the_settling_index_everything_is_at_rest_and_before_it_is_not() -> None:
    q, v = decay(1.0)
    thresholds = rest_thresholds(q, v, NO_COUNT, DT)
    k = settling_index(q, v, thresholds)
    rest = is_at_rest(q, v, thresholds)
    assert rest[k:].all()
    assert not rest[k - 1]


def test_a_record_that_moves_to_its_end_settles_at_its_length() -> None:
    q, v = decay(0.0)
    assert settling_index(q, v, rest_thresholds(q, v, NO_COUNT, DT)) == len(q)


def test_a_record_at_rest_throughout_settles_at_once() -> None:
    thresholds = RestThresholds(np.array([0.1]), np.array([0.1]), np.array([2.0]))
    assert settling_index(np.full((20, 1), 2.01), np.zeros((20, 1)), thresholds) == 0


def test_all_coordinates_must_rest() -> None:
    (slow, slow_v), (fast, fast_v) = decay(0.8), decay(3.0)
    both = np.concatenate([fast, slow], axis=1), np.concatenate([fast_v, slow_v], axis=1)
    together = settling_index(*both, rest_thresholds(*both, np.zeros(2), DT))
    alone = settling_index(slow, slow_v, rest_thresholds(slow, slow_v, NO_COUNT, DT))
    assert together == alone


def test_a_coordinate_that_never_moves_is_at_rest() -> None:
    q, v = decay(1.0)
    still = np.full_like(q, 0.3)
    both = np.concatenate([q, still], axis=1), np.concatenate([v, 0 * v], axis=1)
    alone = settling_index(q, v, rest_thresholds(q, v, NO_COUNT, DT))
    assert settling_index(*both, rest_thresholds(*both, np.zeros(2), DT)) == alone


def test_thresholds_never_fall_below_what_the_encoder_can_tell() -> None:
    q, v = decay(1.0)
    thresholds = rest_thresholds(1e-6 * q, 1e-6 * v, np.array([2e-3]), DT)
    np.testing.assert_allclose(thresholds.excursion, 6e-3)
    np.testing.assert_allclose(thresholds.speed, 6e-3 / (4 * DT))


def test_the_resting_value_is_where_the_record_ends() -> None:
    q, v = decay(2.0)
    np.testing.assert_allclose(rest_thresholds(q, v, NO_COUNT, DT).resting, 0.4, atol=1e-3)
