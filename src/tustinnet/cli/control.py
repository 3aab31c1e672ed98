"""`tustinnet control`: a controller designed on a model, tested, and written as C."""

import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.about import data_words
from tustinnet.cli.models import load_model
from tustinnet.cli.records import load_records
from tustinnet.cli.values import OptionReader, parse_pairs
from tustinnet.cli.verb import refuse_options
from tustinnet.control import design as controller_design
from tustinnet.control import dynamics, replaying
from tustinnet.control import trial as trials
from tustinnet.control.export import compiled
from tustinnet.control.export import gains as gain_files
from tustinnet.errors import InputError
from tustinnet.families import euler_lagrange
from tustinnet.models import groups as model_groups
from tustinnet.models import physical_values
from tustinnet.report import control as control_report
from tustinnet.report import drawing
from tustinnet.report import replay as replay_report
from tustinnet.report.page import controller as controller_page
from tustinnet.simulate import range as training_ranges
from tustinnet.store import exported, kept_system
from tustinnet.store import files as disk
from tustinnet.store import header as file_header

_LONGEST = 1000  # s, of a motion
_OF_REPLAY = ("model", "replay", "card", "system", "group", "json")
_DRAWS = 20  # of parameters, by which bands of frequency responses are drawn
LOOP, ROBUSTNESS, BODE = "closed_loop.png", "robustness.png", "bode.png"
SUMMARY, PAGE = "design.json", "control.html"
MODEL = "model.safetensors"  # the model of the estimator, with which a replay computes


def control(
    context: typer.Context,
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL", help="Model file (.safetensors); with --replay a controller's folder."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for the controller.")
    ] = None,
    at: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE,..",
            help="Positions to hold, e.g. alpha=0, alpha=90deg; a number alone is in the unit of "
            "the data card's column, from its offset on. With --to, positions where the motion "
            "begins. May be repeated.",
        ),
    ] = None,
    swing_up: Annotated[
        bool,
        typer.Option(
            "--swing-up", help="Plan a motion to --at from where the mechanism hangs at rest."
        ),
    ] = False,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE,..",
            help="Plan a motion from --at to these positions; hold these. May be repeated.",
        ),
    ] = None,
    follow: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Follow a motion from rest to rest, then hold its end: a column `time` [s], and "
            "one for each coordinate that follows, in the unit of the data card's column.",
        ),
    ] = None,
    limits: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH,..",
            help="Limits of an input, instead of the data card's. May be repeated.",
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Duration of the motion. Default: six of the mechanism's own oscillations."
        ),
    ] = None,
    data: Annotated[
        str | None,
        typer.Option(
            metavar="DATA",
            help="Records by which the noise of the estimator is found: a folder of logs, a data "
            "card, or the name of a published data set (qube-servo2). Default: from encoders and "
            "the range of the training records.",
        ),
    ] = None,
    card: options.Card = None,
    weight: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE,..",
            help="Acceptable deviation of a state, an input or integral_NAME, e.g. theta=0.1rad: "
            "smaller is stricter. May be repeated. Default: half of the recorded range, of an "
            "angle at most 1 rad.",
        ),
    ] = None,
    integral: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Coordinate held without a lasting error; may be repeated."
        ),
    ] = None,
    mpc: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100,
            metavar="STEPS",
            help="Predictive control instead of linear feedback: at every sample it plans so many "
            "steps ahead, and keeps --within where it can.",
        ),
    ] = None,
    delay: Annotated[
        int,
        typer.Option(
            min=0, max=100, help="Samples from when an input is computed to when it acts."
        ),
    ] = 0,
    within: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH,..",
            help="Limits of a position or velocity that a motion keeps, and --mpc. May be "
            "repeated.",
        ),
    ] = None,
    safe: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE,..",
            help="Inputs while the sensors of positions cannot be used. May be repeated. "
            "Default: 0.",
        ),
    ] = None,
    replay: Annotated[
        str | None,
        typer.Option(
            metavar="LOGS",
            help="Instead of designing: logs of the machine, and what a controller (its folder in "
            "the place of MODEL) would have commanded, estimated and missed.",
        ),
    ] = None,
    observer: Annotated[
        bool,
        typer.Option(
            "--observer", help="Estimate lasting disturbances, and take them from the inputs."
        ),
    ] = False,
    trust_beyond: Annotated[
        bool,
        typer.Option(
            "--trust-beyond", help="Accept a motion or a point beyond the range of the records."
        ),
    ] = False,
    plant: Annotated[
        str | None,
        typer.Option(
            metavar="PLANT",
            help="Another plant to play the controller on: a model file, a system file or name, "
            "qube-servo2-twin, or an FMU.",
        ),
    ] = None,
    starts: Annotated[
        int, typer.Option(min=1, max=1000, help="Runs on the plants of each kind.")
    ] = 20,
    group: options.Group = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Write a controller that fails on its own model, or on others that the records "
            "allow as well.",
        ),
    ] = False,
    system: options.System = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
) -> None:
    """Design a controller on a model, test it on what the model does not know, write it as C.

    Feedback is linear-quadratic, or predictive (--mpc); the state is estimated by an extended
    Kalman filter, a motion is planned by iterative LQR. The folder gets controller, estimator,
    model and a closed loop in C, gains, scripts for CasADi, acados and do-mpc, and figures.
    """
    devices.prepare_jax()

    if replay is not None:
        _refuse_beside_replay(context)
        groups = parse_pairs("--group", group)
        _replay(model, replay, card, system, groups, json=json)
        return
    if out is None:
        raise InputError("--out", "not given", "a folder for the controller")
    _refuse_beside_mpc(mpc, integral, observer=observer)
    _refuse_others(follow, at, to, seconds, within, mpc, swing_up=swing_up)
    if data is None:
        refuse_options({"--card": card}, "without records", "--data")
    if seconds is not None and not 0 < seconds < _LONGEST:
        raise InputError("--seconds", f"{seconds:g}", f"a duration above 0 and below {_LONGEST}")
    exported.require_export_folder(out, overwrite=overwrite)
    printer = terminal.make_printer(quiet=quiet)
    loaded, header = load_model(model, system), tn.read_header(model)
    groups = parse_pairs("--group", group)
    simulator = model_groups.model_for_groups(loaded, groups, "control")
    values = OptionReader(simulator.channels, header)
    training_range = training_ranges.Range.from_header(header, simulator)
    known = None if trust_beyond else training_range
    positions = values.read_point("--at", at, known)
    input_limits = values.read_limits("--limits", limits)
    start, reference = None, None
    if follow is not None:
        factors = {name: column.factor for name, (_, column) in values.values.units.items()}
        reference = tn.control.read_reference(follow, simulator.channels, factors)
        start, positions = ({name: float(q[k]) for name, q in reference.items()} for k in (0, -1))
    elif swing_up:
        start = controller_design.find_rest(
            simulator, positions, dynamics.recorded_limits(simulator, input_limits, training_range)
        )
    elif to is not None:
        start, positions = positions, positions | values.read_point("--to", to, known)
    records: Sequence[tn.Experiment] = ()
    if data is not None:
        records = [*load_records(data, card)]
    task = controller_design.ControlTask(
        positions,
        start,
        seconds,
        values.read("--weight", weight),
        integral or (),
        delay,
        input_limits,
        values.read_limits("--within", within),
        trust_beyond,
        values.read("--safe", safe),
        reference,
        observer,
        mpc,
    )
    with disk.lock_folder(out):
        begin = time.perf_counter()
        design = controller_design.design_controller(
            simulator,
            task,
            range=training_range,
            records=records,
            on_message=lambda step: printer(f"designing: {step}"),
        )
        printer(f"designed in {time.perf_counter() - begin:.1f} s")
        printer(
            f"playing closed loops of {design.steps * simulator.dt:.3g} s, {starts} on each plant"
        )
        late = tn.control.PlantOptions(delay=delay)
        plants = (
            {}
            if plant is None
            else {Path(plant).name: tn.control.load_plant(plant, simulator.channels, options=late)}
        )
        is_physical = physical_values.equations_in(simulator) is not None
        rivals = tn.control.load_rivals(model, system, as_good=is_physical)
        candidates = [model_groups.model_for_groups(one, groups, "control") for one in rivals]
        trial = trials.try_design(
            design, header, plants=plants, count=starts, candidates=candidates
        )
        problem = trial.robustness.problem
        is_refused = bool(problem) and not force
        result = f"failed ({problem}), and was written all the same" if problem else "passed"
        export = (
            None
            if is_refused
            else tn.control.export_controller(
                design.estimated,
                design.controller,
                design.noise,
                out,
                deviations=design.deviations,
                within=design.task.within,
                file=model,
                remarks=[f"its test on other plants {result}: {trial.robustness.sentence}"],
                overwrite=overwrite,
            )
        )
        content = control_report.summarise(design, trial.robustness, export)
        if json:
            terminal.print_json(content)
        else:
            terminal.echo("\n".join(control_report.sentences(design)))
            terminal.print_tables(
                control_report.point_table(design),
                control_report.margins_table(design),
                control_report.robustness_table(trial.robustness, simulator.channels),
            )
            terminal.echo(
                "\n".join((*control_report.errors_along(design, trial), trial.robustness.sentence))
            )
        if export is None:
            remedies = ["record motion about the goal with inputs"]
            remedies += [] if is_physical else ["fit equations of motion (the recipe mechanism)"]
            raise InputError(
                "the controller",
                f"{problem}; nothing was written",
                "one that holds more than its model",
                f"{', or '.join(remedies)}; --force writes it all the same",
            )
        disk.write_into(out, SUMMARY, disk.to_json(content))
        _keep_model(model, out)
        drawing.write_figure(control_report.closed_loop_figure(design, trial.main_runs), out, LOOP)
        drawing.write_figure(control_report.robustness_figure(trial.robustness), out, ROBUSTNESS)
        allowed = euler_lagrange.draw_values(simulator, header, _DRAWS)
        noise = design.noise if design.margins.has_estimator else None
        responses = tn.control.loop_responses(simulator, design.own_feedback, allowed, noise)
        drawing.write_figure(
            control_report.frequency_figure(responses, simulator.channels), out, BODE
        )
        controller_page.write_control_page(
            design,
            trial,
            out / PAGE,
            training_range=training_range,
            command=shlex.join(["tustinnet", *sys.argv[1:]]),
        )
        for note in (*export.notes, *_notes_of_plan(design.plan, header)):
            terminal.messages().print(f"note: {note}")
        terminal.messages().print(
            f"written to {out}: {', '.join((*export.files, SUMMARY, LOOP, ROBUSTNESS, BODE, PAGE))}"
        )
        replay = shlex.join(["tustinnet", "control", str(out), "--replay"])
        terminal.messages().print(
            f"next: make -C {shlex.quote(str(out))} (its C code, README.md says what is in it), "
            f"{replay} LOGS (along a log of the closed loop)"
        )


def _refuse_beside_mpc(mpc: int | None, integral: Sequence[str] | None, *, observer: bool) -> None:
    """Raises for options of linear feedback that predictive control does not have."""
    if mpc is not None:
        options = {"--integral": integral, "--observer": observer}
        refuse_options(options, "beside --mpc", "linear feedback")


def _refuse_others(
    follow: Path | None,
    at: Sequence[str] | None,
    to: Sequence[str] | None,
    seconds: float | None,
    within: Sequence[str] | None,
    mpc: int | None,
    *,
    swing_up: bool,
) -> None:
    """Raises for options that do nothing for the motion that is asked for, and without any."""
    if follow is not None:
        others = {"--at": at, "--to": to, "--swing-up": swing_up, "--seconds": seconds}
        refuse_options(others, "beside --follow", "the file alone, which has them")
    elif at is None:
        raise InputError("control", "neither --at nor --follow", "one of them")
    elif to is not None:
        refuse_options({"--swing-up": swing_up}, "beside --to", "one of them")
    elif not swing_up:
        motion = "--swing-up, --to or --follow"
        refuse_options({"--seconds": seconds}, "without a motion", motion)
        if mpc is None:
            refuse_options({"--within": within}, "without a motion", f"{motion}, or --mpc")


def _refuse_beside_replay(context: typer.Context) -> None:
    """Raises for options of a design, which a replay does not make."""
    for name in context.params:
        source = context.get_parameter_source(name)
        if name not in _OF_REPLAY and source is not None and source.name == "COMMANDLINE":
            option = f"--{name.replace('_', '-')}"
            refuse_options({option: True}, "beside --replay", "a replay of logs alone")


def _notes_of_plan(plan: "tn.control.Plan | None", header: Mapping[str, Any]) -> list[str]:
    """A note on a motion that lasts longer than the free runs by which its model was judged."""
    judgement = file_header.judgement_in_header(header)
    judged = None if judgement is None else judgement.horizon
    if plan is None or judged is None or len(plan.u) * plan.dt <= judged:
        return []
    return [
        f"the motion lasts {len(plan.u) * plan.dt:.3g} s, and the model was compared with records "
        f"over {judged:.3g} s at a time"
    ]


def _keep_model(model: Path, out: Path) -> None:
    """Copies the model, and the system that is kept with it, beside its controller."""
    disk.write_into(out, MODEL, model.read_bytes())
    if (copy := kept_system.find_system_copy(model)) is not None:
        kept_system.write_system_copy(copy, out)


def _replay(
    folder: Path,
    data: str,
    card: Path | None,
    system: str | None,
    groups: Mapping[str, str],
    *,
    json: bool,
) -> None:
    """Prints what the controller of a folder makes of logs."""
    for name in (gain_files.JSON, SUMMARY, MODEL):
        if not (folder / name).is_file():
            raise InputError(
                folder,
                f"no {name} there",
                "the folder of a controller, as `control --out` writes it",
                "one of before 0.3 lacks it: design it again",
            )
    gains = tn.control.read_controller(folder)
    file = folder / MODEL
    loaded = model_groups.model_for_groups(load_model(file, system), groups, "control")
    model = replaying.model_of(gains, loaded)
    noise, is_predictive = replaying.read_estimator(folder / SUMMARY)
    controller = compiled.folder_controller(folder, gains, predictive=is_predictive)
    records = load_records(data, card)
    replays = [tn.control.replay(gains, model, noise, record, controller) for record in records]
    consistency = tn.control.check_filter(model, [*records], noise)
    if json:
        terminal.print_json(replay_report.summarise(replays, consistency))
        return
    terminal.print_tables(replay_report.replay_table(replays))
    terminal.echo("\n".join(replay_report.replay_sentences(replays, consistency)))
    logs = data_words(data, card)
    terminal.echo(
        f"next: tustinnet evaluate {shlex.quote(str(file))} {logs} (free runs of the model), "
        f"tustinnet fit {logs} --out refitted (a model by these logs, too), then control that"
    )
