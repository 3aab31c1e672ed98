"""`tn.fit` without a recipe: the choice of the command, by one call."""

import json
import math
from types import SimpleNamespace
from typing import Any

import pytest
from small_selection import NETWORK_ONLY, plan_in

import tustinnet as tn
from tustinnet.cli.main import run
from tustinnet.selection.plan import read_plan
from tustinnet.store.checkpoint import model_digest


def test_the_library_and_the_command_choose_the_same(folder, tmp_path, monkeypatch, capsys):
    text = NETWORK_ONLY.replace("model-10", "derived-6").replace("small.toml", "linear")
    plan = read_plan(plan_in(tmp_path, text))
    monkeypatch.setattr("tustinnet.selection.select.read_plan", lambda _: plan)
    out = tmp_path / "command"
    with pytest.raises(SystemExit) as ended:
        run(["fit", str(folder), "--out", str(out), "--budget", "none", "--no-report", "--json"])
    assert not ended.value.code
    by_command = json.loads(capsys.readouterr().out)
    choice = tn.fit(tn.load(folder), budget=math.inf, folder=tmp_path / "python")
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "best so far: network" in printed.err
    assert all(f"* {finding}\n" in printed.err for finding in choice.findings)
    starts = [c["starts"] for c in by_command["candidates"]]
    assert [c["starts"] for c in choice.as_plain()["candidates"]] == starts
    files = [place / "model.safetensors" for place in (out, tmp_path / "python")]
    assert {model_digest(tn.load_model(file)) for file in files} == {model_digest(choice.model)}
    tables = [(place / "candidates.md").read_text() for place in (out, tmp_path / "python")]
    assert all("chosen: network" in table for table in tables)
    assert repr(choice).startswith("Choice('network', RMSE 0.")
    assert choice.plot().shape == (2,)
    frame = choice.to_frame()
    network, reference = frame.rows(named=True)
    assert (network["name"], network["is_chosen"], network["records"]) == ("network", True, 5)
    assert (network["difference"], reference["difference"]) == (0, None)
    assert 0 < network["rmse"] < reference["rmse"]
    shown = choice._repr_html_()
    # the candidate and the reference, the findings, and a heading of each table
    assert shown.count("<tr>") == 3 + 1 + len(choice.findings)
    assert "chosen: network" in shown
    with pytest.raises(tn.InputError, match="holds an earlier selection"):
        tn.fit(tn.load(folder), folder=tmp_path / "python", quiet=True)


@pytest.mark.parametrize(("budget", "limit"), [(None, 240.0), (60, 60), (math.inf, None)])
def test_the_budget_is_that_of_the_command(budget, limit, pendulum, monkeypatch, capsys):
    calls: list[Any] = []

    def select(data, folder, options):
        assert folder.is_dir()
        calls.append(SimpleNamespace(folder=folder, options=options))

    monkeypatch.setattr("tustinnet.report.plain_fit.select_model", select)
    tn.fit(pendulum, system="mechanism", budget=budget, quiet=True)
    (call,) = calls
    assert (call.options.budget, call.options.system) == (limit, "mechanism")
    assert not call.folder.exists(), "nothing is kept"
    assert capsys.readouterr() == ("", "")


def test_a_single_recipe_shows_its_progress_unless_it_is_quiet(pendulum, system, capsys):
    heard: list[Any] = []
    result = tn.fit(pendulum, "grey", system=system)
    printed = capsys.readouterr().err
    assert "grey: stage 1 of" in printed
    assert result.findings
    assert all(f"* {finding}\n" in printed for finding in result.findings)
    tn.fit(pendulum, "grey", system=system, quiet=True)
    tn.fit(pendulum, "grey", system=system, listener=tn.Listener(on_progress=heard.append))
    assert capsys.readouterr() == ("", "")
    assert heard


def test_a_notebook_shows_the_last_line(pendulum, monkeypatch, capsys):
    shown: list[str] = []

    class Handle:
        def display(self, content, raw):
            assert raw
            shown.append(content["text/plain"])

        def update(self, content, raw):
            shown.pop()
            self.display(content, raw)

    def select(data, folder, options, reporter):
        for line in ("first", "last"):
            reporter.on_message(line)

    monkeypatch.setattr("IPython.display.DisplayHandle", Handle)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")  # as kernels set it
    monkeypatch.setattr("tustinnet.report.plain_fit.select_model", select)
    tn.fit(pendulum)
    assert shown == ["last"]
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"seed": 0}, "`seed=`: not applicable without a recipe"),
        ({"recipe": "linear", "budget": 10.0}, "`budget=`: not applicable to a single recipe"),
        ({"recipe": "linear", "folder": "x"}, "`folder=`: not applicable to a single recipe"),
        ({"budget": 0.0}, "`budget=`: 0; expected seconds above 0"),
        ({"budget": math.nan}, "`budget=`: nan"),
    ],
)
def test_an_argument_that_does_nothing_is_refused(given, problem, pendulum):
    with pytest.raises(tn.InputError, match=problem):
        tn.fit(pendulum, **given)
