"""Steps of a model as machine code that serves all values of its physical parameters."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.control.input_history import InputHistory, causal_source
from tustinnet.engine.engines import evaluate, make_step
from tustinnet.engine.equations import Equations, Formula
from tustinnet.errors import InputError
from tustinnet.export.source import step_by_samples
from tustinnet.models.contract import Model
from tustinnet.models.physical_values import with_values

Vector = Float[np.ndarray, " _"]


class SteppedModel:
    """A model that is stepped sample by sample, with values of its parameters from run to run.

    It is compiled once. The parameters are those of the equations of motion in it: of a grey box,
    or of the physics of a hybrid. Networks have none. Its steps use memory of their own, so each
    thread needs one of its own.

    Args:
        model: the model, discretised if it is a continuous one.

    Attributes:
        model: the model.
        nominal: the values of its parameters, by name.

    Raises:
        InputError: a continuous model, or JAX in single precision.
    """

    def __init__(self, model: Model) -> None:
        self.model, source = model, causal_source(model, 0)
        self.nominal = source.physical_values
        n_m, n_u = model.channels.measured.stop, model.channels.n_u
        self._n_w = n_w = source.n_w

        def variant(values: Array) -> Model:
            return with_values(source.model, dict(zip(self.nominal, values, strict=True)))

        def step(x: Array, w: Array, p: Any, c: Any) -> Array:
            return step_by_samples(variant(w[n_w:]), source.input_layout)(x, w[:n_w])

        def start(point: Array) -> Array:
            measured, u, values = jnp.split(point, [n_m, n_m + n_u])
            return variant(values).initial_state(measured, u)

        where = f"the model ({type(model).__name__})"
        n_p = len(self.nominal)
        equations = Equations(step, source.n_x, n_w + n_p, continuous=False, where=where)
        self._step = make_step(equations)
        self._start = Formula(start, n_m + n_u + n_p, where=where)

    def history(self) -> InputHistory:
        """A new history of inputs, of which steps take the samples."""
        return InputHistory(self._n_w)

    def vector(self, values: Mapping[str, float]) -> Vector:
        """Values of parameters as `step` takes them; nominal where there are none.

        Raises:
            InputError: a parameter that the model does not have, or a value that is not finite.
        """
        for name, value in values.items():
            if name not in self.nominal or not np.isfinite(value):
                raise InputError(
                    f"a {type(self.model).__name__}",
                    f"the parameter {name} = {value}",
                    f"finite values of {', '.join(self.nominal) or '(it has no parameters)'}",
                )
        return np.array([values.get(name, value) for name, value in self.nominal.items()], float)

    def start(self, q: Vector, v: Vector, values: Vector) -> Vector:
        """The state at positions and velocities, internal states as the model expects, (n_x,)."""
        point = np.concatenate([q, v, np.zeros(self.model.channels.n_u), values])
        return evaluate(self._start, point[None])[0]

    def step(self, x: Vector, inputs: Vector, values: Vector) -> Vector:
        """The state at the next sample, (n_x,).

        Args:
            x: the state, (n_x,).
            inputs: the inputs of the step, as `InputHistory.add` returns them.
            values: the parameters, as `vector` returns them.
        """
        return self._step(x, np.concatenate([inputs, values]) if len(values) else inputs)
