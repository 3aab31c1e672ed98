"""Windows and records as training sees them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import tustinnet as tn
from tustinnet.fitting.free_runs import make_free_runs
from tustinnet.fitting.gradient.epoch import compute_validation_rmse
from tustinnet.fitting.gradient.plan import make_plan
from tustinnet.fitting.gradient.windows import (
    RecordPool,
    adapt_length,
    describe_windows,
    draw_stage_windows,
    draw_windows,
    span_length,
)
from tustinnet.fitting.recipe import WindowRecipe
from tustinnet.fitting.task import make_task
from tustinnet.models.contract import Model
from tustinnet.simulate.starts import start_named


def generator() -> np.random.Generator:
    return np.random.default_rng(0)


def model_of(data: tn.DataSet, **model: object) -> Model:
    """A model of the data set, not trained."""
    recipe = tn.read_recipe("standard", [f"model.{k}={v}" for k, v in model.items()])
    return make_plan(make_task(data, recipe)).initial_models[0]


def rows_of(pendulum: tn.DataSet) -> list[range]:
    ends = np.cumsum([len(e) for e in pendulum])
    return [range(end - len(e), end) for e, end in zip(pendulum, ends, strict=True)]


@pytest.mark.parametrize(
    "recipe",
    [
        WindowRecipe(draw="strided", length=30, step=7),
        WindowRecipe(draw="strided", length=30, count=25, until="k_bar"),
        WindowRecipe(draw="random", length=30, count=50),
        WindowRecipe(draw="random", length=30, count=50, until="k_bar"),
    ],
)
def test_no_window_crosses_from_one_record_into_the_next(pendulum, recipe):
    windows, length = draw_stage_windows(list(pendulum), recipe, generator())
    rows = RecordPool(list(pendulum)).window_rows(windows, list(pendulum))
    assert len(rows) > 0
    for row in rows.tolist():
        record = next(r for r in rows_of(pendulum) if row in r)
        assert row + length in record


def test_a_warm_up_before_a_window_stays_within_its_record(pendulum):
    recipe = WindowRecipe(draw="strided", length=30, step=1)
    windows, length = draw_stage_windows(list(pendulum), recipe, generator(), lead=20)
    assert length == 30
    for record, first in windows.tolist():
        assert first + 20 + length < len(pendulum[record])


def test_windows_are_drawn_once_per_seed(pendulum):
    recipe = WindowRecipe(draw="random", length=20, count=30)
    first, again = (draw_stage_windows(list(pendulum), recipe, generator()) for _ in range(2))
    other = draw_stage_windows(list(pendulum), recipe, np.random.default_rng(1))
    assert first[0].tolist() == again[0].tolist() != other[0].tolist()


def test_a_count_of_strided_windows_is_about_met(pendulum):
    recipe = WindowRecipe(draw="strided", length=20, count=100)
    assert 80 <= len(draw_stage_windows(list(pendulum), recipe, generator())[0]) <= 120


def test_a_record_shorter_than_a_window_is_named(pendulum):
    recipe = WindowRecipe(draw="strided", length=190, step=5)
    with pytest.raises(tn.InputError, match=r"noise2: 180 samples; expected more than a window"):
        draw_stage_windows(list(pendulum), recipe, generator())


def test_random_windows_too_long_for_every_record_are_refused(pendulum):
    recipe = WindowRecipe(draw="random", length=178, count=5)
    with pytest.raises(tn.InputError, match="no window of 178 steps fits"):
        draw_stage_windows([pendulum["noise2"]], recipe, generator())


def test_held_windows_leave_out_records_that_are_too_short(pendulum):
    recipe = WindowRecipe(draw="strided", length=10, step=5)
    held = [pendulum["noise2"], pendulum["fall1"]]
    windows = draw_windows(held, recipe, 200, generator())
    assert set(windows[:, 0].tolist()) == {1}
    assert min(RecordPool(held).window_rows(windows, held)) >= len(pendulum["noise2"])
    assert not len(draw_windows(held, recipe, 400, generator()))


def test_adapted_windows_shrink_with_short_records(pendulum):
    short = [e[:60] for e in pendulum]
    assert adapt_length(short, 50) <= 15
    recipe = WindowRecipe(draw="strided", length=50, step=5, adapt=True)
    assert draw_stage_windows(short, recipe, generator())[1] == adapt_length(short, 50)


def test_windows_that_follow_the_records_fit_into_the_shortest(pendulum):
    records = [*pendulum, pendulum["fall1"][:40]]
    recipe = WindowRecipe(draw="strided", length=50, step=5, adapt=True)
    windows, length = draw_stage_windows(records, recipe, generator())
    assert length == 35
    assert span_length(records, 100.0) < 40
    assert {*windows[:, 0].tolist()} == {*range(len(records))}


def test_adapted_windows_grow_when_little_happens_in_a_sample():
    t = np.arange(8000) * 0.001
    slow = tn.from_arrays(np.sin(2 * t), dt=0.001, coordinates={"a": "angular"})
    assert adapt_length([slow], 50) == 200


def test_records_end_to_end_keep_states_and_held_inputs(pendulum):
    records = RecordPool(list(pendulum)).records(model_of(pendulum), "auto")
    second = rows_of(pendulum)[1]
    np.testing.assert_allclose(
        records.x[second.start : second.stop, 0], pendulum[1].q[:, 0], rtol=1e-6
    )
    np.testing.assert_allclose(records.u[second.start : second.stop - 1], pendulum[1].held_inputs)
    assert records.u[second.stop - 1].tolist() == [0.0]


def test_a_record_that_several_members_use_is_laid_out_once(pendulum):
    pool = RecordPool([pendulum[0], pendulum[1], pendulum[0]])
    assert [e.name for e in pool.experiments] == ["fall1", "fall2"]
    of = [pendulum[1], pendulum[0]]
    assert pool.window_rows(np.array([[0, 7], [1, 3]]), of).tolist() == [len(pendulum[0]) + 7, 3]


def test_windows_begin_with_internal_states_that_followed_their_record(pendulum):
    pool = RecordPool(list(pendulum))
    assert pool.internal_states(model_of(pendulum), "auto").shape[1] == 0
    model = model_of(pendulum, memory="[0.5]")
    states = pool.internal_states(model, "auto")
    first = rows_of(pendulum)[1].start
    e, v = pendulum[1], pendulum[1].velocities()[:, 0]
    by_hand = float(model.initial_internal(jnp.asarray([e.q[0, 0], v[0]]))[0])
    assert abs(by_hand) > 0.1
    np.testing.assert_allclose(states[first], [by_hand], rtol=1e-5)
    for k in range(4):
        x = np.array([e.q[k, 0], v[k], by_hand])
        by_hand = float(model.step(jnp.asarray(x), jnp.asarray(e.held_inputs[k]))[2])
        np.testing.assert_allclose(states[first + k + 1], [by_hand], rtol=1e-4)


def test_validation_weights_sum_to_one_within_each_record(pendulum):
    runs = make_free_runs(model_of(pendulum), list(pendulum), start_named("derived-6"))
    np.testing.assert_allclose(runs.weight.sum(axis=(1, 2)), 1.0, rtol=1e-5)


@pytest.mark.thorough
def test_validation_runs_over_a_horizon_score_as_evaluation_does(pendulum):
    model, start = model_of(pendulum), start_named("derived-6")
    runs = make_free_runs(model, list(pendulum), start, 1.0)
    np.testing.assert_allclose(runs.weight.sum(axis=(1, 2)), 1.0, rtol=1e-5)
    every = jnp.arange(len(pendulum))
    single = jax.tree.map(lambda a: a.astype(jnp.float32), model)
    score = compute_validation_rmse(single, runs, every, jnp.ones(len(pendulum), jnp.float32))
    scores = tn.evaluate(model, list(pendulum), "derived-6", horizon=1.0)
    assert float(score) == pytest.approx(tn.mean_rmse(scores), rel=1e-4)


def test_a_horizon_of_validation_longer_than_every_record_is_refused(pendulum):
    recipe = tn.read_recipe("standard", ["horizon=60"])
    with pytest.raises(tn.InputError, match="recipe 'standard', horizon: 60 s"):
        make_plan(make_task(pendulum, recipe))


def test_windows_of_a_fast_oscillation_last_until_their_start_is_forgotten():
    generator = np.random.default_rng(0)
    # 9 samples a period, 1/e in 30 samples, driven by noise
    pole = np.exp(-1 / 30 + 2j * np.pi / 9)
    poles = [1.0, -2 * pole.real, abs(pole) ** 2]
    x = np.asarray(scipy.signal.lfilter([1.0], poles, generator.normal(size=8000)))
    record = tn.from_arrays(x, dt=1 / 600, coordinates={"mass": "linear"})
    assert 80 <= adapt_length([record], 50) <= 100
    account = describe_windows([record], WindowRecipe(draw="strided", length=50, step=5))
    assert "windows of 50 steps: 5." in account
    assert "of mass, 6" in account
    assert "samples a period are few" in account


def test_a_span_lasts_as_long_however_fast_the_records_are_sampled(pendulum):
    slow = list(pendulum)
    fast = [e.resample(e.dt / 2) for e in slow]
    lengths = [span_length(records, 3.0) for records in (slow, fast)]
    assert lengths[1] == pytest.approx(2 * lengths[0], rel=0.5)
    assert 25 <= lengths[0] < lengths[1] <= 200


def test_a_span_is_at_most_a_quarter_of_a_record(pendulum):
    short = [e[:80] for e in pendulum]
    assert span_length(short, 100.0) == 20


def test_windows_take_a_length_or_a_span():
    with pytest.raises(ValueError, match="either `length` or `span`"):
        WindowRecipe(draw="strided", step=1)
    with pytest.raises(ValueError, match="`adapt` changes a `length`"):
        WindowRecipe(draw="strided", span=3, step=1, adapt=True)
