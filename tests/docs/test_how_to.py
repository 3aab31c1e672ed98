"""What the how-to guides tell readers to type does what they say."""

import json
import re
import runpy
import shutil
import subprocess
import sys
import textwrap
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documented import DOCS, blocks, section

import tustinnet as tn
from tustinnet.data import reading_process
from tustinnet.data.card import Card
from tustinnet.data.declaration import declare
from tustinnet.registry import FAMILIES, READERS

PAGES = sorted((DOCS / "how-to").glob("*.md"))
MODULES = ("make_logs", "drag", "table", "rec_files")  # files of the pages that other files import


def written(page: str, heading: str, language: str, number: int = 0) -> str:
    """A block of a page's section."""
    return blocks(heading, language, f"how-to/{page}.md")[number]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """The logs, card and system that the pages share."""
    place = tmp_path_factory.mktemp("how-to")
    (place / "make_logs.py").write_text(written("index", "The logs in the examples", "python"))
    subprocess.run([sys.executable, "make_logs.py"], cwd=place, check=True)
    card = written("index", "The logs in the examples", "toml")
    (place / "LOGS/dataset.toml").write_text(card)
    (place / "arm.py").write_text(written("add-a-system", "Write the file", "python"))
    return place


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    """A folder of one's own with a copy of them, where programs are run."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in MODULES:
        sys.modules.pop(name, None)


def typed(program: str, capsys) -> tuple[str, dict[str, Any]]:
    """What a program prints when it is run in this process, and its names."""
    Path("typed.py").write_text(program)
    names = runpy.run_path("typed.py")
    return capsys.readouterr().out, names


def test_a_system_is_written_and_tested(place, capsys):
    program = written("add-a-system", "Test it before you fit", "python")
    told, _ = typed(program, capsys)
    assert told.splitlines()[0] in section("Test it before you fit", "how-to/add-a-system.md")
    change = re.search(r"energy changes by (\S+) J", told)
    assert change is not None
    assert float(change[1]) < 1e-10
    system, of = tn.load_system("arm.py"), tn.load("LOGS").channels
    assert [c.name for c in system.coordinates] == [c.name for c in of.coordinates]
    assert [(i.name, i.unit) for i in system.inputs] == [(i.name, i.unit) for i in of.inputs]
    assert [link.coordinate for link in system.links] == ["elbow"]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("tool", "told"),
    [
        ("MATLAB's System Identification Toolbox", "N m/V"),
        ("scikit-learn", "standard_error"),
        ("PySINDy", "elbow''"),
    ],
)
def test_programs_for_users_of_other_tools_run(tool, told, place, capsys):
    text, _ = typed(written("other-tools", tool, "python"), capsys)
    assert told in text


@pytest.mark.thorough
def test_a_family_is_written_registered_and_fitted(place, capsys):
    (place / "drag.py").write_text(written("add-a-family", "Write the family", "python"))
    (place / "drag.toml").write_text(written("add-a-family", "Write the family", "toml"))
    with pytest.raises(tn.InputError, match="no kind of model 'drag'"):
        tn.read_recipe("drag.toml")
    try:
        told, names = typed(written("add-a-family", "Use it in Python", "python"), capsys)
        found = re.search(r"RMSE (\S+) rad", told)
        assert found is not None
        assert float(found[1]) < 0.02  # a network of the default recipe has 0.03 after 5 epochs
        assert isinstance(names["again"], type(names["result"].model))
        assert tn.export_model(names["again"], "mat", "drag-mat")[0].checked.difference < 1e-12
    finally:
        FAMILIES.places.pop("drag", None)


def test_the_package_of_a_family_names_what_is_there(place):
    package = tomllib.loads(written("add-a-family", "Use it from the command", "toml"))
    (entry,) = package["project"]["entry-points"][FAMILIES.group].values()
    module, _, name = entry.partition(":")
    (place / "drag.py").write_text(written("add-a-family", "Write the family", "python"))
    assert getattr(__import__(module), name).kind == "drag"


def test_an_export_is_written_and_checked(place, capsys):
    (place / "table.py").write_text(written("add-an-export", "Write the target", "python"))
    identified = tn.fit(tn.load("LOGS"), "grey", system="arm.py")
    (place / "my-arm").mkdir()
    tn.save(identified.model, "my-arm/model.safetensors")
    told, names = typed(written("add-an-export", "Use it in Python", "python"), capsys)
    head, *states = (place / "arm-table/step.csv").read_text().splitlines()
    assert head == "state,constant,elbow,der_elbow,motor"
    assert head in told
    assert head in section("Use it in Python", "how-to/add-an-export.md")
    a = np.array([[float(x) for x in line.split(",")[2:4]] for line in states])
    expected = tn.linearize(names["model"], np.zeros(2), np.zeros(1)).a
    np.testing.assert_allclose(a, expected, atol=1e-14)


def as_objects_by_line(folder: Path) -> None:
    """Turns the CSV files of a folder into files with an object of JSON on every line."""
    for file in folder.glob("*.csv"):
        names, *rows = (line.split(",") for line in file.read_text().splitlines())
        objects = [dict(zip(names, map(float, row), strict=True)) for row in rows]
        lines = "".join(json.dumps(o) + "\n" for o in objects)
        file.with_suffix(".rec").write_text(lines)
        file.unlink()
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace(".csv", ".rec"))


def test_logs_of_another_format_are_read_by_a_program(place, capsys):
    expected = tn.load("LOGS")
    as_objects_by_line(place / "LOGS")
    _, names = typed(written("add-a-reader", "In a program of your own", "python"), capsys)
    for data in (names["data"], tn.load("CONVERTED")):
        for record in data:
            np.testing.assert_allclose(record.q, expected[record.name].q, atol=1e-9)
            assert record.split == expected[record.name].split


def test_a_package_adds_a_reader(place, monkeypatch):
    as_objects_by_line(place / "LOGS")
    with pytest.raises(tn.InputError, match=r"ending '\.rec'"):
        tn.load("LOGS")
    (place / "rec_files.py").write_text(written("add-a-reader", "In a package", "python"))
    package = tomllib.loads(written("add-a-reader", "In a package", "toml"))
    ((ending, at),) = package["project"]["entry-points"][READERS.group].items()
    info = place / "installed/rec_files-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: rec-files\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{READERS.group}]\n{ending} = {at}\n")
    monkeypatch.syspath_prepend(place / "installed")
    if reading_process._process is not None:  # it imports what was installed when it began
        reading_process._process.stop()
    assert len(tn.load("LOGS")) == 5
    file = place / "LOGS/run1.rec"
    whole = file.read_text().splitlines()
    for defect, message in (
        (
            '{"time": 0.04, "elbow_deg": "x", "volts": 1}',
            "sample 4 (counted from 0), elbow_deg: 'x'",
        ),
        ('{"time": 0.04, "volts": 1}', "sample 4 (counted from 0), elbow_deg: nan (1 such)"),
    ):
        file.write_text("\n".join([*whole[:4], defect, *whole[5:]]))
        with pytest.raises(tn.InputError, match=re.escape(message)):
            tn.load("LOGS")
    assert reading_process._process is not None
    reading_process._process.stop()


@pytest.mark.thorough
def test_a_wheel_is_identified_from_its_speed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    intro = re.findall(
        r"^```python\n(.*?)^```", (DOCS / "how-to/speed-only.md").read_text(), re.M | re.S
    )
    typed(intro[0], capsys)
    (tmp_path / "WHEEL/dataset.toml").write_text(written("speed-only", "The card", "toml"))
    (tmp_path / "wheel.py").write_text(written("speed-only", "The system file", "python"))
    data, system = tn.load("WHEEL"), tn.load_system("wheel.py")
    command = written("speed-only", "The system file", "sh")
    [recipe], [begin] = (
        re.findall('--recipe "(.*?)"', command),
        re.findall("--set '(.*?)'", command),
    )
    held_out = [e for e in data if e.split == "validation"]
    noise, errors = 2.0 * 2 * np.pi / 60, []
    for name, changes in ((recipe, begin), ("grey", ())):
        result = tn.identify(data, system, tn.read_recipe(name, changes))
        runs = tn.free_run(result.model, held_out, "derived-6")
        wrong = [x[:, 0] - e.q[:, 0] for x, e in zip(runs, held_out, strict=True)]
        errors.append(float(np.mean([np.sqrt(np.mean(x**2)) for x in wrong])))
        values = {e.name: e.value for e in result.estimates}
        if changes:
            truth = {"damping": 0.03, "dry": 0.12, "gain": 0.15, "motor.lag": 0.08}
            assert values == pytest.approx(truth, rel=0.06)
    assert errors[0] < 1.05 * noise
    assert errors[1] > 4 * errors[0]


def test_gaps_are_cut(place, capsys):
    spoiling, cutting = re.findall(
        r"^```python\n(.*?)^```", (DOCS / "how-to/jitter-and-gaps.md").read_text(), re.M | re.S
    )
    typed(spoiling, capsys)
    card = place / "LOGS/dataset.toml"
    with pytest.raises(tn.InputError, match=r"row 302: interval of 0\.81 s before sample 300"):
        tn.load("LOGS")
    card.write_text(card.read_text().replace("[time]", '[time]\nirregular = "keep"'))
    _, names = typed(cutting, capsys)
    assert [len(e) for e in names["data"]] == [800, 800, 300, 420, 800, 800]


def tables(page: Path) -> list[dict[str, object]]:
    """What stands as TOML on a page, in lists, too."""
    found = re.findall(r"^( *)```toml\n(.*?)^\1```", page.read_text("utf-8"), re.M | re.S)
    return [tomllib.loads(textwrap.dedent(text)) for _, text in found]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_cards_are_valid(page):
    whole = tomllib.loads(written("index", "The logs in the examples", "toml"))
    for table in tables(page):
        if table.keys() <= {
            *whole,
            "format",
            "controller",
        }:  # a part of a card is put into the whole one
            declare(whole | table, Card, page.name)
        else:  # recipes and packages, which other tests use
            assert {"model", "project"} & table.keys(), page.name
