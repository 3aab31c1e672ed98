"""Euler-Lagrange models: a system's equations of motion with identified parameters.

The equations themselves are in `models.lagrangian`. A file keeps the system's name and the
values, never its code; what its code computes at fixed states is compared when it is loaded.
"""

import inspect
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field, field_validator

from tustinnet.channels import Channels
from tustinnet.engine.equations import Formula
from tustinnet.engine.runs import evaluate
from tustinnet.errors import InputError
from tustinnet.families.family import Arrays, Family, Header, Hyper
from tustinnet.families.shown import VALUES
from tustinnet.models.added import added_parameters, parse_forces, with_forces
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Parameter
from tustinnet.models.sensors import with_sensor_errors
from tustinnet.registry import SYSTEMS
from tustinnet.systems.files import SystemTemplate, load_system

_PROBED = "probed"  # an array: derivatives at the probes
_PROBES = 16
_REACH = {"q": 2.0, "v": 3.0, "z": 0.5, "u": 3.0}  # how far from 0 the probes are, SI units
_SAME = {True: 1e-6, False: 1e-3}  # relative, in double and in single precision


_DRAWN = 12  # sets of parameters that stand for their errors


class EulerLagrangeHyper(Hyper):
    """A system whose parameters are identified.

    Attributes:
        system: a packaged system by name, where none is given beside the recipe. Not a file: a
            recipe runs no code.
        fixed: parameters to hold, at a value or at their `nominal` one.
        begin: where the search for a parameter starts.
        free: what sensors and actuators may be off by, as parameters that are searched for:
            `CHANNEL.bias` and `CHANNEL.gain`.
        forces: forces of the library that are added, `LAW` at every coordinate or
            `LAW:COORDINATE`, see `models.added`.
    """

    system: str | None = None
    fixed: dict[str, float | Literal["nominal"]] = Field(default_factory=dict)
    begin: dict[str, float] = Field(default_factory=dict)
    free: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()

    @field_validator("fixed", "begin", mode="before")
    @classmethod
    def _named(cls, given: Any) -> Any:
        """`alpha.bias = 0.1` is a table in a table for TOML, and a parameter here."""
        if not isinstance(given, dict):
            return given
        tables = {name: of for name, of in given.items() if isinstance(of, dict)}
        flat = {f"{name}.{part}": x for name, of in tables.items() for part, x in of.items()}
        return {name: x for name, x in given.items() if name not in tables} | flat

    @field_validator("system")
    @classmethod
    def _known(cls, system: str | None) -> str | None:
        if system is not None and system not in SYSTEMS:
            known = ", ".join(SYSTEMS.names())
            raise ValueError(f"no system of that name; one of {known}, a file goes with --system")
        return system


class EulerLagrangeFamily(Family):
    """Identified systems."""

    kind = "euler-lagrange"
    spelt = "Euler-Lagrange"
    hyper = EulerLagrangeHyper
    trains = False
    needs = frozenset({"system"})
    correctable = True
    model = LagrangianModel

    def describe(self, model: Discretised) -> tuple[Header, Arrays]:
        """The system's name, its parameters, and what its equations give at fixed states."""
        continuous = model.continuous
        assert isinstance(continuous, LagrangianModel)
        system, names = continuous.system, _names(continuous)
        header: Header = {
            "system": {"name": system.name, "file": _file_of(system)},
            "parameters": names,
            "substeps": model.substeps,
        }
        if _made(system.name):
            others = {*added_parameters(system), *system.sensors}
            header["terms"] = _declared(system, [n for n in system.nominal() if n not in others])
        if system.added:
            header["forces"] = list(system.added)
            header["of_forces"] = _declared(system, added_parameters(system))
        if system.sensors:
            header["sensors"] = _declared(system, system.sensors)
        if known := continuous.groups:
            header["per"] = {p.name: p.per for p in system.grouped}
            header["groups"] = {name: list(of) for name, of in known.items()}
        values = np.array([float(continuous.values[name]) for name in names])
        return header, {VALUES: values, _PROBED: _probed(continuous)}

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Discretised:
        """The packaged system, or the one given, with the file's values."""
        belongs = header["system"]
        if system is None and belongs["name"] not in SYSTEMS:
            file = belongs["file"] or "FILE.py"
            raise InputError(
                where,
                f"a model of the system '{belongs['name']}', which the package does not have",
                f"its file ({file})",
                f"add --system {file} (in Python: load_model(path, system=...))",
            )
        found = _as_stored(header) if system is None else load_system(system)
        if found.name != belongs["name"]:
            raise InputError(
                where, f"the system '{found.name}'", f"'{belongs['name']}', which the model is of"
            )
        found = found.without([n for n in found.optional if n not in header["parameters"]])
        forces, of_forces, sensors = (
            header.get(key, ()) for key in ("forces", "of_forces", "sensors")
        )
        found = with_forces(found, tuple(forces), tuple(Parameter(*of) for of in of_forces))
        found = with_sensor_errors(found, tuple(Parameter(*of) for of in sensors))
        # one by one: JAX compiles a program to take an array apart
        values = dict(zip(header["parameters"], map(jnp.asarray, arrays[VALUES]), strict=True))
        model = found.model(values)
        expected = [
            name
            for p in found.parameters
            for name in ([p.for_group(of).name for of in p.by_group(values)] or [p.name])
        ]
        per = {p.name: p.per for p in found.grouped} if model.groups else {}
        if sorted(expected) != header["parameters"] or per != header.get("per", {}):
            raise InputError(
                where, "parameters that the system does not have", "those of the system"
            )
        _require_same(model, arrays.get(_PROBED), where)
        return discretise(
            model, header["dt"], header["substeps"], inputs=Channels.from_header(header).inputs
        )

    def beginning(
        self, hyper: EulerLagrangeHyper, origin: Model, system: LagrangianSystem
    ) -> EulerLagrangeHyper:
        """Every parameter that both systems have begins at its identified value."""
        self.require_own(origin)
        assert isinstance(origin, Discretised)
        continuous = origin.continuous
        assert isinstance(continuous, LagrangianModel)
        known = {p.name for p in system.parameters if p.per is None} | set(hyper.free)
        # forces that a term brings are not there yet when a search begins
        added = parse_forces(continuous.system, hyper.forces)
        known |= {name for force in added for name in force.parameter_names}
        begin = {n: float(x) for n, x in continuous.values.items() if n in known}
        return hyper.model_copy(update={"begin": begin})

    def parameters(self, model: Discretised) -> Sequence[tuple[str, str, float]]:
        """Those of the system; of values by group that of the group that was chosen."""
        continuous = model.continuous
        assert isinstance(continuous, LagrangianModel)
        values = continuous.values
        return [
            (p.name, p.unit, float(values[p.name]))
            for p in continuous.system.parameters
            if p.name in values
        ]

    def equations(self, model: Discretised) -> LagrangianModel:
        """All of it."""
        assert isinstance(model.continuous, LagrangianModel)
        return model.continuous

    def alternatives(self, model: Discretised, header: Header) -> Sequence[Model]:
        """The same equations with parameters drawn from their errors, within their ranges.

        Around the values of the model, which may be refined.
        """
        found = header.get("identification", {})
        estimates, correlation = found.get("estimates", ()), found.get("correlation")
        if correlation is None or not estimates:
            return ()
        each = [[of[key] for of in estimates] for key in ("error", "lower", "upper")]
        errors, lower, upper = (np.array(x, float) for x in each)  # None becomes NaN
        errors = np.nan_to_num(errors)
        shape = np.nan_to_num(np.array(correlation, float)) * np.outer(errors, errors)
        continuous = model.continuous
        assert isinstance(continuous, LagrangianModel)
        known = continuous.values
        values = [
            float(known[n]) if (n := of["name"]) in known else of["value"] for of in estimates
        ]
        drawn = np.random.default_rng(0).multivariate_normal(
            values, shape, _DRAWN, check_valid="ignore"
        )
        names = [of["name"] for of in estimates if of["name"] in known]
        if len(names) < len(estimates):  # as a delay, which is no parameter of the equations
            kept = np.array([of["name"] in known for of in estimates])
            drawn, lower, upper = drawn[:, kept], lower[kept], upper[kept]
        return [
            replace(model, continuous=LagrangianModel(
                continuous.system,
                known | dict(zip(names, map(jnp.asarray, of), strict=True)),
            ))
            for of in np.clip(drawn, lower, upper)
        ]  # fmt: skip


FAMILY = EulerLagrangeFamily()


def _made(name: str) -> SystemTemplate | None:
    """What makes the packaged system of a name, where it is made for records."""
    if name not in SYSTEMS:
        return None
    found = SYSTEMS[name]
    return found if isinstance(found, SystemTemplate) else None


def _as_stored(header: Header) -> LagrangianSystem:
    """The packaged system that a file names, one that is made for records as it was for these."""
    name = header["system"]["name"]
    made = _made(name)
    if made is None:
        return load_system(name)
    channels = Channels.from_header(header)
    terms = [Parameter(*of) for of in header["terms"]]
    return made.restore(channels.coordinates, channels.inputs, terms)


def _declared(system: LagrangianSystem, names: Iterable[str]) -> list[list[Any]]:
    """Parameters that were added to a system, as a file keeps them."""
    of = [system.parameter(name) for name in names]
    return [[p.name, p.unit, p.nominal, p.lower, p.upper, p.fixed] for p in of]


def _file_of(system: LagrangianSystem) -> str:
    """The name of the file that a system is written in, empty where it is in none."""
    try:
        return Path(inspect.getsourcefile(inspect.unwrap(system.kinetic)) or "").name
    except TypeError:
        return ""


def _names(model: LagrangianModel) -> list[str]:
    """The names of its values, without that of a group that a record took."""
    taken = {p.name for p in model.system.grouped if p.by_group(model.values)}
    return sorted(set(model.values) - taken)


def _probed(model: LagrangianModel) -> Float[np.ndarray, "probes n_x"]:
    """The derivatives at states that are the same for every model of the same size.

    Of values by group those of each group's first value.
    """
    model = model.for_groups({name: known[0] for name, known in model.groups.items()}, "probes")
    of, generator = model.channels, np.random.default_rng(0)
    sizes = {"q": of.n_q, "v": of.n_q, "z": len(model.internal), "u": of.n_u}
    drawn = {k: _REACH[k] * generator.uniform(-1, 1, (_PROBES, n)) for k, n in sizes.items()}
    x = np.concatenate([drawn["q"], drawn["v"], drawn["z"]], axis=1)
    n_x, memory = x.shape[1], model.system.memory
    begins = memory is not None and memory.initial is not None

    def at(point: Array) -> Array:
        parts = [model.derivative(point[:n_x], point[n_x:])]
        if begins:
            parts.append(model.initial_internal(point[of.measured]))
        return jnp.concatenate(parts)

    points = np.concatenate([x, drawn["u"]], axis=1)
    return evaluate(Formula(at, points.shape[1], where=f"system '{model.system.name}'"), points)


def _require_same(model: LagrangianModel, stored: np.ndarray | None, where: Path) -> None:
    """Raises unless the system computes what it did when the model was identified."""
    if stored is None:
        if model.system.name not in SYSTEMS:
            warnings.warn(
                f"{where}: written before model files kept what a system computes; that "
                f"'{model.system.name}' has not changed since could not be checked",
                stacklevel=2,
            )
        return
    now = _probed(model)
    if now.shape != stored.shape:
        raise InputError(
            where, f"the system '{model.system.name}' has changed since the model was identified: "
            "its coordinates or internal states are others, or begin otherwise",
            "the system as it was",
            "identify it again, or give the file as it was then with --system FILE.py",
        )  # fmt: skip
    both = np.isfinite(stored) & np.isfinite(now)
    unit = np.max(np.abs(stored), axis=0, where=np.isfinite(stored), initial=1e-12)
    off = np.where(both, np.abs(now - stored) / unit, np.isfinite(stored) != np.isfinite(now))
    worst = int(np.argmax(off.max(axis=0)))
    if off.max() > _SAME[bool(jax.config.read("jax_enable_x64"))]:
        of = model.channels
        names = [
            *(c.name for c in of.coordinates),
            *(c.name for c in of.coordinates),
            *model.internal,
            *(f"{name} at a record's beginning" for name in model.internal),
        ]
        raise InputError(
            where,
            f"the system '{model.system.name}' has changed since the model was identified: "
            f"'{names[worst]}' moves otherwise by {100 * off.max():.2g} %",
            "the equations of motion as they were",
            "identify it again, or give the file as it was then with --system FILE.py",
        )
