"""The check of records on planted faults, and on clean folders, where every finding is an alarm.

python benchmarks/check.py [faults|measured|late|clean|few|time] [DATA]

Without a word all of it. DATA is a folder with the measured data sets (`qube_servo2`,
`double_pendulum_dfki`, `emps`), which are clean, too; without it there are fewer clean folders.
Under `measured` it is any folder with folders of logs: what is said of each as a user meets it.
"""

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from simulated.faults import FAULTS, LATE_FAULTS, MACHINES, Fault, simulate_logs

import tustinnet as tn
from tustinnet.check.check import check
from tustinnet.check.drafting import draft_files
from tustinnet.data.card import Card
from tustinnet.data.catalog import locate
from tustinnet.data.declaration import declare, parse_toml
from tustinnet.data.drafting.files import list_logs
from tustinnet.data.inspection import held_equilibrium
from tustinnet.data.loading import load_folder
from tustinnet.data.readers import is_log
from tustinnet.data.spoiled import find_without_model
from tustinnet.errors import InputError
from tustinnet.finding import Finding
from tustinnet.report.tables import Table

_SEEDS = (1, 2, 3)  # of the clean machines; faults are planted into those of seed 0
_FEW_SEEDS, _FEW_SETS = (4, 5), 12  # of machines; sets of a few records of each
_TWINS = range(6)
_EXAMPLES = Path(__file__).parents[1] / "examples"
_LONG = 10**6  # samples


def check_folder(folder: Path, card: Path | None = None) -> tuple[tuple[Finding, ...], float]:
    """Findings in a folder of logs, and the seconds that the check takes."""
    place, content = locate(folder, card)
    return _timed(load_folder(place, content), content)


def _timed(records: tn.DataSet, card: object = None) -> tuple[tuple[Finding, ...], float]:
    begun = time.perf_counter()
    findings = check(records, card)  # pyright: ignore[reportArgumentType]
    return findings, time.perf_counter() - begun


def run_faults(faults: Sequence[Fault]) -> Table:
    """A row for each fault: whether it is named, by which finding, and what else is said."""
    rows, found, others = [], 0, 0
    with tempfile.TemporaryDirectory() as place:
        for k, fault in enumerate(faults):
            findings, seconds = check_folder(fault.write(Path(place) / str(k)))
            named = [f for f in findings if fault.is_named_by(f)]
            more = sum(f.is_serious for f in findings) - len(named)
            found, others = found + bool(named), others + more
            text = f"{named[0].severity}: {named[0].size}" if named else "–"
            rows.append(
                [
                    fault.name,
                    fault.machine,
                    "yes" if named else "NO",
                    text[:70],
                    str(more),
                    f"{seconds:.2f}",
                ]
            )
    title = f"{found} of {len(faults)} planted faults named; {others} other findings beside them"
    return Table(["fault", "machine", "named", "finding", "others", "s"], rows, title=title)


def run_measured(data: Path | None) -> Table:
    """A row for each folder of logs: numbers of findings, and each severe or spoiled part.

    A folder without a card has the one that `tustinnet init --yes` drafts.
    """
    rows, severe, warnings = [], 0, 0
    for folder in () if data is None else log_folders(data):
        name = str(folder.relative_to(data)) if data else ""
        try:
            card = card_of(folder)
            records = load_folder(folder, card)
        except InputError as error:
            rows.append([name, "–", "–", f"not read: {error}"[:120]])
            continue
        findings, _ = _timed(records, card)
        spoiled = [p for e in records for p in find_without_model(e, held_equilibrium(e))]
        said = [
            f"{f.what} ({f.size}) in {', '.join(f.records) or 'all'}"
            for f in findings
            if f.severity == "severe"
        ]
        counts = len(said), sum(f.severity == "warning" for f in findings)
        severe, warnings = severe + counts[0], warnings + counts[1]
        said += [f"spoiled: {p.place}: {p.reason}" for p in spoiled]
        rows.append([name, *map(str, counts), ""])
        rows += [["", "", "", text[:200]] for text in said]
    title = f"{severe} severe findings and {warnings} warnings on logs as they are"
    return Table(
        ["folder", "severe", "warnings", "severe findings, spoiled parts"], rows, title=title
    )


def log_folders(place: Path) -> Iterator[Path]:
    """Folders with a card or logs at or below a place; not those below such a folder."""
    files = sorted(place.iterdir())
    try:
        locate(place)
    except InputError:
        if not any(is_log(file) for file in files if file.is_file()):
            for file in files:
                yield from log_folders(file) if file.is_dir() else ()
            return
    yield place


def card_of(folder: Path) -> Card:
    """The card of a folder: its own, that of an example, or a draft."""
    example = _EXAMPLES / f"{folder.name}.toml"
    try:
        return locate(folder, example if example.is_file() else None)[1]
    except InputError:
        draft = draft_files(*list_logs([folder]))
        return declare(parse_toml(draft.text), Card, folder)


def clean_folders(data: Path | None, place: Path) -> Iterator[tuple[str, Path, Path | None]]:
    """Names, folders and cards of clean logs."""
    for name in MACHINES:
        for seed in _SEEDS:
            logs = simulate_logs(name, seed, fit=8, held_out=3, longest=12.0)
            yield f"{name} {seed}", logs.write(place / f"{name}-{seed}"), None
    if data is not None:
        for card in sorted(_EXAMPLES.glob("*.toml")):
            stem = "emps" if card.stem.startswith("emps") else card.stem
            if (data / stem).is_dir():
                yield card.stem, data / stem, card


def clean_sets(data: Path | None) -> Iterator[tuple[str, tn.DataSet]]:
    """Names and records of clean data that are made or cut in memory."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from tustinnet.systems.qube_servo2_twin import twin

    for seed in _TWINS:
        yield f"twin {seed}", twin(seed)
    if data is not None and (data / "qube_servo2").is_dir():
        qube = tn.load(data / "qube_servo2")
        yield "qube", qube
        for split in qube.splits:
            yield f"qube {split}", qube.split(split)
        # of falls alone the check says, rightly, that the voltage never moves
        yield "qube later half", replace(qube, experiments=qube.experiments[len(qube) // 2 :])
        yield "qube noise", replace(qube, experiments=tuple(e for e in qube if e.forced))


def run_clean(data: Path | None) -> Table:
    """A row for each clean folder with findings of the two upper severities."""
    rows, folders, alarms, longest = [], 0, 0, 0.0
    with tempfile.TemporaryDirectory() as place:
        results = [
            *((n, *check_folder(f, c)) for n, f, c in clean_folders(data, Path(place))),
            *((n, *_timed(records)) for n, records in clean_sets(data)),
        ]
    for name, findings, seconds in results:
        folders, longest = folders + 1, max(longest, seconds)
        serious = [f for f in findings if f.is_serious]
        alarms += bool(serious)
        rows += [[name, f.severity, ", ".join(f.records), f.text[:90]] for f in serious]
    title = f"{alarms} of {folders} clean folders with a false alarm; at most {longest:.1f} s"
    return Table(["folder", "severity", "records", "alarm"], rows, title=title)


def run_few() -> Table:
    """A row for each false alarm in random sets of 3 to 8 clean records of a machine.

    Few records, of other kinds of motion each, are those that a model of the others fails on.
    """
    rng = np.random.default_rng(0)
    rows, sets, alarms = [], 0, 0
    for name in MACHINES:
        for seed in _FEW_SEEDS:
            with tempfile.TemporaryDirectory() as place:
                logs = simulate_logs(name, seed, fit=8, held_out=3, longest=12.0)
                folder, card = locate(logs.write(Path(place) / "logs"))
                records = load_folder(folder, card)
            for _ in range(_FEW_SETS):
                size = rng.integers(3, min(8, len(records)) + 1)
                chosen = tuple(records[k] for k in rng.permutation(len(records))[:size])
                findings, _ = _timed(replace(records, experiments=chosen), card)
                serious = [f for f in findings if f.is_serious]
                sets, alarms = sets + 1, alarms + bool(serious)
                rows += [
                    [f"{name} {seed}", ", ".join(e.name for e in chosen), f.text[:90]]
                    for f in serious
                ]
    title = f"{alarms} of {sets} sets of a few clean records with a false alarm"
    return Table(["machine", "records", "alarm"], rows, title=title)


def run_times() -> Table:
    """Seconds of the check of 21 records of 1,000 samples, and of a record of a million."""
    rng = np.random.default_rng(0)

    def record(name: str, samples: int) -> tn.Experiment:
        drive = np.repeat(rng.uniform(-3, 3, samples // 20 + 1), 20)[:samples]
        return tn.from_arrays(
            *_swing(drive),
            dt=0.01,
            coordinates={"a": "angular", "b": "angular"},
            inputs={"u": "V"},
            name=name,
        )

    rows = []
    for count, samples in ((21, 1000), (1, _LONG)):
        records = tn.DataSet("times", tuple(record(f"r{k}", samples) for k in range(count)))
        _, seconds = _timed(records)
        rows.append([str(count), str(samples), f"{seconds:.2f}"])
    return Table(["records", "samples", "s"], rows, title="Seconds of the check")


def _swing(drive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two coupled pendulums that are driven, their angles by encoders, and the drive."""
    dt, count = 0.01, 2 * np.pi / 4096
    a = b = v = w = 0.0
    q = np.empty((len(drive), 2))
    for k, u in enumerate(drive):
        q[k] = a, b
        twist = 8.0 * (a - b)
        v += dt * (-20 * np.sin(a) - twist - 0.8 * v + 6 * u)
        w += dt * (-30 * np.sin(b) + twist - 0.5 * w)
        a, b = a + dt * v, b + dt * w
    return np.round(q / count) * count, drive


def main(arguments: Sequence[str]) -> None:
    """Prints the tables that are asked for."""
    words = ("faults", "measured", "late", "clean", "few", "time")
    chosen = [a for a in arguments if a in words] or [*words]
    folder = next((Path(a) for a in arguments if a not in words), None)
    tables = {
        "faults": lambda: run_faults(FAULTS),
        "measured": lambda: run_measured(folder),
        "late": lambda: run_faults(LATE_FAULTS),
        "clean": lambda: run_clean(folder),
        "few": run_few,
        "time": run_times,
    }
    for word in chosen:
        print(tables[word]().markdown(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
