"""Twins: simulated records that look like logs of an apparatus."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.integrate import discretise
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.signals.derivatives import five_point_stencil
from tustinnet.signals.stacking import stack_padded
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.rollout import rollout

_LEAD, _TRAIL = 3, 2  # rows at a record's ends whose velocities are stored as 0, as in real logs


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


@dataclass(frozen=True)
class Twin:
    """A simulated device of a system: its true values, its encoders, and how it is excited.

    The inputs are sums of sines of equal size and random phase, held over each sampling period.

    Attributes:
        system: the system.
        values: true values of the parameters that are not nominal, by name.
        resolution: counts of the encoders, by coordinate [rad or m].
        amplitude: root mean square of each input, in its unit.
        band: lowest and highest frequency of the inputs [Hz].
        rest: positions about which records begin, (n_q,) [rad or m].
        spread: records begin at rest up to this far from there, (n_q,) [rad or m].
        dt: sampling period [s].
        seconds: length of each record [s].
        substeps: integration steps in a sampling period.
    """

    system: LagrangianSystem
    values: Mapping[str, float]
    resolution: tuple[float, ...]
    amplitude: tuple[float, ...]
    band: tuple[float, float]
    rest: tuple[float, ...]
    spread: tuple[float, ...]
    dt: float = 0.01
    seconds: float = 6.0
    substeps: int = 10

    def true_values(self) -> dict[str, float]:
        """The true values of all parameters by name."""
        return self.system.nominal() | dict(self.values)

    def records(self, seed: int = 0, train: int = 4, validation: int = 1, test: int = 1) -> DataSet:
        """Simulated records of the device.

        Args:
            seed: everything random follows from it.
            train: number of training records.
            validation: number of validation records.
            test: number of test records.

        Raises:
            InputError: a run that is not finite.
        """
        generator = np.random.default_rng(seed)
        n_q, count = len(self.system.coordinates), round(self.seconds / self.dt)
        model = self.system.model({n: jnp.asarray(x) for n, x in self.true_values().items()})
        runs = []
        for split, number in (("train", train), ("validation", validation), ("test", test)):
            for i in range(number):
                q = self.rest + np.array(self.spread) * generator.uniform(-1, 1, n_q)
                u = self._sines(count, generator)
                at_rest = jnp.asarray(np.concatenate([q, np.zeros(n_q)]))
                x0 = np.asarray(model.initial_state(at_rest, jnp.asarray(u[0])))
                name = f"{self.system.name}-{split}{i + 1}".replace("-", "_")
                runs.append(TwinRun(name, split, x0, u))
        logger = Logger(self.dt, 0.0, substeps=self.substeps)
        name = f"{self.system.name}-twin"
        return simulate_twin(
            self.system, self.true_values(), self.resolution, runs, logger, generator, name
        )

    def _sines(
        self, count: int, generator: np.random.Generator
    ) -> Float[np.ndarray, "samples n_u"]:
        """Sums of 10 sines as inputs."""
        t, (lowest, highest) = np.arange(count) * self.dt, self.band
        phases = generator.uniform(0, 2 * np.pi, (len(self.amplitude), 10))
        angles = 2 * np.pi * np.geomspace(lowest, highest, 10) * t[:, None, None] + phases
        return np.array(self.amplitude) * np.sqrt(2 / 10) * np.sin(angles).sum(axis=2)


def simulate_twin(
    system: LagrangianSystem,
    values: Mapping[str, float],
    resolution: Sequence[float],
    runs: Sequence[TwinRun],
    logger: Logger,
    generator: np.random.Generator,
    name: str,
) -> DataSet:
    """Records of a simulated device, inputs held over each sampling period.

    Args:
        system: the system.
        values: the true values of all its parameters.
        resolution: counts of the encoders, by coordinate [rad or m].
        runs: the experiments.
        logger: the sampling.
        generator: the source of jitter and of the encoders' offsets.
        name: name of the data set.
    """
    coordinates = tuple(
        replace(c, resolution=count)
        for c, count in zip(system.coordinates, resolution, strict=True)
    )
    inputs = tuple(replace(i, hold="zero-order") for i in system.inputs)
    model = system.model({n: jnp.asarray(value, jnp.float64) for n, value in values.items()})
    return DataSet(name, log_runs(model, Channels(coordinates, inputs), runs, logger, generator))


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
                name=run.name,
                t=times[:n],
                q=q,
                u=run.u,
                v=v,
                channels=channels,
                split=run.split,
                source="simulated",
            )
        )
    return tuple(records)


@eqx.filter_jit
def _simulate(
    model: Model, x0: Float[Array, "runs n_x"], drive: InputSignal
) -> Float[Array, "runs samples n_x"]:
    return jax.vmap(lambda x, u: rollout(model, x, u))(x0, drive)
