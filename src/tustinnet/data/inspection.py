"""Inspection of a record before anything is fitted to it."""

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
from tustinnet.signals.timescales import Timescales, correlation_time, timescales
from tustinnet.signals.transients import RestThresholds

_REST_SECONDS = 0.25  # slow for this long around a sample: near an equilibrium, not a turning point
# an input of more levels than this is called saturated when it is at an extreme one for this
# share of the time, and three times as often as if all levels were equally frequent
_FEW_LEVELS = 10
_STUCK_SHARE = 0.02
_OTHER_COUNT = 0.01  # relative; an encoder count this far from the declared one is another
_FEWEST_COUNTS = 10  # levels of a position that tell the count of its encoder
_QUARTER, _OFTEN = np.pi / 2, 0.05  # no angle moves by this a sample, in this share of the samples
_MOST_OF_A_TURN = 1.5 * np.pi  # rad; a link that falls from upright ends short of a full turn
_FAST, _FAST_SHARE = 0.1, 0.02  # of the sampling rate; of the power above it
_FARTHEST, _STRONGEST = 1e6, 1e9  # rad or m, and units of an input, which no mechanism reaches


@dataclass(frozen=True)
class CoordinateReport:
    """One coordinate of one record; positions in rad or m.

    Attributes:
        name: the coordinate.
        range: smallest and largest position.
        peak_speed: largest |v| [rad/s or m/s].
        count: encoder count estimated from the positions, None where they are not quantised.
        declared_count: encoder count in the data card.
        speed_threshold: speed below which the coordinate counts as at rest.
        excursion_threshold: distance from the resting value below which it counts as at rest.
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
            a little, a simulation depends on the input between the samples.
        hold: hold in the data card, None where it declares none.
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
        """Whether its course between the samples matters in a simulation."""
        return self.fast_share > _FAST_SHARE


@dataclass(frozen=True)
class ExperimentReport:
    """The result of an inspection of one record.

    Attributes:
        name: the record.
        split: its split.
        samples: its length.
        seconds: its duration.
        dt: nominal period [s].
        recording: its time base as logged, before any resampling.
        forced: whether an input changes.
        k_bar: end of the transient, as a sample index.
        k_bar_declared: whether it is declared in the data card.
        held: the unstable equilibrium that an input holds to the record's end, if any; it is no
            rest, and `k_bar` ignores it.
        rest_share: share of samples near an equilibrium.
        coordinates: a report for each coordinate.
        inputs: a report for each input.
        suspicious: sentences about rows that look wrong.
        notes: remarks on how the record was read.
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
        The report that `tustinnet inspect` prints.
    """
    e = experiment
    v = e.velocities("stencil")
    recording = e.recording or describe_recording(e.t, e.q, e.dt)
    thresholds = transients.rest_thresholds(e.q, v, e.channels.resolution, e.dt)
    equilibrium = None
    if e.forced:
        angular = tuple(c.kind == "angular" for c in e.coordinates)
        equilibrium = equilibria.find_held_equilibrium(e.q, v, e.u, angular, e.dt)
    coordinates = tuple(
        CoordinateReport(
            name=c.name,
            range=(float(e.q[:, j].min()), float(e.q[:, j].max())),
            peak_speed=float(np.abs(v[:, j]).max()),
            count=recording.counts[j],
            declared_count=c.resolution,
            speed_threshold=float(thresholds.speed[j]),
            excursion_threshold=float(thresholds.excursion[j]),
            resting=float(thresholds.resting[j]),
        )
        for j, c in enumerate(e.coordinates)
    )
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
        held=equilibrium,
        rest_share=float(np.mean(_near_equilibrium(v, thresholds, e.dt))),
        coordinates=coordinates,
        inputs=tuple(_inspect_input(e, j) for j in range(e.u.shape[1])),
        suspicious=_suspicious(e, v, recording),
        notes=e.notes,
    )


def still_coordinates(experiments: Sequence[Experiment]) -> list[str]:
    """Names of the coordinates that move in none of some records of a system."""
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


def correlation_times(experiments: Sequence[Experiment]) -> dict[str, float]:
    """Samples in which each velocity that moves loses its correlation, by the coordinate's name."""
    moving = moving_coordinates(experiments)
    velocities = [e.velocities("wiener") for e in experiments]
    return {
        c.name: correlation_time([v[:, j] for v in velocities])
        for j, c in enumerate(experiments[0].coordinates)
        if moving[j]
    }


def rotating_coordinates(experiments: Sequence[Experiment]) -> set[str]:
    """Names of the angles that cover most of a turn in the records: no spring holds them."""
    q = np.concatenate([e.q for e in experiments])
    return {
        c.name
        for c, span in zip(experiments[0].coordinates, np.ptp(q, axis=0), strict=True)
        if c.kind == "angular" and span > _MOST_OF_A_TURN
    }


def transient_end(experiment: Experiment) -> int:
    """`k_bar`: the end of a record's transient, as a sample index.

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


def _inspect_input(e: Experiment, j: int) -> InputReport:
    u = e.u[:, j]
    low, high = float(u.min()), float(u.max())
    bandwidth, fast = None, 0.0
    if high > low:
        frequency, power = periodogram(u, e.dt)
        share = np.cumsum(power) / np.sum(power)
        bandwidth = float(frequency[np.searchsorted(share, 0.9)])
        fast = float(np.sum(power[frequency > _FAST / e.dt]) / np.sum(power))
    limits = e.inputs[j].limits
    if limits is not None:
        saturated = float(np.mean((u <= limits[0]) | (u >= limits[1])))
    else:
        # an input of many levels that stays at an extreme one was probably limited there
        levels, extreme = len(np.unique(u)), float(np.mean((u == low) | (u == high)))
        is_stuck = levels > _FEW_LEVELS and extreme > max(_STUCK_SHARE, 3 * 2 / levels)
        saturated = extreme if is_stuck else 0.0
    return InputReport(
        name=e.inputs[j].name,
        range=(low, high),
        rms=float(np.sqrt(np.mean(u**2))),
        bandwidth=bandwidth,
        fast_share=fast,
        hold=e.inputs[j].hold,
        saturated=saturated,
    )


def _near_equilibrium(
    v: Float[np.ndarray, "n n_q"], thresholds: RestThresholds, dt: float
) -> Bool[np.ndarray, " n"]:
    """Mask of the samples around which all coordinates are slow for a while."""
    slow = np.all(transients.is_slow(v, thresholds), axis=1)
    width = max(5, round(_REST_SECONDS / dt)) | 1
    if width >= len(slow):
        return np.full(len(slow), bool(slow.all()))
    total = np.cumsum(np.pad(slow, (width // 2 + 1, width // 2), mode="edge"))
    return total[width:] - total[:-width] == width


def _suspicious(
    e: Experiment, v: Float[np.ndarray, "n n_q"], recording: Recording
) -> tuple[str, ...]:
    """Sentences about rows of a record that look wrong."""
    sentences = []
    lead, trail = e.padded_rows
    if lead or trail:
        sentences.append(
            f"velocity columns are padded with zero rows ({lead} at the beginning, {trail} at the "
            "end): not measured"
        )
    for j in range(len(e.coordinates)):
        sentences += _suspicious_positions(e, j, recording.counts[j])
    for i, u in zip(e.inputs, e.u.T, strict=True):
        if np.abs(u).max() > _STRONGEST:
            sentences.append(
                f"{i.name} reaches {np.abs(u).max():.3g} {i.unit} (unit or a bad row?)"
            )
        if len(rows := outliers.find_spikes(u)):
            sentences.append(f"{i.name} has spikes at sample {_list_rows(rows)} (bad rows?)")
    real = slice(lead, len(e) - trail)
    if e.v is not None and real.stop > real.start:
        size = np.sqrt(np.mean(v[real] ** 2, axis=0))
        differs = np.sqrt(np.mean((e.v[real] - v[real]) ** 2, axis=0)) > 0.5 * size
        sentences += [
            f"{c.name}: the velocity column disagrees with the change of the positions "
            "(unit or sign?)"
            for c, wrong in zip(e.coordinates, differs, strict=True)
            if wrong
        ]
    return tuple(sentences)


def _suspicious_positions(e: Experiment, j: int, count: float | None) -> list[str]:
    """Sentences about wrong positions of a coordinate, whose encoder count is known or None."""
    coordinate, q = e.coordinates[j], e.q[:, j]
    if not transients.is_moving(e.q)[j]:
        return [f"{coordinate.name} never changes"]
    sentences, unit = [], coordinate.unit
    if unit in ("rad", "m") and np.abs(q).max() > _FARTHEST:
        sentences.append(
            f"{coordinate.name} reaches {np.abs(q).max():.3g} {unit} (unit or a bad row?)"
        )
    wild = np.mean(np.abs(np.diff(q)) > _QUARTER) if coordinate.kind == "angular" else 0.0
    if wild > _OFTEN:
        sentences.append(
            f"{coordinate.name} moves more than a quarter turn in {wild:.0%} of the periods "
            "(wrong unit, or sampled too slowly?)"
        )
    elif len(rows := outliers.find_jumps(e.t, q, coordinate.resolution or count or 0.0)):
        sentences.append(
            f"{coordinate.name} jumps at sample {_list_rows(rows)} (bad rows, or lost counts?)"
        )
    # a few levels have a common step by chance
    is_encoder = count is not None and len(np.unique(q)) >= _FEWEST_COUNTS
    declared = coordinate.resolution
    if is_encoder and declared and abs(count / declared - 1) > _OTHER_COUNT:
        sentences.append(
            f"{coordinate.name}: encoder count {count:.5g} {unit} found, "
            f"{declared:.5g} {unit} declared"
        )
    return sentences


def _list_rows(rows: np.ndarray) -> str:
    return ", ".join(str(int(r)) for r in rows[:5]) + (" ..." if len(rows) > 5 else "")
