"""`fit --from`: a fitted model goes on with the records of another device."""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from test_grey_box import TRUTH
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.fitting.task import Origin, make_task
from tustinnet.store.header import records_in_header
from tustinnet.store.model_file import load_origin
from tustinnet.systems.files import find_system


class Grey(NamedTuple):
    """An identified model and its system's file."""

    model: Path
    system: Path


@pytest.fixture
def grey(identified, system) -> Grey:
    return Grey(identified / "model.safetensors", system)


def network_of(path, part="network", of=None) -> Any:
    model: Any = tn.load_model(path, of)
    return model.network if part == "network" else model.correction.network


def header_of(path) -> dict:
    return tn.read_header(path)


STILL = ("--set", "stages.*.epochs=1", "--set", "stages.*.rate=1e-30", "--quiet", "--no-report")


@pytest.mark.thorough
def test_a_network_goes_on_with_its_own_recipe_and_says_where_it_is_from(
    run_folder, folder, small_recipe, tmp_path, capsys, refused
):
    model, out = run_folder / "model.safetensors", tmp_path / "other"
    fit = ("fit", folder, "--from", model, "--out", out, *STILL)
    code, told, err = tustinnet(capsys, *fit, "--json")
    assert code == 0, err
    # at a rate of nothing the weights are those it began with
    before, after = (network_of(path) for path in (model, out / "model.safetensors"))
    for a, b in zip(*(list(of.hidden) for of in (before, after)), strict=True):
        np.testing.assert_array_equal(a.weight, b.weight)
    digest = sha256(model.read_bytes()).hexdigest()
    summary = json.loads(told)
    assert summary["recipe"] == "small"
    header = header_of(out / "model.safetensors")
    for said in (summary["from"], header["from"]):
        assert (said["file"], said["sha256"]) == (str(model), digest)
    # what it was made from before, it has seen
    first = records_in_header(header_of(model))
    assert len(first) == 3
    assert records_in_header({"from": header["from"]}) == first
    assert digest in tustinnet(capsys, "show", out / "model.safetensors")[1]
    # resumed it is the same; from another model, or from none, it is refused
    kept = (out / "model.safetensors").read_bytes()
    assert tustinnet(capsys, *fit, "--resume")[0] == 0
    assert (out / "model.safetensors").read_bytes() == kept
    for path in out.rglob("log.jsonl"):
        assert path.read_text().count("\n") == 2
    refused(
        "fit",
        folder,
        "--recipe",
        small_recipe,
        "--out",
        out,
        *STILL,
        "--resume",
        names="with another from",
    )


@pytest.mark.thorough
def test_a_correction_goes_on_with_its_physics_or_with_another(grey, folder, tmp_path, capsys):
    recipe, given = tmp_path / "tiny.toml", ("--system", grey.system, "--quiet", "--no-report")
    # without validation records the physics alone does not compete
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace("validation =", "test ="))
    recipe.write_text("""
name = "tiny"
[model]
kind = "hybrid"
correction = { kind = "tustin-net", hidden = [4] }
[[stages]]
name = "only"
windows = { draw = "strided", length = 8, count = 20 }
rate = 1e-2
epochs = 2
batch = 8
keep = "last"
""")
    first = tmp_path / "first"
    new = ("fit", folder, "--recipe", recipe, "--physics", grey.model, *given, "--out", first)
    code, _, err = tustinnet(capsys, *new)
    assert code == 0, err
    model = first / "model.safetensors"
    go_on = ("fit", folder, "--from", model, *given, "--set", "stages.0.rate=1e-30")
    assert tustinnet(capsys, *go_on, "--out", tmp_path / "second")[0] == 0
    said = [
        network_of(place / "model.safetensors", "correction", find_system(str(grey.system)))
        for place in (first, tmp_path / "second")
    ]
    assert float(said[0].output.weight.std()) > 0
    np.testing.assert_array_equal(said[0].output.weight, said[1].output.weight)
    np.testing.assert_array_equal(said[0].hidden[0].weight, said[1].hidden[0].weight)
    # with other physics the correction goes on all the same
    physics, origin = (
        tn.load_model(path, find_system(str(grey.system))) for path in (grey.model, model)
    )
    data = tn.load(folder)
    (fold,) = make_task(
        data, "grey", system=grey.system, origin=load_origin(grey.model, str(grey.system))
    ).folds
    assert fold.origin is not None
    assert fold.origin.fits_records, "it needs no first estimate"
    task = make_task(data, str(recipe), physics=physics, origin=Origin(origin))
    assert task.folds[0].physics is physics
    assert make_task(data, str(recipe), origin=Origin(origin)).folds[0].physics is not physics


@pytest.mark.thorough
def test_an_identification_begins_at_the_values_of_another(grey, folder, tmp_path, capsys, refused):
    model, given = grey.model, ("--system", grey.system, "--quiet", "--no-report")
    out = tmp_path / "again"
    fit = ("fit", folder, "--from", model, *given)
    code, told, err = tustinnet(capsys, *fit, "--out", out, "--json")
    assert code == 0, err
    summary = json.loads(told)
    assert summary["from"]["sha256"] == sha256(model.read_bytes()).hexdigest()
    found = {e["name"]: e["value"] for e in summary["identification"]["estimates"]}
    header = header_of(out / "model.safetensors")
    begun = header["recipe"]["model"]["begin"]
    known = {e["name"]: e["value"] for e in header_of(model)["identification"]["estimates"]}
    for name, value in TRUTH.items():
        assert begun[name] == pytest.approx(known[name])
        assert found[name] == pytest.approx(value, rel=0.02)
    refused(
        *fit,
        "--out",
        tmp_path / "no",
        "--set",
        "model.begin.gain=3",
        names="--from sets the same initial values",
    )


def test_what_cannot_go_on_is_one_line(run_folder, grey, folder, tmp_path, capsys, refused):
    model = run_folder / "model.safetensors"
    fit, out = ("fit", folder, "--from", model), ("--out", tmp_path / "out")
    refused(*fit, *out, "--set", "model.hidden=[8]", names="hidden [8, 6]; expected hidden [8]")
    refused(*fit, *out, "--recipe", "gru", names="kind 'tustin-net'; expected one of kind 'gru'")
    refused(
        *fit,
        *out,
        "--recipe",
        "grey",
        "--system",
        grey.system,
        names="not applicable to a model of kind 'tustin-net'",
    )
    refused(
        "fit",
        folder,
        "--from",
        grey.model,
        "--system",
        grey.system,
        *out,
        "--recipe",
        "standard",
        names="kind 'euler-lagrange'; expected one of kind 'tustin-net'",
    )
    refused(*fit, *out, "--physics", grey.model, names="--physics")
    refused(*fit, *out, "--budget", "1min", names="--budget: not applicable")
    refused("fit", folder, "--from", folder / "fall1.csv", *out, names="not a safetensors file")
    refused(*fit, "--out", run_folder, "--overwrite", names="which --from names")
    both = tmp_path / "both.safetensors"
    tn.save_committee([model, grey.model], both, system=grey.system)
    refused("fit", folder, "--from", both, *out, names="'committee' that names no recipe")
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace('name = "angle"', 'name = "elbow"'))
    refused(*fit, *out, names="elbow (angular)")
    assert not [*(tmp_path / "out").rglob("*.*")]
