"""Checks of records that share samples: ranges of a file that overlap, copies, excerpts.

A record of the test split that a model was fitted to says nothing about the model.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

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
    by_file: dict[tuple[str, str], list[Experiment]] = {}
    for view in views:
        e = view.experiment
        if e.source and e.sha256:
            by_file.setdefault((e.source, e.sha256), []).append(e)
    for (file, _), records in by_file.items():
        for a, b in combinations(records, 2):
            # elements of a MAT file are other arrays
            if a.name.partition("[")[2] != b.name.partition("[")[2]:
                continue
            (start, stop), (first, last) = a.logged_rows, b.logged_rows
            shared = min(stop, last) - max(start, first)
            if shared <= 0:
                continue
            begin = max(start, first)
            kept = (stop - first, len(b)) if stop < last else (0, start - first)
            is_inside = stop >= last and first >= start
            yield Finding(
                "overlap",
                {"rows": shared, "file": file, "begin": begin},
                _severity(a, b),
                without_record(b) if is_inside else file_line(b, card_entry(b, *kept)),
                (a.name, b.name),
                time=float((begin - start) * a.dt),
            )


def copies(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Records of different files with equal stretches, or that are nearly equal throughout."""
    if len(views) < 2:
        return
    records = [v.experiment for v in views]
    found: set[tuple[int, int]] = set()
    for (i, j), (length, start, other_start) in _equal_stretches(records).items():
        a, b = records[i], records[j]
        if a.source and a.source == b.source and a.sha256 == b.sha256:
            continue  # `overlapping_rows` says it
        shorter = min(len(a), len(b))
        stretch = np.concatenate([a.q, a.u], axis=1)[start : start + length]
        changes = int(np.count_nonzero(np.any(np.diff(stretch, axis=0) != 0, axis=1)))
        if changes < max(LEVELS.fewest_shared, LEVELS.least_shared * shorter):
            continue
        found.add((i, j))
        is_whole = length > 0.98 * shorter
        yield Finding(
            "copy",
            {
                "is_whole": is_whole,
                "is_part": not is_whole,
                "samples": length,
                "total": shorter,
                "later": (other_start - start) * a.dt or None,
            },
            _severity(a, b),
            without_record(b),
            (a.name, b.name),
            time=float(a.t[start] - a.t[0]),
        )
    for i, j, difference, share, lag in _alike(records, found):
        a, b = records[i], records[j]
        yield Finding(
            "near copy",
            {"difference": difference, "share": share, "apart": lag * a.dt},
            _severity(a, b),
            without_record(b),
            (a.name, b.name),
        )


def _severity(a: Experiment, b: Experiment) -> Severity:
    """Severe where one record is fitted to and the other one judges."""
    return "severe" if a.split != b.split else "warning"


def _equal_stretches(
    records: Sequence[Experiment],
) -> dict[tuple[int, int], tuple[int, int, int]]:
    """The longest stretch that two records share: samples, and where it begins in each."""
    everything = [np.concatenate([e.q, e.u], axis=1) for e in records]
    extent = np.maximum(np.max([np.ptp(x, axis=0) for x in everything], axis=0), 1e-300)
    place: dict[int, tuple[int, int]] = {}
    best: dict[tuple[int, int], tuple[int, int, int]] = {}
    for i, (e, x) in enumerate(zip(records, everything, strict=True)):
        steps = np.rint(np.diff(x, axis=0) / (extent * LEVELS.digits)).astype(np.int64)
        keys = _moving_stretches(steps[:, e.channels.position])
        position = 0
        for k, key in keys:
            if k < position:
                continue
            earlier = place.get(key)
            if earlier is None or earlier[0] == i:
                continue
            j, m = earlier
            length, back = _extend(everything[j], m, x, k, extent)
            position = k + length - back
            if length > best.get((j, i), (0, 0, 0))[0]:
                best[j, i] = (length, m - back, k - back)
        place.update({key: (i, k) for k, key in keys if key not in place})
    return best


def _moving_stretches(steps: Int[np.ndarray, "n c"]) -> list[tuple[int, int]]:
    """Starts of short stretches in motion, every few samples, with the keys of their content.

    Starts are chosen by the content itself, so that a copy which begins elsewhere has them too.
    """
    starts, keys = stretch_keys(
        steps, np.any(np.abs(steps) > 1, axis=1), LEVELS.run, LEVELS.changes
    )
    chosen = keys % np.uint64(max(1, len(steps) // 20_000)) == 0  # of a long record some
    return list(zip(starts[chosen].tolist(), keys[chosen].tolist(), strict=True))


def _extend(
    a: Float[np.ndarray, "n c"],
    i: int,
    b: Float[np.ndarray, "m c"],
    j: int,
    extent: Float[np.ndarray, " c"],
) -> tuple[int, int]:
    """Length of the equal stretch around two samples, and how much of it is before them.

    Positions may differ by a constant.
    """
    tolerance = 4 * extent * LEVELS.digits
    back, ahead = min(i, j), min(len(a) - i, len(b) - j)
    difference = a[i - back : i + ahead] - b[j - back : j + ahead]
    equal = np.all(np.abs(difference - difference[back]) <= tolerance, axis=1)
    before = np.flatnonzero(~equal[:back])
    after = np.flatnonzero(~equal[back:])
    first = int(before[-1]) + 1 if len(before) else 0
    last = back + (int(after[0]) if len(after) else ahead)
    return last - first, back - first


def _alike(
    records: Sequence[Experiment], known: set[tuple[int, int]]
) -> Iterator[tuple[int, int, float, float, int]]:
    """Pairs of records that are nearly equal: indices, difference, overlap, lag in samples."""
    pairs = [
        (i, j)
        for i, j in combinations(range(len(records)), 2)
        # a periodic experiment repeats itself in other rows of its file
        if (i, j) not in known
        and not (records[i].sha256 and records[i].sha256 == records[j].sha256)
    ]
    if not pairs or len(pairs) > LEVELS.most_pairs:
        return
    swing = np.array([e.q[: LEVELS.longest].std(axis=0) for e in records])
    widest = int(np.argmax(np.median(swing, axis=0) / np.maximum(swing.max(axis=0), 1e-300)))
    size = 1 << int(np.ceil(np.log2(2 * max(min(len(e), LEVELS.longest) for e in records))))
    signals = [_whitened(e.q[: LEVELS.longest, widest]) for e in records]
    spectra = [np.fft.rfft(s, size) for s in signals]
    norms = [np.sqrt(s @ s) for s in signals]
    for i, j in pairs:
        if not (norms[i] and norms[j]):
            continue
        correlation = np.fft.irfft(spectra[i] * np.conj(spectra[j]), size)
        peak = int(np.argmax(correlation))
        if correlation[peak] < 0.5 * min(norms[i], norms[j]) ** 2:
            continue
        lag = peak if peak < size // 2 else peak - size
        difference, share = _difference(records[i], records[j], lag)
        if difference < LEVELS.alike and share > LEVELS.overlap:
            yield i, j, difference, share, -lag


def _whitened(q: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    """A smoothed slope, which neither offsets nor counts dominate."""
    width = min(5, len(q))
    smooth = np.convolve(q, np.ones(width) / width, "valid")
    return np.diff(smooth) if len(smooth) > 1 else np.zeros(1)


def _difference(a: Experiment, b: Experiment, lag: int) -> tuple[float, float]:
    """Largest relative difference of a coordinate or input where b is shifted by a lag."""
    first = a.q[max(lag, 0) :], a.u[max(lag, 0) :]
    second = b.q[max(-lag, 0) :], b.u[max(-lag, 0) :]
    n = min(len(first[0]), len(second[0]))
    if n < LEVELS.fewest_shared:
        return np.inf, 0.0
    x, y = (np.concatenate([q[:n], u[:n]], axis=1) for q, u in (first, second))
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    deviation = np.maximum(x.std(axis=0), y.std(axis=0))
    moves = deviation > 1e-9 * np.maximum(np.abs(a.q).max(), 1e-300)
    if not moves.any():
        return np.inf, 0.0
    relative = np.sqrt(np.mean((x - y) ** 2, axis=0))[moves] / deviation[moves]
    return float(relative.max()), n / min(len(a), len(b))


CHECKS = (overlapping_rows, copies)
