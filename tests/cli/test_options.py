"""No verb accepts an option that it does not use.

`SHOWN` names for every option of every verb the test in which it changes something, or is refused
where it would change nothing. A new option fails here until it has one.
"""

import ast
from functools import cache
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
EXPORT = "cli/test_export_verb.py"
VERBS, BAD, GREY = "cli/test_verbs.py", "cli/test_bad_input.py", "cli/test_grey_box.py"
FOLDS, TABLE, HERE = "cli/test_cross_validate.py", "reproduce/test_table1.py", "cli/test_options.py"
_CARD = f"{HERE}::test_a_card_is_read"
_DEVICE = f"{HERE}::test_a_device_that_is_not_there_is_refused"
_NAMES = f"{HERE}::test_names_that_are_none_are_refused_by_their_option"
_DEMO = f"{HERE}::test_the_demo_takes_seed_and_overwrite"
_ASKED = f"{HERE}::test_reproduce_asks_for_what_its_options_say"
_FOLD = f"{FOLDS}::test_every_record_is_scored_by_models_that_never_saw_it"
_TWICE = f"{VERBS}::test_simulate_never_replaces_records_and_asks_before_replacing_other_files"
_SEVERAL = f"{VERBS}::test_fit_reports_the_spread_of_several_seeds_and_keeps_model_and_figures"
_SYSTEMS = f"{GREY}::test_every_verb_takes_the_model_with_its_system"
_RESIDUALS = f"{GREY}::test_residuals_tell_a_good_model_from_a_poor_one"
_COMPARED = f"{GREY}::test_compare_puts_families_side_by_side"
_AHEAD = f"{VERBS}::test_evaluate_as_json_with_steps_ahead_and_figures"
_HORIZON = f"{GREY}::test_a_horizon_is_told_with_scores_and_residuals"
_REPRODUCED = f"{TABLE}::test_reproduce_writes_tables_and_figures_and_trains_on_no_test_record"
_QUIET = f"{HERE}::test_quiet_silences_the_progress"
_PRINTED = f"{HERE}::test_the_demo_is_quiet_and_prints_json"
_TOGETHER = "cli/test_put_together.py::test_models_are_put_together_and_used_as_one"
_SELECTED = "cli/test_choosing.py::test_a_folder_of_logs_and_a_system_become_one_model"
_STRICT = f"{HERE}::test_strict_refuses_what_looks_wrong"
_INSPECTED = f"{VERBS}::test_inspect_as_json_with_a_figure"

_REDRAWN = "cli/test_outputs.py::test_figures_are_replaced_where_that_is_asked_for"

_LEFT = "cli/test_automatic_report.py"
_NO_REPORT = f"{_LEFT}::test_a_fit_leaves_a_report_of_the_validation_records"

_BANDED = "cli/test_bands_verb.py::test_a_calibrated_model_simulates_and_is_judged_with_bands"
_PAGE = "cli/test_report_verb.py::test_a_run_is_reported_as_its_options_say"
_DRAWN = "cli/test_report_verb.py::test_a_system_with_links_draws_a_network"
_NO_BANDS = "cli/test_bands_verb.py::test_bands_that_cannot_be_are_one_line"

_CURVE = (
    "cli/test_learning_curve.py::test_every_way_to_a_model_is_drawn_against_the_number_of_records"
)
_NO_CURVE = "cli/test_learning_curve.py::test_what_cannot_be_drawn_is_one_line"

_NEXT = "cli/test_next_record.py::test_an_identified_system_wants_what_shrinks_its_errors"
_COMMITTEE_NEXT = "cli/test_next_record.py::test_a_committee_wants_what_its_members_differ_on"

SHOWN = {
    "demo": {
        "--out": f"{GREY}::test_the_demo_does_the_whole_job_and_says_twin_everywhere",
        "--seed": _DEMO, "--overwrite": _DEMO, "--device": _DEVICE, "--json": _PRINTED,
        "--quiet": _PRINTED, "--no-report": f"{_LEFT}::test_the_demo_and_the_table_leave_a_report",
    },
    "inspect": {
        "--card": _CARD, "--split": _NAMES, "--json": _INSPECTED, "--figure": _INSPECTED,
        "--strict": _STRICT, "--overwrite": _REDRAWN,
    },
    "fit": {
        "--out": _SEVERAL, "--recipe": _SEVERAL, "--seeds": _SEVERAL, "--json": _SEVERAL,
        "--set": f"{VERBS}::test_fit_takes_seeds_by_name_and_changes_of_the_recipe",
        "--physics": f"{BAD}::test_a_network_is_no_physics_to_correct",
        "--system": f"{GREY}::test_a_second_fit_does_not_overwrite_the_first",
        "--overwrite": f"{GREY}::test_a_second_fit_does_not_overwrite_the_first",
        "--resume": f"{VERBS}::test_fit_resumes_a_finished_run",
        "--from": "cli/test_begin_from.py::test_what_cannot_go_on_is_one_line",
        "--plan": _SELECTED, "--budget": _SELECTED,
        "--cluster": "cli/test_choosing.py::test_what_cannot_be_asked_is_one_line",
        "--card": _CARD, "--device": _DEVICE, "--quiet": _QUIET, "--strict": _STRICT,
        "--no-report": _NO_REPORT,
    },
    "cross-validate": {
        "--out": _FOLD, "--recipe": _FOLD, "--seeds": _FOLD, "--start": _FOLD,
        "--overwrite": _FOLD, "--json": _FOLD,
        "--cluster": f"{FOLDS}::test_what_cannot_be_asked_is_one_line",
        "--set": f"{FOLDS}::test_a_system_is_identified_anew_in_every_fold",
        "--system": f"{FOLDS}::test_a_system_is_identified_anew_in_every_fold",
        "--folds": f"{FOLDS}::test_what_cannot_be_asked_is_one_line",
        "--physics": f"{FOLDS}::test_what_cannot_be_asked_is_one_line",
        "--card": _CARD, "--device": _DEVICE, "--quiet": _QUIET, "--strict": _STRICT,
    },
    "learning-curve": {
        "--out": _CURVE, "--records": _CURVE, "--draws": _CURVE, "--recipe": _CURVE,
        "--system": _CURVE, "--physics": _CURVE, "--hybrid": _CURVE, "--twin": _CURVE,
        "--start": _CURVE, "--overwrite": _CURVE, "--json": _CURVE, "--quiet": _CURVE,
        "--card": _NO_CURVE, "--strict": _NO_CURVE, "--device": _NO_CURVE,
    },
    "next-record": {
        "--system": _NEXT, "--json": _NEXT, "--horizon": _COMMITTEE_NEXT,
    },
    "simulate": {
        "--out": _TWICE, "--experiment": _TWICE, "--overwrite": _TWICE,
        "--json": f"{VERBS}::test_simulate_writes_the_free_runs",
        "--split": _NAMES, "--start": _NAMES, "--card": _CARD, "--system": _SYSTEMS,
        "--band": _BANDED, "--whole-records": _BANDED,
    },
    "calibrate": {
        "--out": _NO_BANDS, "--system": _NO_BANDS, "--split": _NO_BANDS, "--card": _NO_BANDS,
        "--overwrite": _NO_BANDS, "--json": _NO_BANDS, "--horizon": _NO_BANDS,
        "--start": _NO_BANDS,
    },
    "evaluate": {
        "--split": _NAMES, "--start": _NAMES, "--card": _CARD, "--system": _SYSTEMS,
        "--ahead": _AHEAD, "--figures": _AHEAD, "--json": _AHEAD, "--horizon": _HORIZON,
        "--band": _BANDED, "--whole-records": _BANDED, "--overwrite": _REDRAWN,
    },
    "compare": {
        "--split": _NAMES, "--start": _NAMES, "--card": _CARD, "--system": _COMPARED,
        "--figures": _COMPARED, "--json": _COMPARED, "--horizon": _HORIZON,
        "--band": _BANDED, "--whole-records": _NO_BANDS, "--overwrite": _REDRAWN,
    },
    "residuals": {
        "--split": _NAMES, "--start": _NAMES, "--card": _CARD, "--system": _RESIDUALS,
        "--lags": _RESIDUALS, "--figure": _RESIDUALS, "--json": _RESIDUALS,
        "--horizon": _HORIZON, "--overwrite": _REDRAWN,
    },
    "export": {
        "--to": f"{EXPORT}::test_several_targets_get_a_folder_each",
        "--json": f"{EXPORT}::test_several_targets_get_a_folder_each",
        "--out": f"{EXPORT}::test_a_model_is_exported_with_a_card",
        "--at": f"{EXPORT}::test_matrices_are_about_the_operating_point_that_is_named",
        "--group": f"{EXPORT}::test_a_model_with_values_by_group_needs_the_group",
        "--system": f"{EXPORT}::test_foreign_code_is_run_where_it_is_named",
        "--overwrite": f"{EXPORT}::test_an_export_is_replaced_where_that_is_asked_for",
    },
    "committee": {
        "--out": _TOGETHER, "--weights": _TOGETHER, "--overwrite": _TOGETHER,
        "--system": "cli/test_put_together.py::test_members_of_a_users_system_share_its_file",
    },
    "report": {
        "--split": _NAMES, "--start": _NAMES, "--card": _CARD,
        "--out": _PAGE, "--horizon": _PAGE, "--overwrite": _PAGE, "--system": _DRAWN,
    },
    "show": {"--json": f"{VERBS}::test_show_prints_the_header"},
    "reproduce": {
        "--out": _REPRODUCED, "--data": _REPRODUCED, "--models": _REPRODUCED,
        "--json": _REPRODUCED, "--quiet": _QUIET, "--device": _DEVICE,
        "--split": _ASKED, "--seeds": _ASKED, "--keep": _ASKED, "--experiment": _ASKED,
        "--overwrite": _ASKED,
        "--no-report": f"{_LEFT}::test_the_demo_and_the_table_leave_a_report",
    },
}  # fmt: skip


def options() -> set[tuple[str, str]]:
    """Every option of every verb, by its long name."""
    commands = typer.main.get_command(app).commands  # pyright: ignore[reportAttributeAccessIssue]
    return {
        (verb, max(option.opts, key=len))
        for verb, command in commands.items()
        for option in command.params
        if option.param_type_name == "option"
    }


def test_every_option_is_shown_to_be_used():
    named = {(verb, option) for verb, shown in SHOWN.items() for option in shown}
    assert options() == named


@cache
def source_of(test: str) -> str:
    """The source of a test, with its decorators."""
    file, _, name = test.partition("::")
    text = (TESTS / file).read_text(encoding="utf-8")
    (found,) = [
        node for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef) and node.name == name
    ]  # fmt: skip
    first = min([found.lineno, *(d.lineno for d in found.decorator_list)])
    return "\n".join(text.splitlines()[first - 1 : found.end_lineno])


@pytest.mark.parametrize("verb", SHOWN)
def test_the_named_tests_are_there_and_give_the_option(verb):
    for option, test in SHOWN[verb].items():
        assert option in source_of(test), (option, test)
        assert verb in source_of(test), (verb, test)


# --- refused by name ---


@pytest.fixture
def model(run_folder) -> Path:
    """A network."""
    return run_folder / "model.safetensors"


@pytest.fixture
def refused(capsys):
    """Runs the command, which must refuse with one line that has some words."""

    def check(*arguments: object, names: tuple[str, ...]) -> None:
        code, out, err = tustinnet(capsys, *arguments)
        assert (code, out) == (1, ""), err
        (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
        for name in names:
            assert name in line

    return check


def of(verb: str, model: Path, folder: Path, tmp_path: Path) -> list[object]:
    """A verb with what it cannot do without."""
    first = [verb, model, folder] if verb in JUDGING else [verb, folder]
    out = tmp_path / ("out.html" if verb == "report" else "out")
    return first + (["--out", out] if verb in WRITING else [])


JUDGING = ("simulate", "evaluate", "compare", "residuals", "report")
WRITING = ("simulate", "fit", "cross-validate", "report")


@pytest.mark.parametrize("option", ["--split", "--start"])
@pytest.mark.parametrize(
    "verb", ["inspect", "simulate", "evaluate", "compare", "residuals", "report"]
)
def test_names_that_are_none_are_refused_by_their_option(
    verb, option, model, folder, tmp_path, refused
):
    if (verb, option) not in options():
        pytest.skip("no such option")
    command = of(verb, model, folder, tmp_path)
    refused(*command, option, "nowhere", names=("nowhere",))
    refused(*command, option, "", names=("''",))
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize("verb", ["inspect", "fit", "cross-validate", *JUDGING])
def test_a_card_is_read(verb, model, folder, tmp_path, refused):
    """Of: inspect, fit, cross-validate, simulate, evaluate, compare, residuals, report."""
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
        "simulate", model, folder, "--out", tmp_path / "out", "--split", "train",
        "--experiment", "fall3", names=("'fall3'", "fall1, fall2"),
    )  # fmt: skip
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("system", [[], ["--system", "qube-servo2"]])
def test_physics_without_a_correction_is_refused(system, folder, small_recipe, tmp_path, refused):
    refused(
        "cross-validate", folder, "--recipe", small_recipe, "--physics", "grey", *system,
        "--out", tmp_path / "out", names=("--physics", "'tustin-net'"),
    )  # fmt: skip
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("verb", ["fit", "cross-validate"])
def test_an_identification_has_no_seeds(verb, folder, tmp_path, refused):
    refused(
        verb, folder, "--recipe", "grey", "--system", "qube-servo2", "--out", tmp_path / "out",
        "--seeds", 2, names=("--seeds",),
    )  # fmt: skip
    assert not (tmp_path / "out").exists()


# --- shown to change something ---


def _stop(*told: object) -> InputError:
    return InputError("stopped", " ".join(map(str, told)))


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
    monkeypatch.setattr(catalog.KnownDataSet, "is_in", lambda self, place: True)
    monkeypatch.setattr("tustinnet.data.loading.load_folder", lambda place, card: records)


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
    assert "1/5 twin" in progress
    command = ("demo", "--out", tmp_path / "out", "--json", "--quiet")
    assert tustinnet(capsys, *command) == (1, "", "error: stopped: here\n")


@pytest.mark.parametrize("verb", ["inspect", "fit", "cross-validate"])
def test_strict_refuses_what_looks_wrong(verb, folder, small_recipe, tmp_path, refused):
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace("4096", "3000"))
    more = [] if verb == "inspect" else ["--recipe", small_recipe, "--out", tmp_path / "out"]
    refused(verb, folder, *more, "--strict", names=("encoder count",))
