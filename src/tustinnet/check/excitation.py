"""What records can tell: excitation, independence, speeds, and what to record next."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tustinnet.check.card_lines import coordinate_line, input_line
from tustinnet.check.finding import Finding, Severity
from tustinnet.check.motion_model import make_regressors, record_equations
from tustinnet.check.view import RecordView
from tustinnet.wording import counted

_COPY = 2.0  # counts, by which two columns of one sensor differ at most
_TOGETHER = 0.995  # correlation of two speeds
_RARE = 0.01  # of the samples in the upper half of the speeds
_SPEEDS = (0.1, 0.5)  # of the largest one, between slow, medium and fast
_NOTHING = 1e-4  # of the usual size of a regressor: a direction that records do not excite
_PART = 0.3  # of a direction, that is named
_MOST_DIRECTIONS = 2
_LEVELS = 3  # an input of fewer excites little
_NARROW = 4.0  # lines of the spectrum, of an input that excites little


def still_inputs(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Inputs that move in no record."""
    for k, i in enumerate(views[0].experiment.inputs):
        values = np.concatenate([v.experiment.u[:, k] for v in views])
        if np.ptp(values):
            continue
        yield _finding(
            views,
            "still input",
            "warning",
            f"{i.name} moves in no record",
            f"{values[0]:.4g} {i.unit} in all {counted(len(values), 'sample')}",
            input_line(i.name, "column: is it the right one? else leave the block out"),
            i.name,
        )


def poor_inputs(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Inputs that take few values, or few frequencies, in all records together."""
    for k, i in enumerate(views[0].experiment.inputs):
        columns = [v.experiment.u[:, k] for v in views if np.ptp(v.experiment.u[:, k])]
        if not columns:
            continue
        levels = len(np.unique(np.concatenate([c[:100_000] for c in columns])))
        if levels < _LEVELS:
            yield _finding(
                views,
                "poor input",
                "note",
                f"{i.name} takes few values",
                f"{counted(levels, 'level')} in {counted(len(columns), 'record')}",
                "record more levels: nothing between them can be told",
                i.name,
            )
            continue
        # of the power at n lines of the same size the sum of squares is an n-th
        powers = [np.abs(np.fft.rfft(u[:100_000] - u.mean())) ** 2 for u in columns]
        lines = max(float(np.sum(p) ** 2 / np.sum(p**2)) for p in powers)
        if lines < _NARROW:
            yield _finding(
                views,
                "poor input",
                "note",
                f"{i.name} has few frequencies",
                f"{lines:.1f} effective ones",
                "record more: a sum of sines, noise, or many steps",
                i.name,
            )


def dependent_coordinates(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Coordinates that are one sensor, or move together in all records."""
    first = views[0].experiment
    q = [v.experiment.q - v.experiment.q.mean(axis=0) for v in views]
    everything = np.concatenate(q)
    speeds = np.concatenate([v.velocity for v in views])
    for j in range(first.channels.n_q):
        for i in range(j):
            x, y = everything[:, i], everything[:, j]
            if not (np.ptp(x) and np.ptp(y)):
                continue
            names = f"{first.coordinates[i].name} and {first.coordinates[j].name}"
            gain = float(x @ y / (x @ x))
            error = float(np.sqrt(np.mean((y - gain * x) ** 2)))
            count = np.median([max(v.noise[j], abs(gain) * v.noise[i]) for v in views])
            name = first.coordinates[j].name
            if error <= max(_COPY * count, 1e-9 * float(y.std())):
                yield _finding(
                    views,
                    "same sensor",
                    "warning",
                    f"{names} are one signal",
                    f"{name} is {gain:.4g} times the other within {error:.2g} "
                    f"{first.coordinates[j].unit}",
                    coordinate_line(name, "column: is it the right one? else leave the block out"),
                    name,
                )
                continue
            r = float(np.corrcoef(speeds[:, i], speeds[:, j])[0, 1])
            if abs(r) > _TOGETHER:
                yield _finding(
                    views,
                    "moving together",
                    "note",
                    f"{names} move together",
                    f"correlation of the speeds {r:.4f}",
                    "record runs in which one moves without the other",
                    name,
                )


def speeds(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Share of the samples in each range of speeds of a coordinate."""
    for j, c in enumerate(views[0].experiment.coordinates):
        v = np.abs(np.concatenate([view.velocity[:, j] for view in views]))
        largest = float(np.quantile(v, 0.9999)) if len(v) else 0.0
        if not largest:
            continue
        slow, medium = (float(np.mean(v < s * largest)) for s in _SPEEDS)
        if 1 - medium > _RARE:
            continue
        low, high = _SPEEDS[1] * largest, largest
        yield _finding(
            views,
            "rare speeds",
            "note",
            f"{c.name} moves fast in few samples",
            f"{slow:.0%} of them below {_SPEEDS[0] * largest:.3g} {c.unit}/s, {1 - medium:.2%} "
            f"from {low:.3g} to {high:.3g}",
            f"record more motion of {c.name} at {low:.3g} to {high:.3g} {c.unit}/s",
            c.name,
        )


def null_space(views: Sequence[RecordView]) -> Iterator[Finding]:
    """Combinations of terms of equations of motion that the records do not tell apart."""
    regressors = make_regressors(views)
    if regressors is None:
        return
    chosen = [k for k, name in enumerate(regressors.names) if _is_simple(name)]
    right = np.concatenate([e.right for e in record_equations(regressors, views)])[:, chosen]
    names = [regressors.names[k] for k in chosen]
    # an angle and a length that stand still are said elsewhere
    size = np.sqrt(np.mean(right**2, axis=0))
    used = size > 1e-12 * size.max(initial=1e-300)
    right, names = right[:, used] / size[used], [n for n, u in zip(names, used, strict=True) if u]
    if right.shape[1] < 2 or len(right) < right.shape[1]:
        return
    values, directions = np.linalg.eigh(right.T @ right / len(right))
    for value, direction in list(zip(values, directions.T, strict=True))[:_MOST_DIRECTIONS]:
        if value > _NOTHING:
            break
        parts = [names[k] for k in np.argsort(-np.abs(direction)) if abs(direction[k]) > _PART]
        if len(parts) < 2:
            continue
        yield _finding(
            views,
            "null space",
            "note",
            f"the records do not tell {' and '.join(parts)} apart",
            f"a combination of them varies by {np.sqrt(max(value, 0.0)):.2g} of their size",
            "record runs in which they differ: larger swings, other speeds, other inputs",
        )


def _is_simple(name: str) -> bool:
    """Whether a regressor is a term by itself, neither a product nor a power."""
    return not (
        "^" in name
        or "|" in name
        or " " in name.removeprefix("sin ").removeprefix("cos ").removeprefix("sign ")
    )


def _finding(
    views: Sequence[RecordView],
    check: str,
    severity: Severity,
    what: str,
    size: str,
    remedy: str,
    channel: str = "",
) -> Finding:
    """A finding about all records."""
    return replace(views[0].finding(check, severity, what, size, remedy, channel), records=())


CHECKS = (still_inputs, poor_inputs, dependent_coordinates, speeds)
