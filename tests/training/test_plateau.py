"""The plateau rule against PyTorch's, written out from its documentation."""

import pytest

from tustinnet.training.plateau import Plateau, after_epoch
from tustinnet.training.recipe import PlateauRecipe

RULE = PlateauRecipe(factor=0.5, patience=2)


def rates(figures: list[float], rule: PlateauRecipe | None = RULE) -> list[float]:
    state, seen = Plateau(rate=1.0), []
    for figure in figures:
        state = after_epoch(state, figure, rule)
        seen.append(state.rate)
    return seen


def test_the_rate_falls_after_patience_plus_one_bad_epochs():
    assert rates([1.0, 1.0, 1.0, 1.0]) == [1.0, 1.0, 1.0, 0.5]


def test_the_count_begins_again_after_a_reduction():
    assert rates([1.0] * 7) == [1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.25]


def test_an_improvement_resets_the_count():
    assert rates([1.0, 1.0, 1.0, 0.9, 0.9, 0.9]) == [1.0] * 6


@pytest.mark.parametrize(("figure", "counts"), [(0.99995, False), (0.9998, True)])
def test_an_improvement_counts_from_a_relative_ten_thousandth_on(figure, counts):
    state = after_epoch(after_epoch(Plateau(1.0), 1.0, RULE), figure, RULE)
    assert (state.bad_epochs == 0) is counts


def test_a_figure_that_is_not_finite_is_bad():
    assert rates([1.0, float("nan"), float("inf"), float("nan")])[-1] == 0.5


def test_a_change_below_a_hundred_millionth_is_not_made():
    state = after_epoch(Plateau(1e-8, best=1.0, bad_epochs=2), 1.0, RULE)
    assert state.rate == 1e-8


def test_without_a_rule_the_rate_stays():
    assert rates([1.0] * 5, None) == [1.0] * 5
