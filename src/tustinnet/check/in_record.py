"""Checks of a single record: time base, sensors, velocity columns, inputs.

Every check is a generator of findings from a view of a record. `CHECKS` lists them in the order of
the report; a new one is a function and a line there.
"""

import json
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from tustinnet.check.card_lines import (
    WHICH_COLUMN,
    coordinate_line,
    file_parts,
    input_line,
    time_line,
    top_line,
    unit_key,
)
from tustinnet.check.levels import LEVELS
from tustinnet.check.view import RecordView
from tustinnet.check.weak_form import Windows
from tustinnet.data.units import convert
from tustinnet.finding import Finding, make_finding
from tustinnet.signals import outliers
from tustinnet.signals.timescales import timescales
from tustinnet.words.sentence import SEVERITIES, Severity

_BITS = range(8, 33)  # of counters
_VELOCITIES = {"rad": ("rad/s", "deg/s", "rpm", "rev/s"), "m": ("m/s", "cm/s", "mm/s")}


# --- time ---


def period(view: RecordView) -> Iterator[Finding]:
    """Period of the log against that of the card."""
    e = view.experiment
    if e.recording is not None or view.card is None or view.card.dt is None:
        return
    intervals = np.diff(e.t)
    usual = intervals[np.abs(intervals / np.median(intervals) - 1) < 0.5]
    mean, error = float(usual.mean()), float(usual.std() / np.sqrt(len(usual)))
    deviation = mean / e.dt - 1
    if abs(deviation) < LEVELS.other_period or abs(mean - e.dt) < 4 * error:
        return
    yield view.finding(
        "period",
        top_line(f"dt = {mean:.6g}"),
        severity="severe" if abs(deviation) > LEVELS.far_period else "warning",
        milliseconds=1e3 * mean,
        declared=1e3 * e.dt,
        deviation=deviation,
    )


def time_unit(view: RecordView) -> Iterator[Finding]:
    """Unit of the timestamps, where no period in the card says how large they are."""
    card, e = view.card, view.experiment
    if card is None or card.time is None or card.dt is not None:
        return
    median = view.recording.median_dt
    step = median / card.time.factor()
    is_whole = bool(np.all(np.abs(np.diff(e.t) / card.time.factor() % 1) < 1e-6))
    if card.time.unit == "s" and is_whole and step >= 1:
        unit = "ms" if step < 1e3 else "us" if step < 1e6 else "ns"
    elif card.time.unit != "s" and not is_whole and step < 1 and median < LEVELS.longest_clock:
        unit = "s"
    else:
        return
    yield view.finding(
        "time unit",
        time_line(f'unit = "{unit}"'),
        unit=unit,
        declared=card.time.unit,
        step=step,
        period=median,
    )


def gaps(view: RecordView) -> Iterator[Finding]:
    """Gaps of the log, which are intervals of several periods."""
    e, recording = view.experiment, view.recording
    lengths = [(stop - start) / recording.median_dt for start, stop in recording.gaps]
    if not lengths or max(lengths) < LEVELS.long_gap:
        return
    worst, half = int(np.argmax(lengths)), recording.median_dt / 2
    start, stop = recording.gaps[worst]
    cuts = [
        (int(np.searchsorted(e.t, a + half)), int(np.searchsorted(e.t, b - half)))
        for a, b in recording.gaps
    ]
    yield view.finding(
        "gap",
        file_parts(e, cuts),
        time=start - float(e.t[0]),
        count=len(lengths),
        milliseconds=1e3 * (stop - start),
        samples=lengths[worst] - 1,
        treatment="filled by interpolation" if e.recording is not None else "left as they are",
    )


def sampling(view: RecordView) -> Iterator[Finding]:
    """Samples in a period of the strongest oscillation."""
    e = view.experiment
    fast = np.diff(e.q, axis=0).std(axis=0) > LEVELS.fast * e.q.std(axis=0)
    for j in np.flatnonzero(view.moving & fast).tolist():
        if len(e) < 64 or view.wild_share(j):
            continue
        scales = timescales([e.q[:, j]])
        is_noise = (
            scales.swing < 3 * view.counts[j] or scales.decay < LEVELS.ringing * scales.period
        )
        if scales.period < LEVELS.few_samples and not is_noise:
            yield view.finding(
                "sampling",
                "record with a shorter period; no line of the card mends it",
                e.coordinates[j].name,
                severity="warning" if scales.period < LEVELS.fewer_samples else "note",
                samples=scales.period,
                milliseconds=1e3 * scales.period * e.dt,
            )


# --- positions ---


def dead_sensor(view: RecordView) -> Iterator[Finding]:
    """Coordinates that never change, or flicker between two neighbouring counts."""
    e = view.experiment
    for c, q, moves, flickers in zip(
        e.coordinates, e.q.T, view.moving, view.flickers.tolist(), strict=True
    ):
        if not moves:
            yield view.finding(
                "dead sensor",
                coordinate_line(c.name, WHICH_COLUMN),
                c.name,
                flickers=flickers,
                value=q[0],
                unit=c.unit,
                samples=len(e),
            )


def positions(view: RecordView) -> Iterator[Finding]:
    """Positions that move too fast for their log, stand still in motion, or jump."""
    for j in np.flatnonzero(view.moving).tolist():
        c = view.experiment.coordinates[j]
        frozen, clipped = _standstills(view, j)
        at_end = "no line of the card: the end of the sensor, or a stop of the mechanism?"
        for code, runs, mend in (
            ("frozen sensor", frozen, file_parts(view.experiment, frozen)),
            ("clipped sensor", clipped if len(clipped) > 1 else [], at_end),
        ):
            samples = [stop - first for first, stop in runs]
            if runs:
                yield view.finding(
                    code,
                    mend,
                    c.name,
                    view.seconds(runs[0][0]),
                    count=len(runs),
                    samples=sum(samples),
                    milliseconds=1e3 * max(samples) * view.experiment.dt,
                )
        if share := view.wild_share(j):
            mend = f"{coordinate_line(c.name, 'correct `unit`')}; or record with a shorter period"
            # a wheel that spins fast does so steadily
            is_steady = np.abs(np.diff(view.experiment.q[:, j], n=2)).max() < np.pi / 2
            severity = "note" if is_steady else None
            yield view.finding("fast angle", mend, c.name, severity=severity, share=share)
        else:
            yield from _jumps(view, j, frozen)


def _jumps(view: RecordView, j: int, frozen: Sequence[tuple[int, int]]) -> Iterator[Finding]:
    """Jumps of a position: spikes, lost counts, counters that overflow, wraps of another unit.

    Args:
        view: the record.
        j: the coordinate.
        frozen: stretches in which its sensor froze; the jumps at their ends are not named again.
    """
    e, c = view.experiment, view.experiment.coordinates[j]
    q = e.q[:, j]
    rows = outliers.find_jumps(e.t, q, view.counts[j])
    rows = np.setdiff1d(rows, [b + k for _, b in frozen for k in range(LEVELS.interpolated + 1)])
    rows = rows[~_follows_step(view, rows)] if len(rows) else rows
    if not len(rows):
        return
    change = np.diff(q)
    motion = [np.median(np.r_[change[max(k - 4, 0) : k - 1], change[k : k + 3]]) for k in rows]
    sizes = np.abs(change[rows - 1] - motion)
    largest = float(sizes.max())
    cause, mend = _meaning_of_jumps(view, j, sizes) or (
        None,
        file_parts(e, [(int(k), int(k)) for k in rows]),
    )
    yield view.finding(
        "jump" if cause is None else "counter",
        mend,
        c.name,
        view.seconds(int(rows[0])),
        severity="severe" if cause is not None and len(rows) >= LEVELS.often else "warning",
        rows=rows.tolist(),
        cause=cause,
        count=len(rows),
        largest=largest,
        unit=c.unit,
        counts=largest / view.counts[j] if view.counts[j] else None,
    )


def _meaning_of_jumps(
    view: RecordView, j: int, sizes: Float[np.ndarray, " jumps"]
) -> tuple[Finding, str] | None:
    """Cause of jumps of a size that counters and units have, and the line; None of others."""
    c, count, block = view.experiment.coordinates[j], view.counts[j], view.coordinate_card(j)
    # a bad row beside a jump is no jump of its own
    sizes = sizes[sizes > LEVELS.main_jumps * sizes.max()]
    typical = float(np.median(sizes))
    if np.mean(np.abs(sizes - typical) < 0.2 * typical) < LEVELS.most_jumps:
        return None
    mend = "no line of the card: add the overflows to the column in the file"
    spans = [
        (2.0**bits * count, make_finding("counter overflows", bits=bits), mend)
        for bits in (_BITS if count else ())
    ]
    turn, is_unwrapped = 2 * np.pi, c.kind == "angular" and (block is None or block.unwrap)
    if c.kind == "angular":
        spans = [
            (turn, make_finding("encoder wraps"), coordinate_line(c.name, "unwrap = true")),
            *(
                (span, make_finding(code), coordinate_line(c.name, f'unit = "{unit}"'))
                for span, code, unit in (
                    (360.0, "degrees wrap", "deg"),
                    (np.deg2rad(turn), "radians wrap", "rad"),
                )
                if block is None or block.unit != unit
            ),
            *spans,
        ]
    for span, cause, mend in spans:
        jump = abs(span - turn * round(span / turn)) if is_unwrapped else span
        tolerance = max(3 * count, LEVELS.same_jump * jump)
        if jump > max(3 * LEVELS.counts * count, 1e-9) and abs(typical - jump) < tolerance:
            return cause, mend
    return None


def _standstills(view: RecordView, j: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Runs of equal values that a coordinate enters and leaves at speed.

    On a grid, the interpolation of a constant settles within some samples of its ends.

    Returns:
        Those after which the position jumps to where it moves, as behind a sensor that froze, and
        those at either end of its range; first samples, and the ones after the last.
    """
    e, q, noise = view.experiment, view.experiment.q[:, j], max(view.counts[j], view.noise[j])
    margin = 0 if e.recording is None else LEVELS.interpolated
    change = np.diff(q)
    ends = np.flatnonzero(np.abs(change) > (LEVELS.settled * noise if margin else 0.0))
    first, last = np.r_[0, ends + 1], np.r_[ends, len(e) - 1]
    length = last - first + 1
    inside = (length >= LEVELS.clipped) & (first >= 4 + margin) & (last < len(q) - 5 - margin)
    to_end = _stops_for_good(q, int(first[-1]), margin, LEVELS.counts * noise)
    if not inside.any():
        return to_end, []
    first, last, length = first[inside], last[inside], length[inside]
    before = (q[first - margin - 1] - q[first - margin - 4]) / 3
    after = (q[last + margin + 4] - q[last + margin + 1]) / 3
    slower, faster = np.sort(np.abs([before, after]), axis=0)
    least = LEVELS.counts * noise
    missed = np.abs(q[last + margin + 1] - q[last])
    catches_up = (
        (length >= LEVELS.frozen + 2 * margin)
        & (faster > least)  # else it rests
        & (missed > (margin + 3) * faster)
        & ~_follows_step(view, last + margin + 1)
    )
    # what turns, or is brought to a goal and held there, has slowed down before
    bends = np.lib.stride_tricks.sliding_window_view(np.abs(np.diff(change)), 3).max(axis=1)
    bend = np.maximum(bends[np.maximum(first - margin - 5, 0)], bends[last + margin + 1])
    is_sharp = slower > np.maximum(least, 2 * (margin + 1) * bend)
    is_extreme = (q[first] <= q.min() + least) | (q[first] >= q.max() - least)
    runs = np.stack([first, last + 1], axis=1)
    frozen, clipped = runs[catches_up], runs[is_sharp & is_extreme & ~catches_up]
    return [(a, b) for a, b in (*frozen.tolist(), *to_end)], [(a, b) for a, b in clipped.tolist()]


def _stops_for_good(
    q: Float[np.ndarray, " n"], first: int, margin: int, least: float
) -> list[tuple[int, int]]:
    """The last run of equal values, if it ends motion far more suddenly than anything before."""
    before = q[: max(first - margin, 0)]
    if len(before) < LEVELS.fewest_velocities or len(q) - first < LEVELS.frozen + margin:
        return []
    speed, bend = abs(before[-1] - before[-4]) / 3, np.abs(np.diff(before, 2)).max()
    is_inside = before.min() + least < q[first] < before.max() - least  # else a stop, perhaps
    return [(first, len(q))] if is_inside and speed > max(least, 2 * bend) else []


def _follows_step(view: RecordView, rows: Int[np.ndarray, " jumps"]) -> Bool[np.ndarray, " jumps"]:
    """Mask of jumps that follow a step of an input, which moves a stiff mechanism as fast."""
    change = np.abs(np.diff(view.experiment.u, axis=0, prepend=view.experiment.u[:1]))
    if not change.size:
        return np.zeros(len(rows), bool)
    usual = np.maximum(np.quantile(change, 0.9, axis=0), 1e-300)
    is_step = np.any(change > LEVELS.step * usual, axis=1)
    return np.any(is_step[np.maximum(rows[:, None] - [0, 1, 2, 3], 0)], axis=1)


def encoder(view: RecordView) -> Iterator[Finding]:
    """Encoder count of the positions against the declared one."""
    e = view.experiment
    for j, (c, q) in enumerate(zip(e.coordinates, e.q.T, strict=True)):
        count = view.recording.counts[j]
        if not (c.resolution and count) or abs(count / c.resolution - 1) <= LEVELS.other_count:
            continue
        if len(np.unique(q)) < LEVELS.fewest_counts:  # a few levels have a common step by chance
            continue
        block, key = view.coordinate_card(j), f"resolution = {count:.5g}"
        if block is not None and block.counts_per_revolution is not None:
            # counts that are off by the factor of a unit are not what is wrong
            unit = unit_key(block, c.resolution / count)
            key = unit or f"counts_per_revolution = {2 * np.pi / count:.6g}"
        yield view.finding(
            "encoder count",
            coordinate_line(c.name, key),
            c.name,
            count=count,
            declared=c.resolution,
            ratio=count / c.resolution,
            unit=c.unit,
        )


# --- velocity columns ---


def velocities(view: RecordView) -> Iterator[Finding]:
    """Velocity columns with rows of zeros or outliers, or that are not the slope of positions.

    Of columns that no fit uses only what says that columns are others than the card has them.
    """
    if view.experiment.v is None:
        return
    for finding in _velocity_findings(view):
        if view.experiment.v_measured or finding.severity != "note":
            yield finding


def _velocity_findings(view: RecordView) -> Iterator[Finding]:
    """All findings about velocity columns, those that no fit uses a degree milder."""
    e = view.experiment
    assert e.v is not None
    lead, trail = e.padded_rows
    if lead or trail:
        yield view.finding(
            "padded velocity",
            "`measured = false` in `velocity` of all coordinates",
            severity="warning" if e.v_measured else "note",
            first=lead,
            last=trail,
        )
    q, v = e.q[lead : len(e) - trail], e.v[lead : len(e) - trail].copy()
    if len(q) < LEVELS.fewest_velocities:
        return
    for j in range(len(e.coordinates)):
        rows = outliers.find_outliers(v[:, j])
        if len(rows):
            others = np.delete(np.arange(len(v)), rows)
            usual = np.interp(rows, others, v[others, j])
            largest = np.abs(v[rows, j] - usual).max()
            v[rows, j] = usual
            yield _velocity_finding(
                view,
                j,
                make_finding("has outliers", rows=(rows + lead).tolist()),
                make_finding("by up to", largest=largest),
            )
    windows = Windows(4, 1, e.dt)
    slopes, columns = windows.average(q, derivative=1), windows.average(v)
    for j in np.flatnonzero(slopes.std(axis=0) > 3 * view.noise / (2 * windows.half * e.dt)):
        yield from _compare_velocity(view, int(j), slopes, columns[:, j])


def _compare_velocity(
    view: RecordView, j: int, slopes: Float[np.ndarray, "m n_q"], column: Float[np.ndarray, " m"]
) -> Iterator[Finding]:
    """Findings about a velocity column; it has to follow a slope to be called wrong for sure."""
    e = view.experiment
    lag, correlation, gain = _best_lag(slopes[:, j], column)
    others = np.abs(np.nan_to_num([np.corrcoef(s, column)[0, 1] for s in slopes.T]))
    best = int(np.argmax(others))
    how = make_finding("times the slope", gain=gain, correlation=correlation)
    residual, best_residual = 1 - correlation**2, 1 - others[best] ** 2
    is_better = residual > LEVELS.own_residual * best_residual
    if best != j and others[best] > LEVELS.high_correlation and is_better:
        relation = make_finding("is that of another", other=e.coordinates[best].name)
        how = make_finding("correlates with another", correlation=correlation, other=others[best])
        yield _velocity_finding(view, j, relation, how, "severe")
    elif correlation < -LEVELS.high_correlation:
        yield _velocity_finding(view, j, make_finding("has the opposite sign"), how, "severe")
    elif correlation < LEVELS.low_correlation:
        yield _velocity_finding(view, j, make_finding("disagrees"), how)
    # noise of one of both alone may change the gain by as much as the correlation
    deviation = abs(gain - 1) - (1 - correlation)
    if correlation < LEVELS.high_correlation:
        return
    if deviation > LEVELS.gain_of_velocity:
        unit = _velocity_unit(view, j, gain)
        if unit or e.v_measured:  # else nothing is to be done, whatever its scale is
            severity = "severe" if deviation > LEVELS.other_gain else "warning"
            relation = make_finding("has another scale")
            yield _velocity_finding(view, j, relation, how, severity, unit)
    if lag > max(LEVELS.lag_of_velocity, LEVELS.lag_share * timescales([e.q[:, j]]).period):
        how = make_finding("milliseconds", milliseconds=1e3 * lag * e.dt, samples=lag)
        yield _velocity_finding(view, j, make_finding("lags"), how)


def _velocity_unit(view: RecordView, j: int, gain: float) -> str:
    """The unit in which a velocity column that is some times the slope would be the slope."""
    card, unit = view.coordinate_card(j), view.experiment.coordinates[j].unit
    declared = card.velocity_factor() if card and card.velocity else 1.0
    for name in _VELOCITIES.get(unit, ()):
        factor = convert(name, f"{unit}/s") / declared
        if abs(factor - 1) > 1e-6 and abs(factor * gain - 1) < LEVELS.same_velocity_unit:
            return name
    return ""


def _best_lag(x: Float[np.ndarray, " m"], y: Float[np.ndarray, " m"]) -> tuple[float, float, float]:
    """Lag of `y` behind `x` in samples, and correlation and gain at it."""
    most = min(LEVELS.most_lags, len(x) // 4)
    core = y[most : len(y) - 3]
    windows = np.lib.stride_tricks.sliding_window_view(x, len(core))[::-1]  # by lags from -3 on
    centred = windows - windows.mean(axis=1, keepdims=True)
    core = core - core.mean()
    sizes = np.linalg.norm(centred, axis=1)
    r = centred @ core / np.maximum(sizes * np.linalg.norm(core), 1e-300)
    best = int(np.argmax(np.abs(r)))
    shift = 0.0
    if 0 < best < len(r) - 1:
        left, middle, right = np.abs(r[best - 1 : best + 2])
        bend = left - 2 * middle + right
        shift = float(np.clip((left - right) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0
    gain = np.sign(r[best]) * np.linalg.norm(core) / max(float(sizes[best]), 1e-300)
    return best - 3 + shift, float(r[best]), float(gain)


def _velocity_finding(
    view: RecordView,
    j: int,
    relation: Finding,
    how: Finding,
    severity: Severity = "warning",
    unit: str = "",
) -> Finding:
    """A finding about a velocity column, a degree milder where no fit uses it.

    Args:
        view: the record.
        j: the coordinate.
        relation: what the column is, compared with the slope of the positions.
        how: by how much.
        severity: of a column that fits use.
        unit: the unit that mends it, by default it is not to be used.
    """
    e, card = view.experiment, view.coordinate_card(j)
    keys = {"unit": unit} if unit else {"measured": False}
    if card is not None and card.velocity is not None:
        keys = card.velocity.model_dump(exclude_unset=True) | keys
    entries = ", ".join(
        f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in keys.items()
    )
    name = e.coordinates[j].name
    return view.finding(
        "velocity",
        coordinate_line(name, f"velocity = {{ {entries} }}"),
        name,
        column=str(keys.get("column", "")),
        severity=severity if e.v_measured else SEVERITIES[SEVERITIES.index(severity) + 1],
        relation=relation,
        how=how,
    )


# --- inputs ---


def inputs(view: RecordView) -> Iterator[Finding]:
    """Inputs with samples that are huge compared with all others, or beyond declared limits."""
    e = view.experiment
    for i, u in zip(e.inputs, e.u.T, strict=True):
        if len(rows := outliers.find_spikes(u)):
            size = np.abs(u - np.median(u))
            yield view.finding(
                "spike",
                file_parts(e, [(int(k), int(k) + 1) for k in rows]),
                i.name,
                view.seconds(int(rows[0])),
                rows=rows.tolist(),
                largest=size[rows].max(),
                usual=np.delete(size, rows).max(),
                unit=i.unit,
            )
        low, high = i.limits or (-np.inf, np.inf)
        beyond = np.maximum(low - u, u - high)
        is_beyond = beyond > LEVELS.beyond_limits * (high - low)
        if is_beyond.any():
            yield view.finding(
                "limits",
                input_line(i.name, "clip = true"),
                i.name,
                view.seconds(int(np.argmax(is_beyond))),
                beyond=beyond.max(),
                unit=i.unit,
                samples=int(is_beyond.sum()),
                share=is_beyond.mean(),
            )


CHECKS: tuple[Callable[[RecordView], Iterator[Finding]], ...] = (
    period,
    time_unit,
    gaps,
    sampling,
    dead_sensor,
    positions,
    encoder,
    velocities,
    inputs,
)
