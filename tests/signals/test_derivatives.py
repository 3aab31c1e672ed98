"""Velocities from positions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tustinnet.errors import InputError
from tustinnet.signals.derivatives import (
    VelocityMethod,
    differentiate,
    five_point_stencil,
    polynomial_fit,
)

DT = 0.01
COUNT = 3e-3

slopes = st.floats(-20, 20)


def quantised_sine(samples: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Positions of a swing as the encoder reads them, and the true velocities."""
    t = np.arange(samples) * DT
    read = np.round(np.sin(5 * t) / COUNT) * COUNT
    return read[:, None], 5 * np.cos(5 * t)[:, None]


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_stencil_is_the_formula_divided_by_twelve_periods() -> None:
    q = np.random.default_rng(0).normal(size=(40, 2))
    by_hand = (q[:-4] - 8 * q[1:-3] + 8 * q[3:-1] - q[4:]) / (12 * DT)
    np.testing.assert_allclose(five_point_stencil(q, DT)[2:-2], by_hand, rtol=1e-12)


@pytest.mark.parametrize("method", ["stencil", "savgol"])
@given(a=slopes, b=slopes, c=slopes, samples=st.integers(7, 30), dt=st.floats(1e-3, 0.5))
@settings(deadline=None, max_examples=30)
def test_parabolas_are_differentiated_exactly_ends_included(
    method: VelocityMethod, a: float, b: float, c: float, samples: int, dt: float
) -> None:
    t = np.arange(samples) * dt
    v = differentiate((a + b * t + c * t**2)[:, None], dt, method)
    # rounding of positions up to |a|, divided by the period
    tolerance = 1e-11 * (1 + abs(a) + np.abs(b * t).max() + np.abs(c * t**2).max()) / dt
    np.testing.assert_allclose(v[:, 0], b + 2 * c * t, atol=tolerance, rtol=0)


def test_the_ends_of_a_moving_record_are_never_zero() -> None:
    v = five_point_stencil(3.0 * np.arange(12.0)[:, None] * DT, DT)
    np.testing.assert_allclose(v, 3.0)


@pytest.mark.parametrize("samples", [5, 6, 7, 8])
def test_savgol_is_exact_for_cubics_on_records_of_any_length(samples: int) -> None:
    t = np.arange(samples) * DT
    v = differentiate((t**3 - 2 * t)[:, None], DT, "savgol")
    np.testing.assert_allclose(v[:, 0], 3 * t**2 - 2, atol=1e-9)


def test_savgol_beats_the_stencil_on_a_quantised_signal() -> None:
    q, v = quantised_sine()
    assert rms(differentiate(q, DT, "savgol") - v) < 0.8 * rms(differentiate(q, DT) - v)


def test_kalman_more_than_halves_the_stencils_error_on_a_quantised_signal() -> None:
    q, v = quantised_sine()
    smoothed = differentiate(q, DT, "kalman", np.array([COUNT]))
    assert rms(smoothed - v) < 0.5 * rms(differentiate(q, DT, "stencil") - v)


def test_kalman_treats_coordinates_apart() -> None:
    q, _ = quantised_sine(200)
    pair = np.concatenate([q, 0.01 * q], axis=1)
    together = differentiate(pair, DT, "kalman", np.array([COUNT, 0.01 * COUNT]))
    for j, count in enumerate((COUNT, 0.01 * COUNT)):
        alone = differentiate(pair[:, [j]], DT, "kalman", np.array([count]))
        np.testing.assert_allclose(together[:, [j]], alone, rtol=1e-6, atol=1e-9)


@pytest.mark.usefixtures("unchecked")
def test_an_unknown_method_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'spline'.*stencil, savgol, kalman, wiener, trapezoidal"):
        differentiate(np.zeros((9, 1)), DT, "spline")  # pyright: ignore[reportArgumentType]


def test_fewer_than_five_samples_are_refused() -> None:
    with pytest.raises(InputError, match="4 samples; expected at least 5"):
        differentiate(np.zeros((4, 1)), DT)


@pytest.mark.parametrize("resolution", [None, np.array([COUNT, 0.0])])
def test_kalman_without_a_count_for_every_coordinate_is_refused(
    resolution: np.ndarray | None,
) -> None:
    with pytest.raises(InputError, match=r"kalman.*counts_per_revolution"):
        differentiate(np.zeros((9, 2)), DT, "kalman", resolution)


@given(
    coefficients=st.lists(st.floats(-5, 5), min_size=2, max_size=4),
    start=st.floats(-100, 100),
    at=st.floats(-0.1, 0.2),
)
@settings(deadline=None, max_examples=30)
def test_a_polynomial_is_recovered_with_value_and_slope(
    coefficients: list[float], start: float, at: float
) -> None:
    truth = np.polynomial.Polynomial(coefficients)
    t = np.linspace(0, 0.1, 9)
    value, slope = polynomial_fit(
        start + t, truth(t)[:, None], len(coefficients) - 1, np.array([start + at])
    )
    np.testing.assert_allclose(value[0, 0], truth(at), atol=1e-8)
    np.testing.assert_allclose(slope[0, 0], truth.deriv()(at), atol=1e-7)


def test_a_polynomial_fit_through_noise_is_the_least_squares_one() -> None:
    t = np.arange(8) * DT
    q = np.random.default_rng(1).normal(size=(8, 1))
    expected = np.polynomial.Polynomial.fit(t, q[:, 0], 2)
    value, slope = polynomial_fit(t, q, 2, at=t[:3])
    np.testing.assert_allclose(value[:, 0], expected(t[:3]), rtol=1e-9)
    np.testing.assert_allclose(slope[:, 0], expected.deriv()(t[:3]), rtol=1e-9)
