"""Frequency responses and steps of loops."""

import control
import numpy as np
import pytest
from linear_machines import double_integrator
from test_disturbances import level_slide

from tustinnet.control import lqr, margins
from tustinnet.control.design import ControlTask, design_controller
from tustinnet.control.frequency import loop_responses
from tustinnet.report.control import frequency_figure


def test_responses_are_those_of_python_control():
    model = double_integrator()
    feedback = lqr(model, np.zeros(2), np.zeros(1), deviations={"force": 0.5})
    found = loop_responses(model, feedback)
    loop = control.ss(model.a, model.b, feedback.gain, 0.0, model.dt)
    at = found.frequencies[::200]
    expected = np.asarray(loop(np.exp(1j * at * model.dt)))
    np.testing.assert_allclose(found.loops[0, ::200, 0], expected)
    peak = margins(model, feedback).sensitivity_peak
    assert found.sensitivity[0].max() == pytest.approx(peak)
    closed = control.ss(
        model.a - model.b @ feedback.gain,
        model.b * feedback.gain[0, 0],
        np.eye(2)[:1],
        0.0,
        model.dt,
    )
    _, step = control.step_response(closed, found.times)
    np.testing.assert_allclose(found.steps[0, :, 0], step, atol=1e-9)


def test_bands_are_of_other_parameters():
    model = level_slide()
    design = design_controller(model, ControlTask({"s": 0.0}, observer=True))
    feedback = design.own_feedback
    assert feedback.gain.shape == (1, 2)
    found = loop_responses(model, feedback, [{"mass": 1.0}, {"mass": 2.0}])
    np.testing.assert_allclose(found.loops[1], found.loops[0], rtol=1e-6)
    # far above its crossover a loop of twice the mass has half of the gain
    np.testing.assert_allclose(np.abs(found.loops[2, -700] / found.loops[0, -700]), 0.5, atol=0.02)
    assert not np.allclose(found.steps[2], found.steps[0], atol=0.05)
    figure = frequency_figure(found, model.channels)
    assert [axes.get_title() for axes in figure.axes][-1] == "a coordinate after a step of its goal"
    labels = figure.axes[0].get_legend_handles_labels()[1]
    assert labels == ["force", "sensitivity"]
