"""The kinds without mechanical structure that train: GRU, neural ODE."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.channels import Channels
from tustinnet.families.family import family_of
from tustinnet.families.gru import GRU, random_gru
from tustinnet.families.neural_ode import NeuralODE
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.recipe_reading import packaged_recipes
from tustinnet.fitting.task import Member
from tustinnet.models.blocks import learn_scaling
from tustinnet.simulate.along import states_along
from tustinnet.store.run_folder import MODEL

STAGE = {
    "name": "one",
    "windows": {"draw": "strided", "length": 10, "step": 12},
    "rate": 5e-3,
    "epochs": 10,
    "batch": 32,
}
KINDS = {
    "gru": {"hidden": 6, "warm_up": 8},
    "neural-ode": {"hidden": [8]},
}


def recipe(kind: str, **stage) -> dict:
    return {"name": kind, "model": {"kind": kind, **KINDS[kind]}, "stages": [{**STAGE, **stage}]}


@pytest.fixture(scope="module", params=sorted(KINDS))
def trained(request, pendulum, tmp_path_factory):
    """A run of two seeds of a kind."""
    folder = tmp_path_factory.mktemp(request.param)
    fit = prepare(FitRequest(pendulum, recipe(request.param), [Member(0), Member(1)]))
    return run_fit(fit, folder), fit


def test_it_trains(trained):
    run, _ = trained
    for member in run.members:
        assert member.result.finished
        assert np.isfinite(member.mean)
        # scored in single precision within training, in double precision afterwards
        assert member.result.validation_rmse == pytest.approx(member.mean, rel=2e-2)


@pytest.mark.thorough
def test_it_resumes_saves_loads_and_shows(trained, pendulum, capsys):
    run, fit = trained
    before = (run.folder / MODEL).read_bytes()
    again = run_fit(fit, run.folder, "resume")
    assert [m.mean for m in again.members] == [m.mean for m in run.members]
    loaded = tn.load_model(run.folder / MODEL)
    assert jax.tree.structure(loaded) == jax.tree.structure(run.best.result.model)
    for a, b in zip(jax.tree.leaves(loaded), jax.tree.leaves(run.best.result.model), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    header, own = tn.read_header(run.folder / MODEL), family_of(loaded)
    assert header["kind"] == own.kind == fit.task.recipe.model.kind
    assert len(before) > 0


def test_every_kind_has_a_packaged_recipe():
    assert {tn.read_recipe(name).model.kind for name in packaged_recipes()} >= set(KINDS)


@pytest.mark.thorough
def test_it_is_cross_validated(pendulum):
    asked = tn.make_cross_validation_options(recipe("gru", epochs=2), folds=3, starts=["derived-6"])
    found = tn.cross_validate(pendulum, asked)
    assert {s.record for s in found.scores} == {e.name for e in pendulum}


@pytest.mark.thorough
def test_a_gru_that_says_nothing_keeps_its_velocity_and_forgets(pendulum):
    channels = pendulum.channels
    scaling = learn_scaling(list(pendulum))
    model = random_gru(channels, scaling, jax.random.key(0), 5, 8)
    assert model.internal == tuple(f"hidden {i}" for i in range(5))
    x = jnp.array([0.2, 1.5, *np.linspace(-0.5, 0.5, 5)], jnp.float32)
    following = model.with_zero_output().step(x, jnp.array([0.3], jnp.float32))
    np.testing.assert_allclose(following[:2], [0.2 + 0.02 * 1.5, 1.5], rtol=1e-6)
    assert np.abs(following[2:] - x[2:]).max() > 1e-3


@pytest.mark.thorough
def test_a_grus_equations_are_those_of_its_docstring():
    channels = Channels((tn.Coordinate("a", "linear"),), (), 0.1)
    one = jnp.ones(1)
    from tustinnet.models.blocks import Scaling

    scaling = Scaling(0 * one, one, 2 * one, jnp.zeros(0), 3 * one, jnp.zeros(0))
    model = random_gru(channels, scaling, jax.random.key(1), 2, 6)
    x = jnp.array([0.4, -1.0, 0.3, -0.2], jnp.float32)
    phi, h = np.array([0.4, -0.5]), np.array([0.3, -0.2])
    by = [
        np.asarray(model.by_features.weight) @ phi + np.asarray(model.by_features.bias),
        np.asarray(model.by_hidden.weight) @ h + np.asarray(model.by_hidden.bias),
    ]
    reset, gate = (1 / (1 + np.exp(-(by[0][i : i + 2] + by[1][i : i + 2]))) for i in (0, 2))
    new = np.tanh(by[0][4:] + reset * by[1][4:])
    after = gate * h + (1 - gate) * new
    said = np.array([2.0, 3.0]) * (
        np.asarray(model.output.weight) @ after + np.asarray(model.output.bias)
    )
    expected = [0.4 + 0.1 * (-1.0 + said[0]), -1.0 + 0.1 * said[1], *after]
    np.testing.assert_allclose(model.step(x, jnp.zeros(0)), expected, rtol=1e-5)


@pytest.mark.parametrize("trained", ["gru"], indirect=True)
def test_its_hidden_state_follows_the_record_before_a_free_run(trained, pendulum):
    run, _ = trained
    model = run.best.result.model
    assert isinstance(model, GRU)
    held = list(pendulum.split("validation"))
    assert run.start == "warm-up-8"
    [first, *_] = tn.free_run(model, held, "warm-up-8")
    along = states_along(model, [held[0][:8]], "stencil")[0]
    np.testing.assert_allclose(first[:7], along[:7], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(first[7, 2:], along[7, 2:], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("trained", ["neural-ode"], indirect=True)
def test_a_neural_odes_positions_are_bound_by_no_rule(trained):
    run, _ = trained
    model = run.best.result.model
    assert isinstance(model.continuous, NeuralODE)
    slope = model.continuous.derivative(jnp.array([0.1, 2.0]), jnp.array([0.0]))
    assert slope.shape == (2,)
    assert float(slope[0]) != 2.0


def test_a_gru_corrects_it_or_it_is_refused_as_trained_already(trained, pendulum):
    run, _ = trained
    physics = run.best.result.model
    few = {**STAGE, "epochs": 2, "windows": {"draw": "strided", "length": 10, "step": 40}}
    correction = {"kind": "gru", "hidden": 4, "warm_up": 6}
    asked = {"name": "h", "model": {"kind": "hybrid", "correction": correction}, "stages": [few]}
    if isinstance(physics, GRU):
        with pytest.raises(tn.InputError, match="trained already"):
            tn.fit(pendulum, asked, physics=physics)
        return
    result = tn.fit(pendulum, asked, physics=physics)
    assert result.start == "warm-up-6"
    assert len(result.model.internal) == len(physics.internal) + 4
