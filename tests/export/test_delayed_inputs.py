"""Delays of inputs are in every export: its steps along a record are the model's free run."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from documented import blocks
from every_family import example, hybrid, network
from every_step import require_same_run
from swinging import DT, SWING, swing_model

import tustinnet as tn
from tustinnet.export.source import Source, make_source
from tustinnet.export.target import NotRunnable
from tustinnet.store.exported import find_targets

PUSHED = replace(
    SWING,
    inputs=(*SWING.inputs, tn.Input("push", "N m")),
    input_map=lambda q, v, u, p: p["gain"] * u[:1] + u[1:],
)
RESTING = 0.1  # rad, at the beginning


def late(*timing: tuple[str, float]) -> tn.Channels:
    """Channels whose inputs have holds, and delays in periods."""
    inputs = [
        replace(i, hold=hold, delay=periods * DT)
        for i, (hold, periods) in zip(PUSHED.inputs, timing, strict=False)
    ]
    return tn.Channels(SWING.coordinates, tuple(inputs), DT)


def physics(*timing: tuple[str, float]) -> tn.Model:
    system = PUSHED if len(timing) > 1 else SWING
    return tn.discretise(swing_model(system=system), DT, inputs=late(*timing).inputs)


MODELS = {
    "whole": lambda: physics(("zero-order", 7)),  # 7.000000000000001 periods, as it is divided
    "fraction": lambda: physics(("zero-order", 2.5)),
    "early": lambda: physics(("zero-order", -0.5)),
    "lines": lambda: physics(("first-order", 1.25)),
    "two": lambda: physics(("zero-order", 3), ("first-order", 0.4)),
    "network": lambda: network(0, late(("zero-order", 2.5)), times=(0.5,)),
    "hybrid": lambda: hybrid(1, late(("zero-order", 1.5)), taps=(-1, 0, 1)),
}


@cache
def source(name: str) -> Source:
    return make_source(MODELS[name]())


@cache
def free_run(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start, inputs and states of a free run of the package along a record."""
    return free_run_of(MODELS[name]())


def free_run_of(model: tn.Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    u = np.random.default_rng(0).uniform(-1, 1, (40, model.channels.n_u))
    q = np.zeros((40, model.channels.n_q))
    record = tn.from_arrays(
        q, u, dt=DT, coordinates=model.coordinates, inputs=model.inputs, name="run"
    )
    x0 = np.r_[RESTING, np.zeros(model.state_size - 1)]
    return x0, u, np.asarray(tn.rollout(model, x0, tn.input_signal(model, record)))


def stepped(of: Source, step, x0: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The steps of an export along a record, beyond whose ends its end samples count."""
    rows = np.clip(np.arange(len(u))[:, None] + np.array(of.input_layout.offsets), 0, len(u) - 1)
    states = [x0]
    for samples in rows[:-1]:
        states.append(step(states[-1], u[samples].ravel()))
    return np.array(states)


@pytest.mark.parametrize("to", ["c", "casadi", "onnx", "js", "stablehlo"])
@pytest.mark.parametrize("name", MODELS)
def test_steps_along_a_record_are_the_free_run(name, to, tmp_path):
    of, (target,) = source(name), find_targets(to)
    for file, content in target.files(of).items():
        Path(tmp_path / file).write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
    try:
        step = target.stepper(tmp_path, of)
    except NotRunnable as reason:
        pytest.skip(str(reason))
    x0, u, expected = free_run(name)
    require_same_run(stepped(of, step, x0, u), expected, relative=1e-9)


def test_only_samples_that_act_are_asked_for():
    asked = {name: source(name).input_layout.offsets for name in MODELS}
    assert asked["whole"] == (0, -7)
    assert asked["fraction"] == (0, -2, -3)
    assert asked["lines"] == (0, -1, -2)
    assert asked["two"] == (0, 1, -1, -3)
    assert not any("late" in note for name in MODELS for note in source(name).notes)


def test_the_matrices_of_a_linear_model_have_columns_for_earlier_inputs(tmp_path):
    model = replace(example("linear"), channels=late(("zero-order", 2.5)))
    of, (target,) = make_source(model), find_targets("mat")
    for file, content in target.files(of).items():
        (tmp_path / file).write_bytes(bytes(content))  # pyright: ignore[reportArgumentType]
    assert of.input_names == ("voltage", "voltage_before_2", "voltage_before_3")
    x0, u, expected = free_run_of(model)
    require_same_run(stepped(of, target.stepper(tmp_path, of), x0, u), expected, relative=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["two", "hybrid"])
def test_the_pages_lines_give_a_record_to_a_free_run(name, tmp_path, monkeypatch):
    onnxruntime = pytest.importorskip("onnxruntime")
    tn.export_model(MODELS[name](), "onnx", tmp_path / "out")
    monkeypatch.chdir(tmp_path / "out")
    x0, u, expected = free_run(name)
    (program,) = blocks("What a step is given", "python")
    exec(program, known := {"u": u})
    session = onnxruntime.InferenceSession("rollout.onnx")
    given = {"x0": x0[None], "u": known["step_inputs"][:-1, None]}
    require_same_run(session.run(["x"], given)[0][:, 0], expected, relative=1e-9)


def test_a_long_delay_is_found_at_once():
    of = make_source(physics(("zero-order", 20_000.5)))
    assert of.input_layout.offsets == (0, -20_000, -20_001)
    line = [[0, -0.25, 1.25], [0, 1.5, -1.5]]  # over a period in whose middle the input changes
    np.testing.assert_allclose(of.input_layout.matrix, line, atol=1e-9)
    assert np.isfinite(np.asarray(of.function(jnp.zeros(2), jnp.ones(3)))).all()
