"""What a record holds, before anything is fitted to it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Hold
from tustinnet.data.experiment import Experiment, moving_coordinates
from tustinnet.data.recording import Recording, describe_recording
from tustinnet.signals import equilibria, outliers, transients
from tustinnet.signals.equilibria import HeldEquilibrium
from tustinnet.signals.spectra import periodogram
from tustinnet.signals.timescales import Timescales, timescales
from tustinnet.signals.transients import RestThresholds

_REST_SECONDS = 0.25  # slow for this long around a sample: near an equilibrium, not a turning point
# an input of more than so many levels is called saturated when it is at an extreme one for this
# share of the time, and three times as often as if all levels were equally frequent
_FEW_LEVELS = 10
_STUCK_SHARE = 0.02
_OTHER_COUNT = 0.01  # relative; an encoder count this far from the declared one is another
_QUARTER, _OFTEN = np.pi / 2, 0.05  # an angle that moves so far a sample, so often, is none
_AROUND = 1.5 * np.pi  # rad; a link that falls from upright ends short of a full turn
_FAST, _FAST_SHARE = 0.1, 0.02  # of the sampling rate; of the power above it
_FARTHEST, _STRONGEST = 1e6, 1e9  # rad or m, and of inputs: no mechanism has them


@dataclass(frozen=True)
class CoordinateReport:
    """One coordinate of one record; positions in rad or m.

    Attributes:
        name: the coordinate.
        range: smallest and largest position.
        peak_speed: largest |v| [rad/s or m/s].
        count: encoder count found in the positions, None where they are not quantised.
        declared_count: the count that the data card declares.
        speed_threshold: below this speed the coordinate counts as at rest.
        excursion_threshold: the same for the distance from the resting value.
        resting: the resting value.
    """

    name: str
    range: tuple[float, float]
    peak_speed: float
    count: float | None
    declared_count: float | None
    speed_threshold: float
    excursion_threshold: float
    resting: float


@dataclass(frozen=True)
class InputReport:
    """One input of one record, in its own unit.

    Attributes:
        name: the input.
        range: smallest and largest value.
        rms: root mean square.
        bandwidth: frequency below which 90 % of its power lies [Hz], None for a constant.
        fast_share: share of its power above a tenth of the sampling rate. Where there is more than
            a little, a simulation depends on what the input does between the samples.
        hold: what the data card says of that, None where it says nothing.
        saturated: share of samples at a declared limit, or stuck at an extreme value.
    """

    name: str
    range: tuple[float, float]
    rms: float
    bandwidth: float | None
    fast_share: float
    hold: Hold | None
    saturated: float

    @property
    def hold_matters(self) -> bool:
        """Whether what it does between the samples shows in a simulation."""
        return self.fast_share > _FAST_SHARE


@dataclass(frozen=True)
class ExperimentReport:
    """What `inspect` found in one record.

    Attributes:
        name: the record.
        split: its split.
        samples: its length.
        seconds: its duration.
        dt: nominal period [s].
        recording: how it was sampled, before it was put on a grid where it was.
        forced: whether an input changes.
        k_bar: end of the transient, as a sample index.
        k_bar_declared: whether the data card says so.
        held: the unstable equilibrium that an input holds to the record's end, if any; it is no
            rest: `k_bar` does not know of it.
        rest_share: share of samples near an equilibrium.
        coordinates: per coordinate.
        inputs: per input.
        suspicious: sentences about rows that look wrong.
        notes: what reading the record found and did.
    """

    name: str
    split: str | None
    samples: int
    seconds: float
    dt: float
    recording: Recording
    forced: bool
    k_bar: int
    k_bar_declared: bool
    held: HeldEquilibrium | None
    rest_share: float
    coordinates: tuple[CoordinateReport, ...]
    inputs: tuple[InputReport, ...]
    suspicious: tuple[str, ...]
    notes: tuple[str, ...]


def inspect_experiment(experiment: Experiment) -> ExperimentReport:
    """Examines a record: time base, encoders, excitation, rest, suspicious rows.

    Args:
        experiment: the record.

    Returns:
        What was found; `tustinnet inspect` prints it.
    """
    e = experiment
    v = e.velocities("stencil")
    recording = e.recording or describe_recording(e.t, e.q, e.dt)
    thresholds = transients.rest_thresholds(e.q, v, e.channels.resolution, e.dt)
    return ExperimentReport(
        name=e.name,
        split=e.split,
        samples=len(e),
        seconds=e.seconds,
        dt=e.dt,
        recording=recording,
        forced=e.forced,
        k_bar=transient_end(e),
        k_bar_declared=e.k_bar is not None,
        held=equilibria.find_held_equilibrium(
            e.q, v, e.u, tuple(c.kind == "angular" for c in e.coordinates), e.dt
        )
        if e.forced
        else None,
        rest_share=float(np.mean(_near_equilibrium(v, thresholds, e.dt))),
        coordinates=tuple(_coordinate(e, j, v, thresholds, recording) for j in range(e.q.shape[1])),
        inputs=tuple(_input(e, j) for j in range(e.u.shape[1])),
        suspicious=_suspicious(e, v, recording),
        notes=e.notes,
    )


def still_coordinates(experiments: Sequence[Experiment]) -> list[str]:
    """The names of the coordinates that move in none of some records of a system."""
    moving = moving_coordinates(experiments)
    return [c.name for c, m in zip(experiments[0].coordinates, moving, strict=True) if not m]


def coordinate_timescales(experiments: Sequence[Experiment]) -> dict[str, Timescales]:
    """The time scales of each coordinate that moves, by its name."""
    moving = moving_coordinates(experiments)
    return {
        c.name: timescales([e.q[:, j] for e in experiments])
        for j, c in enumerate(experiments[0].coordinates)
        if moving[j]
    }


def rotating_coordinates(experiments: Sequence[Experiment]) -> set[str]:
    """The angles that cover most of a turn in the records, by name: no spring holds them."""
    q = np.concatenate([e.q for e in experiments])
    return {
        c.name
        for c, span in zip(experiments[0].coordinates, np.ptp(q, axis=0), strict=True)
        if c.kind == "angular" and span > _AROUND
    }


def transient_end(experiment: Experiment) -> int:
    """`k_bar`: where the transient of a record ends, as a sample index.

    The declared one where there is one; the record's end where an input changes; else the first
    sample after which all speeds and all excursions from the resting value stay below the
    thresholds of `rest_thresholds` to the end.
    """
    if experiment.k_bar is not None:
        return experiment.k_bar
    if experiment.forced:
        return len(experiment)
    v = experiment.velocities("stencil")
    thresholds = transients.rest_thresholds(
        experiment.q, v, experiment.channels.resolution, experiment.dt
    )
    return transients.settling_index(experiment.q, v, thresholds)


def _coordinate(
    e: Experiment,
    j: int,
    v: Float[np.ndarray, "n n_q"],
    thresholds: RestThresholds,
    recording: Recording,
) -> CoordinateReport:
    q = e.q[:, j]
    return CoordinateReport(
        name=e.coordinates[j].name,
        range=(float(q.min()), float(q.max())),
        peak_speed=float(np.abs(v[:, j]).max()),
        count=recording.counts[j],
        declared_count=e.coordinates[j].resolution,
        speed_threshold=float(thresholds.speed[j]),
        excursion_threshold=float(thresholds.excursion[j]),
        resting=float(thresholds.resting[j]),
    )


def _input(e: Experiment, j: int) -> InputReport:
    u = e.u[:, j]
    low, high = float(u.min()), float(u.max())
    bandwidth, fast = None, 0.0
    if high > low:
        frequency, power = periodogram(u, e.dt)
        share = np.cumsum(power) / np.sum(power)
        bandwidth = float(frequency[np.searchsorted(share, 0.9)])
        fast = float(np.sum(power[frequency > _FAST / e.dt]) / np.sum(power))
    return InputReport(
        name=e.inputs[j].name,
        range=(low, high),
        rms=float(np.sqrt(np.mean(u**2))),
        bandwidth=bandwidth,
        fast_share=fast,
        hold=e.inputs[j].hold,
        saturated=_saturated_share(u, e.inputs[j].limits),
    )


def _saturated_share(u: Float[np.ndarray, " n"], limits: tuple[float, float] | None) -> float:
    if limits is not None:
        return float(np.mean((u <= limits[0]) | (u >= limits[1])))
    # without limits: an input of many levels that sits on an extreme one was probably cut there
    levels = len(np.unique(u))
    if levels <= _FEW_LEVELS:
        return 0.0
    share = float(np.mean((u == u.min()) | (u == u.max())))
    return share if share > max(_STUCK_SHARE, 3 * 2 / levels) else 0.0


def _near_equilibrium(
    v: Float[np.ndarray, "n n_q"], thresholds: RestThresholds, dt: float
) -> Bool[np.ndarray, " n"]:
    slow = np.all(transients.is_slow(v, thresholds), axis=1)
    width = max(5, round(_REST_SECONDS / dt)) | 1
    if width >= len(slow):
        return np.full(len(slow), bool(slow.all()))
    total = np.cumsum(np.pad(slow, (width // 2 + 1, width // 2), mode="edge"))
    return total[width:] - total[:-width] == width


def _suspicious(
    e: Experiment, v: Float[np.ndarray, "n n_q"], recording: Recording
) -> tuple[str, ...]:
    found = []
    lead, trail = e.padded_rows
    if lead or trail:
        found.append(
            f"velocity columns are padded with zero rows ({lead} at the beginning, {trail} at the "
            "end): not measured"
        )
    for j in range(len(e.coordinates)):
        found += _suspicious_positions(e, j, recording.counts[j])
    for j in range(len(e.inputs)):
        found += _suspicious_input(e, j)
    real = slice(lead, len(e) - trail)
    if e.v is not None and real.stop > real.start:
        size = np.sqrt(np.mean(v[real] ** 2, axis=0))
        off = np.sqrt(np.mean((e.v[real] - v[real]) ** 2, axis=0)) > 0.5 * size
        found += [
            f"{c.name}: the velocity column disagrees with the change of the positions "
            "(unit or sign?)"
            for c, differs in zip(e.coordinates, off, strict=True)
            if differs
        ]
    return tuple(found)


def _suspicious_positions(e: Experiment, j: int, count: float | None) -> list[str]:
    """What looks wrong in the positions of a coordinate, whose encoder count was found or not."""
    of, q = e.coordinates[j], e.q[:, j]
    if not transients.is_moving(e.q)[j]:
        return [f"{of.name} never changes"]
    found = []
    if of.unit in ("rad", "m") and np.abs(q).max() > _FARTHEST:
        found.append(f"{of.name} reaches {np.abs(q).max():.3g} {of.unit} (unit or a bad row?)")
    wild = np.mean(np.abs(np.diff(q)) > _QUARTER) if of.kind == "angular" else 0.0
    if wild > _OFTEN:
        found.append(
            f"{of.name} moves more than a quarter turn in {wild:.0%} of the periods "
            "(wrong unit, or sampled too slowly?)"
        )
    elif len(rows := outliers.find_jumps(e.t, q, of.resolution or count or 0.0)):
        found.append(f"{of.name} jumps at sample {_first(rows)} (bad rows, or lost counts?)")
    if of.resolution and count and abs(count / of.resolution - 1) > _OTHER_COUNT:
        found.append(
            f"{of.name}: encoder count {count:.5g} {of.unit} found, "
            f"{of.resolution:.5g} {of.unit} declared"
        )
    return found


def _suspicious_input(e: Experiment, j: int) -> list[str]:
    of, u = e.inputs[j], e.u[:, j]
    found = []
    if np.abs(u).max() > _STRONGEST:
        found.append(f"{of.name} reaches {np.abs(u).max():.3g} {of.unit} (unit or a bad row?)")
    if len(rows := outliers.find_spikes(u)):
        found.append(f"{of.name} has spikes at sample {_first(rows)} (bad rows?)")
    return found


def _first(rows: np.ndarray) -> str:
    return ", ".join(str(int(r)) for r in rows[:5]) + (" ..." if len(rows) > 5 else "")
