"""The training loop: stages, freezing, best weights, resuming, rolling back."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.training.epoch import validation_rmse
from tustinnet.training.fit import Plan, plan, run_plan, trainable_arrays
from tustinnet.training.loop import train
from tustinnet.training.state import EpochReport, Listener, Progress, Weights


def run(prepared: Plan, resume=None):
    """Trains and keeps everything that listeners were told."""
    reports: list[EpochReport] = []
    states: list[tuple[Weights, Progress]] = []
    listener = Listener(reports.append, lambda w, p: states.append((w, p)))
    model, progress = train(
        prepared.model, prepared.stages, prepared.records, prepared.validation, prepared.key,
        listener, resume,
    )  # fmt: skip
    return model, progress, reports, states


def same_bits(a, b) -> bool:
    left, right = (jax.tree.leaves(eqx.filter(t, eqx.is_array)) for t in (a, b))
    return all(
        np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in zip(left, right, strict=True)
    )


@pytest.fixture(scope="module")
def prepared(pendulum, tmp_path_factory) -> Plan:
    from conftest import SMALL_RECIPE

    path = tmp_path_factory.mktemp("recipe") / "small.toml"
    path.write_text(SMALL_RECIPE)
    return plan(pendulum, path, 0)


@pytest.fixture(scope="module")
def whole(prepared):
    return run(prepared)


def test_every_stage_runs_its_epochs_and_training_lowers_the_loss(whole):
    _, progress, reports, _ = whole
    assert [(r.stage, r.epoch) for r in reports] == [
        *[("first", k) for k in range(1, 6)],
        *[("second", k) for k in range(1, 5)],
    ]
    assert reports[4].loss < reports[0].loss
    assert progress.outcome == "finished"


def test_frozen_arrays_are_bit_identical_after_the_second_stage_and_the_others_moved(whole):
    model, _, _, states = whole
    begun = next(w.model for w, p in states if p.stage == 1)
    assert same_bits((begun.stem, begun.hidden[0], begun.scaling),
                     (model.stem, model.hidden[0], model.scaling))  # fmt: skip
    assert not same_bits(begun.hidden[1], model.hidden[1])
    assert not same_bits(begun.output, model.output)


@pytest.mark.parametrize("frozen", [0, 1, 2])
def test_the_output_layer_always_trains_and_the_scaling_never(prepared, frozen):
    mask = trainable_arrays(prepared.model, frozen)
    assert mask.output.weight is True
    assert [layer.weight for layer in mask.hidden] == [False] * frozen + [True] * (2 - frozen)
    assert mask.stem.weight is (frozen == 0)
    assert not any(jax.tree.leaves(mask.scaling))


def test_the_second_stage_starts_from_the_best_weights_with_a_freshadam_without_rate(whole):
    _, _, _, states = whole
    first_end = [w for w, p in states if p.stage == 0][-1]
    weights, progress = next((w, p) for w, p in states if p.stage == 1)
    assert progress.epoch == 0
    assert same_bits(weights.model, first_end.best)
    assert all(not np.asarray(leaf).any() for leaf in jax.tree.leaves(weights.optimiser))
    assert progress.plateau.rate == 1e-3


def test_the_best_weights_are_those_of_the_lowest_validation_free_run(whole, prepared):
    model, progress, reports, _ = whole
    lowest = min(r.validation for r in reports if r.stage == "second")
    assert progress.best_score == pytest.approx(lowest)
    assert float(validation_rmse(model, prepared.validation)) == pytest.approx(lowest, rel=1e-5)


def test_the_best_weights_can_be_those_of_the_lowest_training_loss(prepared):
    stages = tuple(
        dataclasses.replace(s, recipe=s.recipe.model_copy(update={"keep": "training"}))
        for s in prepared.stages
    )
    _, progress, reports, _ = run(dataclasses.replace(prepared, stages=stages))
    assert progress.best_score == min(r.loss for r in reports if r.stage == "second")


def test_without_validation_records_the_training_loss_decides(pendulum, prepared):
    alone = plan(pendulum.split("train"), prepared.recipe, 0)
    _, progress, reports, _ = run(alone)
    assert all(math.isnan(r.validation) for r in reports)
    assert progress.best_score == min(r.loss for r in reports if r.stage == "second")


def test_watching_the_validation_loss_needs_its_own_windows(pendulum, prepared):
    recipe = prepared.recipe.model_dump()
    recipe["stages"][0]["plateau"]["watch"] = "validation-loss"
    watching = plan(pendulum, tn.Recipe.model_validate(recipe), 0)
    assert watching.stages[0].held is not None
    assert watching.stages[1].held is None
    _, progress, _, states = run(watching)
    assert progress.outcome == "finished"
    watched = [p.plateau.best for _, p in states if p.stage == 0]
    assert all(math.isfinite(b) for b in watched[1:])


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(whole, prepared, pendulum):
    assert same_bits(run(prepared)[0], whole[0])
    assert not same_bits(run(plan(pendulum, prepared.recipe, 1))[0], whole[0])


@pytest.mark.parametrize("at", [0, 2, 4, 5, 7])
def test_a_resumed_training_ends_with_the_same_bits(whole, prepared, at):
    model, progress, reports, states = whole
    again, ended, later, _ = run(prepared, states[at])
    assert same_bits(again, model)
    assert dataclasses.replace(ended, seconds=0.0) == dataclasses.replace(progress, seconds=0.0)
    assert later == reports[len(reports) - len(later) :]


def test_a_loss_that_is_not_finite_rolls_back_and_goes_on_at_a_lower_rate(prepared):
    stages = tuple(
        dataclasses.replace(s, recipe=s.recipe.model_copy(update={"rate": 2e19}))
        for s in prepared.stages[:1]
    )
    model, progress, reports, states = run(dataclasses.replace(prepared, stages=stages))
    events = [r for r in reports if r.event]
    assert events
    assert "back to the last good state" in events[0].event
    assert progress.outcome.startswith("diverged")
    assert "Lower `rate`" in progress.outcome
    assert progress.rollbacks == 5
    assert same_bits(states[0][0].model, prepared.model)
    assert all(
        bool(jnp.all(jnp.isfinite(leaf)))
        for leaf in jax.tree.leaves(eqx.filter(model, eqx.is_array))
    )


def test_after_a_rollback_training_can_finish(prepared, monkeypatch):
    from tustinnet.training import loop

    genuine = loop.compiled_epoch

    def failing_once(stage):
        epoch, calls = genuine(stage), []

        def attempt(weights, rate, rows, records):
            calls.append(float(rate))
            after, loss, finite = epoch(weights, rate, rows, records)
            return (after, jnp.nan, jnp.array(False)) if len(calls) == 2 else (after, loss, finite)

        return attempt

    monkeypatch.setattr(loop, "compiled_epoch", failing_once)
    one = dataclasses.replace(
        prepared,
        stages=tuple(
            dataclasses.replace(s, recipe=s.recipe.model_copy(update={"plateau": None}))
            for s in prepared.stages[:1]
        ),
    )
    _, progress, reports, _ = run(one)
    assert progress.outcome == "finished"
    assert progress.rollbacks == 1
    assert [r.rate for r in reports] == [3e-3, 3e-3, 1.5e-3, 1.5e-3, 1.5e-3, 1.5e-3]
    assert [r.epoch for r in reports] == [1, 2, 2, 3, 4, 5]


def test_fit_returns_a_folded_model_that_computes_what_was_trained(whole, prepared):
    result = run_plan(prepared, Listener())
    assert result.finished
    assert result.model.folded() is result.model
    assert result.windows == tuple(len(s.windows.rows) for s in prepared.stages)
    assert result.epochs == (5, 4)
    x, u = jnp.array([0.5, -0.2]), jnp.array([0.3])
    np.testing.assert_allclose(result.model.step(x, u), whole[0].step(x, u), rtol=1e-4)


def test_training_learns_the_small_pendulum(pendulum):
    """A model of a system seen in training must beat a model that knows nothing."""
    recipe = tn.read_recipe("standard").model_dump()
    recipe["stages"][0] |= {"epochs": 120, "rate": 3e-3}
    recipe["stages"][0]["windows"] |= {"count": 300}
    recipe["model"]["hidden"] = [24]
    result = tn.fit(pendulum, tn.Recipe.model_validate(recipe), seed=0)
    scores = tn.evaluate(result.model, list(pendulum.split("validation")), "derived-6")
    assert all(s.nrmse[0] < 0.35 for s in scores), [s.nrmse for s in scores]


def test_linear_coordinates_train_too():
    t = np.arange(400) * 0.02
    q = np.column_stack([0.3 * np.sin(2 * t), np.cos(3 * t)])
    coordinates = [tn.Coordinate("slide", "linear"), tn.Coordinate("angle", "angular")]
    data = tn.DataSet("mixed", (tn.from_arrays(q, dt=0.02, coordinates=coordinates),))
    recipe = tn.read_recipe("standard").model_dump()
    recipe["stages"][0] |= {"epochs": 3}
    result = tn.fit(data, tn.Recipe.model_validate(recipe))
    assert result.finished
    assert result.validation_rmse is None


def test_the_published_scaling_is_refused_for_linear_coordinates():
    q = np.sin(np.arange(300) * 0.1)
    data = tn.DataSet(
        "slide", (tn.from_arrays(q, dt=0.1, coordinates=[tn.Coordinate("x", "linear")]),)
    )
    with pytest.raises(tn.InputError, match="published scaling"):
        tn.fit(data, "paper-code-standard")
