"""A model as it is controlled: its step by the latest command, earlier commands in the state."""

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from math import ceil, log2
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from tustinnet.control.input_history import causal_source
from tustinnet.engine.engines import compile_formula, evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.export.source import step_by_samples
from tustinnet.models.contract import Model
from tustinnet.models.physical_values import with_values
from tustinnet.simulate.range import Range
from tustinnet.simulate.recent import keep_latest

Limits = Mapping[str, tuple[float, float]]


class InputLimits(NamedTuple):
    """Limits of the inputs.

    Attributes:
        lower: (n_u,).
        upper: (n_u,).
    """

    lower: Float[np.ndarray, " n_u"]
    upper: Float[np.ndarray, " n_u"]

    def clip(self, u: Float[np.ndarray, "*rows n_u"]) -> Float[np.ndarray, "*rows n_u"]:
        """Inputs within the limits."""
        return np.clip(u, self.lower, self.upper)


class ControlledModel:
    """A model whose state also has the earlier commands that a step depends on.

    The state is `z = [x, previous commands]`, the latest first. A step takes inputs at samples
    before its own where the model has taps there, where inputs act late (`Input.delay`), and where
    the computer needs time (`delay`). Inputs at samples to come are the command of now, held.

    Attributes:
        model: the model, in its cheapest form.
        delay: samples from when a command is computed to when it acts.
        n_x: number of states of the model.
        n_u: number of inputs.
        previous: how many samples of commands stand in the state.
        names: names of the model's states: `theta`, `der_theta`, internal states.
    """

    def __init__(self, model: Model, delay: int = 0) -> None:
        if delay < 0:
            raise InputError("control", f"a delay of {delay} samples", "0 or more")
        # a step takes the command of now, then the previous ones
        self._source = source = causal_source(model, delay)
        channels = source.channels
        if not channels.n_u:
            raise InputError("control", "a model without inputs", "an input to act with")
        self.model, self.delay = source.model, delay
        self.n_x, self.n_u, self.names = source.n_x, channels.n_u, source.states
        self.dt = float(model.dt)
        self.previous = len(self._source.input_layout.offsets) - 1

    @property
    def size(self) -> int:
        """`n_z`: states and previous commands."""
        return self.n_x + self.previous * self.n_u

    @property
    def where(self) -> str:
        """The name of the model in messages."""
        return f"the model ({type(self.model).__name__})"

    def function(self, z: Array, u: Array, values: Mapping[str, Any] | None = None) -> Array:
        """The next state after a command, written with JAX; with other values of parameters."""
        step = self._source.function
        if values is not None:
            step = step_by_samples(with_values(self.model, values), self._source.input_layout)
        commands = jnp.concatenate([u, z[self.n_x :]])
        kept = commands[: self.previous * self.n_u]
        return jnp.concatenate([step(z[: self.n_x], commands), kept])

    @cached_property
    def _formula_of_values(self) -> Formula:
        """The step at many points [z, u, values of the parameters]."""
        size, end, names = self.size, self.size + self.n_u, self._source.physical_values

        def step(point: Array) -> Array:
            values = dict(zip(names, point[end:], strict=True))
            return self.function(point[:size], point[size:end], values)

        formula = Formula(step, end + len(names), where=self.where)
        compile_formula(formula, derivatives=True)
        return formula

    @cached_property
    def _slope(self) -> Callable[[Array], Array] | None:
        """The derivatives by [z, u], (n_z, n_z + n_u), where they have equations of their own."""
        along = self._source.along
        if along is None:
            return None
        n_x, size, n_u = self.n_x, self.size, self.n_u
        order = np.r_[:n_x, size : size + n_u, n_x:size]  # state, command of now, previous ones
        kept = np.eye(size + n_u)[order[n_x : n_x + self.previous * n_u]]
        back = np.argsort(order)

        def slope(point: Array) -> Array:
            columns = along(point[:n_x], point[order[n_x:]])
            return jnp.concatenate([columns[:, 1 + back], kept])

        return slope

    @cached_property
    def step_formula(self) -> Formula:
        """The step at many points [z, u]."""
        size = self.size
        formula = Formula(
            lambda point: self.function(point[:size], point[size:]),
            size + self.n_u,
            where=self.where,
            slope=self._slope,
        )
        compile_formula(formula, derivatives=True)
        return formula

    def derivatives(
        self, z: Float[np.ndarray, "n n_z"], u: Float[np.ndarray, "n n_u"]
    ) -> Float[np.ndarray, "n n_z n_zu"]:
        """Derivatives of the steps from many states, by the state and by the command."""
        points = np.concatenate([z, u], axis=1)
        rows = evaluate(self.step_formula, points, derivatives=True)
        return rows.reshape(len(points), self.size, -1)

    def steps(
        self, z: Float[np.ndarray, "n n_z"], u: Float[np.ndarray, "n n_u"]
    ) -> Float[np.ndarray, "n n_z"]:
        """The states after steps from many states."""
        return evaluate(self.step_formula, np.concatenate([z, u], axis=1))

    @cached_property
    def held_formula(self) -> Formula:
        """The step of the model's own state at points [x, u], where all commands were `u`."""
        if not self.previous:
            return self.step_formula
        n_x, count = self.n_x, 1 + self.previous
        return Formula(
            lambda point: self._source.function(point[:n_x], jnp.tile(point[n_x:], count)),
            n_x + self.n_u,
            where=self.where,
        )

    def tangent(
        self,
        x: Float[np.ndarray, " n_x"],
        u: Float[np.ndarray, " n_u"],
        speeds: Float[np.ndarray, " n_q"] | None = None,
        values: Mapping[str, float] | None = None,
    ) -> tuple[Float[np.ndarray, "n_z n_z"], Float[np.ndarray, "n_z n_u"]]:
        """The linear model of the step about a point, by the state and by the command: `A`, `B`.

        With `speeds` it is the one that fits best in the mean over motions about the point, by
        statistical linearisation. At the point itself dry friction looks like a huge viscous one,
        and inputs seem to move nothing; no motion meets that. What grows with the squared speed, as
        the force of a whirling link, is taken away by a second speed: it is none of small motions.

        Args:
            x: the state, (n_x,).
            u: the inputs, (n_u,).
            speeds: usual speeds about the point [rad/s or m/s], (n_q,), 0 of a coordinate for the
                slope at the point; by default all are 0.
            values: other values of physical parameters by name; None for those of the model.

        Raises:
            InputError: derivatives are not finite there.

        References:
            Gelb and Vander Velde (1968), Multiple-input describing functions.
        """
        usual = np.zeros(self.model.channels.n_q) if speeds is None else speeds
        moved = np.flatnonzero(usual)
        columns = moved + self.model.channels.n_q
        # columns of a Hadamard matrix have no part of one another, with its opposite no squares
        half = scipy.linalg.hadamard(2 ** ceil(log2(len(moved) + 1)))[:, 1 : len(moved) + 1]
        signs = np.concatenate([half, -half])
        z = np.tile(self.augment(x, u), (2, len(signs), 1))
        z[:, :, columns] += np.multiply.outer((1, 2), signs * usual[moved])
        inputs = np.tile(u, (len(signs), 1))
        formula, more = self.step_formula, np.zeros((len(signs), 0))
        if values is not None:
            formula = self._formula_of_values
            own = [values.get(name, value) for name, value in self._source.physical_values.items()]
            more = np.tile(own, (len(signs), 1))
        points = [np.hstack([rows, inputs, more]) for rows in z]
        slow, fast = (
            evaluate(formula, each, derivatives=True)
            .reshape(len(signs), self.size, -1)[:, :, : self.size + self.n_u]
            .mean(axis=0)
            for each in points
        )
        jacobian = slow + (slow - fast) / 3
        slopes = evaluate(formula, points[0]).T @ signs / len(signs)
        jacobian[:, columns] = slopes / usual[moved]
        if not np.isfinite(jacobian).all():
            raise InputError(
                "operating point",
                "derivatives that are not finite",
                "a point where the model is smooth",
            )
        return jacobian[:, : self.size], jacobian[:, self.size :]

    def augment(
        self, x: Float[np.ndarray, " n_x"], u: Float[np.ndarray, " n_u"]
    ) -> Float[np.ndarray, " n_z"]:
        """The state `z` where all previous commands were `u`."""
        return np.concatenate([x, np.tile(u, self.previous)])

    @cached_property
    def periodic(self) -> tuple[int, ...]:
        """Indices of the angles that a step does not depend on by whole turns."""
        angles = np.flatnonzero(self.model.channels.angular)
        generator = np.random.default_rng(0)
        z, u = generator.uniform(-1, 1, (4, self.size)), generator.uniform(-1, 1, (4, self.n_u))
        plain = self.steps(z, u)
        result = []
        for i in angles:
            turned = 2 * np.pi * (np.arange(self.size) == i)
            change = self.steps(z + turned, u) - turned - plain
            if np.abs(change).max() < 1e-6 * (1 + np.abs(plain).max()):
                result.append(int(i))
        return tuple(result)


def controlled(model: Model, delay: int = 0) -> ControlledModel:
    """A model as it is controlled; its step is read and compiled once while it is in use.

    Raises:
        InputError: a model in continuous time, without inputs, or with values by group; JAX
            computes in single precision.
    """
    return _controlled_by_delay(model, delay)


@keep_latest(8)
def _controlled_by_delay(model: Model, delay: int) -> ControlledModel:
    """A model as it is controlled after a delay."""
    return ControlledModel(model, delay)


def input_limits(model: Model, limits: Limits | None = None) -> InputLimits:
    """The limits of a model's inputs, those that are given before those that it declares.

    Args:
        model: the model.
        limits: smallest and largest value of inputs by name.

    Raises:
        InputError: an input without limits, a name that is no input, limits that are not ordered.
    """
    given = dict(limits or {})
    names = [i.name for i in model.channels.inputs]
    require_known(given, names, "limits", "inputs")
    pairs = []
    for i in model.channels.inputs:
        pair = given.get(i.name, i.limits)
        if pair is None:
            raise InputError(
                f"input '{i.name}'",
                "it has no limits",
                "the least and the largest value it takes",
                f"declare them in the data card, or give them (`limits=` {i.name}=LOW:HIGH)",
            )
        if not -np.inf < pair[0] < pair[1] < np.inf:
            raise InputError(
                f"input '{i.name}'", f"limits {list(pair)}", "two numbers, the smaller one first"
            )
        pairs.append(pair)
    return InputLimits(*np.array(pairs, float).reshape(-1, 2).T)


def recorded_limits(
    model: Model, limits: Limits | None, range: Range | None
) -> dict[str, tuple[float, float]]:
    """Limits of inputs that are given, and as recorded those of inputs that declare none.

    An input that came near 0 may be 0.

    Args:
        model: the model.
        limits: smallest and largest value of inputs by name.
        range: the range of the model's training records, None where it is not known.
    """
    recorded = {}
    if range is not None:
        ends = zip(model.channels.inputs, range.inputs.tolist(), strict=True)
        recorded = {
            i.name: _with_zero(low, high)
            for i, (low, high) in ends
            if i.limits is None and low < high
        }
    return recorded | dict(limits or {})


def _with_zero(low: float, high: float) -> tuple[float, float]:
    """A recorded range, with 0 where the input came near it: what comes to rest can be off."""
    near = 0.05 * (high - low)
    return low if low > near else min(low, 0.0), high if high < -near else max(high, 0.0)


def safe_inputs(
    model: Model, limits: InputLimits, safe: Mapping[str, float] | None
) -> Float[np.ndarray, " n_u"]:
    """The inputs while the state is not known, (n_u,); by default 0, or the limit that is nearest.

    Args:
        model: the model.
        limits: the limits of its inputs.
        safe: safe inputs by name.

    Raises:
        InputError: a name that is no input, or a value beyond the limits.
    """
    given, names = dict(safe or {}), [i.name for i in model.channels.inputs]
    require_known(given, names, "safe", "inputs")
    inputs = limits.clip(np.array([given.get(name, 0.0) for name in names]))
    for name, value, low, high in zip(names, inputs, *limits, strict=True):
        if given.get(name, value) != value:
            raise InputError("safe", f"{name}={given[name]:g}", f"{low:g} to {high:g}, its limits")
    return inputs


def require_known(given: Mapping[str, object], names: Sequence[str], where: str, what: str) -> None:
    """Raises unless all keys are among some names."""
    for name in given:
        if name not in names:
            raise InputError(where, f"no '{name}' among the {what}", f"some of {', '.join(names)}")
