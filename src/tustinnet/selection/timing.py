"""Holds and delays of inputs, found once for all candidates by the cheapest model that can tell.

They are properties of the records, not of a model: what an input does between two samples, and
the time from a logged sample to its effect. A system that is given, or a mechanism, is identified
from some of the records, with every hold, and with the delay as a parameter.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tustinnet.channels import Hold, Input
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import error_message
from tustinnet.fitting.listener import SILENT
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import Identification
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.shooting.identify import UnfinishedSearchError, identify_task
from tustinnet.fitting.task import Fold, Member, Task, resolve_system
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sensors import delay_name
from tustinnet.selection.deadline import NEVER, Deadline
from tustinnet.systems.files import AnySystem, SystemTemplate, load_system_or_template

_RECORDS, _SAMPLES = 6, 10_000  # that are enough to tell a delay
_LENGTH = 50  # samples of a piece
_BETTER = 0.95  # times the error of the usual timing: less is another timing, more is chance
_SURE = 3.0  # standard errors of a delay that is none
_SHORTEST = 0.1  # of a period, a delay that matters
_USUAL: Hold = "zero-order"


@dataclass(frozen=True)
class Timing:
    """Records whose inputs have holds and delays, and what was found out about them.

    Attributes:
        data: the records.
        sentences: what was found, with the evidence.
    """

    data: DataSet
    sentences: tuple[str, ...] = ()


def determine_timing(
    data: DataSet,
    system: AnySystem | None = None,
    deadline: Deadline = NEVER,
    on_message: Callable[[str], None] = lambda sentence: None,
) -> Timing:
    """Finds the holds that the data card does not declare, and the delay where it declares none.

    A hold other than `zero-order`, and a delay, are taken only where they lower the simulation
    error by a twentieth, a delay only where it is three standard errors long.

    Args:
        data: the records.
        system: the system that is given, or None for a mechanism.
        deadline: when it has to end; what is not known by then is as usual.
        on_message: called with what is being done.
    """
    declared = _holds_of(system)
    sentences = _list_conflicts(declared, data.channels.inputs)
    inputs = [i if i.hold else replace(i, hold=declared.get(i.name)) for i in data.channels.inputs]
    open_holds = [k for k, i in enumerate(inputs) if i.hold in (None, "unknown")]
    open_delays = [k for k, i in enumerate(inputs) if not i.delay]
    timing = [
        replace(i, hold=_USUAL if k in open_holds else i.hold, delay=i.delay or 0.0)
        for k, i in enumerate(inputs)
    ]
    if not open_holds and not open_delays:
        return Timing(data, tuple(sentences))
    by = "a mechanism" if system is None else "the system"
    records, unit = _choose_records(data), data.channels.unit
    # short pieces: there a delay of a period shows most, and nothing runs away; positions alone,
    # as smoothed velocities would say another delay
    changes = (
        "search.refine=none",
        "search.loss=position",
        f"search.horizon={_LENGTH * records[0].dt}",
    )
    recipe = read_recipe("mechanism" if system is None else "best-grey", changes)
    loaded = resolve_system(recipe, system)

    def identify(inputs: Sequence[Input]) -> Identification:
        roles = Roles(tuple(_with_inputs(e, inputs) for e in records), ())
        task = Task(recipe, (Fold(roles),), (Member(),), loaded)
        fit = identify_task(task, Member(), SILENT, deadline.has_passed)
        if fit.identification is None or fit.is_out_of_time:
            raise UnfinishedSearchError("holds and delays", "no time was left", "more time")
        return fit.identification

    try:
        _require_applicable(loaded, records)
        on_message(f"holds and delays of inputs: searched for by {by}")
        undelayed: Identification | None = None
        if open_holds:
            undelayed = identify(
                [replace(i, hold="unknown") if k in open_holds else i for k, i in enumerate(timing)]
            )
            errors = undelayed.hold_errors
            ranked = sorted(errors, key=lambda hold: errors[hold])
            is_clear = errors[ranked[0]] < _BETTER * errors[_USUAL]
            hold = ranked[0] if is_clear else _USUAL
            timing = [replace(i, hold=hold) if k in open_holds else i for k, i in enumerate(timing)]
            listed = ", ".join(f"{hold} {errors[hold]:.3g}" for hold in ranked)
            names = " and ".join(f"'{inputs[k].name}'" for k in open_holds)
            why = "" if hold == ranked[0] else " as usual, as no other is clearly better"
            sentences.append(f"hold of {names}: {hold}{why}; simulation errors [{unit}]: {listed}")
            if hold != ranked[0]:
                undelayed = None  # it is of another hold
        if open_delays:
            before = (undelayed or identify(timing)).rmse
            delayed = identify(
                [replace(i, delay=None) if k in open_delays else i for k, i in enumerate(timing)]
            )
            ratio = float(np.median([delayed.rmse[name] / before[name] for name in before]))
            estimates = {e.name: e for e in delayed.estimates}
            for k in open_delays:
                name, dt = inputs[k].name, float(records[0].dt)
                delay = estimates[delay_name(inputs[k])]
                # a delay that nothing says anything about has no error
                least = max(_SURE * (delay.error or np.inf), _SHORTEST * dt)
                if ratio < _BETTER and not delay.bound and abs(delay.value) > least:
                    timing[k] = replace(timing[k], delay=delay.value)
                    sentences.append(
                        f"delay of '{name}': {delay.value:.3g} ± {delay.error:.1g} s "
                        f"({delay.value / dt:.2g} periods); the simulation error is {ratio:.2g} "
                        "times that without"
                    )
                elif inputs[k].delay is None:
                    sentences.append(f"delay of '{name}': none that makes a clear difference")
    except Exception as error:  # of any kind: candidates are tried with what is known
        if any(i.hold == "unknown" or i.delay is None for i in inputs):
            out_of_time = isinstance(error, UnfinishedSearchError)
            why = "no time was left to search for them" if out_of_time else error_message(error)
            sentences.append(
                f"holds and delays of inputs: {why}; {_USUAL} and no delay taken where they are "
                "not known"
            )
    experiments = tuple(_with_inputs(e, timing) for e in data)
    return Timing(replace(data, experiments=experiments), tuple(sentences))


def _holds_of(system: AnySystem | None) -> dict[str, Hold | None]:
    """The holds that a system declares, by input."""
    loaded = None if system is None else load_system_or_template(system)
    return {i.name: i.hold for i in getattr(loaded, "inputs", ())}


def _require_applicable(
    system: LagrangianSystem | SystemTemplate | None, records: Sequence[Experiment]
) -> None:
    """Raises where a template makes no system of records, before time is spent."""
    if isinstance(system, SystemTemplate):
        system.for_records(records)


def _list_conflicts(declared: Mapping[str, Hold | None], inputs: Sequence[Input]) -> list[str]:
    """Sentences on holds that a system declares otherwise than the records."""
    unknown = (None, "unknown")
    return [
        f"hold of '{i.name}': {i.hold} as in the data card, not {declared[i.name]} as in the system"
        for i in inputs
        if i.hold not in unknown and declared.get(i.name) not in (*unknown, i.hold)
    ]


def _choose_records(data: DataSet) -> list[Experiment]:
    """Some records spread over all, cut so that they do not take long."""
    records = [e for e in data if e.split != "test"]
    chosen = [records[i] for i in np.unique(np.linspace(0, len(records) - 1, _RECORDS).astype(int))]
    most = _SAMPLES // len(chosen)
    return [e[:most] for e in chosen]


def _with_inputs(experiment: Experiment, inputs: Sequence[Input]) -> Experiment:
    channels = replace(experiment.channels, inputs=tuple(inputs))
    return replace(experiment, channels=channels)
