"""`tustinnet init`: a data card from the logs themselves."""

import os
import shlex
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Annotated

import typer

import tustinnet as tn
from tustinnet.check import drafting
from tustinnet.cli import devices, options, terminal
from tustinnet.cli.files import require_apart
from tustinnet.cli.inspect import draft_as_plain, print_inspection
from tustinnet.cli.models import require_readable_robot
from tustinnet.data import catalog, loading, readers
from tustinnet.data.drafting import files as log_files
from tustinnet.data.drafting import findings, system_columns
from tustinnet.errors import InputError
from tustinnet.report import draft_figure, drawing
from tustinnet.store import files as disk
from tustinnet.store import run_folder
from tustinnet.wording import counted

FIGURE = "init.png"
_LONGEST_ANSWER = 40  # characters


def init(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOGS...",
            help="Folder of logs, or some files of one. The card dataset.toml is written into that "
            "folder.",
        ),
    ],
    system: options.SystemOfCard = None,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes", "-y", help="Ask nothing: assume what the logs do not say, and print it."
        ),
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing card and figure.")
    ] = False,
    json: options.Json = False,
) -> None:
    """Write a data card for a folder of logs: times, coordinates, inputs, units, splits.

    It looks at names, units and numbers of all columns, asks what they do not say, and draws every
    column of a record with what it was taken for. With --system the card has the coordinates and
    inputs of the system, as the joints of a robot, and columns are matched with them.
    """
    loaded = _load_system(system)
    folder, files = log_files.list_logs(logs)
    outputs = [folder / catalog.CARD_NAME, folder / FIGURE]
    disk.require_outputs(outputs, overwrite=overwrite, read=[folder / file for file in files])
    disk.require_writable_folder(folder)
    draft = make_draft(folder, files, is_asking=not yes, system=loaded)
    with disk.lock_folder(folder):
        # while questions were answered, another may have written one
        disk.require_outputs(outputs, overwrite=overwrite)
        write_draft(draft, folder)
    shown: set[str] = set()
    if json:
        card = os.fspath(folder / catalog.CARD_NAME)
        terminal.print_json({"card": card} | draft_as_plain(draft))
    else:
        _print_draft(draft, folder)
        place, card = catalog.locate(folder)
        records = loading.load_folder(place, card)
        print_inspection(records, card)
        shown = {note for e in records for note in e.notes}
    print_assumptions(draft, shown)
    draw_draft(draft, folder)
    fit, then = f"tustinnet fit {shlex.quote(str(folder))}", "next"
    if loaded is not None:
        if mends := _print_mismatches(draft, loaded):
            then = "next, when that is mended"
            system = "FILE.py" if "SYSTEM = " in mends else system
        recipe = "" if loaded.source is None else " --recipe inverse-dynamics"
        if recipe and any(map(system_columns.is_goal, loaded.inputs)):  # whose forces nobody knows
            recipe = " --recipe grey"
        elif recipe and loaded.internal:  # of elastic gears
            recipe = " --recipe grey --set search.horizon=0.5"
        fit += f"{recipe} --system {shlex.quote(str(system))}"
    terminal.messages().print(
        f"card: {folder / catalog.CARD_NAME}   figure: {folder / FIGURE}   {then}: {fit} --out RUN",
        highlight=False,
        soft_wrap=True,
    )


def _load_system(which: str | None) -> "tn.LagrangianSystem | None":
    """The system of a card, if one was named."""
    if which is None:
        return None
    require_readable_robot(which)
    devices.prepare_jax()
    return tn.load_system(which).plant


def _print_mismatches(draft: "tn.Draft", system: "tn.LagrangianSystem") -> str:
    """Prints what of a system's file counts otherwise, and what has no column; a line each.

    Then what a fit would refuse, which is returned; "" without.
    """
    console = terminal.messages()
    for sentence in () if system.source is None else system.source.remarks:
        console.print(sentence, highlight=False, soft_wrap=True)
    for sentence in draft.choice.missing:
        console.print(f"not matched: {sentence}", highlight=False, soft_wrap=True)
    coordinates = [tn.Coordinate(c.name, c.kind) for c in draft.choice.coordinates]
    inputs = [tn.Input(i.name, i.unit) for i in draft.choice.inputs]
    try:
        system.for_channels(coordinates, inputs, "a fit needs more")
    except InputError as error:
        console.print(str(error), highlight=False, soft_wrap=True)
        return str(error)
    return ""


def make_draft(
    folder: Path,
    files: Sequence[str],
    *,
    is_asking: bool,
    system: "tn.LagrangianSystem | None" = None,
) -> "tn.Draft":
    """Drafts a card; asks its questions on a terminal, until nothing is open.

    Args:
        folder: the folder of the card.
        files: the logs, below it.
        is_asking: whether to ask at all.
        system: the system whose coordinates and inputs the card has to have, if one was named.
    """
    console = terminal.messages()
    answers: dict[str, str] = {}
    channels = None
    if system is not None:
        joints = {} if system.source is None else system.source.input_joints()
        channels = system_columns.SystemChannels(
            system.coordinates, system.inputs, joints, system.name
        )
    draft = drafting.draft_files(folder, files, system=channels)
    if is_asking and draft.questions and not terminal.can_ask():
        console.print("no terminal to ask at: as with --yes")
    while is_asking and draft.questions and terminal.can_ask():
        for question in draft.questions:
            answers[question.key] = _ask(question)
        draft = drafting.draft_files(folder, files, answers, system=channels)
    draft.require_readable(folder)
    return draft


def _ask(question: "findings.Question") -> str:
    """The answer to a question on the terminal; an empty line takes the assumption."""
    options = f" ({', '.join(question.options)})" if question.options else ""
    while True:
        answer = terminal.ask(f"{question.text}{options}", question.assumption)
        if not answer:
            return question.assumption
        if question.is_number:
            try:
                if 0 < float(answer) < float("inf"):
                    return answer
            except ValueError:
                pass
            terminal.messages().print("a number above 0, or an empty line")
        elif question.options and answer not in question.options:
            terminal.messages().print(f"one of {', '.join(question.options)}, or an empty line")
        elif len(answer) <= _LONGEST_ANSWER and answer.isprintable():
            return answer


def write_draft(draft: "tn.Draft", folder: Path) -> None:
    """Writes a drafted card into a folder."""
    disk.write_into(folder, catalog.CARD_NAME, draft.text)


def draw_draft(draft: "tn.Draft", folder: Path) -> None:
    """Draws every column of a record of a draft into a folder."""
    drawing.write_figure(draft_figure.draft_figure(draft), folder, FIGURE)


def draft_into_run(folder: Path, out: Path, *, keeps: bool, overwrite: bool) -> Path:
    """Drafts a card for logs that have none into the folder of a run, and says what it assumed.

    Args:
        folder: the logs, beside which nothing is written.
        out: the folder of the run.
        keeps: whether a card that an earlier run left there is used as it is.
        overwrite: whether it may be replaced.

    Returns:
        The card.
    """
    require_apart(out, folder)
    card, console = out / catalog.CARD_NAME, terminal.messages()
    if keeps and card.is_file():
        console.print(f"no card in {folder}: that of the earlier run, {card}")
        return card
    folder, files = log_files.list_logs([folder])
    draft = make_draft(folder, files, is_asking=False)
    if card.is_file() and any(
        readers.is_readable(p) and p.name not in run_folder.OWN for p in out.iterdir()
    ):
        raise InputError(
            out, "a folder of records with a card of its own", "another folder for the run"
        )
    if not (card.is_file() and card.read_bytes() == draft.text.encode()):
        disk.require_outputs([card], overwrite=overwrite)
    with disk.lock_folder(out):
        write_draft(draft, out)
        draw_draft(draft, out)
    console.print(
        f"no card in {folder}: drafted {card} (figure: {out / FIGURE}); "
        f"`tustinnet init {shlex.quote(str(folder))}` asks, and writes one beside the logs"
    )
    print_assumptions(draft)
    return card


def print_assumptions(draft: "tn.Draft", shown: Collection[str] = ()) -> None:
    """Prints what was assumed and remarks on the files, a line each, as messages.

    Args:
        draft: the draft.
        shown: remarks that are on the terminal already.
    """
    console = terminal.messages()
    for note in (n for n in draft.notes if n not in shown):
        console.print(note if note.startswith("left out") else f"note: {note}")
    for question in draft.questions:
        console.print(f"assumed: {question.text}: {question.assumption}")
    for channel in draft.choice.inputs:
        for doubt in channel.doubts:
            if not doubt.startswith("the unit"):  # which is among the assumptions
                console.print(f"check: '{channel.column}' as an input: {doubt}")


def _print_draft(draft: "tn.Draft", folder: Path) -> None:
    """Prints the columns with what they were taken for and why, a line each, and the splits."""
    records = len(draft.splits.records)
    terminal.echo(f"{folder}: {counted(records, 'record')}, every {1e3 * draft.dt:.6g} ms")
    lines = [
        (c.name, (f"{c.use} [{c.unit}]" if c.unit else c.use) or "not used", c.because)
        for c in draft.columns
    ]
    widths = [max(len(line[k]) for line in lines) for k in range(2)]
    for name, use, because in lines:
        terminal.echo(f"  {name:<{widths[0]}}  {use:<{widths[1]}}  {because}")
    for sentence in draft.splits.sentences:
        terminal.echo(f"splits: {sentence}")
