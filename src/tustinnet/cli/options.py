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
Card = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Data card for a folder that has none.")
]
System = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE.py",
        help="Physical system: qube-servo2, qube-servo2-naive, qube-servo2-memory, or a Python "
        "file with SYSTEM (it is run).",
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
        "6 samples) or model-20 (from which the model explains 20 samples best). Default: file "
        "where velocities are stored, else derived-6.",
    ),
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the checkpoints in --out.")]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace what is there already in --out.")
]
Seeds = Annotated[
    int, typer.Option(min=1, metavar="K", help="How many seeds to train; all at once.")
]
