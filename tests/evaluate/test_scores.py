"""Scores and free runs."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.evaluate import metrics
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import learn_scaling
from tustinnet.models.contract import require_float64, with_dtype
from tustinnet.simulate.starts import start_named


@pytest.fixture(scope="module")
def model(pendulum) -> TustinNet:
    scaling = learn_scaling(list(pendulum.split("train")))
    return random_tustin_net(pendulum.channels, scaling, jax.random.key(1), hidden=(8,))


def test_rmse_is_the_root_mean_square_of_the_2_norm_over_samples():
    simulated, measured = np.zeros((2, 2)), np.array([[3.0, 4.0], [0.0, 0.0]])
    assert metrics.rmse(simulated, measured) == pytest.approx(math.sqrt(25 / 2))
    np.testing.assert_allclose(
        metrics.coordinate_rmse(simulated, measured), [3 / math.sqrt(2), 4 / math.sqrt(2)]
    )


def test_rmse_does_not_wrap_angles():
    assert metrics.rmse(np.full((3, 1), 2 * np.pi), np.zeros((3, 1))) == pytest.approx(2 * np.pi)


def test_fit_is_100_for_perfect_and_0_for_the_mean():
    measured = np.array([[1.0], [2.0], [3.0]])
    assert metrics.fit_percent(measured, measured)[0] == pytest.approx(100.0)
    assert metrics.fit_percent(np.full((3, 1), 2.0), measured)[0] == pytest.approx(0.0)


def test_nrmse_of_a_coordinate_that_did_not_move_is_nan():
    assert np.isnan(metrics.nrmse(np.ones((3, 1)), np.zeros((3, 1)))[0])


def test_figures_of_nothing_are_nan():
    nothing = np.zeros((0, 2))
    assert math.isnan(metrics.rmse(nothing, nothing))
    assert np.isnan(metrics.fit_percent(nothing, nothing)).all()
    assert np.isnan(metrics.mean_and_error([])).all()


@pytest.mark.parametrize("count", [1, 3, 6, 12])
def test_nine_of_ten_new_records_are_within_the_expected_range(count):
    rng = np.random.default_rng(0)
    inside = []
    spread = 0.7 * np.sqrt(2 / rng.chisquare(2, size=(2000, 1)))  # machines differ in it
    for errors in np.exp(rng.normal(-3.0, spread, size=(2000, count + 1))):
        expected = metrics.expected_range(errors[:-1])
        assert expected is not None
        inside.append(expected.low < errors[-1] < expected.high)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("errors", [[], [0.1, np.inf, 0.2], [0.1, 0.0, 0.2]])
def test_errors_that_say_nothing_of_new_records_have_no_expected_range(errors):
    assert metrics.expected_range(errors) is None


def test_few_errors_that_are_alike_by_chance_promise_little():
    factors = []
    for count in (1, 3, 12):
        expected = metrics.expected_range([0.1] * count)
        assert expected is not None
        factors.append(expected.high / expected.typical)
    assert factors[0] > 10  # so vague that it is said
    assert 3 < factors[1] < 6
    assert factors[2] < 2


@pytest.mark.thorough
def test_free_runs_of_unequal_records_equal_their_own_rollouts(model, pendulum):
    runs = tn.free_run(model, list(pendulum), "derived-6")
    assert [len(r) for r in runs] == [len(e) for e in pendulum]
    for e, run in zip(pendulum, runs, strict=True):
        x0 = jnp.asarray(tn.initial_state(e, "derived-6"))
        alone = tn.rollout(with_dtype(model, np.float64), x0, jnp.asarray(e.held_inputs))
        np.testing.assert_allclose(run, alone, rtol=1e-9, atol=1e-9)


def test_evaluate_names_the_start_with_every_score(model, pendulum):
    scores = tn.evaluate(model, list(pendulum), "derived-6")
    assert {s.start for s in scores} == {"derived-6"}
    assert [s.experiment for s in scores] == [e.name for e in pendulum]
    assert tn.mean_rmse(scores) == pytest.approx(np.mean([s.rmse for s in scores]))


@pytest.mark.parametrize("start", ["derived-6", "warm-up-12"])
def test_a_score_over_a_horizon_is_over_all_segments_each_from_a_state_of_its_own(
    model, pendulum, start
):
    e, first = pendulum[0], start_named(start).first
    (score,) = tn.evaluate(model, e, start, horizon=1.0)
    assert (score.horizon, score.simulated.shape) == (1.0, (len(e), 2))
    edges = range(first, len(e), 50)
    alone = [tn.free_run(model, e[a - first : a + 50], start)[0][first:] for a in edges]
    np.testing.assert_allclose(score.simulated[first:], np.concatenate(alone), rtol=1e-9)
    error = np.concatenate(alone)[:, 0] - e.q[first:, 0]
    assert score.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    place = np.arange(len(error)) % 50 >= start_named(start).seen_samples - first
    assert score.rmse_after == pytest.approx(np.sqrt(np.mean(error[place] ** 2)))
    assert tn.evaluate(model, e, start, horizon=5.9)[0].horizon == 5.9


def test_a_diverging_free_run_scores_infinity(model, pendulum):
    wild = jax.tree.map(lambda leaf: leaf * 1e200 if leaf.ndim == 2 else leaf, model)
    assert tn.evaluate(wild, [pendulum[0]], "derived-6")[0].rmse == math.inf


@pytest.mark.thorough
def test_one_step_ahead_matches_a_single_step(model, pendulum):
    e = pendulum[0]
    errors = tn.rmse_ahead(model, [e], 3)
    assert errors.shape == (3,)
    states = np.concatenate([e.q, e.velocities()], axis=1)
    squares = []
    for k in range(len(e) - 1):
        following = model.step(jnp.asarray(states[k]), jnp.asarray(e.held_inputs[k]))
        squares.append(float(following[0] - e.q[k + 1, 0]) ** 2)
    assert errors[0] == pytest.approx(math.sqrt(np.mean(squares)), rel=1e-4)


def test_steps_ahead_do_not_depend_on_how_they_are_divided(model, pendulum, monkeypatch):
    from tustinnet.evaluate import ahead

    records = [pendulum["fall1"], pendulum["noise2"]]  # the second shorter than the horizon
    whole = tn.rmse_ahead(model, records, 250)
    monkeypatch.setattr(ahead, "_STEPS_AT_ONCE", 30_000)
    np.testing.assert_allclose(tn.rmse_ahead(model, records, 250), whole, rtol=1e-9)
    np.testing.assert_allclose(tn.rmse_ahead(model, records, 40), whole[:40], rtol=1e-9)


def test_a_horizon_longer_than_every_record_is_refused(model, pendulum):
    with pytest.raises(tn.InputError, match="horizon"):
        tn.rmse_ahead(model, list(pendulum), 10_000)


def test_scores_need_double_precision_and_say_how_to_switch_it_on(pendulum):
    with (
        jax.enable_x64(False),
        pytest.warns(UserWarning, match="fit: JAX computes in single precision; scores"),
        pytest.raises(tn.InputError),
    ):
        tn.fit(pendulum, "no recipe")
    with jax.enable_x64(False), pytest.raises(tn.InputError, match="jax_enable_x64"):
        require_float64("evaluate")


@pytest.mark.real
@pytest.mark.parametrize("stem", ["session1", "session2", "standard"])
def test_the_authors_weights_give_their_published_free_runs(real_data, stem):
    import json

    from tustinnet.reproduce.published import load_authors_weights

    folder = real_data / "authors_weights"
    if not folder.is_dir():
        pytest.skip("the authors' weights are not at hand")
    data = tn.load(real_data)
    published = json.loads((folder / "free_run_rmse_rad.json").read_text())[stem]
    model = load_authors_weights(folder / f"{stem}.npz", data)
    records = [e for e in data if e.source in published]
    assert len(records) == 21
    for e, score in zip(records, tn.evaluate(model, records, "file"), strict=True):
        assert score.rmse == pytest.approx(published[e.source], abs=5e-4), e.name
