"""Models put together by the command."""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import pytest
from conftest import SYSTEM
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel


@pytest.fixture
def models(run_folder) -> list[Path]:
    """Two networks."""
    return [run_folder / f"seed-{seed}" / "model.safetensors" for seed in (0, 1)]


def test_models_are_put_together_and_used_as_one(models, folder, tmp_path, capsys):
    file = tmp_path / "both.safetensors"
    asked = ("committee", *models, "--out", file)
    code, out, err = tustinnet(capsys, *asked)
    assert (code, out) == (0, "")
    assert f"2 models: {file}" in err
    code, _, err = tustinnet(capsys, *asked)
    assert code == 1
    assert "there already" in err
    assert tustinnet(capsys, *asked, "--weights", "3,1", "--overwrite")[0] == 0
    header = tn.read_header(file)
    assert [member["weight"] for member in header["members"]] == [0.75, 0.25]
    for path, told in zip(models, header["files"], strict=True):
        assert told["file"] == str(path)
        assert told["sha256"] == sha256(path.read_bytes()).hexdigest()
        assert told["data"]["name"] == "pendulum"
    assert header["range"] == tn.read_header(models[0])["range"]

    code, out, _ = tustinnet(capsys, "evaluate", file, folder, "--json")
    assert code == 0
    both = tn.committee([tn.load_model(path) for path in models], [3, 1])
    expected = tn.evaluate(both, list(tn.load(folder).split("validation")), "derived-6")
    assert json.loads(out)["mean"] == pytest.approx(tn.mean_rmse(expected), rel=1e-9)
    code, out, _ = tustinnet(capsys, "evaluate", file, models[0], folder, "--json")
    assert code == 0
    assert len(json.loads(out)["models"]) == 2
    assert tustinnet(capsys, "simulate", file, folder, "--out", tmp_path / "sim")[0] == 0
    assert tustinnet(capsys, "evaluate", file, folder, "--residuals", "--lags", 5)[0] == 0
    code, out, _ = tustinnet(capsys, "show", file)
    assert code == 0
    assert "tustin-net: 1, 2; weight 0.75, 0.25" in out


def test_what_cannot_be_put_together_is_one_line(models, tmp_path, capsys):
    def refused(*arguments: object, names: str) -> None:
        code, out, err = tustinnet(capsys, "committee", *arguments)
        assert (code, out, err.count("\n")) == (1, "", 1)
        assert names in err

    file = tmp_path / "both.safetensors"
    refused(*models, "--out", file, "--weights", "3", names="2 models, weights [3.0]")
    refused(*models, "--out", file, "--weights", "3,-1", names="weights [3.0, -1.0]")
    refused(*models, "--out", file, "--weights", "3;1", names="--weights: '3;1'")
    refused(*models, "--out", file, "--system", "qube-servo2", names="which no model is of")
    refused(*models, "--out", models[0], "--overwrite", names="what the command reads")
    refused(models[0], tmp_path / "no.safetensors", "--out", file, names="no such file")
    assert not file.exists()


def test_members_of_a_users_system_share_its_file(
    models,
    identified,
    folder,
    system,
    tmp_path,
    capsys,
):
    grey, out = identified / "model.safetensors", tmp_path / "new" / "mixed.safetensors"
    model = tn.load_model(grey, system)
    assert isinstance(model, Discretised)
    equations = model.continuous
    assert isinstance(equations, LagrangianModel)
    values = {**equations.values, "damping": 1.01 * equations.values["damping"]}
    other = replace(model, continuous=equations.system.model(values))
    tn.save(
        other, identified / "other.safetensors", system_copy=tn.read_header(grey)["system_copy"]
    )
    asked = ("committee", grey, models[0], identified / "other.safetensors", "--out", out)
    assert tustinnet(capsys, *asked)[0] == 0  # with the copy that was kept
    kept = tn.read_header(out)["system_copy"]
    assert kept == {"file": "system.py", "sha256": sha256(SYSTEM.encode()).hexdigest()}
    assert (out.parent / "system.py").read_text() == SYSTEM
    code, told, _ = tustinnet(capsys, "evaluate", out, folder, "--split", "validation", "--json")
    assert code == 0
    loaded = tn.load_model(out, system)
    assert isinstance(loaded, tn.Committee)
    assert [of.numbers for of in loaded.groups] == [(0, 2), (1,)]
    scores = tn.evaluate(loaded, list(tn.load(folder).split("validation")), "derived-6")
    assert json.loads(told)["mean"] == pytest.approx(tn.mean_rmse(scores), rel=1e-9)

    # another text that computes the same: with the copies two files, by name one
    system.write_text(f"{SYSTEM}# the same\n")
    again = ("--system", system, "--overwrite")
    assert tustinnet(capsys, *asked, *again)[0] == 0
    assert (out.parent / "system.py").read_text() == system.read_text()
    code, _, err = tustinnet(capsys, "committee", grey, out, "--out", tmp_path / "x.safetensors")
    assert code == 1
    assert "models with different system files" in err
    system.write_text(SYSTEM.replace("jnp.cos(q[0])", "jnp.cos(1.01 * q[0])"))
    code, _, err = tustinnet(capsys, *asked, *again)
    assert code == 1
    assert "has changed since the model was identified" in err
