"""Identification, comparison and residuals by the command, with a system from a file."""

import io
import json
import sys
from dataclasses import replace
from hashlib import sha256
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import SYSTEM
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.cli import demo
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.selection.plan import SelectionPlan
from tustinnet.store.header import read_header
from tustinnet.systems import qube_servo2_twin, twin
from tustinnet.systems.files import find_system
from tustinnet.systems.loading import load_system

TRUTH = {"gravity": 20.0, "damping": 0.8, "gain": 4.0}
QUIET = ("--quiet", "--no-report")
BRIEF = tuple(
    word
    for change in ("initial=anchored", "substeps=1", "iterations=4")
    for word in ("--set", f"search.{change}")
)


def test_fit_finds_the_parameters_and_keeps_model_summary_and_figures(identified):
    summary = json.loads((identified / "summary.json").read_text())
    found = {e["name"]: e for e in summary["identification"]["estimates"]}
    for name, value in TRUTH.items():
        assert found[name]["value"] == pytest.approx(value, rel=0.02)
    assert summary["identification"]["fixed"] == {"inertia": 1.0}
    assert summary["scores"]["split"] == "validation"
    assert summary["scores"]["mean"] < 0.02
    names = {p.name for p in (identified / "figures").iterdir()}
    assert names == {"correlation.png", "fall3.png", "noise2.png"}


def test_the_log_has_every_iteration_and_the_parameters_after_every_stage(identified):
    lines = [json.loads(line) for line in (identified / "log.jsonl").read_text().splitlines()]
    ends = [line for line in lines if "parameters" in line]
    assert ends[0]["stage"] == "equation-error estimate"
    at = [lines.index(end) for end in ends]
    for before, here in pairwise(at):
        end, costs = lines[here], [line["cost"] for line in lines[before + 1 : here]]
        assert len(costs) == end["iterations"]
        assert costs == sorted(costs, reverse=True)
        assert end["initial"] in ("anchored", "unanchored")
    summary = json.loads((identified / "summary.json").read_text())["identification"]
    for e in summary["estimates"]:
        assert ends[-1]["parameters"][e["name"]] == e["value"]
    assert ends[-1]["parameters"]["inertia"] == 1.0


def test_residuals_show_the_stretches_that_weighed_little(
    pendulum, folder, system, tmp_path, capsys
):
    spike = 0.5 * (np.arange(1000) == 30)[:, None]
    spoilt = [
        replace(e, q=e.q + spike[: len(e)], v=None, v_measured=False) if e.split == "train" else e
        for e in pendulum
    ]
    recipe = read_recipe(
        "grey", ["search.robust=student", "search.initial=anchored", "search.substeps=1"]
    )
    request = FitRequest(tn.DataSet("spoilt", tuple(spoilt)), recipe, system=system)
    model = run_fit(prepare(request), tmp_path / "run").folder / "model.safetensors"
    told = read_header(model)["identification"]["downweighted"]
    name = told[0]["record"]
    arguments = ["evaluate", model, folder, "--system", system, "--split", "train"]
    arguments.append("--residuals")
    code, out, _ = tustinnet(capsys, *arguments)
    assert code == 0
    assert "Down-weighted in identification" in out
    code, out, _ = tustinnet(capsys, *arguments, "--json")
    assert name in {s["record"] for s in json.loads(out)["residuals"]["downweighted"]}


def test_a_model_that_runs_away_is_scored_without_residuals(folder, system, tmp_path, capsys):
    equations = load_system(find_system(system))
    values = equations.nominal() | {"damping": -1000.0}
    values = {name: jnp.asarray(value) for name, value in values.items()}
    model = tn.discretise(equations.model(values), 0.02, substeps=1)
    tn.save(model, tmp_path / "model.safetensors")
    asked = ("evaluate", tmp_path / "model.safetensors", folder, "--system", system, "--residuals")
    code, out, err = tustinnet(capsys, *asked)
    assert code == 0
    assert "diverged" in out
    assert "note: no residuals of " in err


def test_the_parameters_of_a_search_that_was_stopped_are_in_its_log(
    pendulum, system, tmp_path, monkeypatch
):
    from tustinnet.fits import in_folder

    def stopped(task, listener, *more):
        told = []
        after = replace(listener, on_stage=lambda of: (listener.on_stage(of), told.append(of)))

        def iteration(of):
            if len(told) == 1:
                raise KeyboardInterrupt
            listener.on_iteration(of)

        return fit_task(task, replace(after, on_iteration=iteration))

    monkeypatch.setattr(in_folder, "fit_task", stopped)
    fit = prepare(FitRequest(pendulum, "grey", system=system))
    with pytest.raises(KeyboardInterrupt):
        run_fit(fit, tmp_path / "run")
    lines = (tmp_path / "run" / "log.jsonl").read_text().splitlines()
    assert set(json.loads(lines[-1])["parameters"]) == {*TRUTH, "inertia"}
    with pytest.raises(tn.InputError, match=r"log\.jsonl"):
        run_fit(fit, tmp_path / "run")


@pytest.mark.thorough
def test_a_second_fit_does_not_overwrite_the_first(identified, folder, system, capsys):
    arguments = ["fit", folder, "--recipe", "grey", "--system", system, "--out", identified]
    arguments += ["--no-report"]
    before = (identified / "model.safetensors").read_bytes()
    code, _, err = tustinnet(capsys, *arguments)
    assert code == 1
    assert "there already" in err
    assert (identified / "model.safetensors").read_bytes() == before
    code, out, _ = tustinnet(capsys, *arguments, "--overwrite")
    assert code == 0
    assert "gravity" in out
    assert "converged" in out


def test_every_verb_takes_the_model_with_its_system(identified, folder, system, tmp_path, capsys):
    model = identified / "model.safetensors"
    code, out, _ = tustinnet(
        capsys, "evaluate", model, folder, "--system", system, "--json", "--ahead", 5
    )
    assert code == 0
    assert json.loads(out)["means"]["validation"] < 0.02
    code, _, _ = tustinnet(
        capsys,
        "simulate",
        model,
        folder,
        "--system",
        system,
        "--split",
        "all",
        "--out",
        tmp_path / "sim",
    )
    assert code == 0
    assert len(list((tmp_path / "sim").glob("*.csv"))) == 5
    code, out, _ = tustinnet(capsys, "show", model)
    assert code == 0
    assert "gravity 20" in out
    assert "Runge-Kutta" in out


def test_without_its_system_the_model_names_the_option(identified, folder, capsys):
    (identified / "system.py").unlink()
    code, _, err = tustinnet(capsys, "evaluate", identified / "model.safetensors", folder)
    assert code == 1
    assert "--system small_pendulum.py" in err


class Terminal(io.StringIO):
    """A terminal at which somebody types."""

    def isatty(self) -> bool:
        return True


def test_the_kept_copy_runs_only_where_it_is_trusted(
    identified, folder, tmp_path, monkeypatch, capsys
):
    copy, marker = identified / "system.py", tmp_path / "it-ran"
    kept = tn.read_header(identified / "model.safetensors")["system_copy"]
    assert kept == {"file": "system.py", "sha256": sha256(copy.read_bytes()).hexdigest()}
    evaluate = ["evaluate", identified / "model.safetensors", folder]
    assert tustinnet(capsys, *evaluate)[0] == 0  # `fit` remembered it, and so for a copy of the run

    copy.write_text(f"{SYSTEM}open({str(marker)!r}, 'w').close()\n")  # changed: nobody trusts it
    code, _, err = tustinnet(capsys, *evaluate)
    assert (code, err.count("\n")) == (1, 1)
    assert "grey/system.py: Python code that was kept with the model" in err
    assert f"--system {copy}" in err

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for answer in ("", "\n", "n\n", "maybe\n"):
        monkeypatch.setattr(sys, "stdin", Terminal(answer))
        code, _, err = tustinnet(capsys, *evaluate)
        assert code == 1
        assert "run it? [y/N]" in err
    assert not marker.exists()
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    assert tustinnet(capsys, *evaluate)[0] == 0
    assert marker.exists()
    code, _, err = tustinnet(capsys, *evaluate)
    assert code == 0
    assert "[y/N]" not in err  # asked once

    monkeypatch.setenv("TUSTINNET_CONFIG", str(tmp_path / "another user"))
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\n"))  # a pipe
    code, _, err = tustinnet(capsys, *evaluate)
    assert code == 1
    assert "[y/N]" not in err


def test_a_fit_does_not_replace_another_system_file(folder, system, tmp_path, capsys):
    own = tmp_path / "run" / "system.py"
    own.parent.mkdir()
    own.write_text("# my own\n")
    arguments = ["fit", folder, "--recipe", "grey", "--system", system, "--out", own.parent]
    code, _, err = tustinnet(capsys, *arguments)
    assert code == 1
    assert "run/system.py: another file than" in err
    assert own.read_text() == "# my own\n"


def test_a_changed_system_is_refused_but_comments_may_change(identified, folder, system, capsys):
    arguments = ["evaluate", identified / "model.safetensors", folder, "--system", system]
    system.write_text("# a remark\n" + SYSTEM.replace("a pendulum with friction", "much said"))
    assert tustinnet(capsys, *arguments)[0] == 0
    system.write_text(SYSTEM.replace("jnp.cos(q[0])", "jnp.cos(2 * q[0])"))
    code, out, err = tustinnet(capsys, *arguments)
    assert code == 1
    assert out == ""
    assert "'small-pendulum' has changed since the model was identified" in err
    assert "'angle' moves otherwise by" in err


CALLING = SYSTEM.replace("jnp.cos(q[0])", "height(q)")
HEIGHT = "def height(q):\n    return jnp.cos(q[0])\n"


def in_the_same_file(system, height):
    system.write_text(CALLING.replace("SYSTEM =", f"{height}\n\nSYSTEM ="))


def in_a_module(system, height):
    (system.parent / "heights.py").write_text(f"import jax.numpy as jnp\n\n\n{height}")
    system.write_text(
        CALLING.replace("import tustinnet", "from heights import height\nimport tustinnet")
    )
    sys.modules.pop("heights", None)


@pytest.mark.parametrize("write", [in_the_same_file, in_a_module])
def test_a_function_that_the_energies_call_may_move_but_not_change(
    identified, folder, system, monkeypatch, capsys, write
):
    monkeypatch.syspath_prepend(system.parent)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setitem(sys.modules, "heights", None)  # put back as it was, not there
    model = identified / "model.safetensors"
    write(system, HEIGHT)
    assert tn.load_model(model, system).state_size == 2
    write(system, HEIGHT.replace("cos(q[0])", "cos(1.0001 * q[0])"))
    code, _, err = tustinnet(capsys, "evaluate", model, folder, "--system", system)
    assert code == 1
    assert "has changed since the model was identified" in err


@pytest.mark.thorough
def test_several_models_stand_side_by_side(
    identified, run_folder, folder, system, tmp_path, capsys
):
    models = [identified / "model.safetensors", run_folder / "model.safetensors"]
    code, out, _ = tustinnet(
        capsys,
        "evaluate",
        *models,
        folder,
        "--system",
        system,
        "--split",
        "validation",
        "--figures",
        tmp_path / "overlay",
    )
    assert code == 0
    assert "grey/model" in out
    assert "run/model" in out
    assert "(standing still)" in out or "(constant speed)" in out
    assert {p.name for p in (tmp_path / "overlay").iterdir()} == {"fall3.png", "noise2.png"}
    code, out, _ = tustinnet(capsys, "evaluate", *models, folder, "--system", system, "--json")
    means = {label: m["mean"] for label, m in json.loads(out)["models"].items()}
    assert means["grey/model"] < means["run/model"]


@pytest.mark.parametrize("count", [1, 2])
def test_a_horizon_is_told_with_scores(count, run_folder, folder, capsys):
    models = [run_folder / f"seed-{i}" / "model.safetensors" for i in range(count)]
    asked = ("evaluate", *models, folder, "--split", "validation")
    code, out, _ = tustinnet(capsys, *asked, "--horizon", 1.2)
    assert code == 0
    assert "start 'derived-6', restarted every 1.2 s" in out
    told = json.loads(tustinnet(capsys, *asked, "--horizon", 1.2, "--json")[1])
    assert told["horizon"] == 1.2
    assert json.loads(tustinnet(capsys, *asked, "--json")[1])["horizon"] is None
    for wrong in (0.05, 100):
        code, out, err = tustinnet(capsys, *asked, "--horizon", wrong)
        assert (code, out) == (1, "")
        named = f"{asked[1]}: " if count > 1 else ""  # one of several models
        assert err.startswith(f"error: {named}horizon: ")


@pytest.mark.thorough
def test_residuals_tell_a_good_model_from_a_poor_one(
    identified, run_folder, folder, system, tmp_path, capsys
):
    asked = ("evaluate", run_folder / "model.safetensors", folder, "--residuals")
    code, out, _ = tustinnet(capsys, *asked, "--figures", tmp_path)
    assert code == 0
    assert "not white" in out
    assert (tmp_path / "residuals.png").stat().st_size > 5000
    code, out, _ = tustinnet(
        capsys,
        "evaluate",
        identified / "model.safetensors",
        folder,
        "--system",
        system,
        "--split",
        "validation",
        "--residuals",
        "--lags",
        20,
        "--json",
    )
    assert code == 0
    (angle,) = json.loads(out)["residuals"]["coordinates"]
    assert len(angle["autocorrelation"]) == 21
    assert len(angle["cross"][0]) == 41
    assert angle["rms"] < 0.02


@pytest.mark.thorough
def test_a_reversed_input_ends_with_its_name_and_exit_code_1(folder, system, tmp_path, capsys):
    card = folder / "dataset.toml"
    for path in folder.glob("*.csv"):
        head, *rows = path.read_text().splitlines()
        turned = [",".join([*row.split(",")[:2], str(-float(row.split(",")[2]))]) for row in rows]
        path.write_text("\n".join([head, *turned]) + "\n")
    assert card.is_file()
    code, out, err = tustinnet(
        capsys, "fit", folder, "--recipe", "grey", "--system", system, "--out", tmp_path / "turned"
    )
    assert code == 1
    assert "error: the sign of 'angle' or of 'torque' is probably reversed" in err
    assert "the sign of 'angle' or of 'torque' is probably reversed" in out
    assert "'gain' is at its lower bound" in out


@pytest.mark.thorough
def test_a_search_that_reaches_its_limit_keeps_its_model_and_warns_once(
    folder, system, tmp_path, capsys
):
    code, out, err = tustinnet(
        capsys,
        "fit",
        folder,
        "--recipe",
        "grey",
        "--system",
        system,
        "--out",
        tmp_path / "out",
        "--set",
        "search.iterations=1",
        "--no-report",
    )
    assert code == 0
    assert err.count("warning: stopped at the limit of 1 iteration ") == 1
    assert "stopped at the limit" not in out
    assert "error: " not in err
    assert (tmp_path / "out" / "model.safetensors").is_file()


# a function that fails from a call on
LATE = """calls = []


def late():
    calls.append(1)
    if len(calls) > {}:
        raise RuntimeError("late")


SYSTEM ="""

BROKEN = {
    "no SYSTEM": "x = 1\n",
    "fails at line 1 with ZeroDivisionError": "1 / 0\n",
    "SyntaxError": "def\n",
    "SYSTEM is a int": "SYSTEM = 3\n",
    "returns shape (1,)": SYSTEM.replace("v[0] ** 2 / 2", "v ** 2"),
    "asks for the parameter 'mass'": SYSTEM.replace('p["inertia"] * v[0]', 'p["mass"] * v[0]'),
    "singular or negative": SYSTEM.replace("v[0] ** 2 / 2", "v[0] * 0"),
    "not quadratic in v": SYSTEM.replace("v[0] ** 2 / 2", "v[0] ** 2 * (1 + v[0]) / 2"),
    "dissipation: not a finite number for angle": SYSTEM.replace(
        'p["damping"] * v', 'p["damping"] * jnp.sqrt(v)'
    ),
    "potential: not a finite number": SYSTEM.replace("jnp.cos(q[0])", "jnp.log(q[0] - q[0])"),
    "with SystemExit: 0": "raise SystemExit(0)\n",
    "range 100..1; expected lower first": SYSTEM.replace("10.0, 1.0, 100.0", "10.0, 100.0, 1.0"),
    "coordinates": SYSTEM.replace('"angle", "angular"', '"x", "linear"'),
    "fails at line 1 with GeneratorExit": "raise GeneratorExit\n",
    "fails at line 1 with KeyboardInterrupt": "raise KeyboardInterrupt\n",
    "fails at line 1 with RecursionError": "(f := lambda: f())()\n",
    "fails at line 3 with Bad: without a text": (
        "class Bad(Exception):\n    def __str__(self): raise Bad\nraise Bad\n"
    ),
    "broken.py at line 13: system 'small-pendulum', input_map: fails with RuntimeError: late": (
        SYSTEM.replace('p["gain"] * u', "late()").replace("SYSTEM =", LATE.format(0))
    ),
    "input_map fails at line 13 with RuntimeError: late": (  # when the equations are derived
        SYSTEM.replace('p["gain"] * u', "late() or u").replace("SYSTEM =", LATE.format(2))
    ),
    "input_map fails at line 13 with SystemExit: late": (  # while parameters are identified
        SYSTEM.replace('p["gain"] * u', "late() or p['gain'] * u").replace(
            "SYSTEM =", LATE.format(3).replace("RuntimeError", "SystemExit")
        )
    ),
    "fails with TypeError: grad": SYSTEM.replace('p["inertia"] * v[0] ** 2 / 2', "3"),
    "unhashable type: 'list'": SYSTEM.replace(
        '(tn.Coordinate("angle", "angular"),)', '[tn.Coordinate("angle", "angular")]'
    ),
    "holds the character '\\x1b'": SYSTEM.replace("small-pendulum", "\\x1b[31m"),
    "null bytes": "x = 1\0\n",
    "broken.py: more than 1 MB": "#" * 1_000_001,
    "nominal value 10": SYSTEM.replace("10.0, 1.0, 100.0", "10.0, 11.0, 100.0"),
}


@pytest.mark.parametrize("told", BROKEN)
@pytest.mark.usefixtures("unchecked")
def test_a_broken_system_file_is_one_line(told, folder, tmp_path, capsys):
    path = tmp_path / "broken.py"
    path.write_text(BROKEN[told])
    code, _, err = tustinnet(
        capsys, "fit", folder, "--recipe", "grey", "--system", path, "--out", tmp_path / "out"
    )
    assert code == 1
    assert told in err
    assert err.count("error: ") == 1
    assert "Traceback" not in err


def test_a_system_file_is_text_in_a_file(tmp_path):
    path = tmp_path / "arm.py"
    path.write_bytes(b"# -*- coding: latin-1 -*-\n# \xe9\n" + SYSTEM.encode())
    with pytest.raises(tn.InputError, match=r"arm\.py: cannot be read .*utf-8"):
        tn.load_system(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(tn.InputError, match=r"arm\.py: a folder or pipe"):
        tn.load_system(path)


@pytest.mark.thorough
def test_a_system_file_is_run_once_and_leaves_nothing_beside_it(
    identified, folder, system, tmp_path, capsys
):
    system.write_text(f"{SYSTEM}print('it runs')\n")
    before = set(system.parent.iterdir())
    model = identified / "model.safetensors"
    for arguments in (
        ["evaluate", model, folder],
        ["evaluate", model, model, folder],
        ["fit", folder, "--recipe", "grey", "--out", tmp_path / "again", *QUIET, *BRIEF],
    ):
        code, out, err = tustinnet(capsys, *arguments, "--system", system)
        assert code == 0, err
        assert out.count("it runs") == 1
    assert set(system.parent.iterdir()) - before == {tmp_path / "again"}


GREY = ["--recipe", "grey", "--system", "{}"]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--recipe", "grey"], ["recipe 'grey'", "no system", "--system"]),
        (["--recipe", "best-grey"], ["recipe 'best-grey'", "no system", "--system"]),
        (["--recipe", "grey", "--system", "qube-servo3"], ["'qube-servo3'", "no such system"]),
        (["--recipe", "grey", "--system", "nowhere.py"], ["nowhere.py", "no such file"]),
        (
            ["--recipe", "grey", "--system", "qube-servo2"],
            ["coordinates", "theta (angular)", "'qube-servo2'"],
        ),
        (["--recipe", "standard", "--system", "{}"], ["--system", "tustin-net", "--recipe grey"]),
        (["--recipe", "nope", "--system", "{}"], ["no recipe 'nope'", "one of best-grey"]),
        ([*GREY, "--set", "model.fixed.mass=nominal"], ["no parameter 'mass'", "inertia"]),
        ([*GREY, "--set", "model.fixed.gain=x"], ["model.fixed.gain", "valid number"]),
        ([*GREY, "--set", "model.fixed.gain=99"], ["'gain'", "0.1..40"]),
        ([*GREY, "--set", "model.begin.gain=99"], ["'gain'", "0.1..40"]),
        ([*GREY, "--set", "model.begin.mass=1"], ["no parameter 'mass'"]),
        ([*GREY, "--set", "model.fix.gain=4"], ["model.fix", "did you mean 'fixed'?"]),
        ([*GREY, "--set", 'model.forces=["glue"]'], ["model.forces", "'glue'", "coulomb"]),
        ([*GREY, "--set", 'model.forces=["cubic:tilt"]'], ["'tilt'", "one of angle"]),
        ([*GREY, "--set", 'model.forces="cubic"'], ["model.forces", "tuple"]),
        (
            [*GREY, "--set", "model.fixed.gain=1", "--set", "model.fixed.gain=2"],
            ["--set", "'model.fixed.gain' twice"],
        ),
        ([*GREY, "--set", "search.initial=here"], ["search.initial", "unknown start"]),
        (
            [*GREY, "--set", "search.initial=warm-up-20"],
            ["search.initial", "after the first sample", "derived-6"],
        ),
        (
            [*GREY, "--set", "search.method=newton"],
            ["search.method", "'levenberg-marquardt'", "'newton'"],
        ),
        ([*GREY, "--set", "search.robst=huber"], ["search.robst", "did you mean 'robust'?"]),
        ([*GREY, "--set", "stages.0.epochs=3"], ["recipe 'grey', stages", "unknown key"]),
        (
            ["--recipe", "standard", "--set", "search.robust=huber"],
            ["recipe 'standard', search", "unknown key"],
        ),
        (
            ["--recipe", "standard", "--set", "model.fixed.gain=4"],
            ["recipe 'standard', model.fixed", "unknown key"],
        ),
        ([*GREY, "--seeds", "2"], ["--seeds", "nothing in 'grey' is random"]),
        ([*GREY, "--seeds", "1"], ["--seeds", "nothing in 'grey' is random"]),
        ([*GREY, "--set", "rates=[1,0.5]"], ["recipe 'grey', rates", "unknown key"]),
        ([*GREY, "--resume"], ["--resume", "a fit that is no training is not resumed"]),
    ],
    ids=lambda part: " ".join(part),
)
def test_options_that_do_not_fit_are_one_line(arguments, told, folder, system, tmp_path, capsys):
    arguments = [a.format(system) for a in arguments]
    out = tmp_path / "out"
    code, printed, err = tustinnet(capsys, "fit", folder, "--out", out, *arguments)
    assert code == 1
    assert printed == ""
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    for word in told:
        assert word in line
    assert "Traceback" not in err
    assert not list(out.glob("*"))


def test_ranges_may_change_without_losing_the_model(identified, folder, system, capsys):
    system.write_text(SYSTEM.replace("2.0, 0.1, 40.0", "3.0, 0.1, 80.0"))
    model = identified / "model.safetensors"
    assert tustinnet(capsys, "evaluate", model, folder, "--system", system)[0] == 0
    loaded = tn.load_model(model, tn.load_system(system))
    counts = tn.load(folder).channels.resolution
    assert counts.all()
    np.testing.assert_array_equal(loaded.channels.resolution, counts)


@pytest.mark.thorough
def test_variants_of_a_system_are_compared(identified, folder, system, tmp_path, capsys):
    """Each model finds its own file by the system's name, and by what the system computes."""
    # of another name, and of the same one
    texts = {
        "stiff": SYSTEM.replace("small-pendulum", "stiff").replace("v[0] ** 2 / 2", "v[0] ** 2"),
        "cubic": SYSTEM.replace('p["damping"] * v,', 'p["damping"] * v * (1 + v**2),'),
    }
    models, files = [identified / "model.safetensors"], [system]
    for name, text in texts.items():
        files.append(tmp_path / f"{name}.py")
        files[-1].write_text(text)
        models.append(tmp_path / name / "model.safetensors")
        arguments = ["fit", folder, "--recipe", "grey", "--system", files[-1], *QUIET, *BRIEF]
        assert tustinnet(capsys, *arguments, "--out", models[-1].parent)[0] == 0

    def compare(models, files):
        named = [part for file in files for part in ("--system", file)]
        return tustinnet(capsys, "evaluate", *models, folder, *named, "--json")

    code, out, _ = compare(models, files)
    assert code == 0
    assert len(json.loads(out)["models"]) == 3
    assert compare(models, files[::-1])[0] == 0
    code, _, err = compare(models, files[:1])
    assert (code, err.count("\n")) == (1, 1)
    assert f"{models[2]}: the system 'small-pendulum' has changed since" in err
    code, _, err = compare(models[:2], files)
    assert code == 1
    assert err.startswith(f"error: --system {files[2]}: 'small-pendulum', which no model is of")
    assert compare(models, [])[0] == 0  # the copies that were kept


def test_records_that_simulate_to_infinity_are_a_named_outcome(folder, system, tmp_path, capsys):
    system.write_text(
        SYSTEM.replace('p["damping"] * v,', '-p["damping"] * v * (1 + v**2),').replace(
            "0.3, 0.01, 10.0", "9.0, 8.0, 10.0"
        )
    )
    code, out, err = tustinnet(
        capsys, "fit", folder, "--recipe", "grey", "--system", system, "--out", tmp_path / "out"
    )
    assert code == 1
    assert "error: " in err
    assert "diverged: the simulations with the estimated values diverge" in out
    assert "Traceback" not in err


@pytest.mark.thorough
def test_fixed_parameters_stay(folder, system, tmp_path, capsys):
    code, out, _ = tustinnet(
        capsys,
        "fit",
        folder,
        "--recipe",
        "grey",
        "--system",
        system,
        "--set",
        "model.fixed.gain=4",
        "--set",
        "model.fixed.inertia=nominal",
        "--json",
        "--out",
        tmp_path / "out",
        *QUIET,
        *BRIEF,
    )
    assert code == 0
    assert json.loads(out)["identification"]["fixed"] == {"inertia": 1.0, "gain": 4.0}


@pytest.mark.thorough
def test_forces_of_the_library_are_added_and_shown(folder, system, tmp_path, capsys):
    out = tmp_path / "rubbed"
    code, told, _ = tustinnet(
        capsys,
        "fit",
        folder,
        "--recipe",
        "grey",
        "--system",
        system,
        "--set",
        'model.forces=["coulomb", "maxwell"]',
        "--set",
        "model.fixed.angle.relaxation=2.0",
        *BRIEF,
        "--no-report",
        "--out",
        out,
    )
    assert code == 0
    assert "angle.coulomb" in told
    assert "angle.maxwell" in told
    code, told, _ = tustinnet(capsys, "show", out / "model.safetensors")
    assert code == 0
    assert "coulomb:angle, maxwell:angle" in " ".join(told.split())
    code, told, _ = tustinnet(
        capsys, "evaluate", out / "model.safetensors", folder, "--system", system
    )
    assert code == 0
    assert "fall3" in told


def test_the_demo_does_the_whole_job_and_says_twin_everywhere(tmp_path, monkeypatch, capsys):
    runs = {"train": (3, 2), "validation": (1, 1), "test": (1, 1)}
    monkeypatch.setattr(qube_servo2_twin, "_TWIN_RUNS", runs)
    log_runs = twin.log_runs

    def log_beginnings(model, channels, runs, *more):
        """The first 3 s of each run."""
        return log_runs(model, channels, [replace(run, u=run.u[:300]) for run in runs], *more)

    monkeypatch.setattr(twin, "log_runs", log_beginnings)
    monkeypatch.setattr(demo, "_DRAWN", ("twin_fall_test1",))
    quick = ["search.initial=anchored", "search.substeps=2", "search.iterations=5"]
    plan = SelectionPlan.model_validate(
        {
            "name": "quick",
            "folds": 3,
            "scored": 1,
            "candidates": [
                {"name": "physics", "recipe": "grey", "set": quick},
                {"name": "linear", "recipe": "linear"},
            ],
        }
    )
    monkeypatch.setattr(demo, "_PLAN", plan)
    monkeypatch.setattr(demo, "_RUNS", 2)
    out = tmp_path / "demo"
    code, printed, err = tustinnet(capsys, "demo", "--out", out)
    assert code == 0, err
    assert "* chosen: physics" in printed
    assert "2 of 2 runs reach upright" in printed
    assert (out / "twin_controller" / "controller.c").is_file()
    assert "Twin (simulated, favours Lagrangian models)" in printed
    table = json.loads((out / "twin_table.json").read_text())
    means = {name: m["mean"] for name, m in table["models"].items()}
    assert means["physics (chosen)"] < means["linear"]
    page = (out / "twin_report.html").read_text(encoding="utf-8")
    assert "2 test records that it was not fitted to" in page
    assert [page.count(f"Show {name}") for name in means] == [1, 1]
    assert f"report: {out / 'twin_report.html'}" in err
    assert len(means) == 2
    scored = json.loads((out / "twin_choice" / "summary.json").read_text())
    assert not any(
        "test" in record for record in scored["candidates"][0]["starts"]["model-20"]["rmse"]
    )
    assert all(path.name.startswith("twin") for path in out.iterdir())
    assert tn.load(out / "twin").splits == ("train", "validation", "test")
    before = (out / "twin_table.json").read_bytes()
    assert tustinnet(capsys, "demo", "--out", out)[0] == 1
    assert (out / "twin_table.json").read_bytes() == before


@pytest.mark.thorough
def test_a_twin_written_and_read_again_is_the_same(tmp_path):
    from tustinnet.store.data_set_folder import write_data_set

    data = qube_servo2_twin.twin(3)
    few = tn.DataSet(data.name, tuple(data.split("validation")))
    write_data_set(few, tmp_path / "twin", "Simulated")
    again = tn.load(tmp_path / "twin")
    for e, r in zip(few, again, strict=True):
        np.testing.assert_allclose(r.q, e.q, atol=1e-7)
        np.testing.assert_allclose(r.t, e.t, atol=1e-8)
        assert r.padded_rows == e.padded_rows
        assert replace(r.coordinates[0]) == e.coordinates[0]
        assert (r.name, r.split) == (e.name, e.split)


def test_a_system_that_no_model_is_of_is_refused(run_folder, folder, system, capsys):
    model = run_folder / "model.safetensors"
    code, _, err = tustinnet(capsys, "evaluate", model, folder, "--system", system)
    assert code == 1
    assert "'small-pendulum', which no model is of" in err
