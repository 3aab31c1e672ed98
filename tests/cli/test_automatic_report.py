"""The report that `fit`, `demo` and `reproduce` leave beside what they have fitted."""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import SYSTEM
from small_selection import plan_in
from test_report_verb import numbers_in
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.cli import demo
from tustinnet.cli.automatic_report import AutomaticReport
from tustinnet.data import catalog
from tustinnet.report.page import fit_reports
from tustinnet.report.page.reported_model import ReportedModel
from tustinnet.report.shown_records import choose_shown_records
from tustinnet.reproduce import table1
from tustinnet.systems import qube_servo2_twin

GREY_ONLY = """
name = "one"
folds = 3
start = "derived-6"
candidates = [{ name = "grey", recipe = "grey.toml" }]
"""


def said(page: Path) -> str:
    """The text of a page, white space as single blanks."""
    return " ".join(page.read_text(encoding="utf-8").split())


@pytest.fixture
def fit(folder, tiny_recipe, tmp_path, capsys):
    """Fits the tiny recipe; returns what was printed and told."""

    def run(*more: object, ends: int = 0) -> tuple[str, str]:
        given = ("--recipe", tiny_recipe, "--out", tmp_path / "run", *more)
        code, printed, told = tustinnet(capsys, "fit", folder, *given)
        assert code == ends, told
        return printed, told

    return run


@pytest.mark.thorough
def test_a_fit_leaves_a_report_of_the_validation_records(fit, folder, tmp_path, capsys):
    page = tmp_path / "run" / "report.html"
    printed, _ = fit()
    assert f"report: {page}" in printed
    told, text = numbers_in(page), said(page)
    assert [of["name"] for of in told["records"]] == ["fall3", "noise2"]
    assert "2 validation records that it was not fitted to" in text
    # its command writes the same page
    (command,) = re.findall(r"<dt>Made by</dt><dd><code>(.*?)</code></dd>", text)
    words = shlex.split(command)
    assert words[:2] == ["tustinnet", "report"]
    before = page.read_bytes()
    assert tustinnet(capsys, *words[1:], "--overwrite")[0] == 0
    assert page.read_bytes() == before
    # a fit that takes its place takes the page along
    fit("--overwrite", "--no-report", "--seeds", "1,")
    assert not page.exists()
    fit("--resume", "--seeds", "1,")
    after = page.read_bytes()
    assert after != before
    fit("--resume", "--seeds", "1,")
    assert page.read_bytes() == after


def test_somebody_elses_report_is_not_replaced(fit, tmp_path, folder, tiny_recipe, capsys):
    page = tmp_path / "run" / "report.html"
    page.parent.mkdir()
    page.write_text("mine")
    given = ("--recipe", tiny_recipe, "--out", page.parent)
    code, _, err = tustinnet(capsys, "fit", folder, *given, "--quiet")
    assert (code, err.count("\n")) == (1, 1)
    assert "report.html: there already" in err
    assert page.read_text() == "mine"


def test_a_report_that_cannot_be_written_loses_nothing(fit, tmp_path, monkeypatch):
    def fails(*given: object) -> None:
        raise RuntimeError("no room")

    monkeypatch.setattr(fit_reports, "write_page", fails)
    printed, told = fit("--quiet", ends=1)
    assert "model: " in printed
    assert "report:" not in printed
    (line,) = [line for line in told.splitlines() if line.startswith("error: ")]
    assert "no report (RuntimeError: no room); all else is kept, try: tustinnet report" in line
    assert (tmp_path / "run" / "model.safetensors").is_file()
    assert (tmp_path / "run" / "summary.json").is_file()


@pytest.mark.thorough
def test_without_validation_it_is_judged_by_what_it_was_fitted_to(fit, folder, tmp_path):
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace('["fall3.csv", "noise2.csv"]', "[]"))
    fit()
    assert "3 train records, all of which it was fitted to" in said(
        tmp_path / "run" / "report.html"
    )


@pytest.mark.thorough
def test_a_chosen_model_says_what_folds_say_of_it(folder, tmp_path, capsys):
    plan, system, out = (
        plan_in(tmp_path, GREY_ONLY),
        tmp_path / "small_pendulum.py",
        tmp_path / "run",
    )
    system.write_text(SYSTEM)
    verb = ("fit", folder, "--plan", plan, "--system", system, "--out", out)
    code, printed, err = tustinnet(capsys, *verb, "--quiet")
    assert code == 0, err
    page = out / "report.html"
    assert f"report: {page}" in printed
    text = said(page)
    assert "5 train and validation records, all of which it was fitted to" in text
    assert "not fitted to, models made in the same way are off by 0.0" in text
    assert "on average (5 records, on folds)" in text


def test_few_of_many_records_are_drawn_from_the_worst_to_the_best():
    rmse = {f"r{i}": float(i) for i in range(16)}
    assert choose_shown_records(rmse) == {"r0", "r3", "r6", "r9", "r12", "r15"}
    assert choose_shown_records({"a": 1.0, "b": 2.0}) == {"a", "b"}


def test_nothing_is_written_where_nothing_is_wanted(tmp_path):
    def fails(command: str) -> Path:
        raise AssertionError(command)

    report = AutomaticReport("logs", is_enabled=False)
    assert report.write([tmp_path], tmp_path / "report.html", fails, {}) == ""


@pytest.mark.thorough
def test_the_demo_and_the_table_leave_a_report(
    folder, pendulum, trained_once, tmp_path, monkeypatch, capsys
):
    """By `demo` and `reproduce` with --no-report none."""
    tests = [replace(e, split="test") for e in pendulum.split("validation")]
    data = replace(pendulum, experiments=(*pendulum.split("train"), *tests))
    file = trained_once / "model.safetensors"
    model = tn.load_model(file)
    scores = tuple(tn.evaluate(model, tests, "derived-6"))
    scored = [ReportedModel("small (chosen)", model, file=file, scores=scores)]
    monkeypatch.setattr(qube_servo2_twin, "twin", lambda seed: data)
    monkeypatch.setattr(demo, "_select_and_score", lambda *given, **more: scored)
    monkeypatch.setattr(demo, "_DRAWN", ())
    monkeypatch.setattr(demo, "_swing_up", lambda *given, **more: "")  # of another machine
    page = tmp_path / "demo" / "twin_report.html"
    given = ("demo", "--out", page.parent)
    code, _, err = tustinnet(capsys, *given, "--no-report")
    assert (code, page.exists()) == (0, False), err
    code, _, err = tustinnet(capsys, *given, "--overwrite")
    assert (code, page.exists()) == (0, True), err
    assert "5/6 the report" in err

    rows = [
        table1.Row(
            "small", 0, "small", tuple(replace(s, start="file") for s in scores), model, file
        ),
        table1.Row("theirs", None, None, scores, model),
    ]
    monkeypatch.setattr(catalog.PublishedDataSet, "is_in", lambda self, place: True)
    monkeypatch.setattr("tustinnet.data.loading.load_folder", lambda place, card, **_: data)
    monkeypatch.setattr(table1, "build_rows", lambda *given: rows)
    page = tmp_path / "table" / "report.html"
    given = ("reproduce", "--data", folder, "--out", page.parent, "--models", "gru")
    code, _, err = tustinnet(capsys, *given, "--no-report")
    assert (code, page.exists()) == (0, False), err
    code, _, err = tustinnet(capsys, *given)
    assert (code, page.exists()) == (0, True), err
    assert f"report: {page}" in err
    # free runs of a page start alike: the row that starts otherwise is left out
    assert [of["label"] for of in numbers_in(page)["models"]] == ["small"]
