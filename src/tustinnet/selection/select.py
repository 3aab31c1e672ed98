"""Selection: tries a plan's candidates within a budget and writes the best model."""

import signal
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tustinnet.cores import OtherPrograms
from tustinnet.data.dataset import DataSet
from tustinnet.data.spoiled import SpoiledPart
from tustinnet.errors import InputError, error_message
from tustinnet.evaluate.reference import find_reference
from tustinnet.evaluate.spoiled import MISFIT, find_spoiled
from tustinnet.finding import Finding, make_finding
from tustinnet.fits.deadline import NEVER, OVER, Deadline, Stopwatch
from tustinnet.fits.preparation import PreparationOptions, prepare_records
from tustinnet.fitting.listener import SILENT, Listener
from tustinnet.fitting.roles import records_without_test
from tustinnet.models.contract import require_float64
from tustinnet.selection.applicability import adds_lag_alone, applicable_candidates, force_cutoff
from tustinnet.selection.calibration import calibrate_on_folds
from tustinnet.selection.choice import Choice
from tustinnet.selection.final_models import (
    FinalModel,
    SelectionResults,
    compare_whole_records,
    make_final_models,
)
from tustinnet.selection.folds import are_cut, prepare_for_folds
from tustinnet.selection.jobs import NO_STAGE, SPENT, JobResult, MakeListener, RunContext
from tustinnet.selection.plan import USUAL, SelectionPlan, read_plan
from tustinnet.selection.queue import NO_TIME, CandidateQueue
from tustinnet.selection.ranking import CandidateResult, find_simplest, rank
from tustinnet.selection.runner import Workplace, run_jobs
from tustinnet.selection.scoring import Scorer
from tustinnet.simulate.horizon import effective_horizon
from tustinnet.store.files import lock_folder, require_outputs, to_json, write_into
from tustinnet.store.kept_system import CANDIDATES, require_copy_fits, write_system_copy
from tustinnet.store.model_file import save
from tustinnet.store.run_folder import (
    FIGURES,
    MODEL,
    REPORT,
    SCORES,
    SUMMARY,
    TABLE,
    Earlier,
    discard_results,
)
from tustinnet.store.specification import (
    SPECIFICATION,
    Specification,
    record_digests,
    require_same_specification,
    write_specification,
)
from tustinnet.systems.files import AnySystem

USUAL_BUDGET = 240.0  # s, a report five minutes after a folder of logs; costs little accuracy
_ENDING = 0.07  # share of the budget for the last fit and bands
_LONGEST_ENDING = 60.0  # s
_FILES = 0.03  # share of the budget for figures and the report, which come after the selection
_LONGEST_FILES = 20.0  # s
_FEWEST_FILES = 5.0  # s, what these take at least
_SHORT = 0.2  # but no more than this share of a short budget
_BUSY = 0.3  # of the processors, what others may use without being mentioned


@dataclass(frozen=True)
class SelectionOptions:
    """Plan, system and budget of a selection.

    Attributes:
        plan: a packaged plan's name, a TOML file, or a plan.
        system: the system that candidates of a system identify, or None.
        budget: how long it may take [s], None for no limit.
        since: from when on it counts, a `time.monotonic()`; None for the call of `select_model`.
        leave_out_spoiled: whether parts of records that spoil fits are left out of everything.
    """

    plan: str | Path | SelectionPlan = USUAL
    system: AnySystem | None = None
    budget: float | None = None
    since: float | None = None
    leave_out_spoiled: bool = False


@dataclass(frozen=True)
class Reporter:
    """Functions that are called while a selection goes on.

    Attributes:
        on_message: with sentences on what happens.
        make_listener: given a job, the listener of its fit.
    """

    on_message: Callable[[str], None] = lambda sentence: None
    make_listener: MakeListener = lambda job: SILENT

    def report(self, findings: Iterable[Finding]) -> None:
        """Calls `on_message` with each finding."""
        for finding in findings:
            self.on_message(finding.text)


def select_model(
    data: DataSet,
    folder: str | Path,
    options: SelectionOptions | None = None,
    earlier: Earlier = "refuse",
    reporter: Reporter | None = None,
    executor: Executor | None = None,
) -> Choice:
    """Tries the candidates of a plan on folds of records, and makes the best one into one model.

    Candidates are tried in one queue, what could change the ranking soonest first. From the first
    candidate on there is a result: Ctrl-C once ends with the best so far, twice at once. Where the
    chosen family has weights, the model is the average of the models of all folds. Where it has
    parameters, they are identified once more from all records.

    Args:
        data: the records; those of the split `test` take part in nothing.
        folder: where models, tables and logs are written.
        options: the plan, the system, the budget; by default the usual plan, no system, no limit.
        earlier: what to do with a selection that is in the folder: `refuse`, `resume` (jobs that
            are done are kept) or `discard`.
        reporter: functions that are called while it goes on; by default nothing is reported.
        executor: where the jobs are done: an executor of `concurrent.futures` whose workers share
            the folder, or what `cluster` gives; by default this process.

    Returns:
        The model, the table of candidates, and findings on what was chosen and why.

    Raises:
        InputError: a plan that does not fit, a selection to be resumed that had other options,
            records too few or too short, columns that forces along the records show to be
            mistaken, a budget in which no candidate was fitted, or none that could be.
    """
    require_float64("select_model")
    options, reporter = options or SelectionOptions(), reporter or Reporter()
    started = time.monotonic() if options.since is None else options.since
    stopwatch, others = Stopwatch(started), OtherPrograms()
    plan, folder, budget = read_plan(options.plan), Path(folder), options.budget
    candidates_end = models_end = NEVER  # for candidates, and for all before figures
    ending = 0.0
    if budget is not None:
        files = max(_FILES * budget, min(_FEWEST_FILES, _SHORT * budget))
        files, ending = min(files, _LONGEST_FILES), min(_ENDING * budget, _LONGEST_ENDING)
        models_end = Deadline(started + budget - files)
        candidates_end = Deadline(started + budget - files - ending)
    # what cannot be done is said before time is spent
    records, before = prepare_for_folds(data)
    is_cut = any(finding.code == "cut into pieces" for finding in before) or are_cut([*records])
    horizon = effective_horizon(plan.horizon, list(records))
    context = RunContext(
        records,
        Scorer(min(plan.folds, len(records)), plan.start, horizon),
        folder,
        system=options.system,
        resume=earlier == "resume",
    )
    candidates, omitted = applicable_candidates(plan, context, budget)
    if earlier == "refuse":
        _require_no_earlier(folder)
    if plan.horizon is not None and horizon is None:
        before.append(make_finding("records shorter than horizon", horizon=plan.horizon))
    if records.channels.controller is not None:
        before.append(make_finding("judged in loop"))
    before += omitted
    reporter.report(before)
    specification = _make_specification(plan, context)
    stopwatch.end("records")
    prepared = prepare_records(
        data,
        PreparationOptions(
            system=context.loaded_system,
            leaves_out_spoiled=options.leave_out_spoiled,
            selection_budget=budget,
            listener=Listener(on_message=reporter.on_message),
            on_step=stopwatch.end,
        ),
    )
    reporter.report(prepared.findings)
    promising = [c.name for c in candidates if prepared.lags and adds_lag_alone(c)]
    context = context.with_changes(data=prepare_for_folds(prepared.data)[0], delays=prepared.delays)
    folds = min(context.scoring.folds, len(context.data))
    context = context.with_changes(
        scoring=replace(context.scoring, folds=folds), cutoff=force_cutoff(context, candidates)
    )
    notes = (*prepared.findings, *before)
    with lock_folder(folder):
        _prepare_folder(context, earlier, specification)
        queue = CandidateQueue(
            plan, candidates, context, reporter.on_message, candidates_end, ending, promising
        )
        workplace = Workplace(executor, reporter.make_listener, reporter.on_message)

        def take(result: JobResult) -> None:
            queue.add(result)
            _require_right_columns(result, data.name)

        is_interrupted = False
        try:
            run_jobs(queue.choose, take, lambda: queue.context, workplace)
        except KeyboardInterrupt as stop:
            _require_result(queue, stop, reporter)
            is_interrupted = True
        queue.judge_by_pieces_if_lost()
        if not queue.remaining():
            raise _nothing_fitted(queue)
        stopwatch.end("candidates")
        try:
            end = OVER if is_interrupted else models_end
            choice = _choose(queue, reporter, end, prepared.left_out, stopwatch)
        except KeyboardInterrupt as stop:
            if is_interrupted:
                raise
            _require_result(queue, stop, reporter)
            is_interrupted = True
            choice = _choose(queue, reporter, OVER, prepared.left_out, stopwatch)
        notes = (*notes, *queue.notes, *([make_finding("interrupted")] if is_interrupted else []))
        if budget is not None and (share := others.share) > _BUSY:
            longer = budget / (1 - share)
            busy = make_finding("processors shared", share=share, longer=longer, budget=budget)
            reporter.on_message(busy.text)
            notes = (*notes, busy)
        choice = replace(
            choice,
            notes=notes,
            seconds=sum(stopwatch.seconds.values()),
            seconds_by_part=stopwatch.seconds,
            budget=budget,
            is_cut=is_cut,
        )
        write_into(folder, SUMMARY, to_json(choice.as_plain()))
    return choice


def _require_right_columns(result: JobResult, name: str) -> None:
    """Ends a selection on columns that are mistaken, as the forces along the records show.

    Whatever else is tried would be fitted to them as well.

    Args:
        result: the result of a job.
        name: the name of the data.
    """
    for fit in result.scores:
        if fit.column_mistakes:
            raise InputError(
                f"data '{name}'",
                "; ".join(fit.column_mistakes),
                "columns whose forces the system explains",
                "or try recipes that compare no forces (`plan=`, `recipe=`)",
            )


def _require_result(queue: CandidateQueue, stop: KeyboardInterrupt, reporter: Reporter) -> None:
    """Goes on after Ctrl-C where there is something to choose; raises other interruptions anew."""
    if getattr(stop, "number", signal.SIGINT) != signal.SIGINT or not queue.remaining():
        raise stop
    best = queue.remaining()[0].name
    reporter.on_message(make_finding("ends with best", candidate=best).text)


def _choose(
    queue: CandidateQueue,
    reporter: Reporter,
    deadline: Deadline,
    left_out: tuple[Finding, ...],
    stopwatch: Stopwatch,
) -> Choice:
    """Makes the chosen candidate into one model, and writes the models of all that remain.

    `left_out` are the findings on parts of records that were left out.
    """
    context, remaining = queue.context, queue.remaining()
    names = tuple(r.name for r in remaining)
    candidates = SelectionResults(queue.plan, tuple(queue.results.values()), names)
    best, whole, alike = compare_whole_records(candidates, remaining[0], context, deadline)
    notes = [make_finding("whole records decide", candidates=[*alike])] if alike else []
    folds = len(best.fits_by_fold)
    as_often = [r for r in candidates.choosable if len(r.fits_by_fold) == folds]
    simplest = find_simplest(as_often, best)
    models = make_final_models(
        candidates, best, simplest, context, reporter.make_listener, deadline
    )
    final = models[best.name]
    stopwatch.end("final model")
    try:
        bands = calibrate_on_folds(best, final, context, deadline)
    except Exception as error:  # of any kind: the model is there
        bands = None
        notes.append(make_finding("no bands", why=error_message(error)))
    stopwatch.end("bands")
    spoiled: tuple[SpoiledPart, ...] = ()
    is_searched = bool(left_out)  # before the candidates were fitted
    if not is_searched and deadline.has_passed():
        reporter.on_message(make_finding("spoiled no time").text)
    elif not is_searched:
        spoiled = _find_spoiled(candidates, best, models, context)
    stopwatch.end("records that spoil a fit")
    origins = {name: model.origin for name, model in models.items()}
    of_fit = [f for f in final.header.get("findings", ()) if f["severity"] != "note"]
    notes += [make_finding(f["code"], **f["values"]) for f in of_fit]
    reporter.report(notes)
    queue.notes += notes
    errors = best.rmse()
    scored = [e for e in records_without_test(context.data) if e.name in errors]
    choice = Choice(
        context,
        candidates,
        best.name,
        simplest.name,
        origins,
        final.model,
        find_reference(scored, context.scoring.horizon),
        bands,
        spoiled=spoiled,
        notes=left_out,
        whole=whole,
    )
    for name, model in models.items():
        path = context.folder / CANDIDATES / name / MODEL
        save(model.model, path, **choice.header(name, model))
    save(choice.model, context.folder / MODEL, **choice.header(best.name, final))
    stopwatch.end("model files")
    return choice


def _find_spoiled(
    candidates: SelectionResults,
    best: CandidateResult,
    models: Mapping[str, FinalModel],
    context: RunContext,
) -> tuple[SpoiledPart, ...]:
    """Parts of records that the chosen model does not explain.

    Where that has weights, those of the best one that was identified: its parameters say which
    records were made under other conditions. None where nothing was. What the chosen one simulates
    as well as other records, without having seen it, is not spoiled: that one lacks something.
    """
    ranked = [best, *(r for r in rank(candidates.choosable) if r.name != best.name)]
    identified = [
        r.name
        for r in ranked
        if r.name in models and "system" in candidates.plan.candidate(r.name).content.family.needs
    ]
    if not identified:
        return ()

    def is_missed(record: str) -> bool:
        """Whether the best one that was scored on a record simulates it worse than others."""
        scored = (errors for errors in (r.rmse() for r in ranked) if record in errors)
        errors = next(scored, None)
        return errors is None or errors[record] > MISFIT.unlike * np.median([*errors.values()])

    parts = find_spoiled(models[identified[0]].model, records_without_test(context.data))
    return tuple(part for part in parts if is_missed(part.record))


def _make_specification(plan: SelectionPlan, context: RunContext) -> Specification:
    """The plan, records and system of a selection; how long it may take is not part of it.

    Nor are holds and delays that were found: another search may find more in more time.
    """
    candidates = [
        {**c.model_dump(mode="json", exclude={"set"}), "recipe": c.content.model_dump(mode="json")}
        for c in plan.candidates
    ]
    file, system = context.system_file, context.loaded_system
    name = None if system is None else system.name
    return {
        "plan": {**plan.model_dump(mode="json"), "candidates": candidates},
        "data": record_digests(list(context.data)),
        "system": name if file is None else file.sha256,
    }


def _prepare_folder(context: RunContext, earlier: Earlier, specification: Specification) -> None:
    """Refuses, discards or keeps an earlier selection; writes specification and system's file."""
    if earlier == "resume":
        require_same_specification(context.folder, specification, MODEL)
    own = [context.folder / name for name in (MODEL, SPECIFICATION) if earlier == "discard"]
    require_copy_fits(context.system_file, context.folder, own)
    if earlier == "discard":
        discard_results(context.folder)
    if earlier == "refuse":
        _require_no_earlier(context.folder)
    files = [context.folder / name for name in (MODEL, SUMMARY, REPORT)]
    drawings = [context.folder / name for name in (FIGURES, TABLE)]
    require_outputs([*files, *drawings], overwrite=earlier != "refuse")
    for path in files:
        path.unlink(missing_ok=True)
    write_specification(context.folder, specification)
    if context.system_file is not None:
        write_system_copy(context.system_file, context.folder)


def _require_no_earlier(folder: Path) -> None:
    """Raises if a folder holds an earlier selection."""
    scores = sorted((folder / CANDIDATES).glob(f"*/*/{SCORES}"))
    if scores:
        raise InputError(
            folder,
            f"holds an earlier selection ({scores[0].parent.parent.name}, ...)",
            "a new folder",
            "add `resume=` to go on with it, `overwrite=` to discard it, or choose another folder",
        )


def _nothing_fitted(queue: CandidateQueue) -> InputError:
    """The error where no candidate was fitted."""
    reasons: dict[str, list[str]] = {}
    for result in queue.results.values():
        if result.why:
            reasons.setdefault(result.why, []).append(result.name)
    why = "; ".join(f"{', '.join(names)}: {reason}" for reason, names in reasons.items())
    short_of_time = reasons.keys() & {SPENT, NO_STAGE, NO_TIME}
    return InputError(
        "selection",
        f"no candidate could be fitted ({why})",
        "one that can",
        "give more time: `budget=`" if short_of_time else "",
    )
