"""What a report finds out: free runs, residuals, steps ahead, bands and energies of its models."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.ahead import rmse_ahead
from tustinnet.evaluate.bands import KEY as BANDS
from tustinnet.evaluate.bands import Band, BandOptions, Calibration, find_alternatives, make_bands
from tustinnet.evaluate.energy import energy_along
from tustinnet.evaluate.residuals import ResidualReport, residual_reports
from tustinnet.evaluate.scores import Score, evaluate
from tustinnet.report.page.subject import Subject
from tustinnet.simulate.range import Left, Range
from tustinnet.simulate.starts import start_named

_STEPS = 100  # ahead
_BEGUN = 1500  # predictions at most: more make no other curve, and take seconds
_LAGS = 50
_LEVEL = 0.9  # of bands, where there are enough calibration records

Energies = Sequence[Float[np.ndarray, " _"]]


@dataclass(frozen=True)
class Judged:
    """A model and what was found of it; of each record in their order.

    Attributes:
        subject: the model.
        scores: free runs.
        range: where its training records lie, None where nobody knows.
        left: where free runs leave that.
        ahead: RMSE by steps ahead, empty where no record is long enough [rad or m].
        every: of how many samples one was predicted from.
        residuals: by coordinate, none where a free run diverges.
        bands: around the free runs, none of a model without.
        energies: at measured and at simulated states [J], None of a model without equations.
        notes: what was left out, and why.
    """

    subject: Subject
    scores: Sequence[Score]
    range: Range | None
    left: Sequence[Left | None]
    ahead: Float[np.ndarray, " horizon"]
    every: int
    residuals: Sequence[ResidualReport]
    bands: Sequence[Band]
    energies: tuple[Energies, Energies] | None
    notes: tuple[str, ...]


def judged(
    subject: Subject, records: Sequence[Experiment], start: str, horizon: float | None
) -> Judged:
    """Judges a model by records; the free runs are computed once, or known already.

    Args:
        subject: the model.
        records: the records.
        start: where the free runs start.
        horizon: how long they last at most [s], None for whole records.

    Raises:
        InputError: see `evaluate`.
    """
    model, notes = subject.model, []
    scores = subject.scores or evaluate(model, records, start, horizon=horizon)
    runs = [score.simulated for score in scores]
    known = Range.from_header(dict(subject.header), model) if subject.header else None
    left = [
        None if known is None else known.left(model.channels, x, e.u)
        for e, x in zip(records, runs, strict=True)
    ]
    residuals: list[ResidualReport] = []
    try:
        lags = min(_LAGS, min(map(len, records)) - start_named(start).first - 1)
        residuals = residual_reports(model, records, start, lags, horizon=horizon, runs=runs)
    except InputError as error:
        notes.append(f"no residuals: {error}")
    bands: list[Band] = []
    try:
        bands = _bands(subject, records, scores)
    except InputError as error:
        notes.append(f"no bands: {error}")
    steps = min(_STEPS, max(map(len, records)) - model.warm_up - 1)
    every = -(-sum(map(len, records)) // _BEGUN)
    ahead = rmse_ahead(model, records, steps, every=every) if steps > 0 else np.zeros(0)
    return Judged(
        subject, scores, known, left, ahead, every, residuals, bands,
        _energies(subject, records, runs), tuple(notes),
    )  # fmt: skip


def _bands(subject: Subject, records: Sequence[Experiment], scores: Sequence[Score]) -> list[Band]:
    """Bands of a model that was calibrated, at the usual level or the highest it can promise."""
    if BANDS not in subject.header:
        return []
    calibration = Calibration.from_header(subject.header, subject.label)
    asked = BandOptions(min(_LEVEL, calibration.highest_level))
    others = find_alternatives(subject.model, subject.header, subject.label)
    return make_bands(calibration, asked, subject.model, others, records, scores)


def _energies(
    subject: Subject, records: Sequence[Experiment], runs: Sequence[np.ndarray]
) -> tuple[Energies, Energies] | None:
    measured = energy_along(subject.model, records, [e.measured_states() for e in records])
    simulated = energy_along(subject.model, records, runs)
    return None if measured is None or simulated is None else (measured, simulated)
