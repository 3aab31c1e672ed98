"""A model as it is exported: its step as a function of vectors, their names and ranges."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Channels
from tustinnet.engine.equations import Equations, Formula
from tustinnet.errors import InputError
from tustinnet.models.contract import Model, require_float64, with_dtype
from tustinnet.models.groups import model_for_groups
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel
from tustinnet.models.physical_values import equations_in, physical_parameters, with_values
from tustinnet.program.program import Program
from tustinnet.program.reading import read
from tustinnet.signals.excitation import DeclaredHold, Excitation, excitation
from tustinnet.simulate.range import Range
from tustinnet.simulate.simulation import step_equations
from tustinnet.wording import counted

_PLACES = 9  # decimals of a delay in periods
_DEFAULT_RANGE = 1.0  # of states and inputs to both sides of 0, where their range is unknown
StepFunction = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class InputLayout:
    """The samples of the inputs on which a step depends.

    Attributes:
        offsets: the samples, counted from the one at which the period begins: that one first, then
            those after it, then those before it.
        matrix: the linear map from these samples, (offsets n_u,), to the step's input, flattened.
        shape: the shape of the step's input.
    """

    offsets: tuple[int, ...]
    matrix: Float[np.ndarray, "input samples"]
    shape: tuple[int, ...]

    def step_input(self, samples: Array) -> Array:
        """The step's input by the inputs at these samples, one after the other, (n_w,)."""
        if self.shape == samples.shape:
            return samples  # of its own sample alone, held
        # from NumPy in here: an array of JAX made while a step is read would belong to that
        return (jnp.asarray(self.matrix) @ samples).reshape(self.shape)


@dataclass(frozen=True)
class Source:
    """A model that is exported.

    Attributes:
        model: the model, in its cheapest form, with the values of one group.
        range: the range of its training records, None if unknown.
        about: the header of its file, for the card.
        layout: the input samples that the exported step is given, where they are not those on
            which the model's steps depend along a record, as those of a controller are not.
    """

    model: Model
    range: Range | None = None
    about: Mapping[str, Any] = field(default_factory=dict)
    layout: InputLayout | None = None

    def described(self, range: Range | None, about: Mapping[str, Any]) -> "Source":
        """A source of a model file, whose step is not read again."""
        other = replace(self, range=range, about=about)
        vars(other)["equations"] = self.equations
        return other

    @cached_property
    def input_layout(self) -> InputLayout:
        """The samples of the inputs on which a step depends."""
        return find_input_layout(self.model) if self.layout is None else self.layout

    @property
    def channels(self) -> Channels:
        """The coordinates, inputs and sampling period of the model."""
        return self.model.channels

    @property
    def n_x(self) -> int:
        """The number of states."""
        return self.model.state_size

    @property
    def n_w(self) -> int:
        """The number of inputs of the exported step: all inputs at every sample of the layout."""
        return len(self.input_layout.offsets) * self.channels.n_u

    @property
    def states(self) -> tuple[str, ...]:
        """The names of the states: `theta`, `der_theta`, internal states."""
        names = [c.name for c in self.channels.coordinates]
        return (*names, *(f"der_{name}" for name in names), *self.model.internal)

    @property
    def units(self) -> tuple[str, ...]:
        """The units of the states; empty for internal states, where they are unknown."""
        units = [c.unit for c in self.channels.coordinates]
        return (*units, *(f"{unit}/s" for unit in units), *("" for _ in self.model.internal))

    @property
    def input_names(self) -> tuple[str, ...]:
        """The names of the inputs of the exported step.

        `voltage`; of other samples than the step's own, `voltage_after_1`, `voltage_before_1`.
        """
        suffixes = [
            f"_{'after' if k > 0 else 'before'}_{abs(k)}" if k else ""
            for k in self.input_layout.offsets
        ]
        return tuple(f"{i.name}{suffix}" for suffix in suffixes for i in self.channels.inputs)

    @property
    def parameters(self) -> tuple[tuple[str, str, float], ...]:
        """Name, unit and value of the physical parameters, which are constants of the step."""
        return tuple(physical_parameters(self.model))

    @cached_property
    def function(self) -> StepFunction:
        """The step as a JAX function of two vectors, (n_x,) and (n_w,), in float64."""
        return step_by_samples(self.model, self.input_layout)

    @cached_property
    def equations(self) -> Equations:
        """The step for the engine, one state at a time."""
        return replace(step_equations(self.model, (self.n_w,), self.function), along=self.along)

    @cached_property
    def along(self) -> StepFunction | None:
        """The step with derivatives by state and inputs behind it, where these have equations."""
        step_along, layout = self.model.step_along, self.input_layout
        if step_along is None or layout.shape != (self.channels.n_u,):
            return None
        along, matrix, n_x = step_along, np.asarray(layout.matrix), self.n_x
        dx, du = np.eye(n_x, n_x + self.n_w), np.pad(matrix, ((0, 0), (n_x, 0)))
        return lambda x, w: along(x, jnp.asarray(matrix) @ w, dx, du)

    @cached_property
    def batched_step(self) -> Formula:
        """The step for the engine, many [x, w] at once."""
        n_x = self.n_x
        return Formula(
            lambda point: self.function(point[:n_x], point[n_x:]),
            n_x + self.n_w,
            where=f"the model ({type(self.model).__name__})",
        )

    @cached_property
    def physical_values(self) -> dict[str, float]:
        """The parameters of the equations of motion in the model by name; none of a network."""
        equations = equations_in(self.model)
        values = {} if equations is None else equations.values
        return {name: float(values[name]) for name in sorted(values)}

    @cached_property
    def batched_step_of_values(self) -> Formula:
        """The step for the engine with its physical parameters, many [x, w, values] at once."""
        n_x, n_w, names = self.n_x, self.n_w, tuple(self.physical_values)

        def step(point: Array) -> Array:
            values = dict(zip(names, point[n_x + n_w :], strict=True))
            variant = with_values(self.model, values)
            return step_by_samples(variant, self.input_layout)(point[:n_x], point[n_x : n_x + n_w])

        return Formula(
            step, n_x + n_w + len(names), where=f"the model ({type(self.model).__name__})"
        )

    @cached_property
    def step(self) -> Program:
        """The step as a program: `x`, `u` to `x`."""
        return _without_parameters(self.equations.program)

    @property
    def integrates(self) -> bool:
        """Whether it is differential equations alone, which are integrated over any time.

        A controller in the loop that computes at samples has to wait for them.
        """
        model = self.model
        if not isinstance(model, Discretised):
            return False
        equations = model.continuous
        feedback = equations.system.feedback if isinstance(equations, LagrangianModel) else None
        return feedback is None or not feedback.is_sampled

    @cached_property
    def part(self) -> Program:
        """A part of a step: `x`, `u`, and `begin` and `length` of the part [periods], to `x`.

        Of a model that `integrates`. Inputs follow over the part what they do over the period.
        """

        def advance(x: Array, u: Array, begin: Array, length: Array) -> dict[str, Array]:
            inputs = self.input_layout.step_input(u)
            if inputs.ndim > 1:
                # values at the beginning of the period, and changes over it
                value, change = inputs
                inputs = jnp.stack([value + begin * change, length * change])
            return {"x": self.model.advance(x, inputs, length[0] * self.channels.dt)}

        sizes = {"x": self.n_x, "u": self.n_w, "begin": 1, "length": 1}
        return read(advance, sizes)

    @cached_property
    def linearised(self) -> Program:
        """The step and its derivatives by rows: `x`, `u` to `x`, `a` (n_x n_x), `b` (n_x n_w)."""
        return _without_parameters(self.equations.linearised)

    @cached_property
    def rest(self) -> Program:
        """The state at rest, with the internal states that the model expects: `q` to `x`."""

        def state(q: Array) -> Array:
            measured = jnp.concatenate([q, jnp.zeros_like(q)])
            return self.model.initial_state(measured, jnp.zeros(self.channels.n_u))

        return read(lambda q: {"x": state(q)}, {"q": self.channels.n_q}, "the state at rest")

    def samples(
        self, count: int, seed: int = 0
    ) -> tuple[Float[np.ndarray, "count n_x"], Float[np.ndarray, "count n_w"]]:
        """Random states and inputs within the range of the training records."""
        within = self.range
        if within is None:
            ends = np.array([-_DEFAULT_RANGE, _DEFAULT_RANGE])
            size = self.channels.measured.stop
            states = np.tile(ends, (self.n_x, 1)) * (np.arange(self.n_x) < size)[:, None]
            within = Range(states, np.tile(ends, (self.channels.n_u, 1)))
        inputs = np.tile(within.inputs, (len(self.input_layout.offsets), 1))
        generator = np.random.default_rng(seed)

        def draw(ends: np.ndarray) -> np.ndarray:
            low, high = ends.T
            return generator.uniform(low, high, (count, len(ends)))

        return draw(within.states), draw(inputs)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for users of the export."""
        notes = [
            f"input '{i.name}' is band-limited in the records; the exported step takes straight "
            "lines between samples"
            for i in self.channels.inputs
            if i.hold == "band-limited" and self.layout is None
        ]
        if self.model.warm_up:
            notes.append(
                f"internal states need {self.model.warm_up} samples: put measured positions and "
                "velocities into the state before each of the first steps"
            )
        if (ahead := max(self.input_layout.offsets)) > 0:
            notes.append(
                f"a step takes inputs up to {counted(ahead, 'sample')} ahead: it can be made once "
                "they are known, and an FMU holds the last ones where its importer tells no "
                "derivatives"
            )
        if self.range is None:
            notes.append(
                "it is not known where its training records lie; in Python file= names the "
                "model's file, which may say so"
            )
        return tuple(notes)


def _without_parameters(program: Program) -> Program:
    """A program of equations that have none."""
    return replace(program, inputs={name: program.inputs[name] for name in ("x", "u")})


def make_source(
    model: Model,
    range: Range | None = None,
    groups: Mapping[str, str] | None = None,
    about: Mapping[str, Any] | None = None,
) -> Source:
    """A model prepared for its export.

    Args:
        model: a model that steps from sample to sample.
        range: the range of its training records.
        groups: the groups of a model with values by group, as `{"payload": "1kg"}`.
        about: the header of its file.

    Raises:
        InputError: JAX computes in single precision; a model without a sampling period; groups
            that are missing, that the model does not have or has no values for.
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
            "export",
            f"a {type(model).__name__} in continuous time",
            "a model that steps from sample to sample",
            "make it discrete (discretise)",
        )


def find_input_layout(model: Model) -> InputLayout:
    """The input samples on which a model's steps depend, from the responses to single samples.

    They are those that it takes along a record, delays of its inputs included; a delay that is no
    whole number of periods is between two samples, see `excitation`.
    """
    inputs = model.channels.inputs
    if not inputs:
        return InputLayout((0,), np.zeros((0, 0)), (0,))
    # rounded, so that a whole number of periods is one
    late = [round((i.delay or 0.0) / model.dt, _PLACES) for i in inputs]
    linear = ("first-order", "band-limited")
    holds: list[DeclaredHold] = [
        "first-order" if i.hold in linear else "zero-order" for i in inputs
    ]

    def step_inputs(samples: np.ndarray) -> np.ndarray:
        signal: Excitation = excitation(samples, holds, late)
        return np.asarray(model.step_inputs(signal))

    near = max((1, *map(abs, model.step_layout.taps)))
    shifts = {whole for delay in late for whole in (math.floor(delay), math.ceil(delay))}
    tried = {0, *(tap - shift for shift in shifts for tap in range(-near, near + 1))}
    reach = max(map(abs, tried))
    blank = np.zeros((2 * reach + 2, len(inputs)))
    shape = step_inputs(blank)[reach].shape
    columns = {}
    for offset in tried:
        rows = []
        for i in range(len(inputs)):
            blank[reach + offset, i] = 1.0
            rows.append(step_inputs(blank)[reach].ravel())
            blank[reach + offset, i] = 0.0
        if np.any(rows) or offset == 0:
            columns[offset] = np.stack(rows, axis=1)
    offsets = sorted(columns, key=lambda offset: (offset < 0, abs(offset)))
    matrix = np.concatenate([columns[offset] for offset in offsets], axis=1)
    return InputLayout(tuple(offsets), matrix, shape)


def step_by_samples(model: Model, layout: InputLayout) -> StepFunction:
    """The step of a model as a function of the state and of the samples of a layout, flattened."""
    return lambda x, w: model.step(x, layout.step_input(w))
