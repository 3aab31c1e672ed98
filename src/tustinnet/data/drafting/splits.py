"""The splits of a draft: records by kind and length, repetitions of an experiment together."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import PurePosixPath
from typing import NamedTuple

import numpy as np

from tustinnet.data.drafting.logs import Piece
from tustinnet.data.drafting.numbers import Values

_SPLIT_WORDS = {
    "train": {"train", "training", "trn", "trainingsdaten", "estimation", "ident", "est"},
    "validation": {"val", "valid", "validation", "validierung"},
    "test": {"test", "testing", "holdout", "heldout"},
}
_CONDITION = re.compile(
    r"(?<![^\W_])\d+(?:[.,]\d+)?(?:k?g|[cm]?m|[um]?s|V|A|Nm?|bar|deg|Hz)(?![^\W_])"
)
_REPETITIONS = {"rep", "repeat", "repetition", "wdh", "wiederholung", "trial", "take", "r"}


class SplitRules(NamedTuple):
    """Rules by which records are cut and dealt to splits.

    All are set by hand, not measured.

    Attributes:
        few: records; of fewer ones long ones are cut.
        long: samples of a record that may be cut.
        long_seconds: length of a record that may be cut [s].
        rest: time without motion, in whose middle a log is cut [s].
        shortest: samples of a part.
        validation: share of the records of a kind.
        test: share of the records of a kind.
        enough_to_test: records of a kind, of which some are for tests.
        same_input: correlation of the inputs of repetitions.
    """

    few: int = 4
    long: int = 2000
    long_seconds: float = 20.0
    rest: float = 0.5
    shortest: int = 500
    validation: float = 0.2
    test: float = 0.15
    enough_to_test: int = 6
    same_input: float = 0.9995


SPLITTING = SplitRules()


@dataclass(frozen=True)
class DraftRecord:
    """A record of the draft.

    Attributes:
        piece: its samples.
        kind: the kind of experiment.
        repetitions: name of the set of repetitions that it belongs to.
        split: train, validation or test; None where all records have none.
    """

    piece: Piece
    kind: str
    repetitions: str
    split: str | None = None


@dataclass(frozen=True)
class Splits:
    """The records with their splits, and sentences on how they were chosen."""

    records: tuple[DraftRecord, ...]
    sentences: tuple[str, ...]


def choose_splits(
    pieces: Sequence[Piece],
    positions: Mapping[str, Sequence[Values]],
    inputs: Sequence[str],
) -> Splits:
    """Chooses what each record is for.

    Args:
        pieces: the records.
        positions: positions of each coordinate, record by record, without wraps.
        inputs: columns of the inputs.
    """
    by_name = _splits_by_name(pieces)
    if by_name is not None:
        records = [
            DraftRecord(p, _kind(p), "", split) for p, split in zip(pieces, by_name, strict=True)
        ]
        return Splits(tuple(records), ("splits by the names of files or folders",))
    sentences: list[str] = []
    if len(pieces) < SPLITTING.few:
        pieces, sentences = _cut_long(pieces, positions)
    reasons = sorted({p.because for p in pieces if p.because and not p.because.startswith("a gap")})
    gaps = sum(p.because.startswith("a gap") for p in pieces)
    sentences += [
        f"cut where {reason}" for reason in reasons if "rest" not in reason and "end" not in reason
    ]
    sentences += ["cut at gaps"] if gaps else []
    records = _group(pieces, inputs)
    sets: dict[str, dict[str, list[DraftRecord]]] = {}
    for record in records:
        sets.setdefault(record.kind, {}).setdefault(record.repetitions, []).append(record)
    if all(len(units) == 1 for units in sets.values()) and len(sets) >= SPLITTING.few:
        # a file of each kind: kinds do not matter then
        sets = {"": {name: rs for units in sets.values() for name, rs in units.items()}}
    split_by_set: dict[str, str] = {}
    for units in sets.values():
        split_by_set |= _deal(units)
    records = [replace(r, split=split_by_set[r.repetitions]) for r in records]
    if {r.split for r in records} == {"train"}:
        sentences.append(
            "no split: too few records for a validation; `fit` without a recipe makes folds"
        )
        return Splits(tuple(replace(r, split=None) for r in records), tuple(sentences))
    kinds = [kind for kind in sets if kind]
    if len(kinds) > 1:
        divided = [kind for kind in kinds if {*map(split_by_set.get, sets[kind])} != {"train"}]
        others = "all" if divided == kinds else f"{', '.join(divided)}, the others are in train"
        sentences.append(
            f"kinds of records: {', '.join(kinds)}; divided among the splits: {others}"
        )
    if any(len(rs) > 1 for units in sets.values() for rs in units.values()):
        sentences.append("repetitions of an experiment are in one split")
    return Splits(tuple(records), tuple(sentences))


def find_conditions(pieces: Sequence[Piece]) -> list[str]:
    """The numbers with a unit in the names of all files, as `5kg`; empty where they are equal."""
    by_file = [tuple(_CONDITION.findall(PurePosixPath(p.log.file).stem)) for p in pieces]
    conditions = dict.fromkeys(text for texts in by_file for text in texts)
    return [*conditions] if all(by_file) and len({*by_file}) > 1 else []


def _tokens(text: str) -> list[str]:
    """Words and numbers of a file's name in lower case."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", text)
    return re.findall(r"[^\W\d_]+|\d+", spaced.lower())


def _splits_by_name(pieces: Sequence[Piece]) -> list[str] | None:
    """The splits that names of files or folders say, None where they say none."""
    splits: list[str | None] = []
    for piece in pieces:
        path = PurePosixPath(piece.log.file)
        words = {*_tokens(path.stem), *(t for part in path.parent.parts for t in _tokens(part))}
        found = [split for split, names in _SPLIT_WORDS.items() if names & words]
        splits.append(found[-1] if found else None)
    named = {split for split in splits if split}
    if not named & {"validation", "test"} or (named == {"test"} and None not in splits):
        return None
    return [split or "train" for split in splits]


def _kind(piece: Piece) -> str:
    """The kind of a record: the words of its file's name, without numbers and units behind them."""
    stem = PurePosixPath(piece.log.file).stem
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", stem)
    words = re.findall(
        r"(?<![^\W\d_])[^\W\d_]+", re.sub(r"\d+([.,_]\d+)?[^\W\d_]{0,3}(?![^\W_])", " ", spaced)
    )
    return "_".join(w.lower() for w in words if w.lower() not in _REPETITIONS)


def _group(pieces: Sequence[Piece], inputs: Sequence[str]) -> list[DraftRecord]:
    """The records with their kinds and sets of repetitions."""
    kinds = [_kind(piece) for piece in pieces]
    for k, piece in enumerate(pieces):
        # records without excitation are a kind of their own
        columns = [piece.column(name) for name in inputs]
        if columns and not any(map(np.ptp, columns)):
            kinds[k] += " at a constant input" if any(map(np.any, columns)) else " without input"
    sets: list[str] = []
    for piece in pieces:
        tokens = _tokens(PurePosixPath(piece.log.file).with_suffix("").as_posix())
        # longer numbers are dates
        numbers = [i for i, t in enumerate(tokens) if t.isdigit() and len(t) < 6]
        marked = [i for i in numbers if i and tokens[i - 1] in _REPETITIONS]
        name = PurePosixPath(piece.log.file).as_posix()
        is_part = not piece.whole or piece.log.place != piece.log.file
        if is_part:
            name = f"{piece.log.place}{piece.rows}"
        elif marked or len(numbers) > 1:
            last = marked[-1] if marked else numbers[-1]
            name = "_".join(t for i, t in enumerate(tokens) if i != last)
        sets.append(name)
    for kind in {*kinds}:
        members = [k for k in range(len(pieces)) if kinds[k] == kind]
        if len({sets[k] for k in members}) == 1 and len(members) > 1:
            # numbers alone distinguish all records of the kind: no repetitions
            for k in members:
                sets[k] = f"{pieces[k].log.place}{pieces[k].rows}"
    _join_equal_inputs(pieces, inputs, kinds, sets)
    return [DraftRecord(p, kind, s) for p, kind, s in zip(pieces, kinds, sets, strict=True)]


def _join_equal_inputs(
    pieces: Sequence[Piece], inputs: Sequence[str], kinds: Sequence[str], sets: list[str]
) -> None:
    """Makes records of equal inputs repetitions of one another, unless all of a kind are."""
    joined = list(sets)
    for k, piece in enumerate(pieces):
        for j in range(k):
            if kinds[j] == kinds[k] and _have_equal_inputs(pieces[j], piece, inputs):
                joined[k] = joined[j]
                break
    for kind in {*kinds}:
        members = [k for k in range(len(pieces)) if kinds[k] == kind]
        if len({joined[k] for k in members}) > 1:
            for k in members:
                sets[k] = joined[k]


def _have_equal_inputs(first: Piece, second: Piece, inputs: Sequence[str]) -> bool:
    n = min(len(first.t), len(second.t))
    if not inputs or n < 0.9 * max(len(first.t), len(second.t)):
        return False
    for name in inputs:
        a, b = first.column(name)[:n], second.column(name)[:n]
        if not np.ptp(a) or not np.ptp(b):
            return False
        if np.array_equal(a, b):
            continue
        size = np.sqrt(np.mean(b**2))
        if (
            np.corrcoef(a, b)[0, 1] < SPLITTING.same_input
            or np.sqrt(np.mean((a - b) ** 2)) > 0.05 * size
        ):
            return False
    return True


def _deal(units: Mapping[str, Sequence[DraftRecord]]) -> dict[str, str]:
    """The split of each set of repetitions of one kind: of usual length go into validation."""
    names = list(units)
    count = len(names)
    lengths = [sum(r.piece.seconds for r in units[name]) for name in names]
    validation = 0 if count < 2 else max(1, round(SPLITTING.validation * count))
    test = max(1, round(SPLITTING.test * count)) if count >= SPLITTING.enough_to_test else 0
    usual = float(np.median(lengths)) or 1.0
    order = sorted(range(count), key=lambda k: (round(abs(lengths[k] / usual - 1), 1), -k))
    splits = dict.fromkeys(names, "train")
    for rank, k in enumerate(order[: validation + test]):
        splits[names[k]] = "validation" if rank < validation else "test"
    return splits


# --- long logs ---


def _cut_long(
    pieces: Sequence[Piece], positions: Mapping[str, Sequence[Values]]
) -> tuple[list[Piece], list[str]]:
    """Few records with long ones cut at rests, or a single one in two, and sentences on it."""
    parts: list[Piece] = []
    sentences: list[str] = []
    for k, piece in enumerate(pieces):
        is_long = len(piece.t) >= SPLITTING.long and piece.seconds >= SPLITTING.long_seconds
        cuts = _rests(piece, [columns[k] for columns in positions.values()]) if is_long else []
        edges = [0, *cuts, len(piece.t)]
        if cuts:
            sentences.append(f"{piece.log.file}: cut in the middle of {len(cuts)} rests")
            parts += [piece.part(a, b, "it rests") for a, b in pairwise(edges)]
        else:
            parts.append(piece)
    if len(parts) == 1 and len(parts[0].t) >= SPLITTING.long // 4:
        (piece,) = parts
        n = len(piece.t)
        edges = [0, n // 4, n // 2, 3 * n // 4, n]
        motion = [columns[0] for columns in positions.values()]
        if all(any(np.ptp(q[a:b]) > 0.1 * np.ptp(q) for q in motion) for a, b in pairwise(edges)):
            parts = [piece.part(a, b, "the end") for a, b in pairwise(edges)]
            sentences.append(f"{piece.log.file}: one record, cut into four parts")
    return parts, sentences


def _rests(piece: Piece, positions: Sequence[Values]) -> list[int]:
    """Samples in the middle of rests, so that no part is short."""
    n = len(piece.t)
    dt = piece.seconds / (n - 1)
    width = max(2, round(SPLITTING.rest / 2 / dt))
    if 4 * width > n or not positions:
        return []
    still = np.ones(n, bool)
    for q in positions:
        moved = np.abs(q[width:] - q[:-width])
        limit = 0.01 * moved.max(initial=0.0)
        calm = np.zeros(n, bool)
        calm[width // 2 : width // 2 + len(moved)] = moved <= limit
        still &= calm
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    rests = [
        (int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= width
    ]
    shortest = max(SPLITTING.shortest, n // 12)
    cuts: list[int] = []
    for a, b in rests:
        middle = (a + b) // 2
        if middle - (cuts[-1] if cuts else 0) >= shortest and n - middle >= shortest:
            cuts.append(middle)
    return cuts
