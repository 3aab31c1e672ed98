"""Holds and delays of inputs, found before anything is fitted by the cheapest model that can tell.

They are properties of the records, not of a model: what an input does between two samples, and
the time from a logged sample to its effect. A system that is given, or a mechanism, is identified
from some of the records, with every hold, and with the delay as a parameter. A slow actuator looks
like a delay: where one is found, a first-order lag in its place is compared with it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from tustinnet.channels import Hold, Input
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import error_message
from tustinnet.fitting.listener import SILENT
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.fitting.report import Estimate, Identification
from tustinnet.fitting.roles import Roles, records_without_test
from tustinnet.fitting.shooting.holds import describe_hold_errors
from tustinnet.fitting.shooting.identify import UnfinishedSearchError, identify_task
from tustinnet.fitting.shooting.levenberg_marquardt import ShouldStopSearch, never_stop_search
from tustinnet.fitting.task import Fold, Member, Task, resolve_system
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.sensors import delay_name
from tustinnet.systems.files import AnySystem, SystemTemplate
from tustinnet.systems.loading import load_system_or_template

_RECORDS, _SAMPLES = 6, 10_000  # that are enough to tell a delay
_LENGTH = 50  # samples of a piece
_BETTER = 0.95  # times the error of the usual timing: less is another timing, more is chance
_SURE = 3.0  # standard errors of a delay that is none
_SHORTEST = 0.1  # of a period, a delay that matters
_LAG = 2 / 3  # times the error with a delay: less is a lag, more may be its additional freedom
_USUAL: Hold = "zero-order"
LAG = "lag"  # the force by name that is the lag of an actuator


@dataclass(frozen=True)
class Timing:
    """Records whose inputs have holds and delays, and what was found out about them.

    Attributes:
        data: the records.
        sentences: what was found, with the evidence.
        lags: names of the inputs whose actuators lag, where a delay is no explanation.
    """

    data: DataSet
    sentences: tuple[str, ...] = ()
    lags: tuple[str, ...] = ()


def determine_timing(
    data: DataSet,
    system: AnySystem | None = None,
    should_stop: ShouldStopSearch = never_stop_search,
    on_message: Callable[[str], None] = lambda sentence: None,
) -> Timing:
    """Finds the holds that the data card does not declare, and the delay where it declares none.

    A hold other than `zero-order`, and a delay, are taken only where they lower the simulation
    error by a twentieth, a delay only where it is three standard errors long. Where a first-order
    lag of the actuator in its place lowers the error by another third, no delay is taken.

    Args:
        data: the records.
        system: the system that is given, or None for a mechanism.
        should_stop: asked often: whether it ends; what is not known by then is as usual.
        on_message: called with what is being done.
    """
    declared = _holds_of(system)
    sentences = _list_conflicts(declared, data.channels.inputs)
    inputs = [i if i.hold else replace(i, hold=declared.get(i.name)) for i in data.channels.inputs]
    open_holds = [k for k, i in enumerate(inputs) if i.hold in (None, "unknown")]
    open_delays = [k for k, i in enumerate(inputs) if not (i.delay or i.is_delay_declared)]
    timing = [
        replace(i, hold=_USUAL if k in open_holds else i.hold, delay=i.delay or 0.0)
        for k, i in enumerate(inputs)
    ]
    if not open_holds and not open_delays:
        return Timing(data, tuple(sentences))
    search = _make_search(data, system, should_stop)
    lags: list[str] = []
    try:
        _require_applicable(search)
        by = "a mechanism" if system is None else "the system"
        on_message(f"holds and delays of inputs: searched for by {by}")
        undelayed: Identification | None = None
        if open_holds:
            hold, undelayed, sentence = _find_hold(search, timing, open_holds)
            timing = [replace(i, hold=hold) if k in open_holds else i for k, i in enumerate(timing)]
            sentences.append(sentence)
        if open_delays:
            before = undelayed or search.identify(timing)
            explanations = _explain_lateness(search, timing, open_delays, before)
            for k, (delay, sentence) in explanations.items():
                sentences.append(sentence)
                if delay is None:
                    lags.append(inputs[k].name)
                else:
                    timing[k] = replace(timing[k], delay=delay)
            sentences += [
                f"delay of '{inputs[k].name}': none that makes a clear difference"
                for k in open_delays
                if inputs[k].delay is None and k not in explanations
            ]
    except Exception as error:  # of any kind: candidates are tried with what is known
        if any(i.hold == "unknown" or i.delay is None for i in inputs):
            out_of_time = isinstance(error, UnfinishedSearchError)
            why = "no time was left to search for them" if out_of_time else error_message(error)
            sentences.append(
                f"holds and delays of inputs: {why}; {_USUAL} and no delay taken where they are "
                "not known"
            )
    experiments = tuple(_with_inputs(e, timing) for e in data)
    return Timing(replace(data, experiments=experiments), tuple(sentences), tuple(lags))


@dataclass(frozen=True)
class _TimingSearch:
    """Identifications of some records, with inputs that act in one way or another.

    Attributes:
        records: the records.
        recipe: the recipe.
        system: the system that is identified.
        should_stop: asked often: whether the last one ends.
    """

    records: Sequence[Experiment]
    recipe: Recipe
    system: LagrangianSystem | SystemTemplate | None
    should_stop: ShouldStopSearch

    def identify(self, inputs: Sequence[Input], forces: Sequence[str] = ()) -> Identification:
        """The system identified with inputs in the place of the records' own, and added forces.

        Raises:
            UnfinishedSearchError: no time was left.
        """
        roles = Roles(tuple(_with_inputs(e, inputs) for e in self.records), ())
        added = {"forces": (*getattr(self.recipe.model, "forces", ()), *forces)}
        model = self.recipe.model.model_copy(update=added)
        recipe = self.recipe.model_copy(update={"model": model})
        task = Task(recipe, (Fold(roles),), (Member(),), self.system)
        # an identification asks for the time only when it has compiled its programs
        is_late = self.should_stop()
        fit = (
            None
            if is_late
            else identify_task(task, Member(), SILENT, self.should_stop, checks_signs=False)
        )
        if fit is None or fit.identification is None or fit.is_out_of_time:
            raise UnfinishedSearchError("holds and delays", "no time was left", "more time")
        return fit.identification


def _make_search(
    data: DataSet, system: AnySystem | None, should_stop: ShouldStopSearch
) -> _TimingSearch:
    """Makes the search for the timing of records by a system, or by a mechanism."""
    records = _choose_records(data)
    # short pieces: there a delay of a period shows most, and nothing runs away; positions alone,
    # as smoothed velocities would say another delay
    changes = (
        "search.refine=none",
        "search.loss=position",
        f"search.horizon={_LENGTH * records[0].dt}",
    )
    recipe = read_recipe("mechanism" if system is None else "best-grey", changes)
    return _TimingSearch(records, recipe, resolve_system(recipe, system), should_stop)


def _find_hold(
    search: _TimingSearch, timing: Sequence[Input], places: Sequence[int]
) -> tuple[Hold, Identification | None, str]:
    """The hold of the inputs at some places, what was identified with it, and the evidence.

    Another hold than the usual one has to be clearly better. Where the usual one is taken though it
    is not the best, nothing was identified with it.
    """
    identification = search.identify(
        [replace(i, hold="unknown") if k in places else i for k, i in enumerate(timing)]
    )
    errors = identification.hold_errors
    ranked = cast("list[Hold]", sorted(errors, key=lambda hold: errors[hold]))
    hold: Hold = ranked[0] if errors[ranked[0]] < _BETTER * errors[_USUAL] else _USUAL
    is_best = hold == ranked[0]
    names = " and ".join(f"'{timing[k].name}'" for k in places)
    why = "" if is_best else " as usual, as no other is clearly better"
    channels = search.records[0].channels
    listed = f"[{channels.unit}]: " + ", ".join(f"{hold} {errors[hold]:.3g}" for hold in ranked)
    if len(channels.units) > 1:
        listed = describe_hold_errors(errors, channels)
    sentence = f"hold of {names}: {hold}{why}; simulation errors {listed}"
    return hold, identification if is_best else None, sentence


def _explain_lateness(
    search: _TimingSearch,
    timing: Sequence[Input],
    places: Sequence[int],
    undelayed: Identification,
) -> dict[int, tuple[float | None, str]]:
    """The inputs that act late, by their place: the delay, None of a lag, and the evidence.

    Args:
        search: the search.
        timing: the inputs, with their holds.
        places: those whose delay is not known.
        undelayed: what was identified without delays.
    """

    def compare(identification: Identification) -> float:
        """Error of a typical record by that without delays."""
        before, rmse = undelayed.rmse, identification.rmse
        return float(np.median([rmse[name] / before[name] for name in before]))

    delayed = search.identify(
        [replace(i, delay=None) if k in places else i for k, i in enumerate(timing)]
    )
    ratio, dt = compare(delayed), float(search.records[0].dt)
    delays = {k: _estimate(delayed, delay_name(timing[k])) for k in places}

    def is_clear(delay: Estimate) -> bool:
        # a delay that nothing says anything about has no error
        least = max(_SURE * (delay.error or np.inf), _SHORTEST * dt)
        return not delay.bound and abs(delay.value) > least

    clear = {k: delay for k, delay in delays.items() if is_clear(delay)}
    if not clear or ratio >= _BETTER:
        return {}
    try:
        lagging = search.identify(timing, [f"{LAG}:{timing[k].name}" for k in clear])
    except Exception:  # of any kind: the delay stands
        lagging, lag_ratio = None, np.inf
    else:
        lag_ratio = compare(lagging)
    # with a lag each piece begins with an internal state of its own
    is_lag = lag_ratio < _LAG * ratio
    explanations: dict[int, tuple[float | None, str]] = {}
    for k, delay in clear.items():
        name = timing[k].name
        duration = f"{delay.value:.3g} ± {delay.error:.1g} s ({delay.value / dt:.2g} periods)"
        if lagging is not None and is_lag:
            lag = _estimate(lagging, f"{name}.{LAG}")
            error = "" if lag.error is None else f" ± {lag.error:.1g}"
            sentence = (
                f"lag of '{name}': first order with a time constant of {lag.value:.3g}{error} s, "
                f"and no delay; the simulation error is {lag_ratio:.2g} times that without, with a "
                f"delay of {duration} instead {ratio:.2g} times (the force `{LAG}` adds it to "
                "equations of motion)"
            )
            explanations[k] = None, sentence
            continue
        instead = f", with a lag instead {lag_ratio:.2g} times" if np.isfinite(lag_ratio) else ""
        sentence = (
            f"delay of '{name}': {duration}; the simulation error is {ratio:.2g} times that without"
            f"{instead}"
        )
        explanations[k] = delay.value, sentence
    return explanations


def _estimate(identification: Identification, name: str) -> Estimate:
    """The estimate of a parameter."""
    return next(e for e in identification.estimates if e.name == name)


def _holds_of(system: AnySystem | None) -> dict[str, Hold | None]:
    """The holds that a system declares, by input."""
    loaded = None if system is None else load_system_or_template(system)
    return {i.name: i.hold for i in getattr(loaded, "inputs", ())}


def _require_applicable(search: _TimingSearch) -> None:
    """Raises where a template makes no system of records, before time is spent."""
    if isinstance(search.system, SystemTemplate):
        search.system.for_records(search.records)


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
    records = records_without_test(data)
    chosen = [records[i] for i in np.unique(np.linspace(0, len(records) - 1, _RECORDS).astype(int))]
    most = _SAMPLES // len(chosen)
    return [e[:most] for e in chosen]


def _with_inputs(experiment: Experiment, inputs: Sequence[Input]) -> Experiment:
    channels = replace(experiment.channels, inputs=tuple(inputs))
    return replace(experiment, channels=channels)
