"""What comes in by arguments and files: each is refused by name, or said, or asked for."""

import shutil
from pathlib import Path

import pytest
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.data.card import Card, FileCard
from tustinnet.data.card_files import would_be_record
from tustinnet.data.declaration import read_declaration


@pytest.fixture
def model(run_folder) -> Path:
    """A network."""
    return run_folder / "model.safetensors"


def with_data(verb: str, model: Path, data: Path, out: Path) -> list[object]:
    """A verb that reads records."""
    reads_model = verb in ("simulate", "evaluate", "report")
    ending = ".html" if verb == "report" else ""
    writes = verb not in ("inspect", "evaluate")
    return [
        verb,
        *([model] if reads_model else []),
        data,
        *(["--out", out.with_suffix(ending)] if writes else []),
    ]


@pytest.mark.parametrize("verb", ["inspect", "fit", "simulate"])
def test_links_out_of_the_folder_are_followed_where_that_is_asked_for(
    verb, model, folder, tmp_path, refused, monkeypatch
):
    elsewhere = tmp_path / "elsewhere.csv"
    shutil.move(folder / "fall3.csv", elsewhere)
    (folder / "fall3.csv").symlink_to(elsewhere)
    command = with_data(verb, model, folder, tmp_path / "out")
    said = ("fall3.csv", "a link that leaves the folder", "set TUSTINNET_FOLLOW_LINKS=1")
    refused(*command, names=said)
    # followed, the link is no reason to refuse: another one, given beside it, is
    lines = elsewhere.read_text().splitlines()
    elsewhere.write_text("\n".join([*lines[:5], "nothing,1,1", *lines[6:]]))
    monkeypatch.setenv("TUSTINNET_FOLLOW_LINKS", "1")
    refused(*command, names=("fall3.csv row 6", "'nothing'"))
    option = "--follow-links: an option of an earlier version; expected TUSTINNET_FOLLOW_LINKS=1"
    refused(*command, "--follow-links", names=option)


def test_a_folder_that_is_called_like_a_record_is_said_to_be_left_out(folder, tmp_path):
    (folder / "fall9.csv").mkdir()
    card = (folder / "dataset.toml").read_text().partition("[splits]")[0]
    for splits in ("", '[splits]\ntrain = ["fall*.csv"]\n'):
        (folder / "dataset.toml").write_text(card + splits)
        with pytest.warns(UserWarning, match=r"fall9\.csv: a folder, no record"):
            assert len(tn.load(folder)) >= 3


EMPTY = {
    "simulate": ("--out",),
    "report": ("--out",),
    "fit": ("--out", "--physics", "--from", "--recipe"),
    "inspect": ("--figure",),
    "evaluate": ("--figures",),
    "demo": ("--out",),
}


@pytest.mark.parametrize(("verb", "option"), [(v, o) for v, names in EMPTY.items() for o in names])
@pytest.mark.parametrize("value", ["", " ", "x" * 5000, "y/" * 3000])
def test_a_path_that_names_nothing_or_is_too_long_is_refused_by_its_option(
    verb, option, value, model, folder, tmp_path, refused, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    given = {"demo": [], "inspect": [folder], "fit": [folder]}
    command = [verb, *given.get(verb, [model, folder])]
    if option != "--out" and verb == "fit":
        command += ["--out", tmp_path / "out"]
    refused(*command, f"{option}={value}", names=(option,))
    refused("show", value, names=("MODEL",))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("splits", ["", '[splits]\ntrain = ["*.csv", "*.txt"]\n'])
def test_simulations_are_not_written_where_a_card_would_read_them(
    splits, model, folder, tmp_path, refused
):
    card = (folder / "dataset.toml").read_text().partition("[splits]")[0]
    for path in folder.glob("*.csv"):
        path.rename(path.with_suffix(".txt"))  # so that their simulations are new files
    shutil.copy(folder / "fall1.txt", folder / "other.csv")
    (folder / "dataset.toml").write_text(card + splits)
    before = sorted(folder.iterdir())
    refused(
        "simulate",
        model,
        folder,
        "--out",
        folder,
        "--start",
        "derived-6",
        "--experiment",
        "fall3",
        names=("fall3.csv would be a record of", "another folder"),
    )
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("file", "patterns", "is_record"),
    [
        ("new.csv", ["*.csv"], True),
        ("sub/new.csv", ["*.csv"], False),
        ("sub/new.csv", ["*/*.csv"], True),
        ("sub/new.csv", ["sub/new.csv"], True),
        ("new.csv", [], True),
        ("sub/new.csv", [], False),
        (".new.csv", [], False),
        ("new.png", [], False),
        ("../new.csv", ["*.csv"], False),
        ("sub/../new.csv", ["*.csv"], True),
    ],
)
def test_files_that_a_card_would_read(file, patterns, is_record, folder):
    (folder / "sub").mkdir()
    card = read_declaration(folder / "dataset.toml", Card)
    splits = {"train": [FileCard(file=pattern) for pattern in patterns]} if patterns else {}
    card = card.model_copy(update={"splits": splits})
    assert would_be_record(folder / file, folder, card) is is_record


@pytest.mark.thorough
def test_another_system_file_beside_the_output_is_never_replaced(
    folder, system, tmp_path, refused, capsys
):
    out = tmp_path / "out"
    out.mkdir()
    (out / "system.py").write_text("mine = True")
    identification = ("--recipe", "grey", "--system", system, "--set", "search.iterations=2")
    identification += ("--set", "search.initial=anchored", "--set", "search.substeps=1")
    command = ("fit", folder, *identification, "--no-report", "--out", out)
    for more in ((), ("--overwrite",)):
        refused(*command, *more, names=("system.py", "another file than"))
    assert (out / "system.py").read_text() == "mine = True"
    (out / "system.py").unlink()
    assert tustinnet(capsys, *command)[0] == 0  # its own copy is replaced with the model
    text = (out / "system.py").read_text()
    system.write_text(f"{system.read_text()}\n# another version\n")
    assert tustinnet(capsys, *command, "--overwrite")[0] == 0
    assert (out / "system.py").read_text() != text
