"""A model as it is exported: its step as a function of vectors, their names and ranges."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.engine.equations import Equations, Formula
from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model, require_float64, with_dtype
from tustinnet.models.groups import model_for_groups
from tustinnet.program.derivatives import with_derivatives
from tustinnet.program.program import Program
from tustinnet.program.reading import read
from tustinnet.signals.excitation import Excitation, Held, excitation
from tustinnet.simulate.range import Range

_FARTHEST = 1000  # samples away that a step may see
_UNKNOWN = 1.0  # how far from 0 states and inputs are tried where nobody knows their range
StepFunction = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Seen:
    """What a step is given of the samples of the inputs.

    Attributes:
        offsets: the samples, counted from the one at which the period begins: that one first, then
            those after it, then those before it.
        matrix: what makes of them, (offsets n_u,), the step's own drive, flattened.
        shape: that of the step's own drive.
    """

    offsets: tuple[int, ...]
    matrix: Float[np.ndarray, "drive samples"]
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Source:
    """A model on its way out.

    Attributes:
        model: the model, in its cheapest form, of one group.
        range: where its training records lie, None where nobody knows.
        about: what its file says of it, for the card.
    """

    model: Model
    range: Range | None = None
    about: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def seen(self) -> Seen:
        """What a step is given of the inputs."""
        return find_input_layout(self.model)

    @property
    def channels(self) -> Channels:
        """Its coordinates, inputs and sampling period."""
        return self.model.channels

    @property
    def n_x(self) -> int:
        """How many numbers a state has."""
        return self.model.state_size

    @property
    def n_w(self) -> int:
        """How many numbers a step is given of the inputs: all inputs of every sample seen."""
        return len(self.input_layout.offsets) * self.channels.n_u

    @property
    def states(self) -> tuple[str, ...]:
        """What the numbers of a state are called: `theta`, `der_theta`, internal states."""
        names = [c.name for c in self.channels.coordinates]
        return (*names, *(f"der_{name}" for name in names), *self.model.internal)

    @property
    def units(self) -> tuple[str, ...]:
        """The units of the numbers of a state; of internal states nobody knows."""
        units = [c.unit for c in self.channels.coordinates]
        internal = [""] * len(self.model.internal)
        return (*units, *(f"{unit}/s" for unit in units), *internal)

    @property
    def input_names(self) -> tuple[str, ...]:
        """What the numbers that a step is given of the inputs are called.

        `voltage`; where it sees other samples than its own, `voltage_after_1`, `voltage_before_1`.
        """
        names = [i.name for i in self.channels.inputs]
        return tuple(f"{name}{_counted(k)}" for k in self.input_layout.offsets for name in names)

    @property
    def parameters(self) -> tuple[tuple[str, str, float], ...]:
        """Name, unit and value of its physical parameters, which are constants of the step."""
        return tuple(family_of(self.model).parameters(self.model))

    @cached_property
    def function(self) -> StepFunction:
        """The step as a JAX function of two vectors, (n_x,) and (n_w,), in float64."""
        model, seen = self.model, self.seen
        plain = seen.offsets == (0,) and seen.shape == (self.channels.n_u,)

        def step(x: Array, w: Array) -> Array:
            # from NumPy in here: an array of JAX made while a step is read would belong to that
            return model.step(x, w if plain else (jnp.asarray(seen.matrix) @ w).reshape(seen.shape))

        return step

    @cached_property
    def equations(self) -> Equations:
        """The step as the engine takes it, for one state at a time."""
        return Equations(
            lambda x, u, p, c: self.function(x, u), n_x=self.n_x, n_u=self.n_w,
            continuous=False, where=f"the model ({type(self.model).__name__})",
        )  # fmt: skip

    @cached_property
    def batched_step(self) -> Formula:
        """The step as the engine takes it, for many [x, w] at once."""
        n_x = self.n_x
        return Formula(
            lambda point: self.function(point[:n_x], point[n_x:]), n_x + self.n_w,
            where=f"the model ({type(self.model).__name__})",
        )  # fmt: skip

    @cached_property
    def step(self) -> Program:
        """The step as a program: `x`, `u` to `x`."""
        return read(lambda x, u: {"x": self.function(x, u)}, self._inputs)

    @cached_property
    def linearised(self) -> Program:
        """The step and its derivatives by rows: `x`, `u` to `x`, `a` (n_x n_x), `b` (n_x n_w)."""
        return with_derivatives(self.step, "x", {"a": "x", "b": "u"})

    @property
    def _inputs(self) -> dict[str, int]:
        return {"x": self.n_x, "u": self.n_w}

    def samples(
        self, count: int, seed: int = 0
    ) -> tuple[Float[np.ndarray, "count n_x"], Float[np.ndarray, "count n_w"]]:
        """Random states and inputs within the range of the training records."""
        known = self.range
        if known is None:
            ends = np.array([-_UNKNOWN, _UNKNOWN])
            size = self.channels.measured.stop
            states = np.tile(ends, (self.n_x, 1)) * (np.arange(self.n_x) < size)[:, None]
            known = Range(states, np.tile(ends, (self.channels.n_u, 1)))
        inputs = np.tile(known.inputs, (len(self.input_layout.offsets), 1))
        generator = np.random.default_rng(seed)

        def drawn(ends: np.ndarray) -> np.ndarray:
            low, high = ends.T
            return generator.uniform(low, high, (count, len(ends)))

        return drawn(known.states), drawn(inputs)

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What whoever uses the export has to know beside the layout."""
        notes = []
        for i in self.channels.inputs:
            if i.hold == "band-limited":
                notes.append(
                    f"input '{i.name}' is band-limited in the records; the exported step takes "
                    "straight lines between samples"
                )
            if i.delay:
                notes.append(f"input '{i.name}' acts {i.delay:g} s late; the step has no delay")
        if self.model.warm_up:
            notes.append(
                f"internal states need {self.model.warm_up} samples: put measured positions and "
                "velocities into the state before each of the first steps"
            )
        if self.model.encoder is not None:
            notes.append(
                f"the encoder, which estimates the state from {self.model.encoder.samples} "
                "samples, is not part of the export: it is given states"
            )
        if (ahead := max(self.input_layout.offsets)) > 0:
            notes.append(
                f"a step takes inputs up to {ahead} samples ahead: it can be made once they are "
                "known, and an FMU holds the last ones where its importer tells no derivatives"
            )
        if self.range is None:
            notes.append(
                "it is not known where its training records lie; in Python file= names the "
                "model's file, which may say so"
            )
        return tuple(notes)


def make_source(
    model: Model,
    range: Range | None = None,
    groups: Mapping[str, str] | None = None,
    about: Mapping[str, Any] | None = None,
) -> Source:
    """A model as it is exported.

    Args:
        model: a model that steps from sample to sample.
        range: where its training records lie.
        groups: of models with values by group those to take, as `{"payload": "1kg"}`.
        about: what its file says of it.

    Raises:
        InputError: JAX computes in single precision; a model of no sampling period; groups that
            are missing, that the model does not have or whose values it does not know.
    """
    require_stepping(model)
    # in double precision, as it is evaluated: folding in single would round once more
    chosen = with_dtype(model_for_groups(model, groups or {}, "export"), np.float64)
    return Source(chosen.simplify(), range, about or {})


def require_stepping(model: object) -> None:
    """Raises unless it is a model that steps from sample to sample, in double precision."""
    require_float64("export")
    if not hasattr(model, "derivative") and not isinstance(model, Model):
        raise InputError(
            "export", f"a {type(model).__name__}", "a model", "tn.load_model reads one from a file"
        )
    if not isinstance(model, Model) or not model.dt > 0:
        raise InputError(
            "export", f"a {type(model).__name__} in continuous time",
            "a model that steps from sample to sample", "make it discrete (discretise)",
        )  # fmt: skip


def find_input_layout(model: Model) -> Seen:
    """What the steps of a model are given of the samples, found by trying single samples of 1."""
    inputs = model.channels.inputs
    if not inputs:
        return Seen((0,), np.zeros((0, 0)), (0,))
    holds: list[Held] = [_hold(i.hold) for i in inputs]

    def driven(samples: np.ndarray) -> np.ndarray:
        made: Excitation = excitation(samples, holds, [0.0] * len(inputs))
        return np.asarray(model.step_inputs(made))

    reach = 1
    while reach < _FARTHEST and _beyond(driven, reach, len(inputs)):
        reach *= 2
    blank = np.zeros((2 * reach + 2, len(inputs)))
    shape = driven(blank)[reach].shape
    columns = {}
    for offset in range(-reach, reach + 1):
        rows = []
        for i in range(len(inputs)):
            blank[reach + offset, i] = 1.0
            rows.append(driven(blank)[reach].ravel())
            blank[reach + offset, i] = 0.0
        if np.any(rows) or offset == 0:
            columns[offset] = np.stack(rows, axis=1)
    offsets = sorted(columns, key=lambda offset: (offset < 0, abs(offset)))
    return Seen(tuple(offsets), np.concatenate([columns[o] for o in offsets], axis=1), shape)


def _beyond(driven: Callable[[np.ndarray], np.ndarray], reach: int, n_u: int) -> bool:
    """Whether a step sees samples farther away than `reach`."""
    samples = np.ones((2 * _FARTHEST + 2, n_u))
    samples[_FARTHEST - reach : _FARTHEST + reach + 1] = 0.0
    return bool(np.any(driven(samples)[_FARTHEST]))


def _counted(offset: int) -> str:
    return f"_{'after' if offset > 0 else 'before'}_{abs(offset)}" if offset else ""


def _hold(hold: str | None) -> Held:
    return "first-order" if hold in ("first-order", "band-limited") else "zero-order"
