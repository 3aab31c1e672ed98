"""How good are the models of `tustinnet fit` on machines that it was not developed on?

    python benchmarks/machines.py write DIR [NAME ...]
    python benchmarks/machines.py run DIR [NAME ...] --budget 5min [--system] --out ROWS.md

`write` simulates twelve machines with their sensors and writes for each a folder: `logs/` with the
records for fitting and the data card that a user would write, `heldout/` with records of other
amplitudes and kinds, `system.py` with its equations of motion and begin values that are wrong. The
machines have effects that `system.py` has not: friction that drifts, dead zones, backlash,
saturation, eccentric encoders.

`run` fits each machine by the command `tustinnet fit logs --budget ...`, gives the delivered model
the held-out records, and writes a table. Rows of finished machines are kept in a file beside it
(`ROWS.jsonl`): those are not run again. Another budget or another use of `--system` needs another
file.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from simulated.machines import MACHINES
from simulated.measurement import write_records

SYSTEMS = Path(__file__).parent / "simulated" / "systems"
GRACE = 1.3  # of the budget, after which a fit is ended
CUT = "Traceback (most recent call last)"


def system_file(name: str) -> Path:
    """The system file of a machine."""
    return SYSTEMS / f"{name.replace('-', '_')}.py"


def write(folder: Path, names: Sequence[str], seed: int = 0) -> None:
    """Writes the folders of some machines.

    Args:
        folder: where the folders of machines are made.
        names: the machines.
        seed: everything random follows from it.
    """
    for name in names:
        machine = MACHINES[name](True)
        rng = np.random.default_rng([seed, list(MACHINES).index(name)])
        for part, runs in zip(("logs", "heldout"), machine.runs(rng), strict=True):
            write_records(machine, runs, folder / name / part, rng)
        shutil.copy(system_file(name), folder / name / "system.py")
        print(f"{folder / name}", flush=True)


# --- scores, in a process of its own ---


def rms(
    measured: Sequence[np.ndarray], simulated: Sequence[np.ndarray], kinds: Sequence[str]
) -> float:
    """The mean RMSE of records, errors of angles within half a turn; infinite where one diverges.

    Args:
        measured: positions of each record, (n, n_q) [rad or m].
        simulated: of each record, likewise.
        kinds: `angular` or `linear`, of each coordinate.
    """
    angular = np.array([kind == "angular" for kind in kinds])
    rmse = []
    for q, p in zip(measured, simulated, strict=True):
        if not np.isfinite(p).all():
            return np.inf
        error = p - q
        error = np.where(angular, np.arctan2(np.sin(error), np.cos(error)), error)
        rmse.append(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    return float(np.mean(rmse))


def spread(measured: Sequence[np.ndarray], kinds: Sequence[str]) -> float:
    """The distance of positions from their mean, as `rms` measures it; angles within turns.

    Args:
        measured: positions of each record, (n, n_q) [rad or m].
        kinds: `angular` or `linear`, of each coordinate.
    """
    centres = []
    for q in measured:
        circular = np.arctan2(np.sin(q).mean(axis=0), np.cos(q).mean(axis=0))
        is_angle = np.array([kind == "angular" for kind in kinds])
        # the mean direction of an angle that stays within a turn is near its mean
        centres.append(np.where(is_angle, circular, q.mean(axis=0)) + np.zeros_like(q))
    return rms(measured, centres, kinds)


def score(run: Path, folder: Path) -> dict[str, float | str | list[float]]:
    """The errors of a run's chosen model on held-out records.

    Free runs start, and are as long, as those by which the run chose.

    Args:
        run: folder of the run.
        folder: folder of the held-out records.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    import tustinnet as tn

    summary = json.loads((run / "summary.json").read_text())
    best = next(c for c in summary["candidates"] if c["name"] == summary["best"])
    start, records = next(iter(best["starts"])), list(tn.load(folder))
    system = run / "system.py"
    try:
        model = tn.load_model(run / "model.safetensors", str(system) if system.is_file() else None)
    except tn.InputError:  # a model without equations of motion takes none
        model = tn.load_model(run / "model.safetensors")
    longest = max(e.t[-1] - e.t[0] for e in records)
    horizon = summary["horizon"] if summary["horizon"] and summary["horizon"] < longest else None
    scores = tn.evaluate(model, records, start, horizon=horizon)
    measured, n_q = [e.q for e in records], records[0].q.shape[1]
    kinds = [c.kind for c in records[0].channels.coordinates]
    return {
        "unit": summary["unit"],
        "start": start,
        "spread": spread(measured, kinds),
        "rmse": rms(measured, [s.simulated[:, :n_q] for s in scores], kinds),
        "by_record": [s.rmse for s in scores],
    }


# --- rows ---


@dataclass(frozen=True)
class Row:
    """The result of one machine; None where there is none.

    Attributes:
        machine: its name.
        chosen: the candidate that was chosen.
        unit: unit of all RMSE.
        horizon: length of the free runs [s], None for whole records.
        claimed: RMSE that the fit claims for new records.
        claimed_error: its standard error.
        heldout: RMSE on the held-out records, errors of angles within half a turn.
        by_record: RMSE of each held-out record, as `tustinnet evaluate` has them.
        spread: distance of the held-out positions from their mean, root mean square.
        typical: error that the fit claims as typical for new records, and the range of nine of ten.
        linear: RMSE that the fit has for the linear candidate.
        wall: time that the fit took [s].
        budget: its budget [s].
        used: time of the command without that of candidates that have no score, and without what
            was left of the budget [s].
        exit_code: of the command; None where it was ended after 1.3 budgets.
        traceback: whether its output has a traceback.
        sentences: what the fit says of its choice.
        problem: what went wrong with the scores.
    """

    machine: str
    chosen: str | None = None
    unit: str = ""
    horizon: float | None = None
    claimed: float | None = None
    claimed_error: float | None = None
    heldout: float | None = None
    by_record: Sequence[float] = ()
    spread: float | None = None
    typical: Sequence[float] = ()
    linear: float | None = None
    wall: float = 0.0
    budget: float = 0.0
    used: float = 0.0
    exit_code: int | None = None
    traceback: bool = False
    sentences: Sequence[str] = ()
    problem: str = ""


def append_row(file: Path, row: Row) -> None:
    """Adds a row to a file of JSON lines."""
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(asdict(row)) + "\n")


def read_rows(file: Path) -> list[Row]:
    """The rows of a file of JSON lines; none if there is no such file."""
    if not file.is_file():
        return []
    rows = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    return [
        Row(**{k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}) for row in rows
    ]


def table(rows: Sequence[Row]) -> str:
    """The rows as a Markdown table."""
    columns = [
        "machine",
        "chosen",
        "claimed",
        "held out",
        "typical claimed",
        "held out",
        "in range",
        "spread",
        "linear",
        "wall / budget",
        "used / budget",
        "exit",
        "traceback",
    ]
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]

    def number(value: float | None, unit: str = "") -> str:
        return "" if value is None else f"{value:.3g} {unit}".rstrip()

    for row in rows:
        error = "" if row.claimed_error is None else f" ± {row.claimed_error:.2g}"
        horizon = "" if row.horizon is None else f" ({row.horizon:.2g} s)"
        typical, inside = "", ""
        if row.typical:
            middle, low, high = row.typical
            typical = f"{middle:.2g} ({low:.2g} to {high:.2g})"
            inside = f"{sum(low <= x <= high for x in row.by_record)} of {len(row.by_record)}"
        geometric = float(np.exp(np.mean(np.log(row.by_record)))) if row.by_record else None
        ended = "stopped" if row.exit_code is None else str(row.exit_code)
        cells = [
            row.machine,
            row.chosen or row.problem,
            number(row.claimed) + error + f" {row.unit}",
            number(row.heldout) + horizon,
            typical,
            number(geometric),
            inside,
            number(row.spread),
            number(row.linear),
            *(number(x / row.budget if row.budget else None) for x in (row.wall, row.used)),
            ended,
            "yes" if row.traceback else "no",
        ]
        lines.append(f"| {' | '.join(cell.strip() for cell in cells)} |")
    return "\n".join(lines) + "\n"


def fit_and_score(folder: Path, budget: str, system: bool, command: str, runs: Path) -> Row:
    """Fits a machine by the command, and scores the model on the held-out records.

    Args:
        folder: folder of the machine.
        budget: as the command takes it, such as 5min.
        system: whether the fit is given the system file.
        command: the command `tustinnet`.
        runs: where the run's folder is made.
    """
    from tustinnet.cli.select import parse_seconds

    name, seconds = folder.name, parse_seconds(budget) or 0.0
    run = runs / name
    shutil.rmtree(run, ignore_errors=True)
    words = [command, "fit", str(folder / "logs"), "--out", str(run), "--budget", budget]
    words += ["--system", str(folder / "system.py")] if system else []
    began, log = time.monotonic(), runs / f"{name}.log"
    runs.mkdir(parents=True, exist_ok=True)
    exit_code = None
    with log.open("w") as output:
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT)
        try:
            exit_code = process.wait(GRACE * seconds)
        except subprocess.TimeoutExpired:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
    result = {
        "machine": name,
        "wall": time.monotonic() - began,
        "budget": seconds,
        "exit_code": exit_code,
        "traceback": CUT in log.read_text(errors="replace"),
    }
    if not (run / "summary.json").is_file():
        return Row(**result, problem="no model")
    summary = json.loads((run / "summary.json").read_text())
    candidates = {c["name"]: c for c in summary["candidates"]}
    best = candidates[summary["best"]]
    first = next(iter(best["starts"].values()))
    linear = next(iter(candidates.get("linear", {}).get("starts", {}).values()), {})
    claim, parts = summary["claim"], summary["seconds_by_part"]
    tried = parts.get("candidates", 0.0)
    result |= {
        "chosen": summary["best"],
        "unit": summary["unit"],
        "horizon": summary["horizon"],
        "claimed": first["mean"],
        "claimed_error": first["standard_error"],
        "linear": linear.get("mean"),
        "sentences": tuple(f["text"] for f in summary["findings"]),
        "typical": () if claim is None else (claim["typical"], claim["low"], claim["high"]),
        "used": result["wall"]
        - tried
        + sum(c["seconds"] for c in candidates.values() if c.get("starts")),
    }
    words = [sys.executable, str(Path(__file__)), "score", str(run), str(folder / "heldout")]
    scored = subprocess.run(words, capture_output=True, text=True, check=False)
    if scored.returncode:
        return Row(**result, problem=scored.stderr.strip().splitlines()[-1])
    values = json.loads(scored.stdout.splitlines()[-1])
    return Row(
        **result,
        heldout=values["rmse"],
        spread=values["spread"],
        by_record=tuple(values["by_record"]),
    )


def run(
    folder: Path, names: Sequence[str], budget: str, system: bool, command: str, out: Path
) -> None:
    """Fits and scores the machines that have no row yet; prints and writes the table."""
    runs = out.with_suffix("")
    if runs.resolve() == folder.resolve():
        raise SystemExit(f"{out}: its runs would take the place of the machines; another name")
    out.parent.mkdir(parents=True, exist_ok=True)
    lines = out.with_suffix(".jsonl")
    done = {row.machine for row in read_rows(lines)}
    for name in names:
        if name not in done:
            row = fit_and_score(folder / name, budget, system, command, runs)
            append_row(lines, row)
            print(table([row]).splitlines()[-1], flush=True)
    text = table([row for row in read_rows(lines) if row.machine in names])
    out.write_text(text, encoding="utf-8")
    print(f"\n{text}")


def main() -> None:
    """Reads the arguments and does what they say."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    writing, running = verbs.add_parser("write"), verbs.add_parser("run")
    for verb in (writing, running):
        verb.add_argument("folder", type=Path, help="folder of the machines' folders")
        verb.add_argument("names", nargs="*", metavar="NAME", help="machines; all by default")
    writing.add_argument("--seed", type=int, default=0)
    running.add_argument("--budget", default="5min", help="of each fit, as 5min")
    running.add_argument("--system", action="store_true", help="give the fit the system file")
    running.add_argument("--command", default="tustinnet", help="the command (default: tustinnet)")
    running.add_argument("--out", type=Path, required=True, help="the table, a file .md")
    scoring = verbs.add_parser("score", help="one run, as `run` does it in a process of its own")
    scoring.add_argument("run", type=Path)
    scoring.add_argument("heldout", type=Path)
    args = parser.parse_args()
    if args.verb == "score":
        print(json.dumps(score(args.run, args.heldout)))
        return
    names = args.names or list(MACHINES)
    unknown = [name for name in names if name not in MACHINES]
    if unknown:
        parser.error(f"no machine {', '.join(unknown)}; expected {', '.join(MACHINES)}")
    if args.verb == "write":
        write(args.folder, names, args.seed)
    else:
        os.environ.setdefault("COLUMNS", "160")
        run(args.folder, names, args.budget, args.system, args.command, args.out)


if __name__ == "__main__":
    main()
