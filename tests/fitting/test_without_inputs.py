"""Records without inputs, as of a free pendulum: every family and judgement takes them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from free_swings import FREE, free, free_swings
from swinging import TRUTH

import tustinnet as tn
from tustinnet.evaluate.bands import Band, BandOptions, calibrate_bands, make_bands, predict
from tustinnet.evaluate.residuals import residual_reports
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.selection.cross_validation import cross_validate, make_cross_validation_options
from tustinnet.simulate import rollout as simulator
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.simulate.rollout import rollouts

TRAINED = {
    "tustin-net": {"kind": "tustin-net", "hidden": [4]},
    "with memory, taps and a linear map": {
        "kind": "tustin-net",
        "hidden": [4],
        "memory": [0.3],
        "linear": True,
        "input_taps": [-1, 0],
    },
    "gru": {"kind": "gru", "hidden": 3, "warm_up": 6},
    "neural-ode": {"kind": "neural-ode", "hidden": [4]},
    "hybrid": {"kind": "hybrid", "correction": {"hidden": [4]}},
}


def recipe(model: dict, **keys) -> tn.Recipe:
    """A stage of two epochs, judged by free runs and by windows of the validation records."""
    stage = {
        "name": "only",
        "windows": {"draw": "strided", "length": 10, "count": 20},
        "epochs": 2,
        "batch": 10,
        "rate": 1e-3,
        "plateau": {"factor": 0.5, "patience": 1, "watch": "validation-loss"},
    }
    return read_recipe({"name": "short", "model": model, "stages": [stage], **keys})


WITH_VALIDATION = ("train", "train", "validation", "validation")


@pytest.mark.parametrize(
    ("of", "keys", "splits"),
    [
        pytest.param("gru", {}, WITH_VALIDATION, marks=pytest.mark.thorough),
        ("hybrid", {}, WITH_VALIDATION),
        pytest.param(
            "with memory, taps and a linear map",
            {"horizon": 0.8, "start": "model-10"},
            WITH_VALIDATION,
            marks=pytest.mark.thorough,
        ),
        ("neural-ode", {}, ("train",)),
    ],
    ids=str,
)
def test_every_family_trains_on_them_and_is_judged(of, keys, splits, tmp_path):
    data, physics = free_swings(splits), free() if of == "hybrid" else None
    request = FitRequest(data, recipe(TRAINED[of], **keys), physics=physics)
    run = run_fit(prepare(request), tmp_path / "run")
    assert all(member.result.finished for member in run.members)
    assert np.isfinite(run.best.mean)
    model = tn.load_model(tmp_path / "run" / "model.safetensors", FREE if physics else None)
    assert model.channels.n_u == 0
    again = tn.mean_rmse(
        tn.evaluate(
            model,
            run.roles.ranking,
            run.best.result.start,
            horizon=effective_horizon(run.best.result.horizon, run.roles.ranking),
        )
    )
    assert again == pytest.approx(run.best.mean)
    if splits == WITH_VALIDATION:
        assert run.best.result.validation_rmse == pytest.approx(run.best.mean, rel=1e-2)


@pytest.mark.thorough
@pytest.mark.parametrize("changes", [[], ["search.initial=anchored", "search.refine=model-20"]])
def test_a_system_is_identified_from_them_and_from_one(changes):
    for splits in (WITH_VALIDATION, ("train",)):
        found = tn.fit(free_swings(splits), read_recipe("grey", changes), system=FREE)
        assert found.identification is not None
        values = {e.name: e.value for e in found.identification.estimates}
        assert values["gravity"] == pytest.approx(TRUTH["gravity"], rel=0.01)


@pytest.mark.thorough
def test_long_free_runs_have_a_gradient_without_inputs(monkeypatch):
    nothing, begin = np.zeros((2, 30, 0)), np.array([[0.4, 0.1], [1.0, -0.2]])

    def size(scale):
        return jnp.sum(rollouts(free(TRUTH | {"gravity": scale}), begin, nothing) ** 2)

    short = jax.grad(size)(1.5)
    monkeypatch.setattr(simulator, "LONG_ROLLOUT", 10)
    assert float(jax.grad(size)(1.5)) == pytest.approx(float(short), rel=1e-9)


@pytest.mark.thorough
def test_bands_committees_residuals_and_folds_take_them():
    data = free_swings((None,) * 4)
    every = list(data)
    together = tn.committee([free(), free(TRUTH | {"gravity": 1.45})])
    made = predict(together, [free(), free(TRUTH | {"gravity": 1.45})], every, "model-10")
    bands = make_bands(
        calibrate_bands(made, every, "model-10"),
        BandOptions(0.5),
        together,
        [free(), free(TRUTH | {"gravity": 1.45})],
        every,
        tn.evaluate(together, every, "model-10"),
    )
    assert all(isinstance(band, Band) for band in bands)
    assert [len(r.cross) for r in residual_reports(together, every, "model-10")] == [0]
    found = cross_validate(
        data, make_cross_validation_options(recipe(TRAINED["tustin-net"]), folds=3)
    )
    assert {score.record for score in found.scores} == {e.name for e in every}
