"""Figures and tables of identified parameters, and errors of coordinates with different units."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import DT, SWING, swing_model

import tustinnet as tn
from tustinnet.evaluate.ahead import joint_rmse, rmse_ahead_by_unit
from tustinnet.evaluate.scores import Score, mean_rmse_by_unit
from tustinnet.fitting.report import BaseParameterEstimate, Estimate
from tustinnet.report.comparison import comparison_table
from tustinnet.report.figures import free_run_figure
from tustinnet.report.fits import base_parameter_table, parameter_table
from tustinnet.report.identification import MOST_DRAWN, choose_parameters, correlation_figure
from tustinnet.report.summary import time_sentence

MIXED = [
    tn.Coordinate("cart", "linear"),
    tn.Coordinate("pole", "angular"),
    tn.Coordinate("arm", "angular"),
]


def identified(n: int, correlation: np.ndarray) -> tn.Identification:
    """An identification of `n` parameters of two links, every other one of which is informed."""
    estimates = tuple(
        Estimate(
            f"link{i % 2}.p{i}", "kg", 1.0, 0.1, 0.1, (0.8, 1.2), 0.1, 10.0, is_informed=i % 2 == 0
        )
        for i in range(n)
    )
    return tn.Identification(
        SWING,
        tn.discretise(swing_model(), DT),
        estimates,
        {},
        correlation,
        1.0,
        True,
        "",
        (),
        (),
        "residuals",
        {},
        (),
        (),
        "anchored",
        {},
        "file",
        {},
        None,
        1,
        1,
    )


def mixed_score(name: str, *rmse: float, horizon: float | None = None) -> Score:
    simulated = np.zeros((50, 6))
    nrmse = tuple(x / 0.5 for x in rmse)
    fit = tuple(100 * (1 - x) for x in nrmse)
    norm = float(np.linalg.norm(rmse))
    return Score(name, "file", norm, norm, rmse, nrmse, fit, simulated, horizon, rmse)


def mixed_record(name: str) -> tn.Experiment:
    return tn.from_arrays(np.zeros((50, 3)), dt=0.01, coordinates=MIXED, name=name)


def test_few_parameters_are_all_drawn_and_of_many_those_with_correlated_errors():
    few = identified(MOST_DRAWN, np.eye(MOST_DRAWN))
    assert list(choose_parameters(few)) == list(range(MOST_DRAWN))
    n = 60
    correlation = np.eye(n)
    for i, j in ((3, 50), (20, 41)):
        correlation[i, j] = correlation[j, i] = -0.9
    correlation[7] = correlation[:, 7] = np.nan  # at a bound
    many = identified(n, correlation)
    estimates = list(many.estimates)
    estimates[7] = replace(estimates[7], bound="upper", interval=None)
    many = replace(many, estimates=tuple(estimates))
    chosen = list(choose_parameters(many))
    assert {3, 50, 20, 41, 7} <= set(chosen)
    assert len(chosen) == len(set(chosen)) < 15
    assert abs(chosen.index(3) - chosen.index(50)) == 1
    assert chosen[-1] == 7
    figure = correlation_figure(many)
    assert figure.get_figheight() < 6
    assert f"{len(chosen)} of 60 parameters" in figure.get_suptitle()


def test_of_many_parameters_the_table_has_those_that_the_records_tell_about():
    table = parameter_table(identified(40, np.eye(40)))
    assert len(table.rows) == 20
    assert "without 20 that the records tell little about" in table.title
    few = identified(29, np.eye(29))
    few = replace(few, fixed={"damping": 0.1})
    assert len(parameter_table(few).rows) == 30
    many = parameter_table(replace(identified(30, np.eye(30)), fixed={"damping": 0.1}))
    assert len(many.rows) == 30
    assert many.title.endswith("without 1 fixed ones, which are in summary.json")


def test_base_parameters_are_written_as_combinations():
    first = BaseParameterEstimate(
        "arm.inertia_zz",
        "kg m^2",
        {"hand.mass": 0.0625, "hand.mass*center_x": -1.0},
        0.51234,
        (0.5, 0.52468),
    )
    assert first.expression == "arm.inertia_zz + 0.0625 hand.mass - hand.mass*center_x"
    at_bound = BaseParameterEstimate("joint.viscous", "N m s/rad", {}, 0.1, None)
    rows = base_parameter_table([first, at_bound]).rows
    assert rows[0][1:] == ["0.5123", "kg m^2", "0.5..0.5247"]
    assert rows[1][1:] == ["0.1", "N m s/rad", "–"]


def test_errors_of_different_units_are_not_added_up():
    records = [mixed_record("a"), mixed_record("b")]
    channels = records[0].channels
    scores = [mixed_score("a", 0.01, 0.3, 0.4), mixed_score("b", 0.03, 0.0, 0.1)]
    assert scores[0].rmse_by_unit(channels) == {"m": 0.01, "rad": pytest.approx(0.5)}
    means = mean_rmse_by_unit(scores, channels)
    assert means == {"m": pytest.approx(0.02), "rad": pytest.approx(0.3)}
    table = comparison_table(records, {"one": scores}, "file")
    assert table.columns == ["record", "split", "one [m]", "one [rad]"]
    assert table.rows[-1] == ["mean", "all", "0.0200", "0.300"]
    far = [mixed_score("a", 1.0, 3.0, 4.0), mixed_score("b", 3.0, 0.0, 1.0)]
    both = comparison_table(records, {"one": scores, "far": far}, "file")
    assert both.rows[-1] == ["mean", "all", "0.0200", "0.300", "2.0000", "3.000"]
    ahead = np.array([[0.1, 0.3, 0.4]])
    np.testing.assert_allclose(rmse_ahead_by_unit(ahead, channels), [[0.1, 0.5]])
    np.testing.assert_allclose(joint_rmse(ahead), [np.sqrt(0.26)])
    angle = tn.from_arrays(np.zeros(50), dt=0.01, coordinates={"x": "angular"}, name="c")
    alone = Score("c", "file", 0.2, 0.2, (0.25,), (0.1,), (90.0,), np.zeros((50, 2)))
    assert alone.rmse_by_unit(angle.channels) == {"rad": 0.2}


def test_a_free_run_over_a_horizon_is_drawn_with_its_errors_beside_it():
    record = mixed_record("a")
    figure = free_run_figure(record, {"m": mixed_score("a", 0.4, 0.3, 0.4, horizon=0.2)})
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == [
        "cart [m]",
        "error [m]",
        "pole [rad]",
        "error [rad]",
        "arm [rad]",
        "error [rad]",
    ]
    (text,) = [t.get_text() for t in figure.legends[0].get_texts() if "RMSE" in t.get_text()]
    assert text == "m (RMSE 0.400 m and 0.500 rad)"
    # whole records: only where every error is small
    for error, panels in ((0.4, 3), (0.01, 6)):
        figure = free_run_figure(record, {"m": mixed_score("a", error, error, error)})
        assert len(figure.axes) == panels


def test_the_time_of_a_command_names_its_parts():
    parts = "the fit 9 s, preparation of the records 60 s, scores, figures and the rest 21 s"
    assert time_sentence(90.0, 9.0, 60.0) == f"time: 90 s ({parts})"
    assert time_sentence(9.0, 8.5, 0.0) == "time: 9 s (the fit 8 s)"
