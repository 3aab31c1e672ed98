"""The training loop: stages, freezing, best weights, resuming, rolling back."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.training.epoch import validation_rmse, window_losses
from tustinnet.training.fit import fit_many, run_plan
from tustinnet.training.layout import lay_out_devices
from tustinnet.training.loop import train
from tustinnet.training.plan import Member, Plan, plan, trainable_arrays
from tustinnet.training.state import EpochReport, Listener, Progress, TrainingState


def run(prepared: Plan, resume=None):
    """Trains and keeps everything that listeners were told."""
    reports: list[EpochReport] = []
    states: list[tuple[TrainingState, tuple[Progress, ...]]] = []
    listener = Listener(reports.append, lambda s, p: states.append((s, p)))
    models, progress = train(
        prepared.models, prepared.stages, prepared.records, prepared.validation, prepared.keys,
        prepared.mesh, prepared.factors, listener, resume,
    )  # fmt: skip
    return models, progress, reports, states


def one(tree, member=0):
    """A member's part."""
    return jax.tree.map(lambda a: a[member], eqx.filter(tree, eqx.is_array))


def with_stages(prepared: Plan, **update) -> Plan:
    """The same plan with other values in the recipe of every stage."""
    stages = tuple(
        dataclasses.replace(s, recipe=s.recipe.model_copy(update=update)) for s in prepared.stages
    )
    return dataclasses.replace(prepared, stages=stages)


def same_bits(a, b) -> bool:
    left, right = (jax.tree.leaves(eqx.filter(t, eqx.is_array)) for t in (a, b))
    return all(bits(x) == bits(y) for x, y in zip(left, right, strict=True))


def bits(array) -> bytes:
    if jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    return np.asarray(array).tobytes()


@pytest.fixture(scope="module")
def prepared(pendulum, tmp_path_factory) -> Plan:
    from conftest import SMALL_RECIPE

    path = tmp_path_factory.mktemp("recipe") / "small.toml"
    path.write_text(SMALL_RECIPE)
    return plan(pendulum, path)


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
    assert progress[0].outcome == "finished"
    assert progress[0].epochs == (5, 4)


def test_frozen_arrays_are_bit_identical_after_the_second_stage_and_the_others_moved(whole):
    model, _, _, states = whole
    begun = next(s.weights.model for s, p in states if p[0].stage == 1)
    assert same_bits((begun.stem, begun.hidden[0], begun.scaling),
                     (model.stem, model.hidden[0], model.scaling))  # fmt: skip
    assert not same_bits(begun.hidden[1], model.hidden[1])
    assert not same_bits(begun.output, model.output)


@pytest.mark.parametrize("frozen", [0, 1, 2])
def test_the_output_layer_always_trains_and_the_scaling_never(prepared, frozen):
    mask = trainable_arrays(one(prepared.models), frozen)
    assert mask.output.weight is True
    assert [layer.weight for layer in mask.hidden] == [False] * frozen + [True] * (2 - frozen)
    assert mask.stem.weight is (frozen == 0)
    assert not any(jax.tree.leaves(mask.scaling))


def test_the_second_stage_starts_from_the_best_weights_with_a_fresh_optimiser(whole):
    _, _, _, states = whole
    first_end = [s.weights for s, p in states if p[0].stage == 0][-1]
    state, progress = next((s, p) for s, p in states if p[0].stage == 1)
    assert progress[0].epoch == 0
    assert same_bits(state.weights.model, first_end.best)
    assert all(not np.asarray(leaf).any() for leaf in jax.tree.leaves(state.weights.optimiser))
    assert float(state.course.plateau.rate[0]) == pytest.approx(1e-3)


def test_the_best_weights_are_those_of_the_lowest_validation_free_run(whole, prepared):
    model, progress, reports, _ = whole
    lowest = min(r.validation for r in reports if r.stage == "second")
    assert progress[0].best_score == pytest.approx(lowest)
    score = validation_rmse(one(model), prepared.validation)
    assert float(score) == pytest.approx(lowest, rel=1e-5)


def test_a_mirrored_window_is_that_of_the_mirrored_records(prepared):
    model = jax.tree.map(lambda a: a[0], prepared.models)
    rows, length = jnp.array([0, 7, 20]), 5
    mirrored = jax.tree.map(jnp.negative, prepared.records)
    ours = window_losses(model, rows, prepared.records, length, "state", signs=-jnp.ones(3))
    theirs = window_losses(model, rows, mirrored, length, "state")
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)
    assert not np.allclose(ours, window_losses(model, rows, prepared.records, length, "state"))


def test_mirrored_training_learns_the_side_that_was_never_recorded(prepared):
    one_sided = with_stages(prepared, mirror=False, averaging=None)
    both_sides = with_stages(prepared, mirror=True, averaging=None)
    rows = jnp.asarray(prepared.stages[0].windows.rows[0])
    mirrored = jax.tree.map(jnp.negative, prepared.records)
    losses = []
    for plan_of_a_side in (one_sided, both_sides):
        model = jax.tree.map(lambda a: a[0], run(plan_of_a_side)[0])
        losses.append(float(jnp.mean(window_losses(model, rows, mirrored, 10, "state"))))
    assert losses[1] < losses[0]


def test_the_best_weights_can_be_those_of_the_lowest_training_loss(prepared):
    _, progress, reports, _ = run(with_stages(prepared, keep="training"))
    assert progress[0].best_score == min(r.loss for r in reports if r.stage == "second")


def test_an_average_of_the_weights_is_kept_where_one_is_asked_for(prepared):
    stages = prepared.stages[:1]
    plain = run(dataclasses.replace(prepared, stages=stages))
    averaged = run(with_stages(dataclasses.replace(prepared, stages=stages), averaging=0.9))
    # the average does not change what is trained, only what is judged and kept
    last, smooth = plain[3][-1][0].weights, averaged[3][-1][0].weights
    if [r.rate for r in plain[2]] == [r.rate for r in averaged[2]]:
        assert same_bits(last.model, smooth.model)
    assert same_bits(last.model, last.average)
    assert not same_bits(smooth.model, smooth.average)
    score = validation_rmse(one(averaged[0]), prepared.validation)
    assert float(score) == pytest.approx(averaged[1][0].best_score, rel=1e-5)


def test_a_stage_ends_when_its_figure_has_not_fallen_for_its_patience(prepared):
    # a rate at which nothing changes: the first epoch stays the best
    still = dataclasses.replace(with_stages(prepared, patience=2), members=(Member(0, 1e-30),))
    _, progress, reports, _ = run(still)
    assert progress[0].outcome == "finished"
    assert progress[0].epochs == (3, 3)
    assert [(r.stage, r.epoch) for r in reports][:3] == [("first", k) for k in (1, 2, 3)]


def test_without_validation_records_the_training_loss_decides(pendulum, prepared):
    alone = plan(pendulum.split("train"), prepared.recipe)
    _, progress, reports, _ = run(alone)
    assert all(math.isnan(r.validation) for r in reports)
    assert progress[0].best_score == min(r.loss for r in reports if r.stage == "second")


def test_watching_the_validation_loss_needs_its_own_windows(pendulum, prepared):
    recipe = prepared.recipe.model_dump()
    recipe["stages"][0]["plateau"]["watch"] = "validation-loss"
    watching = plan(pendulum, tn.Recipe.model_validate(recipe))
    assert watching.stages[0].held is not None
    assert watching.stages[1].held is None
    _, progress, _, states = run(watching)
    assert progress[0].outcome == "finished"
    watched = [float(s.course.plateau.best[0]) for s, p in states if p[0].stage == 0]
    assert watched
    assert all(math.isfinite(b) for b in watched)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(whole, prepared, pendulum):
    assert same_bits(run(prepared)[0], whole[0])
    assert not same_bits(run(plan(pendulum, prepared.recipe, [Member(1)]))[0], whole[0])


@pytest.fixture(scope="module")
def longer(prepared) -> Plan:
    """Two members, several compiled calls a stage."""
    recipe = prepared.recipe.model_dump()
    recipe["stages"][0]["epochs"], recipe["stages"][1]["epochs"] = 12, 7
    return plan_of(recipe)


PAIR = (Member(0), Member(1))


def plan_of(recipe, members=PAIR, devices=None) -> Plan:
    from conftest import record

    data = tn.DataSet(
        "pair", (record("a", 200, 1, "train"), record("b", 160, 4, "validation", forced=True))
    )
    return plan(data, tn.Recipe.model_validate(recipe), members, devices)


@pytest.mark.parametrize("at", [0, 1, 2, 3, 5])
def test_a_resumed_training_ends_with_the_same_bits(longer, at):
    models, progress, reports, states = run(longer)
    again, ended, later, _ = run(longer, states[at])
    assert same_bits(again, models)
    assert [dataclasses.replace(p, seconds=0.0) for p in ended] == [
        dataclasses.replace(p, seconds=0.0) for p in progress
    ]
    assert later == reports[len(reports) - len(later) :]


def test_members_together_are_what_they_are_alone(longer):
    recipe = longer.recipe.model_dump()
    together, progress, reports, _ = run(longer)
    assert len(reports) == 2 * 19
    for m in (0, 1):
        alone, ended, _, _ = run(plan_of(recipe, [Member(m)]))
        pairs = zip(jax.tree.leaves(one(together, m)), jax.tree.leaves(one(alone)), strict=True)
        for ours, single in pairs:
            np.testing.assert_allclose(ours, single, rtol=1e-3, atol=1e-4)
        assert ended[0].best_score == pytest.approx(progress[m].best_score, rel=1e-3)


def test_windows_shared_among_devices_train_like_windows_on_one(longer):
    assert len(jax.devices()) == 2, "the tests' set-up makes two devices"
    recipe = longer.recipe.model_dump()
    shared = plan_of(recipe, [Member(0)])
    single = plan_of(recipe, [Member(0)], jax.devices()[:1])
    assert dict(shared.mesh.shape) == {"members": 1, "windows": 2}
    assert dict(single.mesh.shape) == {"members": 1, "windows": 1}
    pairs = zip(jax.tree.leaves(run(shared)[0]), jax.tree.leaves(run(single)[0]), strict=True)
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("members", "batch", "devices", "shape"),
    [
        (1, 32, 2, (1, 2)), (8, 32, 2, (2, 1)), (3, 32, 2, (1, 2)), (1, 32, 16, (1, 4)),
        (6, 32, 4, (3, 1)), (1, 4, 2, (1, 1)), (2, 32, 4, (2, 2)), (5, 256, 8, (5, 1)),
    ],
)  # fmt: skip
def test_devices_take_members_first_and_windows_with_what_is_left(members, batch, devices, shape):
    mesh = lay_out_devices(members, batch, jax.devices()[:1] * devices)
    assert tuple(mesh.shape.values()) == shape


def test_a_loss_that_is_not_finite_rolls_back_and_goes_on_at_a_lower_rate(prepared):
    wild = with_stages(dataclasses.replace(prepared, stages=prepared.stages[:1]), rate=2e19)
    models, progress, reports, _ = run(wild)
    events = [r for r in reports if r.event]
    assert len(events) == 6
    assert "back to the last good state with rate 1e+19" in events[0].event
    assert [r.rate for r in events] == [pytest.approx(2e19 / 2**k) for k in range(6)]
    assert all(math.isnan(r.loss) for r in events)
    assert progress[0].outcome.startswith("diverged")
    assert "Lower `rate`" in progress[0].outcome
    assert progress[0].rollbacks == 5
    assert same_bits(models, prepared.models)


def test_a_member_that_diverges_does_not_touch_the_other(longer):
    recipe = longer.recipe.model_dump()
    quiet, wild = plan_of(recipe), plan_of(recipe, [Member(0), Member(1, 1e23)])
    (calm, progress, _, _), (models, ended, reports, states) = run(quiet), run(wild)
    assert same_bits(one(calm, 0), one(models, 0))
    assert [p.outcome.split(":")[0] for p in ended] == ["finished", "diverged"]
    assert ended[0].epochs == progress[0].epochs == (12, 7)
    assert ended[1].epochs == (0,)
    assert {r.member for r in reports if r.event} == {1}
    # it stays where it was, also through the next stage
    assert same_bits(one(models, 1), one(wild.models, 1))
    assert states[-1][1][1].stage == 0


def test_after_a_rollback_training_can_finish(longer):
    one_stage = dataclasses.replace(longer, stages=longer.stages[:1])
    for rate in 10.0 ** np.arange(0.0, 3.0, 0.1):
        wild = with_stages(one_stage, rate=float(rate), plateau=None, patience=None)
        _, progress, reports, _ = run(wild)
        ends = [p.outcome == "finished" and p.rollbacks > 0 for p in progress]
        if any(ends):
            break
    else:
        pytest.fail("no rate that is too high only at first")
    m = ends.index(True)
    mine = [r for r in reports if r.member == m]
    events = [i for i, r in enumerate(mine) if r.event]
    assert len(events) == progress[m].rollbacks
    assert progress[m].epochs == (12,)
    # the epoch is done again, at half the rate
    assert mine[events[0]].epoch == mine[events[0] + 1].epoch
    assert mine[events[0] + 1].rate == pytest.approx(mine[events[0]].rate / 2)


def test_many_seeds_and_rates_are_fitted_at_once(pendulum, prepared):
    results = fit_many(pendulum, prepared.recipe, seeds=[0, 1], rates=[1.0, 0.5])
    assert [(r.seed, r.member.rate) for r in results] == [(0, 1.0), (0, 0.5), (1, 1.0), (1, 0.5)]
    assert all(r.finished and r.validation_rmse is not None for r in results)
    assert not same_bits(results[0].model, results[1].model)
    for seeds, rates in (((), (1.0,)), ((0, 0), (1.0,)), ((0,), (0.0,))):
        with pytest.raises(tn.InputError, match="different seeds"):
            fit_many(pendulum, prepared.recipe, seeds, rates)


def test_fit_returns_a_folded_model_that_computes_what_was_trained(whole, prepared):
    [result] = run_plan(prepared, Listener())
    assert result.finished
    assert result.model.folded() is result.model
    assert result.windows == tuple(s.windows.rows.shape[1] for s in prepared.stages)
    assert result.epochs == (5, 4)
    x, u = jnp.array([0.5, -0.2]), jnp.array([0.3])
    trained = jax.tree.map(lambda a: a[0], whole[0])
    np.testing.assert_allclose(result.model.step(x, u), trained.step(x, u), rtol=1e-4)


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
