"""A mechanism that nobody has written down: energies as short series, made for some records.

Gravity, springs and inertias are sums of sines, cosines and powers of the coordinates. Which of
the terms a machine has is for the identification to find out: terms that the records do not need
are left out.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from tustinnet.channels import Coordinate, Input
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import still, turning_around
from tustinnet.errors import InputError
from tustinnet.models.blocks import root_mean_square
from tustinnet.models.contract import Coordinates, InputVector
from tustinnet.models.lagrangian import LagrangianSystem, Parameter, Scalar, Values
from tustinnet.systems.files import SystemTemplate

NAME = "mechanism"
_MOST = 3  # coordinates; with more, terms are many and identification slow
_SHARE = 0.5  # what is expected of a term of the inertia, as a share of the inertia
_SHARES, _RATIOS = 5.0, (1e-6, 1e6)  # ranges of such a term, and of inertias to the first one
_LARGEST = 10.0  # times the root mean square of the accelerations: no single term does more
_STEADY = 0.01  # share of the largest damping, where it begins
_POWERS = ("pull", "spring", "quadratic")  # forces by the power of the coordinate, from 0
_CABLE = ("cubic", "rubbing", "maxwell")  # what a spring may do beside


class Wave(NamedTuple):
    """How inertia or height may depend on positions.

    Attributes:
        name: what it is called.
        of: its value at positions.
        rank: how special it is: 0 for what most mechanisms have.
    """

    name: str
    of: Callable[[Any], Any]
    rank: int


Term = tuple[int, Parameter]  # how special, and what scales it


class Mechanism(SystemTemplate):
    """The system `mechanism`: one for every set of records, since it has their coordinates."""

    name = NAME

    def for_records(self, records: Sequence[Experiment]) -> LagrangianSystem:
        """The system with every term that the motion of some records can say something of.

        Ranges are those of the motion: no term accelerates more than 10 times what the records
        do. Angles may feel gravity; springs act where a coordinate does not turn around.

        Args:
            records: at least one.

        Raises:
            InputError: more coordinates than 3, or one that never moves.
        """
        coordinates, inputs = records[0].coordinates, records[0].inputs
        if len(coordinates) > _MOST:
            raise InputError(
                f"system '{NAME}'", f"{len(coordinates)} coordinates", f"{_MOST} at most",
                "write the system down: docs/how-to/add-a-system.md",
            )  # fmt: skip
        if never := still(records):
            raise InputError(
                f"system '{NAME}', coordinate '{never[0]}'", "never moves in the records",
                "a coordinate that moves", "leave it out of the data card",
            )  # fmt: skip
        v = [e.velocities() for e in records]
        a = [np.gradient(x, e.dt, axis=0) for x, e in zip(v, records, strict=True)]
        size, acting = (_sizes([getattr(e, name) for e in records]) for name in ("q", "u"))
        speed, largest = _sizes(v), [_LARGEST * x for x in _sizes(a)]
        found = [*_inertias(coordinates), *_heights(coordinates, largest)]
        around = turning_around(records)
        for k, c in enumerate(coordinates):
            damping = largest[k] / speed[k]
            viscous = Parameter(f"{c.name}.viscous", "1/s", _STEADY * damping, 0.0, damping)
            found.append((0, viscous))
            found += [
                _either(0, f"{c.name}.by_{i.name}", f"{c.unit}/s^2/{i.unit}", largest[k] / x)
                for i, x in zip(inputs, acting, strict=True)
            ]
            if c.name not in around:
                found += _springs(c, largest[k], size[k])
        # of terms that can stand for one another the later ones are left out
        found.sort(key=lambda term: term[0])
        return self.restore(coordinates, inputs, [parameter for _, parameter in found])

    def restore(
        self,
        coordinates: Sequence[Coordinate],
        inputs: Sequence[Input],
        parameters: Sequence[Parameter],
    ) -> LagrangianSystem:
        """The system with some of its terms: those that have their parameter among those given.

        Args:
            coordinates: of the records.
            inputs: of the records.
            parameters: the inertia of each coordinate, and what other terms there are.
        """
        axes, acting = tuple(coordinates), tuple(inputs)
        of = _functions(axes, acting)
        return LagrangianSystem(
            NAME, axes, acting, tuple(parameters), of["kinetic"], of["potential"],
            of["dissipation"], of["input_map"],
        )  # fmt: skip


MECHANISM = Mechanism()


def _sizes(signals: Sequence[np.ndarray]) -> list[float]:
    """The root mean square of each column, over all records."""
    return [float(x) for x in root_mean_square(np.concatenate(signals))]


def _either(rank: int, name: str, unit: str, most: float, **known: Any) -> Term:
    """A term that may be missing, and may have either sign."""
    return rank, Parameter(name, unit, 0.0, -most, most, optional=True, **known)


def _tied(rank: int, name: str) -> Term:
    """One that is 1 between rigid links, if it is there; minus 1 where an axis is turned round."""
    return _either(rank, name, "1", _SHARES, prior=1.0, usual=(1.0, -1.0))


def _inertias(coordinates: Sequence[Coordinate]) -> list[Term]:
    """Inertias as shares: the first is the unit, so forces are accelerations."""
    found: list[Term] = []
    for i, c in enumerate(coordinates):
        unit = {"rad": "kg m^2", "m": "kg"}.get(c.unit, f"J s^2/{c.unit}^2")
        found.append((0, Parameter(f"{c.name}.inertia", unit, 1.0, *_RATIOS, fixed=i == 0)))
        found += [
            _either(wave.rank, f"{c.name}.inertia_{wave.name}", "1", _SHARES, prior=_SHARE)
            for wave in _of_inertia(coordinates, i)
        ]
        found += [
            _tied(1 + (k < i), f"{c.name}.inertia_across_{other.name}")
            for k, other in enumerate(coordinates)
            if k != i and other.kind == "angular"
        ]
        for j in range(i + 1, len(coordinates)):
            pair = _pair(c, coordinates[j])
            if _both_turn(coordinates, i, j):
                along = f"{c.name}.inertia_along_{coordinates[j].name}"
                found += [_tied(0, pair), _tied(0, along)]
            else:
                found.append(_either(0, pair, "1", _SHARES, prior=_SHARE))
            found += [
                _either(wave.rank, f"{pair}_{wave.name}", "1", _SHARES, prior=_SHARE)
                for wave in _of_coupling(coordinates, i, j)
            ]
    return found


def _heights(coordinates: Sequence[Coordinate], most: Sequence[float]) -> list[Term]:
    """Gravity on angles, and on the sums of neighbours: links on links."""
    return [
        _either(wave.rank, f"{coordinates[k].name}.gravity_{wave.name}", "1/s^2", most[k])
        for k, wave in _of_gravity(coordinates)
    ]


def _springs(of: Coordinate, most: float, size: float) -> list[Term]:
    """A constant force, a spring with all that it brings, and one that differs by sides."""
    brings = tuple(f"{law}:{of.name}" for law in _CABLE)
    return [
        _either(1, f"{of.name}.pull", f"{of.unit}/s^2", most),
        _either(0, f"{of.name}.spring", "1/s^2", most / size, brings=brings),
        _either(2, f"{of.name}.quadratic", f"1/(s^2 {of.unit})", most / size**2),
    ]


def _pair(a: Coordinate, b: Coordinate) -> str:
    return f"{a.name}.coupling_{b.name}"


def _both(name: str, angle: Callable[[Any], Any], rank: int) -> list[Wave]:
    """Cosine and sine of an angle; a sine is for angles that are not counted from an axis."""
    return [
        Wave(name.format("cos"), lambda q: jnp.cos(angle(q)), rank),
        Wave(name.format("sin"), lambda q: jnp.sin(angle(q)), rank + 1),
    ]


def _waves(coordinates: Sequence[Coordinate], k: int) -> list[Wave]:
    """Those of an angle."""
    if coordinates[k].kind != "angular":
        return []
    return _both(f"{{}}_{coordinates[k].name}", lambda q: q[k], 0)


def _both_turn(coordinates: Sequence[Coordinate], i: int, j: int) -> bool:
    return coordinates[i].kind == coordinates[j].kind == "angular"


def _of_inertia(coordinates: Sequence[Coordinate], i: int) -> list[Wave]:
    """What the inertia of a coordinate may depend on by itself: all other angles.

    Those before it are special: coordinates are mostly listed from the base to the tip. That an
    inertia depends on an angle and none couples them is special, too.
    """
    angular = [k for k, c in enumerate(coordinates) if c.kind == "angular" and k != i]
    each = [
        (k, wave)
        for k in angular
        for wave in (
            *_waves(coordinates, k),
            Wave(f"sin_2{coordinates[k].name}", lambda q, k=k: jnp.sin(2 * q[k]), 1),
        )
    ]
    return [wave._replace(rank=wave.rank + 1 + (k < i)) for k, wave in each]


def _of_coupling(coordinates: Sequence[Coordinate], i: int, j: int) -> list[Wave]:
    """What the inertia that couples two coordinates may depend on: angles, and their difference."""
    found = [
        wave._replace(rank=wave.rank + (k != j))
        for k in range(len(coordinates))
        for wave in _waves(coordinates, k)
    ]
    if _both_turn(coordinates, i, j):
        found += _both("{}_difference", lambda q: q[i] - q[j], 1)
    return found


def _of_gravity(coordinates: Sequence[Coordinate]) -> list[tuple[int, Wave]]:
    """Heights: whose link rises, and how, by its angle or by its and the angle before."""
    angular = [k for k, c in enumerate(coordinates) if c.kind == "angular"]
    alone = [(k, wave) for k in angular for wave in _both("{}", lambda q, k=k: q[k], 0)]
    return alone + [
        (k, wave)
        for before, k in pairwise(angular)
        for wave in _both("{}_sum", lambda q, a=before, b=k: q[a] + q[b], 1)
    ]


def _kinetic(coordinates: tuple[Coordinate, ...]) -> Callable[..., Any]:
    """The kinetic energy: inertias that depend on the angles."""
    names = [c.name for c in coordinates]
    n = len(names)

    def share(begin: str, waves: Sequence[Wave], q: Coordinates, p: Values) -> Any:
        each = ((f"{begin}_{wave.name}", wave) for wave in waves)
        return sum(p[name] * wave.of(q) for name, wave in each if name in p)

    def own(i: int, q: Coordinates, p: Values) -> Any:
        inertia = p[f"{names[i]}.inertia"]
        total = inertia * (1.0 + share(f"{names[i]}.inertia", _of_inertia(coordinates, i), q, p))
        for k in range(n):
            if (across := f"{names[i]}.inertia_across_{names[k]}") in p:
                total = total + p[f"{names[k]}.inertia"] * p[across] * jnp.sin(q[k]) ** 2
        return total

    def coupled(i: int, j: int, q: Coordinates, v: Coordinates, p: Values) -> Any:
        first, second = p[f"{names[i]}.inertia"], p[f"{names[j]}.inertia"]
        pair, mean = _pair(coordinates[i], coordinates[j]), jnp.sqrt(first * second)
        steady = second if _both_turn(coordinates, i, j) else mean
        both = steady * p.get(pair, 0.0)
        both = both + mean * share(pair, _of_coupling(coordinates, i, j), q, p)
        along = p.get(f"{names[i]}.inertia_along_{names[j]}", 0.0)
        bent = mean * share(pair, _waves(coordinates, j), q, p)
        return both * v[i] * v[j] + along * bent * v[i] ** 2

    def kinetic(q: Coordinates, v: Coordinates, p: Values) -> Scalar:
        total = jnp.zeros((), v.dtype)
        for i in range(n):
            total = total + 0.5 * own(i, q, p) * v[i] ** 2
            for j in range(i + 1, n):
                total = total + coupled(i, j, q, v, p)
        return total

    return kinetic


@lru_cache(maxsize=64)  # so that equal systems serve the same compiled programs
def _functions(
    coordinates: tuple[Coordinate, ...], inputs: tuple[Input, ...]
) -> dict[str, Callable[..., Any]]:
    """Energies and forces; they have the terms whose parameters they are given."""
    names = [c.name for c in coordinates]

    def potential(q: Coordinates, p: Values) -> Scalar:
        """Gravity and springs."""
        total = jnp.zeros((), q.dtype)
        for k, wave in _of_gravity(coordinates):
            if (of := f"{names[k]}.gravity_{wave.name}") in p:
                total = total + p[f"{names[k]}.inertia"] * p[of] * wave.of(q)
        for k, c in enumerate(names):
            powers = enumerate(_POWERS, 1)
            held = sum(p.get(f"{c}.{name}", 0.0) * q[k] ** m / m for m, name in powers)
            total = total + p[f"{c}.inertia"] * held
        return total

    def dissipation(q: Coordinates, v: Coordinates, p: Values) -> Coordinates:
        """Viscous friction; the voltage that a motor induces acts alike."""
        return jnp.stack(
            [p[f"{c}.inertia"] * p[f"{c}.viscous"] * v[k] for k, c in enumerate(names)]
        )

    def input_map(q: Coordinates, v: Coordinates, u: InputVector, p: Values) -> Coordinates:
        """Every input at every coordinate."""
        each = [
            sum((p.get(f"{c}.by_{i.name}", 0.0) * u[m] for m, i in enumerate(inputs)), 0.0 * v[k])
            for k, c in enumerate(names)
        ]
        return jnp.stack([p[f"{c}.inertia"] * a for c, a in zip(names, each, strict=True)])

    return {
        "kinetic": _kinetic(coordinates), "potential": potential, "dissipation": dissipation,
        "input_map": input_map,
    }  # fmt: skip
