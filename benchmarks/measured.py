"""How good are the models of plain `tustinnet fit` on records that were measured?

    python benchmarks/measured.py OUT FOLDER... [--budget 4min] [--busy N]

A FOLDER has records and a data card. Records of the split `test` are held out, without such the
last one; of a single record its last quarter is. `tustinnet fit` gets the others, without splits,
and nothing else. Beside other programs (`--busy`: so many that only compute) it has the same time.

A row has the CPU seconds, errors of the held-out records over longer and longer free runs by that
of the better trivial predictor (standing still, constant speed), how long whole records are
followed, and the error that the fit claims as typical with the range of nine of ten, beside the
true ones. `worse` are the horizons up to the run's own at which the model loses to the trivial
predictor, which nobody was told.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import tustinnet as tn
from tustinnet.store.data_set_folder import write_data_set

HELD_OUT = 0.25  # of a single record
COLUMNS = (
    "folder",
    "chosen",
    "CPU s",
    "error by reference (horizon)",
    "follows",
    "claimed",
    "held out",
    "in range",
    "worse",
)
COMPUTE = "import os; parent = os.getppid()\nwhile os.getppid() == parent: pass"
COMPUTING = [sys.executable, "-c", COMPUTE]  # as long as this program is there


def split(data: tn.DataSet) -> tuple[tn.DataSet, tn.DataSet]:
    """The records to fit to, and those that are held out."""
    records = list(data)
    held_out = [e for e in records if e.split == "test"] or records[-1:]
    kept = [e for e in records if e not in held_out]
    if not kept:
        cut = round((1 - HELD_OUT) * len(records[0]))
        kept, held_out = [records[0][:cut]], [records[0][cut:]]
    return tuple(  # pyright: ignore[reportReturnType]
        replace(data, experiments=tuple(replace(e, split=None) for e in part))
        for part in (kept, held_out)
    )


@contextmanager
def others(count: int) -> Iterator[None]:
    """So many other programs that compute."""
    programs = [subprocess.Popen(COMPUTING) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def run(words: Sequence[str | Path], log: Path) -> tuple[str, float]:
    """What `tustinnet` prints, and the CPU seconds that it takes."""
    with log.open("w") as errors, (out := log.with_suffix(".out")).open("w") as output:
        command = [sys.executable, "-m", "tustinnet", *map(str, words)]
        child = subprocess.Popen(command, stdout=output, stderr=errors)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        sys.exit(f"{log}: {log.read_text()[-500:]}")
    return out.read_text(), usage.ru_utime + usage.ru_stime


def row(folder: Path, out: Path, budget: str | None) -> list[str]:
    """Fits a folder's records, and judges the model on those held out."""
    shutil.rmtree(out, ignore_errors=True)
    parts = split(tn.load(folder))
    for data, name in zip(parts, ("logs", "heldout"), strict=True):
        write_data_set(data, out / name, f"{folder.name}, {name}")
    words = ["fit", out / "logs", "--out", out / "run", "--no-report"]
    _, seconds = run([*words, *(["--budget", budget] if budget else [])], out / "fit.log")
    model = out / "run" / "model.safetensors"
    text, _ = run(["evaluate", model, out / "heldout", "--json"], out / "evaluate.log")
    summary, judged = json.loads((out / "run" / "summary.json").read_text()), json.loads(text)
    return [folder.name, summary["best"], f"{seconds:.0f}", *cells(summary, judged)]


def cells(summary: dict[str, Any], judged: dict[str, Any]) -> Iterator[str]:
    """The cells of errors, claims and what was not told."""
    (unit,) = list(judged["mean_by_unit"])[:1]
    shares = {
        h["horizon"]: h["mean_by_unit"][unit] / h["reference"]["mean_by_unit"][unit]
        for h in judged["horizons"]
        if h["reference"]["mean_by_unit"][unit]
    }
    yield ", ".join(f"{x:.2g} ({f'{h:g} s' if h else 'whole'})" for h, x in shares.items())
    yield f"{median(judged['seconds_followed']):.2g} s"
    rmse, claim = [e["rmse"] for e in judged["experiments"]], summary["claim"]
    yield (
        ""
        if claim is None
        else f"{claim['typical']:.2g} ({claim['low']:.2g} to {claim['high']:.2g})"
    )
    yield f"{median(rmse):.3g} {unit}"
    inside = [claim["low"] <= x <= claim["high"] for x in rmse] if claim else []
    yield f"{sum(inside)} of {len(rmse)}" if claim else ""
    longest = summary["horizon"] or float("inf")
    lost = [h for h, x in shares.items() if (h or float("inf")) <= longest and x >= 1]
    yield ", ".join(f"{h:g} s" if h else "whole" for h in lost)


def main() -> None:
    """Reads the arguments, and prints a row for each folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path, help="where runs are written")
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--budget", help="of each fit, as 5min; by default that of the command")
    parser.add_argument("--busy", type=int, default=0, metavar="N", help="other programs")
    args = parser.parse_args()
    print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|", flush=True)
    with others(args.busy):
        for folder in args.folders:
            start_time = time.monotonic()
            text = " | ".join(row(folder, args.out / folder.name, args.budget))
            print(f"| {text} |  <!-- {time.monotonic() - start_time:.0f} s -->", flush=True)


if __name__ == "__main__":
    main()
