"""Serialized functions of JAX compute what the model does, without this package."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from documented import blocks
from every_family import NAMES, example, example_source
from every_step import require_same_run, without_inputs

import tustinnet as tn
from tustinnet.export.source import Source, make_source
from tustinnet.export.stablehlo import ROLLOUT, TARGET


def made(source: Source) -> dict[str, bytes]:
    return {name: bytes(of) for name, of in TARGET.files(source).items() if isinstance(of, bytes)}


@pytest.mark.thorough
@pytest.mark.parametrize("name", NAMES)
def test_every_family_leaves_with_both_functions(name, tmp_path):
    source = example_source(name)
    for file, content in made(source).items():
        (tmp_path / file).write_bytes(content)
    (x,), (u,) = source.samples(1)
    found = TARGET.stepper(tmp_path, source)(x, u)
    np.testing.assert_allclose(found, jax.jit(source.function)(x, u), rtol=1e-13, atol=1e-13)
    run = jax.export.deserialize(bytearray((tmp_path / ROLLOUT).read_bytes()))
    assert run.platforms == ("cpu", "cuda")
    (of,) = run.out_avals
    assert str(of.shape) == f"(steps + 1, {source.n_x})"


ELSEWHERE = """\
import sys
sys.modules["tustinnet"] = None  # cannot be imported
import jax
import numpy as np
jax.config.update("jax_enable_x64", True)
def loaded(name):
    return jax.export.deserialize(bytearray(open(name, "rb").read()))

step, run = loaded("step.bin"), loaded("rollout.bin")
given = np.load("given.npz")
for steps in (1, 300):
    np.save(f"found{steps}.npy", run.call(given["x0"], given["u"][:steps]))
np.save("following.npy", step.call(given["x0"], given["u"][0]))
assert not [m for m in sys.modules if m.startswith("tustinnet.")]
"""


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["network memory", "qube rubbing"])
def test_a_process_without_the_package_makes_the_same_run(name, tmp_path):
    source = example_source(name)
    for file, content in made(source).items():
        (tmp_path / file).write_bytes(content)
    x0, u = np.full(source.n_x, 0.1), 0.5 * np.sin(np.arange(300.0) / 7)[:, None]
    np.savez(tmp_path / "given.npz", x0=x0, u=u)
    elsewhere(ELSEWHERE, tmp_path)
    expected = tn.rollout(source.model, x0, u)
    for steps in (1, 300):
        found = np.load(tmp_path / f"found{steps}.npy")
        require_same_run(found, expected[: steps + 1])
    np.testing.assert_allclose(np.load(tmp_path / "following.npy"), expected[1], rtol=1e-13)


def elsewhere(script: str, folder: Path) -> str:
    """What a process says that knows no path to the package."""
    known = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=folder,
        env=known,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert not done.returncode, done.stderr
    return done.stdout


@pytest.mark.thorough
def test_a_free_run_sees_samples_as_the_step_does():
    source = example_source("band-limited")
    x0, w = (of[0] for of in source.samples(1))
    inputs = np.stack([w, 0.5 * w, -w])
    run = jax.export.deserialize(bytearray(made(source)[ROLLOUT]))
    expected = [jnp.asarray(x0)]
    for u in inputs:
        expected.append(source.function(expected[-1], jnp.asarray(u)))
    np.testing.assert_allclose(run.call(x0, inputs), expected, atol=1e-13)


def test_a_model_without_inputs_leaves():
    model = without_inputs()
    run = jax.export.deserialize(bytearray(made(make_source(model))[ROLLOUT]))
    x0, u = np.array([0.1, 0.2]), np.zeros((4, 0))
    np.testing.assert_allclose(run.call(x0, u), tn.rollout(model, x0, u), rtol=1e-14)


def test_bytes_depend_on_the_model_only_and_hold_no_path():
    files = made(make_source(example("physics")))
    assert files == made(make_source(example("physics")))
    for content in files.values():
        assert b".py" not in content
        assert str(Path(tn.__file__).parent).encode() not in content


@pytest.mark.thorough
def test_the_documented_lines_run(tmp_path):
    for file, content in made(example_source("qube")).items():
        (tmp_path / file).write_bytes(content)
    (block,) = blocks("StableHLO", "python")
    assert elsewhere(block, tmp_path).split() == ["(4,)", "(501,", "4)"]
