"""Free runs of models by the engine, several records side by side."""

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.engines import evaluate, simulate
from tustinnet.engine.equations import Equations, Formula, SampledValues
from tustinnet.engine.runs import Runs
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.sensors import delay_name
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.recent import keep_latest


def step_equations(
    model: Model, shape: tuple[int, ...], step: Callable[..., Any] | None = None
) -> Equations:
    """The step of a discrete model as equations for the engine.

    Args:
        model: the model.
        shape: shape of the input that a step takes.
        step: the step, where it is not the model's own: from state and input to the next state.
            Its derivatives are those of its program.
    """
    function = model.step if step is None else step
    n_x, n_u, step_along = model.state_size, int(np.prod(shape)), model.step_along
    along = None
    if step is None and step_along is not None and shape == (model.channels.n_u,):
        directions = np.split(np.eye(n_x + n_u), [n_x])
        along = lambda x, u: step_along(x, u, *directions)  # noqa: E731
    return Equations(
        lambda x, u, p, c: function(x, u.reshape(shape)),
        n_x=n_x,
        n_u=n_u,
        continuous=False,
        where=f"the model ({type(model).__name__})",
        along=along,
    )


@lru_cache(maxsize=32)  # one machine code serves a system whatever its parameters' values
def system_motion(
    system: LagrangianSystem, searched: tuple[str, ...], others: tuple[str, ...], *, delays: bool
) -> Equations:
    """The derivative of the state of a system, by its state, inputs and parameters.

    Args:
        system: the system.
        searched: names of the parameters that derivatives are needed by.
        others: names of all other parameters.
        delays: whether the inputs are followed by their derivatives by their delays, and the
            parameters by the delays that the inputs were made with.
    """
    n_u, n_others, feedback = len(system.inputs), len(others), system.feedback

    def model(p: Array, c: Array) -> LagrangianModel:
        values = {name: p[i] for i, name in enumerate(searched)}
        return system.model(values | {name: c[i] for i, name in enumerate(others)})

    def derivative(x: Array, u: Array, p: Array, c: Array) -> Array:
        equations = model(p, c)
        if delays:
            u = u[:n_u] + u[n_u:] * delay_changes(system, equations.values, c[n_others:])
        return equations.derivative(x, u)

    is_held = feedback is not None and feedback.is_sampled
    sampled = None
    if is_held or system.states.memory.settle is not None:

        def at_sample(x: Array, u: Array, p: Array, c: Array) -> tuple[Array, Array]:
            equations = model(p, c)
            x = equations.settled(x)
            return x, equations.computed(x, u) if is_held else x[:0]

        size = feedback.size + len(feedback.states) if feedback and is_held else 0
        sampled = SampledValues(at_sample, size)

    def until_next(x: Array, u: Array, p: Array, c: Array, computed: Array) -> Array:
        return model(p, c).held_derivative(x, u, computed) if is_held else derivative(x, u, p, c)

    return Equations(
        derivative if sampled is None else until_next,
        n_x=system.channels.measured.stop + len(system.internal),
        n_u=2 * n_u if delays else n_u,
        n_p=len(searched),
        n_c=n_others + (n_u if delays else 0),
        where=f"system '{system.name}'",
        sampled=sampled,
    )


def delay_changes(
    system: LagrangianSystem, values: Mapping[str, Any], delays: Float[Array, " n_u"]
) -> Float[Array, " n_u"]:
    """Differences of the inputs' delays [s] among parameters from those the inputs were made with.

    Args:
        system: the system, which has at least one input.
        values: the parameters by name.
        delays: the delays that the inputs were made with [s].
    """
    names = [delay_name(i) for i in system.inputs]
    changes = [values.get(name, delays[i]) - delays[i] for i, name in enumerate(names)]
    return jnp.stack(changes)


class ModelEquations:
    """Equations of a model for the engine, with the values of its parameters.

    Attributes:
        model: the model.
        shape: shape of the input that a step takes.
        equations: its equations of motion, or its step.
        parameters: values of the parameters of the equations, (n_c,).
        substeps: integration steps in a period.
        dt: its sampling period [s].
    """

    def __init__(self, model: Model, shape: tuple[int, ...]) -> None:
        self.model, self.shape = model, shape
        self.dt, self.substeps = float(model.dt), 1
        self.parameters: Float[np.ndarray, " n_c"] = np.zeros(0)
        if not isinstance(model, Discretised):
            self.equations = step_equations(model, shape)
            return
        self.substeps, continuous = model.substeps, model.continuous
        if isinstance(continuous, LagrangianModel):
            names = tuple(sorted(continuous.values))
            self.equations = system_motion(continuous.system, (), names, delays=False)
            self.parameters = np.array([float(continuous.values[name]) for name in names])
        else:
            self.equations = Equations(
                lambda x, u, p, c: continuous.derivative(x, u),
                n_x=continuous.state_size,
                n_u=model.channels.n_u,
                where=f"the model ({type(continuous).__name__})",
            )

    def runs(
        self,
        start: Float[np.ndarray, "runs n_x"],
        signal: InputSignal,
        measured: Float[np.ndarray, "runs known n_m"] | None = None,
    ) -> Runs:
        """Runs over inputs, which stand in rows run after run; a row more than steps for each.

        Args:
            start: states at the beginning, (runs, n_x).
            signal: what acts between the samples, (runs, steps, ...).
            measured: positions and velocities of the first samples, which replace the model's own.
        """
        u = np.asarray(signal.u, np.float64)
        count, steps = u.shape[:2]
        rows = np.zeros((count, steps + 1, *u.shape[2:]))
        rows[:, :steps] = u
        periods = np.full((count, steps + 1), self.dt)
        if signal.periods is not None:
            periods[:, :steps] = signal.periods
        order = u.shape[2] if self.equations.continuous and u.ndim == 4 else 1
        padded = None
        if measured is not None:
            padded = np.zeros((count, steps + 1, measured.shape[2]))
            padded[:, : measured.shape[1]] = measured[:, : steps + 1]
        return Runs(
            start=np.asarray(start, np.float64),
            parameters=np.tile(self.parameters, (count, 1)),
            steps=np.full(count, steps),
            first=np.arange(count) * (steps + 1),
            drive=rows.reshape(count * (steps + 1), order, self.equations.n_u),
            periods=periods.ravel(),
            measured=None if padded is None else padded.reshape(-1, padded.shape[2]),
            measured_samples=(
                None if measured is None else np.full(count, min(measured.shape[1], steps))
            ),
        )


def model_equations(model: Model, signal: InputSignal) -> ModelEquations:
    """Equations of a model for the engine; the model is read once while it is in use."""
    return _equations_by_shape(model, np.shape(signal.u)[2:])


@keep_latest(8)
def _equations_by_shape(model: Model, shape: tuple[int, ...]) -> ModelEquations:
    """Equations of a model that take inputs of a shape."""
    return ModelEquations(model, shape)


def simulate_runs(
    model: Model,
    x0: Float[Array | np.ndarray, "runs n_x"],
    signal: InputSignal,
    measured: Float[Array | np.ndarray, "runs known n_m"] | None = None,
) -> Float[np.ndarray, "runs samples n_x"]:
    """Free runs side by side, in double precision, each as by `rollout`.

    Args:
        model: the model.
        x0: states at the beginning, (runs, n_x).
        signal: what acts between the samples, (runs, steps, ...).
        measured: positions and velocities [q, v] of the first samples, which take the place of the
            model's own before it steps on, (runs, known, 2 n_q).

    Returns:
        The states, (runs, steps + 1, n_x).
    """
    equations = model_equations(model, signal)
    start = np.asarray(x0, np.float64)
    rows = None if measured is None else np.asarray(measured, np.float64)
    runs = equations.runs(start, signal, rows)
    states = simulate(equations.equations, runs, equations.substeps)
    return states.reshape(len(start), -1, start.shape[1])


def initial_states(
    model: Model,
    measured: Float[np.ndarray, "runs n_measured"],
    inputs: Float[Array | np.ndarray, "runs n_u"] | None = None,
) -> Float[np.ndarray, "runs n_x"]:
    """The states in which records begin, by their first [q, v], see `Model.initial_internal`.

    Args:
        model: the model.
        measured: positions and velocities at the beginning, (runs, 2 n_q).
        inputs: inputs there, (runs, n_u), which models with `initial_needs_inputs` require.
    """
    measured = np.asarray(measured, np.float64)
    if not model.internal:
        return measured
    n_m, points, by_inputs = measured.shape[1], measured, model.initial_needs_inputs
    if by_inputs:
        assert inputs is not None
        points = np.concatenate([measured, inputs], axis=1)
    formula = Formula(
        lambda x: model.initial_internal(x[:n_m], x[n_m:] if by_inputs else None),
        points.shape[1],
        where=f"the model ({type(model).__name__})",
    )
    return np.concatenate([measured, evaluate(formula, points)], axis=1)
