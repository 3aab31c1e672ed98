"""The verb: the best model that records allow, from a plan and a budget."""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.data.inspection import coordinate_timescales
from tustinnet.errors import InputError
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.task import resolve_system
from tustinnet.selection.calibration import calibrated_on_folds
from tustinnet.selection.choice import Choice
from tustinnet.selection.clock import Clock
from tustinnet.selection.ending import Found, final_models, judge_averages
from tustinnet.selection.executors import Executor, InProcess
from tustinnet.selection.halving import NO_TIME, Halving
from tustinnet.selection.jobs import SCORES, SPENT, Job, Judging, Workplace
from tustinnet.selection.plan import USUAL, Candidate, SelectionPlan, read_plan
from tustinnet.selection.ranking import Standing
from tustinnet.selection.records import for_folds
from tustinnet.simulate.starts import start_named
from tustinnet.store.files import owned, remove_below, require_outputs, to_json, write_into
from tustinnet.store.kept_system import CANDIDATES, keep, require_room
from tustinnet.store.model_file import save
from tustinnet.store.question import Question, data_of, require_same, write_question
from tustinnet.store.run import FIGURES, MODEL, REPORT, SUMMARY, WRITTEN, Earlier, Tell
from tustinnet.systems.files import AnySystem

_TENTH = 0.1  # of a record, a horizon where no fit chose one
_STARTS = 3  # a horizon is at least as many times as long as what a start is fitted to
_ENDING = 0.12  # share of the budget for committees, the last fit and bands
_FILES = 0.08  # and for figures and the report, which come after the selection
_FEWEST_FILES = 6.0  # s, what these take at least
_SHORT = 0.2  # but no more than this share of a short budget
TABLE = "candidates.md"  # written by rooms above this one


@dataclass(frozen=True)
class Asked:
    """What a selection is asked.

    Attributes:
        plan: a packaged plan's name, a TOML file, or a plan.
        system: the system that candidates of a system identify, or None.
        budget: how long it may take [s], None for no limit.
        since: from when on it counts, a `time.monotonic()`; None for the call of `select_model`.
    """

    plan: str | Path | SelectionPlan = USUAL
    system: AnySystem | None = None
    budget: float | None = None
    since: float | None = None


@dataclass(frozen=True)
class Reporter:
    """Who is told while a selection goes on.

    Attributes:
        say: of what happens, in sentences.
        tell: given a job, what `perform` tells of its fit.
    """

    say: Callable[[str], None] = lambda sentence: None
    tell: Callable[[Job], Tell] = lambda job: lambda prepared: Listener()


def select_model(
    data: DataSet,
    folder: str | Path,
    asked: Asked | None = None,
    earlier: Earlier = "refuse",
    reporter: Reporter | None = None,
    executor: Callable[[Workplace], Executor] | None = None,
) -> Choice:
    """Tries the candidates of a plan on folds of records, and makes the best one into one model.

    Candidates are compared by successive halving; committees of those that are left are tried
    last. Where the chosen family has weights, the model is a committee of the models of all folds.
    Where it has parameters, they are identified once more from all records.

    Args:
        data: the records; those of the split `test` take part in nothing.
        folder: where models, tables and logs are written.
        asked: the plan, the system, the budget; by default the usual plan, no system, no limit.
        earlier: what to do with a selection that is in the folder: `refuse`, `resume` (jobs that
            are done are kept) or `discard`.
        reporter: functions that are called while it goes on; by default nobody is told.
        executor: where the jobs are done, as `cluster` gives it; by default in this process.

    Returns:
        The model, the table of candidates, and sentences on what was chosen and why.

    Raises:
        InputError: a plan that does not fit, a selection to be resumed that was asked otherwise,
            records too few or too short, a budget in which no candidate was fitted, or none that
            could be.
    """
    wanted, told = asked or Asked(), reporter or Reporter()
    begun = time.monotonic() if wanted.since is None else wanted.since
    plan, where = read_plan(wanted.plan), Path(folder)
    records, cut = for_folds(data)
    candidates, lacking = _taking_part(plan, wanted, records)
    notes = (*([cut] if cut else []), *lacking)
    judging = Judging(min(plan.folds, len(records)), plan.start, plan.horizon)
    clock, ending = _clocks(wanted.budget, begun)
    at = Workplace(where, records, judging, wanted.system, clock, earlier == "resume")
    at.run_system_file()
    for note in notes:
        told.say(note)
    with owned(where):
        _make_room(at, earlier, _question(plan, at))
        do = executor or (lambda at: InProcess(at, told.tell))
        halving = Halving(plan, candidates, at, told.say)
        left = halving.run(do(at))
        if halving.hopeless:
            at, note = _over_a_horizon(at, halving)
            told.say(note)
            notes, halving = (*notes, note), Halving(plan, candidates, at, told.say)
            left = halving.run(do(at))
        if not left:
            raise _nothing(halving, wanted.budget)
        choice = _choose(halving, left, replace(at, clock=ending), told)
        spent = time.monotonic() - begun
        choice = replace(choice, notes=notes, seconds=spent, budget=wanted.budget)
        write_into(where, SUMMARY, to_json(choice.as_plain()))
    return choice


def _clocks(budget: float | None, begun: float) -> tuple[Clock, Clock]:
    """When time is up for the rounds, and for all that comes before figures and report."""
    if budget is None:
        return Clock(), Clock()
    files = max(_FILES * budget, min(_FEWEST_FILES, _SHORT * budget))
    end = begun + budget - files
    return Clock(end - _ENDING * budget), Clock(end)


def _over_a_horizon(at: Workplace, halving: Halving) -> tuple[Workplace, str]:
    """Judges over the shortest horizon that a fit chose, or a tenth of a record; and says so."""
    chosen = [m.horizon for s in halving.standings.values() for m in s.models if m.horizon]
    usual = _TENTH * float(np.median([len(e) for e in at.data])) * at.data.channels.dt
    fewest = _STARTS * start_named(at.judging.start).samples * at.data.channels.dt
    horizon = max(min(chosen, default=usual), fewest)
    note = (
        "free runs of whole records were further off than the records move: judged over pieces "
        f"of {horizon:.3g} s instead, each from a start of its own (`horizon` in a plan)"
    )
    return replace(at, judging=replace(at.judging, horizon=horizon), resume=False), note


def _choose(halving: Halving, left: Sequence[Standing], at: Workplace, told: Reporter) -> Choice:
    """Judges committees of what is left, and writes the models."""
    averages = judge_averages(halving.plan, left, at, told.say)
    names = tuple(s.name for s in left)
    found = Found(halving.plan, tuple(halving.standings.values()), names, averages)
    models, best, plain = final_models(found, at, told.tell)
    made = {name: of.words for name, of in models.items()}
    bands = calibrated_on_folds(found, best, models[best], at)
    choice = Choice(at, found, best, plain, made, models[best].model, bands)
    for name, of in models.items():
        save(of.model, at.folder / CANDIDATES / name / MODEL, **choice.header(name, of))
    save(choice.model, at.folder / MODEL, **choice.header(best, models[best]))
    return choice


def _taking_part(
    plan: SelectionPlan, asked: Asked, records: DataSet
) -> tuple[list[Candidate], list[str]]:
    """The candidates for which everything is given, and sentences on those for which not."""
    if asked.budget is not None and not 0 < asked.budget < math.inf:
        raise InputError("--budget", f"{asked.budget:g} s", "a time above 0")
    if asked.system is not None and not any(_identifies(c) for c in plan.candidates):
        raise InputError("--system", f"means nothing to the plan '{plan.name}'",
                         "a plan with a candidate that identifies a system")  # fmt: skip
    fast = any(scales.is_fast for scales in coordinate_timescales(list(records)).values())
    other = "slow" if fast else "fast"
    lacking: dict[str, str] = {}
    for c in plan.candidates:
        if c.when == other:
            lacking[c.name] = f"only for {other} records"
        elif c.when == "no-system" and asked.system is not None:
            lacking[c.name] = "only without a system"
        elif _identifies(c) and (asked.system or resolve_system(c.content, None)) is None:
            lacking[c.name] = "for want of a system (--system)"
        elif c.corrects and lacking.keys() >= set(c.corrects):
            lacking[c.name] = lacking[c.corrects[0]]
    found = [c for c in plan.candidates if c.name not in lacking]
    why = {reason: [n for n, of in lacking.items() if of == reason] for reason in lacking.values()}
    told = [f"left out, {reason}: {', '.join(names)}" for reason, names in why.items()]
    if not found:
        raise InputError(f"plan '{plan.name}'", "; ".join(told), "a candidate that can take part")
    return found, told


def _identifies(candidate: Candidate) -> bool:
    return "system" in candidate.content.family.needs


def _question(plan: SelectionPlan, at: Workplace) -> Question:
    """What a selection is asked; how long it may take is not part of it."""
    candidates = [
        {**c.model_dump(mode="json", exclude={"set"}), "recipe": c.content.model_dump(mode="json")}
        for c in plan.candidates
    ]
    file, system = at.system_file, at.loaded_system
    named = None if system is None else system.name
    return {
        "plan": {**plan.model_dump(mode="json"), "candidates": candidates},
        "data": data_of(list(at.data)),
        "system": named if file is None else file.sha256,
    }


def _make_room(at: Workplace, earlier: Earlier, question: Question) -> None:
    """Refuses, discards or leaves what is there, and keeps the question and the system's file."""
    scores = sorted((at.folder / CANDIDATES).glob(f"*/*/{SCORES}"))
    if earlier == "resume":
        require_same(at.folder, question, MODEL)
    if earlier == "discard":
        _discard(at.folder)
    if earlier == "refuse" and scores:
        raise InputError(
            at.folder, f"holds an earlier selection ({scores[0].parent.parent.name}, ...)",
            "a new folder",
            "add --resume to go on with it, --overwrite to discard it, or choose another --out",
        )  # fmt: skip
    if earlier != "discard":
        require_room(at.system_file, at.folder)
    files = [at.folder / name for name in (MODEL, SUMMARY, REPORT)]
    drawn = [at.folder / name for name in (FIGURES, TABLE)]
    require_outputs([*files, *drawn], overwrite=earlier != "refuse")
    for path in files:
        path.unlink(missing_ok=True)
    write_question(at.folder, question)
    if at.system_file is not None:
        keep(at.system_file, at.folder)


def _discard(folder: Path) -> None:
    """Removes what an earlier selection wrote, and nothing else."""
    remove_below(folder / CANDIDATES, {*WRITTEN, SCORES})
    try:
        told = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        starts = [of for c in told["candidates"] for of in c.get("starts", {}).values()]
        records = {record for of in starts for record in of["rmse"]}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return  # nobody knows which figures are its own
    drawn = {f"{name}.png" for name in (CANDIDATES, *records)}
    remove_below(folder / FIGURES, drawn)


def _nothing(halving: Halving, budget: float | None) -> InputError:
    """What to say where no candidate was fitted."""
    short = halving.cheapest
    if short is not None and short.needs is not None:
        needed = max(short.needs / (1 - _ENDING - _FILES), 1.2 * (budget or 0.0))
        return InputError(
            "--budget", f"{budget:g} s: no candidate was fitted in it",
            f"the cheapest, {short.candidate}, needs about {needed:.0f} s",
            "what was begun stays: add --resume to go on",
        )  # fmt: skip
    reasons: dict[str, list[str]] = {}
    for s in halving.standings.values():
        if s.why:
            reasons.setdefault(s.why, []).append(s.name)
    why = "; ".join(f"{', '.join(names)}: {reason}" for reason, names in reasons.items())
    short_of_time = reasons.keys() & {SPENT, NO_TIME}
    return InputError(
        "selection", f"no candidate could be fitted ({why})", "one that can",
        "give more time: --budget" if short_of_time else "",
    )  # fmt: skip
