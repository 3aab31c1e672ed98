"""Errors of estimates, against repeated draws of the noise."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import DT, SWING, TRUTH, noises, noisy, records, simulated, swing_model

import tustinnet as tn
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.least_squares import (
    CostFunction,
    LeastSquaresResult,
    Prior,
    StoppingRule,
    minimise,
)
from tustinnet.fitting.shooting.segments import CutOptions, Segments, cut_records
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.fitting.shooting.uncertainty import (
    Uncertainty,
    estimate_uncertainty,
    lag_correlation,
)

SPACE = make_search_space(SWING, {}, {})
SIZE = 0.01
POSITION = Residual((False,), (1.0,))


def fitted_to(
    experiments: list[tn.Experiment], steps: int | None = None
) -> tuple[Segments, LeastSquaresResult]:
    """Whole records, or segments of so many steps, and the parameters that fit them."""
    model = tn.discretise(swing_model(), DT)
    pieces = cut_records(experiments, model, CutOptions(POSITION, steps, timestamps=False))
    nothing = Prior(np.zeros(3), np.zeros(3), 0.0)
    cost = CostFunction(SWING, POSITION, SPACE, pieces, nothing, anchor_variance=0.0, substeps=1)
    return pieces, minimise(cost, SPACE.to_vector(TRUTH), StoppingRule(1e-6, 20))


def fit(experiments: list[tn.Experiment]) -> tuple[np.ndarray, Uncertainty]:
    """Estimates in the coordinates of the search, and what is believed of them."""
    pieces, fitted = fitted_to(experiments)
    certain = estimate_uncertainty(fitted.products, pieces, np.zeros(3), np.ones(3, dtype=bool))
    return fitted.vector, certain


@pytest.mark.thorough
def test_both_covariances_are_those_of_repeated_draws_of_white_noise():
    vectors, naive, clustered = [], [], []
    for draw in range(40):
        experiments = [noisy(e, SIZE, 10 * draw + i) for i, e in enumerate(records())]
        vector, certain = fit(experiments)
        assert certain.clustered is not None
        vectors.append(vector)
        naive.append(certain.naive)
        clustered.append(certain.clustered)
    scatter = np.cov(np.array(vectors).T)
    spread = np.sqrt(np.diag(scatter))
    for claimed in (naive, clustered):
        mean = np.mean(claimed, axis=0)
        ratio = np.sqrt(np.diag(mean)) / spread
        assert np.all((ratio > 0.7) & (ratio < 1.5)), ratio
    correlation = scatter / np.outer(spread, spread)
    claimed = np.mean(naive, axis=0)
    unit = np.sqrt(np.diag(claimed))
    np.testing.assert_allclose(claimed / np.outer(unit, unit), correlation, atol=0.35)


def test_errors_shrink_with_the_noise():
    loud = fit([noisy(e, SIZE, i) for i, e in enumerate(records())])[1]
    quiet = fit([noisy(e, SIZE / 10, i) for i, e in enumerate(records())])[1]
    ratio = np.sqrt(np.diag(loud.naive) / np.diag(quiet.naive))
    np.testing.assert_allclose(ratio, 10.0, rtol=0.05)


@pytest.mark.parametrize(
    "unit",
    [
        1e-3,
        1e-10,
    ],
)
def test_an_error_does_not_depend_on_the_unit_in_which_its_parameter_is_searched(unit):
    experiments = [noisy(e, SIZE, i) for i, e in enumerate(records())]
    pieces, fitted = fitted_to(experiments)
    units = np.array([unit, 1.0, 1.0])
    coarse = replace(
        fitted.products,
        pp=fitted.products.pp * np.outer(units, units),
        px=fitted.products.px * units[:, None],
        gp=fitted.products.gp * units,
    )
    every = np.ones(3, dtype=bool)
    expected = estimate_uncertainty(fitted.products, pieces, np.zeros(3), every)
    vectors = estimate_uncertainty(coarse, pieces, np.zeros(3), every)
    np.testing.assert_allclose(
        np.sqrt(np.diag(vectors.naive)) * units, np.sqrt(np.diag(expected.naive)), rtol=1e-4
    )
    np.testing.assert_allclose(
        np.sqrt(np.diag(vectors.trusted)) * units, np.sqrt(np.diag(expected.trusted)), rtol=1e-4
    )
    assert vectors.condition == pytest.approx(expected.condition, rel=1e-4)


def test_records_that_disagree_make_errors_larger_than_their_residuals_say():
    """One of four was made with another damping."""
    odd = simulated("odd", [2.5, 0.0], np.zeros(200), {"damping": 0.022})
    experiments = [noisy(e, 1e-4, i) for i, e in enumerate([odd, *records()[1:]])]
    _, certain = fit(experiments)
    assert certain.clustered is not None
    assert certain.clustered[0, 0] > 10 * certain.naive[0, 0]


def test_fewer_than_four_records_leave_only_the_residuals():
    _, certain = fit([noisy(e, SIZE, i) for i, e in enumerate(records()[:3])])
    assert certain.clustered is None
    assert certain.trusted is certain.naive
    assert certain.quantile_for_records(3) == pytest.approx(1.96, abs=0.01)


@pytest.mark.thorough
def test_segments_of_few_records_see_errors_that_last():
    """Against repeated draws of errors that are alike for eight samples."""
    vectors, naive, by_segments = [], [], []
    for draw in range(30):
        rng, experiments = np.random.default_rng(draw), []
        for e in records()[:2]:
            slow = np.repeat(rng.normal(0, SIZE, (len(e) // 8 + 1, e.q.shape[1])), 8, axis=0)
            experiments.append(replace(e, q=e.q + slow[: len(e)]))
        pieces, fitted = fitted_to(experiments, 25)
        certain = estimate_uncertainty(fitted.products, pieces, np.zeros(3), np.ones(3, dtype=bool))
        assert certain.source == "segments"
        assert certain.trusted is certain.by_segments
        vectors.append(fitted.vector)
        naive.append(np.diag(certain.naive))
        by_segments.append(np.diag(certain.trusted))
        # Student's t of 16 segments
        assert certain.quantile_for_records(2) == pytest.approx(2.131, abs=1e-3)
    spread = np.std(vectors, axis=0)[:2]  # the input of these two records is 0
    stated, robust = (np.sqrt(np.mean(x, axis=0))[:2] / spread for x in (naive, by_segments))
    assert (stated < 0.6).all()
    assert (robust > 0.75).all()
    assert (robust < 1.6).all()


def test_few_records_have_wide_quantiles():
    _, certain = fit([noisy(e, SIZE, i) for i, e in enumerate(records())])
    assert certain.trusted is certain.clustered
    # Student's t, 3 degrees of freedom
    assert certain.quantile_for_records(4) == pytest.approx(3.182, abs=1e-3)


def test_a_record_that_alone_informs_of_a_parameter_is_not_left_out():
    experiments = [noisy(e, SIZE, i) for i, e in enumerate([*records(), records()[0]])]
    pieces, fitted = fitted_to(experiments)
    assert len(pieces.first_of_records) == len(fitted.products.pp) == 5
    others = np.ones((5, 3))
    others[1:, 2] = 0.0  # the last parameter is of a group whose only record is the first
    alone = replace(
        fitted.products,
        pp=fitted.products.pp * others[:, :, None] * others[:, None],
        px=fitted.products.px * others[:, :, None],
        gp=fitted.products.gp * others,
    )
    tiny_prior = np.array([1e-300, 1e-300, 1e-300])
    certain = estimate_uncertainty(alone, pieces, tiny_prior, np.ones(3, dtype=bool))
    assert certain.clustered is not None
    # the others disagree as they do without the record, and its own residuals say what it tells
    assert certain.clustered[2, 2] >= certain.naive[2, 2] > 0
    assert np.all(np.diag(certain.clustered) < 100 * np.diag(certain.naive))


def test_a_parameter_at_a_bound_has_no_error_and_takes_no_part():
    pieces, fitted = fitted_to([noisy(e, SIZE, i) for i, e in enumerate(records())])
    moving = np.array([True, False, True])
    certain = estimate_uncertainty(fitted.products, pieces, np.zeros(3), moving)
    every = estimate_uncertainty(fitted.products, pieces, np.zeros(3), np.ones(3, dtype=bool))
    for covariance in (certain.naive, certain.clustered):
        assert covariance is not None
        assert np.isnan(covariance[1]).all()
        assert np.isfinite(covariance[np.ix_(moving, moving)]).all()
    assert certain.worst_direction[1] == 0.0
    assert certain.naive[0, 0] < every.naive[0, 0]


def test_the_worst_determined_direction_is_named_by_its_largest_entry():
    _, certain = fit([noisy(e, SIZE, i) for i, e in enumerate(noises())])
    assert np.abs(certain.worst_direction).max() == pytest.approx(1.0)
    assert 1.0 < certain.condition < 10.0


def test_priors_make_errors_smaller():
    pieces, fitted = fitted_to([noisy(e, SIZE, i) for i, e in enumerate(records())])
    every = np.ones(3, dtype=bool)
    loose = estimate_uncertainty(fitted.products, pieces, np.zeros(3), every)
    with_prior = estimate_uncertainty(fitted.products, pieces, np.array([1e3, 0.0, 0.0]), every)
    assert with_prior.naive[0, 0] < loose.naive[0, 0] / 100


def test_residuals_of_a_simulation_that_ran_away_do_not_overflow():
    slow = np.array([[1.0], [1.0], [1.0], [1.0]])
    away = np.array([[1.0], [1e200], [np.inf], [np.nan]])
    np.testing.assert_allclose(lag_correlation([slow]), [1.0])
    np.testing.assert_allclose(lag_correlation([slow, away]), [3 / 12**0.5])
    assert lag_correlation([np.array([[1.0], [2.0], [4.0]])]) <= 1 + 1e-15, "of errors that grow"
