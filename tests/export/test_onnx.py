"""ONNX files compute what the model does, in onnxruntime and in ONNX's own reference."""

import json
import subprocess
import sys
from importlib import import_module

import jax.numpy as jnp
import numpy as np
import pytest
from documented import blocks, section
from every_family import NAMES, example_source
from every_step import (
    PROGRAMS,
    require_same_run,
    state_of,
    stepping,
    without_inputs,
)

import tustinnet as tn
from tustinnet.errors import InputError
from tustinnet.export import onnx as target_module
from tustinnet.export.onnx import ROLLOUT, SINGLE, STEP, TARGET
from tustinnet.export.source import Source, make_source
from tustinnet.program.numbers import run

onnx = import_module("onnx")  # no types are known


def made(source: Source, name: str) -> bytes:
    content = TARGET.files(source)[name]
    assert isinstance(content, bytes)
    return content


def session(content: bytes | str):
    runtime = import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    return runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def rows(source: Source, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    pairs = zip(states, inputs, strict=True)
    return np.stack([run(source.step, x=x, u=u)["x"] for x, u in pairs])


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_a_batch_of_every_family_steps_and_runs(name):
    source = example_source(name)
    files = TARGET.files(source)
    x, u = source.samples(3)
    once = rows(source, x, u)
    (found,) = session(files[STEP]).run(["x_next"], {"x": x, "u": u})
    np.testing.assert_allclose(found, once, atol=1e-13)
    course = np.stack([u, u[::-1]])
    (found,) = session(files[ROLLOUT]).run(["x"], {"x0": x, "u": course})
    np.testing.assert_allclose(found, [x, once, rows(source, once, u[::-1])], atol=1e-13)
    single = {"x0": x.astype(np.float32), "u": course.astype(np.float32)}
    (less,) = session(files[SINGLE[1]]).run(["x"], single)
    assert less.dtype == np.float32
    np.testing.assert_allclose(less, found, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("runtime", ["onnxruntime", "reference"])
@pytest.mark.parametrize("name", PROGRAMS)
def test_it_does_everything_a_program_may_hold(name, runtime, tmp_path, monkeypatch):
    if runtime != "onnxruntime":
        monkeypatch.setattr(target_module, "find_spec", lambda name: None)
    source = stepping(PROGRAMS[name])
    (tmp_path / STEP).write_bytes(made(source, STEP))
    with np.errstate(all="ignore"):
        found = TARGET.stepper(tmp_path, source)(state_of(source), np.array([0.3]))
    expected = run(source.step, x=state_of(source), u=np.array([0.3]))["x"]
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-300)


COMPOSED = (
    jnp.expm1,
    jnp.log1p,
    jnp.sinh,
    jnp.cosh,
    jnp.arcsinh,
    jnp.arccosh,
    jnp.arctanh,
    jnp.tan,
    jnp.arcsin,
    jnp.arccos,
    jnp.arctan,
)


@pytest.mark.parametrize("function", COMPOSED)
def test_what_run_times_lack_in_double_is_exact_everywhere(function):
    sizes = np.concatenate([10.0 ** np.arange(-300, 300, 7), np.linspace(0.001, 3, 400), [np.inf]])
    x = np.concatenate([sizes, -sizes, [0.0, np.nan]])
    source = stepping(lambda x, u: jnp.concatenate([function(x[:1]), x[:1]]))
    given = {"x": np.stack([x, x], axis=1), "u": np.zeros((len(x), 1))}
    (found,) = session(made(source, STEP)).run(None, given)
    expected = getattr(np, function.__name__)
    tolerance = (
        1e-13 if function is jnp.tan else 2e-15
    )  # at its poles the cosine's, which is near 0
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(found[:, 0], expected(x), rtol=tolerance, atol=0)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["network memory", "gru", "qube rubbing", "qube network"])
def test_1000_steps_are_a_rollout(name):
    source = example_source(name)
    x0, u = np.full(source.n_x, 0.1), 0.5 * np.sin(np.arange(1000.0) / 7)[:, None]
    files, expected = TARGET.files(source), np.asarray(tn.rollout(source.model, x0, u))
    given = {"x0": x0[None], "u": u[:, None]}
    (found,) = session(files[ROLLOUT]).run(None, given)
    require_same_run(found[:, 0], expected)
    # in single precision by the step: a free run also adds up what was rounded before
    single = {"x": expected[:-1].astype(np.float32), "u": u.astype(np.float32)}
    (less,) = session(files[SINGLE[0]]).run(None, single)
    assert np.max(np.abs(less - expected[1:]) / (1 + np.abs(expected[1:]))) < 1e-6


def test_a_model_without_inputs_runs():
    model = without_inputs()
    x0, u = np.array([0.1, 0.2]), np.zeros((4, 1, 0))
    (found,) = session(made(make_source(model), ROLLOUT)).run(None, {"x0": x0[None], "u": u})
    np.testing.assert_allclose(found[:, 0], tn.rollout(model, x0, u[:, 0]), rtol=1e-14)


def test_a_file_says_names_units_period_and_opset():
    model = onnx.load_from_string(made(example_source("qube"), ROLLOUT))
    told = {p.key: json.loads(p.value) for p in model.metadata_props}
    assert told == {
        "states": ["theta", "alpha", "der_theta", "der_alpha"],
        "units": ["rad", "rad", "rad/s", "rad/s"],
        "inputs": ["voltage"],
        "samples": [0],
        "period": 0.01,
    }
    assert [(o.domain, o.version) for o in model.opset_import] == [("", 17)]
    assert "opset 17" in section("ONNX")


def test_bytes_depend_on_the_model_only():
    source = example_source("hybrid")
    assert TARGET.files(source) == TARGET.files(source)


def test_without_the_package_the_extra_is_told(monkeypatch):
    monkeypatch.setattr("tustinnet.errors.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"onnx is not installed.*tustinnet\[onnx\]"):
        TARGET.require_extra()


def test_the_documented_lines_run(tmp_path):
    (tmp_path / ROLLOUT).write_bytes(made(example_source("qube"), ROLLOUT))
    (block,) = blocks("ONNX", "python")
    done = subprocess.run(
        [sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["(501,", "16,", "4)"]
