"""Inputs between their samples."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.signals.excitation import HALF, DeclaredHold, excitation

BAND = 0.4  # of the sampling rate


def tones(t: np.ndarray) -> np.ndarray:
    """A sum of sines up to `BAND`, at times in periods."""
    f = np.linspace(0.02, BAND, 30)
    phase = np.random.default_rng(0).uniform(0, 2 * np.pi, len(f))
    return np.sin(2 * np.pi * np.multiply.outer(t, f) + phase).sum(axis=-1) / np.sqrt(len(f))


def between(pieces: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Values at parts of every period, (steps, parts), of the first input."""
    return pieces[..., 0] @ np.vander(part, pieces.shape[1], increasing=True).T


def test_held_inputs_keep_their_sample_and_straight_lines_meet_the_next():
    u = np.array([1.0, 4.0, 2.0])[:, None]
    both = excitation(np.hstack([u, u]), ("zero-order", "first-order"), (0.0, 0.0))
    np.testing.assert_array_equal(both.pieces, [[[1, 1], [0, 3]], [[4, 4], [0, -2]]])
    np.testing.assert_array_equal(both.mean, [[1.0, 2.5], [4.0, 3.0]])


@pytest.mark.parametrize("delay", [0.0, 0.37, 2.6, -0.4])
def test_a_band_limited_input_is_known_between_its_samples(delay):
    k, part = np.arange(300), np.linspace(0, 1, 7)
    found = excitation(tones(k)[:, None], ("band-limited",), (delay,))
    inner = slice(HALF + 3, -HALF - 3)
    exact = tones(k[:-1, None] + part - delay)
    assert np.abs(between(found.pieces, part) - exact)[inner].max() < 4e-4
    np.testing.assert_allclose(found.samples[inner, 0], tones(k - delay)[inner], atol=4e-4)


def test_its_ends_are_nearly_as_good():
    """Linear prediction goes on where the record ends; a mirrored record would err by a third."""
    k, part = np.arange(600), np.linspace(0, 1, 7)
    found = between(excitation(tones(k)[:, None], ("band-limited",), (0.0,)).pieces, part)
    assert np.abs(found - tones(k[:-1, None] + part)).max() < 0.04


def test_a_constant_stays_one_and_samples_are_met():
    flat = excitation(np.full((40, 1), 3.0), ("band-limited",), (0.3,))
    np.testing.assert_allclose(between(flat.pieces, np.linspace(0, 1, 5)), 3.0, atol=1e-3)
    u = np.random.default_rng(1).normal(size=(50, 1))
    found = excitation(u, ("band-limited",), (0.0,))
    np.testing.assert_allclose(found.pieces[:, 0], u[:-1], atol=1e-12)
    np.testing.assert_allclose(found.pieces.sum(axis=1), u[1:], atol=1e-12)


def test_a_delayed_held_input_keeps_its_impulse():
    u = np.array([0.0, 0, 5, 5, 0, 0, 0])[:, None]
    found = excitation(u, ("zero-order",), (1.25,)).mean[:, 0]
    np.testing.assert_allclose(found, [0, 0, 0, 3.75, 5, 1.25])
    assert excitation(u, ("zero-order",), (0.5,)).mean.sum() == pytest.approx(u.sum())


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.75, 3.0])
def test_a_delayed_held_input_moves_a_mass_as_far_as_the_steps_do(delay: float):
    u = np.random.default_rng(0).normal(size=30)
    pieces = excitation(u[:, None], ("zero-order",), (delay,)).pieces
    fine = 400  # steps in a period, in the middle of which the input changes nowhere
    at = (np.arange(29 * fine) + 0.5) / fine
    true = u[np.maximum(np.floor(at - delay).astype(int), 0)]
    held = between(pieces, (np.arange(fine) + 0.5) / fine).ravel()
    for x in (true, held):
        speed = np.cumsum(x) / fine
        x[:] = np.cumsum(speed - x / 2 / fine) / fine
    np.testing.assert_allclose(held[fine - 1 :: fine], true[fine - 1 :: fine], atol=1e-4)


# --- by records ---


def record(hold: DeclaredHold | str | None, n: int = 40, **of: float) -> tn.Experiment:
    u = np.random.default_rng(2).normal(size=n)
    inputs = [tn.Input("force", "N", hold, **of)]  # type: ignore[arg-type]
    return tn.from_arrays(u, u, dt=0.1, coordinates={"x": "linear"}, inputs=inputs, name="push")


def test_a_record_too_short_to_interpolate_is_refused():
    assert record("band-limited", HALF + 1).excitation().pieces.shape == (HALF, 8, 1)
    with pytest.raises(tn.InputError, match=r"push, input 'force': hold 'band-limited' and 16 sa"):
        record("band-limited", HALF).excitation()


def test_a_delay_longer_than_the_record_is_refused():
    with pytest.raises(tn.InputError, match=r"push, input 'force': a delay of 4 s; .* 3\.9 s"):
        record(None, delay=4.0).excitation()


def test_an_unknown_hold_is_refused_where_one_is_needed_and_taken_from_the_model():
    unknown = record("unknown")
    with pytest.raises(tn.InputError, match=r"push, input 'force': hold 'unknown', and simulating"):
        unknown.excitation()
    with pytest.raises(tn.InputError, match="hold 'unknown', and resampling"):
        unknown.resample(0.2)
    found = unknown.excitation([tn.Input("force", "N", "first-order", delay=0.05)])
    expected = record("first-order", delay=0.05).excitation()
    np.testing.assert_array_equal(found.pieces, expected.pieces)


def test_the_record_s_hold_counts_where_both_say_one():
    found = record("first-order").with_timing([tn.Input("force", "N", "zero-order")])
    assert found.inputs[0].hold == "first-order"
