"""Simulations of equations: their states, or products of their derivatives.

Two engines do the same. One makes machine code of the equations, in about half a second; the other
compiles them with JAX, for equations that no program can hold and where LLVM cannot be had.
"""

import os
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.engine import by_jax, by_machine_code
from tustinnet.engine.equations import Equations, Formula, ResidualFormula
from tustinnet.engine.runs import Comparison, Directions, Runs, Samples
from tustinnet.errors import InputError
from tustinnet.program.reading import Unreadable

VARIABLE = "TUSTINNET_ENGINE"  # of the environment
ENGINES = ("llvm", "jax")


def simulate(equations: Equations, runs: Runs, substeps: int = 1) -> Float[np.ndarray, "rows n_x"]:
    """The states at all samples, run after run, (samples, n_x).

    Args:
        equations: what is simulated.
        runs: the runs.
        substeps: integration steps in a period, of continuous equations.

    Raises:
        InputError: an engine that there is not.
    """
    return _choose_engine(lambda: equations.programs).simulate(equations, runs, substeps)


def compare(
    equations: Equations,
    residual: ResidualFormula,
    runs: Runs,
    substeps: int,
    directions: Directions,
    samples: Samples,
) -> Comparison:
    """Simulates runs with derivatives along some directions and compares them with samples.

    Args:
        equations: what is simulated.
        residual: how errors count.
        runs: the runs.
        substeps: integration steps in a period, of continuous equations.
        directions: what is differentiated.
        samples: what the runs are compared with.

    Raises:
        InputError: an engine that there is not.
    """
    engine = _choose_engine(lambda: (equations.programs, residual.program))
    return engine.compare(equations, residual, runs, substeps, directions, samples)


def evaluate(
    formula: Formula, points: Float[np.ndarray, "n n_in"], *, derivatives: bool = False
) -> Float[np.ndarray, "n n_out"]:
    """Values of a formula at many points, (n, m), or its derivatives there by rows, (n, m n_in).

    Raises:
        InputError: an engine that there is not.
    """
    engine = _choose_engine(lambda: formula.program)
    return engine.evaluate(formula, points, derivatives=derivatives)


def compile_formula(formula: Formula, *, derivatives: bool = False) -> None:
    """Compiles a formula now; else it is compiled once it was evaluated at many points.

    For programs that must not wait later, as controllers.

    Raises:
        InputError: an engine that there is not.
    """
    _choose_engine(lambda: formula.program).compile_formula(formula, derivatives=derivatives)


Step = Callable[[np.ndarray, np.ndarray], np.ndarray]
LinearisedStep = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]


def make_step(equations: Equations) -> Step:
    """A function that steps a discrete model without parameters once: `step(x, u) -> x`.

    It uses memory of its own, so each thread needs one of its own. It raises an `InputError` for
    arrays that are not (n_x,) and (n_u,).

    Raises:
        InputError: an engine that there is not.
    """
    return _with_shapes(equations, _choose_engine(lambda: equations.program).make_step(equations))


def make_linearised_step(equations: Equations) -> LinearisedStep:
    """A function that steps a discrete model and linearises the step: `step(x, u) -> x, a, b`.

    The derivatives are by the state, `a` (n_x, n_x), and by the inputs, `b` (n_x, n_u). As
    `make_step`, it is for models without parameters, and uses memory of its own.

    Raises:
        InputError: an engine that there is not.
    """
    return _with_shapes(
        equations, _choose_engine(lambda: equations.linearised).make_linearised_step(equations)
    )


def _with_shapes(equations: Equations, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of a state and inputs that refuses arrays of other shapes."""
    state_shape, input_shape = (equations.n_x,), (equations.n_u,)

    def step(state: np.ndarray, inputs: np.ndarray) -> Any:
        state, inputs = np.asarray(state), np.asarray(inputs)  # in less time than np.shape takes
        if state.shape != state_shape:
            raise InputError(
                equations.where,
                f"a state of shape {state.shape}",
                f"{state_shape}",
                "give all positions, then all velocities, then the internal states",
            )
        if inputs.shape != input_shape:
            raise InputError(
                equations.where,
                f"inputs of shape {inputs.shape}",
                f"{input_shape}",
                "give an array with a number for each input",
            )
        return function(state, inputs)

    return step


def current_engine() -> str:
    """The engine that is used: `llvm`, or `jax` where the environment says so or LLVM is missing.

    Raises:
        InputError: the environment names another one.
    """
    name = os.environ.get(VARIABLE, "")
    if name and name not in ENGINES:
        raise InputError(VARIABLE, f"'{name}'", f"one of {', '.join(ENGINES)}", "or leave it out")
    if name == "jax":
        return "jax"
    if find_spec("llvmlite") is None:
        warn_once("llvmlite is not installed: simulations are compiled by JAX, which is slower")
        return "jax"
    return "llvm"


def _choose_engine(read: Callable[[], object]) -> ModuleType:
    """The module of machine code where `read` reads all programs, else that of JAX."""
    if current_engine() == "jax":
        return by_jax
    try:
        read()
    except Unreadable as error:
        # several parts of a system and its model have the same reason
        _, _, reason = str(error).partition(": ")
        warn_once(f"{error}; simulated by JAX instead, which is slower", reason)
        return by_jax
    return by_machine_code


_warned_topics: set[str] = set()


def warn_once(message: str, topic: str | None = None) -> None:
    """Issues a warning the first time in this process.

    Args:
        message: the message.
        topic: messages of one topic count as one; by default each message is its own.
    """
    topic = topic or message
    if topic not in _warned_topics:
        _warned_topics.add(topic)
        warnings.warn(message, stacklevel=2)
