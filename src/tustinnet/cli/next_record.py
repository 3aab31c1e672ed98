"""`tustinnet next-record`: ranks proposed records by their information, or designs one."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.files import list_input_files
from tustinnet.cli.models import load_model
from tustinnet.cli.select import parse_seconds
from tustinnet.cli.values import OptionReader, parse_pairs
from tustinnet.cli.verb import refuse_options
from tustinnet.data import proposals as proposal_files
from tustinnet.errors import InputError
from tustinnet.evaluate import bands, record_design
from tustinnet.evaluate import next_record as proposal_ranking
from tustinnet.report import drawing, tables
from tustinnet.report import record_design as design_report
from tustinnet.store import files as disk
from tustinnet.store import motion_file
from tustinnet.systems import files as system_files

MOTION, FIGURE, SUMMARY = "motion.csv", "motion.png", "design.json"
_RATE = 200.0  # Hz, of a design without a model
_HIGHEST_RATE = 1e6  # Hz
_LINE_EVERY = 5.0  # seconds between two lines of progress


def next_record(
    model: Annotated[
        Path | None,
        typer.Argument(
            metavar="MODEL", help="Model file (.safetensors). With --design, --system may do."
        ),
    ] = None,
    proposals: Annotated[
        Path | None,
        typer.Argument(metavar="PROPOSALS", help="TOML file of records that could be made."),
    ] = None,
    horizon: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="For a committee: compare members over segments of this length. Default: whole "
            "records.",
        ),
    ] = None,
    design: Annotated[
        bool,
        typer.Option(
            "--design", help="Design a motion that tells the most, instead of ranking PROPOSALS."
        ),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="With --design: folder for the motion.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="With --design: length of the record. Default: 10.")
    ] = None,
    harmonics: Annotated[
        int | None, typer.Option(metavar="K", help="With --design: harmonics. Default: 10.")
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option(
            metavar="HZ", help="With --design: base frequency. Default: one period in the record."
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="With --design: samples a second. Default: those of the model, else 200.",
        ),
    ] = None,
    within: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="With --design: limits of a position (NAME), velocity (NAME_dot) or acceleration "
            "(NAME_ddot), instead of the robot file's. May be repeated.",
        ),
    ] = None,
    limits: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="With --design: limits of an input, beside those of the robot file. May be "
            "repeated.",
        ),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE", help="With --design: share of each limit to keep free. Default: 0.1."
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="With --design: share of a force that stays unexplained. Default: what the fit "
            "left, else 0.02.",
        ),
    ] = None,
    group: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="With --design: group of the record, e.g. payload=1kg; may be repeated.",
        ),
    ] = None,
    starts: Annotated[
        int | None,
        typer.Option(metavar="K", help="With --design: random motions to search from. Default: 4."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="With --design: seed of these. Default: 0.")
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(metavar="TIME", help="With --design: time limit, or none. Default: 60s."),
    ] = None,
    system: options.System = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="With --design: replace an earlier one in --out.")
    ] = False,
    json: options.Json = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="With --design: do not show progress.")
    ] = False,
) -> None:
    """Rank proposed records by how much a model would gain, or design one.

    PROPOSALS has tables [[proposals]] with name, start (initial values by coordinate), and either
    seconds (without inputs) or inputs (a file with a column for each input). The first record of
    the ranking should be recorded next.

    With --design: a periodic motion of a robot, within limits, that makes the errors of its
    parameters smallest, for a model or for a robot's file alone (--system arm.urdf).
    """
    given = {
        "seconds": seconds,
        "harmonics": harmonics,
        "frequency": frequency,
        "margin": margin,
        "noise": noise,
        "starts": starts,
        "seed": seed,
    }
    if not design:
        if model is None or proposals is None:
            raise typer.BadParameter(
                "missing; a model and a file of proposals, or --design",
                param_hint="MODEL" if model is None else "PROPOSALS",
            )
        others = {f"--{key}": value for key, value in given.items()}
        others |= {
            "--out": out,
            "--rate": rate,
            "--within": within,
            "--limits": limits,
            "--group": group,
            "--budget": budget,
            "--overwrite": overwrite,
            "--quiet": quiet,
        }
        refuse_options(others, "to a ranking of proposals", "--design")
        _rank(model, proposals, horizon, system, json=json)
        return
    needless = {"PROPOSALS": proposals, "--horizon": horizon}
    refuse_options(needless, "to a design", "MODEL, --system, or both", "or omit --design")
    if out is None:
        raise InputError("--design", "no folder for the motion", "--out DIR")
    devices.prepare_jax()
    groups = parse_pairs("--group", group)
    limit = parse_seconds(budget) if budget is not None else record_design.DesignOptions.budget
    files = list_input_files(None, None, model, system)
    disk.require_outputs(
        [out / name for name in (MOTION, FIGURE, SUMMARY)], overwrite=overwrite, read=files
    )
    if model is None:
        if system is None:
            raise InputError(
                "--design",
                "neither a model nor a system",
                "one of them",
                "for instance --system arm.urdf",
            )
        equations = tn.load_system(system_files.find_system(system))
        record_design.require_inputs(equations)
        knowledge, channels, dt = (
            record_design.prior_knowledge(equations, groups),
            equations.channels,
            1 / _RATE,
        )
        header = None
    else:
        fitted, header = load_model(model, system), tn.read_header(model)
        mechanics = proposal_ranking.equations_of_motion(fitted)
        if mechanics is None:
            raise InputError(
                model,
                "a model without equations of motion",
                "an identified system",
                "fit one: tustinnet fit LOGS --recipe inverse-dynamics --system arm.urdf",
            )
        equations, channels, dt = mechanics.system, fitted.channels, fitted.dt
        record_design.require_inputs(equations)
        knowledge = record_design.fitted_knowledge(mechanics, header.get("identification"), groups)
    if rate is not None and not 0 < rate <= _HIGHEST_RATE:
        raise InputError("--rate", f"{rate:g}", f"a rate above 0 and at most {_HIGHEST_RATE:g} Hz")
    design_options = record_design.DesignOptions(
        dt=dt if rate is None else 1 / rate,
        budget=limit,
        **{key: value for key, value in given.items() if value is not None},
    )
    values = OptionReader(channels, header)
    box = record_design.gather_limits(
        equations,
        values.read_limits("--within", within),
        values.read_limits("--limits", limits),
        channels,
    )
    with disk.lock_folder(out):
        result = record_design.design_record(
            equations,
            knowledge,
            box,
            design_options,
            groups=groups,
            on_progress=_make_listener(terminal.make_printer(quiet=quiet)),
        )
        _write(result, out, json=json)


def _rank(
    model: Path, proposals: Path, horizon: float | None, system: str | None, *, json: bool
) -> None:
    """Ranks proposed records."""
    devices.prepare_jax()
    simulator, header = load_model(model, system), tn.read_header(model)
    values = OptionReader(simulator.channels, header).values
    # raises at once where the errors of the model are unknown
    bands.find_alternatives(simulator, header, model)
    candidates = proposal_files.read_proposals(proposals, simulator.channels, values)
    ranking = proposal_ranking.rank_proposals(simulator, header, candidates, horizon=horizon)
    if json:
        terminal.print_json(ranking.as_plain())
        return
    rows = [[gain.name, tables.number(gain.value), gain.words] for gain in ranking.gains]
    columns = ["proposal", f"gain [{ranking.unit}]", "largest effect"]
    terminal.print_tables(tables.Table(columns, rows, title=f"By the {ranking.criterion}"))
    terminal.echo(f"record next: {ranking.gains[0].name}")


def _make_listener(
    printer: Callable[[str], None],
) -> "Callable[[record_design.DesignProgress], None]":
    """Makes a function that prints a line of progress now and then."""
    last, start = time.monotonic(), 0

    def on_progress(progress: "record_design.DesignProgress") -> None:
        nonlocal last, start
        if progress.start == start and time.monotonic() - last < _LINE_EVERY:
            return
        last, start = time.monotonic(), progress.start
        printer(
            f"start {progress.start} of {progress.starts}, step {progress.iteration}: "
            f"information {progress.gain:+.1f} nats"
        )

    return on_progress


def _write(result: "record_design.RecordDesign", out: Path, *, json: bool) -> None:
    """Prints a design, and writes its motion, its figure and its summary."""
    motion_file.write_motion(out, MOTION, result)
    disk.write_into(out, SUMMARY, disk.to_json(result.as_plain()))
    if json:
        terminal.print_json(result.as_plain())
    else:
        terminal.print_tables(design_report.motion_table(result), design_report.error_table(result))
        for sentence in design_report.sentences(result):
            terminal.echo(f"* {sentence}")

    drawing.write_figure(design_report.design_figure(result), out, FIGURE)
    terminal.messages().print(
        f"written: {', '.join(str(out / name) for name in (MOTION, FIGURE, SUMMARY))}"
    )
