"""What verbs write never replaces what they read, nor other files, nor anything unasked."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from test_options import _stand_in_for_the_measured_data, options
from test_verbs import tustinnet

from tustinnet.cli.automatic_report import AutomaticReport
from tustinnet.data import catalog
from tustinnet.errors import InputError
from tustinnet.evaluate import horizons, reference, scores
from tustinnet.fits import run as runs
from tustinnet.selection import final_models, jobs
from tustinnet.store import model_file
from tustinnet.store.files import lock_folder


class Place(NamedTuple):
    """What verbs are given; `out` is where they may write."""

    root: Path
    logs: Path
    model: Path
    other: Path
    recipe: Path
    out: Path


@pytest.fixture
def place(run_folder, folder, small_recipe, tmp_path) -> Place:
    model, other = (run_folder / f"seed-{seed}" / "model.safetensors" for seed in (0, 1))
    return Place(tmp_path, folder, model, other, small_recipe, tmp_path / "out")


Verb = Callable[[Place, Path], tuple[object, ...]]

# verbs whose file the user names: how it ends, and how it is asked for
FILES: dict[str, tuple[str, Verb]] = {
    "inspect": (".png", lambda p, out: ("inspect", p.logs, "--figure", out)),
    "report": (".html", lambda p, out: ("report", p.model, p.logs, "--out", out)),
}
# verbs that write into a folder, and files there that they would write
FOLDERS: dict[str, tuple[Verb, list[str]]] = {
    "fit": (
        lambda p, out: ("fit", p.logs, "--recipe", p.recipe, "--out", out),
        ["model.safetensors", "summary.json", "report.html", "figures/fall3.png"],
    ),
    "fit by a plan": (
        lambda p, out: ("fit", p.logs, "--plan", "quick", "--out", out),
        ["model.safetensors", "summary.json", "report.html", "figures/f.png", "candidates.md"],
    ),
    "cross-validate": (
        lambda p, out: ("cross-validate", p.logs, "--recipe", p.recipe, "--out", out),
        ["folds.json", "folds.md"],
    ),
    "cross-validate by numbers of records": (
        lambda p, out: (
            "cross-validate",
            p.logs,
            "--records",
            "all",
            "--recipe",
            p.recipe,
            "--out",
            out,
        ),
        [f"learning-curve.{ending}" for ending in ("json", "md", "png")],
    ),
    "simulate": (
        lambda p, out: ("simulate", p.model, p.logs, "--out", out),
        ["fall3.csv", "noise2.csv"],
    ),
    "evaluate": (
        lambda p, out: ("evaluate", p.model, p.logs, "--figures", out, "--ahead", 2),
        ["fall3.png", "ahead.png"],
    ),
    "export": (lambda p, out: ("export", p.model, "--to", "c", "--out", out), ["model.c", "x"]),
    "control": (
        lambda p, out: ("control", p.model, "--at", "angle=0", "--out", out),
        ["card.json", "controller.c"],
    ),
    "demo": (
        lambda p, out: ("demo", "--out", out),
        [
            "twin_table.md",
            "twin_table.json",
            "twin_report.html",
            "twin_records.png",
            "twin/dataset.toml",
            "twin_choice/model.safetensors",
            "twin_fall_test1.png",
        ],
    ),
    "reproduce": (
        lambda p, out: ("reproduce", "--data", p.logs, "--out", out, "--models", "gru"),
        ["table1.json", "table1.md", "table1.tex", "report.html"],
    ),
}


def test_no_verb_that_writes_is_left_out():
    writing = {verb for verb, option in options() if option in ("--out", "--figure", "--figures")}
    assert writing == {*FILES, *(name.partition(" by ")[0] for name in FOLDERS)}


# verbs that write nothing among the records
KEEPS_APART = ("fit", "cross-validate", "simulate", "reproduce")


def everything(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


@pytest.fixture
def refused(place, capsys, monkeypatch, pendulum):
    """Runs the command, which must refuse in a line, compute nothing and change no file."""

    def computes(*arguments, **named):
        pytest.fail("computed before it refused")

    def check(*arguments: object, names: str) -> None:
        before = everything(place.root)
        with monkeypatch.context() as patched:
            for module in (scores, reference, horizons):
                patched.setattr(module, "score_runs", computes)
            patched.setattr(runs, "fit_in_folder", computes)
            patched.setattr(jobs, "fit_in_folder", computes)
            patched.setattr(final_models, "fit_in_folder", computes)
            if arguments[0] == "reproduce":
                _stand_in_for_the_measured_data(patched, place.logs, pendulum)
            code, out, err = tustinnet(capsys, *arguments)
        assert (code, out) == (1, ""), err
        (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
        assert names in line
        assert everything(place.root) == before

    return check


READ: dict[str, Callable[[Place], Path]] = {
    "a record": lambda p: p.logs / "fall1.csv",
    "a record of another split": lambda p: p.logs / "noise2.csv",
    "the card": lambda p: p.logs / "dataset.toml",
    "the model": lambda p: p.model,
}


@pytest.mark.thorough
@pytest.mark.parametrize("what", READ)
@pytest.mark.parametrize("verb", FILES)
def test_a_file_is_never_written_over_what_is_read(
    verb, what, place, refused, monkeypatch, tmp_path
):
    ending, asked = FILES[verb]
    file = READ[what](place)
    for loads in ("load_model", "load_models"):
        monkeypatch.setattr(model_file, loads, lambda *_: pytest.fail("loaded a model"))
    if verb == "inspect":
        monkeypatch.setattr(catalog, "load", lambda *_: pytest.fail("loaded records"))
    reads = file != place.model or verb != "inspect"
    told = "what the command reads" if reads else "ending"
    for path in (file, tmp_path / "logs" / ".." / file.relative_to(tmp_path)):
        refused(*asked(place, path), "--overwrite", names=told)
        refused(*asked(place, path), names=told)
    if reads:  # under another name, with the ending of what is written
        for make in (os.link, os.symlink):
            other = tmp_path / f"{make.__name__}{ending}"
            make(file, other)
            refused(*asked(place, other), "--overwrite", names="what the command reads")


@pytest.mark.parametrize("verb", FILES)
def test_a_file_has_the_ending_of_its_kind_and_replaces_nothing_unasked(
    verb, place, refused, tmp_path
):
    ending, asked = FILES[verb]
    first = ".png" if verb == "inspect" else ending
    for name in ("notes.txt", "notes", "notes.csv", f"notes{ending}.toml"):
        refused(*asked(place, tmp_path / name), names=f"expected a file that ends in {first}")
        (tmp_path / name).write_text("mine")
        refused(*asked(place, tmp_path / name), "--overwrite", names="ending")
    (tmp_path / f"there{ending}").write_text("mine")
    refused(*asked(place, tmp_path / f"there{ending}"), names="add --overwrite")
    (tmp_path / f"folder{ending}").mkdir()
    refused(*asked(place, tmp_path / f"folder{ending}"), "--overwrite", names="a folder")


@pytest.mark.parametrize(
    ("verb", "name"), [(verb, name) for verb, (_, names) in FOLDERS.items() for name in names]
)
def test_nothing_in_a_folder_is_replaced_unasked(verb, name, place, refused):
    asked, _ = FOLDERS[verb]
    there = place.out / name
    there.parent.mkdir(parents=True)
    there.write_text("mine")
    refused(
        *asked(place, place.out),
        names="choose another" if verb in ("export", "control") else "--overwrite",
    )


@pytest.mark.parametrize("verb", [v for v in FOLDERS if v.split()[0] in KEEPS_APART])
def test_nothing_is_written_among_the_records(verb, place, refused):
    asked, _ = FOLDERS[verb]
    told = "what the command reads" if verb == "simulate" else "the folder of the data"
    for more in ((), ("--overwrite",)):
        refused(*asked(place, place.logs), *more, names=told)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "verb", [verb for verb in FOLDERS if verb not in ("evaluate", "fit by a plan")]
)
def test_a_folder_that_another_run_has_is_left_to_it(verb, place, refused):
    asked, _ = FOLDERS[verb]
    with lock_folder(place.out):
        refused(*asked(place, place.out), names="another run is writing there")


@pytest.mark.thorough
def test_a_fit_keeps_its_folder_until_the_report_is_there(place, tiny_recipe, monkeypatch, capsys):
    """Another one would write its model beside the figures and the report of this one."""
    asked, _ = FOLDERS["fit"]
    taken = []

    def write(report, models, out, *_):
        try:
            with lock_folder(out.parent):
                taken.append(False)
        except InputError:
            taken.append(True)
        return ""

    monkeypatch.setattr(AutomaticReport, "write", write)
    short = ("--set", "stages.*.epochs=1", "--quiet")
    tiny = place._replace(recipe=tiny_recipe)
    assert tustinnet(capsys, *asked(tiny, place.out), *short)[0] == 0
    assert taken == [True]


@pytest.mark.parametrize("option", ["--budget", "--plan", "--system"])
def test_a_fit_that_cannot_begin_drafts_no_card(option, place, refused):
    (place.logs / "dataset.toml").unlink()
    refused("fit", place.logs, "--out", place.out, option, "=", names=option[2:])
    assert not place.out.exists()


def test_a_drafted_card_replaces_none_of_other_records(place, refused, tmp_path):
    bare = shutil.copytree(place.logs, tmp_path / "bare")
    (bare / "dataset.toml").unlink()
    refused("fit", bare, "--out", place.logs, "--overwrite", names="a card of its own")


@pytest.mark.parametrize("option", ["--physics", "--from"])
def test_a_run_is_not_written_over_the_model_that_it_is_made_from(option, place, refused):
    for out in (place.model.parent, place.model.parent.parent):
        refused(
            "fit",
            place.logs,
            option,
            place.model,
            "--out",
            out,
            "--overwrite",
            names=f"which {option} names",
        )


def test_an_export_is_not_written_beside_the_model(place, refused):
    asked, _ = FOLDERS["export"]
    refused(*asked(place, place.model.parent), "--overwrite", names="holds something else")


@pytest.mark.thorough
def test_figures_are_replaced_where_that_is_asked_for(place, capsys, refused, tmp_path):
    drawn = tmp_path / "drawn"
    for verb, asked in (
        ("inspect", ("inspect", place.logs, "--figure", drawn / "a.png")),
        ("evaluate", ("evaluate", place.model, place.logs, "--figures", drawn / "c")),
        ("several", ("evaluate", place.model, place.other, place.logs, "--figures", drawn / "d")),
    ):
        assert tustinnet(capsys, *asked)[0] == 0
        refused(*asked, names="add --overwrite")
        for path in drawn.rglob("*.png"):
            path.write_bytes(b"")
        assert tustinnet(capsys, *asked, "--overwrite")[0] == 0
        assert any(path.stat().st_size for path in drawn.rglob("*.png")), verb
        refused(*asked[:-2], "--overwrite", names="--overwrite: no figures")
