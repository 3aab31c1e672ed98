"""Parts of records that spoil a fit: what they are, their lines for the data card, their removal.

A part is a record or a stretch of it. This module finds those that need no model: a mechanism that
moves though its inputs are zero, a position that is unstable and held. `evaluate.spoiled` finds
others by the errors of a model.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.data.declaration import quote
from tustinnet.data.experiment import Experiment
from tustinnet.finding import Finding, make_finding
from tustinnet.signals.equilibria import HeldEquilibrium
from tustinnet.signals.transients import is_slow, rest_thresholds

Cause = Literal["unlogged force", "other conditions", "unstable phase"]

KEY = "spoiled"  # in headers and summaries
_REACH = 2  # samples ahead of one of which its derived velocity knows
FEWEST_SAMPLES = 50  # samples of a part of a record that is worth keeping


@dataclass(frozen=True)
class SpoiledPart:
    """A record, or a stretch of it, that spoils a fit.

    Attributes:
        record: the record.
        cause: what is probably wrong with it.
        samples: first sample of the stretch and the one after its last; None for a whole record.
        seconds: beginning and end of the stretch [s], from the record's first sample on; None for
            a whole record.
        reason: why it is named, in words.
        card: the line for the data card that mends it, empty where there is none.
        removable: whether a fit leaves it out where that is requested.
    """

    record: str
    cause: Cause
    samples: tuple[int, int] | None
    seconds: tuple[float, float] | None
    reason: str
    card: str = ""
    removable: bool = True

    @property
    def place(self) -> str:
        """The record, and the times of the stretch, in words."""
        if self.seconds is None:
            return self.record
        return f"{self.record}, {self.seconds[0]:.4g} to {self.seconds[1]:.4g} s"

    @property
    def sentence(self) -> str:
        """The place, the reason and the line for the card."""
        return f"{self.place}: {self.reason}" + (f"; card: {self.card}" if self.card else "")

    def as_plain(self) -> dict[str, Any]:
        """The part as plain values, with its sentence."""
        return {**asdict(self), "sentence": self.sentence}


def spoiled_stretch(e: Experiment, first: int, stop: int, cause: Cause, reason: str) -> SpoiledPart:
    """A stretch of a record that spoils a fit, with the entries of the parts that remain.

    Args:
        e: the record.
        first: its first sample.
        stop: the sample after its last.
        cause: what is probably wrong.
        reason: why it is named.
    """
    seconds = float(e.t[first] - e.t[0]), float(e.t[stop - 1] - e.t[0])
    entries = [card_entry(e, a, b) for a, b in _remaining(e, [(first, stop)])]
    card = ", ".join(entry for entry in entries if entry)
    return SpoiledPart(e.name, cause, (first, stop), seconds, reason, card)


def spoiled_record(e: Experiment, cause: Cause, reason: str) -> SpoiledPart:
    """A record that spoils a fit as a whole, with an entry that gives it a group of its own."""
    entry = card_entry(e, 0, len(e), groups={"setup": e.name})
    return SpoiledPart(e.name, cause, None, None, reason, entry)


def card_entry(e: Experiment, first: int, stop: int, groups: dict[str, str] | None = None) -> str:
    """The entry of some samples of a record under `[splits]` of a data card.

    Args:
        e: the record.
        first: the first sample.
        stop: the sample after the last.
        groups: conditions beside those of the record.

    Returns:
        An inline table of TOML; empty for a record that is of no file, or that is a part of a file
        and was resampled, of which nothing says the rows.
    """
    is_whole = first == 0 and stop == len(e)
    if not e.source or (e.recording is not None and e.first_row):
        return ""
    parts = [f"file = {quote(e.source)}"]
    cell = re.search(r"\[(\d+)\]$", e.name)
    if cell and e.source.lower().endswith(".mat"):
        parts.append(f"cell = {cell[1]}")
    if e.first_row:
        parts.append(f"rows = [{e.first_row + first}, {e.first_row + stop}]")
    elif not is_whole:
        # in the middle between two samples, so that rounding moves none
        elapsed = e.t - e.t[0]
        edges = [0.0 if k == 0 else float(elapsed[k - 1]) + e.dt / 2 for k in (first, stop)]
        parts.append("seconds = [{:.7g}, {:.7g}]".format(*edges))
    together = {**dict(e.groups), **(groups or {})}
    if together:
        pairs = ", ".join(f"{quote(key)} = {quote(value)}" for key, value in together.items())
        parts.append(f"groups = {{ {pairs} }}")
    return f"{{ {', '.join(parts)} }}"


def _remaining(e: Experiment, stretches: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The parts of a record between some stretches that are long enough to be kept."""
    left_out = np.zeros(len(e), bool)
    for first, stop in stretches:
        left_out[first:stop] = True
    edges = np.flatnonzero(np.diff(~left_out, prepend=False, append=False)).reshape(-1, 2)
    return [(a, b) for a, b in edges.tolist() if b - a >= FEWEST_SAMPLES]


def leave_out(data: DataSet, parts: Sequence[SpoiledPart]) -> tuple[DataSet, tuple[Finding, ...]]:
    """Records without the parts that spoil a fit, and a finding on each part that is left out.

    Records of the split `test` stay as they are. A part without which a split, or a set without
    splits, would have no records stays, too.

    Args:
        data: the records.
        parts: the parts; those that are only named stay.
    """
    experiments: list[Experiment] = []
    findings: list[Finding] = []
    for e in data:
        of_record = [p for p in parts if p.record == e.name and p.removable and e.split != "test"]
        stretches = [p.samples or (0, len(e)) for p in of_record]
        kept = _remaining(e, stretches) if stretches else [(0, len(e))]
        is_last = not kept and not any(
            x.split == e.split and all(p.record != x.name for p in parts) for x in data
        )
        if is_last or not of_record:
            experiments.append(e)
            continue
        findings += [make_finding("left out", place=p.place, reason=p.reason) for p in of_record]
        experiments += [replace(e[a:b], name=f"{e.name}[{a}:{b}]") for a, b in kept]
    return replace(data, experiments=tuple(experiments)), tuple(findings)


def find_without_model(e: Experiment, held: HeldEquilibrium | None) -> list[SpoiledPart]:
    """The parts of a record that spoil a fit, as far as they show without a model.

    Args:
        e: the record.
        held: the unstable equilibrium that is held to its end (`held_equilibrium`), if any.
    """
    parts = _moved_by_hand(e)
    if held is not None and held.sample >= FEWEST_SAMPLES:
        first = held.sample
        reason = (
            f"a controller holds an unstable position; errors of a simulation grow e-fold in "
            f"{held.e_fold:.2g} s: judge it over a horizon (`horizon=` "
            f"{4 * held.e_fold:.2g}), or leave it out"
        )
        parts.append(
            replace(spoiled_stretch(e, first, len(e), "unstable phase", reason), removable=False)
        )
    return parts


def _moved_by_hand(e: Experiment) -> list[SpoiledPart]:
    """Stretches in which a mechanism leaves its rest though all inputs are zero.

    The hand's end cannot be seen: a stretch lasts as long as the inputs are zero. Where the record
    begins away from where it ends, the hand lets go: the stretch is the rest before.
    """
    if not e.forced:
        return []
    # a smaller input is as good as none
    is_zero = np.all(np.abs(e.u) <= 0.02 * np.abs(e.u).max(axis=0), axis=1)
    v = e.velocities("stencil")
    thresholds = rest_thresholds(e.q, v, e.channels.resolution, e.dt)
    slow = np.all(is_slow(v, thresholds), axis=1)
    # three times the speed below which it rests, after half a second of rest
    is_moving = np.any(np.abs(v) > 3.0 * thresholds.speed, axis=1)
    needed = max(10, round(0.5 / e.dt))
    parts: list[SpoiledPart] = []
    edges = np.flatnonzero(np.diff(is_zero, prepend=False, append=False)).reshape(-1, 2)
    for a, b in edges.tolist():
        rests = np.flatnonzero(np.diff(slow[a:b], prepend=False, append=False)).reshape(-1, 2)
        long = [(a + r, a + s) for r, s in rests.tolist() if s - r >= needed]
        if not long:
            continue
        r, s = long[0]
        after = np.flatnonzero(is_moving[s : max(s, b - _REACH)])
        if not len(after):
            continue
        # one that begins slowly has left its rest then, however small it is
        begin = np.ptp(e.u[s : s + after[0] + 1], axis=0)
        if np.any(begin > 2 * np.ptp(e.u[r:s], axis=0)):
            continue
        is_release = r == 0 and np.any(np.abs(e.q[r] - thresholds.resting) > thresholds.excursion)
        first, stop = (0, s) if is_release else (s - needed // 2, b)
        what = "is held, and let go" if is_release else "moves"
        reason = f"the mechanism {what} though all inputs are zero: by a hand?"
        parts.append(spoiled_stretch(e, first, stop, "unlogged force", reason))
    return parts


def spoiled_header(findings: Iterable[Finding]) -> dict[str, Any]:
    """The entry of files on parts that spoil a fit and on those left out; empty without any."""
    plain = [f.as_plain() for f in findings]
    parts = [f["values"] for f in plain if f["code"] == "spoiled"]
    left_out = [f for f in plain if f["code"] == "left out"]
    return {KEY: {"parts": parts, "left_out": left_out}} if parts or left_out else {}
