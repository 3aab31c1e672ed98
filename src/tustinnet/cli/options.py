"""Arguments and options that several verbs share."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Hardware(StrEnum):
    """What computes."""

    cpu = "cpu"
    gpu = "gpu"


Device = Annotated[
    Hardware | None, typer.Option(help="What computes; by default what JAX prefers.")
]
Data = Annotated[
    str,
    typer.Argument(
        metavar="DATA",
        help="Folder with dataset.toml, a data card, or a name of the catalog (qube-servo2).",
    ),
]
Model = Annotated[Path, typer.Argument(metavar="MODEL", help="Model file (.safetensors).")]
Models = Annotated[
    list[Path], typer.Argument(metavar="MODEL...", help="Model files (.safetensors).")
]
Card = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Data card for a folder that has none.")
]
System = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.py",
        help="Physical system: qube-servo2, qube-servo2-naive, qube-servo2-memory, "
        "qube-servo2-rubbing, duffing, or a Python file with SYSTEM (it is run).",
    ),
]
Recipe = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="A packaged recipe, or a TOML file; its [model] kind says what is fitted. Default: "
        "standard, with --system grey, with --physics best-hybrid.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the recipe, e.g. model.hidden=[64,64], stages.*.epochs=50, "
        "search.loss=state, model.fixed.mass=0.4; repeatable.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]
Split = Annotated[
    str | None, typer.Option(metavar="NAME", help="train, validation or test; all by default.")
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Start of the free runs: file (first row as stored), derived-6 (parabola through "
        "6 samples), model-20 (from which the model explains 20 samples best) or warm-up-20 "
        "(internal states follow 20 samples). Default: a warm-up where the model needs one, else "
        "file where velocities are stored, else derived-6.",
    ),
]
Horizon = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Cut records end to end into segments of this length, each with a start of its own; "
        "for unstable systems under control. Default: whole records.",
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Refuse records in which something looks wrong.")
]
Physics = Annotated[
    Path | None,
    typer.Option(metavar="MODEL", help="A model whose accelerations a network corrects."),
]
Origin = Annotated[
    Path | None,
    typer.Option(
        "--from",
        metavar="MODEL",
        help="A fitted model to begin with, by default with the recipe that it was fitted by: for "
        "few records of another device.",
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the checkpoints in --out.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace what is there already in --out.")
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Write no report.html.")]
Seeds = Annotated[
    str | None,
    typer.Option(metavar="K|A,B,..", help="How many seeds, from 0 on, or which; all at once."),
]
Band = Annotated[
    float | None,
    typer.Option(
        metavar="LEVEL",
        help="Bands that hold this share of the time, as 0.9, of a model that was calibrated.",
    ),
]
WholeRecords = Annotated[
    bool, typer.Option("--whole-records", help="With --band: hold this share of whole records.")
]
