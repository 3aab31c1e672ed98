"""The linear state-space model: found by least squares of its free runs."""

import itertools
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.families.linear import FAMILY, LinearHyper
from tustinnet.families.linear_search import (
    LinearRecord,
    LinearSearch,
    LinearSearchOptions,
    PositionResidual,
    _FreeRun,
)
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.task import Origin, make_task
from tustinnet.store.run_folder import MODEL

NAMES = ("train", "train", "validation")


def oscillation(noise: float = 0.0, splits: tuple[str | None, ...] = NAMES) -> tn.DataSet:
    """A driven oscillator, whose free motion is known, as a noisy sensor reads it."""
    dt, stiffness, damping, records = 0.05, 4.0, 0.4, []
    a = np.array([[1.0, dt], [-dt * stiffness, 1.0 - dt * damping]])
    for i, split in enumerate(splits):
        generator = np.random.default_rng(i)
        u, x = generator.normal(size=500), np.zeros((500, 2))
        x[0] = [0.5 - 0.3 * i, 0.1]
        for n in range(499):
            x[n + 1] = a @ x[n] + [0.0, dt * u[n]]
        read = x + noise * generator.normal(size=x.shape)
        records.append(
            tn.from_arrays(
                read[:, 0],
                u,
                v=read[:, 1],
                dt=dt,
                coordinates={"s": "linear"},
                inputs=[tn.Input("f", "N", "zero-order", is_delay_declared=True)],
                name=f"r{i}",
                split=split,
            )
        )
    return tn.DataSet("linear", tuple(records))


def error(model: tn.Model, data: tn.DataSet) -> float:
    return tn.mean_rmse(tn.evaluate(model, list(data.split("validation")), "file"))


def test_a_linear_system_is_found_and_noise_does_not_bias_it():
    data, noisy = oscillation(), oscillation(0.05)
    assert error(tn.fit(data, "linear").model, data) < 1e-4
    hyper = LinearHyper(kind="linear")
    one_step = FAMILY.one_step_model(hyper, list(noisy.split("train")), "file")
    clean = replace(data, experiments=tuple(data))
    assert error(tn.fit(noisy, "linear").model, clean) < error(one_step, clean) / 3


def test_derivatives_of_free_runs_are_those_of_differences():
    generator = np.random.default_rng(0)
    change = generator.normal(size=(3, 5)) / 10
    states, drive = generator.normal(size=(2, 40, 2)), generator.normal(size=(2, 40, 2))
    segment, size = LinearRecord(states, drive), 1e-6
    found = _FreeRun(change, segment).derivatives(2, 3)
    for i, j in itertools.product(range(3), range(5)):
        step = np.zeros((3, 5))
        step[i, j] = size
        ends = [_FreeRun(change + s * step, segment).states[:, ::3, :2] for s in (1, -1)]
        np.testing.assert_allclose(
            found[..., i, j], (ends[0] - ends[1]) / (2 * size), rtol=1e-5, atol=1e-7
        )


def test_it_is_complete_saved_loaded_and_the_same_again(tmp_path):
    data = oscillation(0.02)
    first, second = (
        run_fit(prepare(FitRequest(data, "linear")), tmp_path / name) for name in ("a", "b")
    )
    assert first.best.result.finished
    assert (tmp_path / "a" / MODEL).is_file()
    x, u = jnp.array([0.3, -0.2]), jnp.array([0.5])
    loaded = tn.load_model(tmp_path / "a" / MODEL)
    for model in (loaded, second.best.result.model):
        np.testing.assert_array_equal(model.step(x, u), first.best.result.model.step(x, u))
    with pytest.raises(tn.InputError, match="has no seeds"):
        tn.fit_many(data, "linear", seeds=(0, 1))


def test_internal_states_explain_more_and_an_origin_of_other_size_is_refused():
    data = oscillation(0.02)
    wide = {"name": "wide", "model": {"kind": "linear", "internal": 1}}
    model = tn.fit(data, wide).model
    assert len(model.internal) == 1
    assert error(model, data) < 0.1
    with pytest.raises(tn.InputError, match=r"`origin=`.*1 internal states; expected 0"):
        fit_task(make_task(data, "linear", origin=Origin(model)))
    (again,) = fit_task(make_task(data, wide, origin=Origin(model)))
    assert error(again.model, data) <= 1.01 * error(model, data)


def test_a_search_that_is_stopped_has_its_best_stage():
    task = make_task(oscillation(0.02), "linear")
    questions = itertools.count()
    (result,) = fit_task(task, Listener(should_stop=lambda seconds: next(questions) >= 2))
    assert result.is_out_of_time
    assert not result.finished
    assert error(result.model, oscillation()) < 1.0


def test_what_diverges_stands_still_and_stages_are_not_trained():
    data = oscillation()
    states = np.column_stack([data[0].q, data[0].velocities("file")])
    record = LinearRecord(states, np.ones((len(states), 1)))
    residual = PositionResidual(np.ones(1), np.zeros(1, bool))
    search = LinearSearch([record], [record], residual, options=LinearSearchOptions((50,)))
    for factor in (1e30, 1e300, np.nan):
        unstable = np.column_stack([factor * np.eye(2), np.zeros(2)])
        found, is_complete = search.run(unstable, lambda: False)
        assert is_complete
        np.testing.assert_array_equal(found, np.zeros((2, 3)))
    with pytest.raises(
        tn.InputError, match=r"stages: unknown key; nothing is trained: leave it out"
    ):
        tn.read_recipe("linear", ["stages.0.epochs=3"])


def test_a_map_that_lacks_a_mode_has_derivatives_too():
    """A position that integrates what integrates."""
    rng, change = np.random.default_rng(1), np.array([[0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.1, 0.0]])
    segment = LinearRecord(rng.normal(size=(2, 40, 2)), rng.normal(size=(2, 40, 2)))
    found = _FreeRun(change, segment).derivatives(1, 3)
    for c, j in np.ndindex(2, 4):
        step = np.zeros_like(change)
        step[c, j] = 1e-6
        ahead, behind = (_FreeRun(change + s * step, segment).states for s in (1, -1))
        expected = (ahead - behind)[:, ::3, :1] / 2e-6
        np.testing.assert_allclose(found[..., c, j], expected, rtol=1e-4, atol=1e-5)
