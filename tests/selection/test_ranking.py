"""How candidates compare."""

import math
from dataclasses import replace

import pytest

from tustinnet.evaluate.metrics import mean_and_error
from tustinnet.selection.jobs import FitScore, JobResult
from tustinnet.selection.ranking import (
    CandidateResult,
    find_simplest,
    paired_difference,
    rank,
)


def scores(values: dict[str, float], seed: int = 0) -> FitScore:
    return FitScore(seed, "finished", f"m{seed}", None, {"model-20": values})


def standing(name: str, *folds: dict[str, float]) -> CandidateResult:
    return CandidateResult(name, {i: (scores(values),) for i, values in enumerate(folds)})


def test_seeds_are_averaged_record_by_record():
    of = CandidateResult(
        "a", {0: (scores({"r": 1.0}), scores({"r": 3.0}, 1)), 1: (scores({"s": 5.0}),)}
    )
    assert of.rmse() == {"r": 2.0, "s": 5.0}
    assert of.rmse([0]) == {"r": 2.0}


def test_candidates_are_ranked_by_the_folds_that_all_of_them_have():
    # the second fold is the harder one; only `b` has it
    a, b = standing("a", {"r": 2.0}), standing("b", {"r": 1.0}, {"s": 9.0})
    assert [s.name for s in rank([a, b])] == ["b", "a"]


def test_a_single_record_decides_where_one_is_several_times_as_far_off():
    linear = standing("linear", {"r": 0.06}, {"s": 0.1}, {"t": 0.08})
    physics, chance = standing("physics", {"r": 0.01}), standing("chance", {"r": 0.03})
    assert [s.name for s in rank([linear, physics, chance])] == ["physics", "linear", "chance"]


def test_on_two_records_one_that_is_far_ahead_on_both_is_the_best():
    hybrid = standing("hybrid", {"r": 0.0032, "s": 0.0061}, {"t": 0.0025})
    gru = standing("gru", {"r": 0.0003, "s": 0.0011})
    chance = standing("chance", {"r": 0.0003, "s": 0.0055})  # but not on both
    assert [s.name for s in rank([hybrid, gru, chance])] == ["gru", "hybrid", "chance"]


def test_what_is_before_the_most_scored_one_is_ranked_by_its_own_folds():
    poor = standing("linear", {"r": 1.4, "s": 1.4}, {"t": 1.4}, {"u": 1.4})
    good = standing("mechanism", {"r": 0.7, "s": 0.8}, {"t": 0.6})
    # on its two records as sure as can be, by the linear model; not by the mechanism
    lucky = standing("mechanism + end_stops", {"r": 0.69, "s": 0.7})
    of_poor = [s.name for s in rank([poor, lucky])]
    assert of_poor == [lucky.name, poor.name]
    assert [s.name for s in rank([poor, lucky, good])] == [good.name, lucky.name, poor.name]


def test_those_that_share_no_fold_are_ranked_by_what_each_has():
    a, b = (
        CandidateResult("a", {0: (scores({"r": 2.0}),)}),
        CandidateResult("b", {1: (scores({"s": 1.0}),)}),
    )
    assert [s.name for s in rank([a, b])] == ["b", "a"]


def test_how_far_a_lost_run_is_off_decides_nothing():
    """Of a double pendulum one free run of four left its record, and the others were far better."""
    linear = standing("linear", {"r": 0.12}, {"s": 0.55}, {"t": 0.61}, {"u": 0.16})
    physics = standing("physics", {"r": 0.04}, {"s": 0.04}, {"t": 1.99}, {"u": 0.07})
    assert [s.name for s in rank([linear, physics])] == ["linear", "physics"]
    bounded = [replace(result, lost=0.78) for result in (linear, physics)]
    assert [s.name for s in rank(bounded)] == ["physics", "linear"]
    assert bounded[1].rmse()["t"] == 1.99
    diverged = replace(bounded[1], fits_by_fold=standing("", {"r": math.inf}).fits_by_fold)
    assert diverged.compared() == {"r": math.inf}


def test_what_is_lost_on_every_record_is_not_the_simplest_that_is_as_good():
    lost = replace(standing("a", {"r": 90.0, "s": 80.0}), lost=1.0)
    best = replace(standing("b", {"r": 3.0, "s": 2.0}), lost=1.0)
    assert find_simplest([lost, best], best) is best


def test_a_candidate_that_is_lost_on_every_record_follows_none():
    of = replace(standing("a", {"r": 0.5, "s": math.inf}), lost=1.0)
    assert of.follows_some
    assert not replace(of, lost=0.4).follows_some
    assert not CandidateResult("b").follows_some


def test_what_left_all_bounds_comes_last_and_what_was_not_scored_not_at_all():
    found = rank([standing("a", {"r": math.inf}), standing("b", {"r": 7.0}), CandidateResult("c")])
    assert [s.name for s in found] == ["b", "a"]


def test_differences_are_paired_by_record():
    a = standing("a", {"r": 1.0, "s": 2.0, "t": 4.0})
    b = standing("b", {"r": 2.0, "s": 3.5, "t": 4.0, "u": 100.0})
    found = paired_difference(b, a)
    assert found.records == 3
    assert found.mean == pytest.approx((1 + 1.5 + 0) / 3)
    assert found.standard_error == pytest.approx(mean_and_error([1.0, 1.5, 0.0])[1])


def test_the_simplest_within_one_standard_error_is_named():
    best = standing("best", {"r": 1.0, "s": 2.0, "t": 3.0})
    level = standing("level", {"r": 1.2, "s": 1.9, "t": 3.1})  # 0.067 +- 0.088
    worse = standing("worse", {"r": 2.0, "s": 3.0, "t": 4.1})
    assert find_simplest([worse, level, best], best) is level
    assert find_simplest([worse, best], best) is best


def test_a_difference_of_a_fiftieth_is_none_however_sure():
    best = standing("best", {"r": 1.0, "s": 2.0})
    near = standing("near", {"r": 1.01, "s": 2.01})  # 0.01 +- 0
    assert find_simplest([near, best], best) is near


def test_one_record_says_nothing_of_an_error():
    one, best = standing("one", {"r": 1.0}), standing("best", {"r": 1.0})
    assert math.isnan(paired_difference(one, best).standard_error)
    assert find_simplest([one, best], best) is best


def test_a_job_that_failed_leaves_its_reason_and_what_was_there_before():
    after = standing("a", {"r": 1.0}).with_job(JobResult("a", 1, 5.0, "failed", why="no window"))
    assert (after.why, list(after.fits_by_fold), after.seconds) == ("no window", [0], 5.0)
    late = standing("a", {"r": 1.0}).with_job(JobResult("a", 1, 5.0, "out of time", why="spent"))
    assert late.why == ""


def test_one_that_was_soon_left_takes_no_records_from_the_others():
    # on the first fold, the only one of `soon`, `b` is better than `a`
    a = standing("a", {"q": 2.1, "r": 2.0}, {"s": 1.0}, {"t": 1.0})
    b = standing("b", {"q": 1.9, "r": 1.9}, {"s": 3.0}, {"t": 3.0})
    soon = standing("soon", {"q": 9.0, "r": 9.0})
    assert [s.name for s in rank([b, soon, a])] == ["a", "b", "soon"]


def test_one_that_was_soon_left_is_the_best_only_beyond_doubt():
    a = standing("a", {"q": 2.1, "r": 2.0}, {"s": 1.0})
    sure = standing("sure", {"q": 1.0, "r": 1.0})
    doubtful = standing("doubtful", {"q": 3.0, "r": 0.9})  # better by 0.1 +- 1
    single = CandidateResult("single", {0: (scores({"q": 0.8}),)})
    found = [s.name for s in rank([single, doubtful, a, sure])]
    assert found == ["sure", "a", "doubtful", "single"]


def test_where_all_that_were_scored_on_most_folds_left_all_bounds_a_shorter_one_comes_first():
    a, short = standing("a", {"r": 1.0}, {"s": math.inf}), standing("short", {"r": 3.0})
    assert [s.name for s in rank([a, short])] == ["short", "a"]


def test_a_candidate_of_few_records_is_not_first_where_others_are_better_on_these():
    """All are better than the best on the first fold, and the one that has only this least so."""
    best = standing("best", {"a": 0.054, "b": 0.051}, {"c": 0.034}, {"d": 0.052})
    other = standing("other", {"a": 0.017, "b": 0.015}, {"c": 0.121})
    few = standing("few", {"a": 0.046, "b": 0.041})
    assert rank([few, other, best])[0] is best
    assert rank([few, best])[0] is few  # clearly better on both, and nothing says otherwise
