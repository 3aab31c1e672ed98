"""The losses of the paper."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.fitting.recipe import SearchRecipe, StageRecipe
from tustinnet.fitting.residual import Residual, make_residual


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


def stretched(factor: float) -> tn.DataSet:
    """Records of a mass on a spring, in another size."""
    made = []
    for seed, split in enumerate(("train", "train", "validation")):
        u = np.random.default_rng(seed).normal(size=(160, 1))
        q = np.zeros((160, 1))
        for k in range(2, 160):
            q[k] = 1.8 * q[k - 1] - 0.9 * q[k - 2] + 0.01 * u[k - 1]
        made.append(
            tn.from_arrays(
                factor * q,
                u,
                dt=0.02,
                name=f"spring{seed}",
                split=split,
                coordinates=[tn.Coordinate("x", "linear")],
                inputs=[tn.Input("force", "N", "zero-order", is_delay_declared=True)],
            )
        )
    return tn.DataSet("spring", tuple(made))


@pytest.mark.thorough
@pytest.mark.parametrize("scaled", [False, True])
def test_a_training_goes_the_same_way_whatever_the_size_of_the_system(scaled):
    recipe = {
        "name": "sizes",
        "start": "derived-6",
        "model": {"kind": "tustin-net", "hidden": [8]},
        "stages": [
            {
                "name": "one",
                "windows": {"draw": "strided", "length": 20, "step": 5},
                "rate": 1e-2,
                "epochs": 5,
                "batch": 16,
                "clip": 0.05,
                "scaled": scaled,
            }
        ],
    }
    # from a stage of metres to one of micrometres; powers of two, so that not even rounding differs
    large, small = (tn.fit(stretched(f), recipe) for f in (1.0, 2.0**-20))
    nets: list[Any] = [of.model for of in (large, small)]
    for one, other in zip(*(net.network.hidden for net in nets), strict=True):
        np.testing.assert_array_equal(one.weight, other.weight)
    assert large.validation_rmse == pytest.approx(2.0**20 * (small.validation_rmse or 0), rel=1e-6)


def test_a_training_counts_lengths_in_their_spread_an_identification_in_metres():
    records = list(stretched(1.0))[:2]
    spread = np.sqrt(np.mean([e.q.var() for e in records]))
    stage = {
        "name": "one",
        "windows": {"draw": "strided", "length": 20, "step": 5},
        "rate": 1e-2,
        "epochs": 5,
        "batch": 16,
    }
    unit = make_residual(StageRecipe.model_validate(stage), records).unit
    assert unit[0] == unit[1] == 2.0 ** round(np.log2(spread))
    assert make_residual(SearchRecipe(), records).unit[:1] == (1.0,)


def test_a_scaled_training_has_units_that_are_powers_of_two():
    stage = {
        "name": "one",
        "windows": {"draw": "strided", "length": 20, "step": 5},
        "rate": 1e-2,
        "epochs": 5,
        "batch": 16,
        "scaled": True,
    }
    units = make_residual(StageRecipe.model_validate(stage), list(stretched(1.0))[:2]).unit
    assert all(np.log2(units) == np.round(np.log2(units)))
    assert units[0] != units[1]
