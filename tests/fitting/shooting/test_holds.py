"""Models whose inputs have holds that nobody declared."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.channels import Hold
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.task import Origin, make_task
from tustinnet.models.integrate import discretise
from tustinnet.simulate.input_signal import input_signal

DT = 0.05
SYSTEM = tn.LagrangianSystem(
    name="oscillator",
    coordinates=(tn.Coordinate("x", "linear", 1e-4),),
    inputs=(tn.Input("force", "N"),),
    parameters=(
        tn.Parameter("stiffness", "N/m", 30.0, 5.0, 500.0),
        tn.Parameter("damping", "N s/m", 1.0, 0.01, 10.0),
    ),
    kinetic=lambda q, v, p: v[0] ** 2 / 2,
    potential=lambda q, p: p["stiffness"] * q[0] ** 2 / 2,
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: u,
)
TRUTH = {"stiffness": 80.0, "damping": 0.6}


def logged(hold: Hold, seed: int, n: int = 300) -> tn.Experiment:
    """A record of the oscillator under noise up to a quarter of the sampling rate."""
    generator = np.random.default_rng(seed)
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[1 : n // 4] = np.exp(2j * np.pi * generator.uniform(size=n // 4 - 1))
    u = np.fft.irfft(spectrum, n) * n / 4
    e = tn.from_arrays(
        u,
        u,
        dt=DT,
        coordinates=SYSTEM.coordinates,
        inputs=[tn.Input("force", "N", hold)],
        name=f"record{seed}",
    )
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    model = discretise(SYSTEM.model(values), DT, 4, inputs=e.inputs)
    q = np.asarray(tn.rollout(model, np.zeros(2), input_signal(model, e)))[:, :1]
    return replace(e, q=np.round(q / 1e-4) * 1e-4)


def without_hold(e: tn.Experiment) -> tn.Experiment:
    """The same record by somebody who does not know what the input did."""
    return replace(e, channels=replace(e.channels, inputs=(tn.Input("force", "N", "unknown"),)))


@pytest.mark.thorough
@pytest.mark.parametrize("hold", ["zero-order", "band-limited"])
def test_the_right_hold_is_found_and_told(hold):
    data = tn.DataSet("d", tuple(without_hold(logged(hold, seed)) for seed in range(2)))
    result = tn.identify(data, SYSTEM)
    assert result.model.inputs[0].hold == hold
    told = f"input 'force' acts without delay; hold {hold}"
    assert any(finding.text.startswith(told) for finding in result.findings)
    for name, value in TRUTH.items():
        assert result.values[name] == pytest.approx(value, rel=0.01)


DECLARED = replace(SYSTEM, name="declared", inputs=(tn.Input("force", "N", "zero-order"),))
SHORT = """
name = "short"
[model]
kind = "hybrid"
correction = { hidden = [4], linear = true }
[[stages]]
name = "only"
windows = { draw = "strided", length = 20, count = 40 }
rate = 1e-4
epochs = 2
batch = 20
"""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("system", "recipe"),
    [(DECLARED, []), (SYSTEM, ["search.refine=model-20", "search.initial=anchored"])],
    ids=["declared, plain", "open, refined"],
)
def test_the_model_and_its_file_have_the_hold_that_was_found(system, recipe, tmp_path):
    """Also where the system's file says another one: free runs of records that say none use it."""
    declared = [logged("band-limited", seed) for seed in range(3)]
    unknown = [without_hold(e) for e in declared]
    data = tn.DataSet(
        "d",
        tuple(
            replace(e, split=split)
            for e, split in zip(unknown, ("train", "train", "validation"), strict=True)
        ),
    )
    result = tn.fit(data, read_recipe("grey", recipe), system=system)
    assert result.model.inputs[0].hold == "band-limited"
    assert result.validation_rmse is not None
    assert result.validation_rmse < 1e-4
    tn.save(result.model, tmp_path / "grey.safetensors")
    model = tn.load_model(tmp_path / "grey.safetensors", system)
    assert model.channels == result.model.channels
    for start in ("derived-6", "model-20"):
        here, there = (tn.evaluate(model, of, start) for of in (unknown, declared))
        assert [s.rmse for s in here] == pytest.approx([s.rmse for s in there], rel=1e-12)
    assert tn.mean_rmse(tn.evaluate(model, unknown, "model-20")) < 1e-4
    with pytest.raises(tn.InputError, match=r"first-order.*expected force \(N, band-limited\)"):
        tn.evaluate(model, [logged("first-order", 0)], "derived-6")


@pytest.mark.thorough
def test_what_begins_with_such_a_model_keeps_its_hold(tmp_path):
    unknown = [without_hold(logged("band-limited", seed)) for seed in range(3)]
    data = tn.DataSet("d", tuple(unknown))
    grey = tn.identify(data, DECLARED).model
    recipe = tmp_path / "short.toml"
    recipe.write_text(SHORT)
    hybrid = tn.fit(data, recipe, physics=grey).model
    assert isinstance(hybrid, tn.HybridModel)
    assert hybrid.inputs[0].hold == hybrid.correction.inputs[0].hold == "band-limited"
    assert tn.mean_rmse(tn.evaluate(hybrid, unknown, "model-20")) < 2e-3
    again = [
        fit_task(prepare(request).task)
        for request in (
            FitRequest(data, "grey", system=DECLARED, origin=Origin(grey)),
            FitRequest(data, recipe, origin=Origin(hybrid)),
        )
    ]
    together = tn.committee([grey, *(of.model for (of,) in again)])
    for i, model in enumerate([hybrid, *(of.model for (of,) in again), together]):
        tn.save(model, tmp_path / f"{i}.safetensors")
        loaded = tn.load_model(tmp_path / f"{i}.safetensors", DECLARED)
        assert loaded.inputs[0].hold == "band-limited"


def test_holds_that_inputs_say_are_taken_before_those_of_the_model():
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    holds: tuple[Hold | None, ...] = (None, "unknown", "zero-order", "first-order")
    for model_hold in holds:
        model = replace(SYSTEM, inputs=(tn.Input("force", "N", model_hold),)).model(values)
        for given in (*holds, "band-limited"):
            other = tn.Input("other", "V", given, limits=(-1.0, 1.0), delay=0.02)
            (result,) = discretise(model, DT, inputs=[other]).inputs
            expected = model_hold if given in (None, "unknown") and model_hold else given
            assert result == tn.Input("force", "N", expected, delay=0.02)
        assert discretise(model, DT).inputs == model.inputs


def test_terms_nobody_needs_are_left_out():
    data = tn.DataSet("d", tuple(without_hold(logged("zero-order", seed)) for seed in range(2)))
    result = tn.identify(data, "mechanism", "mechanism")
    assert result.model.inputs[0].hold == "zero-order"
    values = {e.name: e.value for e in result.estimates}
    # one that relaxes slowly is a spring, too
    stiffness = values["x.spring"] + values["x.maxwell"]
    assert stiffness == pytest.approx(TRUTH["stiffness"], rel=0.02)
    assert values["x.by_force"] == pytest.approx(1.0, rel=0.02)
    assert "x.quadratic" not in values


@pytest.mark.parametrize(("recipe", "system"), [("standard", None), ("grey", SYSTEM)])
def test_records_that_were_not_prepared_are_refused(recipe, system):
    unknown = without_hold(logged("first-order", 0))
    task = make_task(tn.DataSet("d", (unknown,)), recipe, system=system)
    with pytest.raises(tn.InputError, match=r"record0, input 'force': hold 'unknown'"):
        fit_task(task)
