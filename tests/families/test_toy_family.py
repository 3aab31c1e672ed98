"""A family that is registered from outside goes through everything the package does."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy
from conftest import write_folder

import tustinnet as tn
from tustinnet.channels import Channels
from tustinnet.cli.main import run
from tustinnet.families.descriptions import Description
from tustinnet.families.family import Hyper, TrainedFamily, named_arrays, restore_arrays
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.task import Member
from tustinnet.models.blocks import Affine, Scaling, feature_count, learn_scaling, random_affine
from tustinnet.models.contract import AccelerationModel
from tustinnet.registry import FAMILIES
from tustinnet.selection.cross_validation import cross_validate, make_cross_validation_options
from tustinnet.store.header import check_header, read_header
from tustinnet.store.run_folder import MODEL


class Toy(AccelerationModel):
    """Accelerations are a linear map of the features."""

    layer: Affine
    scaling: Scaling
    channels: Channels = eqx.field(static=True)

    def with_zero_output(self) -> "Toy":
        return eqx.tree_at(lambda m: m.layer, self, self.layer.zeros())

    def accelerate(self, x, u):
        told = self.layer(self.scaling.features(self.channels, x, u))
        return self.scaling.acceleration * told, lambda mean: x[self.channels.internal]


class ToyHyper(Hyper):
    bias: bool = True


class ToyDescription(Description):
    bias: bool


class ToyFamily(TrainedFamily):
    kind = "toy"
    hyper = ToyHyper
    description = ToyDescription
    correctable = True
    model = Toy

    def builder(self, hyper, experiments, velocity, physics) -> Callable[..., Toy]:
        scaling = learn_scaling(experiments, velocity)
        return lambda key: make(experiments[0].channels, scaling, key, hyper.bias)

    def describe(self, model):
        return {"bias": model.layer.bias is not None}, named_arrays(model)

    def restore(self, header, arrays, system, where):
        channels = Channels.from_header(header)
        none, by_coordinate = jnp.zeros(0), jnp.zeros(channels.n_q)
        blank = Scaling(none, none, by_coordinate, jnp.zeros(channels.n_u), by_coordinate)
        return restore_arrays(
            lambda: make(channels, blank, jax.random.key(0), header["bias"]), arrays
        )

    def summarise(self, header, arrays):
        return [("toy", f"{arrays['layer.weight'].size} weights")]


def make(channels: Channels, scaling: Scaling, key, bias: bool) -> Toy:
    layer = random_affine(feature_count(channels), channels.n_q, key, bias=bias)
    return Toy(layer, scaling, channels)


RECIPE = {
    "name": "toy",
    "model": {"kind": "toy"},
    "stages": [
        {
            "name": "one",
            "windows": {"draw": "strided", "length": 10, "step": 8},
            "rate": 1e-2,
            "epochs": 10,
            "batch": 32,
        }
    ],
}
SYSTEM = """
import jax.numpy as jnp
import tustinnet as tn

SYSTEM = tn.LagrangianSystem(
    name="bare",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        tn.Parameter("inertia", "kg m^2", 1.0, 0.1, 10.0, fixed=True),
        tn.Parameter("gravity", "N m", 10.0, 1.0, 100.0),
        tn.Parameter("gain", "1", 4.0, 0.1, 40.0),
    ),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]),
    input_map=lambda q, v, u, p: p["gain"] * u,
)
"""


@pytest.fixture(scope="module", autouse=True)
def _registered():
    FAMILIES.register("toy", ToyFamily())
    yield
    del FAMILIES.places["toy"]


@pytest.fixture(scope="module")
def place(_registered, pendulum, tmp_path_factory) -> Path:
    """Logs, a recipe file, and a run of two seeds by the command."""
    place = tmp_path_factory.mktemp("toy")
    write_folder(pendulum, place / "logs")
    (place / "toy.toml").write_text(TOML)
    command(
        "fit",
        place / "logs",
        "--recipe",
        place / "toy.toml",
        "--seeds",
        2,
        "--out",
        place / "run",
        "--quiet",
    )
    return place


TOML = """
name = "toy"
[model]
kind = "toy"
[[stages]]
name = "one"
windows = { draw = "strided", length = 10, step = 8 }
rate = 1e-2
epochs = 10
batch = 32
"""


def command(*arguments: object) -> None:
    with pytest.raises(SystemExit) as ended:
        run([str(a) for a in arguments])
    assert not ended.value.code


def arrays(path: Path) -> dict[str, bytes]:
    return {name: a.tobytes() for name, a in safetensors.numpy.load_file(path).items()}


@pytest.mark.thorough
def test_it_trains_and_better_than_it_began(place, pendulum):
    log = [json.loads(x) for x in (place / "run/seed-0/log.jsonl").read_text().splitlines()]
    assert log[-1]["loss"] < 0.8 * log[0]["loss"]
    assert json.loads((place / "run/summary.json").read_text())["kind"] == "toy"


def test_it_resumes_with_the_same_bits(place, tmp_path):
    data = tn.load(place / "logs")
    fit = prepare(FitRequest(data, place / "toy.toml", [Member(0), Member(1)]))
    before = arrays(place / "run" / MODEL)
    run_fit(fit, place / "run", "resume")
    assert arrays(place / "run" / MODEL) == before
    run_fit(fit, tmp_path / "again")
    assert arrays(tmp_path / "again" / MODEL) == before


def test_it_is_saved_loaded_shown_compared_and_simulated(place, pendulum, tmp_path, capsys):
    file = place / "run" / MODEL
    model = tn.load_model(file)
    assert isinstance(model, Toy)
    tn.save(model, tmp_path / "again.safetensors")
    again = tn.load_model(tmp_path / "again.safetensors")
    for a, b in zip(jax.tree.leaves(model), jax.tree.leaves(again), strict=True):
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    command("show", file)
    assert "4 weights" in capsys.readouterr().out
    command("evaluate", file, tmp_path / "again.safetensors", place / "logs", "--json")
    means = [m["mean"] for m in json.loads(capsys.readouterr().out)["models"].values()]
    assert means[0] == means[1]
    command("simulate", file, place / "logs", "--out", tmp_path / "sim")
    assert len(list((tmp_path / "sim").glob("*.csv"))) == 2  # the validation records
    capsys.readouterr()
    command("evaluate", file, place / "logs", "--ahead", 5, "--start", "model-12", "--json")
    assert len(json.loads(capsys.readouterr().out)["ahead"]["rmse"]) == 5
    step = tn.compiled_step(model)(np.array([0.3, 0.1]), np.array([0.5]))
    np.testing.assert_allclose(step, model.step(jnp.array([0.3, 0.1]), jnp.array([0.5])), rtol=1e-5)


def test_its_header_is_checked_by_its_description(place):
    header = read_header(place / "run" / MODEL)
    with pytest.raises(tn.InputError, match=r"file, bias: .* \(got 'no'\)$"):
        check_header({**header, "bias": "no"}, "file")


@pytest.mark.thorough
def test_it_is_cross_validated(pendulum):
    found = cross_validate(pendulum, make_cross_validation_options(RECIPE, folds=3, seeds=[0, 1]))
    assert sorted({s.record for s in found.scores}) == sorted(e.name for e in pendulum)
    assert len(found.scores) == 10


@pytest.mark.thorough
def test_it_corrects_physics_and_is_corrected(place, pendulum, tmp_path):
    (tmp_path / "bare.py").write_text(SYSTEM)
    bare = tn.load_system(tmp_path / "bare.py")
    values = {name: jnp.asarray(value) for name, value in bare.nominal().items()}
    physics = tn.discretise(bare.model(values), pendulum[0].dt, 2)
    correcting = {**RECIPE, "model": {"kind": "hybrid", "correction": {"kind": "toy"}}}
    held = list(pendulum.split("validation"))
    before = tn.mean_rmse(tn.evaluate(physics, held, "derived-6"))
    result = tn.fit(pendulum, correcting, physics=physics)
    after = tn.mean_rmse(tn.evaluate(result.model, held, "derived-6"))
    assert after < before
    tn.save(result.model, tmp_path / "hybrid.safetensors")
    loaded = tn.load_model(tmp_path / "hybrid.safetensors", tmp_path / "bare.py")
    again = tn.mean_rmse(tn.evaluate(loaded, held, "derived-6"))
    assert again == pytest.approx(after, rel=1e-9)
    toy = tn.load_model(place / "run" / MODEL)
    corrected = {**RECIPE, "model": {"kind": "hybrid", "correction": {"hidden": [4]}}}
    result = tn.fit(pendulum, corrected, physics=toy)
    assert isinstance(result.model, tn.HybridModel)
    assert isinstance(result.model.physics, Toy)


def test_keys_that_it_does_not_know_are_refused_by_name():
    for wrong, told in (
        ({"model": {"kind": "toy", "biass": False}}, "did you mean 'bias'"),
        ({"stages": [{**RECIPE["stages"][0], "frozen_layers": 1}]}, r"frozen_layers: unknown key"),
    ):
        with pytest.raises(tn.InputError, match=told):
            tn.read_recipe({**RECIPE, **wrong})


def test_without_its_registry_line_nobody_knows_it(place):
    toy = FAMILIES.places.pop("toy")
    try:
        with pytest.raises(tn.InputError, match="no kind of model 'toy'"):
            tn.read_recipe(RECIPE)
        with pytest.raises(tn.InputError, match="a file of kind 'toy'"):
            tn.load_model(place / "run" / MODEL)
    finally:
        FAMILIES.register("toy", toy)


OUTDATED = """
import equinox as eqx
from tustinnet.families.family import {imports}
from tustinnet.models.contract import Model

class Old({base}):
    kind = "old"
    hyper = Hyper
    model = object
    def builder(self, hyper, experiments, velocity, physics): ...
    def describe(self, model): ...
    def restore(self, header, arrays, system, where): ...
{more}

FAMILY = Old()
"""
HOOKS = """
    def trainable(self, model, stage): ...
    def begun(self, built, origin): ...
    def shown(self, header, arrays): ...
"""
OLD_MODEL = """
class OldModel(Model):
    def step(self, x, u): ...
    def of(self, record): ...
    def seen(self, inputs): ...
"""


@pytest.mark.parametrize(
    ("imports", "base", "more", "message"),
    [
        (
            "Family, Hyper",
            "Family",
            HOOKS,
            r"class outdated\.Old: names of an earlier version: trainable, begun, shown; "
            "expected trainable_mask, with_weights_from, summarise$",
        ),
        ("Family, Hyper", "Family", "", "class Family; expected TrainedFamily, Solved"),
        (
            "TrainedFamily, Hyper",
            "TrainedFamily",
            OLD_MODEL,
            "class outdated.OldModel: .*: of, seen; expected for_record, step_layout",
        ),
        (
            "TrainedFamily, Hyper, gone",
            "TrainedFamily",
            "",
            "kind of model 'old': outdated:FAMILY cannot be loaded .*ImportError.*update or uninst",
        ),
    ],
)
def test_a_family_of_an_earlier_version_is_refused_by_name(
    tmp_path, monkeypatch, imports, base, more, message
):
    code = OUTDATED.format(imports=imports, base=base, more=more)
    (tmp_path / "outdated.py").write_text(code)
    package = tmp_path / "outdated-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: outdated\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[tustinnet.families]\nold = outdated:FAMILY\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "outdated", raising=False)
    with pytest.raises(tn.InputError, match=message):
        tn.read_recipe({"name": "old", "model": {"kind": "old"}, "stages": []})
