"""The twin of a fast oscillator: few samples in a period, an input that moves between samples.

It simulates the packaged system `duffing` with values like those of an electronic circuit that
behaves as such a mass, and writes its logs, in a few seconds:

    python examples/duffing_twin.py LOGS
    tustinnet fit LOGS --system duffing --out my-oscillator

References:
    Wigren, Schoukens (2013), Three free data sets for development and benchmarking in nonlinear
    system identification, European Control Conference (a circuit of this kind).
"""

import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.store.data_set_folder import write_data_set

jax.config.update("jax_enable_x64", True)

SYSTEM = tn.load_system("duffing")
SAMPLING = 610.35  # Hz
BAND = 0.285  # of the sampling rate: the input has nothing above
COUNT = 20 / 2**16  # m: 16 bits from -10 to 10
TWIN_VALUES = SYSTEM.nominal() | {
    "stiffness": 1.825e5,  # resonance at 68 Hz
    "cubic": 7.3e5,
    "damping": 38.0,  # a ratio of 0.044: it decays to 1/e in 32 samples
    "gain": 1.825e5,
}
RMS = 0.022  # V, of the multisines
GROWTH = 1.2  # the noise grows to this many times as much
PERIOD = 4096  # samples
RECORDS = {"train": 6, "validation": 2}
LEAD = 512  # samples before a record, in which the initial state decays
SUBSTEPS = 32  # integration steps in a period; the input is a straight line within each


def duffing_twin(seed=0, *, exact=False):
    """Records of a simulated oscillator: 6 + 2 multisines, and noise that grows.

    Multisines have random phases and equal amplitudes up to 0.285 of the sampling rate; each
    record is a period of 4096 samples. The test record is noise of the same band, 8192 samples,
    whose amplitude grows from 0 to 1.2 times that of the multisines. The input is as smooth as its
    band says: the oscillator is simulated with the input between the samples, not with held
    samples. A converter rounds the deflections to 16 bits.

    Args:
        seed: everything random follows from it.
        exact: true deflections instead of rounded ones, and true velocities with them: to measure
            estimators by.
    """
    generator = np.random.default_rng(seed)
    inputs = [
        (f"duffing_multisine_{split}{i + 1}", split, multisine(generator))
        for split, count in RECORDS.items()
        for i in range(count)
    ]
    inputs.append(("duffing_growing_noise", "test", growing_noise(generator)))
    values = {name: jnp.asarray(value, jnp.float64) for name, value in TWIN_VALUES.items()}
    step = tn.discretise(SYSTEM.model(values), 1 / SAMPLING / SUBSTEPS, 1)
    channels = tn.Channels(
        tuple(replace(c, resolution=COUNT) for c in SYSTEM.coordinates),
        tuple(replace(i, hold="band-limited") for i in SYSTEM.inputs),
        1 / SAMPLING,
    )
    records = []
    for name, split, u in inputs:
        lines = np.stack([u[:-1], np.diff(u)], axis=1)[:, :, None]
        x = np.array(tn.rollout(step, np.zeros(2), lines))[LEAD * SUBSTEPS :: SUBSTEPS]
        if not exact:
            x[:, 0] = np.round(x[:, 0] / COUNT) * COUNT
        records.append(
            tn.Experiment(
                name=name,
                t=np.arange(len(x)) / SAMPLING,
                q=x[:, :1],
                u=u[LEAD * SUBSTEPS :: SUBSTEPS, None],
                v=x[:, 1:] if exact else None,
                v_measured=exact,
                channels=channels,
                split=split,
                source="simulated",
            )
        )
    return tn.DataSet("duffing-twin", tuple(records))


def multisine(generator):
    """A period, behind the end of the one before, at all integration steps."""
    lines = int(BAND * PERIOD)
    phases = generator.uniform(0, 2 * np.pi, lines)
    period = periodic(np.exp(1j * phases) * RMS / np.sqrt(2 * lines), PERIOD)
    return np.concatenate([period[-LEAD * SUBSTEPS :], period])


def growing_noise(generator):
    """Gaussian noise within the band times a ramp, at all integration steps."""
    samples = 2 * PERIOD
    lines = int(BAND * samples)
    spectrum = generator.normal(size=lines) + 1j * generator.normal(size=lines)
    noise = periodic(spectrum * RMS / np.sqrt(4 * lines), samples)
    ramp = np.linspace(0, GROWTH, len(noise))
    return np.concatenate([np.zeros(LEAD * SUBSTEPS), ramp * noise])


def periodic(lines, samples):
    """The sum of 2 Re(line_k exp(2 pi i k t)), k from 1 on, at all integration steps."""
    n = samples * SUBSTEPS
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[1 : len(lines) + 1] = lines * n
    return np.fft.irfft(spectrum, n)


if __name__ == "__main__":
    write_data_set(duffing_twin(), Path(sys.argv[1]), "Simulated oscillator", overwrite=False)
