"""Several models averaged in the acceleration at every step."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import CHANNELS, every_family, hybrid, network, neural_ode, physics
from swinging import CREEPING, DT, SWING, records, swing_model

import tustinnet as tn
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.models.contract import with_dtype
from tustinnet.models.parameters import Parameter
from tustinnet.simulate.rollout import rollouts
from tustinnet.store.header import read_description
from tustinnet.store.model_file import read_system_name

BAND = replace(CHANNELS, inputs=(replace(SWING.inputs[0], hold="band-limited"),))


def banded() -> list[tn.Experiment]:
    """Records whose input is band-limited."""
    return [replace(e, channels=replace(e.channels, inputs=BAND.inputs)) for e in records()[2:]]


# compiled once for members that are alike
@jax.jit
def stepped(model: tn.Model, x: jax.Array, u: jax.Array) -> jax.Array:
    return model.step(x, u)


def by_hand(
    models: Sequence[tn.Model], weights: np.ndarray, x0: np.ndarray, e: tn.Experiment
) -> np.ndarray:
    """The same as plain loops: each member with its own internal states and its own drive."""
    drives = [np.asarray(tn.input_signal(m, e).u) for m in models]
    own = np.split(x0[2:], np.cumsum([len(m.internal) for m in models])[:-1])
    states, shared = [x0], x0[:2]
    for k in range(len(drives[0])):
        each = [
            np.asarray(stepped(m, jnp.asarray(np.concatenate([shared, z])), jnp.asarray(u[k])))
            for m, z, u in zip(models, own, drives, strict=True)
        ]
        before = shared
        acceleration = sum(w * (x[1] - before[1]) for w, x in zip(weights, each, strict=True)) / DT
        moved = sum(w * (x[0] - before[0]) for w, x in zip(weights, each, strict=True))
        shared = np.array([before[0] + moved, before[1] + DT * acceleration])
        own = [x[2:] for x in each]
        states.append(np.concatenate([shared, *own]))
    return np.array(states)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("channels", "some"), [(CHANNELS, records), (BAND, banded)], ids=["held", "band-limited"]
)
def test_accelerations_are_averaged_and_internal_states_are_a_members_own(channels, some):
    e = some()[-1][:20]
    models = [with_dtype(m, np.float64) for m in every_family(channels)]
    weights = np.arange(1.0, 10.0)
    together = tn.committee(models, weights)
    x0 = 0.1 * np.random.default_rng(0).normal(size=together.state_size)
    found = tn.rollout(together, x0, tn.input_signal(together, e))
    expected = by_hand(models, weights / weights.sum(), x0, e)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)


@pytest.mark.thorough
@pytest.mark.parametrize("make", [network, hybrid, neural_ode])
def test_of_one_member_or_of_equal_ones_it_is_the_member(make):
    model = with_dtype(make(3), np.float64)
    e = records()[2]
    alone = tn.rollout(model, np.full(model.state_size, 0.2), tn.input_signal(model, e))
    for count in (1, 2, 3):
        together = tn.committee([model] * count)
        run = tn.rollout(together, np.full(together.state_size, 0.2), tn.input_signal(together, e))
        np.testing.assert_allclose(run[:, :2], alone[:, :2], rtol=1e-9, atol=1e-11)
        assert together.state_size == 2 + count * len(model.internal)


def test_a_member_that_counts_nothing_changes_nothing():
    first, second = (with_dtype(network(i), np.float64) for i in (0, 1))
    e, x0 = records()[2], np.array([0.3, 0.1])
    run = tn.rollout(tn.committee([first, second], [1, 0]), x0, e.held_inputs)
    np.testing.assert_allclose(run, tn.rollout(first, x0, e.held_inputs), rtol=1e-9, atol=1e-11)
    run = tn.rollout(tn.committee([first, second], [0, 7]), x0, e.held_inputs)
    np.testing.assert_allclose(run, tn.rollout(second, x0, e.held_inputs), rtol=1e-9, atol=1e-11)


@pytest.mark.thorough
def test_members_are_kept_as_they_are_and_folded_ones_step_alike():
    models = every_family()
    together = tn.committee(models)
    for given, kept in zip(models, together.members, strict=True):
        leaves = zip(jax.tree.leaves(given), jax.tree.leaves(kept), strict=True)
        assert jax.tree.structure(given) == jax.tree.structure(kept)
        assert all(np.array_equal(a, b) for a, b in leaves)
    folded = together.simplify()
    x, u = jnp.full(together.state_size, 0.2), jnp.array([0.3])
    np.testing.assert_allclose(stepped(folded, x, u), stepped(together, x, u), rtol=1e-4)


@pytest.mark.thorough
def test_internal_states_have_the_number_of_their_member_and_the_longest_warm_up_counts():
    together = tn.committee(every_family())
    assert together.internal == (
        "angle, relaxing in 0.5 s 1",
        "creep 2",
        "creep 3",
        "hidden 0 4",
        "hidden 1 4",
        "hidden 2 4",
        "angle, relaxing in 0.5 s 5",
        "state 0 6",
        "creep 8",
    )
    assert len(set(together.internal)) == together.state_size - 2
    assert together.warm_up == 8


@pytest.mark.thorough
def test_what_all_agree_on_stays_in_single_precision():
    still = [with_dtype(network(i).with_zero_output(), np.float32) for i in range(7)]
    together = tn.committee(still)
    x = jnp.array([3.3, 0.0], jnp.float32)
    run = tn.rollout(together, x, np.zeros((2000, 1), np.float32))
    assert run.dtype == np.float32
    np.testing.assert_array_equal(run, np.tile(x, (2001, 1)))


@pytest.mark.thorough
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_batches_and_single_runs_are_the_same(dtype):
    together = with_dtype(tn.committee([hybrid(0), network(1), hybrid(2)], [1, 2, 3]), dtype)
    x0 = 0.1 * np.random.default_rng(0).normal(size=(3, together.state_size)).astype(dtype)
    u = np.random.default_rng(1).normal(size=(3, 12, 1)).astype(dtype)
    batch = rollouts(together, x0, u)
    assert batch.dtype == dtype
    for x, drive, run in zip(x0, u, batch, strict=True):
        np.testing.assert_allclose(run, tn.rollout(together, x, drive), rtol=1e-4, atol=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize("start", ["file", "derived-6", "model-20", "warm-up-20"])
def test_it_is_evaluated_from_every_start(start):
    together = tn.committee([hybrid(0), network(1, taps=(0, 1)), hybrid(2)])
    scores = tn.evaluate(together, records(), start)
    assert np.isfinite([score.rmse for score in scores]).all()
    alone = tn.evaluate(hybrid(0), records(), start)
    alike = tn.evaluate(tn.committee([hybrid(0), hybrid(0)]), records(), start)
    if start != "model-20":  # whose search is over other internal states
        for one, two in zip(alone, alike, strict=True):
            assert two.rmse == pytest.approx(one.rmse, rel=1e-6)


def test_it_is_linearised_stepped_by_any_period_and_compiled():
    models = [physics(gravity=1.5), physics(gravity=1.2)]
    together = tn.committee(models, [3, 1])
    x, u = jnp.array([0.2, 0.1, 0.3, 0.3]), jnp.array([0.4])
    line = tn.linearize(together, x, u)
    own = [tn.linearize(m, x[:3], u) for m in models]
    mean = 0.75 * own[0].a[:2, :2] + 0.25 * own[1].a[:2, :2]
    np.testing.assert_allclose(line.a[:2, :2], mean, rtol=1e-9)
    following = stepped(together, x, u)
    compiled = tn.compiled_step(together)(np.asarray(x), np.asarray(u))
    np.testing.assert_allclose(compiled, following, rtol=1e-9)
    np.testing.assert_allclose(jax.jit(lambda: together.advance(x, u, DT))(), following, rtol=1e-12)
    with pytest.raises(tn.InputError, match="steps from timestamp to timestamp"):
        tn.committee([physics(), network(0)]).advance(jnp.zeros(3), u, 0.01)


GROUPED = replace(
    SWING,
    name="loaded swing",
    parameters=(Parameter("inertia", "kg m^2", 0.05, 0.01, 0.2, per="load"), *SWING.parameters[1:]),
)


def loaded(seed: int) -> tn.HybridModel:
    values = {"inertia[light]": 0.03 + 0.01 * seed, "inertia[heavy]": 0.1}
    named = {p.name: p.nominal for p in GROUPED.parameters if p.per is None} | values
    model = GROUPED.model({k: jnp.asarray(v) for k, v in named.items()})
    return tn.HybridModel(tn.discretise(model, DT), network(seed))


@pytest.mark.thorough
def test_members_take_the_values_of_a_records_group():
    together = tn.committee([loaded(0), loaded(1)])
    loads = ("light", "heavy", "light", "heavy")
    some = [replace(e, groups=(("load", of),)) for e, of in zip(records(), loads, strict=True)]
    e, models = (
        some[0][:20],
        [with_dtype(loaded(i).for_record(some[0]), np.float64) for i in (0, 1)],
    )
    x0 = np.array([0.3, 0.0])
    found = tn.rollout(together.for_record(e), x0, e.held_inputs)
    np.testing.assert_allclose(found, by_hand(models, np.array([0.5, 0.5]), x0, e), rtol=1e-6)
    assert len(tn.evaluate(together, some, "file")) == 4
    with pytest.raises(tn.InputError, match="load"):
        tn.evaluate(together, records(), "file")


# --- files ---


def arrays_of(model: tn.Model) -> list[bytes]:
    return [np.asarray(a).tobytes() for a in jax.tree.leaves(model)]


def test_a_file_gives_it_back_with_one_system_for_all(tmp_path):
    together = tn.committee(every_family(), range(1, 10))
    file = tmp_path / "committee.safetensors"
    tn.save(together, file)
    assert read_system_name(file) == "creeping swing"
    again = tn.load_model(file, CREEPING)
    assert isinstance(again, tn.Committee)
    assert jax.tree.structure(again) == jax.tree.structure(together)
    assert arrays_of(again) == arrays_of(together)
    np.testing.assert_allclose(again.weights, np.arange(1, 10) / 45, rtol=1e-12)
    tn.save(again, tmp_path / "again.safetensors")
    assert (tmp_path / "again.safetensors").read_bytes() == file.read_bytes()
    with pytest.raises(tn.InputError, match="'creeping swing', which the package does not have"):
        tn.load_model(file)


def test_a_packaged_system_is_found_and_networks_take_none(tmp_path):
    system = tn.load_system("qube-servo2-naive")
    values = {k: jnp.asarray(v) for k, v in system.nominal().items()}
    grey = [
        tn.discretise(system.model({k: i * v for k, v in values.items()}), 0.01) for i in (1, 2)
    ]
    tn.save(tn.committee(grey), tmp_path / "grey.safetensors")
    found = tn.load_model(tmp_path / "grey.safetensors")
    assert isinstance(found, tn.Committee)
    tn.save(tn.committee([network(0), network(1)]), tmp_path / "nets.safetensors")
    assert arrays_of(tn.load_model(tmp_path / "nets.safetensors")) == arrays_of(
        tn.committee([network(0), network(1)])
    )
    with pytest.raises(tn.InputError, match="not applicable to a model of kind 'committee'"):
        tn.load_model(tmp_path / "nets.safetensors", CREEPING)


def test_a_file_is_of_one_system(tmp_path):
    other = replace(CREEPING, name="another")
    together = tn.committee([physics(), physics(system=other)])
    with pytest.raises(tn.InputError, match="members of the systems creeping swing, another"):
        tn.save(together, tmp_path / "two.safetensors")


def test_show_tells_what_members_of_a_structure_say_alike(tmp_path):
    file = tmp_path / "committee.safetensors"
    tn.save(tn.committee([hybrid(0), network(1), hybrid(2, gravity=1.2)], [2, 1, 1]), file)
    _, lines = read_description(file)
    told = [text for word, text in lines if word == "members"]
    assert told == ["hybrid: 1, 3; weight 0.5, 0.25", "tustin-net: 2; weight 0.25"]
    words = [word for word, _ in lines]
    assert words.count("network") == 2
    assert "values" not in words  # which differ


# --- what is refused ---


@pytest.mark.parametrize(
    "weights",
    [[1], [1, 2, 3], [1, -1], [1, np.nan], [np.inf, 1], [0, 0], [1e308, 1e308], [[1], [1]]],
)
@pytest.mark.usefixtures("unchecked")
def test_weights_that_are_none_are_refused(weights):
    with pytest.raises(tn.InputError, match="2 models, weights"):
        tn.committee([network(0), network(1)], weights)


@pytest.mark.usefixtures("unchecked")
def test_models_that_cannot_be_averaged_are_refused():
    def channels(**changes):
        return replace(CHANNELS, **changes)

    delayed = channels(inputs=(replace(SWING.inputs[0], delay=0.003),))
    cases: list[tuple[Any, str]] = [
        (network(1, channels(dt=0.01)), "model 2 of the committee: sampling period 0.01 s"),
        (network(1, channels(coordinates=(tn.Coordinate("other", "angular"),))), "coordinates oth"),
        (network(1, BAND), "inputs voltage .*band-limited"),
        (network(1, delayed), r"delays of the inputs of \[0.003\] s"),
        (tn.committee([network(1)]), "model 2 of the committee: a committee"),
        (swing_model(), "a model that steps from sample to sample"),
    ]
    for wrong, told in cases:
        with pytest.raises(tn.InputError, match=told):
            tn.committee([network(0), wrong])
    with pytest.raises(tn.InputError, match="0 models"):
        tn.committee([])
    with pytest.raises(tn.InputError, match="what `input_signal` makes of a record"):
        tn.rollout(tn.committee(every_family()), np.zeros(11), np.zeros((4, 4, 1)))


@pytest.mark.parametrize("kind", ["committee", "hybrid"])
def test_no_recipe_makes_one(kind):
    model = {"kind": kind} | ({"correction": {"kind": "committee"}} if kind == "hybrid" else {})
    with pytest.raises(tn.InputError, match="kind 'committee'"):
        read_recipe({"name": "mine", "model": model, "stages": []})
