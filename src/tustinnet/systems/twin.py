"""Twins: simulated records that look as if an apparatus had been logged."""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Coordinate, Experiment, Input
from tustinnet.models.base import ContinuousModel, State
from tustinnet.signals.derivatives import five_point_stencil
from tustinnet.simulation.integrators import substep

_LEAD, _TRAIL = 3, 2  # rows at a record's ends whose velocities are stored as 0, as in real logs


@dataclass(frozen=True)
class Run:
    """One experiment to be made with a twin.

    Attributes:
        name: what its record is called.
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
    """How a twin is logged.

    Attributes:
        dt: sampling period [s].
        jitter: standard deviation of the sampling instants [s]; the samples are taken, and inputs
            change, at the instants that are written down.
        counts: whether encoders round positions to their count.
        substeps: integration steps from sample to sample.
    """

    dt: float = 0.01
    jitter: float = 1e-5
    counts: bool = True
    substeps: int = 10


AS_LOGGED = Logger()


def log_runs(
    model: ContinuousModel,
    coordinates: tuple[Coordinate, ...],
    inputs: tuple[Input, ...],
    runs: Sequence[Run],
    logger: Logger,
    generator: np.random.Generator,
) -> tuple[Experiment, ...]:
    """Simulates runs and logs them.

    Encoders round to the nearest count; where the counts lie is drawn anew for every record and
    coordinate. Velocities are the five-point stencil of what was read.

    Args:
        model: the twin's equations of motion.
        coordinates: its coordinates, with the encoders' counts.
        inputs: its inputs.
        runs: what to do.
        logger: how it is logged.
        generator: the source of jitter and of the counts' places.
    """
    longest = max(len(run.u) for run in runs)
    t = np.arange(longest) * logger.dt + logger.jitter * generator.normal(size=(len(runs), longest))
    t -= t[:, :1]
    u = np.zeros((len(runs), longest, len(inputs)))
    for row, run in zip(u, runs, strict=True):
        row[: len(run.u)] = run.u
    x0 = np.stack([run.x0 for run in runs])
    x = np.asarray(_simulate(model, x0, u[:, :-1], np.diff(t, axis=1), logger.substeps))
    n_q = len(coordinates)
    records = []
    for run, states, times in zip(runs, x, t, strict=True):
        n = len(run.u)
        q = states[:n, :n_q]
        if logger.counts:
            count = np.array([c.resolution for c in coordinates], dtype=float)
            place = generator.uniform(-0.5, 0.5, n_q) * count
            q = np.round((q - place) / count) * count + place
        v = five_point_stencil(q, logger.dt)
        v[:_LEAD] = v[n - _TRAIL :] = 0.0
        records.append(
            Experiment(
                name=run.name, t=times[:n], q=q, u=run.u, v=v, dt=logger.dt, split=run.split,
                coordinates=coordinates, inputs=inputs, source="simulated",
            )
        )  # fmt: skip
    return tuple(records)


@eqx.filter_jit
def _simulate(
    model: ContinuousModel,
    x0: Float[Array | np.ndarray, "runs n_x"],
    u: Float[Array | np.ndarray, "runs steps n_u"],
    periods: Float[Array | np.ndarray, "runs steps"],
    parts: int,
) -> Float[Array, "runs samples n_x"]:
    def run(x: State, drive: Array, lengths: Array) -> Array:
        def advance(state: State, now: tuple[Array, Array]) -> tuple[State, State]:
            held, period = now
            state = jax.lax.fori_loop(
                0, parts, lambda i, s: substep(model, s, held, i, parts, period / parts), state
            )
            return state, state

        return jnp.concatenate([x[None], jax.lax.scan(advance, x, (drive, lengths))[1]])

    return jax.vmap(run)(jnp.asarray(x0), jnp.asarray(u), jnp.asarray(periods))
