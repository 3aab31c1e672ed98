"""The system `mechanism`: energies as short series, for machines without a system file.

Gravity, springs and inertias are sums of sines, cosines and powers of the coordinates. The
identification selects the terms of a machine: terms that the records do not need are left out.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise, permutations
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tustinnet.channels import Coordinate, Input
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import (
    rotating_coordinates,
    smooth_velocities,
    still_coordinates,
)
from tustinnet.errors import InputError
from tustinnet.models.blocks import root_mean_square
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.forces import LAWS
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.files import SystemTemplate

NAME = "mechanism"
_LARGEST_MECHANISM = 6  # coordinates; with more, terms are many and identification slow
_FEW_COORDINATES = (
    3  # coordinates up to which any two may be coupled; more angles are those of a chain
)
_INERTIA_SHARE = 0.5  # expected size of a term of the inertia, as a share of the inertia
_SHARES = 5.0  # ranges of such a term, and of inertias to the first one
_BALANCED = 5.0  # times that acceleration: gravity on links of a chain, whose motors balance it
_POWERS = ("pull", "spring", "quadratic")  # forces by the power of the coordinate, from 0


class Wave(NamedTuple):
    """A function of positions on which inertia or height may depend.

    Attributes:
        name: its name.
        value: its value at positions.
        rank: how special it is: 0 where most mechanisms have it.
    """

    name: str
    value: Callable[[Any], Any]
    rank: int


Term = tuple[int, Parameter]  # its rank, and the parameter that scales it


class Mechanism(SystemTemplate):
    """The template of the system `mechanism`, which has the coordinates of the records."""

    name = NAME

    def for_records(self, records: Sequence[Experiment]) -> LagrangianSystem:
        """The system with every term that some records have information about.

        Ranges follow from the motion: no term accelerates more than 10 times what the records
        do. Angles may feel gravity; springs act where a coordinate does not turn around. With
        more than 3 coordinates, angles that follow one another are those of a chain of links in a
        plane, and special terms are missing.

        Args:
            records: at least one.

        Raises:
            InputError: more coordinates than 6, or one that never moves.
        """
        coordinates, inputs = records[0].coordinates, records[0].inputs
        if len(coordinates) > _LARGEST_MECHANISM:
            raise InputError(
                f"system '{NAME}'",
                f"{len(coordinates)} coordinates",
                f"{_LARGEST_MECHANISM} at most",
                "write the system down: docs/how-to/add-a-system.md",
            )
        if at_rest := still_coordinates(records):
            raise InputError(
                f"system '{NAME}', coordinate '{at_rest[0]}'",
                "never moves in the records",
                "a coordinate that moves",
                "leave it out of the data card",
            )
        v = [smooth_velocities(e) for e in records]
        a = [np.gradient(x, e.dt, axis=0) for x, e in zip(v, records, strict=True)]
        size, input_size = (_sizes([getattr(e, name) for e in records]) for name in ("q", "u"))
        # no single term does ten times as much as the root mean square of the accelerations
        speed, largest = _sizes(v), [10.0 * x for x in _sizes(a)]
        around, is_special = rotating_coordinates(records), len(coordinates) <= _FEW_COORDINATES
        # gravity acts on angles, and on the sums of neighbours: links on links, which motors hold
        gravity_factor = 1.0 if is_special else _BALANCED
        terms = [
            *_inertias(coordinates),
            *(
                _optional(
                    wave.rank,
                    f"{coordinates[k].name}.gravity_{wave.name}",
                    "1/s^2",
                    gravity_factor * largest[k],
                )
                for k, wave in _gravity_waves(coordinates)
            ),
        ]
        terms += _pair_terms(coordinates, records, v, largest)
        for k, c in enumerate(coordinates):
            damping = largest[k] / speed[k]
            # the search begins at a hundredth of the largest damping
            viscous = Parameter(f"{c.name}.viscous", "1/s", 0.01 * damping, 0.0, damping)
            terms.append((0, viscous))
            for i, x in zip(inputs, input_size, strict=True):
                by, unit = f"{c.name}.by_{i.name}", f"{c.unit}/s^2/{i.unit}"
                terms.append(_optional(0, by, unit, largest[k] / x))
                if is_special:
                    squared = _optional(3, f"{by}_squared", f"{unit}^2", largest[k] / x**2)
                    terms.append(squared)
            if is_special:
                drag = largest[k] / speed[k] ** 2
                terms.append(_resistance(3, f"{c.name}.drag", f"1/{c.unit}", drag))
            if c.name not in around:
                terms += _spring_terms(c, largest[k], size[k], is_special)
        # of terms that can stand for one another the later ones are left out
        terms.sort(key=lambda term: term[0])
        return self.restore(coordinates, inputs, [parameter for _, parameter in terms])

    def restore(
        self,
        coordinates: Sequence[Coordinate],
        inputs: Sequence[Input],
        parameters: Sequence[Parameter],
    ) -> LagrangianSystem:
        """The system with the terms whose parameters are given.

        Args:
            coordinates: coordinates of the records.
            inputs: inputs of the records.
            parameters: the inertia of each coordinate, and the parameters of its other terms.
        """
        channels = tuple(coordinates), tuple(inputs)
        return LagrangianSystem(
            NAME,
            *channels,
            tuple(parameters),
            **_functions(*channels),
            energy_unit=f"{coordinates[0].unit}^2/s^2",  # of which the first inertia is 1
        )


MECHANISM = Mechanism()


def _sizes(signals: Sequence[np.ndarray]) -> list[float]:
    """The root mean square of each column, over all records."""
    return [float(x) for x in root_mean_square(np.concatenate(signals))]


def _optional(
    rank: int,
    name: str,
    unit: str,
    most: float,
    prior: float | None = None,
    usual: tuple[float, ...] = (),
    brings: tuple[str, ...] = (),
) -> Term:
    """A term that may be missing, and may have either sign."""
    return rank, Parameter(
        name, unit, 0.0, -most, most, prior=prior, optional=True, usual=usual, brings=brings
    )


def _resistance(rank: int, name: str, unit: str, most: float) -> Term:
    """A friction that may be missing; it never drives the motion."""
    return rank, Parameter(name, unit, 0.0, 0.0, most, optional=True)


def _rigid(rank: int, name: str) -> Term:
    """A term that is 1 between rigid links if it exists, -1 where an axis is reversed."""
    return _optional(rank, name, "1", _SHARES, prior=1.0, usual=(1.0, -1.0))


def _inertias(coordinates: Sequence[Coordinate]) -> list[Term]:
    """Inertias as shares: the first is the unit, so forces are accelerations."""
    terms: list[Term] = []
    for i, c in enumerate(coordinates):
        unit = "1" if c.unit == coordinates[0].unit else f"{coordinates[0].unit}^2/{c.unit}^2"
        terms.append((0, Parameter(f"{c.name}.inertia", unit, 1.0, 1e-6, 1e6, fixed=i == 0)))
        if len(coordinates) > _FEW_COORDINATES:
            terms += _chain_inertias(coordinates, i)
            continue
        terms += [
            _optional(
                wave.rank, f"{c.name}.inertia_{wave.name}", "1", _SHARES, prior=_INERTIA_SHARE
            )
            for wave in _inertia_waves(coordinates, i)
        ]
        terms += [
            _rigid(1 + (k < i), f"{c.name}.inertia_across_{other.name}")
            for k, other in enumerate(coordinates)
            if k != i and other.kind == "angular"
        ]
        for j in range(i + 1, len(coordinates)):
            pair = _pair(c, coordinates[j])
            if _are_angles(coordinates, i, j):
                along = f"{c.name}.inertia_along_{coordinates[j].name}"
                terms += [_rigid(0, pair), _rigid(0, along)]
            else:
                terms.append(_optional(0, pair, "1", _SHARES, prior=_INERTIA_SHARE))
            terms += [
                _optional(wave.rank, f"{pair}_{wave.name}", "1", _SHARES, prior=_INERTIA_SHARE)
                for wave in _coupling_waves(coordinates, i, j)
            ]
    return terms


def _chain_inertias(coordinates: Sequence[Coordinate], i: int) -> list[Term]:
    """Terms of the inertia of one of many coordinates: of a rotor, of links, of what slides.

    Args:
        coordinates: coordinates of the records.
        i: the index of the coordinate.
    """
    name, begin = coordinates[i].name, _chain_begin(coordinates, i)
    terms = []
    if begin < i:
        terms.append(_resistance(2, f"{name}.rotor", "1", _SHARES))
    for j in range(i + 1, len(coordinates)):
        other = coordinates[j].name
        if _chain_begin(coordinates, j) == begin:
            terms.append(
                _optional(j - i - 1, f"{name}.link_{other}", "1", 1.0, prior=_INERTIA_SHARE)
            )
        else:
            terms.append(_optional(3, f"{name}.coupling_{other}", "1", 1.0, prior=_INERTIA_SHARE))
    return terms


def _chain_begin(coordinates: Sequence[Coordinate], i: int) -> int:
    """The index of the first angle of the chain that a coordinate is in; its own if it slides."""
    begin = i
    while coordinates[i].kind == "angular" and begin and coordinates[begin - 1].kind == "angular":
        begin -= 1
    return begin


def _spring_terms(c: Coordinate, largest: float, size: float, is_special: bool) -> list[Term]:
    """A steady pull, a spring and, where special terms are offered, a quadratic one.

    Args:
        c: the coordinate.
        largest: largest acceleration of a single term.
        size: root mean square of its positions.
        is_special: whether special terms are offered.
    """
    brings = tuple(f"{law.name}:{c.name}" for law in LAWS.values() if law.joins_springs)
    terms = [
        _optional(1, f"{c.name}.pull", f"{c.unit}/s^2", largest),
        _optional(0, f"{c.name}.spring", "1/s^2", largest / size, brings=brings),
    ]
    if is_special:
        most = largest / size**2
        terms.append(_optional(2, f"{c.name}.quadratic", f"1/(s^2 {c.unit})", most))
    return terms


def _pair_terms(
    coordinates: Sequence[Coordinate],
    records: Sequence[Experiment],
    velocities: Sequence[np.ndarray],
    largest: Sequence[float],
) -> list[Term]:
    """Shafts between two coordinates of a kind, and slides on axes that turn.

    Args:
        coordinates: coordinates of the records.
        records: the records.
        velocities: their velocities, of each record.
        largest: largest acceleration of a single term, for each coordinate.
    """
    q, v = np.concatenate([e.q for e in records]), np.concatenate(velocities)
    terms: list[Term] = []
    for i, a in enumerate(coordinates):
        for k, b in enumerate(coordinates):
            if i < k and a.kind == b.kind:
                twist, slip = (_sizes([x[:, [i]] - x[:, [k]]])[0] for x in (q, v))
                most = max(largest[i], largest[k])
                # two coordinates that turn or slide together differ by less
                if np.ptp(q[:, i] - q[:, k]) < 0.3 * np.ptp(q[:, [i, k]], axis=0).max():
                    terms += [
                        _optional(1, f"{a.name}.shaft_{b.name}", "1/s^2", most / twist),
                        _resistance(2, f"{a.name}.shaft_viscous_{b.name}", "1/s", most / slip),
                    ]
            if a.kind == "linear" and b.kind == "angular" and len(coordinates) <= _FEW_COORDINATES:
                sizes = {"sin": np.sin(q[:, k]), "cos": np.cos(q[:, k])}
                terms += [
                    _optional(
                        1 + (name == "cos"),
                        f"{a.name}.gravity_{name}_{b.name}",
                        f"{a.unit}/s^2",
                        largest[i] / _sizes([x[:, None]])[0],
                    )
                    for name, x in sizes.items()
                ]
                terms.append(_rigid(2, f"{b.name}.inertia_at_{a.name}"))
    return terms


def _pair(a: Coordinate, b: Coordinate) -> str:
    """The name of the parameter that couples two coordinates."""
    return f"{a.name}.coupling_{b.name}"


def _cosine_and_sine(name: str, angle: Callable[[Any], Any], rank: int) -> list[Wave]:
    """Cosine and sine of an angle; a sine is for angles that are not counted from an axis."""
    return [
        Wave(name.format("cos"), lambda q: jnp.cos(angle(q)), rank),
        Wave(name.format("sin"), lambda q: jnp.sin(angle(q)), rank + 1),
    ]


def _waves(coordinates: Sequence[Coordinate], k: int) -> list[Wave]:
    """Cosine and sine of a coordinate, none of one that is no angle."""
    if coordinates[k].kind != "angular":
        return []
    return _cosine_and_sine(f"{{}}_{coordinates[k].name}", lambda q: q[k], 0)


def _are_angles(coordinates: Sequence[Coordinate], i: int, j: int) -> bool:
    return coordinates[i].kind == coordinates[j].kind == "angular"


def _inertia_waves(coordinates: Sequence[Coordinate], i: int) -> list[Wave]:
    """Functions on which the inertia of a coordinate alone may depend: of all other angles.

    Those before it are special: coordinates are mostly listed from the base to the tip. That an
    inertia depends on an angle and none couples them is special, too.
    """
    angular = [k for k, c in enumerate(coordinates) if c.kind == "angular" and k != i]
    return [
        wave._replace(rank=wave.rank + 1 + (k < i))
        for k in angular
        for wave in (
            *_waves(coordinates, k),
            Wave(f"sin_2{coordinates[k].name}", lambda q, k=k: jnp.sin(2 * q[k]), 1),
        )
    ]


def _coupling_waves(coordinates: Sequence[Coordinate], i: int, j: int) -> list[Wave]:
    """Functions on which a coupling may depend: of all angles, and of the pair's difference."""
    waves = [
        wave._replace(rank=wave.rank + (k != j))
        for k in range(len(coordinates))
        for wave in _waves(coordinates, k)
    ]
    if _are_angles(coordinates, i, j):
        waves += _cosine_and_sine("{}_difference", lambda q: q[i] - q[j], 1)
    return waves


def _gravity_waves(coordinates: Sequence[Coordinate]) -> list[tuple[int, Wave]]:
    """Heights of links by their angle, or by the sum with the angle before; with the index.

    In a chain of many links it is the sum of all angles up to the link.
    """
    angular = [k for k, c in enumerate(coordinates) if c.kind == "angular"]
    if len(coordinates) > _FEW_COORDINATES:
        begins = {k: _chain_begin(coordinates, k) for k in angular}
        return [
            (k, wave)
            for k, begin in begins.items()
            for wave in _cosine_and_sine(
                "{}" if begin == k else "{}_chain",
                lambda q, a=begin, b=k: jnp.sum(q[a : b + 1]),
                0,
            )
        ]
    alone = [(k, wave) for k in angular for wave in _cosine_and_sine("{}", lambda q, k=k: q[k], 0)]
    return alone + [
        (k, wave)
        for before, k in pairwise(angular)
        for wave in _cosine_and_sine("{}_sum", lambda q, a=before, b=k: q[a] + q[b], 1)
    ]


def _chain_kinetic(coordinates: tuple[Coordinate, ...]) -> Callable[..., Any]:
    """The kinetic energy of chains of links in a plane: it depends on angles between links."""
    names = [c.name for c in coordinates]
    n, begins = len(names), [_chain_begin(coordinates, i) for i in range(len(names))]

    def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
        inertias = [p[f"{name}.inertia"] for name in names]
        speeds = [jnp.sum(v[begin : i + 1]) for i, begin in enumerate(begins)]
        total = jnp.zeros((), v.dtype)
        for i, name in enumerate(names):
            own = speeds[i] ** 2 + p.get(f"{name}.rotor", 0.0) * v[i] ** 2
            total = total + 0.5 * inertias[i] * own
            for j in range(i + 1, n):
                mean = jnp.sqrt(inertias[i] * inertias[j])
                if (link := f"{name}.link_{names[j]}") in p:
                    between = jnp.cos(jnp.sum(q[i + 1 : j + 1]))
                    total = total + mean * p[link] * between * speeds[i] * speeds[j]
                if (coupling := f"{name}.coupling_{names[j]}") in p:
                    total = total + mean * p[coupling] * v[i] * v[j]
        return total

    return kinetic


def _kinetic(coordinates: tuple[Coordinate, ...]) -> Callable[..., Any]:
    """The kinetic energy: inertias that depend on the angles."""
    names = [c.name for c in coordinates]
    n = len(names)
    if n > _FEW_COORDINATES:
        return _chain_kinetic(coordinates)

    def share(prefix: str, waves: Sequence[Wave], q: Coordinates, p: Values) -> Any:
        named = ((f"{prefix}_{wave.name}", wave) for wave in waves)
        return sum(p[name] * wave.value(q) for name, wave in named if name in p)

    def alone(i: int, q: Coordinates, p: Values) -> Any:
        inertia = p[f"{names[i]}.inertia"]
        total = inertia * (1.0 + share(f"{names[i]}.inertia", _inertia_waves(coordinates, i), q, p))
        for k in range(n):
            if (at := f"{names[i]}.inertia_at_{names[k]}") in p:
                total = total + p[f"{names[k]}.inertia"] * p[at] * q[k] ** 2
            if (across := f"{names[i]}.inertia_across_{names[k]}") in p:
                total = total + p[f"{names[k]}.inertia"] * p[across] * jnp.sin(q[k]) ** 2
        return total

    def coupled(i: int, j: int, q: Coordinates, v: Coordinates, p: Values) -> Any:
        first, second = p[f"{names[i]}.inertia"], p[f"{names[j]}.inertia"]
        pair, mean = _pair(coordinates[i], coordinates[j]), jnp.sqrt(first * second)
        steady = second if _are_angles(coordinates, i, j) else mean
        coupling = steady * p.get(pair, 0.0)
        coupling = coupling + mean * share(pair, _coupling_waves(coordinates, i, j), q, p)
        along = p.get(f"{names[i]}.inertia_along_{names[j]}", 0.0)
        by_angle = mean * share(pair, _waves(coordinates, j), q, p)
        return coupling * v[i] * v[j] + along * by_angle * v[i] ** 2

    def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
        total = jnp.zeros((), v.dtype)
        for i in range(n):
            total = total + 0.5 * alone(i, q, p) * v[i] ** 2
            for j in range(i + 1, n):
                total = total + coupled(i, j, q, v, p)
        return total

    return kinetic


def _potential(coordinates: tuple[Coordinate, ...]) -> Callable[..., Any]:
    """The potential energy: gravity, springs and shafts."""
    names, waves = [c.name for c in coordinates], _gravity_waves(coordinates)

    def of_pair(i: int, k: int, q: Coordinates, p: Values) -> Any:
        """The shaft between two coordinates; the height of a slide on a turning axis."""
        name, other, total = names[i], names[k], 0.0
        if (shaft := f"{name}.shaft_{other}") in p:
            total = total + p[shaft] * (q[i] - q[k]) ** 2 / 2
        for function, value in (("sin", jnp.sin), ("cos", jnp.cos)):
            if (slide := f"{name}.gravity_{function}_{other}") in p:
                total = total + p[slide] * q[i] * value(q[k])
        return total

    def potential(q: Coordinates, p: Values) -> Scalar:
        total = jnp.zeros((), q.dtype)
        for k, wave in waves:
            if (name := f"{names[k]}.gravity_{wave.name}") in p:
                total = total + p[f"{names[k]}.inertia"] * p[name] * wave.value(q)
        for k, c in enumerate(names):
            powers = enumerate(_POWERS, 1)
            elastic = sum(p.get(f"{c}.{name}", 0.0) * q[k] ** m / m for m, name in powers)
            total = total + p[f"{c}.inertia"] * elastic
        for i, k in permutations(range(len(names)), 2):
            total = total + p[f"{names[i]}.inertia"] * of_pair(i, k, q, p)
        return total

    return potential


def _dissipation(coordinates: tuple[Coordinate, ...]) -> Callable[..., Any]:
    """Friction, viscous and in shafts, and drag; the voltage that a motor induces acts alike."""
    names = [c.name for c in coordinates]

    def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
        total = [p[f"{c}.inertia"] * p[f"{c}.viscous"] * v[k] for k, c in enumerate(names)]
        for k, c in enumerate(names):
            if (name := f"{c}.drag") in p:
                total[k] = total[k] + p[f"{c}.inertia"] * p[name] * v[k] * jnp.abs(v[k])
        for k, m in permutations(range(len(names)), 2):
            if (name := f"{names[k]}.shaft_viscous_{names[m]}") in p:
                friction = p[f"{names[k]}.inertia"] * p[name] * (v[k] - v[m])
                total[k], total[m] = total[k] + friction, total[m] - friction
        return jnp.stack(total)

    return dissipation


def _input_map(
    coordinates: tuple[Coordinate, ...], inputs: tuple[Input, ...]
) -> Callable[..., Any]:
    """The generalised forces of the inputs, each of which acts on every coordinate."""
    names = [c.name for c in coordinates]

    def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
        forces = []
        for k, c in enumerate(names):
            acceleration = 0.0 * v[k]
            for m, i in enumerate(inputs):
                acceleration = acceleration + p.get(f"{c}.by_{i.name}", 0.0) * u[m]
                if (name := f"{c}.by_{i.name}_squared") in p:
                    acceleration = acceleration + p[name] * u[m] * jnp.abs(u[m])
            forces.append(p[f"{c}.inertia"] * acceleration)
        return jnp.stack(forces)

    return input_map


@lru_cache(maxsize=64)  # so that equal systems serve the same compiled programs
def _functions(coordinates: tuple[Coordinate, ...], inputs: tuple[Input, ...]) -> dict[str, Any]:
    """Energies and forces with the terms whose parameters they are given."""
    return {
        "kinetic": _kinetic(coordinates),
        "potential": _potential(coordinates),
        "dissipation": _dissipation(coordinates),
        "input_map": _input_map(coordinates, inputs),
    }
