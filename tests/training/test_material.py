"""Windows and records as training sees them."""

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.training.material import (
    adapted_length,
    held_windows,
    lay_out,
    stage_windows,
    validation_runs,
)
from tustinnet.training.plan import plan
from tustinnet.training.recipe import WindowRecipe


def generator() -> np.random.Generator:
    return np.random.default_rng(0)


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
    windows = stage_windows(list(pendulum), recipe, generator())
    assert len(windows.rows) > 0
    for row in windows.rows:
        record = next(r for r in rows_of(pendulum) if row in r)
        assert row + windows.length in record


def test_windows_are_drawn_once_per_seed(pendulum):
    recipe = WindowRecipe(draw="random", length=20, count=30)
    first, again = (stage_windows(list(pendulum), recipe, generator()) for _ in range(2))
    other = stage_windows(list(pendulum), recipe, np.random.default_rng(1))
    assert first.rows.tolist() == again.rows.tolist() != other.rows.tolist()


def test_a_count_of_strided_windows_is_about_met(pendulum):
    recipe = WindowRecipe(draw="strided", length=20, count=100)
    assert 80 <= len(stage_windows(list(pendulum), recipe, generator()).rows) <= 120


def test_a_record_shorter_than_a_window_is_named(pendulum):
    recipe = WindowRecipe(draw="strided", length=190, step=5)
    with pytest.raises(tn.InputError, match=r"noise2: 180 samples; expected more than a window"):
        stage_windows(list(pendulum), recipe, generator())


def test_random_windows_too_long_for_every_record_are_refused(pendulum):
    recipe = WindowRecipe(draw="random", length=178, count=5)
    with pytest.raises(tn.InputError, match="no window of 178 steps fits"):
        stage_windows([pendulum["noise2"]], recipe, generator())


def test_held_windows_leave_out_records_that_are_too_short(pendulum):
    recipe = WindowRecipe(draw="strided", length=10, step=5)
    held = [pendulum["noise2"], pendulum["fall1"]]
    windows = held_windows(held, recipe, 200, generator())
    assert windows is not None
    assert min(windows.rows) >= len(pendulum["noise2"])
    assert held_windows(held, recipe, 400, generator()) is None


def test_adapted_windows_shrink_with_short_records(pendulum):
    short = [e[:60] for e in pendulum]
    assert adapted_length(short, 50) <= 15
    recipe = WindowRecipe(draw="strided", length=50, step=5, adapt=True)
    assert stage_windows(short, recipe, generator()).length == adapted_length(short, 50)


def test_adapted_windows_grow_when_little_happens_in_a_sample():
    t = np.arange(8000) * 0.001
    slow = tn.from_arrays(np.sin(2 * t), dt=0.001, coordinates={"a": "angular"})
    assert adapted_length([slow], 50) == 200


def test_records_end_to_end_keep_states_and_held_inputs(pendulum):
    model = plan(pendulum, tn.read_recipe("standard")).models
    records = lay_out(model, list(pendulum), "auto")
    second = rows_of(pendulum)[1]
    np.testing.assert_allclose(
        records.x[second.start : second.stop, 0], pendulum[1].q[:, 0], rtol=1e-6
    )
    assert records.u[second.stop - 1].tolist() == [0.0]


def test_validation_weights_sum_to_one_within_each_record(pendulum):
    model = plan(pendulum, tn.read_recipe("standard")).models
    runs = validation_runs(model, list(pendulum), "derived-6", "auto")
    np.testing.assert_allclose(runs.weight.sum(axis=1), 1.0, rtol=1e-5)
