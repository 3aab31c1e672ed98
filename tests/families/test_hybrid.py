"""Physics and a network that corrects it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import CREEPING, DT, SWING, TRUTH, swing_model

import tustinnet as tn
from tustinnet.families.euler_lagrange import without_ranges
from tustinnet.families.hybrid import HybridModel
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.gradient.plan import groups_alike, make_plan
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.fitting.task import Fold, Member, Task, make_task
from tustinnet.models.blocks import Scaling
from tustinnet.models.contract import with_dtype
from tustinnet.models.integrate import Discretised
from tustinnet.simulate.along import states_along
from tustinnet.simulate.rollout import rollout, rollouts
from tustinnet.store.model_file import save
from tustinnet.systems.mechanism import MECHANISM

SYSTEMS = {"swing": SWING, "creeping swing": CREEPING}  # without and with an internal state


def physics(name: str = "swing"):
    return tn.discretise(swing_model(system=SYSTEMS[name]), DT)


def network(model, seed: int = 0, times: tuple[float, ...] = ()):
    one = jnp.ones(1, jnp.float32)
    scaling = Scaling(
        jnp.zeros(0), jnp.zeros(0), 5 * one, one, 0.1 * one, jnp.ones(len(times), jnp.float32)
    )
    return random_tustin_net(
        model.channels,
        scaling,
        jax.random.key(seed),
        hidden=(6, 5),
        stem=4,
        output_bias=True,
        relaxation_times=times,
    )


@pytest.mark.parametrize(("name", "fades"), [("swing", False), ("creeping swing", True)])
def test_without_a_correction_it_is_the_physics(name, fades):
    model = physics(name)
    silent = HybridModel(model, network(model).with_zero_output(), fades_at_rest=fades)
    assert silent.state_size == model.state_size
    x0, u = np.linspace(0.1, 0.5, model.state_size), np.full((15, 1), 0.3)
    np.testing.assert_array_equal(rollout(silent, x0, u), rollout(model, x0, u))


def test_a_correction_enters_velocities_and_by_the_trapezoidal_rule_positions():
    model = physics("creeping swing")
    correction = with_dtype(network(model), np.float64)
    corrected = HybridModel(model, correction)
    x, u = jnp.asarray(np.linspace(0.1, 0.5, model.state_size)), jnp.array([0.3])
    added = corrected.step(x, u) - model.step(x, u)
    f = correction.acceleration(x[:2], u)
    np.testing.assert_allclose(added[1:2], DT * f, rtol=1e-9)
    np.testing.assert_allclose(added[:1], DT**2 / 2 * f, rtol=1e-6)
    np.testing.assert_array_equal(added[2:], 0)
    folded = corrected.simplify()
    assert isinstance(folded, HybridModel)
    assert isinstance(folded.correction, tn.TustinNet)
    assert folded.correction.network.stem is None
    np.testing.assert_allclose(folded.step(x, u), corrected.step(x, u), rtol=1e-12)


def test_the_network_may_remember_beside_the_physics():
    model = physics("creeping swing")
    correction = with_dtype(network(model, times=(0.5,)), np.float64)
    corrected = HybridModel(model, correction)
    assert corrected.internal == ("creep", "angle, relaxing in 0.5 s")
    x, u = jnp.array([0.4, 1.0, 0.2, 0.3]), jnp.array([0.3])
    following = corrected.step(x, u)
    f = correction.acceleration(x[jnp.array([0, 1, 3])], u)
    plain = model.step(x[:3], u)
    np.testing.assert_allclose(following[1], plain[1] + DT * f[0], rtol=1e-12)
    np.testing.assert_allclose(following[2], plain[2], rtol=1e-12)
    speed = (x[1:2] + following[1:2]) / 2
    np.testing.assert_allclose(following[3:], correction.relax(x[3:], speed), rtol=1e-12)


@pytest.mark.thorough
def test_a_correction_that_fades_at_rest_leaves_a_free_integrator_where_it_is(tmp_path):
    free = dataclasses.replace(SWING, name="free", potential=None)
    model = tn.discretise(swing_model(system=free), DT)
    network_of_it = with_dtype(network(model), np.float64)
    x0, u = jnp.array([0.7, 0.0]), jnp.zeros((200, 1))
    drifting = rollout(HybridModel(model, network_of_it), x0, u)
    assert abs(float(drifting[-1, 0]) - 0.7) > 1e-3
    fading = HybridModel(model, network_of_it, fades_at_rest=True)
    np.testing.assert_array_equal(rollout(fading, x0, u), np.tile(x0, (201, 1)))
    # in motion it is the correction as it was
    fast, drive = jnp.array([0.7, 50.0]), jnp.array([1.0])
    by_physics = model.step(fast, drive)
    np.testing.assert_allclose(
        fading.step(fast, drive) - by_physics,
        HybridModel(model, network_of_it).step(fast, drive) - by_physics,
        rtol=0.03,
    )
    tn.save(fading, tmp_path / "fading.safetensors")
    loaded = tn.load_model(tmp_path / "fading.safetensors", free)
    assert isinstance(loaded, tn.HybridModel)
    assert loaded.fades_at_rest


@pytest.mark.thorough
def test_its_batches_have_the_gradients_of_the_plain_scan():
    model = physics("creeping swing")
    corrected = with_dtype(HybridModel(model, network(model)), np.float64)
    x0 = np.random.default_rng(0).normal(size=(3, model.state_size)) * 0.3
    u = np.full((3, 12, 1), 0.5)

    def loss(simulate):
        return jax.jit(jax.grad(lambda m: jnp.mean(simulate(m.simplify())[..., :1] ** 2)))(
            corrected
        )

    ours = loss(lambda m: rollouts(m, x0, u))
    plain = loss(lambda m: jax.vmap(lambda x, v: rollout(m, x, v))(x0, u))
    pairs = zip(jax.tree.leaves(ours), jax.tree.leaves(plain), strict=True)
    for a, b in pairs:
        assert jnp.linalg.norm(a - b) <= 1e-10 * jnp.linalg.norm(b)


def test_a_network_of_another_system_is_refused():
    model = physics()
    channels = dataclasses.replace(model.channels, coordinates=(tn.Coordinate("b", "angular"),))
    other = dataclasses.replace(network(model), channels=channels)
    with pytest.raises(tn.InputError, match="another system"):
        HybridModel(model, other)


def test_internal_states_follow_the_record_they_were_simulated_with():
    model = physics("creeping swing")
    u = np.sin(np.arange(61) * 0.2)[:, None]
    states = np.asarray(rollout(model, np.array([2.0, 0.0, 0.0]), u[:-1]))
    whole = tn.from_arrays(
        states[:, :1],
        u,
        v=states[:, 1:2],
        dt=DT,
        coordinates=model.coordinates,
        inputs=model.inputs,
    )
    # records of unequal length go side by side
    found, beginning = states_along(model, [whole, whole[:25]], "file")
    np.testing.assert_array_equal(found[:, :2], states[:, :2])
    np.testing.assert_allclose(found[:, 2:], states[:, 2:], rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(beginning, found[:25])
    assert np.ptp(found[:, 2]) > 0
    (without,) = states_along(physics(), [whole], "file")
    np.testing.assert_array_equal(without, states[:, :2])


def test_internal_states_follow_what_was_measured_not_what_the_model_says():
    model = physics("creeping swing")
    q, v = np.cos(np.arange(12) * 0.3)[:, None], np.full((12, 1), 0.7)
    e = tn.from_arrays(
        q, np.ones(12), v=v, dt=DT, coordinates=model.coordinates, inputs=model.inputs
    )
    state, expected = np.zeros(3), []
    for k in range(12):
        state[:2] = q[k, 0], v[k, 0]
        expected.append(state.copy())
        state = np.array(rollout(model, state, e.u[k : k + 1])[1])
    np.testing.assert_allclose(states_along(model, [e], "file")[0], expected, rtol=1e-12)


RECIPE = {
    "name": "short",
    "start": "model-12",
    "model": {
        "kind": "hybrid",
        "correction": {"kind": "tustin-net", "hidden": [6], "output_bias": True},
    },
    "stages": [
        {
            "name": "one",
            "windows": {"draw": "strided", "length": 10, "count": 60},
            "rate": 3e-3,
            "epochs": 10,
            "batch": 16,
            "averaging": 0.9,
        }
    ],
}


@pytest.fixture(scope="module")
def records() -> tn.DataSet:
    """Free runs of a system that is heavier than the physics knows."""
    truth = tn.discretise(swing_model({"gravity": 1.3 * TRUTH["gravity"]}), DT)
    made = []
    for i, split in enumerate(["train", "train", "validation"]):
        u = np.zeros((150, 1))
        x = np.asarray(rollout(truth, np.array([2.5 - 0.6 * i, 0.0]), u[:-1]))
        made.append(
            tn.from_arrays(
                x[:, :1],
                u,
                dt=DT,
                coordinates=list(truth.coordinates),
                inputs=list(truth.inputs),
                name=f"run{i}",
                split=split,
                v=x[:, 1:],
            )
        )
    return tn.DataSet("heavier", tuple(made))


@pytest.mark.thorough
def test_training_corrects_what_the_physics_leaves_and_the_file_keeps_it(records, tmp_path):
    model, folder = physics(), tmp_path / "run"

    def prepared(model):
        return prepare(FitRequest(records, RECIPE, [Member(0)], physics=model))

    run = run_fit(prepared(model), folder)
    result = run.best.result
    assert isinstance(result.model, tn.HybridModel)
    held = list(records.split("validation"))
    before, after = (tn.mean_rmse(tn.evaluate(m, held, "file")) for m in (model, result.model))
    assert after < before
    # the physics is kept as it was given, in double precision
    for ours, given in zip(
        jax.tree.leaves(result.model.physics), jax.tree.leaves(model), strict=True
    ):
        assert float(ours) == float(given)
    loaded = tn.load_model(folder / "model.safetensors", SWING)
    assert isinstance(loaded, tn.HybridModel)
    assert tn.mean_rmse(tn.evaluate(loaded, held, "file")) == pytest.approx(after, rel=1e-9)
    again = run_fit(prepared(model), folder, "resume")
    assert again.best.mean == run.best.mean
    other = jax.tree.map(lambda value: value * 1.01, model)
    with pytest.raises(tn.InputError, match="with another physics;"):
        run_fit(prepared(other), folder, "resume")


@pytest.mark.thorough
def test_the_physics_takes_no_more_steps_than_its_own_errors_are_worth(records):
    fine = tn.discretise(swing_model(), DT, 8)

    def steps(**model: object) -> int:
        recipe = {**RECIPE, "model": {**RECIPE["model"], **model}}
        found = make_plan(make_task(records, recipe, physics=fine)).models
        assert isinstance(found, HybridModel)
        assert isinstance(found.physics, Discretised)
        return found.physics.substeps

    assert steps() == 1
    assert steps(substeps=3) == 3


def test_substeps_mean_nothing_to_physics_that_is_not_integrated(records):
    linear = tn.fit(records, "linear").model
    recipe = {**RECIPE, "model": {**RECIPE["model"], "substeps": 2}}
    with pytest.raises(tn.InputError, match=r"model\.substeps: physics that is not integrated"):
        tn.fit(records, recipe, physics=linear)


def test_folds_whose_physics_takes_other_steps_train_apart(records):
    near, far = (tn.discretise(swing_model({"gravity": g}), DT, 8) for g in (1.0, TRUTH["gravity"]))
    every = list(records)
    # the physics of the second fold is exact, so its integration must be as well
    exact = [
        dataclasses.replace(e, q=q[:, :1], v=q[:, 1:])
        for e, q in zip(every, tn.free_run(far, every, "file"), strict=True)
    ]
    train, held = tuple(every[:2]), tuple(every[2:])
    folds = (
        Fold(Roles(train, held), physics=near),
        Fold(Roles(tuple(exact[:2]), held), physics=far),
    )
    task = Task(tn.read_recipe(RECIPE), folds, (Member(0, fold=0), Member(0, fold=1)))
    assert [len(group) for group in groups_alike(task)] == [1, 1]


def test_mechanisms_of_several_folds_are_corrected_by_one_program(records, tmp_path):
    """What made them of their records are ranges, which say nothing of values that are found."""

    def mechanism(e: tn.Experiment) -> Discretised:
        system = MECHANISM.for_records([e])
        forced = with_added(system, ["coulomb"], [e], {})
        assert all(p.upper > p.lower for p in forced.parameters if not p.fixed)
        return tn.discretise(
            forced.model({name: jnp.asarray(x) for name, x in forced.nominal().items()}), DT
        )

    found = [mechanism(e) for e in list(records)[:2]]
    assert jax.tree.structure(found[0]) != jax.tree.structure(found[1])
    folds = [Fold(Roles((e,), (records[2],)), m) for e, m in zip(records, found, strict=False)]
    members = (Member(0, fold=0), Member(0, fold=1))
    task = Task(tn.read_recipe(RECIPE, ["model.substeps=1"]), tuple(folds), members)
    assert [len(group) for group in groups_alike(task)] == [2]
    corrected = without_ranges(found[1])
    values = (map(float, jax.tree.leaves(model)) for model in (corrected, found[1]))
    assert [*next(values)] == [*next(values)]
    model = HybridModel(corrected, network(corrected))
    save(model, tmp_path / "hybrid.safetensors")
    again = tn.load_model(tmp_path / "hybrid.safetensors")
    assert jax.tree.structure(again) == jax.tree.structure(model)


def test_a_correction_that_does_not_beat_its_physics_is_left_out(records):
    exact = tn.discretise(swing_model({"gravity": 1.3 * TRUTH["gravity"]}), DT)
    result = tn.fit(records, RECIPE, physics=exact, quiet=True)
    (finding,) = [f for f in result.findings if f.code == "physics alone"]
    assert "no better than the physics alone" in str(finding)
    assert result.detail("kept_epoch") == 0
    held = records.split("validation")
    (alone,), (kept,) = (tn.free_run(m, held, "file") for m in (exact, result.model))
    np.testing.assert_allclose(kept, alone, atol=1e-9)
