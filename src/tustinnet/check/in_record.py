"""Checks of a single record: time base, sensors, velocity columns, inputs.

Every check is a generator of findings from a view of a record. `CHECKS` lists them in the order of
the report; a new one is a function and a line there.
"""

from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Float, Int

from tustinnet.check.card_lines import (
    WHICH_COLUMN,
    coordinate_line,
    file_parts,
    input_line,
    time_line,
    top_line,
)
from tustinnet.check.levels import LEVELS
from tustinnet.check.view import RecordView
from tustinnet.check.weak_form import Windows
from tustinnet.data.units import velocity_factor
from tustinnet.finding import Finding, make_finding
from tustinnet.signals import outliers
from tustinnet.signals.timescales import timescales
from tustinnet.words.sentence import SEVERITIES, Severity

_BITS = range(8, 33)  # of counters
_UNUSED = "measured = false"
"""The entry for a velocity column with which no fit is to begin."""

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
    for j, c in enumerate(e.coordinates):
        if len(e) < 64 or not view.moving[j] or view.wild_share(j):
            continue
        scales = timescales([e.q[:, j]])
        is_noise = (
            scales.swing < 3 * view.counts[j] or scales.decay < LEVELS.ringing * scales.period
        )
        if scales.period < LEVELS.few_samples and not is_noise:
            yield view.finding(
                "sampling",
                "record with a shorter period; no line of the card mends it",
                c.name,
                severity="warning" if scales.period < LEVELS.fewer_samples else "note",
                samples=scales.period,
                milliseconds=1e3 * scales.period * e.dt,
            )


# --- positions ---


def dead_sensor(view: RecordView) -> Iterator[Finding]:
    """Coordinates that never change, or flicker between two neighbouring counts."""
    e = view.experiment
    for j, c in enumerate(e.coordinates):
        flickers = len(np.unique(e.q[:, j])) == 2 and _is_one_count(view, j)
        if flickers or not view.moving[j]:
            yield view.finding(
                "dead sensor",
                coordinate_line(c.name, WHICH_COLUMN),
                c.name,
                flickers=flickers,
                value=e.q[0, j],
                unit=c.unit,
                samples=len(e),
            )


def _is_one_count(view: RecordView, j: int) -> bool:
    """Whether both values of a coordinate are neighbours as far as its count is known."""
    e = view.experiment
    count = e.coordinates[j].resolution
    if count:
        return bool(np.ptp(e.q[:, j]) < 1.5 * count)
    # a coordinate that goes from one place to another changes once or twice
    return int(np.count_nonzero(np.diff(e.q[:, j]))) > 2


def wild_angle(view: RecordView) -> Iterator[Finding]:
    """Angles that often move more than a quarter turn from sample to sample."""
    for j, c in enumerate(view.experiment.coordinates):
        if share := view.wild_share(j):
            yield view.finding(
                "fast angle", coordinate_line(c.name, "correct `unit`"), c.name, share=share
            )


def jumps(view: RecordView) -> Iterator[Finding]:
    """Jumps of positions: spikes, lost counts, counters that overflow, wraps of another unit."""
    e = view.experiment
    for j, c in enumerate(e.coordinates):
        if view.wild_share(j) or not view.moving[j]:
            continue
        rows = outliers.find_jumps(e.t, e.q[:, j], c.resolution or view.recording.counts[j] or 0.0)
        rows = rows[~_ends_standstill(view, j, rows) & ~_follows_step(view, rows)]
        if not len(rows):
            continue
        sizes = _jump_sizes(e.q[:, j], rows)
        worst = float(np.abs(sizes).max())
        cause, mend = _meaning_of_jumps(view, j, sizes) or (
            None,
            file_parts(e, [(int(k), int(k)) for k in rows]),
        )
        is_sure = cause is not None and len(rows) >= LEVELS.often
        yield view.finding(
            "jump" if cause is None else "counter",
            mend,
            c.name,
            view.seconds(int(rows[0])),
            severity="severe" if is_sure else "warning",
            rows=rows.tolist(),
            cause=cause,
            count=len(rows),
            largest=worst,
            unit=c.unit,
            counts=worst / view.counts[j] if view.counts[j] else None,
        )


def _meaning_of_jumps(
    view: RecordView, j: int, sizes: Float[np.ndarray, " jumps"]
) -> tuple[Finding, str] | None:
    """Cause of jumps of a size that counters and units have, and the line; None of others."""
    c, count = view.experiment.coordinates[j], view.counts[j]
    block = view.coordinate_card(c.name)
    size = np.abs(sizes)
    size = size[
        size > LEVELS.main_jumps * size.max()
    ]  # a bad row beside a jump is no jump of its own
    typical = float(np.median(size))
    if np.mean(np.abs(size - typical) < 0.2 * typical) < LEVELS.most_jumps:
        return None
    turn = 2 * np.pi
    if c.kind == "angular":
        if block is not None and not block.unwrap and abs(typical / turn - 1) < 0.2:
            return make_finding("encoder wraps"), coordinate_line(c.name, "unwrap = true")
        if (other := _turn_of_other(view, j, typical)) is not None:
            mend = coordinate_line(c.name, f"exchange `column` with that of {other}")
            return make_finding("turn of another", other=other), mend
        degrees = abs(360 - turn * round(360 / turn))
        if abs(typical / degrees - 1) < LEVELS.same_wrap:
            return make_finding("degrees wrap"), coordinate_line(c.name, 'unit = "deg"')
        if abs(typical / np.deg2rad(turn) - 1) < LEVELS.same_wrap:
            return make_finding("radians wrap"), coordinate_line(c.name, 'unit = "rad"')
    if not count:
        return None
    for bits in _BITS:
        jump = 2**bits * count
        if c.kind == "angular" and (block is None or block.unwrap):
            jump = abs(jump - turn * round(jump / turn))
        if jump > 3 * LEVELS.counts * count and abs(typical - jump) < max(
            3 * count, LEVELS.same_jump * jump
        ):
            mend = "no line of the card: add the overflows to the column in the file"
            return make_finding("counter overflows", bits=bits), mend
    return None


def _turn_of_other(view: RecordView, j: int, jump: float) -> str | None:
    """The coordinate whose encoder makes jumps of this size where it is read as another one."""
    blocks = view.card.coordinates if view.card is not None else []
    own = blocks[j].counts_per_revolution if blocks else None
    for other in blocks:
        if own and other.counts_per_revolution and other.name != blocks[j].name:
            turns = other.counts_per_revolution / own
            expected = 2 * np.pi * abs(turns - round(turns))
            if abs(jump - expected) < 0.1 * expected:
                return other.name
    return None


def _jump_sizes(q: Float[np.ndarray, " n"], rows: Int[np.ndarray, " r"]) -> np.ndarray:
    """Changes at some rows without those of the motion around them."""
    change = np.diff(q)
    near = [np.r_[max(k - 4, 0) : k - 1, k : min(k + 3, len(change))] for k in rows]
    return np.array([change[k - 1] - np.median(change[n]) for k, n in zip(rows, near, strict=True)])


def _standstills(view: RecordView, j: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Runs of equal values that a coordinate enters and leaves at speed.

    On a grid, the interpolation of a constant settles within some samples of its ends.

    Returns:
        Those after which the position catches up, as behind a sensor that froze, and those at
        either end of its range; first samples, and the ones after the last.
    """
    e, q, noise = view.experiment, view.experiment.q[:, j], max(view.counts[j], view.noise[j])
    if not view.moving[j] or len(e) < LEVELS.fewest_samples:
        return [], []
    margin = 0 if e.recording is None else LEVELS.interpolated
    ends = np.flatnonzero(np.abs(np.diff(q)) > bool(margin) * LEVELS.settled * noise)
    first, last = np.r_[0, ends + 1], np.r_[ends, len(e) - 1]
    length = last - first + 1
    inside = (length >= LEVELS.clipped) & (first >= 4 + margin) & (last < len(q) - 5 - margin)
    first, last, length = first[inside], last[inside], length[inside]
    before = (q[first - margin - 1] - q[first - margin - 4]) / 3
    after = (q[last + margin + 4] - q[last + margin + 1]) / 3
    slower, faster = np.sort(np.abs([before, after]), axis=0)
    noise *= LEVELS.counts
    missed, expected = q[last + margin + 1] - q[last], (before + after) / 2 * (length + margin)
    catches_up = (
        (length >= LEVELS.frozen + 2 * margin)
        & (np.abs(missed) > np.maximum(noise, 3 * faster))
        & (np.abs(expected) > noise)
        & (np.abs(missed - expected) < 0.6 * np.abs(missed) + noise)
    )
    # a turning point that lasts so long is left at a speed of half of this
    is_sharp = slower > np.maximum(noise, 2 * np.median(np.abs(np.diff(q, 2))) * length)
    extreme = (q[first] <= q.min() + noise) | (q[first] >= q.max() - noise)
    runs = np.stack([first, last + 1], axis=1)
    frozen, clipped = runs[catches_up], runs[is_sharp & extreme & ~catches_up]
    return [(a, b) for a, b in frozen.tolist()], [(a, b) for a, b in clipped.tolist()]


def _ends_standstill(view: RecordView, j: int, rows: Int[np.ndarray, " r"]) -> np.ndarray:
    """Mask of jumps that end a standstill of the sensor, which `standstills` reports."""
    frozen, _ = _standstills(view, j)
    return np.isin(rows, [b + k for _, b in frozen for k in range(LEVELS.interpolated + 1)])


def _follows_step(view: RecordView, rows: Int[np.ndarray, " r"]) -> np.ndarray:
    """Mask of jumps that follow a step of an input, which moves a stiff mechanism as fast."""
    change = np.abs(np.diff(view.experiment.u, axis=0, prepend=view.experiment.u[:1]))
    if not change.size or not len(rows):
        return np.zeros(len(rows), bool)
    is_step = np.any(
        change > LEVELS.step * np.maximum(np.quantile(change, 0.9, axis=0), 1e-300), axis=1
    )
    return np.any(is_step[np.maximum(rows[:, None] - [1, 2, 3], 0)], axis=1)


def standstills(view: RecordView) -> Iterator[Finding]:
    """Sensors that repeat a value in the middle of motion, or at an end of their range."""
    e = view.experiment
    for j, c in enumerate(e.coordinates):
        frozen, clipped = _standstills(view, j)
        kinds = []
        if frozen:
            kinds.append(("frozen sensor", file_parts(e, frozen), frozen))
        if len(clipped) > 1:
            mend = "no line of the card: the end of the sensor, or a stop of the mechanism?"
            kinds.append(("clipped sensor", mend, clipped))
        for code, mend, runs in kinds:
            samples = [stop - first for first, stop in runs]
            yield view.finding(
                code,
                mend,
                c.name,
                view.seconds(runs[0][0]),
                count=len(runs),
                samples=sum(samples),
                milliseconds=1e3 * max(samples) * e.dt,
            )


def encoder(view: RecordView) -> Iterator[Finding]:
    """Encoder count of the positions against the declared one."""
    e = view.experiment
    for c, q, count in zip(e.coordinates, e.q.T, view.recording.counts, strict=True):
        if not (c.resolution and count) or abs(count / c.resolution - 1) <= LEVELS.other_count:
            continue
        if len(np.unique(q)) < LEVELS.fewest_counts:  # a few levels have a common step by chance
            continue
        block, key = view.coordinate_card(c.name), f"resolution = {count:.5g}"
        if block is not None and block.counts_per_revolution is not None:
            key = f"counts_per_revolution = {2 * np.pi / count:.6g}"
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


def padded_velocities(view: RecordView) -> Iterator[Finding]:
    """Velocity columns with rows of zeros at the ends, while the positions move."""
    e = view.experiment
    lead, trail = e.padded_rows
    if lead or trail:
        is_used = e.v_measured
        yield view.finding(
            "padded velocity",
            "velocity = { ..., measured = false }" if is_used else "none is needed",
            severity="warning" if is_used else "note",
            first=lead,
            last=trail,
            is_used=is_used,
        )


def velocities(view: RecordView) -> Iterator[Finding]:
    """Velocity columns against the slope of the positions: sign, unit, gain, lag, another one's."""
    e = view.experiment
    lead, trail = e.padded_rows
    usable = slice(lead, len(e) - trail)
    if e.v is None or usable.stop - usable.start < 40:
        return
    q, v = e.q[usable], e.v[usable].copy()
    for j in range(len(e.coordinates)):
        rows = outliers.find_outliers(v[:, j])
        if len(rows):
            others = np.delete(np.arange(len(v)), rows)
            usual = np.interp(rows, others, v[others, j])
            yield _velocity_finding(
                view,
                j,
                make_finding("has outliers", rows=(rows + lead).tolist()),
                make_finding("by up to", largest=np.abs(v[rows, j] - usual).max()),
                _UNUSED,
                "warning",
            )
            v[rows, j] = usual
    windows = Windows(4, 1, e.dt)
    slopes, columns = windows.average_derivative(q), windows.average(v)
    for j in range(len(e.coordinates)):
        if np.std(slopes[:, j]) > 3 * view.noise[j] / (2 * windows.half * e.dt):
            yield from _compare_velocity(view, j, slopes, columns[:, j])


def _compare_velocity(
    view: RecordView, j: int, slopes: Float[np.ndarray, "m n_q"], column: Float[np.ndarray, " m"]
) -> Iterator[Finding]:
    """Findings about a velocity column; it has to follow a slope to be called wrong for sure."""
    e = view.experiment
    lag, correlation, gain = _best_lag(slopes[:, j], column)
    others = [abs(np.corrcoef(s, column)[0, 1]) if np.std(s) else 0.0 for s in slopes.T]
    best = int(np.argmax(others))
    # noise of one of both alone may change the gain by as much as the correlation
    deviation = abs(gain - 1) - (1 - correlation)
    how = make_finding("times the slope", gain=gain, correlation=correlation)
    key, relation, severity = _UNUSED, None, "severe"
    if best != j and others[best] > max(LEVELS.high_correlation, abs(correlation) + 0.1):
        relation = make_finding("is that of another", other=e.coordinates[best].name)
        how = make_finding("correlates with another", correlation=correlation, other=others[best])
    elif correlation < -LEVELS.high_correlation:
        relation = make_finding("has the opposite sign")
    elif correlation < LEVELS.low_correlation:
        relation, severity = make_finding("disagrees"), "warning"
    elif correlation > LEVELS.high_correlation and deviation > LEVELS.gain_of_velocity:
        key = _velocity_unit(view, j, gain)
        severity = "severe" if deviation > LEVELS.other_gain else "warning"
        if key != _UNUSED or e.v_measured:  # else nothing is to be done, whatever its scale is
            relation = make_finding("has another scale")
    if relation is not None:
        yield _velocity_finding(view, j, relation, how, key, severity)
    if correlation > LEVELS.high_correlation and lag > LEVELS.lag_of_velocity:
        period = timescales([e.q[:, j]]).period
        if lag > LEVELS.lag_share * min(period, 400.0):
            how = make_finding("milliseconds", milliseconds=1e3 * lag * e.dt, samples=lag)
            yield _velocity_finding(view, j, make_finding("lags"), how, _UNUSED, "warning")


def _velocity_unit(view: RecordView, j: int, gain: float) -> str:
    """The entry of the card for a velocity column that is some times the slope."""
    if abs(gain - 1) < LEVELS.same_velocity_unit:
        return _UNUSED
    c = view.experiment.coordinates[j]
    card = view.coordinate_card(c.name)
    declared = card.velocity_factor() if card and card.velocity else 1.0
    for name in _VELOCITIES.get(c.unit, ()):
        if abs(velocity_factor(name, c.unit) * gain / declared - 1) < LEVELS.same_velocity_unit:
            return f'unit = "{name}"'
    return _UNUSED


def _best_lag(x: Float[np.ndarray, " m"], y: Float[np.ndarray, " m"]) -> tuple[float, float, float]:
    """Lag of `y` behind `x` in samples, and correlation and gain at it."""
    x, y = x - x.mean(), y - y.mean()
    lags = range(-3, min(LEVELS.most_lags, len(x) // 4) + 1)
    pairs = [(x[max(0, -k) : len(x) - max(k, 0)], y[max(k, 0) : len(y) + min(k, 0)]) for k in lags]
    r = np.array([a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-300) for a, b in pairs])
    best = int(np.argmax(np.abs(r)))
    a, b = pairs[best]
    shift = 0.0
    if 0 < best < len(r) - 1:
        left, middle, right = np.abs(r[best - 1 : best + 2])
        shift = 0.5 * (left - right) / (left - 2 * middle + right) if middle < 1 else 0.0
    return (
        lags[best] + float(np.clip(shift, -0.5, 0.5)),
        float(r[best]),
        float(np.sign(r[best]) * np.sqrt((b @ b) / (a @ a))),
    )


def _velocity_finding(
    view: RecordView, j: int, relation: Finding, how: Finding, key: str, severity: Severity
) -> Finding:
    """A finding about a velocity column, a degree milder where no fit uses it."""
    c = view.experiment.coordinates[j]
    if not view.experiment.v_measured:
        severity = SEVERITIES[SEVERITIES.index(severity) + 1]
    return view.finding(
        "velocity",
        coordinate_line(c.name, f"velocity = {{ {key} }}"),
        c.name,
        severity=severity,
        is_velocity=True,
        relation=relation,
        how=how,
    )


# --- inputs ---


def input_spikes(view: RecordView) -> Iterator[Finding]:
    """Inputs with single samples that are huge compared with all others."""
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


def limits(view: RecordView) -> Iterator[Finding]:
    """Inputs beyond the declared limits of their actuators."""
    e = view.experiment
    for i, u in zip(e.inputs, e.u.T, strict=True):
        if i.limits is None:
            continue
        low, high = i.limits
        margin = LEVELS.beyond_limits * (high - low)
        beyond = (u < low - margin) | (u > high + margin)
        if beyond.any():
            reach = max(low - u.min(), u.max() - high)
            wide = f"limits = [{min(low, u.min()):.4g}, {max(high, u.max()):.4g}]"
            yield view.finding(
                "limits",
                input_line(i.name, wide),
                i.name,
                view.seconds(int(np.argmax(beyond))),
                beyond=reach,
                unit=i.unit,
                samples=int(beyond.sum()),
                share=beyond.mean(),
            )


CHECKS: tuple[Callable[[RecordView], Iterator[Finding]], ...] = (
    period,
    time_unit,
    gaps,
    sampling,
    dead_sensor,
    wild_angle,
    jumps,
    standstills,
    encoder,
    padded_velocities,
    velocities,
    input_spikes,
    limits,
)
