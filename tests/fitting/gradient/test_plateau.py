"""How the rate goes down: the plateau rule of PyTorch's documentation, and the cosine."""

import jax.numpy as jnp
import pytest

from tustinnet.fitting.gradient.plateau import Plateau, decay_rate, new_plateau, update_plateau
from tustinnet.fitting.recipe import PlateauRecipe, StageRecipe, WindowRecipe

RULE = PlateauRecipe(factor=0.5, patience=2)


def rates(figures: list[float], rule: PlateauRecipe | None = RULE) -> list[float]:
    state, seen = new_plateau(jnp.array(1.0)), []
    for figure in figures:
        state = update_plateau(state, jnp.array(figure), rule)
        seen.append(float(state.rate))
    return seen


def test_the_rate_falls_after_patience_plus_one_bad_epochs():
    assert rates([1.0, 1.0, 1.0, 1.0]) == [1.0, 1.0, 1.0, 0.5]


def test_the_count_begins_again_after_a_reduction():
    assert rates([1.0] * 7) == [1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.25]


def test_an_improvement_resets_the_count():
    assert rates([1.0, 1.0, 1.0, 0.9, 0.9, 0.9]) == [1.0] * 6


@pytest.mark.parametrize(("figure", "counts"), [(0.99995, False), (0.9998, True)])
def test_an_improvement_counts_from_a_relative_ten_thousandth_on(figure, counts):
    state = update_plateau(new_plateau(jnp.array(1.0)), jnp.array(1.0), RULE)
    state = update_plateau(state, jnp.array(figure), RULE)
    assert (int(state.bad_epochs) == 0) is counts


def test_a_figure_that_is_not_finite_is_bad():
    assert rates([1.0, float("nan"), float("inf"), float("nan")])[-1] == 0.5


def test_a_change_below_a_hundred_millionth_is_not_made():
    state = Plateau(jnp.array(1e-8), jnp.array(1.0), jnp.array(2))
    assert float(update_plateau(state, jnp.array(1.0), RULE).rate) == 1e-8


def test_members_have_schedulers_of_their_own():
    state = new_plateau(jnp.array([1.0, 2.0]))
    for figures in ([1.0, 1.0], [1.0, 0.9], [1.0, 0.8], [1.0, 0.7]):
        state = update_plateau(state, jnp.array(figures), RULE)
    assert state.rate.tolist() == [0.5, 2.0]
    assert state.bad_epochs.tolist() == [0, 0]


def test_without_a_rule_the_rate_stays():
    assert rates([1.0] * 5, None) == [1.0] * 5


@pytest.mark.parametrize(
    ("decay", "expected"), [("cosine", [2.0, 1.5, 0.5]), (None, [2.0, 2.0, 2.0])]
)
def test_a_cosine_goes_from_the_whole_rate_to_nothing(decay, expected):
    windows = WindowRecipe(draw="strided", length=5, count=9)
    stage = StageRecipe(name="one", windows=windows, rate=1.0, epochs=3, batch=4, decay=decay)
    done, epochs = jnp.arange(3), jnp.array(3)
    told = decay_rate(jnp.full(3, 2.0), done, epochs, stage)
    assert told.tolist() == pytest.approx(expected)
