"""Variants of a model: plants that its records allow as well, and wear of the machine."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np

from tustinnet.control.plants import ModelPlant
from tustinnet.control.sampled_plant import USUAL, PlantOptions, SampledPlant
from tustinnet.control.stepped_model import SteppedModel
from tustinnet.families.euler_lagrange import FAMILY as EULER_LAGRANGE
from tustinnet.families.euler_lagrange import draw_values
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem
from tustinnet.models.parameters import Parameter
from tustinnet.models.physical_values import equations_in, with_equations
from tustinnet.simulate.filtering import FilterNoise

FRICTION = "friction factor"  # the parameter that multiplies all dissipation
_MOST_FRICTION = 2.0  # times that of the model
_HEAVIER = 0.2  # share by which masses and inertias grow at most
NOMINAL = "nominal"
_MASS = "kg"  # how units of masses and inertias begin


@dataclass(frozen=True)
class VariantKind:
    """Plants that differ from the model in one way.

    Attributes:
        name: its name.
        help: in which way, for tables.
        plants: the plants, drawn at random, one for each start.
        allowed: whether the records allow these plants as well as the model.
    """

    name: str
    help: str
    plants: tuple[SampledPlant, ...]
    allowed: bool = False


def make_variants(
    model: Model,
    noise: FilterNoise,
    header: Mapping[str, Any] | None = None,
    *,
    count: int = 20,
    seed: int = 0,
    options: PlantOptions = USUAL,
    candidates: Sequence[Model] = (),
    has_records: bool = False,
) -> tuple[VariantKind, ...]:
    """Plants that differ from a model in what it does not know, kind by kind.

    * `nominal`: the model through its encoders.
    * `parameters`: its parameters drawn from the errors of their identification.
    * `moved 10 %`, `moved 20 %`: all parameters changed at random by up to so much.
    * `members`: the members of a committee, in turn.
    * `candidates`: other models of the same records, in turn.
    * `friction`: all dissipation up to twice as large.
    * `heavier`: masses and inertias up to 20 % larger.
    * `delay 1`, `delay 2`: inputs act so many samples later.
    * `noise`: noise of one count on the encoders.
    * `disturbance`: velocities change by what the model misses in a step.

    Parameters and forces belong to equations of motion: a network without physics has kinds of
    the other names only, a model without known errors no `parameters`.

    Args:
        model: the model, with the values of one group.
        noise: the noise of its filter, of which encoders and disturbances follow.
        header: the header of its file, with the errors of its parameters.
        count: plants of each kind.
        seed: of all draws.
        options: of encoders and inputs of all plants. Where neither these nor the model have counts
            of the encoders, the filter's noise is taken for their rounding.
        candidates: other models of the same records, which have equations of motion.
        has_records: whether the noise was found by records, which allow its disturbances then.
    """
    generator = np.random.default_rng(seed)
    about = "the model through its encoders"
    if options.counts is None:
        rounding = np.sqrt(12) * np.asarray(noise.measured, np.float64)
        resolution = model.channels.resolution
        options = replace(options, counts=np.where(resolution > 0, resolution, rounding))
        if not resolution.all():  # of some encoder no count is known
            about = "the model, with rounding as the filter expects"
    counts = np.asarray(options.counts, np.float64)
    family = family_of(model)
    members = () if family is EULER_LAGRANGE else family.alternatives(model, dict(header or {}))
    stepped = SteppedModel(model)

    def plants(one: Callable[[int], SampledPlant]) -> tuple[SampledPlant, ...]:
        return tuple(one(i) for i in range(count))

    def same(changed: PlantOptions) -> tuple[SampledPlant, ...]:
        return plants(lambda i: ModelPlant(stepped, options=changed))

    def in_turn(models: Sequence[Model]) -> tuple[SampledPlant, ...]:
        several = [SteppedModel(one) for one in models]
        return plants(lambda i: ModelPlant(several[i % len(several)], options=options))

    kinds = [VariantKind(NOMINAL, about, same(options))]
    if len(members) > 1:
        about = "the members of the committee, in turn"
        kinds.append(VariantKind("members", about, in_turn(members), allowed=True))
    if candidates:
        about = "other candidates of its run, which have equations of motion"
        kinds.append(VariantKind("candidates", about, in_turn(candidates), allowed=True))
    physical = next((m for m in (model, *members) if equations_in(m) is not None), None)
    if physical is not None:
        kinds += _physical_kinds(physical, header or {}, count, generator, options)
    for delay in (1, 2):
        late = replace(options, delay=options.delay + delay)
        kinds.append(
            VariantKind(
                f"delay {delay}",
                "inputs act a sample later" if delay == 1 else f"inputs act {delay} samples later",
                same(late),
            )
        )
    noisy = replace(options, noise=np.hypot(np.asarray(options.noise, np.float64), counts))
    kinds.append(VariantKind("noise", "noise of one count on the encoders", same(noisy)))
    missed = np.asarray(noise.process, np.float64)[model.channels.velocity]
    disturbed = replace(options, disturbance=np.hypot(options.disturbance, missed))
    about = "velocities disturbed by what the model misses in a step"
    kinds.append(VariantKind("disturbance", about, same(disturbed), allowed=has_records))
    return tuple(kinds)


def _physical_kinds(
    model: Model,
    header: Mapping[str, Any],
    count: int,
    generator: np.random.Generator,
    options: PlantOptions,
) -> list[VariantKind]:
    """The kinds that change equations of motion: one machine code serves all."""
    stepped = SteppedModel(with_friction_factor(model))
    equations = equations_in(stepped.model)
    assert equations is not None

    def kind(name: str, help: str, values: Sequence[Mapping[str, float]]) -> VariantKind:
        return VariantKind(name, help, tuple(ModelPlant(stepped, v, options) for v in values))

    kinds = []
    if drawn := draw_values(model, header, count, int(generator.integers(2**31))):
        about = "parameters drawn from their errors"
        kinds.append(replace(kind("parameters", about, drawn), allowed=True))
    # shares by which parameters are moved at most
    for share in (0.1, 0.2):
        moved = [moved_values(stepped.nominal, share, generator) for _ in range(count)]
        percent = f"{100 * share:.0f} %"
        kinds.append(kind(f"moved {percent}", f"all parameters changed by up to {percent}", moved))
    if equations.system.dissipation is not None:
        rubbing = [{FRICTION: generator.uniform(1.0, _MOST_FRICTION)} for _ in range(count)]
        kinds.append(kind("friction", f"friction up to {_MOST_FRICTION:g} times", rubbing))
    masses = [
        p.name
        for p in equations.system.parameters
        if p.unit.startswith(_MASS) and p.name in stepped.nominal
    ]
    if masses:
        heavier = []
        for _ in range(count):
            factor = 1 + generator.uniform(0.0, _HEAVIER)
            heavier.append({name: factor * stepped.nominal[name] for name in masses})
        kinds.append(
            kind("heavier", f"masses and inertias up to {100 * _HEAVIER:.0f} % larger", heavier)
        )
    return kinds


def moved_values(
    values: Mapping[str, float], share: float, generator: np.random.Generator
) -> dict[str, float]:
    """Parameters that are each changed at random, by up to a share of their size.

    Args:
        values: the parameters by name; the factor of friction stays.
        share: the largest change, 0.1 for 10 %.
        generator: the source of the changes, which are uniform.
    """
    return {
        name: value * (1 + share * generator.uniform(-1.0, 1.0))
        for name, value in values.items()
        if name != FRICTION
    }


def with_friction_factor(model: Model) -> Model:
    """A model whose dissipation is multiplied by a further parameter, 1 to begin with.

    Forces of friction have no common parameter: what all have in common is that they are the
    system's dissipation.
    """
    equations = equations_in(model)
    if equations is None or equations.system.dissipation is None:
        return model
    values = equations.values | {FRICTION: jnp.asarray(1.0, jnp.float64)}
    return with_equations(model, LagrangianModel(_with_factor(equations.system), values))


@lru_cache(maxsize=16)
def _with_factor(system: LagrangianSystem) -> LagrangianSystem:
    dissipation = system.dissipation
    assert dissipation is not None
    factor = Parameter(FRICTION, "1", 1.0, 0.0, 10.0, fixed=True)
    return replace(
        system,
        parameters=(*system.parameters, factor),
        dissipation=lambda q, v, p: p[FRICTION] * jnp.asarray(dissipation(q, v, p)),
    )
