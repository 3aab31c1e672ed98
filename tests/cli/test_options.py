"""No verb accepts an option that it does not use.

A new option fails here until a test gives it to its verb.
"""

import ast
import re
from functools import cache
from itertools import product
from pathlib import Path

import pytest
import typer
from test_verbs import tustinnet

from tustinnet.cli import demo
from tustinnet.cli.main import app
from tustinnet.data import catalog
from tustinnet.errors import InputError
from tustinnet.reproduce import figures, table1
from tustinnet.systems import qube_servo2_twin

TESTS = Path(__file__).parents[1]


def options() -> set[tuple[str, str]]:
    """Every option of every verb, by its long name."""
    commands = typer.main.get_command(app).commands  # pyright: ignore[reportAttributeAccessIssue]
    return {
        (verb, max(option.opts, key=len))
        for verb, command in commands.items()
        for option in command.params
        if option.param_type_name == "option"
    }


@cache
def sources_of_tests() -> list[str]:
    """The sources of all tests of verbs, with their decorators."""
    sources = []
    for file in [*(TESTS / "cli").glob("test_*.py"), *(TESTS / "reproduce").glob("test_*.py")]:
        text = file.read_text(encoding="utf-8")
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
                sources.append("\n".join(text.splitlines()[first - 1 : node.end_lineno]))
    return sources


@pytest.mark.parametrize(("verb", "option"), sorted(options()))
def test_every_option_of_every_verb_is_given_in_a_test(verb, option):
    given = re.compile(rf"{option}(?![\w-])")
    assert any(given.search(source) and verb in source for source in sources_of_tests())


# --- refused by name ---


@pytest.fixture
def model(run_folder) -> Path:
    """A network."""
    return run_folder / "model.safetensors"


def of(verb: str, model: Path, folder: Path, tmp_path: Path) -> list[object]:
    """A verb with what it cannot do without."""
    first = [verb, model, folder] if verb in JUDGING else [verb, folder]
    out = tmp_path / ("out.html" if verb == "report" else "out")
    return first + (["--out", out] if verb in WRITING else [])


JUDGING = ("simulate", "evaluate", "report")
WRITING = ("simulate", "fit", "cross-validate", "report")


@pytest.mark.parametrize(
    ("verb", "option"),
    [
        ("inspect", "--split"),
        *product(["simulate", "evaluate", "report"], ["--split", "--start"]),
    ],
)
def test_names_that_are_none_are_refused_by_their_option(
    verb, option, model, folder, tmp_path, refused
):
    command = of(verb, model, folder, tmp_path)
    refused(*command, option, "nowhere", names=("nowhere",))
    refused(*command, option, "", names=("''",))
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("verb", ["inspect", "fit", "cross-validate", *JUDGING])
def test_a_card_is_read(verb, model, folder, tmp_path, refused):
    """Given to inspect, fit, cross-validate, simulate, evaluate, report."""
    card = tmp_path / "nowhere.toml"
    refused(*of(verb, model, folder, tmp_path), "--card", card, names=("nowhere.toml",))


@pytest.mark.parametrize("verb", ["demo", "fit", "cross-validate", "reproduce"])
def test_a_device_that_is_not_there_is_refused(verb, folder, tmp_path, refused):
    data = [folder] if verb in ("fit", "cross-validate") else []
    refused(verb, *data, "--out", tmp_path / "o", "--device", "gpu", names=("--device gpu",))
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("verb", JUDGING)
def test_a_network_has_no_system(verb, model, folder, tmp_path, refused):
    command = of(verb, model, folder, tmp_path)
    refused(*command, "--system", "qube-servo2", names=("system",))
    assert not (tmp_path / "out").exists()


def test_a_record_of_another_split_is_refused(model, folder, tmp_path, refused):
    refused(
        "simulate",
        model,
        folder,
        "--out",
        tmp_path / "out",
        "--split",
        "train",
        "--experiment",
        "fall3",
        names=("'fall3'", "fall1, fall2"),
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("system", [[], ["--system", "qube-servo2"]])
def test_physics_without_a_correction_is_refused(system, folder, small_recipe, tmp_path, refused):
    refused(
        "cross-validate",
        folder,
        "--recipe",
        small_recipe,
        "--physics",
        "grey",
        *system,
        "--out",
        tmp_path / "out",
        names=("--physics", "'tustin-net'"),
    )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", ["fit", "cross-validate"])
def test_an_identification_has_no_seeds(verb, folder, tmp_path, refused):
    refused(
        verb,
        folder,
        "--recipe",
        "grey",
        "--system",
        "qube-servo2",
        "--out",
        tmp_path / "out",
        "--seeds",
        2,
        names=("--seeds",),
    )
    assert not (tmp_path / "out").exists()


# --- shown to change something ---


def _stop(*values: object) -> InputError:
    return InputError("stopped", " ".join(map(str, values)))


def test_the_demo_takes_seed_and_overwrite(tmp_path, monkeypatch, refused):
    def twin(seed: int) -> None:
        raise _stop("seed", seed)

    monkeypatch.setattr(qube_servo2_twin, "twin", twin)
    demo = ("demo", "--out", tmp_path / "out", "--quiet")
    refused(*demo, "--seed", 3, names=("seed 3",))
    (tmp_path / "out" / "twin").mkdir(parents=True)
    refused(*demo, names=("add --overwrite",))
    refused(*demo, "--overwrite", names=("seed 0",))


def _stand_in_for_the_measured_data(monkeypatch, folder, records) -> None:
    monkeypatch.setenv("TUSTINNET_DATA", str(folder))
    monkeypatch.setattr(catalog.PublishedDataSet, "is_in", lambda self, place: True)
    monkeypatch.setattr("tustinnet.data.loading.load_folder", lambda place, card, **_: records)


def test_reproduce_asks_for_what_its_options_say(folder, pendulum, tmp_path, monkeypatch, refused):
    def rows(records, place, ask, *more):
        raise _stop(ask.split, ask.seeds, ask.keep, ask.overwrite)

    def drawn(records, split, name):
        if name == "noise3":
            raise _stop("drawing", name)

    _stand_in_for_the_measured_data(monkeypatch, folder, pendulum)
    monkeypatch.setattr(table1, "build_rows", rows)
    monkeypatch.setattr(figures, "choose_experiment", drawn)
    command = ("reproduce", "--out", tmp_path / "out", "--models", "gru", "--split", "validation")
    refused(*command, names=("validation 1 None False",))
    changed = ("--seeds", 2, "--keep", "training", "--overwrite")
    refused(*command, *changed, names=("validation 2 training True",))
    refused(*command, "--experiment", "noise3", names=("drawing noise3",))
    refused(*command[:-1], "nowhere", names=("nowhere",))


@pytest.mark.parametrize("verb", ["fit", "cross-validate", "reproduce"])
@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_quiet_silences_the_progress(
    verb, quiet, folder, small_recipe, pendulum, tmp_path, monkeypatch, refused
):
    def progress(told, *, quiet):
        raise _stop("quiet", quiet)

    _stand_in_for_the_measured_data(monkeypatch, folder, pendulum)
    monkeypatch.setattr("tustinnet.report.progress.FitProgress", progress)
    data = ["--split", "validation"] if verb == "reproduce" else [folder, "--recipe", small_recipe]
    refused(verb, *data, "--out", tmp_path / "out", *quiet, names=(f"quiet {bool(quiet)}",))


def test_the_demo_is_quiet_and_prints_json(pendulum, tmp_path, monkeypatch, capsys):
    def fitted(*arguments, **more):
        raise _stop("here")

    monkeypatch.setattr(qube_servo2_twin, "twin", lambda seed: pendulum)
    monkeypatch.setattr(demo, "_select_and_score", fitted)
    _, table, progress = tustinnet(capsys, "demo", "--out", tmp_path / "loud")
    assert "Time: period" in table
    assert "1/6 twin" in progress
    command = ("demo", "--out", tmp_path / "out", "--json", "--quiet")
    assert tustinnet(capsys, *command) == (1, "", "error: stopped: here\n")


def test_strict_refuses_what_looks_wrong(folder, capsys):
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace("4096", "3000"))
    code, out, err = tustinnet(capsys, "inspect", folder, "--strict")  # prints its page first
    assert (code, "encoder count" in err, "Time: " in out) == (1, True, True)


@pytest.mark.parametrize("given", ["--strict", "--strict=1"])
@pytest.mark.parametrize("verb", ["fit", "cross-validate"])
def test_an_option_of_before_says_what_to_write_instead(verb, given, folder, refused):
    """--strict of fit and cross-validate, which inspect has."""
    words = "--strict: an option of an earlier version; expected tustinnet inspect DATA --strict"
    refused(verb, folder, "--out", "x", given, names=words)
