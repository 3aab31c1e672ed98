"""What is said of the free runs of a model on records: tables, sentences and plain values."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import fmean
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.data.experiment import Experiment
from tustinnet.evaluate.ahead import joint_rmse, rmse_ahead_by_unit
from tustinnet.evaluate.bands import BandOptions
from tustinnet.evaluate.coverage import Coverage
from tustinnet.evaluate.horizons import HorizonError, describe_followed, seconds_followed
from tustinnet.evaluate.reference import Reference
from tustinnet.evaluate.residuals import ResidualReport
from tustinnet.evaluate.scores import Score, mean_rmse, mean_rmse_by_unit, rmse_by_record
from tustinnet.fitting.inverse_dynamics.record_forces import RecordForces, force_errors
from tustinnet.fitting.report import ForceError, Stretch
from tustinnet.report.fits import force_errors_table
from tustinnet.report.residuals import downweighted_table, residual_table
from tustinnet.report.tables import Table, number
from tustinnet.simulate.horizon import horizon_words
from tustinnet.simulate.starts import start_named

_SCORE_KEYS = ("experiment", "rmse", "rmse_after", "coordinate_rmse", "nrmse", "fit_percent")


@dataclass(frozen=True)
class Evaluation:
    """The free runs of a model on records, and what else was asked about them.

    Attributes:
        channels: coordinates and inputs.
        records: the records.
        start: where the free runs start.
        scores: their scores.
        whole: the scores of whole records.
        horizons: errors over longer and longer free runs.
        reference: what a trivial predictor is off by.
        band_options: of the bands, None without.
        coverage: shares of the motion inside the bands.
        ahead: errors of predictions some steps ahead, None without.
        along: the forces along the records, none unless they are asked for.
        residuals: tests of the errors, by coordinate; none unless they are asked for.
        downweighted: stretches of the records that weighed little in the identification.
    """

    channels: Channels
    records: Sequence[Experiment]
    start: str
    scores: Sequence[Score]
    whole: Sequence[Score]
    horizons: Sequence[HorizonError]
    reference: Reference
    band_options: BandOptions | None
    coverage: Sequence[Coverage]
    ahead: Float[np.ndarray, "horizon n_q"] | None
    along: Sequence[RecordForces]
    residuals: Sequence[ResidualReport]
    downweighted: Sequence[Stretch]

    @property
    def by_split(self) -> dict[str, list[Score]]:
        """The scores by split."""
        return _group_by_split(self.records, self.scores)

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values, for JSON."""
        channels, experiments = self.channels, []
        for e, score in zip(self.records, self.scores, strict=True):
            values = {key: getattr(score, key) for key in _SCORE_KEYS}
            by_unit = score.rmse_by_unit(channels)
            experiments.append({**values, "rmse_by_unit": by_unit, "split": e.split})
        content: dict[str, Any] = {
            "coordinates": [c.name for c in channels.coordinates],
            "experiments": experiments,
            "mean": mean_rmse(self.scores),
            "means": {name: mean_rmse(group) for name, group in self.by_split.items()},
            "mean_by_unit": mean_rmse_by_unit(self.scores, channels),
            "reference": self.reference.as_plain(),
            "horizons": [
                {"horizon": h.horizon, "mean_by_unit": h.rmse, "reference": h.reference.as_plain()}
                for h in self.horizons
            ],
            "seconds_followed": seconds_followed(self.records, self.whole),
            "means_by_unit": {
                name: mean_rmse_by_unit(group, channels) for name, group in self.by_split.items()
            },
        }
        if self.band_options is not None:
            content["band"] = {
                "level": self.band_options.level,
                "of": self.band_options.scope,
                "covered": [asdict(share) for share in self.coverage],
            }
        if self.ahead is not None:
            by_unit = rmse_ahead_by_unit(self.ahead, channels).T.tolist()
            content["ahead"] = {
                "dt": channels.dt,
                "rmse": joint_rmse(self.ahead).tolist(),
                "rmse_by_unit": dict(zip(channels.units, by_unit, strict=True)),
            }
        if self.along:
            content["forces"] = [asdict(error) for error in force_errors(self.along)]
        if self.residuals:
            content["residuals"] = {
                "coordinates": [r.as_plain() for r in self.residuals],
                "downweighted": [asdict(stretch) for stretch in self.downweighted],
            }
        return content

    def parts(self) -> Iterator[Table | str]:
        """Tables and sentences, in the order in which they are read."""
        label = self.reference.label
        trivial = _group_by_split(self.records, self.reference.scores)
        yield from _score_tables(self.by_split, self.channels, self.start, label, trivial)
        yield _horizon_table(self.horizons, self.channels)
        yield describe_followed(self.records, self.whole).text
        rmse = rmse_by_record(self.scores)
        if self.reference.median_share(rmse, self.records) >= 1:
            yield f"the model follows these records no better than {label}"
        if self.band_options is not None:
            yield _band_table(self.coverage, self.band_options, self.channels)
        if self.ahead is not None:
            yield _ahead_table(self.ahead, self.channels)
        if self.along:
            yield _forces_table(self.along)
        if self.residuals:
            yield residual_table(self.residuals, self.channels)
            if self.downweighted:
                yield downweighted_table(self.downweighted)
            yield from (f"{r.coordinate}: {r.sentence}" for r in self.residuals)


def _group_by_split(
    records: Sequence[Experiment], scores: Sequence[Score]
) -> dict[str, list[Score]]:
    """Scores by the split of their records; "all" where there is none."""
    groups: dict[str, list[Score]] = {}
    for e, score in zip(records, scores, strict=True):
        groups.setdefault(e.split or "all", []).append(score)
    return groups


def _score_tables(
    by_split: Mapping[str, Sequence[Score]],
    channels: Channels,
    start: str,
    label: str,
    reference: Mapping[str, Sequence[Score]],
) -> list[Table]:
    """Tables of the scores of every record and of the means of the splits.

    Where there are many coordinates, their scores are a table of their own, of the means alone.

    Args:
        by_split: scores of the model.
        channels: coordinates of the records.
        start: where the free runs start.
        label: what the reference does.
        reference: its scores.
    """
    # any model simulates the samples well that its start was fitted to
    start_samples = start_named(start).seen_samples
    # the scores of three coordinates have room beside one another
    is_wide = channels.n_q > 3
    columns = ["record", "split", *[f"RMSE [{unit}]" for unit in channels.units]]
    if start_samples:
        has_units = len(channels.units) > 1
        columns += [
            f"from sample {start_samples}" + (f" [{unit}]" if has_units else "")
            for unit in channels.units
        ]
    for c in channels.coordinates:
        columns += (
            [f"{c.name}, fit [%]"] if is_wide else [f"{c.name} [{c.unit}]", "NRMSE", "fit [%]"]
        )

    def errors_of(s: Score) -> list[float]:
        after = s.rmse_after_by_unit(channels).values() if start_samples else ()
        return [*s.rmse_by_unit(channels).values(), *after]

    rows = []
    for split, scores in by_split.items():
        for s in scores:
            row = [s.experiment, split, *map(number, errors_of(s))]
            for error, relative, percent in zip(
                s.coordinate_rmse, s.nrmse, s.fit_percent, strict=True
            ):
                row += [] if is_wide else [number(error), number(relative)]
                row.append(number(percent, 1))
            rows.append(row)
    # scores of training records are optimistic, so each split has a mean of its own
    for name, groups in (("mean", by_split), (f"({label})", reference)):
        for split, scores in groups.items():
            means = [fmean(column) for column in zip(*map(errors_of, scores), strict=True)]
            row = [name, split, *map(number, means)]
            rows.append([*row, *[""] * (len(columns) - len(row))])
    horizon = horizon_words(next(iter(by_split.values()))[0].horizon)
    tables = [Table(columns, rows, title=f"Free runs, start '{start}'{horizon}")]
    if is_wide:
        rows = [
            [
                c.name,
                split,
                number(fmean(s.coordinate_rmse[j] for s in scores)),
                c.unit,
                number(fmean(s.nrmse[j] for s in scores)),
                number(fmean(s.fit_percent[j] for s in scores), 1),
            ]
            for split, scores in by_split.items()
            for j, c in enumerate(channels.coordinates)
        ]
        columns = ["coordinate", "split", "RMSE", "unit", "NRMSE", "fit [%]"]
        tables.append(Table(columns, rows, title="Means over the records"))
    return tables


def _horizon_table(errors: Sequence[HorizonError], channels: Channels) -> Table:
    """Table of mean errors over longer and longer free runs, beside the reference."""
    rows = []
    for e in errors:
        trivial = e.reference.mean_by_unit
        row = ["whole" if e.horizon is None else f"{e.horizon:g} s"]
        for unit in channels.units:
            share = 100 * e.rmse[unit] / trivial[unit] if trivial[unit] else float("nan")
            row += [number(e.rmse[unit]), number(trivial[unit]), number(share, 1)]
        rows.append([*row, e.reference.label])
    columns = ["free runs of"]
    for unit in channels.units:
        columns += [f"RMSE [{unit}]", f"reference [{unit}]", "share [%]"]
    title = "Means over the records, beside what a trivial predictor is off by"
    return Table([*columns, "reference"], rows, title=title)


def _band_table(
    coverage: Sequence[Coverage], band_options: BandOptions, channels: Channels
) -> Table:
    """Table of the share of the motion inside the bands, and of their width."""
    units = {c.name: c.unit for c in channels.coordinates}
    rows = []
    for row in coverage:
        low, high = (f"{100 * end:.0f}" for end in row.interval)
        rows.append(
            [
                row.coordinate,
                row.part,
                f"{100 * row.inside:.1f}",
                f"{low} to {high}",
                f"{row.whole} of {row.records}",
                f"{number(row.width)} {units[row.coordinate]}",
                number(row.width / row.rmse, 1) if row.rmse else "",
                number(row.crps),
            ]
        )
    columns = [
        "coordinate",
        "part",
        "inside [%]",
        "95 % interval",
        "records all inside",
        "width",
        "width / RMSE",
        "CRPS",
    ]
    share = "of the time" if band_options.scope == "time" else "of whole records"
    return Table(columns, rows, title=f"Bands of {100 * band_options.level:g} % {share}")


def _ahead_table(errors: Float[np.ndarray, "horizon n_q"], channels: Channels) -> Table:
    """Table of errors of predictions some steps ahead."""
    shown = [*(k for k in (1, 2, 5, 10, 20, 50, 100, 200, 500) if k < len(errors)), len(errors)]
    by_unit = rmse_ahead_by_unit(errors, channels)
    rows = [
        [str(k), f"{k * channels.dt:g}", *[number(x, 4) for x in by_unit[k - 1]]] for k in shown
    ]
    columns = ["k", "horizon [s]", *[f"RMSE [{unit}]" for unit in channels.units]]
    title = "k steps ahead, from the position and velocity of the record at every sample"
    return Table(columns, rows, title=title)


def _forces_table(along: Sequence[RecordForces]) -> Table:
    """Table of the forces that are missing along the records of each split."""
    by_split: dict[str, list[ForceError]] = {}
    for error in force_errors(along):
        by_split.setdefault(error.split or "all", []).append(error)
    return force_errors_table(by_split)
