"""The inspection of records: what they are, and what is wrong with them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.channels import Hold
from tustinnet.check.check import check_views, view_record
from tustinnet.check.view import RecordView
from tustinnet.data.card import Card
from tustinnet.data.experiment import Experiment
from tustinnet.data.inspection import held_equilibrium, saturated_share, transient_end
from tustinnet.data.recording import Recording
from tustinnet.finding import Finding
from tustinnet.shown import Brief
from tustinnet.signals import transients
from tustinnet.signals.equilibria import HeldEquilibrium
from tustinnet.signals.spectra import periodogram
from tustinnet.signals.transients import RestThresholds


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
        return self.fast_share > 0.02


@dataclass(frozen=True, repr=False)
class ExperimentReport(Brief):
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
        suspicious: sentences about what is wrong with it, the statements of its findings.
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


@dataclass(frozen=True)
class Inspection:
    """The result of an inspection of the records of one machine.

    Attributes:
        reports: a report for each record.
        findings: what is wrong with them, the most severe first.
    """

    reports: tuple[ExperimentReport, ...]
    findings: tuple[Finding, ...]


def inspect_records(records: Iterable[Experiment], card: Card | None = None) -> Inspection:
    """Examines the records of one machine, each and against one another.

    Args:
        records: the records.
        card: their data card, which the findings name lines of.
    """
    records = tuple(records)
    views = [view_record(e, card) for e in records]
    findings = check_views(views)
    reports = (_report(e, view, findings) for e, view in zip(records, views, strict=True))
    return Inspection(tuple(reports), findings)


def inspect_experiment(experiment: Experiment) -> ExperimentReport:
    """Examines a record: time base, encoders, excitation, rest, and what is wrong with it.

    Args:
        experiment: the record.

    Returns:
        The report that `tustinnet inspect` prints.
    """
    return inspect_records([experiment]).reports[0]


def _report(e: Experiment, view: RecordView, findings: Sequence[Finding]) -> ExperimentReport:
    """The report on a record, its view without a controller, with the findings on all records."""
    v, recording = view.velocity, view.recording
    thresholds = transients.rest_thresholds(e.q, v, e.channels.resolution, e.dt)
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
        held=held_equilibrium(e),
        rest_share=float(np.mean(_near_equilibrium(v, thresholds, e.dt))),
        coordinates=coordinates,
        inputs=tuple(_inspect_input(e, j) for j in range(e.u.shape[1])),
        suspicious=tuple(f.statement for f in findings if f.is_serious and e.name in f.records),
        notes=e.notes,
    )


def _inspect_input(e: Experiment, j: int) -> InputReport:
    u = e.u[:, j]
    low, high = float(u.min()), float(u.max())
    bandwidth, fast = None, 0.0
    if high > low:
        frequency, power = periodogram(u, e.dt)
        share = np.cumsum(power) / np.sum(power)
        bandwidth = float(frequency[np.searchsorted(share, 0.9)])
        fast = float(np.sum(power[frequency > 0.1 / e.dt]) / np.sum(power))
    return InputReport(
        name=e.inputs[j].name,
        range=(low, high),
        rms=float(np.sqrt(np.mean(u**2))),
        bandwidth=bandwidth,
        fast_share=fast,
        hold=e.inputs[j].hold,
        saturated=saturated_share(u, e.inputs[j].limits),
    )


def _near_equilibrium(
    v: Float[np.ndarray, "n n_q"], thresholds: RestThresholds, dt: float
) -> Bool[np.ndarray, " n"]:
    """Mask of the samples around which all coordinates are slow for a while."""
    slow = np.all(transients.is_slow(v, thresholds), axis=1)
    # slow for this long around a sample: near an equilibrium, not a turning point
    width = max(5, round(0.25 / dt)) | 1
    if width >= len(slow):
        return np.full(len(slow), bool(slow.all()))
    total = np.cumsum(np.pad(slow, (width // 2 + 1, width // 2), mode="edge"))
    return total[width:] - total[:-width] == width
