"""The draft of a data card from a folder of logs."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tustinnet.channels import LONGEST_DT, SHORTEST_DT
from tustinnet.data.columns import NUMBERED
from tustinnet.data.drafting.assignment import Assignment, Verdict
from tustinnet.data.drafting.card_text import write_card
from tustinnet.data.drafting.choice import (
    ROLE_BY_ANSWER,
    choose_channels,
    choose_system_channels,
)
from tustinnet.data.drafting.evidence import EvidenceTable, Role
from tustinnet.data.drafting.findings import (
    Choice,
    CoordinateChoice,
    Findings,
    InputChoice,
    Question,
)
from tustinnet.data.drafting.joined_files import join_logs
from tustinnet.data.drafting.logs import (
    Clock,
    Log,
    Piece,
    find_clock,
    find_pieces,
    keep_usual,
    read_logs,
    read_names,
)
from tustinnet.data.drafting.names import INPUTS, NameReading
from tustinnet.data.drafting.numbers import Numbers, Values, examine, unwrap
from tustinnet.data.drafting.positions import period_by_velocities
from tustinnet.data.drafting.relations import Slopes, compare_slopes, find_sines
from tustinnet.data.drafting.splits import Splits, choose_splits, find_conditions
from tustinnet.data.drafting.system_columns import SystemChannels
from tustinnet.data.drafting.texts_beside import name_as_described, period_beside
from tustinnet.data.readers import is_text
from tustinnet.data.text_rate import find_period, period_in_name, period_in_numbers
from tustinnet.errors import InputError
from tustinnet.shown import Brief, Shown
from tustinnet.wording import counted

_USUAL_PERIOD = 0.01  # s, assumed where nothing says it
_FEWEST_SAMPLES = 6  # samples of a record
_AT_REST = 0.05  # of the largest travel of its kind: less is the noise of a joint that rests
PERIOD = "period"
ANSWERED = ("role", "unit", "counts", "resolution")  # before the column in an answer's key
_PLAIN_FOLDERS = {"", "logs", "log", "data", "daten", "messungen", "records", "csv", "raw"}


@dataclass(frozen=True, repr=False)
class DraftColumn(Brief):
    """A column of the logs and what the draft takes it for.

    Attributes:
        name: its name.
        role: its role.
        use: its use in the card: `time`, `coordinate`, `velocity`, `input`; empty if not used.
        because: the reasons.
        unit: its unit in the card, empty if not used.
        numbers: properties of its numbers.
        margin: points by which its role is ahead of another use; infinite where nothing else was
            weighed, as of times and constants.
    """

    name: str
    role: Role
    use: str
    because: str
    unit: str
    numbers: Numbers
    margin: float = np.inf


@dataclass(frozen=True, repr=False)
class Draft(Shown):
    """A drafted data card.

    Attributes:
        text: the card in TOML.
        columns: every column of numbers, in the order of the files.
        dt: sampling period [s].
        choice: coordinates and inputs.
        clock: the time base.
        splits: the records and their splits.
        questions: what the columns do not say, with what was assumed.
        notes: remarks on how the files were read, and files that were left out.
        texts: columns that hold no numbers, and what they hold.
        rows: number of samples in all records.
        is_readable: whether the card can read a record.
    """

    text: str
    columns: tuple[DraftColumn, ...]
    dt: float
    choice: Choice
    clock: Clock
    splits: Splits
    questions: tuple[Question, ...]
    notes: tuple[str, ...]
    texts: Mapping[str, str]
    rows: int
    is_readable: bool

    def require_readable(self, folder: Path) -> None:
        """Raises unless the card has coordinates and a record that it can read.

        Raises:
            InputError: no column could be a position, or no record could be read.
        """
        positions = [f"'{c.name}'" for c in self.columns if c.role == "position"]
        if not self.choice.coordinates and self.choice.missing and positions:
            raise InputError(
                folder,
                f"{counted(len(positions), 'position')} that neither names nor numbers join to the "
                f"system's coordinates ({', '.join(positions)}): "
                f"{'; '.join(self.choice.missing)}",
                "as many positions as coordinates, or columns that are named like them",
                "lock joints that stand still, in a system file: tn.load_robot(FILE, locked={...})",
            )
        if not self.choice.coordinates:
            roles = ", ".join(f"'{c.name}' ({c.role})" for c in self.columns)
            problem = f"no column could be a position: {roles}"
            raise InputError(folder, problem, "positions that move")
        if not self.is_readable:
            expected = "records of finite numbers in which positions move"
            left_out = [note for note in self.notes if note.startswith("left out: ")]
            raise InputError(folder, (left_out or self.notes)[-1], expected)

    @property
    def typical(self) -> Piece:
        """The record to draw, of those in which most columns move: of usual length and ranges."""
        pieces = [record.piece for record in self.splits.records]
        moving = [
            sum(bool(np.ptp(np.nan_to_num(p.column(c.name)))) for c in self.columns) for p in pieces
        ]
        best = [p for p, n in zip(pieces, moving, strict=True) if n == max(moving)]
        names = [c.name for c in self.columns if c.use == "coordinate"]
        sizes = np.array([[p.seconds, *(np.ptp(p.column(n)) for n in names)] for p in best])
        usual = np.maximum(np.median(sizes, axis=0), 1e-300)
        return best[int(np.argmin(np.nansum(np.abs(sizes / usual - 1), axis=1)))]


@dataclass(frozen=True)
class Examination:
    """Knowledge of some logs, from which coordinates and inputs are chosen.

    Attributes:
        folder: the folder of the card.
        logs: the logs.
        notes: remarks on how they were read, and files that were left out.
        clock: the time base, with a period.
        period_reason: why it has that period; empty where it is assumed.
        findings: what is known of the columns.
    """

    folder: Path
    logs: Sequence[Log]
    notes: Sequence[str]
    clock: Clock
    period_reason: str
    findings: Findings


def examine_logs(
    folder: Path, files: Sequence[str], answers: Mapping[str, str] | None = None
) -> Examination:
    """Examines logs: their columns, their clock, the roles for which most evidence speaks.

    Args:
        folder: the folder of the card.
        files: the logs, below it.
        answers: answers to questions of an earlier draft, by their keys.

    Raises:
        InputError: no file has columns of numbers besides times.
    """
    notes: list[str] = []
    logs = join_logs(read_logs(folder, files, notes.append), notes.append)
    logs = name_as_described(folder, keep_usual(logs, notes.append), notes.append)
    notes += dict.fromkeys(note for log in logs for note in log.notes)
    return _examine(folder, logs, notes, answers or {})


def draft_card(
    folder: Path, files: Sequence[str], answers: Mapping[str, str] | None = None
) -> Draft:
    """Drafts a data card for logs, see `examine_logs` and `draft_examined`."""
    return draft_examined(examine_logs(folder, files, answers))


def draft_file(path: Path) -> Draft:
    """Drafts a card for a single file, which names no records.

    Raises:
        InputError: the file cannot be read, or has no column of numbers.
    """
    examination = examine_logs(path.parent, [path.name])
    return draft_examined(examination, name=path.stem, has_splits=False)


def draft_examined(
    examination: Examination,
    by_motion: Mapping[str, str] | None = None,
    *,
    name: str = "",
    has_splits: bool = True,
    system: SystemChannels | None = None,
) -> Draft:
    """Drafts a data card for logs that were examined.

    Args:
        examination: what is known of them.
        by_motion: answers that the motion of the records shows, as `check.drafting` finds them.
        name: name of the data set; that of the folder by default.
        has_splits: whether the card names the files; otherwise all logs beside it are records.
        system: coordinates and inputs that the card has to have; by default those that the columns
            show.

    Returns:
        The draft. Its `questions` say what was assumed.
    """

    def choose(examined: Examination) -> tuple[Findings, Choice]:
        findings = replace(examined.findings, by_motion=by_motion or {})
        if system is None:
            return findings, choose_channels(findings)
        return findings, choose_system_channels(findings, system)

    findings, choice = choose(examination)
    if not examination.period_reason:
        dt = examination.clock.dt or _USUAL_PERIOD
        if (period := period_by_velocities(dt, findings)) is not None:
            parts = examination.folder, examination.logs, [*examination.notes], findings.answers
            examination = _examine(*parts, period)
            findings, choice = choose(examination)
    clock, numbers, notes = examination.clock, findings.numbers, [*examination.notes]
    questions = [*choice.questions]
    if not examination.period_reason:
        text = "sampling period [s]; no column of times was found"
        questions.insert(0, Question(PERIOD, text, str(clock.dt), is_number=True))
    logs = [_without_unused_files(log, clock, choice) for log in examination.logs]
    trimmed = _trim_logs(logs, choice, notes.append)
    found = find_pieces(trimmed, clock, findings.readings, notes.append)
    usable = _usable_pieces(found, choice, notes.append)
    texts = {n: text for log in logs for n, text in log.texts.items() if "where the others" in text}
    notes += [f"'{name}' is left out: {text}" for name, text in texts.items()]
    if not choice.inputs:
        notes.append("no input was found: a fit takes the records for free motion")
    if conditions := find_conditions(found):
        differences = f"{', '.join(conditions[:4])}{', ...' if len(conditions) > 4 else ''}"
        is_period = clock.column is None and all(map(period_in_name, conditions))
        meaning = "sampling periods? each needs a card" if is_period else "loads are `groups`"
        notes.append(f"names of files differ by {differences}: {meaning}")
    pieces = usable or find_pieces(examination.logs, clock, findings.readings)
    positions = {
        c.column: [unwrap(p.column(c.column), numbers[c.column].wrap) for p in pieces]
        for c in choice.coordinates
    }
    splits = choose_splits(pieces, positions, [i.column for i in choice.inputs])
    assert clock.dt is not None
    text = write_card(
        name or _name(examination.folder),
        clock,
        clock.dt,
        choice,
        splits if has_splits else None,
        has_header=logs[0].has_header,
        has_damaged_rows=any(log.has_damaged_rows for log in logs),
        column_numbers=logs[0].numbers,
        texts=logs[0].texts,
        joined=logs[0].joined,
        period_reason=examination.period_reason,
    )
    return Draft(
        text,
        tuple(_columns(findings.readings, clock, choice, findings.verdicts, numbers)),
        clock.dt,
        choice,
        clock,
        splits,
        tuple(q for q in questions if q.key not in findings.answers),
        tuple(notes),
        logs[0].texts,
        sum(map(len, logs)),
        bool(usable),
    )


def _examine(
    folder: Path,
    logs: Sequence[Log],
    notes: list[str],
    answers: Mapping[str, str],
    by_velocities: tuple[float, str] | None = None,
) -> Examination:
    """Examines logs that were read; by velocities they may have a period [s] that nothing says."""
    readings = read_names(logs)
    clock, period_reason = find_clock(logs, readings), "the usual time between samples"
    if clock.dt is None:
        logs, stated_period = _keep_usual_period(folder, logs, notes.append)
        dt, period_reason = _find_period(folder, logs, stated_period, answers, by_velocities)
        clock = replace(clock, dt=dt)
    motion = [n for n in readings if n != clock.column and n not in clock.others]
    if not motion:
        others = [f", but '{name}': {text}" for log in logs for name, text in log.texts.items()]
        problem = "no column besides the times" + "".join(others[:1])
        raise InputError(folder, problem, "columns of positions and inputs")
    shown = _choose_samples(find_pieces(logs, clock, readings))
    numbers = {n: examine([p.column(n) for p in shown]) for n in readings}
    samples = {n: [unwrap(p.column(n), numbers[n].wrap) for p in shown] for n in motion}
    times = [p.t for p in shown]
    sines = find_sines(readings, samples, times)
    for cosine, sine in sines.items():
        pairs = zip(samples[cosine], samples.pop(sine), strict=True)
        samples[cosine] = [np.unwrap(np.arctan2(b, a)) for a, b in pairs]
        numbers[cosine] = examine(samples[cosine])
    slopes = compare_slopes(samples, times)
    known: dict[str, Role] = {
        n: _role(answers[f"role {n}"]) for n in samples if f"role {n}" in answers
    }
    for cosine in sines:
        known[cosine] = "position"
    verdicts = _judge(
        {n: readings[n] for n in samples},
        numbers,
        samples,
        slopes,
        known,
    )
    for cosine, sine in sines.items():
        reason = f"'{cosine}' and '{sine}' are cosine and sine of one angle"
        verdicts[cosine] = Verdict("position", (reason,))
    findings = Findings(readings, numbers, samples, times, slopes, verdicts, answers, {}, sines)
    return Examination(folder, logs, notes, clock, period_reason, findings)


def _find_period(
    folder: Path,
    logs: Sequence[Log],
    stated_period: float | None,
    answers: Mapping[str, str],
    by_velocities: tuple[float, str] | None,
) -> tuple[float, str]:
    """The sampling period [s] of files without times, and the reason; empty where it is assumed."""
    if PERIOD in answers:
        return float(answers[PERIOD]), "as you say"
    if (period := _only_period({stated_period})) is not None:
        return period, "by the sampling rate that the files say"
    if (by_text := period_beside(folder, {log.file for log in logs})) is not None:
        return by_text
    if by_velocities is not None:
        return by_velocities
    return _only_period({period_in_name(log.file) for log in logs}) or _USUAL_PERIOD, ""


def _said_period(folder: Path, log: Log) -> float | None:
    """The sampling period [s] that lines or numbers beside the columns of a file say."""
    if is_text(folder / log.file):
        return find_period(folder / log.file)
    return period_in_numbers(log.texts)


def _keep_usual_period(
    folder: Path, logs: Sequence[Log], on_message: Callable[[str], None]
) -> tuple[Sequence[Log], float | None]:
    """The logs of the period that most samples have by what files say, and that period [s].

    All logs and None where some say none.
    """
    periods = {log.file: _said_period(folder, log) for log in logs}
    samples = Counter[float | None]()
    for log in logs:
        samples[periods[log.file]] += len(log)
    usual = samples.most_common(1)[0][0]
    if None in samples:
        return logs, None
    for file, period in periods.items():
        if period != usual:
            on_message(f"left out: {file}: a period of {period:g} s, and not {usual:g} s")
    return [log for log in logs if periods[log.file] == usual], usual


def _only_period(periods: set[float | None]) -> float | None:
    """The period that all files say, where it is a possible one."""
    (period, *others) = periods
    is_possible = period is not None and SHORTEST_DT <= period <= LONGEST_DT
    return period if is_possible and not others else None


def _without_unused_files(log: Log, clock: Clock, choice: Choice) -> Log:
    """A log without other files of its record of which the card uses no column."""
    used = [clock.column or "", *choice.motion, *(i.column for i in choice.inputs)]
    return replace(
        log,
        joined={
            label: file
            for label, file in log.joined.items()
            if any(name.startswith(f"{label}/") for name in used)
        },
    )


def _trim_logs(logs: Sequence[Log], choice: Choice, on_message: Callable[[str], None]) -> list[Log]:
    """The logs over the time that all columns of the card have, as loading takes them."""
    trimmed: list[Log] = []
    for log in logs:
        common = log.trim(choice.motion, [i.column for i in choice.inputs])
        if len(common) < _FEWEST_SAMPLES <= len(log):
            on_message(f"left out: {log.place}: the columns have no time in common")
            continue
        if len(common) < len(log):
            lost = len(log) - len(common)
            on_message(
                f"{log.place}: {lost} of {len(log)} samples left out: other columns have none there"
            )
        trimmed.append(common)
    return trimmed


def _usable_pieces(
    pieces: Sequence[Piece], choice: Choice, on_message: Callable[[str], None]
) -> list[Piece]:
    """Records that a card can read: of finite numbers, whose clock rises, in which something moves.

    Rows that are not finite at either end of a record are cut off.
    """
    coordinates = [c.column for c in choice.coordinates]
    used = [*choice.motion, *(i.column for i in choice.inputs)]
    usable: list[Piece] = []
    for piece in pieces:
        place = piece.place
        finite = np.isfinite(piece.t) & np.append(np.diff(piece.t) > 0, True)
        for name in used:
            finite &= np.isfinite(piece.column(name))
        rows = np.flatnonzero(finite)
        if (np.diff(piece.t) <= 0)[rows[0] : rows[-1]].any() if len(rows) else False:
            on_message(f"left out: {place}: times that do not rise")
            continue
        if len(rows) < _FEWEST_SAMPLES or not finite[rows[0] : rows[-1] + 1].all():
            on_message(f"left out: {place}: numbers that are not finite, or too few samples")
            continue
        if len(rows) < len(finite):
            on_message(
                f"{place}: cut off at its ends, not finite or without a time of their own: "
                + counted(len(finite) - len(rows), "row")
            )
            piece = piece.part(int(rows[0]), int(rows[-1]) + 1, "rows lack numbers or times")
        # a sensor at rest flickers between neighbouring values
        if coordinates and all(len(np.unique(piece.column(c))) <= 3 for c in coordinates):
            names = ", ".join(f"'{name}'" for name in coordinates)
            on_message(f"left out: {place}: nothing moves ({names}: three values at most)")
        else:
            usable.append(piece)
    return usable


def _name(folder: Path) -> str:
    """A name for the logs of a folder: its own, or that of the folder above a plain `logs`."""
    path = folder.resolve()
    return (
        path.parent.name if path.name.lower() in _PLAIN_FOLDERS and path.parent.name else path.name
    )


def _judge(
    readings: Mapping[str, NameReading],
    numbers: Mapping[str, Numbers],
    samples: Mapping[str, Sequence[Values]],
    slopes: Slopes,
    known: Mapping[str, Role],
) -> dict[str, Verdict]:
    """The roles of columns that are neither times nor counters, some of which are known."""
    resting = _find_resting(readings, numbers)
    moving = {n: r for n, r in readings.items() if not numbers[n].constant and n not in resting}
    constant = Verdict("constant", ("it never changes",))
    if not moving:
        return dict.fromkeys(readings, constant)
    lengths = [len(values) for values in samples[next(iter(moving))]]
    # five records are compared, in fewer rows the more columns there are
    chosen = np.linspace(0, len(lengths) - 1, min(len(lengths), 5)).astype(int)
    most = max(500, 30_000 // max(10, len(moving)))
    first = {k: max(0, (lengths[k] - most) // 2) for k in chosen.tolist()}
    records = [
        np.column_stack([_fill(samples[n][k][row : row + most]) for n in moving])
        for k, row in first.items()
    ]
    table = EvidenceTable(moving, numbers, records, slopes.for_columns(moving))
    verdicts = Assignment(table, known).verdicts()
    if not {v.role for v in verdicts.values()} & {"input", "set point"}:
        for name, reading in readings.items():
            is_input = reading.quantity in INPUTS or name.startswith(NUMBERED)
            if name not in moving and numbers[name].distinct > 1 and is_input:
                reason = "it never changes in a record, and differs between records"
                verdicts[name] = Verdict("input", (reason,), "other", 0.0)
    verdicts |= {n: Verdict("other", ("at rest, where others of its kind move",)) for n in resting}
    return {n: verdicts.get(n, constant) for n in readings}


def _find_resting(readings: Mapping[str, NameReading], numbers: Mapping[str, Numbers]) -> set[str]:
    """The columns of joints that rest while others of their kind move, by names and numbers.

    Their positions do not change, or no more than by noise; velocities and currents flicker.
    """
    kinds: dict[tuple[str, ...], list[str]] = {}
    for name, reading in readings.items():
        is_place = reading.quantity == "position" and reading.qualifier != "command"
        if is_place and reading.object and numbers[name].range:
            words = tuple(w for w in reading.words if not w.isdigit())
            kinds.setdefault((*words, reading.unit), []).append(name)
    resting: set[frozenset[str]] = set()
    for names in kinds.values():
        spans = {n: float(np.ptp(numbers[n].range or 0.0)) for n in names}
        still = [n for n in names if spans[n] < _AT_REST * max(spans.values())]
        resting |= {readings[n].object for n in still if numbers[n].is_white or numbers[n].constant}
    return {n for n, r in readings.items() if r.object in resting}


def _fill(values: Values) -> Values:
    """A column whose samples that are not finite are those between their neighbours."""
    finite = np.isfinite(values)
    if finite.all() or not finite.any():
        return np.nan_to_num(values, posinf=0.0, neginf=0.0)
    rows = np.arange(len(values))
    return np.interp(rows, rows[finite], values[finite])


def _role(answer: str) -> Role:
    """The role that an answer says.

    Raises:
        InputError: it says none.
    """
    if answer not in ROLE_BY_ANSWER:
        raise InputError("answers", f"a role '{answer}'", ", ".join(ROLE_BY_ANSWER))
    return ROLE_BY_ANSWER[answer]


def _choose_samples(pieces: Sequence[Piece]) -> list[Piece]:
    """Records, or the middle parts of long ones, on which the evidence rests."""
    share = max(1, 200_000 // len(pieces))
    chosen: list[Piece] = []
    for piece in pieces:
        n = len(piece.t)
        first = max(0, (n - share) // 2)
        chosen.append(piece if n <= share else piece.part(first, first + share, piece.because))
    return chosen


def _columns(
    readings: Mapping[str, object],
    clock: Clock,
    choice: Choice,
    verdicts: Mapping[str, Verdict],
    numbers: Mapping[str, Numbers],
) -> list[DraftColumn]:
    """Columns of the logs, each with its role, its use and the reasons."""
    velocities = {c.velocity.column: c.velocity for c in choice.coordinates if c.velocity}
    coordinates = {c.column: c for c in choice.coordinates}
    inputs = {i.column: i for i in choice.inputs}
    columns: list[DraftColumn] = []
    for name in readings:
        role: Role
        use, unit = "", ""
        if name == clock.column:
            role, use, because, unit = "time", "time", clock.because, clock.unit
        elif name in clock.others:
            because = clock.others[name]
            role = "time" if because.startswith("times") else "counter"
        elif name not in verdicts:
            role, use, because = "position", "coordinate", "the sine of an angle"
        else:
            role, because = verdicts[name].role, verdicts[name].because
            if name in coordinates:
                use, unit = "coordinate", coordinates[name].unit
                because = _with_doubts(coordinates[name])
            elif name in inputs:
                use, unit = "input", inputs[name].unit
                because = _with_doubts(inputs[name])
            elif name in velocities:
                use, unit = "velocity", velocities[name].unit or ""
            else:
                because = choice.unused.get(name, because)
        margin = verdicts[name].margin if name in verdicts else np.inf
        columns.append(DraftColumn(name, role, use, because, unit, numbers[name], margin))
    return columns


def _with_doubts(channel: CoordinateChoice | InputChoice) -> str:
    """Why a column was chosen, and what to check, as the card says it."""
    return "; ".join([*channel.because, *(f"check {doubt}" for doubt in channel.doubts)])
