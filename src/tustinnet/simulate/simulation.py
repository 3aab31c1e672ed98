"""Free runs of models by the engine, several records side by side."""

from functools import lru_cache

import numpy as np
from jaxtyping import Array, Float

from tustinnet.engine.equations import Equations, Formula
from tustinnet.engine.runs import Runs, evaluate, simulate
from tustinnet.models.contract import ContinuousModel, Model
from tustinnet.models.integrate import Discretised
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.simulate.drive import Drive

_RECENT = 8  # models whose equations are at hand


class ModelEquations:
    """A model as the engine takes it.

    Attributes:
        equations: its equations of motion, or its step.
        parameters: what the equations are given of its parameters, (n_c,).
        substeps: integration steps in a period.
        dt: its sampling period [s].
    """

    def __init__(self, model: Model, shape: tuple[int, ...]) -> None:
        self.model, self.shape = model, shape
        self.dt, self.substeps = float(model.dt), 1
        self.parameters: Float[np.ndarray, " n_c"] = np.zeros(0)
        if isinstance(model, Discretised):
            self.substeps = model.substeps
            self.equations, self.parameters = _motion(model.continuous, model.channels.n_u)
        else:
            self.equations = Equations(
                lambda x, u, p, c: model.step(x, u.reshape(shape)),
                n_x=model.state_size, n_u=int(np.prod(shape)), continuous=False,
                where=f"the model ({type(model).__name__})",
            )  # fmt: skip

    def runs(
        self,
        start: Float[np.ndarray, "runs n_x"],
        drive: Drive,
        known: Float[np.ndarray, "runs known n_m"] | None = None,
    ) -> Runs:
        """Runs over inputs, which stand in rows run after run; a row more than steps for each.

        Args:
            start: states at the beginning, (runs, n_x).
            drive: what acts between the samples, (runs, steps, ...).
            known: positions and velocities of the first samples, which replace the model's own.
        """
        u = np.asarray(drive.u, np.float64)
        count, steps = u.shape[:2]
        rows = np.zeros((count, steps + 1, *u.shape[2:]))
        rows[:, :steps] = u
        periods = np.full((count, steps + 1), self.dt)
        if drive.periods is not None:
            periods[:, :steps] = drive.periods
        order = u.shape[2] if self.equations.continuous and u.ndim == 4 else 1
        measured = None
        if known is not None:
            measured = np.zeros((count, steps + 1, known.shape[2]))
            measured[:, : known.shape[1]] = known[:, : steps + 1]
        return Runs(
            start=np.asarray(start, np.float64),
            parameters=np.tile(self.parameters, (count, 1)),
            steps=np.full(count, steps),
            first=np.arange(count) * (steps + 1),
            drive=rows.reshape(count * (steps + 1), order, self.equations.n_u),
            periods=periods.ravel(),
            known=None if measured is None else measured.reshape(-1, measured.shape[2]),
            measured=None if known is None else np.full(count, min(known.shape[1], steps)),
        )


def equations_of(model: Model, drive: Drive) -> ModelEquations:
    """A model as the engine takes it; it is read once while it is in use."""
    shape = np.shape(drive.u)[2:]
    for known in _recent:
        if known.model is model and known.shape == shape:
            return known
    made = ModelEquations(model, shape)
    _recent.insert(0, made)
    del _recent[_RECENT:]
    return made


_recent: list[ModelEquations] = []


def simulated(
    model: Model,
    x0: Float[Array | np.ndarray, "runs n_x"],
    drive: Drive,
    known: Float[Array | np.ndarray, "runs known n_m"] | None = None,
) -> Float[np.ndarray, "runs samples n_x"]:
    """Free runs side by side, in double precision; what `rollout` does for each.

    Args:
        model: the model.
        x0: states at the beginning, (runs, n_x).
        drive: what acts between the samples, (runs, steps, ...).
        known: positions and velocities [q, v] of the first samples, which take the place of the
            model's own before it steps on, (runs, known, 2 n_q).

    Returns:
        The states, (runs, steps + 1, n_x).
    """
    of = equations_of(model, drive)
    start = np.asarray(x0, np.float64)
    given = None if known is None else np.asarray(known, np.float64)
    states = simulate(of.equations, of.runs(start, drive, given), of.substeps)
    return states.reshape(len(start), -1, start.shape[1])


def beginnings(
    model: Model, measured: Float[np.ndarray, "runs n_measured"]
) -> Float[np.ndarray, "runs n_x"]:
    """The states in which records begin, by their first [q, v], see `Model.initial_internal`."""
    measured = np.asarray(measured, np.float64)
    if not model.internal:
        return measured
    formula = Formula(
        model.initial_internal, measured.shape[1], where=f"the model ({type(model).__name__})"
    )
    return np.concatenate([measured, evaluate(formula, measured)], axis=1)


def _motion(model: ContinuousModel, n_u: int) -> tuple[Equations, Float[np.ndarray, " n_c"]]:
    if isinstance(model, LagrangianModel):
        names = tuple(sorted(model.values))
        return _system_motion(model.system, names), np.array(
            [float(model.values[n]) for n in names]
        )
    equations = Equations(
        lambda x, u, p, c: model.derivative(x, u), n_x=model.state_size, n_u=n_u,
        where=f"the model ({type(model).__name__})",
    )  # fmt: skip
    return equations, np.zeros(0)


@lru_cache(maxsize=32)  # one machine code serves a system whatever its parameters' values
def _system_motion(system: LagrangianSystem, names: tuple[str, ...]) -> Equations:
    def derivative(x: Array, u: Array, p: Array, c: Array) -> Array:
        return system.model({name: c[i] for i, name in enumerate(names)}).derivative(x, u)

    return Equations(
        derivative, n_x=2 * len(system.coordinates) + len(system.internal),
        n_u=len(system.inputs), n_c=len(names), where=f"system '{system.name}'",
    )  # fmt: skip
