"""The example of a fast oscillator: its twin, and the packaged system with its values."""

import runpy
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn

EXAMPLES = Path(__file__).parents[2] / "examples"
_TWIN = runpy.run_path(str(EXAMPLES / "duffing_twin.py"))
BAND, COUNT, TWIN_VALUES, duffing_twin = (
    _TWIN[name] for name in ("BAND", "COUNT", "TWIN_VALUES", "duffing_twin")
)


@pytest.fixture(scope="module")
def twin() -> tn.DataSet:
    return duffing_twin()


@pytest.fixture(scope="module")
def exact() -> tn.DataSet:
    return duffing_twin(exact=True)


@pytest.mark.thorough
def test_there_are_multisines_and_noise_that_grows(twin):
    lengths = {split: [len(e) for e in twin.split(split)] for split in twin.splits}
    assert lengths == {"train": [4096] * 6, "validation": [4096] * 2, "test": [8192]}
    noise = np.abs(twin["duffing_growing_noise"].q[:, 0]).reshape(4, -1)
    assert np.all(np.diff(noise.max(axis=1)) > 0)
    assert noise.max() < max(np.abs(e.q).max() for e in twin.split("train"))


@pytest.mark.thorough
def test_the_seed_decides_everything(twin):
    again, other = duffing_twin(), duffing_twin(1)
    assert all(np.array_equal(a.q, b.q) for a, b in zip(twin, again, strict=True))
    assert not np.array_equal(twin[0].q, other[0].q)


def test_inputs_have_nothing_above_the_band(twin):
    for e in twin.split("train"):
        lines = np.abs(np.fft.rfft(e.u[:, 0]))
        edge = int(BAND * len(e))
        assert lines[edge + 1 :].max() < 1e-9 * lines[1:edge].min()


def test_deflections_are_rounded_to_16_bits(twin, exact):
    for e, true in zip(twin, exact, strict=True):
        np.testing.assert_allclose(e.q / COUNT, np.round(e.q / COUNT), atol=1e-9)
        assert (e.q - true.q).std() == pytest.approx(COUNT / np.sqrt(12), rel=0.05)


def test_the_input_moves_between_the_samples_as_its_band_says(exact):
    """Line by line the equation of motion holds, in continuous time."""
    e, p = exact["duffing_multisine_train1"], TWIN_VALUES
    s = 2j * np.pi * np.fft.rfftfreq(len(e), e.dt)
    q, cubed, u = (np.fft.rfft(x) for x in (e.q[:, 0], e.q[:, 0] ** 3, e.u[:, 0]))
    pushed = p["gain"] * u
    left = (p["mass"] * s**2 + p["damping"] * s + p["stiffness"]) * q + p["cubic"] * cubed - pushed
    # up to where the cube's own lines, folded back by the sampling, are small
    low = slice(1, int(0.1 * len(e)))
    assert np.abs(left[low]).max() < 0.01 * np.abs(pushed[low]).min()
    speed = np.fft.irfft(s * q, len(e))
    assert (speed - e.velocities("file")[:, 0]).std() < 1e-3 * speed.std()


def test_the_system_is_a_mass_on_a_spring_that_stiffens():
    system = tn.load_system("duffing")
    model = system.model({k: jnp.asarray(v) for k, v in TWIN_VALUES.items()})
    slope = model.derivative(jnp.array([0.1, 2.0]), jnp.array([0.05]))
    force = 1.825e5 * 0.05 - 1.825e5 * 0.1 - 7.3e5 * 0.1**3 - 38 * 2.0
    np.testing.assert_allclose(slope, [2.0, force], rtol=1e-6)
