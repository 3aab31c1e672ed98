"""Physics that is corrected, fitted once more to free runs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import DT, SWING, TRUTH, changed, data_set, falls, noises, swing_model

import tustinnet as tn
from tustinnet.families.hybrid import HybridModel
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.fitting.gradient.material import free_runs
from tustinnet.fitting.gradient.refinement import refined, refines
from tustinnet.fitting.gradient.train import unrefined
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.models.blocks import Scaling
from tustinnet.models.contract import with_dtype
from tustinnet.models.integrate import Discretised
from tustinnet.simulate.starts import start_named

RECIPE = {
    "name": "short",
    "start": "model-12",
    "refine": True,
    "model": {"kind": "hybrid", "correction": {"kind": "tustin-net", "hidden": [4]}},
    "stages": [
        {
            "name": "one", "windows": {"draw": "strided", "length": 10, "count": 40},
            "rate": 1e-5, "epochs": 1, "batch": 16,
        }
    ],
}  # fmt: skip


def hybrid(system=SWING, **values: float) -> HybridModel:
    """Physics with other values than the records', and a correction that says nothing."""
    model = tn.discretise(swing_model(values, system), DT)
    one = jnp.ones(1, jnp.float32)
    scaling = Scaling(jnp.zeros(0), jnp.zeros(0), 5 * one, one, 0.1 * one, jnp.ones(0))
    net = random_tustin_net(model.channels, scaling, jax.random.key(0), hidden=(4,))
    return HybridModel(model, with_dtype(net, np.float64).silent())


def by_model(model, records=None):
    return free_runs(model, records or [*falls(), *noises()], start_named("model-12"))


def test_parameters_that_free_runs_know_are_found():
    model, told = hybrid(gravity=1.1 * TRUTH["gravity"], damping=0.7 * TRUTH["damping"]), []
    found, account = refined(model, by_model(model), lambda *of: told.append(of))
    assert account.after < 0.1 * account.before
    assert not unrefined(account)
    # the prior holds what it can
    for name in ("gravity", "damping"):
        assert account.values[name] == pytest.approx(TRUTH[name], rel=0.05)
    assert isinstance(found.physics, Discretised)
    assert isinstance(found.physics.continuous, tn.LagrangianModel)
    values = found.physics.continuous.values
    assert {name: float(values[name]) for name in account.values} == account.values
    assert values["inertia"] == TRUTH["inertia"]  # fixed
    same = jax.tree.map(np.array_equal, found.correction, model.correction)
    assert all(jax.tree.leaves(same))
    assert [number for number, _, _ in told] == list(range(1, account.iterations + 1))
    rmse = [of for _, of, _ in told]
    assert rmse[-1] == account.after
    scores = tn.evaluate(found, [*falls(), *noises()], "model-12")
    assert account.after == pytest.approx(tn.mean_rmse(scores), rel=1e-4)


def test_parameters_stay_within_their_ranges():
    narrow = changed("gravity", lower=1.6, nominal=1.65, upper=5.0)
    model = hybrid(narrow, gravity=1.65)
    _, account = refined(model, by_model(model), lambda *of: None)
    assert account.values["gravity"] == pytest.approx(1.6, rel=1e-6)  # the truth is below
    assert account.after < account.before


def test_free_runs_that_leave_all_numbers_leave_the_model_as_it_is():
    model = hybrid()
    wild = replace(model, correction=jax.tree.map(lambda a: a * 0 + 1e300, model.correction))
    found, account = refined(wild, by_model(model), lambda *of: None)
    assert account.iterations == 0
    assert not np.isfinite(account.before)
    assert found is wild
    (told,) = unrefined(account)
    assert "give the recipe a `horizon`" in told


def test_a_recipe_that_refines_says_what_it_did():
    train = [replace(e, split="train") for e in falls()]
    data = data_set([*train, replace(noises()[1], split="validation")])
    physics = tn.discretise(swing_model({"gravity": 1.1 * TRUTH["gravity"]}), DT)
    told: list[Iteration] = []
    result = tn.fit(data, RECIPE, physics=physics, listener=Listener(iteration=told.append))
    account = result.details["training"]["refined"]
    assert account["after"] < 0.5 * account["before"]
    assert [of.number for of in told] == list(range(1, account["iterations"] + 1))
    assert {of.stage for of in told} == {"refining the physics of seed 0"}
    scores = tn.evaluate(result.model, list(data.split("validation")), "model-12")
    assert result.validation_rmse == pytest.approx(tn.mean_rmse(scores), rel=1e-2)


def test_where_it_means_nothing_it_is_refused():
    with pytest.raises(tn.InputError, match="`refine` means nothing to kind 'tustin-net'"):
        tn.read_recipe({**RECIPE, "model": {"kind": "tustin-net", "hidden": [4]}})
    fixed = replace(SWING, parameters=tuple(replace(p, fixed=True) for p in SWING.parameters))
    network = hybrid().correction
    without = {
        "all of its parameters fixed": hybrid(fixed),
        "physics without parameters": HybridModel(network, network),
    }
    for what, model in without.items():
        told = f'refine = true, and {what}; .*set `refine` to "automatic" or leave it out'
        with pytest.raises(tn.InputError, match=told):
            refines(model, True, "recipe 'short'")
        assert not refines(model, "automatic", "recipe 'short'")
    assert refines(hybrid(), "automatic", "")
    assert not refines(hybrid(), False, "")
