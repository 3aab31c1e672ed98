"""Holds and delays of inputs, taken from the records before anything is fitted.

They are properties of the records, not of a model: what an input does between two samples, and the
time from a logged sample to its effect. `signals.input_timing` finds them without a model.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tustinnet.channels import Hold, Input
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.finding import Finding, make_finding
from tustinnet.fitting.recipe import IdentificationRecipe, Recipe
from tustinnet.fitting.roles import records_without_test
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.signals.input_timing import (
    DeclaredTiming,
    InputTiming,
    estimate_input_timing,
)
from tustinnet.systems.files import AnySystem
from tustinnet.systems.loading import load_system_or_template

LAG = "lag"  # the force by name that is the lag of an actuator
_USUAL: Hold = "zero-order"


@dataclass(frozen=True)
class Timing:
    """Records whose inputs have holds and delays, and what was found out about them.

    Attributes:
        data: the records.
        findings: what was found, with its errors.
        lags: names of the inputs whose actuators lag, or may lag.
        delays: names of the inputs whose delays an identification refines: of those that act late,
            be it by a lag, which hides a short delay, and of those that the card calls unknown.
    """

    data: DataSet
    findings: tuple[Finding, ...] = ()
    lags: tuple[str, ...] = ()
    delays: tuple[str, ...] = ()


def determine_timing(data: DataSet, system: AnySystem | None = None) -> Timing:
    """Finds the holds and delays that the data card does not declare.

    Where records do not tell, an input is held from sample to sample and acts without delay. An
    actuator that lags has no delay: a model needs the force `lag`.

    Args:
        data: the records.
        system: the system that is given, whose declared holds count; None without one.
    """
    loaded = None if system is None else load_system_or_template(system)
    system_holds = {i.name: i.hold for i in getattr(loaded, "inputs", ())}
    lacks_lag = isinstance(loaded, LagrangianSystem) and loaded.memory is None
    findings = _list_conflicts(system_holds, data.channels.inputs)
    inputs = [
        i if i.hold else replace(i, hold=system_holds.get(i.name)) for i in data.channels.inputs
    ]
    declared = [_declared_timing(i) for i in inputs]
    is_asked = [k.hold is None or k.delay is None for k in declared]
    if not any(is_asked):
        return Timing(data, tuple(findings))
    try:
        estimates = _estimate(data, declared)
    except InputError as error:
        estimates = None
        if any(i.hold == "unknown" or i.delay is None for i in inputs):
            findings.append(make_finding("timing not found", why=str(error), hold=_USUAL))
    lags, delays, acting = list[str](), list[str](), list[Input]()
    for j, (own, what) in enumerate(zip(inputs, declared, strict=True)):
        one = estimates[j] if estimates else None
        delay = what.delay if one is None or what.delay is not None else _acting_delay(one)
        hold = what.hold or (one.hold if one else _USUAL)
        acting.append(replace(own, hold=hold, delay=delay or 0.0))
        has_delay, has_lag = (one is not None and word in one.verdict for word in ("delay", "lag"))
        if own.delay is None or (what.delay is None and (has_delay or has_lag)):
            delays.append(own.name)
        if one and is_asked[j]:
            findings.append(_describe(own.name, one, what, data[0].dt, advises_force=lacks_lag))
            if has_lag:
                lags.append(own.name)
    experiments = tuple(_with_inputs(e, acting) for e in data)
    data = replace(data, experiments=experiments)
    return Timing(data, tuple(findings), tuple(lags), tuple(delays))


def refine_delays(recipe: Recipe, inputs: Iterable[str]) -> Recipe:
    """The recipe in which the delays of some inputs are parameters; of an identification only.

    One that compares forces along the measured motion has no delays.
    """
    if not isinstance(recipe, IdentificationRecipe) or recipe.is_by_forces:
        return recipe
    return recipe.with_free(f"{name}.delay" for name in inputs)


def _declared_timing(own: Input) -> DeclaredTiming:
    hold = None if own.hold == "unknown" else own.hold
    return DeclaredTiming(hold, own.delay if own.delay or own.is_delay_declared else None)


def _estimate(data: DataSet, declared: Sequence[DeclaredTiming]) -> list[InputTiming]:
    """The times at which the inputs act.

    Raises:
        InputError: records that do not tell.
    """
    if data.channels.controller is not None:
        raise InputError("records", "a controller's set points for inputs", "inputs of the system")
    records = [e for e in records_without_test(data) if np.isclose(e.dt, data[0].dt)]
    angular = np.array([c.kind == "angular" for c in data.channels.coordinates])
    q, u = [e.q for e in records], [e.u for e in records]
    return estimate_input_timing(q, u, data[0].dt, angular, declared)


def _acting_delay(timing: InputTiming) -> float:
    """The delay with which records are fitted [s]."""
    return timing.delay.value if "delay" in timing.verdict else 0.0


def _describe(
    name: str, timing: InputTiming, declared: DeclaredTiming, dt: float, *, advises_force: bool
) -> Finding:
    """A sentence on the timing of an input, with the force for its lag where one is missing."""
    hold = timing.hold if declared.hold is None else None
    common = {"input": name, "hold": hold, "rivals": list(timing.rivals) if hold else []}
    if declared.delay is not None:
        return make_finding("timing declared", declared=declared.delay, **common)
    verdict = "hidden" if timing.verdict == "unclear" and timing.is_hidden else timing.verdict
    delay, lag = timing.delay, timing.lag
    return make_finding(
        f"timing {verdict}",
        **common,
        delay=delay.value,
        delay_error=delay.error,
        delay_periods=delay.value / dt,
        lead=-delay.value,
        lead_periods=-delay.value / dt,
        lag=lag.value,
        lag_error=lag.error,
        lag_periods=lag.value / dt,
        advises_force=advises_force,
    )


def _list_conflicts(declared: Mapping[str, Hold | None], inputs: Sequence[Input]) -> list[Finding]:
    """Holds that a system declares otherwise than the records."""
    unknown = (None, "unknown")
    return [
        make_finding("hold of card", input=i.name, hold=i.hold, of_system=declared[i.name])
        for i in inputs
        if i.hold not in unknown and declared.get(i.name) not in (*unknown, i.hold)
    ]


def _with_inputs(experiment: Experiment, inputs: Sequence[Input]) -> Experiment:
    channels = replace(experiment.channels, inputs=tuple(inputs))
    return replace(experiment, channels=channels)
