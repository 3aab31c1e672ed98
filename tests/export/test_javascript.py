"""JavaScript computes what the model does, in node and in a browser."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from documented import blocks
from every_family import CHANNELS, NAMES, example_source, network
from every_step import (
    PROGRAMS,
    require_same_run,
    state_of,
    stepping,
    without_inputs,
)

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.export.javascript import MODULE, TARGET
from tustinnet.export.source import Source, make_source
from tustinnet.export.target import NotRunnable
from tustinnet.program.numbers import run
from tustinnet.simulate.range import Range

NODE = shutil.which("node")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
by_node = pytest.mark.skipif(NODE is None, reason="node is not installed")


def written(source: Source, folder: Path) -> Path:
    text = TARGET.files(source)[MODULE]
    assert isinstance(text, str)
    (folder / MODULE).write_text(text, encoding="utf-8")
    return folder


def node(script: str, folder: Path) -> str:
    assert NODE is not None
    done = subprocess.run(
        [NODE, "--input-type=module", "--eval", script],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert not done.stderr
    return done.stdout


@pytest.mark.thorough
@by_node
@pytest.mark.parametrize("name", NAMES)
def test_node_steps_every_family(name, tmp_path):
    source = example_source(name)
    step = TARGET.stepper(written(source, tmp_path), source)
    for x, u in zip(*source.samples(5), strict=True):
        np.testing.assert_allclose(step(x, u), run(source.step, x=x, u=u)["x"], atol=1e-13)


@by_node
@pytest.mark.parametrize("name", PROGRAMS)
def test_node_does_everything_a_program_may_hold(name, tmp_path):
    source = stepping(PROGRAMS[name])
    step = TARGET.stepper(written(source, tmp_path), source)
    x, u = state_of(source), np.array([0.3])
    expected = run(source.step, x=x, u=u)["x"]
    expected[~np.isfinite(expected)] = np.nan  # JSON has no other word
    np.testing.assert_allclose(step(x, u), expected, rtol=1e-14, atol=1e-300)


@by_node
def test_a_model_without_inputs_steps(tmp_path):
    source, x, u = make_source(without_inputs()), np.array([0.1, 0.2]), np.zeros(0)
    found = TARGET.stepper(written(source, tmp_path), source)(x, u)
    np.testing.assert_allclose(found, run(source.step, x=x, u=u)["x"], rtol=1e-14)


def rolled(module: str, x0: np.ndarray, u: np.ndarray) -> str:
    """A script that makes a free run of a module."""
    return f"""{module}
const state = init({json.dumps(x0.tolist())}), other = init({json.dumps((-x0).tolist())});
const run = [Array.from(state.x)];
for (const u of {json.dumps(u.tolist())}) {{
  step(other, u);  // in between, as it has a state of its own
  run.push(Array.from(step(state, u).x));
}}
"""


@pytest.mark.thorough
@by_node
@pytest.mark.parametrize("name", ["network memory", "gru", "qube memory", "qube network"])
def test_500_steps_in_node_are_a_rollout(name, tmp_path):
    source = example_source(name)
    x0, u = np.full(source.n_x, 0.1), 0.5 * np.sin(np.arange(500.0) / 7)[:, None]
    script = rolled(f'import {{ init, step }} from "./{MODULE}";', x0, u)
    found = node(f"{script}console.log(JSON.stringify(run));", written(source, tmp_path))
    require_same_run(json.loads(found), tn.rollout(source.model, x0, u))


HOSTILE = "<script>'\"`${x} é"


def hostile() -> Source:
    """A model whose names would end a text or begin something else."""
    channels = tn.Channels(
        (tn.Coordinate(f"{HOSTILE}<!--", "angular"),), (tn.Input(f"{HOSTILE}--&gt;", "V"),), 0.02
    )
    known = Range(np.array([[-1.0, 1.0]] * 2), np.array([[-3.0, 3.0]]))
    return make_source(network(0, channels), known)


@by_node
def test_a_module_says_names_period_and_range(tmp_path):
    source = hostile()
    script = f'import * as model from "./{MODULE}"; console.log(JSON.stringify(model));'
    told = json.loads(node(script, written(source, tmp_path)))
    assert told["states"] == list(source.states)
    assert told["inputs"] == [source.channels.inputs[0].name]
    assert told["period"] == 0.02
    assert told["samples"] == [0]
    assert told["range"] == {"states": [[-1, 1], [-1, 1]], "inputs": [[-3, 3]]}


@pytest.mark.parametrize("name", ["</script>", "\u2028", "<!--"])
def test_no_text_ends_a_script_or_a_line(name, monkeypatch):
    source = example_source("network memory")
    monkeypatch.setattr(Source, "states", (name,))
    text = TARGET.files(source)[MODULE]
    assert name not in text
    told = re.search(r"states = (.*);", str(text))
    assert told
    assert json.loads(told[1]) == [name]


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_a_browser_makes_the_same_run(tmp_path):
    source = hostile()
    x0, u = np.array([0.4, -0.2]), 0.5 * np.sin(np.arange(500.0) / 7)[:, None]
    script = rolled(str(TARGET.files(source)[MODULE]), x0, u)
    page = tmp_path / "page.html"
    page.write_text(
        '<!doctype html><meta charset="utf-8"><body><script type="module">'
        f"{script}document.body.textContent = `<${{JSON.stringify(run)}}>`;</script></body>",
        encoding="utf-8",
    )
    assert CHROMIUM is not None
    done = subprocess.run(
        [CHROMIUM, *QUIET, f"--user-data-dir={tmp_path}/user", "--dump-dom", page.as_uri()],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    found = re.search(r"&lt;(\[.*\])&gt;", done.stdout)
    assert found
    require_same_run(json.loads(found[1]), tn.rollout(source.model, x0, u))


@by_node
def test_a_wrong_number_of_numbers_is_told(tmp_path):
    script = f"""import {{ init, step }} from "./{MODULE}";
    for (const wrong of [() => init([1]), () => step(init([1, 2, 3]), [1, 2])]) {{
      try {{ wrong(); }} catch (error) {{ console.log(`${{error}}`); }}
    }}"""
    found = node(script, written(example_source("network memory"), tmp_path))
    assert found.splitlines() == [
        "RangeError: x0 has 1 numbers, not 3",
        "RangeError: u has 2 numbers, not 1",
    ]


@by_node
def test_a_process_that_ends_is_told_and_none_stays(tmp_path):
    source = example_source("network memory")
    step = TARGET.stepper(written(source, tmp_path), source)
    process = cast(Any, step)._process
    step(*(of[0] for of in source.samples(1)))
    del step
    assert process.returncode == 0
    (tmp_path / MODULE).write_text("export {")
    broken = TARGET.stepper(tmp_path, source)
    with pytest.raises(InputError, match=r"`to=` js: node ended: .*SyntaxError"):
        broken(*(of[0] for of in source.samples(1)))


def test_without_node_nothing_is_run(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(NotRunnable, match="node is not installed"):
        TARGET.stepper(tmp_path, example_source("physics"))


@by_node
def test_the_documented_lines_run(tmp_path):
    (block,) = blocks("JavaScript", "js")
    found = node(block, written(example_source("qube"), tmp_path))
    assert "theta" in found
    assert len(re.findall(r"-?\d+\.\d+", found)) >= CHANNELS.n_q
