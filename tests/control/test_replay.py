"""Logs of closed loops, along which controllers are played again."""

from dataclasses import replace

import numpy as np
import pytest
from test_disturbances import level_slide, play_on_a_slope

import tustinnet as tn
from tustinnet.control.design import ControlTask
from tustinnet.control.replaying import model_of, replay

TASK = ControlTask({"s": 0.1}, {"s": 0.0}, seconds=1.0, trust_beyond=True)


def log_of(run) -> tn.Experiment:
    """What a logger keeps of a closed loop."""
    model = level_slide()
    return tn.from_arrays(
        run.measurements[:-1],
        run.inputs,
        dt=run.dt,
        coordinates=model.coordinates,
        inputs=model.inputs,
        name="first",
    )


@pytest.mark.thorough
@pytest.mark.parametrize("observer", [False, True])
def test_the_inputs_of_its_own_log_are_those_of_the_controller(observer):
    run, design = play_on_a_slope(replace(TASK, observer=observer))
    model = model_of(design.gains, level_slide())
    played = replay(design.gains, model, design.noise, log_of(run))
    assert played.late == 0
    assert np.abs(played.difference).max() < 1e-9
    np.testing.assert_allclose(played.estimates, run.estimates[:-1], atol=1e-9)
    # the slope of 3 N, of which the model knows nothing
    assert played.disturbance[0] == pytest.approx(-3.0, abs=0.5)


@pytest.mark.thorough
def test_shifted_columns_and_other_controllers_are_found():
    run, design = play_on_a_slope(TASK)
    log = log_of(run)
    late = replace(log, u=np.concatenate([np.zeros((2, 1)), log.u[:-2]]))
    assert replay(design.gains, level_slide(), design.noise, late).late == 2
    other = replace(log, u=log.u + np.sin(np.arange(len(log)))[:, None])
    played = replay(design.gains, level_slide(), design.noise, other)
    assert np.sqrt(np.mean(played.difference**2)) > 0.5
    # one that has nothing to do with it is said to be so, and not to be late
    foreign = replay(design.gains, level_slide(), design.noise, replace(log, u=-log.u))
    assert [one.is_foreign for one in (played, foreign)] == [False, True]
    with pytest.raises(tn.InputError, match="gains of 2 states; expected 3"):
        replay(design.gains, model_of_three(design), design.noise, log)


def model_of_three(design) -> tn.Model:
    _, observed = play_on_a_slope(replace(TASK, observer=True))
    return observed.estimated
