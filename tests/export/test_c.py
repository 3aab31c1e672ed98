"""A model in C is the model: compiled here, stepped through ctypes."""

import ctypes
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import NAMES, example
from every_step import require_same_run
from swinging import DT, SWING, swing_model

import tustinnet as tn
from tustinnet.engine.engines import make_linearised_step
from tustinnet.export.c import TARGET, compile_c, library_step
from tustinnet.export.check import check_export
from tustinnet.export.source import Source, make_source
from tustinnet.export.target import NotRunnable
from tustinnet.models.contract import Model
from tustinnet.simulate.filtering import FilterNoise, KalmanFilter, kalman_filter

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

STRICT = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Werror",
    "-fsyntax-only",
]
STEADY = ("qube network", "qube hybrid")
FLOAT_STEP = 1e-6  # of a step in single precision, relative to 1 + the state


class Odd(Model):
    """Uses every operation there is, on numbers and on vectors, in loops of loops too."""

    channels: tn.Channels = tn.Channels(
        tuple(tn.Coordinate(f"q{i}", "linear") for i in range(5)), (tn.Input("u", "V"),), 0.5
    )

    def step(self, x, u):
        single = [odd(x[3:4], u[0]) for odd in (smooth, jumping, chosen)]
        whole = [odd(x, u[0]) for odd in (smooth, jumping, chosen, beyond, turning)]
        return jnp.sum(jnp.stack(single)) + jnp.sum(jnp.stack(whole), axis=0)


def smooth(x, u):
    plain = (jnp.sin, jnp.cos, jnp.tan, jnp.arctan, jnp.sinh, jnp.cosh, jnp.tanh, jnp.arcsinh)
    inner = (jnp.arcsin, jnp.arccos, jnp.arctanh, jnp.expm1, jnp.log1p)
    outer = (jnp.log, jnp.sqrt, jnp.arccosh, jnp.exp)
    found = sum(f(x / 3) for f in plain) + sum(f(jnp.tanh(x) / 2) for f in inner)
    found = found + sum(f(2 + x**2) for f in outer) + (x**2 + 0.3) ** (u / 7)
    return found / 20 - x / (2 + u**2) + jnp.arctan2(x, u + 2.5)


def jumping(x, u):
    parts = jnp.abs(x), jnp.sign(x), jnp.floor(x), jnp.ceil(x), jnp.fmod(x, 0.3), -x
    return sum(parts) + jnp.maximum(x, u) + jnp.minimum(x, 0.2)


def chosen(x, u):
    truths = (x > u) | ~(x < 0.1) & (x <= 2) | (x >= 3) | (x == u) | (x != x)
    either = jnp.where(x > 0, truths, x > -1)
    never = jnp.maximum(x, jnp.nan) > 0
    return jnp.where(either, x, truths * u) + jnp.where(u > 0.1, x, -x) + truths + 9.0 * never


def beyond(x, u):
    """Constants that single precision does not have."""
    far = jnp.array([jnp.inf, 1e300, 1e-300, -jnp.inf, 1e-42, -1e300, 0.0, -0.0, 3e38, 1.0])
    far = far[: len(x)]
    return jnp.where(jnp.abs(x) > far, 1.0, x) + jnp.where(x < -1e200, -jnp.inf, 0.0)


def turning(x, u):
    matrix = jnp.asarray(np.random.default_rng(1).normal(size=(len(x), len(x))) / 10)

    def inner(carried, given):
        y, seen = carried
        y = jnp.tanh(matrix @ y + given)
        return (y, seen | (y > 0.5)), None

    def outer(carried, given):
        y, z = carried
        (y, seen), _ = jax.lax.scan(inner, (y, y > 9), given + jnp.zeros((40, 1)))
        # one takes the place of the other: it cannot be written over it
        return (z, jnp.where(seen, y, z * 0.5)), None

    return sum(jax.lax.scan(outer, (x, 2 * x), jnp.arange(12.0)[:, None])[0])


@cache
def source(name: str) -> Source:
    if name == "odd":
        return make_source(Odd())
    if name == "free":  # of no inputs
        system = replace(SWING, inputs=(), input_map=lambda q, v, u, p: 0.0 * v)
        return make_source(tn.discretise(swing_model(system=system), DT))
    return make_source(example(name))


ALL = (*NAMES, "odd", "free")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folders with the C of a model, by name."""

    @cache
    def write(name: str) -> Path:
        folder = tmp_path_factory.mktemp("c")
        for file, text in TARGET.files(source(name)).items():
            (folder / file).write_text(str(text))
        return folder

    return write


@pytest.fixture(scope="module")
def compiled(written):
    """Shared libraries of the model and its filter, by name."""

    @cache
    def build(name: str, *flags: str) -> Path:
        folder = written(name)
        to = folder / f"lib{'-'.join(flags)}.so"
        sources = [folder / "model.c", folder / "estimate.c"]
        compile_c(sources, to, ["-std=c99", "-O0", "-fPIC", "-shared", *flags])
        return to

    return build


def called(library: Path, function: str, *arrays: np.ndarray) -> None:
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in arrays]
    getattr(ctypes.CDLL(str(library)), function)(*pointers)


@pytest.mark.parametrize("name", ALL)
def test_a_step_and_its_derivatives_are_the_models(name, compiled):
    library, of = compiled(name), source(name)
    assert check_export(of, TARGET, library_step(library, of.n_x)).difference < 1e-13
    x, u = (values[0] for values in of.samples(1, seed=1))
    following, a, b = np.empty(of.n_x), np.empty((of.n_x, of.n_x)), np.empty((of.n_x, of.n_w))
    called(library, "model_linearise", x, u, following, a, b)
    step = library_step(library, of.n_x)
    np.testing.assert_allclose(following, step(x, u), rtol=1e-14, atol=1e-14)
    w, near = np.r_[x, u], 1e-5 * np.eye(of.n_x + of.n_w)
    differences = [
        step(*np.split(w + by, [of.n_x])) - step(*np.split(w - by, [of.n_x])) for by in near
    ]
    np.testing.assert_allclose(np.hstack([a, b]), np.stack(differences, axis=1) / 2e-5, atol=1e-6)


@pytest.mark.parametrize("precision", ["-DMODEL_DOUBLE", "-DMODEL_FLOAT"])
@pytest.mark.parametrize("name", ALL)
def test_compilers_have_nothing_to_say(name, precision, written):
    files = ["model.c", "estimate.c", "example.c"]
    done = subprocess.run(
        ["gcc", *STRICT, precision, *files], cwd=written(name), capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", STEADY)
def test_a_thousand_steps_are_the_rollout(name, compiled):
    of = source(name)
    u = 2 * np.sin(np.arange(1000) / 20)[:, None]
    x0 = np.r_[0.1, 0.2, np.zeros(of.n_x - 2)]
    expected = np.asarray(tn.rollout(of.model, x0, u))
    step, found = library_step(compiled(name), of.n_x), [x0]
    for k in range(1000):
        found.append(step(found[-1], u[k]))
    require_same_run(found, expected)


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_a_step_in_single_precision_is_near(name, compiled):
    library, of = compiled(name, "-DMODEL_FLOAT"), source(name)
    state, exact = np.zeros(of.n_x, np.float32), library_step(compiled(name), of.n_x)
    for x, u in zip(*of.samples(50), strict=True):
        x, u = x.astype(np.float32), u.astype(np.float32)
        called(library, "model_init", state, x)
        called(library, "model_step", state, u)
        expected = exact(x, u)
        assert np.max(np.abs(state - expected) / (1 + np.abs(expected))) < FLOAT_STEP


def test_models_do_not_know_of_one_another(compiled):
    library, u = compiled("qube hybrid"), np.ones(1)
    one, two, alone = np.full(5, 0.1), np.full(5, -0.3), np.full(5, 0.1)
    for _ in range(10):
        called(library, "model_step", alone, u)
    for _ in range(10):
        called(library, "model_step", one, u)
        called(library, "model_step", two, -u)
    np.testing.assert_array_equal(one, alone)
    assert np.abs(two - one).max() > 0.1


@pytest.mark.parametrize("name", STEADY)
def test_it_needs_nothing_but_the_mathematical_library(name, compiled):
    told = subprocess.run(
        ["nm", "-u", "-D", compiled(name)], capture_output=True, text=True, check=True
    ).stdout
    needed = {line.split()[-1].split("@")[0] for line in told.splitlines() if " U " in line}
    assert {"sin", "cos"} <= needed
    assert needed <= {"sin", "cos", "tanh", "sqrt", "__stack_chk_fail"}


def test_nothing_that_changes_is_kept_outside_of_the_state(written):
    subprocess.run(["gcc", "-c", "-O2", "model.c"], cwd=written("qube hybrid"), check=True)
    told = subprocess.run(
        ["nm", "model.o"], cwd=written("qube hybrid"), capture_output=True, text=True, check=True
    ).stdout
    kinds = {line.split()[-2] for line in told.splitlines()}
    assert kinds <= {"T", "t", "r", "U"}  # code and constants, no data


@pytest.mark.parametrize("name", STEADY)
def test_the_commands_of_its_readme_compile_and_run_the_example(name, written):
    folder = written(name)
    readme = (folder / "README.md").read_text()
    commands = [line.strip() for line in readme.splitlines() if line.startswith("    ")]
    assert commands[-1] == "./example"
    assert "theta" in readme.partition("## Inputs")[0]
    told = [
        subprocess.run(command.split(), cwd=folder, capture_output=True, text=True, check=True)
        for command in commands
    ]
    lines = told[-1].stdout.splitlines()
    model, estimate = (np.array(line.split()[1:], float) for line in lines[-2:])
    assert lines[-3] == "0.9 s"
    np.testing.assert_allclose(estimate, model, atol=0.02)


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*STEADY, "gru", "first-order", "hybrid"])
def test_the_filter_is_that_of_the_package(name, compiled):
    of, generator = source(name), np.random.default_rng(0)
    channels, n_x = of.channels, of.n_x
    u = np.cumsum(generator.normal(size=(60, channels.n_u)), axis=0) / 5
    q = np.cumsum(generator.normal(size=(60, channels.n_q)), axis=0) / 200
    record = tn.from_arrays(
        q, u, dt=channels.dt, coordinates=channels.coordinates, inputs=channels.inputs, name="run"
    )
    noise = np.full(n_x, 0.5), np.linspace(1e-3, 0.1, n_x), np.full(channels.n_q, 1e-2)
    x0 = np.linspace(-0.1, 0.1, n_x)
    expected = kalman_filter(of.model, record, x0, FilterNoise(*noise))

    library = compiled(name)
    kept = np.zeros(3 * n_x + n_x**2 + channels.n_q + 1)  # as `model_estimate` lies in memory
    called(library, "model_estimate_init", kept, x0, *noise)
    rows = np.clip(np.arange(60)[:, None] + np.array(of.input_layout.offsets), 0, 59)
    for k, samples in enumerate(rows):
        called(library, "model_estimate_correct", kept, np.ascontiguousarray(q[k]))
        covariance = kept[n_x : n_x + n_x**2].reshape(n_x, n_x)
        np.testing.assert_allclose(kept[:n_x], expected.states[k], rtol=1e-9, atol=1e-10)
        deviations = np.sqrt(np.diag(covariance))
        np.testing.assert_allclose(deviations, expected.deviations[k], rtol=1e-9, atol=1e-10)
        np.testing.assert_array_equal(covariance, covariance.T)
        called(library, "model_estimate_predict", kept, np.ascontiguousarray(u[samples].ravel()))


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["qube network", "hybrid"])
def test_the_filter_survives_wrong_positions_as_in_python(name, compiled):
    of, generator = source(name), np.random.default_rng(0)
    n_q, n_x = of.channels.n_q, of.n_x
    noise = FilterNoise(np.full(n_x, 0.5), np.full(n_x, 0.02), np.full(n_q, 1e-3))

    def at_rest(q: np.ndarray) -> np.ndarray:
        return np.asarray(of.model.initial_state(jnp.asarray(np.r_[q, 0 * q]), jnp.zeros(1)))

    own = KalmanFilter(make_linearised_step(of.equations), noise, of.channels, at_rest)
    library, kept = compiled(name), np.zeros(3 * n_x + n_x**2 + n_q + 1)
    called(library, "model_estimate_init", kept, np.zeros(n_x), *vars(noise).values())
    u, unused = np.zeros(of.n_w), []
    for k in range(300):
        wrong = generator.random() < 0.2 or 100 < k < 130
        y = generator.choice([np.nan, np.inf, 1e300, 3.0, -3.0], n_q) if wrong else np.zeros(n_q)
        called(library, "model_estimate_correct", kept, y)
        own.correct(y)
        missed, count = kept[-1:].view(np.int32)
        assert (missed, count) == (own.missed, own.unused)
        assert np.isfinite(kept[:-1]).all()
        np.testing.assert_allclose(kept[:n_x], own.x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(kept[n_x : n_x + n_x**2], own.p.ravel(), rtol=1e-9, atol=1e-12)
        unused.append(count)
        called(library, "model_estimate_predict", kept, u)
        own.predict(u)
        own.x, own.p = kept[:n_x].copy(), kept[n_x : n_x + n_x**2].reshape(n_x, n_x).copy()
    assert 60 < unused[-1] < 150
    assert np.abs(own.x[:n_q]).max() < 0.1


@pytest.mark.skipif(
    shutil.which("arm-none-eabi-gcc") is None, reason="no compiler for microcontrollers here"
)
def test_it_fits_a_microcontroller(written):
    flags = "-std=c99 -O2 -mcpu=cortex-m7 -mfpu=fpv5-d16 -mfloat-abi=hard -DMODEL_FLOAT"
    command = ["arm-none-eabi-gcc", *flags.split(), "-fstack-usage", "-c", "model.c", "-o", "arm.o"]
    folder = written("qube network")
    subprocess.run(command, cwd=folder, check=True)
    told = subprocess.run(
        ["arm-none-eabi-size", "arm.o"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout
    text, data, bss = (int(word) for word in told.splitlines()[1].split()[:3])
    assert text < 50_000  # the weights are 44,208 of them
    assert (data, bss) == (0, 0)
    stack = [line.split("\t") for line in next(folder.glob("*.su")).read_text().splitlines()]
    of_step = [int(size) for place, size, _ in stack if "linearise" not in place]
    assert sum(of_step) < 2000


def test_without_a_compiler_the_sources_are_written(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(NotRunnable, match="no no-such-compiler here"):
        TARGET.stepper(tmp_path, source("linear"))
    (done,) = tn.export_model(example("linear"), "c", tmp_path / "out")
    assert (tmp_path / "out/model.c").is_file()
    assert "set CC" in done.checked.note


def test_a_compiler_that_refuses_is_told(tmp_path, monkeypatch, written):
    monkeypatch.setenv("CC", "false")
    with pytest.raises(NotRunnable, match="false does not compile it: without a message"):
        TARGET.stepper(written("linear"), source("linear"))
