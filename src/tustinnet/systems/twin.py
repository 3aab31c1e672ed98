"""Twins: simulated records that look like logs of an apparatus."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.signals.derivatives import five_point_stencil
from tustinnet.signals.stacking import stack_padded
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.rollout import rollout

_LEAD, _TRAIL = 3, 2  # rows at a record's ends whose velocities are stored as 0, as in real logs

_SPREAD = 0.1  # standard deviation of initial states about recorded ones, relative to theirs
_FAR = 10  # times the recorded range, which a simulated record must not leave


@dataclass(frozen=True)
class TwinRun:
    """One experiment with a twin.

    Attributes:
        name: the name of its record.
        split: `train`, `validation` or `test`.
        x0: initial state, (n_x,).
        u: inputs, one row a sample, (n, n_u).
    """

    name: str
    split: str
    x0: Float[np.ndarray, " n_x"]
    u: Float[np.ndarray, "n n_u"]


@dataclass(frozen=True)
class Logger:
    """The sampling of a twin.

    Attributes:
        dt: sampling period [s].
        jitter: standard deviation of the sampling instants [s]; the samples are taken, and inputs
            change, at the instants that are recorded.
        counts: whether encoders round positions to their count.
        substeps: integration steps from sample to sample.
    """

    dt: float = 0.01
    jitter: float = 1e-5
    counts: bool = True
    substeps: int = 10


AS_LOGGED = Logger()


def imitate_records(
    model: Discretised,
    records: Sequence[Experiment],
    count: int,
    generator: np.random.Generator,
) -> tuple[Experiment, ...]:
    """Simulated records in the range of recorded ones.

    Each begins near a state of one of them, internal states as the model expects, and has the
    inputs of one of them, shifted in time. Runs that leave ten times the recorded range are left
    out.

    Args:
        model: the model, discretised: its period and integration steps are taken.
        records: the recorded ones.
        count: how many to make, at most.
        generator: the source of choices, of the encoders' offsets and of the initial states.

    Raises:
        InputError: a run that is not finite.
    """
    channels = replace(records[0].channels, dt=model.dt)
    q = np.concatenate([e.q for e in records])
    v = np.concatenate([e.velocities() for e in records])
    runs = []
    for i in range(count):
        start, drive = (records[int(generator.integers(len(records)))] for _ in range(2))
        row = int(generator.integers(_LEAD, max(len(start) - _TRAIL, _LEAD + 1)))
        spread_q = _SPREAD * q.std(axis=0) * generator.normal(size=channels.n_q)
        spread_v = _SPREAD * v.std(axis=0) * generator.normal(size=channels.n_q)
        measured = np.concatenate([start.q[row] + spread_q, start.velocities()[row] + spread_v])
        u = np.roll(drive.u, int(generator.integers(len(drive))), axis=0)
        x0 = np.asarray(model.initial_state(jnp.asarray(measured), jnp.asarray(u[0])))
        runs.append(TwinRun(f"simulated{i + 1}", "train", x0, u))
    logger = Logger(model.dt, 0.0, counts=bool(channels.resolution.all()), substeps=model.substeps)
    simulated = log_runs(model.continuous, channels, runs, logger, generator)
    middle, reach = (q.max(axis=0) + q.min(axis=0)) / 2, _FAR * np.ptp(q, axis=0) + 1e-12
    return tuple(e for e in simulated if (np.abs(e.q - middle) < reach).all())


def log_runs(
    model: ContinuousModel,
    channels: Channels,
    runs: Sequence[TwinRun],
    logger: Logger,
    generator: np.random.Generator,
) -> tuple[Experiment, ...]:
    """Simulates runs and logs them.

    Encoders round to the nearest count; their offsets are drawn for every record and coordinate.
    Velocities are the five-point stencil of the positions.

    Args:
        model: the twin's equations of motion.
        channels: its coordinates, with the encoders' counts, and its inputs.
        runs: the experiments.
        logger: the sampling.
        generator: the source of jitter and of the encoders' offsets.
    """
    longest = max(len(run.u) for run in runs)
    t = np.arange(longest) * logger.dt + logger.jitter * generator.normal(size=(len(runs), longest))
    t -= t[:, :1]
    u = stack_padded([run.u for run in runs])[:, :-1]
    drive = InputSignal(u, np.diff(t, axis=1))
    x0 = jnp.asarray(np.stack([run.x0 for run in runs]))
    x = np.asarray(_simulate(discretise(model, logger.dt, logger.substeps), x0, drive))
    channels = replace(channels, dt=logger.dt)
    n_q, count = channels.n_q, channels.resolution
    records = []
    for run, states, times in zip(runs, x, t, strict=True):
        n = len(run.u)
        q = states[:n, channels.position]
        if logger.counts:
            offset = generator.uniform(-0.5, 0.5, n_q) * count
            q = np.round((q - offset) / count) * count + offset
        v = five_point_stencil(q, logger.dt)
        v[:_LEAD] = v[n - _TRAIL :] = 0.0
        records.append(
            Experiment(
                name=run.name, t=times[:n], q=q, u=run.u, v=v, channels=channels,
                split=run.split, source="simulated",
            )
        )  # fmt: skip
    return tuple(records)


@eqx.filter_jit
def _simulate(
    model: Model, x0: Float[Array, "runs n_x"], drive: InputSignal
) -> Float[Array, "runs samples n_x"]:
    return jax.vmap(lambda x, u: rollout(model, x, u))(x0, drive)
