"""Arguments and options that several verbs share."""

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from tustinnet.cli import completion
from tustinnet.registry import SYSTEMS
from tustinnet.simulate.start_names import starts_help
from tustinnet.wording import join_words

_ARGUMENT = re.compile(r"`([a-z_]+)=`(?! of `load)")  # as sentences of the library name an argument
_SHORTER = {"changes": "set", "origin": "from"}


def with_options(text: str) -> str:
    """A text of the library with the command's options: `budget=`, an argument, is --budget here.

    Options are called like the arguments, but for those that say it shorter.
    """

    def to_option(match: re.Match[str]) -> str:
        name = _SHORTER.get(match[1], match[1])
        return f"--{name.replace('_', '-')}"

    return _ARGUMENT.sub(to_option, text)


class Hardware(StrEnum):
    """Processors that can compute."""

    cpu = "cpu"
    gpu = "gpu"


Device = Annotated[
    Hardware | None,
    typer.Option(help="Processor to compute on. Default: a GPU that JAX can use, else cpu."),
]
Data = Annotated[
    str,
    typer.Argument(
        metavar="DATA",
        help="Folder of logs with its data card dataset.toml, a data card, or the name of a "
        "published data set (qube-servo2).",
    ),
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="Model file (.safetensors).")]
Models = Annotated[
    list[Path], typer.Argument(metavar="MODEL...", help="Model files (.safetensors).")
]
Card = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Data card, if DATA is a folder without one.")
]
System = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        autocompletion=completion.system,
        help=f"System, that is equations of motion: {', '.join(SYSTEMS.places)}, a Python file "
        "that defines SYSTEM (the file is executed), or a robot: FILE.urdf, or FILE.xml of MuJoCo.",
    ),
]
SystemOfCard = Annotated[
    str | None,
    typer.Option(
        "--system",
        metavar="NAME|FILE",
        autocompletion=completion.system,
        help=f"System whose coordinates and inputs the card gets: {', '.join(SYSTEMS.places)}, a "
        "Python file that defines SYSTEM (the file is executed), or a robot: FILE.urdf, or "
        "FILE.xml of MuJoCo.",
    ),
]
_CLUSTER = (
    "a Ray cluster, given as HOST:PORT of its head node. auto: the cluster in RAY_ADDRESS, else "
    "this machine."
)


def recipe(default: str) -> Any:
    """Option that names a recipe, with the recipe that is used by default."""
    return typer.Option(
        metavar="NAME|FILE",
        autocompletion=completion.recipe,
        help="How the model is built and fitted: a packaged recipe, or a TOML file; "
        f"with more forces as 'mechanism + lag'. Default: {default}.",
    )


def cluster(use: str) -> Any:
    """Option that names a cluster; its help begins with `use`, the use of the cluster."""
    return typer.Option(metavar="auto|ADDRESS", help=f"{use} {_CLUSTER}")


Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the recipe, e.g. model.hidden=[64,64], stages.*.epochs=50, "
        "search.robust=huber, model.fixed.mass=0.4. May be repeated.",
    ),
]
Group = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=VALUE",
        help="For a model with values by group: the group, e.g. payload=1kg; may be repeated.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Do not show progress.")]


def _split(default: str) -> Any:
    """Option that names a split of the records."""
    return typer.Option(
        metavar="NAME",
        autocompletion=completion.split,
        help=f"Records to use: {join_words(completion.SPLITS, 'or')}. Default: {default}.",
    )


def _start(default: str) -> Any:
    """Option that names a start, by default the one given or else the usual one."""
    return typer.Option(
        metavar="NAME",
        autocompletion=completion.start,
        help=f"Initial states of the free runs: {starts_help()}. Default: {default}warm-up-N where "
        "the model needs a warm-up, else file where records have velocity columns, else model-20, "
        "or derived-6 of records with fewer than 40 samples.",
    )


Split = Annotated[str | None, _split("all")]
JudgedSplit = Annotated[str | None, _split("test if there is one, else validation, else all")]
Start = Annotated[str | None, _start("")]
JudgedStart = Annotated[
    str | None, _start("that by which fit judged the model; where its file says none, ")
]
JudgedHorizon = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Cut records into segments of this length and estimate an initial state for each; for "
        "unstable systems under control. inf: whole records. Default: as fit judged the model, "
        "else whole records.",
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse records with severe findings or warnings.")
]
LeaveOutSpoiled = Annotated[
    bool,
    typer.Option(
        "--leave-out-spoiled",
        help="Leave out stretches and records that spoil the fit (moved by hand, another payload), "
        "fit the others, and say what was left out.",
    ),
]
Physics = Annotated[
    Path | None,
    typer.Option(
        metavar="MODEL", help="Model file: a network is trained to correct this model (hybrid)."
    ),
]
Origin = Annotated[
    Path | None,
    typer.Option(
        "--from",
        metavar="MODEL",
        help="Fitted model whose weights or parameters the fit begins with, for instance for few "
        "records of another device.",
    ),
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Continue the training from the checkpoints in --out.")
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the earlier results in --out.")
]
Redraw = Annotated[bool, typer.Option("--overwrite", help="Replace existing figures.")]
NoReport = Annotated[bool, typer.Option("--no-report", help="Write no report.html.")]
Seeds = Annotated[
    str | None,
    typer.Option(
        metavar="K|A,B,..",
        help="Number of seeds (8: seeds 0 to 7) or a list (4,7); all train together. Default: 1.",
    ),
]
Band = Annotated[
    float | None,
    typer.Option(
        metavar="LEVEL",
        help="Add bands around the free runs that contain the true motion for this share of the "
        "time, e.g. 0.9. The model needs bands: of fit without a recipe, or of tn.calibrate.",
    ),
]
WholeRecords = Annotated[
    bool,
    typer.Option(
        "--whole-records",
        help="With --band: contain this share of the records over their whole length.",
    ),
]
