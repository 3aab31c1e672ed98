"""The losses of the paper."""

import jax.numpy as jnp
import numpy as np
import pytest

from tustinnet.fitting.residual import Residual


def loss(difference: list[list[float]], kind: str) -> float:
    """Of an angle and a length."""
    compared = 4 if kind == "state" else 2
    residual = Residual((True, False, False, False)[:compared], (1.0,) * compared)
    target = jnp.ones((len(difference) + 1, 4))
    simulated = target.at[1:].add(jnp.array(difference))
    return float(residual.window_loss(simulated, target))


def test_angles_are_compared_periodically_and_lengths_by_squares():
    assert loss([[2 * np.pi, 0.0, 0.0, 0.0]], "state") == pytest.approx(0.0, abs=1e-12)
    assert loss([[np.pi, 0.0, 0.0, 0.0]], "state") == pytest.approx(4.0)
    assert loss([[0.0, 3.0, 0.0, 0.0]], "state") == pytest.approx(9.0)


def test_periodic_distance_is_the_sum_of_squared_sine_and_cosine_differences():
    a, b = 0.4, 1.9
    expected = (np.cos(a) - np.cos(b)) ** 2 + (np.sin(a) - np.sin(b)) ** 2
    assert loss([[a - b, 0.0, 0.0, 0.0]], "position") == pytest.approx(expected)


def test_velocities_count_in_the_state_loss_only():
    assert loss([[0.0, 0.0, 2.0, 1.0]], "state") == pytest.approx(5.0)
    assert loss([[0.0, 0.0, 2.0, 1.0]], "position") == 0.0


def test_the_loss_is_the_mean_over_the_steps_and_leaves_out_the_given_start():
    assert loss([[0.0, 3.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]], "state") == pytest.approx(4.5)
