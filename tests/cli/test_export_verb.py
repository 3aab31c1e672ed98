"""The command that writes models in other forms, with a target of its own."""

import json
from hashlib import sha256
from pathlib import Path
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example
from scipy.io import loadmat
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.export.mat import Matrices
from tustinnet.export.source import Source
from tustinnet.export.target import Files, NotRunnable, Stepper, Target
from tustinnet.program.numbers import run
from tustinnet.registry import TARGETS
from tustinnet.store import exported
from tustinnet.store.files import write_into


class Plain(Target):
    """Tells what a program does, and computes it with NumPy."""

    name: ClassVar[str] = "plain"
    off = 0.0

    def files(self, source: Source) -> Files:
        told = "\n".join(f"{node.op} {node.data}" for node in source.step.nodes)
        return {"step.txt": told, "notes.bin": b"\x00"}

    def stepper(self, folder: Path, source: Source) -> Stepper:
        assert (folder / "step.txt").read_text().split()
        return lambda x, u: run(source.step, x=x, u=u)["x"] * (1 + self.off)


class Other(Plain):
    name = "other"

    def files(self, source: Source) -> Files:
        return {"other.txt": "other", "notes.bin": b"\x00"}

    def stepper(self, folder: Path, source: Source) -> Stepper:
        raise NotRunnable("no reader of texts here")


class Wrong(Plain):
    name, off = "wrong", 1e-6


class Single(Plain):
    """Steps in single precision."""

    name, bound = "single", 1e-5

    def stepper(self, folder: Path, source: Source) -> Stepper:
        def step(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            with np.errstate(all="ignore"):
                return run(source.step, x=x, u=u)["x"].astype(np.float32).astype(float)

        return step


class Lacking(Plain):
    name, extra = "lacking", ("lacking-extra", ("no_package_of_this_name",))


class LackingToo(Plain):
    name, extra = "lacking-too", ("other-extra", ("nor_of_that_name",))


@pytest.fixture(autouse=True)
def _targets():
    """Targets of this file take the place of the package's own.

    All at once: names that are put back one by one come back in another order.
    """
    before = dict(TARGETS.places)
    TARGETS.places.clear()
    for target in (Plain(), Other(), Wrong(), Single(), Lacking()):
        TARGETS.register(target.name, target)
    yield
    TARGETS.places.clear()
    TARGETS.places.update(before)


@pytest.fixture
def model(run_folder) -> Path:
    return run_folder / "model.safetensors"


@pytest.fixture
def out(tmp_path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def refused(capsys):
    """Runs the verb, which must refuse with one line that has some words."""

    def check(*arguments: object, names: str) -> None:
        code, printed, err = tustinnet(capsys, "export", *arguments)
        *understood, error = err.splitlines()
        assert (code, printed, error.startswith("error: ")) == (1, "", True), err
        assert all(line.startswith("--at: ") for line in understood), err
        assert names in error

    return check


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*.*")}


# --- what is written ---


def test_matrices_are_about_the_operating_point_that_is_named(model, out, capsys, refused):
    TARGETS.register("mat", Matrices())
    given = ("export", model, "--to", "mat", "--at", "angle=0.5rad, torque=-1", "--out", out)
    code, _, err = tustinnet(capsys, *given)
    assert code == 0, err
    read = loadmat(out / "linear.mat")
    expected = tn.linearize(tn.load_model(model), np.array([0.5, 0.0]), np.array([-1.0]))
    np.testing.assert_allclose(read["A"], expected.a, rtol=1e-12)
    np.testing.assert_array_equal(read["x"].ravel(), [0.5, 0.0])
    for at, to, told in [
        ("angle=0", "plain", "--at: an operating point for plain"),
        ("angle", "mat", "--at: 'angle'; expected NAME=VALUE"),
        ("angle=1,angle=2", "mat", "each name once"),
        ("speed=1", "mat", "no state or input 'speed'; expected some of angle, der_angle, torque"),
    ]:
        refused(model, "--to", to, "--at", at, "--out", out / "new", names=told)


def test_a_model_is_exported_with_a_card(model, out, capsys):
    code, printed, err = tustinnet(capsys, "export", model, "--to", "plain", "--out", out)
    assert code == 0, err
    assert "notes.bin" in printed
    header, card = tn.read_header(model), json.loads((out / "card.json").read_text())
    assert set(contents(out)) == {"card.json", "notes.bin", "step.txt"}
    for name, digest in card["files"].items():
        assert sha256((out / name).read_bytes()).hexdigest() == digest
    assert card["target"] == "plain"
    assert card["model"] == {
        "file": "model.safetensors",
        "sha256": sha256(model.read_bytes()).hexdigest(),
        "kind": "tustin-net",
    }
    assert card["period"] == 0.02
    states, inputs = header["range"]["states"], header["range"]["inputs"]
    assert card["states"] == [
        {"name": "angle", "unit": "rad", "range": states[0]},
        {"name": "der_angle", "unit": "rad/s", "range": states[1]},
    ]
    assert card["inputs"] == [
        {
            "name": "torque",
            "unit": "N m",
            "hold": "zero-order",
            "delay": 0.0,
            "limits": None,
            "range": inputs[0],
        }
    ]
    assert (card["samples"], card["warm_up"], card["notes"]) == ([0], 0, [])
    assert card["scores"] == header["scores"]
    assert card["scores"]["start"] == "derived-6"
    assert (card["check"]["steps"], card["check"]["bound"]) == (200, 1e-12)
    assert 0 <= card["check"]["difference"] <= 1e-12
    assert card["versions"]["tustinnet"]


def test_several_targets_get_a_folder_each(model, out, capsys):
    asked = ("export", model, "--to", "plain, other", "--out", out, "--json")
    code, printed, err = tustinnet(capsys, *asked)
    assert (code, err) == (0, "")
    plain, other = json.loads(printed)
    assert (plain["target"], plain["folder"]) == ("plain", str(out / "plain"))
    assert plain["files"] == ["step.txt", "notes.bin", "card.json"]
    assert (plain["steps"], plain["note"], plain["notes"]) == (200, "", [])
    assert plain["difference"] <= 1e-12
    assert other["note"] == (
        "not run here: no reader of texts here; what it is written from was compared"
    )
    found = set(contents(out))
    assert found == {
        "plain/card.json",
        "plain/notes.bin",
        "plain/step.txt",
        "other/card.json",
        "other/notes.bin",
        "other/other.txt",
    }


def test_all_are_all_that_are_known(model, out, capsys):
    for name in ("wrong", "lacking"):
        del TARGETS.places[name]
    code, _, err = tustinnet(capsys, "export", model, "--to", "all", "--out", out)
    assert code == 0
    assert "note: other: not run here: no reader of texts here" in err
    assert {p.name for p in out.iterdir()} == {"plain", "other", "single"}


def test_an_export_is_replaced_where_that_is_asked_for(model, out, refused, capsys):
    asked = (model, "--out", out, "--to")
    assert tustinnet(capsys, "export", *asked, "plain")[0] == 0
    before = contents(out)
    refused(*asked, "plain", names="card.json: there already; expected a new file; choose another")
    assert contents(out) == before
    (out / "mine.c").write_text("mine")
    assert tustinnet(capsys, "export", *asked, "other", "--overwrite")[0] == 0
    assert set(contents(out)) == {"card.json", "notes.bin", "other.txt", "mine.c"}
    # what was changed since it was written stays
    (out / "other.txt").write_text("changed")
    assert tustinnet(capsys, "export", *asked, "plain", "--overwrite")[0] == 0
    assert set(contents(out)) == {*before, "other.txt", "mine.c"}


def test_an_export_that_was_stopped_can_be_made_again(model, out, monkeypatch, capsys):
    def stopped(folder, name, content):
        if folder == out and name != "card.json":
            (folder / f".{name}.1.part").write_text("half")
            raise KeyboardInterrupt
        write_into(folder, name, content)

    asked = ("export", model, "--to", "plain", "--out", out)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(exported, "write_into", stopped)
        tn.export_model(tn.load_model(model), "plain", out)
    assert set(contents(out)) == {"card.json", ".step.txt.1.part"}
    assert tustinnet(capsys, *asked)[0] == 1
    assert tustinnet(capsys, *asked, "--overwrite")[0] == 0
    assert set(contents(out)) == {"card.json", "notes.bin", "step.txt"}


def test_a_card_cannot_have_files_removed_elsewhere(model, out, tmp_path, capsys):
    assert tustinnet(capsys, "export", model, "--to", "plain", "--out", out)[0] == 0
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    digest = sha256(b"precious").hexdigest()
    card = json.loads((out / "card.json").read_text())
    card["files"] = {"../precious.txt": digest, str(precious): digest}
    (out / "card.json").write_text(json.dumps(card))
    assert tustinnet(capsys, "export", model, "--to", "other", "--out", out, "--overwrite")[0] == 0
    assert precious.read_text() == "precious"


# --- what is refused; nothing is written then ---


@pytest.mark.parametrize(
    ("to", "told"),
    [
        ("nowhere", "target 'nowhere': no such target; expected one of plain, other"),
        ("plain,nowhere", "no such target"),
        ("", "target ''"),
        ("plain,plain", "--to: 'plain,plain'; expected targets, none of them twice"),
        ("plain,all", "--to: 'all' beside others; expected all by itself"),
        ("lacking", "--to lacking: the package no_package_of_this_name is not installed"),
        ("plain,lacking", "pip install 'tustinnet[lacking-extra]'"),
        ("wrong", "--to wrong: a step differs from the model's by"),
        ("plain,wrong", "expected at most 1e-12; nothing was written"),
    ],
)
def test_a_target_that_cannot_be_had_is_one_line(to, told, model, out, refused):
    refused(model, "--to", to, "--out", out, names=told)
    assert not out.exists()


def test_all_packages_that_are_missing_are_named_at_once(model, out):
    told = r"packages for lacking, lacking-too are not.*'tustinnet\[lacking-extra,other-extra\]'"
    with pytest.raises(InputError, match=told):
        tn.export_model(tn.load_model(model), [Lacking(), LackingToo()], out)


def test_what_is_no_model_and_the_file_of_another_are_told(model, out):
    with pytest.raises(InputError, match=r"a str; expected a model; tn\.load_model"):
        tn.export_model(str(model), "plain", out)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match=r"of the kind 'tustin-net'; expected .* 'gru'"):
        tn.export_model(example("gru"), "plain", out, file=model)
    assert not out.exists()


def test_a_folder_that_holds_something_else_is_left_alone(model, out, refused, tmp_path):
    out.mkdir()
    for name, text in (("work.txt", "work"), ("card.json", "{}")):
        (out / name).write_text(text)
        before = contents(out)
        for more in ([], ["--overwrite"]):
            refused(
                model,
                "--to",
                "plain",
                "--out",
                out,
                *more,
                names="a folder that holds something else; expected an empty folder",
            )
        assert contents(out) == before
    file = tmp_path / "file"
    file.write_text("a file")
    refused(model, "--to", "plain", "--out", file, names="a file stands where a folder is needed")
    refused(model, "--to", "plain", "--out", file / "in", names="where a folder is needed")


def test_one_folder_of_several_that_is_taken_stops_all(model, out, refused):
    (out / "other").mkdir(parents=True)
    (out / "other" / "work.txt").write_text("work")
    refused(model, "--to", "plain,other", "--out", out, names="holds something else")
    assert set(contents(out)) == {"other/work.txt"}


def test_foreign_code_is_run_where_it_is_named(
    identified,
    system,
    out,
    refused,
    capsys,
    monkeypatch,
    tmp_path,
):
    model = identified / "model.safetensors"
    asked = (model, "--to", "plain", "--out", out)
    monkeypatch.setenv("TUSTINNET_CONFIG", str(tmp_path / "nothing is trusted here"))
    refused(*asked, names="expected your consent; if you would run it yourself, add --system")
    (identified / "system.py").unlink()
    refused(*asked, names="add --system small_pendulum.py")
    refused(*asked, "--system", "qube-servo2", names="the system 'qube-servo2'")
    assert not out.exists()
    code, _, err = tustinnet(capsys, "export", *asked, "--system", system)
    assert code == 0, err
    assert json.loads((out / "card.json").read_text())["model"]["kind"] == "euler-lagrange"


def test_a_network_has_no_system(model, out, refused):
    refused(
        model, "--to", "plain", "--out", out, "--system", "qube-servo2", names="leave --system out"
    )
    refused(model.parent / "no.safetensors", "--to", "plain", "--out", out, names="no such file")
    assert not out.exists()


SLIDE = """
from tustinnet import Coordinate, Input, LagrangianSystem, Parameter

SYSTEM = LagrangianSystem(
    name="loaded slide",
    coordinates=(Coordinate("x", "linear"),),
    inputs=(Input("force", "N"),),
    parameters=(Parameter("mass", "kg", 1.0, 0.1, 10.0, per="load"),),
    kinetic=lambda q, v, p: p["mass"] * v[0] ** 2 / 2,
    input_map=lambda q, v, u, p: u,
)
"""
MASSES = {"mass[1kg]": 1.0, "mass[2kg]": 2.0, "mass[feather]": 1e-42, "mass[none]": 1e-315}


@pytest.fixture
def loaded(tmp_path) -> tuple[object, ...]:
    """A model with a mass by load, and its system; two of the masses lead out of all numbers."""
    file, model = tmp_path / "slide.py", tmp_path / "slide.safetensors"
    file.write_text(SLIDE)
    values = {name: jnp.asarray(mass) for name, mass in MASSES.items()}
    made = tn.discretise(tn.load_system(file).model(values), 0.1)
    known = {
        "states": [[-1.0, 1.0], [-2.0, 2.0]],
        "inputs": [[-3.0, 3.0]],
        "recorded_states": [[0.0, 0.0]],
    }
    tn.save(made, model, range=known)
    return model, "--system", file, "--to"


@pytest.mark.thorough
def test_a_model_with_values_by_group_needs_the_group(loaded, model, out, refused, capsys):
    asked = (*loaded, "plain", "--out", out)
    refused(*asked, names="no group 'load', which 'mass' is per; expected one of 1kg, 2kg")
    refused(*asked, names="of an export add --group load=")
    refused(*asked, "--group", "load=3kg", names="load '3kg', for which 'mass' has no value")
    refused(*asked, "--group", "load=1kg", "--group", "colour=red", names="group 'colour', which")
    refused(*asked, "--group", "load", names="--group: 'load'; expected NAME=VALUE")
    refused(*asked, "--group", "load=1kg", "--group", "load=2kg", names="each name once")
    refused(
        model,
        "--to",
        "plain",
        "--out",
        out,
        "--group",
        "load=1kg",
        names="group 'load', which nothing in the model is per",
    )
    assert not out.exists()
    steps = {}
    for load in ("1kg", "2kg"):
        verb = ("export", *loaded, "plain", "--out", out / load, "--group", f"load={load}")
        assert tustinnet(capsys, *verb)[0] == 0
        steps[load] = (out / load / "step.txt").read_text()
    assert steps["1kg"] != steps["2kg"]


def test_a_model_that_leaves_the_numbers_is_not_exported(loaded, out, refused):
    asked = (*loaded, "plain", "--out", out, "--group")
    refused(*asked, "load=none", names="to numbers that are not finite; expected finite states")
    single = (*loaded, "single", "--out", out, "--group")
    refused(*single, "load=feather", names="--to single: a step differs from the model's by inf")
    assert not out.exists()
