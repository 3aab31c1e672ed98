"""Models as systems of the package control (python-control)."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.engines import make_step
from tustinnet.errors import require_package
from tustinnet.export.source import Source, make_source
from tustinnet.export.tangent import compute_tangent
from tustinnet.models.contract import Model

if TYPE_CHECKING:
    from control import NonlinearIOSystem, StateSpace


def control_system(model: Model) -> "NonlinearIOSystem":
    """A model as a discrete system of python-control, with the names of its channels.

    Its outputs are the states. Where a step depends on inputs at several samples, each is an input
    of its own (`voltage`, `voltage_after_1`, `voltage_before_2`): connect all to one signal that is
    held, those of a delay behind so many delays of a period.

    Args:
        model: a model that steps from sample to sample.

    Raises:
        InputError: python-control is not installed.
    """
    require_package("control", "control", "control_system")
    from control import nlsys

    source = make_source(model)
    step = make_step(source.equations)

    def update(t: float, x: Any, u: Any, params: Any) -> np.ndarray:
        return step(np.asarray(x, float), np.asarray(u, float))

    return nlsys(update, None, dt=model.dt, **_signals(source))


def state_space(
    model: Model,
    x: Float[Array | np.ndarray, " n_x"],
    u: Float[Array | np.ndarray, " n_u"],
) -> "StateSpace":
    """The linear system of python-control about an operating point, by the exact derivatives.

    Its states and inputs are differences from the point. Names and outputs are those of
    `control_system`, matrices those of the export `mat`.

    Args:
        model: a model that steps from sample to sample.
        x: the state there, usually an equilibrium, (n_x,).
        u: the inputs there, (n_u,).

    Raises:
        InputError: other shapes, derivatives that are not finite there, or python-control is not
            installed.
    """
    require_package("control", "control", "state_space")
    from control import StateSpace

    source = make_source(model)
    matrices = compute_tangent(source, np.asarray(x), np.asarray(u))
    a, b, feedthrough = matrices.a, matrices.b, np.zeros_like(matrices.b)
    return StateSpace(a, b, np.eye(source.n_x), feedthrough, model.dt, **_signals(source))


def _signals(source: Source) -> dict[str, list[str]]:
    """The names of signals, without dots, which would name a part of a system."""
    states = [name.replace(".", "_") for name in source.states]
    inputs = [name.replace(".", "_") for name in source.input_names]
    return {"states": states, "inputs": inputs, "outputs": states}
