"""A linear state-space model, found by least squares of its free runs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment, VelocitySource, moving_coordinates
from tustinnet.errors import InputError
from tustinnet.families.descriptions import Description, Entries
from tustinnet.families.family import (
    Arrays,
    Header,
    Hyper,
    Lines,
    SolvedFamily,
    SolvedRecords,
    named_arrays,
    restore_arrays,
)
from tustinnet.families.linear_search import LinearRecord, LinearSearch, PositionResidual
from tustinnet.models.blocks import Affine, root_mean_square
from tustinnet.models.contract import InputVector, Model, State
from tustinnet.models.sizes import MOST_STATES


class LinearModel(Model):
    """`x[k+1] = x[k] + U (W [(x[k] - o) / s; u[k] / s_u] + b)` with one unit `s` a state.

    It equals `x[k+1] = A x[k] + B u[k] + c`, written so that all weights are of one size. Angles
    enter as they are: the model is linear about the mean of the records.

    Attributes:
        change: `W` and `b`, from the scaled state and inputs to the scaled change in a period.
        offset: `o`, mean positions and zeros, (n_x,).
        unit: `s`, root mean squares of positions about the offset, velocities, internal states.
        moved: `U`, root mean squares of what a period changes, (n_x,).
        input: `s_u`, (n_u,).
        channels: its coordinates, inputs and period.

    References:
        Ljung (1999), System Identification: Theory for the User, section 4.3, and section 7.2 for
        the output-error criterion.
    """

    change: Affine
    offset: Float[Array, " n_x"]
    unit: Float[Array, " n_x"]
    moved: Float[Array, " n_x"]
    input: Float[Array, " n_u"]
    channels: Channels = eqx.field(static=True)

    @property
    def internal(self) -> tuple[str, ...]:
        """The names of the states beside positions and velocities."""
        return tuple(f"state {i}" for i in range(len(self.offset) - 2 * self.channels.n_q))

    def step(self, x: State, u: InputVector) -> State:
        """The state after one period."""
        scaled = jnp.concatenate([(x - self.offset) / self.unit, u / self.input])
        return x + self.moved * self.change(scaled)


Internal = Annotated[int, Field(ge=0, le=MOST_STATES)]


class LinearHyper(Hyper):
    """The table `[model]` of a linear state-space model.

    Attributes:
        internal: states beside positions and velocities.
    """

    internal: Internal = 0


class LinearEntries(Entries):
    """The size of a linear model."""

    internal: Internal


class LinearDescription(Description):
    """The header of a linear state-space model."""

    structure: LinearEntries


class LinearFamily(SolvedFamily):
    """The family of linear state-space models."""

    kind = "linear"
    hyper = LinearHyper
    description = LinearDescription
    correctable = True
    model = LinearModel

    def solve(
        self,
        hyper: LinearHyper,
        records: SolvedRecords,
        origin: Model | None,
        should_stop: Callable[[], bool],
    ) -> tuple[LinearModel, bool]:
        """The model whose free runs are closest; the search begins with one step ahead."""
        channels = records.train[0].channels
        model = self.one_step_model(hyper, records.train, records.velocity)
        if origin is not None:
            model = self._require_same_size(origin, model)
        measured, position = channels.measured, channels.position
        offset, unit, moved, size = (
            np.asarray(a, float) for a in (model.offset, model.unit, model.moved, model.input)
        )
        per_period = moved / unit

        def scale(e: Experiment) -> LinearRecord:
            states = (e.measured_states(records.velocity) - offset[measured]) / unit[measured]
            # what acts after the last sample moves nothing that was recorded
            drive = np.zeros((len(e), channels.n_u + 1))
            drive[:-1] = np.hstack([e.held_inputs / size, np.ones((len(e) - 1, 1))])
            return LinearRecord(states, drive)

        train = [scale(e) for e in records.train]
        horizon = None if records.horizon is None else round(records.horizon / channels.dt)
        search = LinearSearch(
            train,
            [scale(e) for e in records.validation] or train,
            PositionResidual(unit[position], channels.angular),
            horizon,
        )
        assert model.change.bias is not None
        solution = np.hstack([model.change.weight, np.asarray(model.change.bias)[:, None]])
        solution, is_complete = search.run(per_period[:, None] * solution, should_stop)
        solution = jnp.asarray(solution / per_period[:, None], jnp.float32)
        change = Affine(solution[:, :-1], solution[:, -1])
        return replace(model, change=change), is_complete

    def one_step_model(
        self, hyper: LinearHyper, experiments: Sequence[Experiment], velocity: VelocitySource
    ) -> LinearModel:
        """The model by least squares of one step; internal states are weakly coupled."""
        channels, n_z = experiments[0].channels, hyper.internal
        x = [e.measured_states(velocity) for e in experiments]
        before, change = (
            np.concatenate([a[:-1] for a in x]),
            np.concatenate([np.diff(a, axis=0) for a in x]),
        )
        u = np.concatenate([e.held_inputs for e in experiments])
        offset = np.where(np.arange(2 * channels.n_q) < channels.n_q, before.mean(axis=0), 0.0)
        moving = np.tile(moving_coordinates(experiments), 2)
        unit = np.where(moving, root_mean_square(before - offset), 1.0)
        moved = root_mean_square(change)
        scaled = np.hstack([(before - offset) / unit, u / (size := root_mean_square(u))])
        affine = np.hstack([scaled, np.ones((len(scaled), 1))])
        solution = np.linalg.lstsq(affine, change / moved, rcond=None)[0].T
        padded = [
            np.pad(a, (0, n_z), constant_values=fill)
            for a, fill in ((offset, 0.0), (unit, 1.0), (moved, channels.dt))
        ]
        arrays = [jnp.asarray(a, jnp.float32) for a in (*padded, size)]
        return LinearModel(_widen_map(solution, channels, n_z), *arrays, channels=channels)

    def _require_same_size(self, origin: Model, like: LinearModel) -> LinearModel:
        """The model to begin with, which has as many internal states as the recipe says."""
        self.require_own(origin)
        model = cast(LinearModel, origin)
        if len(model.internal) != len(like.internal):
            raise InputError(
                "`origin=`",
                f"a model with {len(model.internal)} internal states",
                f"{len(like.internal)}, as the recipe has it",
            )
        return model

    def describe(self, model: LinearModel) -> tuple[Header, Arrays]:
        """The number of internal states for the header; all arrays."""
        return {"structure": {"internal": len(model.internal)}}, named_arrays(model)

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> LinearModel:
        """The linear model of a file, from structure and arrays."""
        channels = Channels.from_header(header)
        n_x = 2 * channels.n_q + header["structure"]["internal"]

        def make() -> LinearModel:
            change = Affine(jnp.zeros((n_x, n_x + channels.n_u)), jnp.zeros(n_x))
            sizes = (n_x, n_x, n_x, channels.n_u)
            return LinearModel(change, *(jnp.zeros(n) for n in sizes), channels=channels)

        return restore_arrays(make, arrays)

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """Order and eigenvalues."""
        n_x = len(arrays["offset"])
        by_state = arrays["change.weight"][:, :n_x] / arrays["unit"]
        values = np.linalg.eigvals(np.eye(n_x) + arrays["moved"][:, None] * by_state)
        size = ", ".join(f"{abs(v):.4f}" for v in sorted(values, key=abs, reverse=True))
        return [("order", f"{n_x} states"), ("eigenvalues", f"of size {size}")]


FAMILY = LinearFamily()


def _widen_map(solution: np.ndarray, channels: Channels, n_z: int) -> Affine:
    """The least-squares map, widened by internal states that decay and are weakly coupled."""
    n, n_u = 2 * channels.n_q, channels.n_u
    generator = np.random.default_rng(0)
    # small weights, with which internal states begin
    weight = 0.1 * generator.normal(size=(n + n_z, n + n_z + n_u))
    weight[:n, :n] = solution[:, :n]
    weight[:n, n + n_z :] = solution[:, n:-1]
    weight[n:, n : n + n_z] -= np.eye(n_z)
    return Affine(
        jnp.asarray(weight, jnp.float32),
        jnp.asarray(np.pad(solution[:, -1], (0, n_z)), jnp.float32),
    )
