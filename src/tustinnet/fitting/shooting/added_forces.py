"""Forces that are added to a system, with ranges from the motion in the records."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import rotating_coordinates, smooth_velocities
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.models.added import WHERE, PlacedForce, parse_forces, with_forces
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.forces import LAWS, Motion
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.parameters import Parameter


def with_added(
    system: LagrangianSystem,
    names: Sequence[str],
    experiments: Sequence[Experiment],
    known: Mapping[str, float],
) -> LagrangianSystem:
    """The system with forces of the library.

    Forces in equilibrium: none that is missing can be much larger than those that the system has.
    So the largest value of a friction at the speeds of the records, and of a spring at their
    deflections, is 10 times the root mean square of inertia, potential and actuators at the
    coordinate, at the nominal values. The search begins at 0, and at a thousandth of the largest
    value where there is no derivative at 0 (breakaway, a spring that relaxes).

    Args:
        system: the system.
        names: `LAW`, `LAW:COORDINATE` or `LAW:INPUT`, see `models.added.parse_forces`. A law that
            depends on a deflection and names no coordinate is added at those that do not turn
            around.
        experiments: the training records.
        known: values of parameters that are better known than the nominal ones.

    Raises:
        InputError: a force that `models.added` refuses, a coordinate that never moves, or an input
            that never changes.
    """
    added = parse_forces(system, _with_coordinates(system, names, experiments))
    if not added:
        return system
    parameters = force_parameters(system, added, experiments, known)
    return with_forces(system, tuple(map(str, added)), parameters)


def force_parameters(
    system: LagrangianSystem,
    added: Sequence[PlacedForce],
    experiments: Sequence[Experiment],
    known: Mapping[str, float],
) -> tuple[Parameter, ...]:
    """The parameters that forces bring to a system, with ranges by the motion, see `with_added`."""
    values = system.nominal()
    values |= {name: x for name, x in known.items() if name in values}
    motions = _motions(system, added, experiments, values)
    parameters: dict[str, Parameter] = {}
    for force, motion in zip(added, motions, strict=True):
        if force.law.is_at_input:
            channel = system.inputs[force.index]
            if all(np.ptp(e.u[:, force.index]) == 0 for e in experiments):
                raise InputError(
                    WHERE,
                    f"'{force}': '{channel.name}' never changes in a training record",
                    "an input that changes",
                    "name those that do, as LAW:INPUT",
                )
            made = [need.for_input(channel, motion) for need in force.law.parameters]
            parameters |= {p.name: p for p in made}
            continue
        if not (motion.travel > 0 and motion.speed > 0 and motion.force > 0):
            raise InputError(
                WHERE,
                f"'{force}': '{force.channel}' never moves in the training records",
                "a coordinate that moves",
                "name those that do, as LAW:COORDINATE",
            )
        motion = replace(motion, width=values.get(force.own_width))
        coordinate = replace(system.coordinates[force.index], name=force.channel)
        unit = system.force_unit(coordinate)
        every = [need.for_coordinate(coordinate, unit, motion) for need in force.brought.values()]
        parameters |= {p.name: p for p in every}
    # frictions that were added before share some
    return tuple(p for name, p in parameters.items() if name not in system.added_parameters)


def _with_coordinates(
    system: LagrangianSystem, names: Sequence[str], experiments: Sequence[Experiment]
) -> list[str]:
    """Names of forces, those that need a limited travel at every coordinate that has one."""
    around = rotating_coordinates(experiments)
    limited = [c.name for c in system.coordinates if c.name not in around]
    placed: list[str] = []
    for name in names:
        if name not in LAWS or not LAWS[name].needs_limited_travel:
            placed.append(name)
            continue
        if not limited:
            raise InputError(
                WHERE,
                f"'{name}': every coordinate turns around",
                "a coordinate with an end",
                f"name one, as {name}:COORDINATE, if a spring pulls at it all the same",
            )
        placed += [f"{name}:{coordinate}" for coordinate in limited]
    return placed


def _motions(
    system: LagrangianSystem,
    added: Sequence[PlacedForce],
    experiments: Sequence[Experiment],
    values: Mapping[str, float],
) -> list[Motion]:
    """The motion at the place of every force, and the forces along it.

    These are inertia, the forces of the energies, and the actuators at standstill; of a force at an
    input those at the first coordinate.
    """
    velocities = [smooth_velocities(e) for e in experiments]
    a = [np.gradient(v, e.dt, axis=0) for v, e in zip(velocities, experiments, strict=True)]
    q, u = ([getattr(e, name) for e in experiments] for name in ("q", "u"))
    q, v, a, u = map(np.concatenate, (q, velocities, a, u))
    samples, ends = np.concatenate([q, v, a, u], axis=1), np.cumsum([x.shape[1] for x in (q, v, a)])
    model = rigid_system(system).model({name: jnp.asarray(x) for name, x in values.items()})

    def forces(sample: Array) -> Array:
        q, v, a, u = jnp.split(sample, ends)
        at_rest = jnp.zeros_like(v)
        z = model.balanced_internal(q, at_rest, u)
        applied = model.applied(q, at_rest, z, u)
        return jnp.concatenate([model.mass_matrix(q) @ a, model.conservative(q, v), applied])

    formula = Formula(forces, samples.shape[1], where=f"system '{system.name}'")
    acting = np.split(evaluate(formula, samples), 3, axis=1)
    size = np.max([_size(x) for x in acting], axis=0)
    dt, longest = experiments[0].dt, max(e.seconds for e in experiments)
    motions = []
    for force in added:
        places = ((0, 1.0),) if force.law.is_at_input else force.places
        along = np.zeros(q.shape[1])
        for i, factor in places:
            along[i] = factor
        of_force = max(float(size[i]) for i, _ in places)
        position, speed = (float(_size(x @ along)) for x in (q, v))
        travel, (lower, upper) = float(np.std(q @ along)), np.percentile(q @ along, (1, 99))
        outer = float(lower), float(upper)
        drive = float(np.abs(u[:, force.index]).max()) if force.law.is_at_input else 0.0
        motions.append(Motion(of_force, position, travel, speed, outer, dt, longest, drive))
    return motions


def _size(signal: Float[np.ndarray, "n *c"]) -> Float[np.ndarray | np.float64, " *c"]:
    """The root mean square of a signal, or of each column."""
    return np.sqrt(np.mean(signal**2, axis=0))
