"""The training loop: stages, freezing, best weights, resuming, rolling back."""

import dataclasses
import math
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.fits.fit import fit_many
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.gradient import loop
from tustinnet.fitting.gradient.epoch import (
    compute_validation_rmse,
)
from tustinnet.fitting.gradient.layout import lay_out_devices
from tustinnet.fitting.gradient.loop import train
from tustinnet.fitting.gradient.plan import TrainingPlan, make_plan, restore_untrained
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.gradient.train import describe_kept_epoch, train_plan
from tustinnet.fitting.listener import EpochReport, Listener
from tustinnet.fitting.task import Member, Task, make_task


def run(prepared: TrainingPlan, resume=None):
    """Trains and keeps everything that listeners were told."""
    reports: list[EpochReport] = []
    states: list[tuple[TrainingState, tuple[Progress, ...]]] = []
    listener = Listener(on_epoch=reports.append, on_state=lambda s, p: states.append((s, p)))
    models, progress = train(prepared, listener, resume)
    return models, progress, reports, states


ALONE = (Member(),)


def planned(data, recipe, members=ALONE, devices=None) -> TrainingPlan:
    """A plan for a recipe on a data set."""
    return make_plan(make_task(data, recipe, members), devices)


def one(tree, member=0):
    """A member's part."""
    return jax.tree.map(lambda a: a[member], eqx.filter(tree, eqx.is_array))


def with_stages(prepared: TrainingPlan, **update) -> TrainingPlan:
    """The same plan with other values in the recipe of every stage."""
    stages = tuple(
        dataclasses.replace(s, recipe=s.recipe.model_copy(update=update)) for s in prepared.stages
    )
    return dataclasses.replace(prepared, stages=stages)


def first_stage(prepared: TrainingPlan) -> TrainingPlan:
    """The same plan without its second stage, where one says as much: each is a program."""
    return dataclasses.replace(prepared, stages=prepared.stages[:1])


def free_runs(prepared: TrainingPlan, model, member=0) -> float:
    """Mean RMSE of a member's validation free runs."""
    assert prepared.validation_runs is not None
    mine = prepared.run_indices[member], prepared.run_counts[member]
    return float(compute_validation_rmse(model, prepared.validation_runs, *mine))


def same_bits(a, b) -> bool:
    left, right = (jax.tree.leaves(eqx.filter(t, eqx.is_array)) for t in (a, b))
    return all(bits(x) == bits(y) for x, y in zip(left, right, strict=True))


def bits(array) -> bytes:
    if jnp.issubdtype(array.dtype, jax.dtypes.prng_key):
        array = jax.random.key_data(array)
    return np.asarray(array).tobytes()


@pytest.fixture(scope="module")
def prepared(pendulum, tmp_path_factory) -> TrainingPlan:
    from conftest import SMALL_RECIPE

    path = tmp_path_factory.mktemp("recipe") / "small.toml"
    path.write_text(SMALL_RECIPE)
    return planned(pendulum, path)


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
    before, after = begun.network, model.network
    assert same_bits(
        (before.stem, before.hidden[0], before.scaling),
        (after.stem, after.hidden[0], after.scaling),
    )
    assert not same_bits(before.hidden[1], after.hidden[1])
    assert not same_bits(before.output, after.output)


@pytest.mark.parametrize("frozen", [0, 1, 2])
def test_the_output_layer_always_trains_and_the_scaling_never(prepared, frozen):
    model = one(prepared.models)
    stage = prepared.stages[0].recipe.model_copy(update={"frozen_layers": frozen})
    mask = prepared.recipe.family.trainable_mask(model, stage).network
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
    assert float(state.progress.plateau.rate[0]) == pytest.approx(1e-3)


@pytest.mark.thorough
def test_the_best_weights_are_those_of_the_lowest_validation_free_run(whole, prepared):
    model, progress, reports, _ = whole
    lowest = min(r.validation for r in reports if r.stage == "second")
    assert progress[0].best_score == pytest.approx(lowest)
    assert free_runs(prepared, one(model)) == pytest.approx(lowest, rel=1e-5)


def mirrored_records(prepared: TrainingPlan) -> TrainingPlan:
    """The same plan with records of the mirrored system."""
    return dataclasses.replace(prepared, records=jax.tree.map(jnp.negative, prepared.records))


@pytest.mark.thorough
def test_a_mirrored_window_is_that_of_the_mirrored_records(prepared, monkeypatch):
    # the clip limits nothing: it keeps these programs apart from those of other tests
    quick = {"epochs": 2, "clip": 1e6, "keep": "training", "plateau": None}
    alone = first_stage(prepared)
    plain = with_stages(alone, mirror=False, **quick)
    theirs = run(mirrored_records(plain))[0]
    with monkeypatch.context() as every_window_mirrored:
        every_window_mirrored.setattr(
            jax.random, "rademacher", lambda key, shape, dtype: -jnp.ones(shape, dtype)
        )
        ours = run(with_stages(alone, mirror=True, **quick))[0]
    for a, b in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)
    unlike = run(plain)[0]
    assert isinstance(ours, tn.TustinNet)
    assert isinstance(unlike, tn.TustinNet)
    mine, plainly = ours.network.output.weight, unlike.network.output.weight
    assert not np.allclose(mine, plainly, rtol=1e-2, atol=1e-3)


@pytest.mark.thorough
def test_the_best_weights_can_be_those_of_the_lowest_training_loss(prepared):
    _, progress, reports, _ = run(with_stages(first_stage(prepared), keep="training"))
    assert progress[0].best_score == min(r.loss for r in reports)


@pytest.fixture(scope="module")
def decaying(prepared) -> TrainingPlan:
    """Two members whose rate decays and whose last epochs are kept; several compiled calls."""
    changes = {
        "stages.0.epochs": 12,
        "stages.1.epochs": 7,
        "stages.*.decay": "cosine",
        "stages.*.keep": "last",
        "stages.*.averaging": 0.9,
    }
    plain = prepared.recipe.with_stages(plateau=None)
    return plan_of(tn.read_recipe(plain, [f"{key}={value}" for key, value in changes.items()]))


@pytest.fixture(scope="module")
def decaying_whole(decaying):
    return run(decaying)


@pytest.mark.thorough
def test_the_weights_of_the_last_epoch_can_be_kept(decaying_whole):
    model, progress, _, states = decaying_whole
    assert [p.best_epoch for p in progress] == [7, 7]
    assert same_bits(model, states[-1][0].weights.average)


def test_a_rate_that_decays_is_told_epoch_by_epoch(decaying_whole):
    _, _, reports, _ = decaying_whole
    told = [r.rate for r in reports if r.stage == "first" and r.member == 0]
    assert told == pytest.approx(3e-3 * (1 + np.cos(np.pi * np.arange(12) / 12)) / 2, rel=1e-5)


@pytest.mark.parametrize("at", [0, 1, 3])
def test_a_resumed_training_with_a_decaying_rate_ends_with_the_same_bits(
    decaying, decaying_whole, at
):
    model, _, reports, states = decaying_whole
    again, _, later, _ = run(decaying, states[at])
    assert same_bits(again, model)
    assert later == reports[len(reports) - len(later) :]


@pytest.mark.thorough
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
    score = free_runs(prepared, one(averaged[0]))
    assert score == pytest.approx(averaged[1][0].best_score, rel=1e-5)


@pytest.mark.thorough
def test_a_stage_ends_when_its_figure_has_not_fallen_for_its_patience(prepared):
    # a rate at which nothing changes: the first epoch stays the best
    still = prepared.task.with_members([Member(0, 1e-30)])
    patient = dataclasses.replace(with_stages(first_stage(prepared), patience=2), task=still)
    _, progress, reports, _ = run(patient)
    assert progress[0].outcome == "finished"
    assert progress[0].epochs == (3,)
    assert [(r.stage, r.epoch) for r in reports] == [("first", k) for k in (1, 2, 3)]


@pytest.mark.thorough
def test_without_validation_records_the_training_loss_decides(pendulum, prepared):
    alone = planned(pendulum.split("train"), prepared.recipe)
    _, progress, reports, _ = run(first_stage(alone))
    assert all(math.isnan(r.validation) for r in reports)
    assert progress[0].best_score == min(r.loss for r in reports)


@pytest.mark.thorough
def test_watching_the_validation_loss_needs_its_own_windows(pendulum, prepared):
    recipe = tn.read_recipe(prepared.recipe, ["stages.0.plateau.watch=validation-loss"])
    watching = planned(pendulum, recipe)
    assert watching.stages[0].validation_rows is not None
    assert watching.stages[1].validation_rows is None
    _, progress, _, states = run(first_stage(watching))
    assert progress[0].outcome == "finished"
    watched = [float(s.progress.plateau.best[0]) for s, p in states if p[0].stage == 0]
    assert watched
    assert all(math.isfinite(b) for b in watched)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(whole, prepared, pendulum):
    assert same_bits(run(prepared)[0], whole[0])
    assert not same_bits(run(planned(pendulum, prepared.recipe, [Member(1)]))[0], whole[0])


@pytest.fixture(scope="module")
def longer(prepared) -> TrainingPlan:
    """Two members, several compiled calls a stage."""
    return plan_of(tn.read_recipe(prepared.recipe, ["stages.0.epochs=12", "stages.1.epochs=7"]))


PAIR = (Member(0), Member(1))


def plan_of(recipe, members=PAIR, devices=None) -> TrainingPlan:
    from conftest import record

    data = tn.DataSet(
        "pair", (record("a", 200, 1, "train"), record("b", 160, 4, "validation", forced=True))
    )
    return planned(data, recipe, members, devices)


@pytest.fixture(scope="module")
def longer_whole(longer):
    return run(longer)


@pytest.mark.parametrize("at", [0, 1, 2, 3, 5])
def test_a_resumed_training_ends_with_the_same_bits(longer, longer_whole, at):
    models, progress, reports, states = longer_whole
    again, ended, later, _ = run(longer, states[at])
    assert same_bits(again, models)
    assert [dataclasses.replace(p, seconds=0.0) for p in ended] == [
        dataclasses.replace(p, seconds=0.0) for p in progress
    ]
    assert later == reports[len(reports) - len(later) :]


def test_a_training_with_long_epochs_can_stop_after_each_of_them(longer, longer_whole, monkeypatch):
    assert longer_whole[3][0][1][0].epoch == 1  # the first call says how long an epoch takes
    monkeypatch.setattr(loop, "_CALL", 0.0)
    models, _, _, states = run(longer)
    assert [p[0].epoch for _, p in states][:3] == [1, 2, 3]
    assert same_bits(models, longer_whole[0])


@pytest.mark.thorough
def test_members_together_are_what_they_are_alone(longer, longer_whole):
    recipe = longer.recipe
    together, progress, reports, _ = longer_whole
    assert len(reports) == 2 * 19
    for m in (0, 1):
        alone, ended, _, _ = run(plan_of(recipe, [Member(m)]))
        pairs = zip(jax.tree.leaves(one(together, m)), jax.tree.leaves(one(alone)), strict=True)
        for ours, single in pairs:
            np.testing.assert_allclose(ours, single, rtol=1e-3, atol=1e-4)
        assert ended[0].best_score == pytest.approx(progress[m].best_score, rel=1e-3)


@pytest.mark.thorough
def test_windows_shared_among_devices_train_like_windows_on_one(longer):
    assert len(jax.devices()) == 2, "the tests' set-up makes two devices"
    recipe = longer.recipe
    shared = first_stage(plan_of(recipe, [Member(0)]))
    single = first_stage(plan_of(recipe, [Member(0)], jax.devices()[:1]))
    assert dict(shared.mesh.shape) == {"members": 1, "windows": 2}
    assert dict(single.mesh.shape) == {"members": 1, "windows": 1}
    pairs = zip(jax.tree.leaves(run(shared)[0]), jax.tree.leaves(run(single)[0]), strict=True)
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("members", "batch", "devices", "shape"),
    [
        (1, 32, 2, (1, 2)),
        (8, 32, 2, (2, 1)),
        (3, 32, 2, (1, 2)),
        (1, 32, 16, (1, 4)),
        (6, 32, 4, (3, 1)),
        (1, 4, 2, (1, 1)),
        (2, 32, 4, (2, 2)),
        (5, 256, 8, (5, 1)),
    ],
)
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


def test_a_member_that_diverges_does_not_touch_the_other(longer, longer_whole):
    wild = plan_of(longer.recipe, [Member(0), Member(1, 1e23)])
    (calm, progress, _, _), (models, ended, reports, states) = longer_whole, run(wild)
    assert same_bits(one(calm, 0), one(models, 0))
    assert [p.outcome.split(":")[0] for p in ended] == ["finished", "diverged"]
    assert ended[0].epochs == progress[0].epochs == (12, 7)
    assert ended[1].epochs == (0,)
    assert {r.member for r in reports if r.event} == {1}
    # it stays where it was, also through the next stage
    assert same_bits(one(models, 1), one(wild.models, 1))
    assert states[-1][1][1].stage == 0


@pytest.mark.thorough
def test_after_a_rollback_training_can_finish(longer):
    one_stage = first_stage(longer)
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


@pytest.mark.thorough
def test_many_seeds_and_rates_are_fitted_at_once(pendulum, prepared):
    recipe = prepared.recipe.model_copy(update={"stages": prepared.recipe.stages[:1]})
    results = fit_many(pendulum, recipe, seeds=[0, 1], rates=[1.0, 0.5])
    assert [(r.seed, r.member.rate) for r in results] == [(0, 1.0), (0, 0.5), (1, 1.0), (1, 0.5)]
    assert all(r.finished and r.validation_rmse is not None for r in results)
    assert not same_bits(results[0].model, results[1].model)
    for seeds, rates in (((), (1.0,)), ((0, 0), (1.0,)), ((0,), (0.0,))):
        with pytest.raises(tn.InputError, match="different seeds"):
            fit_many(pendulum, prepared.recipe, seeds, rates)


def test_a_task_tells_its_plan_before_training_and_goes_on_from_a_state(prepared, whole):
    model, _, _, states = whole
    plans: list[TrainingPlan | Task] = []
    later = Member(5)
    task = prepared.task.with_members([later, *prepared.members])
    new, resumed = fit_task(task, Listener(on_begin=plans.append), [(prepared.members, states[0])])
    assert [p.members for p in plans if isinstance(p, TrainingPlan)] == [(later,), prepared.members]
    assert (new.member, resumed.member) == (later, prepared.members[0])
    assert same_bits(resumed.model, restore_untrained(prepared, 0, one(model)).simplify())


@pytest.mark.thorough
def test_fit_returns_a_folded_model_that_computes_what_was_trained(whole, prepared):
    [result] = train_plan(prepared)
    assert result.finished
    assert result.model.simplify() is result.model
    assert result.detail("windows") == [s.windows.rows.shape[1] for s in prepared.stages]
    assert result.details["training"]["epochs"] == [5, 4]
    x, u = jnp.array([0.5, -0.2]), jnp.array([0.3])
    trained = jax.tree.map(lambda a: a[0], whole[0])
    np.testing.assert_allclose(result.model.step(x, u), trained.step(x, u), rtol=1e-4)


@pytest.mark.thorough
def test_training_learns_the_small_pendulum(pendulum):
    """A model of a system seen in training must beat a model that knows nothing."""
    changes = ["epochs=70", "rate=3e-3", "windows.count=300"]
    recipe = tn.read_recipe("standard", ["model.hidden=[24]", *(f"stages.0.{c}" for c in changes)])
    result = tn.fit(pendulum, recipe, seed=0)
    scores = tn.evaluate(result.model, list(pendulum.split("validation")), "derived-6")
    assert all(s.nrmse[0] < 0.35 for s in scores), [s.nrmse for s in scores]


@pytest.mark.thorough
def test_linear_coordinates_train_too():
    t = np.arange(400) * 0.02
    q = np.column_stack([0.3 * np.sin(2 * t), np.cos(3 * t)])
    coordinates = [tn.Coordinate("slide", "linear"), tn.Coordinate("angle", "angular")]
    data = tn.DataSet("mixed", (tn.from_arrays(q, dt=0.02, coordinates=coordinates),))
    changes = ["model.hidden=[4]", "stages.0.epochs=1", "stages.0.windows.count=50"]
    result = tn.fit(data, tn.read_recipe("standard", changes))
    assert result.finished
    assert result.validation_rmse is None


def test_the_published_scaling_is_refused_for_linear_coordinates():
    q = np.sin(np.arange(300) * 0.1)
    data = tn.DataSet(
        "slide", (tn.from_arrays(q, dt=0.1, coordinates=[tn.Coordinate("x", "linear")]),)
    )
    with pytest.raises(tn.InputError, match="published scaling"):
        tn.fit(data, "paper-code-standard")


@pytest.mark.parametrize(
    ("kept", "said"),
    [(98, "one of the last.*`changes=` stages.1.epochs=200"), (3, "one of the first"), (50, "")],
)
def test_a_kept_epoch_at_an_end_of_the_last_stage_is_told(prepared, kept, said):
    progress = Progress(stage=1, epochs=(5, 100), best_epoch=kept, outcome="finished")
    found = " ".join(map(str, describe_kept_epoch(with_stages(prepared, epochs=100), progress)))
    assert bool(found) is bool(said)
    assert re.search(said, found)
    assert not said or "validation" in found
    assert (
        describe_kept_epoch(
            with_stages(prepared, epochs=100), Progress(best_epoch=kept, outcome="")
        )
        == ()
    )
    assert describe_kept_epoch(with_stages(prepared, epochs=100, keep="last"), progress) == ()
