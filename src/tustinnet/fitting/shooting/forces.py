"""Forces that are added to a system, in units of what moves it in the records."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tustinnet.channels import Coordinate
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import turning_around
from tustinnet.engine.equations import Formula
from tustinnet.engine.runs import evaluate
from tustinnet.errors import InputError
from tustinnet.models.added import LAWS, WHERE, PlacedForce, added_parameters, parse_forces, with_forces
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Parameter

_MOST = 10.0  # times the largest force that the system has without it
_FAINT, _LEAST = 1e-3, 1e-6  # of the largest value, where a force that cannot be 0 begins and ends
_SMOOTH = 0.02  # of the speed, within which the sign of a dry friction turns
_EITHER_WAY = 10.0  # times that width and a tenth of it may be asked for
_FIXED = ("smooth_speed", "turned")  # over whole records they would make up for other errors
_STRIBECK = (10.0, 2.0, 100.0)  # of it: speeds at which breakaway is forgotten
_FASTEST = 4  # periods in which a spring that relaxes has done so, at least


@dataclass(frozen=True)
class Scale:
    """What a coordinate's motion in the records is like.

    Attributes:
        force: generalised force [N m or N], the largest of inertia, springs and gravity, and
            actuators; root mean squares.
        position: distance from 0, root mean square [rad or m].
        travel: the same from the mean.
        speed: root mean square [rad/s or m/s].
        dt: sampling period [s].
        longest: duration of the longest record [s].
    """

    force: float
    position: float
    travel: float
    speed: float
    dt: float
    longest: float


def with_added(
    system: LagrangianSystem,
    names: Sequence[str],
    experiments: Sequence[Experiment],
    known: Mapping[str, float],
) -> LagrangianSystem:
    """The system with forces of the library.

    Forces in equilibrium: none that is missing can be much larger than those that the system has.
    So the largest value of a friction at the speeds of the records, and of a spring at their
    deflections, is 10 times the root mean square of what inertia, potential and actuators do to
    the coordinate at the nominal values. The search begins at 0; what would have no derivative
    there (breakaway, a spring that relaxes) at a thousandth of the largest value.

    Args:
        system: the system.
        names: `LAW` or `LAW:COORDINATE`, see `models.added.parse_forces`. A spring that names no
            coordinate is added at those that do not turn around.
        experiments: the training records.
        known: values of parameters that are better known than the nominal ones.

    Raises:
        InputError: what `models.added` refuses, and a coordinate that never moves.
    """
    added = parse_forces(system, _held(system, names, experiments))
    if not added:
        return system
    values = system.nominal()
    values |= {name: x for name, x in known.items() if name in values}
    scales = _scales(system, experiments, values)
    found: dict[str, Parameter] = {}
    for force in added:
        i = [c.name for c in system.coordinates].index(force.coordinate)
        if not (scales[i].travel > 0 and scales[i].speed > 0 and scales[i].force > 0):
            raise InputError(
                WHERE, f"'{force}': '{force.coordinate}' never moves in the training records",
                "a coordinate that moves", "name those that do, as LAW:COORDINATE",
            )  # fmt: skip
        found |= {p.name: p for p in _parameters(force, system.coordinates[i], scales[i])}
    shared = set(added_parameters(system))  # of forces that were added before
    new = tuple(p for name, p in found.items() if name not in shared)
    return with_forces(system, tuple(map(str, added)), new)


def _held(
    system: LagrangianSystem, names: Sequence[str], experiments: Sequence[Experiment]
) -> list[str]:
    """The names, with springs at no coordinate in particular placed at those that can have one."""
    around = turning_around(experiments)
    held = [c.name for c in system.coordinates if c.name not in around]
    found: list[str] = []
    for name in names:
        if name in LAWS and LAWS[name].elastic:
            if not held:
                raise InputError(
                    WHERE, f"'{name}': every coordinate turns around", "a coordinate with an end",
                    f"name one, as {name}:COORDINATE, if a spring pulls at it all the same",
                )  # fmt: skip
            found += [f"{name}:{coordinate}" for coordinate in held]
        else:
            found.append(name)
    return found


def _parameters(force: PlacedForce, of: Coordinate, scale: Scale) -> list[Parameter]:
    """The parameters of a force, with their ranges."""
    unit = {"rad": "N m", "m": "N"}.get(of.unit, f"J/{of.unit}")
    most, slow = _MOST * scale.force, _SMOOTH * scale.speed
    slowest, fastest = 1 / scale.longest, 1 / (_FASTEST * scale.dt)
    stiff, hard = (most / scale.position**n for n in (1, 3))
    pulled = most / scale.travel
    ranges = {  # unit, nominal, lower, upper
        "coulomb": (unit, 0.0, 0.0, most),
        "breakaway": (unit, _FAINT * most, _LEAST * most, most),
        "stribeck_speed": (f"{of.unit}/s", *(x * slow for x in _STRIBECK)),
        "smooth_speed": (f"{of.unit}/s", slow, slow / _EITHER_WAY, slow * _EITHER_WAY),
        "viscous": (f"{unit} s/{of.unit}", 0.0, 0.0, most / scale.speed),
        "rubbing": (f"{unit}/{of.unit}", 0.0, 0.0, stiff),
        "spring": (f"{unit}/{of.unit}", 0.0, -stiff, stiff),
        "cubic": (f"{unit}/{of.unit}^3", 0.0, -hard, hard),
        "maxwell": (f"{unit}/{of.unit}", _FAINT * pulled, _LEAST * pulled, pulled),
        "relaxation": (
            "1/s", min(max(scale.speed / scale.travel, slowest), fastest), slowest, fastest,
        ),
        # between forgotten and just turned there: what was before a record is not in it
        "turned": ("1", 0.5, 0.0, 1.0),
    }  # fmt: skip
    needs = LAWS[force.law].needs
    return [
        Parameter(name, *ranges[need], fixed=need in _FIXED)
        for name, need in zip(force.parameter_names, needs, strict=True)
    ]


def _scales(
    system: LagrangianSystem, experiments: Sequence[Experiment], values: Mapping[str, float]
) -> list[Scale]:
    """What the motion of every coordinate is like."""
    v = [e.velocities() for e in experiments]
    a = np.concatenate([np.gradient(x, e.dt, axis=0) for x, e in zip(v, experiments, strict=True)])
    q, u = (np.concatenate([getattr(e, name) for e in experiments]) for name in ("q", "u"))
    model = system.model({name: jnp.asarray(x) for name, x in values.items()})
    acting = _acting(model, q, np.concatenate(v), u, a)
    force = np.max([_size(x) for x in acting], axis=0)
    dt, longest = experiments[0].dt, max(e.seconds for e in experiments)
    each = zip(force, _size(q), np.std(q, axis=0), _size(np.concatenate(v)), strict=True)
    return [Scale(*map(float, of), dt=dt, longest=longest) for of in each]


def _size(signal: Float[np.ndarray, "n c"]) -> Float[np.ndarray, " c"]:
    """The root mean square of each column."""
    return np.sqrt(np.mean(signal**2, axis=0))


def _acting(
    model: LagrangianModel,
    q: Float[np.ndarray, "n n_q"],
    v: Float[np.ndarray, "n n_q"],
    u: Float[np.ndarray, "n n_u"],
    a: Float[np.ndarray, "n n_q"],
) -> list[Float[np.ndarray, "n n_q"]]:
    """Inertia, what comes from the energies, and actuators at standstill, at every sample."""
    samples, ends = np.concatenate([q, v, a, u], axis=1), np.cumsum([x.shape[1] for x in (q, v, a)])

    def at(sample: Array) -> Array:
        q, v, a, u = jnp.split(sample, ends)
        still, z = jnp.zeros_like(v), jnp.zeros(len(model.internal))
        inertia = model.mass_matrix(q) @ a
        applied = model.applied(q, still, z, u)
        return jnp.concatenate([inertia, model.conservative(q, v), applied])

    formula = Formula(at, samples.shape[1], where=f"system '{model.system.name}'")
    return np.split(evaluate(formula, samples), 3, axis=1)
