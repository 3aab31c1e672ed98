"""Models of several files as one, in a file."""

import os
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from conftest import SYSTEM

import tustinnet as tn
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.physical_values import equations_in
from tustinnet.store.header import find_fitted
from tustinnet.store.kept_system import find_system_copy, trust


@pytest.fixture
def models(run_folder) -> list[Path]:
    """Two networks."""
    return [run_folder / f"seed-{seed}" / "model.safetensors" for seed in (0, 1)]


@pytest.mark.thorough
def test_the_file_names_members_and_their_records(models, folder, tmp_path):
    file = tmp_path / "both.safetensors"
    tn.save_committee(models, file)
    with pytest.raises(tn.InputError, match="there already"):
        tn.save_committee(models, file)
    made = tn.save_committee(models, file, [3, 1], overwrite=True)
    header = tn.read_header(file)
    assert [member["weight"] for member in header["members"]] == [0.75, 0.25]
    for path, source in zip(models, header["files"], strict=True):
        assert source["file"] == str(path)
        assert source["sha256"] == sha256(path.read_bytes()).hexdigest()
        assert source["data"]["name"] == "pendulum"
    assert header["range"] == tn.read_header(models[0])["range"]
    data = tn.load(folder)
    assert find_fitted(header, data) == ["fall1", "fall2", "noise1"]
    scores = [
        tn.mean_rmse(tn.evaluate(model, list(data.split("validation")), "derived-6"))
        for model in (made, tn.load_model(file))
    ]
    assert scores[0] == pytest.approx(scores[1], rel=1e-12)


def test_what_cannot_be_put_together_is_refused(models, tmp_path):
    file = tmp_path / "both.safetensors"
    others: dict[str, Path] = {}
    for make, name in ((shutil.copy, "copy"), (os.link, "hard"), (os.symlink, "link")):
        others[name] = tmp_path / f"{name}.safetensors"
        make(models[0], others[name])
    # another header, the same arrays
    others["saved"] = tmp_path / "saved.safetensors"
    tn.save(tn.load_model(models[0]), others["saved"])
    cases: list[tuple[list[Path], dict[str, Any], str]] = [
        (models, {"weights": [3.0]}, "2 models, weights"),
        (models, {"weights": [3.0, -1.0]}, "weights"),
        (models, {"system": "qube-servo2"}, "which no model is of"),
        ([models[0], tmp_path / "no.safetensors"], {}, "no such file"),
    ]
    same = (models[0], *others.values())
    cases += [([models[0], o], {}, "the same model as .*larger weight") for o in same]
    for paths, given, problem in cases:
        with pytest.raises(tn.InputError, match=problem):
            tn.save_committee(paths, file, **given)
    with pytest.raises(tn.InputError, match="what the command reads"):
        tn.save_committee(models, models[0], overwrite=True)
    assert not file.exists()


def test_members_of_a_users_system_share_its_file(models, identified, folder, system, tmp_path):
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
    copy = find_system_copy(grey)
    assert copy is not None
    trust(copy)
    members = [grey, models[0], identified / "other.safetensors"]
    made = tn.save_committee(members, out)  # with the copy that was kept
    kept = tn.read_header(out)["system_copy"]
    assert kept == {"file": "system.py", "sha256": sha256(SYSTEM.encode()).hexdigest()}
    assert (out.parent / "system.py").read_text() == SYSTEM
    systems = [found.system for member in made.members if (found := equations_in(member))]
    assert systems == [systems[0]] * 2
    scores = [
        tn.mean_rmse(tn.evaluate(m, list(tn.load(folder).split("validation")), "derived-6"))
        for m in (made, tn.load_model(out, system))
    ]
    assert scores[0] == pytest.approx(scores[1], rel=1e-9)

    # another text that computes the same: with the copies two files, by name one
    system.write_text(f"{SYSTEM}# the same\n")
    tn.save_committee(members, out, system=system, overwrite=True)
    assert (out.parent / "system.py").read_text() == system.read_text()
    second = find_system_copy(out)
    assert second is not None
    trust(second)
    with pytest.raises(tn.InputError, match="models with different system files"):
        tn.save_committee([grey, out], tmp_path / "x.safetensors")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "system.py").write_text("mine = True")
    with pytest.raises(tn.InputError, match=r"system\.py: another file than"):
        tn.save_committee(members, tmp_path / "other" / "x.safetensors", system=system)
    with pytest.raises(tn.InputError, match=r"system\.py: another file than"):
        tn.calibrate(
            grey, tn.load(folder).split("validation"), tmp_path / "other" / "x.safetensors"
        )
    system.write_text(SYSTEM.replace("jnp.cos(q[0])", "jnp.cos(1.01 * q[0])"))
    with pytest.raises(tn.InputError, match="has changed since the model was identified"):
        tn.save_committee(members, out, system=system, overwrite=True)
