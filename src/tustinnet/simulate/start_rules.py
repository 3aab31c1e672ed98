"""Starts of free runs: rules that find the state in which a free run of a record begins.

A start is a class here and a name in `start_names`, with what the command's help says of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.models.contract import Model
from tustinnet.signals.derivatives import polynomial_fit
from tustinnet.simulate.along import predictions_along
from tustinnet.simulate.input_signal import initial_inputs, input_signals
from tustinnet.simulate.simulation import initial_states, simulate_runs
from tustinnet.simulate.start_names import DERIVED, FITTED, STORED, WARM_UP, StartName, parse_start
from tustinnet.simulate.state_fits import FEWEST_FOR_A_VELOCITY, fit_states, fit_states_traced
from tustinnet.wording import counted

PARABOLA_SAMPLES = DERIVED.usual_samples
FIT_SAMPLES = FITTED.usual_samples  # that a state is usually fitted to


@dataclass(frozen=True)
class Start(ABC):
    """A rule that finds the state in which a free run begins, from a record's first samples.

    Attributes:
        kind: its name without the number of samples.
        samples: how many samples it uses, from the record's first on.
    """

    kind: ClassVar[StartName]

    samples: int

    @property
    def name(self) -> str:
        """The name of the start in recipes, options and scores, such as `model-20`."""
        return self.kind.with_samples(self.samples)

    @property
    def first(self) -> int:
        """The sample at which the free run begins."""
        return 0

    @property
    def needs_model(self) -> bool:
        """Whether a model is needed to find the state."""
        return True

    @property
    def seen_samples(self) -> int:
        """Samples that any model then simulates well, because the state was chosen for them."""
        return self.samples if self.needs_model else 0

    @abstractmethod
    def start_data(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """Arrays of records that the states are computed from, with the record first.

        Raises:
            InputError: a record that does not have what the start requires.
        """

    def traced_states(self, model: Model, start_data: Any) -> Array:
        """States at the start as a part of a program that JAX compiles, (records, n_x).

        They can be differentiated by the model. Here of positions and velocities, and inputs for a
        model that needs them, with the internal states that the model expects there.
        """
        rows, n_m = jnp.asarray(start_data), model.channels.measured.stop
        if not model.initial_needs_inputs:
            return jax.vmap(model.initial_state)(rows)
        return jax.vmap(model.initial_state)(rows[:, :n_m], rows[:, n_m:])

    def numeric_states(self, model: Model, start_data: Any) -> np.ndarray:
        """States at the start as numbers, computed by the engine, (records, n_x).

        They are those of `traced_states`, for models that are not being trained.
        """
        rows, n_m = np.asarray(start_data), model.channels.measured.stop
        return initial_states(model, rows[:, :n_m], rows[:, n_m:])

    def _require_samples(self, e: Experiment, fewest: int, purpose: str) -> None:
        if self.samples < fewest:
            raise InputError("start", f"'{self.name}'", f"at least {fewest} samples for {purpose}")
        if self.samples > len(e):
            raise InputError(
                e.name,
                counted(len(e), "sample"),
                f"at least {self.samples} for the start '{self.name}'",
                "leave the record out, or take another start",
            )


class MeasuredStart(Start):
    """A start whose positions and velocities are read from the record, whatever the model is."""

    @property
    def needs_model(self) -> bool:
        """No: the record is enough."""
        return False

    def start_data(self, model: Model, experiments: Sequence[Experiment]) -> np.ndarray:
        """Positions and velocities where the runs begin, (records, 2 n_q).

        They are followed by the inputs there, (records, 2 n_q + n_u), for a model that needs them.
        """
        measured = np.stack([self.measured_state(e) for e in experiments])
        return _with_inputs(measured, model, experiments)

    @abstractmethod
    def measured_state(self, e: Experiment) -> np.ndarray:
        """Positions and velocities at the first sample of a record [q, v], (2 n_q,)."""


class StoredStart(MeasuredStart):
    """`file`: the first row of a record as it is stored, velocities included."""

    kind = STORED

    def measured_state(self, e: Experiment) -> np.ndarray:
        """The first row of a record [q, v], (2 n_q,)."""
        if e.v is None:
            raise InputError(
                e.name,
                "start 'file' without velocity columns",
                "velocities in the file",
                f"use the start '{DERIVED.usual}'",
            )
        return np.concatenate([e.q[0], e.v[0]])


class DerivedStart(MeasuredStart):
    """`derived-N`: the least-squares parabola through the first N samples, at their times."""

    kind = DERIVED

    def measured_state(self, e: Experiment) -> np.ndarray:
        """Value and slope of the parabola at the first sample of a record [q, v], (2 n_q,)."""
        self._require_samples(e, 3, "the parabola")
        return parabola(e, 0, self.samples)


class FirstSamples(NamedTuple):
    """First samples of records, to which states are fitted through a model.

    Attributes:
        parabola: positions and velocities where the search begins, (records, 2 n_q), followed by
            the inputs there for a model that needs them.
        signal: what acts between the samples, an `InputSignal`, (records, samples - 1, ...).
        q: measured positions, (records, samples, n_q).
    """

    parabola: Any
    signal: Any
    q: Any


class FittedStart(Start):
    """`model-N`: the state from which the model explains the first N samples best."""

    kind = FITTED

    def start_data(self, model: Model, experiments: Sequence[Experiment]) -> FirstSamples:
        """The first samples of records."""
        for e in experiments:
            self._require_samples(e, FEWEST_FOR_A_VELOCITY, "the fit")
        samples = min(self.samples, PARABOLA_SAMPLES)
        return FirstSamples(
            parabola=_with_inputs(
                np.stack([parabola(e, 0, samples) for e in experiments]), model, experiments
            ),
            signal=input_signals(model, experiments, slice(self.samples)),
            q=np.stack([e.q[: self.samples] for e in experiments]),
        )

    def traced_states(self, model: Model, start_data: FirstSamples) -> Array:
        """States by least squares through the model, (records, n_x), see `fit_states_traced`."""
        guess = super().traced_states(model, start_data.parabola)
        return fit_states_traced(model, guess, signal=start_data.signal, q=start_data.q)

    def numeric_states(self, model: Model, start_data: FirstSamples) -> np.ndarray:
        """States by least squares through the model, (records, n_x), see `fit_states`."""
        guess = super().numeric_states(model, start_data.parabola)
        return fit_states(model, guess, signal=start_data.signal, q=start_data.q)


class WarmUpStart(Start):
    """`warm-up-N`: internal states follow the first N samples; the run begins at the last of them.

    Positions and velocities there are those of the parabola through the 6 samples up to it, so
    that nothing later is used. For models whose internal states say what the past was.
    """

    kind = WARM_UP

    @property
    def first(self) -> int:
        """The last of the N samples."""
        return self.samples - 1

    def start_data(self, model: Model, experiments: Sequence[Experiment]) -> Any:
        """Positions and velocities along the first N samples, and the inputs."""
        for e in experiments:
            self._require_samples(e, PARABOLA_SAMPLES, "the warm-up")
        heads = [e[: self.samples] for e in experiments]
        measured = [e.measured_states("stencil") for e in heads]
        for x, e in zip(measured, heads, strict=True):
            x[-1] = parabola(e, self.first, PARABOLA_SAMPLES)
        return np.stack(measured), input_signals(model, experiments, slice(self.samples))

    def traced_states(self, model: Model, start_data: Any) -> Array:
        """Measured states with the internal states that the samples led to, (records, n_x)."""
        measured, signal = start_data
        run = predictions_along(model, jnp.asarray(measured), signal)
        internal = run[:, -1, model.channels.internal]
        return jnp.concatenate([jnp.asarray(measured)[:, -1].astype(run.dtype), internal], axis=1)

    def numeric_states(self, model: Model, start_data: Any) -> np.ndarray:
        """Measured states with the internal states that the samples led to, (records, n_x)."""
        measured, signal = start_data
        start = initial_states(model, measured[:, 0], initial_inputs(model, signal))
        run = simulate_runs(model, start, signal, measured)
        return np.concatenate([measured[:, -1], run[:, -1, model.channels.internal]], axis=1)


def _with_inputs(
    measured: np.ndarray, model: Model, experiments: Sequence[Experiment]
) -> np.ndarray:
    """Rows of first [q, v], followed by the records' first inputs for a model that needs them."""
    if not model.initial_needs_inputs:
        return measured
    inputs = initial_inputs(model, input_signals(model, experiments, slice(2)))
    assert inputs is not None
    return np.concatenate([measured, inputs], axis=1)


_STARTS: dict[StartName, type[Start]] = {
    start.kind: start for start in (StoredStart, DerivedStart, FittedStart, WarmUpStart)
}


def start_named(name: str, where: object = "start") -> Start:
    """A start by its name, see `parse_start`."""
    kind, samples = parse_start(name, where)
    return _STARTS[kind](samples)


def parabola(e: Experiment, k: int, samples: int) -> np.ndarray:
    """Value and slope at sample k of the least-squares parabola through so many samples there.

    At the beginning of a record these are the first ones, else those up to sample k.
    """
    near = slice(max(0, k + 1 - samples), max(k + 1, samples))
    q, v = polynomial_fit(e.t[near], e.q[near], 2, at=e.t[k : k + 1])
    return np.concatenate([q[0], v[0]])
