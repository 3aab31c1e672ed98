"""Forces along records by a model, beside those of its actuators."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.inverse_dynamics.along import ForcesAlong, filter_record, require_possible
from tustinnet.fitting.inverse_dynamics.cutoff import choose_cutoff
from tustinnet.fitting.inverse_dynamics.linear_forces import LinearForces
from tustinnet.fitting.inverse_dynamics.record_forces import RecordForces, force_errors
from tustinnet.fitting.inverse_dynamics.solver import least_squares
from tustinnet.fitting.inverse_dynamics.sums import sum_up
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.fitting.shooting.groups import expand_parameters
from tustinnet.fitting.shooting.space import SearchSpace, make_search_space
from tustinnet.models.contract import Model, require_float64
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem


def inverse_dynamics(
    model: Model,
    record: Experiment,
    cutoff: float | None = None,
    *,
    training: Sequence[Experiment] = (),
) -> RecordForces:
    """The forces that the motion of a record needs by a model, beside those of its actuators.

    Nothing is simulated: positions are filtered and differentiated. Of a closed loop the system
    alone counts, with the inputs that its controller computed as recorded. Inputs act with the
    delays of the model, as in its free runs.

    Args:
        model: a model with equations of motion.
        record: a record, of any split.
        cutoff: frequency up to which forces are compared [Hz]; by default that up to which the
            equations of motion can explain forces that they were not fitted to, along the training
            records if there are any, else along this one. Numbers of other frequencies are others.
        training: records by which least squares, as a reference, has its parameters; those of a fit
            lead to the cut-off frequency of the fit.

    Raises:
        InputError: a model without equations of motion, or one whose forces do not follow from a
            motion; a record of another system, or one that is too short.
    """
    return forces_of_records(model, [record], cutoff, training=training)[0]


def forces_of_records(
    model: Model,
    records: Sequence[Experiment],
    cutoff: float | None = None,
    *,
    training: Sequence[Experiment] = (),
) -> list[RecordForces]:
    """The forces along several records by a model, see `inverse_dynamics`.

    Args:
        model: see `inverse_dynamics`.
        records: the records.
        cutoff: see `inverse_dynamics`; by default that of the training records, if there are any.
        training: see `inverse_dynamics`.

    Raises:
        InputError: see `inverse_dynamics`.
    """
    require_float64("inverse_dynamics")
    equations = family_of(model).equations(model)
    if equations is None:
        expected = "equations of motion, as of an identified system"
        raise InputError("inverse_dynamics", "a model without equations of motion", expected)
    system = equations.system.plant
    require_possible(system, [*records, *training])
    alone, training = ([e.without_controller() for e in some] for some in (records, training))
    for e in (*alone, *training):
        system.channels.require_same(e.channels, e.name, f"the system '{system.name}'")
    # as in a free run, inputs act when the model has them act
    inputs = model.channels.plant.inputs
    alone, training = ([e.with_timing(inputs) for e in some] for some in (alone, training))
    space = _space_of_file(system, [*alone, *training])
    cutoff = cutoff or choose_cutoff(system, training or alone, space)
    values = {name: float(x) for name, x in equations.values.items()}
    by_least_squares = _needed_by_least_squares(system, space, values, alone, training, cutoff)
    return [
        _forces_along(equations, e, cutoff, by_least_squares.get(k)) for k, e in enumerate(alone)
    ]


def unexplained_forces(
    model: LagrangianModel, records: Sequence[Experiment], cutoff: float
) -> dict[str, float]:
    """Missing force by that of the actuators along several records, by coordinate.

    Args:
        model: equations of motion to which `find_obstacle` finds no obstacle.
        records: the records.
        cutoff: frequency up to which forces are compared [Hz].

    Raises:
        InputError: a record that is too short.
    """
    parts = [_forces_along(model, replace(e, split=None), cutoff) for e in records]
    return {error.coordinate: error.share for error in force_errors(parts)}


def _space_of_file(system: LagrangianSystem, records: Sequence[Experiment]) -> SearchSpace:
    """The parameters of a system as it is without added forces."""
    parameters = expand_parameters(system, records)
    none = {p.name: 0.0 for p in parameters if p.name in system.added_parameters and not p.fixed}
    return make_search_space(system, {}, none, parameters)


def _needed_by_least_squares(
    system: LagrangianSystem,
    space: SearchSpace,
    values: Mapping[str, float],
    records: Sequence[Experiment],
    training: Sequence[Experiment],
    cutoff: float,
) -> dict[int, Float[np.ndarray, "k n_q"]]:
    """Forces that motions need by least squares on training records, by the place of the record.

    Gains of inputs have their values.
    """
    if not training:
        return {}
    vector = space.to_vector(space.nominal)

    def forces(some: Sequence[Experiment]) -> LinearForces:
        return LinearForces(system, space, tuple(filter_record(e, cutoff) for e in some))

    of_training = forces(training)
    found = least_squares(sum_up(of_training.columns(vector)), of_training.gains_among(values))
    return {
        k: own.slopes @ found + own.rest + own.applied
        for k, own in enumerate(forces(records).columns(vector))
    }


def _forces_along(
    model: LagrangianModel,
    record: Experiment,
    cutoff: float,
    by_least_squares: Float[np.ndarray, "k n_q"] | None = None,
) -> RecordForces:
    system = model.system.plant
    values = {name: float(x) for name, x in model.values.items()}
    part = filter_record(record.without_controller(), cutoff)
    along = ForcesAlong(system_equations(system), part, values)
    needed = along.needed(values)
    return RecordForces(
        record=record.name,
        split=record.split or "",
        coordinates=system.coordinates,
        units=tuple(map(system.force_unit, system.coordinates)),
        cutoff=cutoff,
        t=part.times,
        applied=needed - along.missing(values),
        needed=needed,
        needed_by_file=along.needed({**values, **system.nominal()}),
        needed_by_least_squares=by_least_squares,
        speed=part.compare(np.abs(part.v)),
    )
