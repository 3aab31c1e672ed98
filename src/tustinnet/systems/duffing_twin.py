"""The twin of a fast oscillator: few samples in a period, an input that moves between samples."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.models.integrate import discretise
from tustinnet.simulate.rollout import rollout
from tustinnet.systems.duffing import SYSTEM

TWIN_NAME = "duffing-twin"
SAMPLING = 610.35  # Hz
BAND = 0.285  # of the sampling rate: the input has nothing above
COUNT = 20 / 2**16  # m: 16 bits from -10 to 10
TWIN_VALUES = SYSTEM.nominal() | {
    "stiffness": 1.825e5,  # resonance at 68 Hz
    "cubic": 7.3e5,
    "damping": 38.0,  # a ratio of 0.044: it decays to 1/e in 32 samples
    "gain": 1.825e5,
}
_RMS = 0.022  # V, of the multisines
_GROWN = 1.2  # the noise grows to this many times as much
_PERIOD = 4096  # samples
_RECORDS = {"train": 6, "validation": 2}
_LEAD = 512  # samples before a record, in which what it began with decays
_FINE = 32  # integration steps in a period; the input is a straight line within each
_MOVING = tuple(replace(i, hold="band-limited") for i in SYSTEM.inputs)


def duffing_twin(seed: int = 0, *, exact: bool = False) -> DataSet:
    """Records of a simulated oscillator: 6 + 2 multisines, and noise that grows.

    Multisines have random phases and equal amplitudes up to 0.285 of the sampling rate; each
    record is a period of 4096 samples. The test record is noise of the same band, 8192 samples,
    whose amplitude grows from 0 to 1.2 times that of the multisines. The input is as smooth as its
    band says: the oscillator is simulated with what it is between the samples, not with held
    samples. A converter rounds the deflections to 16 bits.

    Args:
        seed: everything random follows from it.
        exact: deflections as they are instead of rounded, and velocities with them: to measure
            estimators by.
    """
    generator = np.random.default_rng(seed)
    of = [
        (f"duffing_multisine_{split}{i + 1}", split, _multisine(generator))
        for split, count in _RECORDS.items()
        for i in range(count)
    ]
    of.append(("duffing_growing_noise", "test", _growing_noise(generator)))
    records = tuple(
        _logged(name, split, *_driven(fine, exact=exact), exact=exact) for name, split, fine in of
    )
    return DataSet(TWIN_NAME, records)


def _multisine(generator: np.random.Generator) -> Float[np.ndarray, " fine"]:
    """A period, behind the end of the one before, at all integration steps."""
    lines = int(BAND * _PERIOD)
    phases = generator.uniform(0, 2 * np.pi, lines)
    period = _periodic(np.exp(1j * phases) * _RMS / np.sqrt(2 * lines), _PERIOD)
    return np.concatenate([period[-_LEAD * _FINE :], period])


def _growing_noise(generator: np.random.Generator) -> Float[np.ndarray, " fine"]:
    """Gaussian noise within the band times a ramp, at all integration steps."""
    samples = 2 * _PERIOD
    lines = int(BAND * samples)
    spectrum = generator.normal(size=lines) + 1j * generator.normal(size=lines)
    noise = _periodic(spectrum * _RMS / np.sqrt(4 * lines), samples)
    ramp = np.linspace(0, _GROWN, len(noise))
    return np.concatenate([np.zeros(_LEAD * _FINE), ramp * noise])


def _periodic(lines: np.ndarray, samples: int) -> Float[np.ndarray, " fine"]:
    """The sum of 2 Re(line_k exp(2 pi i k t)), k from 1 on, between the samples of a period too."""
    fine = samples * _FINE
    spectrum = np.zeros(fine // 2 + 1, complex)
    spectrum[1 : len(lines) + 1] = lines * fine
    return np.fft.irfft(spectrum, fine)


def _driven(
    fine: Float[np.ndarray, " fine"], *, exact: bool
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 1"]]:
    """States and inputs at the samples behind the lead."""
    values = {name: jnp.asarray(value, jnp.float64) for name, value in TWIN_VALUES.items()}
    step = discretise(SYSTEM.model(values), 1 / SAMPLING / _FINE, 1)
    lines = np.stack([fine[:-1], np.diff(fine)], axis=1)[:, :, None]
    x = np.array(rollout(step, np.zeros(2), lines))[_LEAD * _FINE :: _FINE]
    if not exact:
        x[:, 0] = np.round(x[:, 0] / COUNT) * COUNT
    return x, fine[_LEAD * _FINE :: _FINE, None]


def _logged(
    name: str,
    split: str,
    x: Float[np.ndarray, "n 2"],
    u: Float[np.ndarray, "n 1"],
    *,
    exact: bool,
) -> Experiment:
    coordinates = tuple(replace(c, resolution=COUNT) for c in SYSTEM.coordinates)
    return Experiment(
        name=name,
        t=np.arange(len(x)) / SAMPLING,
        q=x[:, :1],
        u=u,
        v=x[:, 1:] if exact else None,
        v_measured=exact,
        channels=Channels(coordinates, _MOVING, 1 / SAMPLING),
        split=split,
        source="simulated",
    )
