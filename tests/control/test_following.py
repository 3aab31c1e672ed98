"""Motions that a controller is to follow."""

import numpy as np
import pytest
from every_family import example

import tustinnet as tn
from tustinnet.control.design import ControlTask, design_controller
from tustinnet.control.reference import read_reference
from tustinnet.control.trial import try_design

ROWS = "time,theta\n0,0\n0.5,0.3\n1.0,0.9\n1.5,1.0\n"


def test_a_file_is_read_as_positions_at_samples_from_rest_to_rest(tmp_path):
    (file := tmp_path / "ref.csv").write_text(ROWS)
    channels = example("qube").channels
    (q,) = read_reference(file, channels, {"theta": 2.0}).values()
    assert len(q) == round(1.5 / channels.dt) + 1
    np.testing.assert_allclose(q[:: round(0.5 / channels.dt)], [0.0, 0.6, 1.8, 2.0])
    speed = np.gradient(q, channels.dt)
    assert abs(speed[0]) < 0.05 > abs(speed[-1])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,beta\n0,0\n1,1\n", "columns time, beta; expected a CSV file with .* theta, alpha"),
        ("t,theta\n0,0\n1,1\n", "columns t, theta"),
        ("time,theta\n0,0\n0,1\n", "2 rows that do not ascend"),
        ("time,theta\n0,0\n", "1 rows"),
        ("time,theta\n0,0\n1,\n", "values that are missing"),
        ("time,theta\n0,0\n1,far\n", "expected a CSV file"),
        ("time,theta\n0,0\n1e9,1\n", "more than 100000 samples"),
    ],
)
def test_files_that_are_no_reference_are_refused(text, message, tmp_path):
    (file := tmp_path / "ref.csv").write_text(text)
    with pytest.raises(tn.InputError, match=message):
        read_reference(file, example("qube").channels)
    with pytest.raises(tn.InputError, match="No such file"):
        read_reference(tmp_path / "none.csv", example("qube").channels)


@pytest.mark.thorough
def test_a_motion_is_followed_while_the_pendulum_hangs(tmp_path):
    (file := tmp_path / "ref.csv").write_text(ROWS)
    model = example("qube")
    reference = read_reference(file, model.channels)
    ends = [{"theta": float(reference["theta"][k]), "alpha": -np.pi} for k in (0, -1)]
    limits = {"voltage": (-10.0, 10.0)}
    task = ControlTask(ends[1], ends[0], reference=reference, limits=limits, trust_beyond=True)
    design = design_controller(model, task)
    assert design.plan is not None
    assert design.plan.converged
    assert design.errors_along(design.plan.x)["theta"] < 0.02
    trial = try_design(design, count=1)
    assert trial.robustness["nominal"].successes == 1
    assert design.errors_along(trial.runs["nominal"].states)["theta"] < 0.05
    with pytest.raises(tn.InputError, match="a reference of shape"):
        tn.control.follow(model, np.zeros((5, 3)), limits=limits)
