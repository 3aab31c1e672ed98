"""Euler-Lagrange models: a system's equations of motion with identified parameters.

The equations themselves are in `models.lagrangian`. A file keeps the system's name and the
values, never its code; what its code computes at fixed states is compared when it is loaded.
"""

import inspect
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from pydantic import Field

from tustinnet.channels import Channels
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.errors import InputError
from tustinnet.families.descriptions import Description, Entries
from tustinnet.families.family import (
    Arrays,
    Header,
    IdentifiedFamily,
    IdentifiedHyper,
    Lines,
    describe_part,
    restore_part,
)
from tustinnet.models.added import parse_forces, with_forces
from tustinnet.models.closed_loop import with_controller
from tustinnet.models.contract import Model
from tustinnet.models.integrate import Discretised, discretise
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Parameter
from tustinnet.models.sensors import with_sensor_errors
from tustinnet.models.sizes import MOST_SUBSTEPS
from tustinnet.registry import SYSTEMS
from tustinnet.simulate.recent import keep_latest
from tustinnet.systems.files import SystemTemplate
from tustinnet.systems.loading import load_system
from tustinnet.systems.robot_options import RobotOptions

_VALUES = "values"  # the name of the array of the parameters' values
_PROBED = "probed"  # the name of the array of derivatives at the probes
_PROBES = 16
_REACH = {"q": 2.0, "v": 3.0, "z": 0.5, "u": 3.0}  # how far from 0 the probes are, SI units
_TOLERANCE = {True: 1e-6, False: 1e-3}  # relative, in double and in single precision
_DRAWS = 200  # of values for each that is to lie within the ranges


class EulerLagrangeHyper(IdentifiedHyper):
    """The table `[model]` of a system whose parameters are identified."""


class SystemEntries(Entries):
    """The system of a grey box: its name, and the name of the file that defines it.

    `call` is the line of a Python file that loads a robot's file with options.
    """

    name: str
    file: str
    call: str = ""


# the first fields of `Parameter`
ParameterRow = tuple[str, str, float, float, float, bool]
RowWithPrior = tuple[str, str, float, float, float, bool, float]


class EulerLagrangeDescription(Description):
    """The header of a grey box: its parameters by name, and what was added to its system."""

    system: SystemEntries
    parameters: list[str]
    substeps: int = Field(gt=0, le=MOST_SUBSTEPS)
    terms: list[ParameterRow] = Field(default_factory=list)
    forces: list[str] = Field(default_factory=list)
    of_forces: list[ParameterRow | RowWithPrior] = Field(default_factory=list)
    sensors: list[ParameterRow] = Field(default_factory=list)
    gains: list[ParameterRow] = Field(default_factory=list)
    per: dict[str, str] = Field(default_factory=dict)
    groups: dict[str, list[str]] = Field(default_factory=dict)


class EulerLagrangeFamily(IdentifiedFamily):
    """The family of identified systems."""

    kind = "euler-lagrange"
    title = "Euler-Lagrange"
    hyper = EulerLagrangeHyper
    description = EulerLagrangeDescription
    correctable = True
    has_feedback = True
    model = LagrangianModel

    def describe(self, model: Discretised) -> tuple[Header, Arrays]:
        """The system's name, its parameters, and what its equations give at fixed states."""
        equations = self.equations(model)
        closed_loop, system = equations.system, equations.system.plant
        # the value that a parameter has for a record's group is one of those of all groups
        by_record = {p.name for p in system.grouped if p.by_group(equations.values)}
        names = sorted(set(equations.values) - by_record)
        header: Header = {
            "system": _describe_system(system),
            "parameters": names,
            "substeps": model.substeps,
        }
        if _made_for_records(system.name):
            others = {*system.added_parameters, *system.sensors}
            terms = [name for name in system.nominal() if name not in others]
            header["terms"] = _describe_parameters(system, terms)
        if system.added:
            header["forces"] = list(system.added)
            header["of_forces"] = [
                [*row, prior] if (prior := system.parameter(row[0]).prior) else row
                for row in _describe_parameters(system, system.added_parameters)
            ]
        if system.sensors:
            header["sensors"] = _describe_parameters(system, system.sensors)
        if closed_loop.feedback is not None:
            own = system.nominal()
            gains = [name for name in closed_loop.nominal() if name not in own]
            header["gains"] = _describe_parameters(closed_loop, gains)
        if groups := equations.groups:
            header["per"] = {p.name: p.per for p in system.grouped}
            header["groups"] = {name: list(values) for name, values in groups.items()}
        values = np.array([float(equations.values[name]) for name in names])
        return header, {_VALUES: values, _PROBED: _compute_probes(equations)}

    def restore(self, header: Header, arrays: Arrays, system: Any, where: Path) -> Discretised:
        """The model of the packaged system, or of the one given, with the file's values."""
        name = header["system"]["name"]
        if system is None and name not in SYSTEMS:
            problem = f"a model of the system '{name}', which the package does not have"
            raise _other_system_error(where, problem, header)
        channels = Channels.from_header(header)
        if system is None and (made := _made_for_records(name)):
            terms = [Parameter(*fields) for fields in header["terms"]]
            loaded = made.restore(channels.coordinates, channels.inputs, terms)
        else:
            plant = channels.plant
            loaded = load_system(name if system is None else system).plant
            loaded = loaded.for_channels(plant.coordinates, plant.inputs, where)
        if loaded.name != name:
            raise InputError(
                where, f"the system '{loaded.name}'", f"'{name}', which the model is of"
            )
        loaded = loaded.without([n for n in loaded.optional if n not in header["parameters"]])
        force_parameters = (Parameter(*fields) for fields in header.get("of_forces", ()))
        loaded = with_forces(loaded, tuple(header.get("forces", ())), tuple(force_parameters))
        sensors = (Parameter(*fields) for fields in header.get("sensors", ()))
        loaded = with_sensor_errors(loaded, tuple(sensors))
        loaded = with_controller(
            loaded, channels, tuple(Parameter(*fields) for fields in header.get("gains", ()))
        )
        # one by one: JAX compiles a program to take an array apart
        values = dict(zip(header["parameters"], map(jnp.asarray, arrays[_VALUES]), strict=True))
        model = loaded.model(values)
        expected = [
            name
            for p in loaded.parameters
            for name in ([p.for_group(group).name for group in p.by_group(values)] or [p.name])
        ]
        per = {p.name: p.per for p in loaded.grouped} if model.groups else {}
        if sorted(expected) != header["parameters"] or per != header.get("per", {}):
            others = [f"'{n}'" for n in header["parameters"] if n not in expected][:3]
            problem = f"parameters that the system does not have {', '.join(others)}".rstrip()
            raise _other_system_error(where, problem, header)
        _require_same(model, arrays[_PROBED], where)
        return discretise(model, header["dt"], header["substeps"], inputs=channels.inputs)

    def summarise(self, header: Header, arrays: Arrays) -> Lines:
        """System and values."""
        system = header["system"]
        name = f"{system['name']} ({system['file']})" if system["file"] else system["name"]
        values = dict(zip(header["parameters"], arrays[_VALUES].tolist(), strict=True))
        forces = header.get("forces", ())
        return [
            ("system", f"{name}, {header['substeps']} Runge-Kutta steps a period"),
            *([("added forces", ", ".join(forces))] if forces else []),
            ("values", ", ".join(f"{name} {value:.4g}" for name, value in values.items())),
        ]

    def with_initial_values(
        self, hyper: EulerLagrangeHyper, origin: Model, system: LagrangianSystem | None
    ) -> EulerLagrangeHyper:
        """The table with the forces of the origin, and with its values to begin with."""
        self.require_own(origin)
        equations = self.equations(cast(Discretised, origin))
        own = system.parameters if system is not None else ()
        names = {p.name for p in own if p.per is None} | set(hyper.free)
        # forces that a term brings are not there yet when a search begins
        brought = {force for p in own for force in p.brings}
        added = parse_forces(equations.system, hyper.forces)
        kept = [] if system is None else [*equations.system.added]
        more = [name for name in kept if name not in {*map(str, added), *brought}]
        every = (*added, *parse_forces(equations.system, more))
        names |= {name for force in every for name in force.parameter_names}
        begin = {name: float(x) for name, x in equations.values.items() if name in names}
        return hyper.model_copy(update={"begin": begin, "forces": (*hyper.forces, *more)})

    def equations(self, model: Discretised) -> LagrangianModel:
        """The equations of motion that the model integrates."""
        return cast(LagrangianModel, model.continuous)

    def alternatives(self, model: Discretised, header: Header) -> Sequence[Model]:
        """Models with parameters drawn from their errors, within their ranges.

        They are drawn around the values of the model, which may be those of a second fit.
        """
        # twelve sets of parameters are drawn from their errors
        drawn = draw_values(model, header, 12)
        equations = self.equations(model)
        return [
            replace(
                model,
                continuous=LagrangianModel(
                    equations.system,
                    equations.values | {name: jnp.asarray(value) for name, value in values.items()},
                ),
            )
            for values in drawn
        ]


FAMILY = EulerLagrangeFamily()


def draw_values(
    model: Model, header: Mapping[str, Any], count: int, seed: int = 0
) -> list[dict[str, float]]:
    """Parameters drawn from the errors of their identification, within their ranges.

    They are drawn around the values of the model, which may be those of a second fit.

    Args:
        model: the model.
        header: the header of its file.
        count: how many sets to draw.
        seed: of the draw.

    Returns:
        The sets, by name; none of another family's model, or of one whose file has no errors.
    """
    identification = header.get("identification")
    if not FAMILY.owns(model) or identification is None or not identification["estimates"]:
        return []
    estimates, correlation = identification["estimates"], identification["correlation"]
    errors, lower, upper = (
        np.array([estimate[key] for estimate in estimates], float)  # None becomes NaN
        for key in ("error", "lower", "upper")
    )
    errors = np.nan_to_num(errors)
    covariance = np.nan_to_num(np.array(correlation, float)) * np.outer(errors, errors)
    current = FAMILY.equations(cast(Discretised, model)).values
    values = [
        float(current[estimate["name"]]) if estimate["name"] in current else estimate["value"]
        for estimate in estimates
    ]
    drawn = np.random.default_rng(seed).multivariate_normal(
        values, covariance, _DRAWS * count, check_valid="ignore"
    )
    # a delay, for instance, is no parameter of the equations
    columns = [i for i, estimate in enumerate(estimates) if estimate["name"] in current]
    names, drawn = [estimates[i]["name"] for i in columns], drawn[:, columns]
    # to cut off one value alone would part it from those that are correlated with it
    inside = np.clip(drawn, lower[columns], upper[columns])
    is_inside = (inside == drawn).all(axis=1)
    drawn = inside[np.argsort(~is_inside, kind="stable")[:count]]
    return [dict(zip(names, row.tolist(), strict=True)) for row in drawn]


def _made_for_records(name: str) -> SystemTemplate | None:
    """The maker of the packaged system of a name, where it is made for records."""
    if name not in SYSTEMS:
        return None
    system = SYSTEMS[name]
    return system if isinstance(system, SystemTemplate) else None


def without_ranges(model: Discretised) -> Discretised:
    """The model of a system that was made for records, without what follows from these alone.

    Ranges of parameters that are found already say nothing. Without them models of several folds
    are of one system: what one compiles, as a network that corrects it, serves all of them.
    """
    header, arrays = describe_part(model, "")
    if "terms" not in header:
        return model
    for key in {"terms", "of_forces", "sensors"} & header.keys():
        header[key] = [[name, unit, 0.0, 0.0, 0.0, True] for name, unit, *_ in header[key]]
    return restore_part(header, arrays, "", None, Path())


def _describe_parameters(system: LagrangianSystem, names: Iterable[str]) -> list[list[Any]]:
    """The parameters that were added to a system, as a file keeps them."""
    parameters = [system.parameter(name) for name in names]
    return [[p.name, p.unit, p.nominal, p.lower, p.upper, p.fixed] for p in parameters]


def _describe_system(system: LagrangianSystem) -> dict[str, str]:
    """The entries of a system in a header, see `SystemEntries`."""
    entries, source = {"name": system.name, "file": _file_name(system)}, system.source
    has_options = source and source.call() != RobotOptions().call(source.path.name, {})
    return entries | ({"call": source.call()} if source and has_options else {})


def _other_system_error(where: Path, problem: str, header: Header) -> InputError:
    """The error of a model that needs another system than the one given, or one at all."""
    system = header["system"]
    file, call = system["file"] or "FILE.py", system.get("call")
    expected = f"a Python file with {call}" if call else f"its file ({file})"
    remedy = f"add `system=` {'FILE.py' if call else file}"
    return InputError(
        where, problem, expected, f"{remedy} (in Python: load_model(path, system=...))"
    )


def _file_name(system: LagrangianSystem) -> str:
    """The name of the file that a system is written in, empty where it is in none."""
    if system.source is not None:
        return system.source.path.name
    try:
        return Path(inspect.getsourcefile(inspect.unwrap(system.kinetic)) or "").name
    except TypeError:
        return ""


@keep_latest(1)  # a fit saves its model twice, without scores and with them
def _compute_probes(model: LagrangianModel) -> Float[np.ndarray, "probes n_x"]:
    """The derivatives at states that are the same for every model of the same size.

    Of values by group those of each group's first value count.
    """
    model = model.for_groups({name: values[0] for name, values in model.groups.items()}, "probes")
    channels, generator = model.channels, np.random.default_rng(0)
    sizes = {"q": channels.n_q, "v": channels.n_q, "z": len(model.internal), "u": channels.n_u}
    drawn = {k: _REACH[k] * generator.uniform(-1, 1, (_PROBES, n)) for k, n in sizes.items()}
    points = np.concatenate([drawn["q"], drawn["v"], drawn["z"], drawn["u"]], axis=1)
    n_x, has_initial = points.shape[1] - channels.n_u, model.system.states.has_initial

    def probe(point: Array) -> Array:
        parts = [model.derivative(point[:n_x], point[n_x:])]
        if has_initial:
            parts.append(model.initial_internal(point[channels.measured], point[n_x:]))
        return jnp.concatenate(parts)

    where = f"system '{model.system.name}'"
    return evaluate(Formula(probe, points.shape[1], where=where), points)


def _require_same(model: LagrangianModel, stored: np.ndarray, where: Path) -> None:
    """Raises unless the system computes what it did when the model was identified."""
    now = _compute_probes(model)
    if now.shape != stored.shape:
        raise InputError(
            where,
            f"the system '{model.system.name}' has changed since the model was identified: "
            "its coordinates or internal states are others, or begin otherwise",
            "the system as it was",
            "identify it again, or give the file as it was then with `system=` FILE.py",
        )
    both = np.isfinite(stored) & np.isfinite(now)
    unit = np.max(np.abs(stored), axis=0, where=np.isfinite(stored), initial=1e-12)
    off = np.where(both, np.abs(now - stored) / unit, np.isfinite(stored) != np.isfinite(now))
    worst = int(np.argmax(off.max(axis=0)))
    if off.max() > _TOLERANCE[bool(jax.config.read("jax_enable_x64"))]:
        coordinates = [c.name for c in model.channels.coordinates]
        internal = [*model.internal, *(f"{z} at a record's beginning" for z in model.internal)]
        names = [*coordinates, *coordinates, *internal]
        raise InputError(
            where,
            f"the system '{model.system.name}' has changed since the model was identified: "
            f"'{names[worst]}' moves otherwise by {100 * off.max():.2g} %",
            "the equations of motion as they were",
            "identify it again, or give the file as it was then with `system=` FILE.py",
        )
