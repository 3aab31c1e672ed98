"""Model files that earlier versions have written still load, and simulate as they did."""

import contextlib
from pathlib import Path

import jax
import numpy as np
import pytest
from every_step import require_same_run

import tustinnet as tn
from tustinnet.models.contract import with_dtype
from tustinnet.store.sealed import FORMAT

HERE = Path(__file__).parent
EMPS = Path(__file__).parents[2] / "examples" / "emps.py"
SYSTEMS = {"format_1/euler_lagrange_emps": EMPS}  # of files that the package has no system for
FILES = sorted(f"{path.parent.name}/{path.stem}" for path in HERE.glob("format_*/*.safetensors"))


@pytest.fixture(scope="module")
def free_runs() -> dict[str, np.ndarray]:
    """What the version that wrote the files simulated."""
    found = {}
    for path in HERE.glob("format_*/free_runs.npz"):
        with np.load(path) as stored:
            found |= {f"{path.parent.name}/{name}": run for name, run in stored.items()}
    return found


def read(name: str) -> tn.Model:
    """A stored model; of a system of one's own it is said that a change could not be seen."""
    path = HERE / f"{name}.safetensors"
    unchecked = pytest.warns(UserWarning, match=r"'emps' has not changed.*could not be checked")
    with unchecked if name in SYSTEMS else contextlib.nullcontext():
        return tn.load_model(path, SYSTEMS.get(name))


def simulated(model: tn.Model) -> np.ndarray:
    u = np.sin(np.arange(60) * 0.2)[:, None]
    x0 = np.linspace(0.2, 0.6, model.state_size)
    return np.asarray(tn.rollout(with_dtype(model, np.float64), x0, u))


def test_there_is_a_free_run_of_every_file(free_runs):
    assert sorted(free_runs) == FILES
    for name in FILES:
        header = tn.read_header(HERE / f"{name}.safetensors")
        assert f"format_{header['format']}" == name.split("/")[0]


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_an_earlier_format_simulates_as_it_did(name, free_runs):
    require_same_run(simulated(read(name)), free_runs[name])


@pytest.mark.parametrize("name", FILES)
def test_saved_again_it_is_the_same_model_in_the_format_of_today(name, tmp_path):
    model, path = read(name), tmp_path / "again.safetensors"
    tn.save(model, path)
    assert tn.read_header(path)["format"] == FORMAT == 3
    again = tn.load_model(path, SYSTEMS.get(name))  # what the system computes is now kept: no word
    assert type(again) is type(model)
    assert again.channels == model.channels
    assert again.internal == model.internal
    for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(model), strict=True):
        assert a.dtype == b.dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    np.testing.assert_array_equal(simulated(again), simulated(model))
