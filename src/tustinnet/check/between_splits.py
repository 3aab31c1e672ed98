"""Checks of records that share samples: ranges of a file that overlap, copies, excerpts.

A record of the test split that a model was fitted to says nothing about the model.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from tustinnet.check.card_lines import file_line, without_record
from tustinnet.check.levels import LEVELS
from tustinnet.check.view import RecordView
from tustinnet.data.experiment import Experiment
from tustinnet.data.spoiled import card_entry
from tustinnet.finding import Finding
from tustinnet.signals.stretches import stretch_keys
from tustinnet.words.sentence import Severity


def overlapping_rows(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Records that are ranges of one file and share rows."""
    for a, b in combinations([v.experiment for v in views], 2):
        if not _is_of_same_file(a, b) or _element(a) != _element(b):
            continue
        (start, stop), (first, last) = a.logged_rows, b.logged_rows
        begin = max(start, first)
        shared = min(stop, last) - begin
        if shared <= 0:
            continue
        kept = (stop - first, len(b)) if stop < last else (0, start - first)
        is_inside = stop >= last and first >= start
        yield Finding(
            "overlap",
            {"rows": shared, "file": a.source, "begin": begin},
            _severity(a, b),
            without_record(b) if is_inside else file_line(b, card_entry(b, *kept)),
            (a.name, b.name),
            time=float((begin - start) * a.dt),
        )


def copies(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Records of different files that have a stretch in common, or are nearly equal."""
    records = [v.experiment for v in views]
    signals = [v.samples for v in views]
    exact: set[tuple[int, int]] = set()
    for (i, j), (length, start, other_start) in _equal_stretches(signals, records).items():
        a, b = records[i], records[j]
        shorter = min(len(a), len(b))
        changes = np.any(np.diff(signals[i][start : start + length], axis=0) != 0, axis=1).sum()
        if _is_of_same_file(a, b) or changes < max(
            LEVELS.fewest_shared, LEVELS.least_shared * shorter
        ):
            continue
        exact.add((i, j))
        is_whole = length > 0.98 * shorter
        values = {
            "is_whole": is_whole,
            "is_part": not is_whole,
            "samples": length,
            "total": shorter,
            "later": (other_start - start) * a.dt or None,
        }
        time = float(a.t[start] - a.t[0])
        yield Finding(
            "copy", values, _severity(a, b), without_record(b), (a.name, b.name), time=time
        )
    for i, j, difference in _near_copies(signals):
        a, b = records[i], records[j]
        # a periodic experiment repeats itself in other rows of its file
        if (i, j) not in exact and not _is_of_same_file(a, b):
            yield Finding(
                "near copy",
                {"difference": difference},
                "warning",
                without_record(b),
                (a.name, b.name),
            )


def _is_of_same_file(a: Experiment, b: Experiment) -> bool:
    return bool(a.sha256) and (a.source, a.sha256) == (b.source, b.sha256)


def _element(e: Experiment) -> str:
    """The element of a MAT file that a record is; other elements are other arrays."""
    return e.name.partition("[")[2]


def _severity(a: Experiment, b: Experiment) -> Severity:
    """Severe where one record is fitted to and the other one judges."""
    return "severe" if a.split != b.split else "warning"


def _near_copies(signals: Sequence[Float[np.ndarray, "_ c"]]) -> Iterator[tuple[int, int, float]]:
    """Pairs of records of one length that hardly differ: rounded copies, repeated experiments.

    Yields their indices, and the root mean square of the difference in deviations of the signal.
    """
    lengths = np.array([len(x) for x in signals])
    for length in np.unique(lengths[lengths >= LEVELS.fewest_shared]):
        members = np.flatnonzero(lengths == length).tolist()
        some = np.array([signals[k][:: max(1, length // LEVELS.fewest_shared)] for k in members])
        some -= some.mean(axis=1, keepdims=True)
        deviation = some.std(axis=1)
        for m, i in enumerate(members):
            difference = np.sqrt(np.mean((some[m + 1 :] - some[m]) ** 2, axis=1))
            largest = np.max(difference / np.maximum(deviation[m], 1e-300), axis=1)
            for n in np.flatnonzero((largest < LEVELS.alike) & deviation[m].any()):
                yield i, members[m + 1 + n], float(largest[n])


def _equal_stretches(
    signals: Sequence[Float[np.ndarray, "_ c"]], records: Sequence[Experiment]
) -> dict[tuple[int, int], tuple[int, int, int]]:
    """The longest stretch that two records share: samples, and where it begins in each.

    Stretches are found by keys of their content, so that a copy may begin elsewhere.
    """
    extent = np.maximum(np.max([np.ptp(x, axis=0) for x in signals], axis=0), 1e-300)
    tolerance = extent * LEVELS.digits
    places: dict[int, tuple[int, int]] = {}
    best: dict[tuple[int, int], tuple[int, int, int]] = {}
    for i, (e, x) in enumerate(zip(records, signals, strict=True)):
        steps = np.rint(np.diff(x, axis=0) / tolerance).astype(np.int64)
        motion = steps[:, e.channels.position]
        is_moving = np.any(np.abs(motion) > 1, axis=1)
        starts, keys = stretch_keys(motion, is_moving, LEVELS.run, LEVELS.changes)
        # of a long record some, which are the same in its copies
        chosen = keys % np.uint64(max(1, len(steps) // 20_000)) == 0
        stretches = [*zip(keys[chosen].tolist(), starts[chosen].tolist(), strict=True)]
        known_until = 0
        for key, k in stretches:
            if k < known_until or key not in places:
                continue
            j, m = places[key]
            length, back = _extend(signals[j], m, x, k, 4 * tolerance)
            known_until = k + length - back
            if length > best.get((j, i), (0, 0, 0))[0]:
                best[j, i] = (length, m - back, k - back)
        for key, k in stretches:
            places.setdefault(key, (i, k))
    return best


def _extend(
    a: Float[np.ndarray, "n c"],
    i: int,
    b: Float[np.ndarray, "m c"],
    j: int,
    tolerance: Float[np.ndarray, " c"],
) -> tuple[int, int]:
    """Length of the equal stretch around two samples, and how much of it is before them.

    Positions may differ by a constant.
    """
    back, ahead = min(i, j), min(len(a) - i, len(b) - j)
    difference = a[i - back : i + ahead] - b[j - back : j + ahead]
    differs = np.any(np.abs(difference - difference[back]) > tolerance, axis=1)
    edges = np.flatnonzero(np.r_[True, differs, True])  # one before the stretch, one after it
    after = int(np.searchsorted(edges, back + 1))
    first, stop = int(edges[after - 1]), int(edges[after]) - 1
    return stop - first, back - first
