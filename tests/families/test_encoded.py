"""Models with an encoder, trained along, that says where free runs start."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import network
from swinging import CART, CREEPING, DT, records, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.families.encoded import EncodedModel, with_encoder
from tustinnet.families.family import family_of
from tustinnet.fitting.gradient.plan import plan
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.recipe import TrainingRecipe
from tustinnet.fitting.task import Origin, make_task
from tustinnet.models.state_encoder import encoder_features
from tustinnet.simulate.drive import drive_of
from tustinnet.simulate.starts import default_start, start_states
from tustinnet.store.header import read_description
from tustinnet.store.run import MODEL, run_task
from tustinnet.store.sealed import read_sealed

COUNT = 2 * np.pi / 512
SAMPLES = 10
KINDS = {
    "tustin-net": {"kind": "tustin-net", "hidden": [8], "stem": 4},
    "memory": {"kind": "tustin-net", "hidden": [8], "memory": [0.5], "input_taps": [-1, 0]},
    "gru": {"kind": "gru", "hidden": 4, "warm_up": 8},
    "neural-ode": {"kind": "neural-ode", "hidden": [4]},
    "linear": {"kind": "linear", "internal": 2},
}


def coarse(seed: int, samples: int = 200) -> tn.Experiment:
    """A record under noise without velocities, its angle read in coarse counts."""
    e = simulated(f"coarse{seed}", [0.3 * seed, 0.0], voltage(samples, seed))
    return replace(e, q=np.round(e.q / COUNT) * COUNT, v=None, v_measured=False)


def recipe(model: dict, start: str = f"encoder-{SAMPLES}", epochs: int = 6) -> tn.Recipe:
    stage = {
        "name": "one", "windows": {"draw": "strided", "length": 10, "step": 4}, "rate": 1e-3,
        "epochs": epochs, "batch": 32, "averaging": 0.9,
    }  # fmt: skip
    return tn.read_recipe({"name": "encoded", "start": start, "model": model, "stages": [stage]})


def data() -> tn.DataSet:
    made = [replace(coarse(seed), split="train") for seed in (1, 2, 3)]
    return tn.DataSet("coarse", (*made, replace(coarse(4), split="validation")))


def encoded(model: tn.Model | None = None, samples: int = SAMPLES) -> EncodedModel:
    known = [coarse(seed) for seed in (1, 2, 3)]
    return with_encoder(model or network(0), known, "stencil", samples, jax.random.key(0))


@pytest.mark.parametrize("kind", KINDS)
def test_every_family_that_trains_has_one_and_files_keep_it(kind, tmp_path):
    found = tn.fit(data(), recipe(KINDS[kind]))
    model, known = found.model, list(data())
    assert found.start == f"encoder-{SAMPLES}" == default_start(known, model)
    assert model.encoder is not None
    assert model.encoder.samples == SAMPLES
    assert np.isfinite(found.validation_rmse or np.inf)
    # its network says something now: it was trained along
    assert np.abs(model.encoder.output.weight).max() > 1e-4
    tn.save(model, tmp_path / "model.safetensors")
    again = tn.load_model(tmp_path / "model.safetensors")
    assert jax.tree.structure(again) == jax.tree.structure(model)
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(model), strict=True):
        np.testing.assert_array_equal(a, b)
    runs = [tn.free_run(m, known, f"encoder-{SAMPLES}") for m in (model, again)]
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a, b)
    told = dict(read_description(tmp_path / "model.safetensors")[1])
    assert told["dynamics"] == KINDS[kind]["kind"]
    assert told["encoder"] == f"the state from {SAMPLES} samples, 32 hidden units"


def test_its_scores_in_training_are_those_of_an_evaluation():
    found = tn.fit(data(), recipe(KINDS["memory"]))
    scores = tn.evaluate(found.model, list(data().split("validation")), found.start)
    assert tn.mean_rmse(scores) == pytest.approx(found.validation_rmse, rel=1e-4)
    assert scores[0].start == f"encoder-{SAMPLES}"


def test_a_hybrid_has_one_too():
    known = tn.discretise(swing_model({"gravity": 1.2}, CREEPING), DT)
    correction = {"kind": "hybrid", "correction": {"kind": "tustin-net", "hidden": [4]}}
    found = tn.fit(data(), recipe(correction), physics=known)
    model: Any = found.model
    assert isinstance(model.dynamics, tn.HybridModel)
    assert model.internal == ("creep",)
    assert np.isfinite(found.validation_rmse or np.inf)
    # the physics is not trained, the rest is
    for a, b in zip(jax.tree.leaves(model.dynamics.physics), jax.tree.leaves(known), strict=True):
        np.testing.assert_array_equal(a, b)
    assert np.abs(model.encoder.output.weight).max() > 1e-4


def test_untrained_it_says_velocities_better_than_a_parabola_and_positions_as_measured():
    model, start = encoded(), f"encoder-{SAMPLES}"
    errors = {"encoder": [], "parabola": []}
    for seed in range(11, 31):
        exact = simulated("exact", [0.2, 0.0], voltage(60, seed))
        e = replace(exact, q=np.round(exact.q / COUNT) * COUNT, v=None, v_measured=False)
        tail = e[SAMPLES - 1 :]
        found = start_states(model, [e], start)[0]
        assert found[0] == pytest.approx(e.q[SAMPLES - 1, 0], abs=1e-7)
        parabola = start_states(model, [tail], "derived-6")[0]
        assert exact.v is not None
        truth = exact.v[SAMPLES - 1, 0]
        errors["encoder"].append(found[1] - truth)
        errors["parabola"].append(parabola[1] - truth)
    rms = {name: np.sqrt(np.mean(np.square(of))) for name, of in errors.items()}
    assert rms["encoder"] < 0.5 * rms["parabola"], rms


def test_turns_of_an_angle_change_nothing_but_the_angle():
    model, e = encoded(), coarse(5)
    turned = replace(e, q=e.q + 4 * np.pi)
    plain, other = (start_states(model, [of], f"encoder-{SAMPLES}")[0] for of in (e, turned))
    np.testing.assert_allclose(other - plain, [4 * np.pi, 0.0], atol=1e-5)


def test_it_sees_sines_of_angles_linear_positions_distances_and_what_acts():
    q = np.array([[1.0, 0.5], [1.2, 0.4], [1.3, 0.2]])
    u = np.arange(4.0).reshape(2, 2, 1)
    channels = tn.Channels(CART.coordinates, CART.inputs, 0.01)
    seen = encoder_features(channels, jnp.asarray(q), jnp.asarray(u))
    angle = [np.sin(0.2), np.cos(0.2), 1.3]
    np.testing.assert_allclose(seen, [*angle, -0.3, 0.3, -0.1, 0.2, 0, 1, 2, 3], atol=1e-12)


def test_it_steps_as_its_model_does():
    alone = network(0, times=(0.5,))
    model, e = encoded(alone), records()[2]
    x0 = np.array([0.2, 0.1, 0.05])
    np.testing.assert_array_equal(
        tn.rollout(model, x0, tn.drive_of(model, e)), tn.rollout(alone, x0, tn.drive_of(alone, e))
    )
    assert model.internal == alone.internal
    assert family_of(model).kind == "encoded"
    u = np.asarray(drive_of(alone, e).u)[0]
    x = x0.astype(np.float32)
    plain = network(0)
    first, second = (tn.compiled_step(of)(x[:2], u) for of in (encoded(plain), plain))
    np.testing.assert_array_equal(first, second)


def test_a_committee_is_of_the_models_alone_and_a_comparison_starts_as_all_can():
    model, other = encoded(), network(1)
    together = tn.committee([model, other])
    assert together.encoder is None
    assert together.members[0].encoder is None
    known = [coarse(1)]
    assert default_start(known, model) == f"encoder-{SAMPLES}"
    assert default_start(known, model, encoded(other)) == f"encoder-{SAMPLES}"
    assert default_start(known, model, other) == "derived-6"
    assert default_start(known, model, encoded(other, 20)) == "derived-6"


def test_a_training_goes_on_with_it():
    first: Any = tn.fit(data(), recipe(KINDS["tustin-net"])).model
    origin = Origin(first, {})

    def begun(start: str) -> Any:
        asked = recipe(KINDS["tustin-net"], start)
        return plan(make_task(data(), asked, origin=origin)).given[0]

    same, longer, without = (begun(start) for start in ("encoder-10", "encoder-15", "derived-6"))
    for model in (same, longer, without):
        np.testing.assert_array_equal(
            model.dynamics.folded().network.output.weight, first.dynamics.network.output.weight
        )
    np.testing.assert_array_equal(same.encoder.output.weight, first.encoder.output.weight)
    assert longer.encoder.samples == 15
    assert not longer.encoder.output.weight.any()
    assert without.encoder is None


@pytest.mark.parametrize(
    ("model", "start", "message"),
    [
        (
            network(0),
            "encoder",
            r"for a model without encoder.*use the start 'model-20'",
        ),
        (encoded(), "encoder", r"with an encoder of 10 samples.*use the start 'encoder-10'"),
        (encoded(), "encoder-2", r"'encoder-2' for a model with an encoder of 10"),
        (encoded(), "encoder-", r"unknown start 'encoder-'"),
    ],
)
def test_starts_that_it_does_not_have(model, start, message):
    with pytest.raises(tn.InputError, match=message):
        tn.evaluate(model, [coarse(1)], start)


def test_records_that_are_too_short():
    with pytest.raises(
        tn.InputError, match=r"coarse1: 8 samples; expected at least 10 for the start 'encoder-10'"
    ):
        tn.evaluate(encoded(), [coarse(1)[:8]], "encoder-10")
    with pytest.raises(tn.InputError, match=r"a window of 208 steps, 198 of them before.*start"):
        tn.fit(data(), recipe(KINDS["tustin-net"], "encoder-199"))
    short = tn.DataSet("coarse", (*list(data())[:3], replace(coarse(4)[:8], split="validation")))
    with pytest.raises(tn.InputError, match=r"coarse4: 8 samples; expected at least 10"):
        tn.fit(short, recipe(KINDS["tustin-net"]))
    for start in ("encoder-0", "encoder-2", "encoder-200"):
        with pytest.raises(tn.InputError, match=rf"'{start}'; expected at least 3 samples, and"):
            tn.fit(data(), recipe(KINDS["tustin-net"], start))


def test_kinds_that_cannot_be_named_in_a_recipe():
    with pytest.raises(tn.InputError, match=r'made of other models.*say `start = "encoder-20"`'):
        tn.read_recipe("standard", ["model.kind=encoded"])
    with pytest.raises(tn.InputError, match="a start after the first sample"):
        tn.read_recipe("grey", ["search.initial=encoder-20"])


def test_stopped_between_stages_and_resumed_it_ends_with_the_same_bits(tmp_path):
    of = recipe(KINDS["memory"])
    assert isinstance(of, TrainingRecipe)
    stages = [of.stages[0].model_copy(update={"name": name}) for name in ("one", "two")]
    task = make_task(data(), of.model_copy(update={"stages": stages}))

    def stop(report) -> None:
        if report.stage == "two":
            raise RuntimeError("stopped")

    whole, cut = tmp_path / "whole", tmp_path / "cut"
    run_task(task, "coarse", whole, "refuse", lambda prepared: SILENT)
    with pytest.raises(RuntimeError, match="stopped"):
        run_task(task, "coarse", cut, "refuse", lambda prepared: Listener(epoch=stop))
    run_task(task, "coarse", cut, "resume", lambda prepared: SILENT)
    first, second = (read_sealed(at / MODEL, ["encoded"])[1] for at in (whole, cut))
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name])
