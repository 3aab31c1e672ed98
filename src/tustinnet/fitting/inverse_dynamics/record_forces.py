"""Forces along a record by a model, beside those of its actuators."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Coordinate
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.inverse_dynamics.along import ForcesAlong, filter_record, require_possible
from tustinnet.fitting.inverse_dynamics.cutoff import choose_cutoff
from tustinnet.fitting.inverse_dynamics.sums import force_sizes, rest_speeds
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.models.contract import Model, require_float64
from tustinnet.models.lagrangian import LagrangianModel


@dataclass(frozen=True)
class RecordForces:
    """Forces along a record, filtered, at nearly independent samples.

    Attributes:
        record: the record's name.
        coordinates: the coordinates.
        cutoff: frequency up to which forces are compared [Hz].
        t: times of the samples [s], (k,).
        needed: what the motion needs by the model, (k, n_q) [N m or N].
        applied: what the actuators give, (k, n_q) [N m or N].
        speed: size of the velocities, (k, n_q) [rad/s or m/s].
    """

    record: str
    coordinates: tuple[Coordinate, ...]
    cutoff: float
    t: Float[np.ndarray, " k"]
    needed: Float[np.ndarray, "k n_q"]
    applied: Float[np.ndarray, "k n_q"]
    speed: Float[np.ndarray, "k n_q"]

    @property
    def missing(self) -> Float[np.ndarray, "k n_q"]:
        """What the motion needs and the actuators do not give, (k, n_q) [N m or N]."""
        return self.needed - self.applied

    @property
    def moves(self) -> Bool[np.ndarray, "k n_q"]:
        """Where each coordinate moves: faster than 2 % of its root mean square speed."""
        return self.speed >= rest_speeds(self.speed)

    @property
    def share(self) -> dict[str, float]:
        """Missing force by that of the actuators, root mean squares, by coordinate.

        Of a coordinate without an actuator by the force that its motion needs.
        """
        return self._shares(np.ones_like(self.moves))

    @property
    def share_moving(self) -> dict[str, float]:
        """The same of the samples at which the coordinate moves."""
        return self._shares(self.moves)

    def _shares(self, kept: Bool[np.ndarray, "k n_q"]) -> dict[str, float]:
        size = force_sizes(self.applied, self.needed)
        missing, of = (np.sqrt(np.sum(x**2 * kept, axis=0)) for x in (self.missing, size))
        shares = missing / np.maximum(of, 1e-300)
        return {c.name: float(x) for c, x in zip(self.coordinates, shares, strict=True)}


def inverse_dynamics(model: Model, record: Experiment, cutoff: float | None = None) -> RecordForces:
    """The forces that the motion of a record needs by a model, beside those of its actuators.

    Nothing is simulated: positions are filtered and differentiated. Of a closed loop the system
    alone counts, with the inputs that its controller computed as recorded.

    Args:
        model: a model with equations of motion.
        record: a record, of any split.
        cutoff: frequency up to which forces are compared [Hz]; by default that up to which the
            equations of motion can explain forces that they were not fitted to. Numbers of other
            frequencies are others.

    Raises:
        InputError: a model without equations of motion, or one whose forces do not follow from a
            motion; a record of another system, or one that is too short.
    """
    require_float64("inverse_dynamics")
    equations = family_of(model).equations(model)
    if equations is None:
        expected = "equations of motion, as of an identified system"
        raise InputError("inverse_dynamics", "a model without equations of motion", expected)
    system = equations.system.plant
    require_possible(system, [record])
    alone = record.without_controller()
    system.channels.require_same(alone.channels, alone.name, f"the system '{system.name}'")
    return forces_along(equations, record, cutoff or choose_cutoff(system, [alone]))


def unexplained_forces(
    model: LagrangianModel, records: Sequence[Experiment], cutoff: float
) -> dict[str, float]:
    """Missing force by that of the actuators along several records, see `RecordForces.share`.

    Args:
        model: equations of motion to which `find_obstacle` finds no obstacle.
        records: the records.
        cutoff: frequency up to which forces are compared [Hz].

    Raises:
        InputError: a record that is too short.
    """
    parts = [forces_along(model, e, cutoff) for e in records]
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "needed", "applied", "speed")
    }
    return replace(parts[0], **joined).share


def forces_along(model: LagrangianModel, record: Experiment, cutoff: float) -> RecordForces:
    """The forces along a record by equations of motion, see `inverse_dynamics`.

    Args:
        model: equations of motion to which `find_obstacle` finds no obstacle.
        record: the record.
        cutoff: frequency up to which forces are compared [Hz].

    Raises:
        InputError: a record that is too short.
    """
    system = model.system.plant
    values = {name: float(x) for name, x in model.values.items()}
    part = filter_record(record.without_controller(), cutoff)
    along = ForcesAlong(system_equations(system), part, values)
    needed = along.needed(values)
    t = record.t[0] + part.dt * np.arange(len(part.q))[part.kept]
    return RecordForces(
        record.name,
        system.coordinates,
        cutoff,
        t,
        needed,
        needed - along.missing(values),
        part.compare(np.abs(part.v)),
    )
