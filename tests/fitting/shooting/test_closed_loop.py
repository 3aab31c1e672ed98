"""Identification of records in which a controller holds an unstable equilibrium."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from balancing import SYSTEM, TRUTH, balanced
from swinging import DT, SWING, data_set, falls, records, simulated, swing_model
from test_identify import grey, worst

import tustinnet as tn
from tustinnet.fitting.listener import Listener


@pytest.fixture(scope="module")
def balancing() -> tn.DataSet:
    """Four records that train, one that validates."""
    *train, last = balanced(5, 4.0)
    return tn.DataSet(
        "held", (*(replace(e, split="train") for e in train), replace(last, split="validation"))
    )


@pytest.fixture(scope="module")
def result(balancing) -> tn.Identification:
    return tn.identify(balancing, SYSTEM, grey("initial=anchored"))


@pytest.mark.thorough
def test_held_records_are_identified_over_the_segments_that_they_allow(balancing, result):
    assert result.converged
    assert worst(result, TRUTH) < 0.05
    assert set(result.horizons) == {e.name for e in balancing}
    # an error doubles every 62 ms: from the encoder's noise to 0.3 of the motion in 4 or 5 times
    assert all(0.2 < seconds < 0.4 for seconds in result.horizons.values())
    assert max(result.rmse.values()) < 1e-3
    assert result.trust == "records"
    assert len(result.initial_states["hold1"]) == 4
    assert result.as_plain()["horizons"] == dict(result.horizons)


def test_which_records_were_fitted_over_which_horizon_is_told(result):
    grown = [f for f in result.findings if f.code == "segments errors grow"]
    assert {name for f in grown for name in f.values["records"]} == {
        "hold1",
        "hold2",
        "hold3",
        "hold4",
    }
    assert any("validation records are scored over segments of" in f.text for f in result.findings)


def test_validation_is_over_the_horizon_found(balancing, result):
    validation = list(balancing.split("validation"))
    assert result.start == "model-20"
    scores = tn.evaluate(result.model, validation, result.start, horizon=result.horizon)
    assert result.validation_rmse == pytest.approx(tn.mean_rmse(scores), rel=1e-3)
    # as a whole, nothing simulates them; rounding, which differs among machines, moves the first
    # figure by a few hundredths of itself
    assert scores[0].rmse < 0.03
    assert tn.evaluate(result.model, validation, result.start)[0].rmse > 1.0


@pytest.mark.thorough
def test_records_that_swing_stay_whole_beside_one_that_is_held():
    """A held record of the swing: noise on its input answers to where it is."""
    top = 0.4 + np.pi
    generator = np.random.default_rng(0)
    x, u = np.array([top + 0.01, 0.0]), np.zeros(400)
    step = eqx.filter_jit(tn.discretise(swing_model(), DT, 8).step)
    for k in range(len(u)):
        u[k] = -30 * (x[0] - top) - 4 * x[1] + generator.normal()
        x = np.asarray(step(jnp.asarray(x), jnp.asarray(u[k : k + 1])))
    upright = simulated("upright", [top + 0.01, 0.0], u)
    result = tn.identify(data_set([*records(), upright]), SWING)
    assert worst(result) < 1e-3
    assert set(result.horizons) == {"upright"}
    assert any(
        f.text.startswith("fall1, fall2, noise1, noise2: fitted as a whole")
        for f in result.findings
    )


def test_a_horizon_can_be_asked_for():
    iterations = []
    result = tn.identify(
        data_set(records()),
        SWING,
        grey("horizon=1.2"),
        listener=Listener(on_iteration=iterations.append),
    )
    assert worst(result) < 1e-4
    assert set(result.horizons.values()) == {1.2}
    assert iterations[-1].stage == "segments of 1.2 s, anchored start"
    assert any("fitted over segments of 1.2 s" in f.text for f in result.findings)
    fitted = tn.fit(data_set(records()), grey("horizon=1.2"), system=SWING)
    assert fitted.horizon == 1.2


@pytest.mark.parametrize(("horizon", "words"), [(0.01, "at least two samples"), (9, "3.98 s")])
def test_a_horizon_that_makes_no_sense_is_refused(horizon, words):
    with pytest.raises(tn.InputError, match=f"search.horizon: .*{words}"):
        tn.identify(data_set(records()), SWING, grey(f"horizon={horizon}"))


def test_the_limit_of_iterations_names_the_records_that_are_not_followed():
    first, second = falls()
    lost = replace(
        second, q=np.random.default_rng(0).normal(size=(200, 1)), v=None, v_measured=False
    )
    stopped = tn.identify(data_set([first, lost]), SWING, grey("iterations=1", "tolerance=1e-12"))
    assert "not converged after 1 iteration" in stopped.outcome
    assert "the simulations of fall2 miss by more than the records vary" in stopped.outcome
    assert "search.horizon=2" in stopped.outcome
    mild = tn.identify(data_set(records()), SWING, grey("iterations=1", "tolerance=1e-300"))
    assert "allow more (search.iterations)" in mild.outcome
