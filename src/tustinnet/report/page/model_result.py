"""Results of a model on the records of a report: free runs, residuals, bands and others."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.ahead import coordinate_rmse_ahead, rmse_ahead_by_unit
from tustinnet.evaluate.bands import KEY as BANDS
from tustinnet.evaluate.bands import Band, BandOptions, Calibration, find_alternatives, make_bands
from tustinnet.evaluate.energy import energy_along
from tustinnet.evaluate.residuals import ResidualReport, residual_reports
from tustinnet.evaluate.scores import Score, score_runs
from tustinnet.families.family import family_of
from tustinnet.report.page.reported_model import ReportedModel
from tustinnet.simulate.range import ExtrapolationPoint, Range

Energies = Sequence[Float[np.ndarray, " _"]]


@dataclass(frozen=True)
class ModelResult:
    """A model with its results on the records of a report, in the order of the records.

    Attributes:
        reported: the model.
        scores: scores of the free runs.
        whole: scores of those of whole records, without a restart.
        range: range of its training data, None where that is unknown.
        extrapolations: where each free run leaves that range, None where it stays inside.
        ahead: RMSE by steps ahead over the coordinates of each unit, empty where no record is long
            enough.
        every: predictions ahead begin at one sample in so many.
        residuals: residuals by coordinate, empty where a free run diverges.
        bands: bands around the free runs, empty of a model without.
        energies: energies at measured and at simulated states, from the lowest measured one on;
            None of a model without equations of motion.
        energy_unit: their unit, empty of a model without.
        notes: results that are missing, and the reasons.
    """

    reported: ReportedModel
    scores: Sequence[Score]
    whole: Sequence[Score]
    range: Range | None
    extrapolations: Sequence[ExtrapolationPoint | None]
    ahead: Float[np.ndarray, "horizon n_units"]
    every: int
    residuals: Sequence[ResidualReport]
    bands: Sequence[Band]
    energies: tuple[Energies, Energies] | None
    energy_unit: str
    notes: tuple[str, ...]


def compute_model_result(
    reported: ReportedModel, records: Sequence[Experiment], start: str, horizon: float | None
) -> ModelResult:
    """Computes the results of a model; free runs that are scored already are used as they are.

    Args:
        reported: the model.
        records: the records.
        start: where the free runs start.
        horizon: longest duration of a free run [s], None for whole records.

    Raises:
        InputError: see `evaluate`.
    """
    model, header, notes = reported.model, reported.header, []
    scores = reported.scores or score_runs(model, records, start, horizon=horizon)
    whole = scores if horizon is None else score_runs(model, records, start, horizon=None)
    runs = [score.simulated for score in scores]
    training_range = Range.from_header(dict(header), model) if header else None
    extrapolations = [
        None
        if training_range is None
        else training_range.extrapolation_point(model.channels, x, e.u)
        for e, x in zip(records, runs, strict=True)
    ]
    residuals: list[ResidualReport] = []
    try:
        residuals = residual_reports(model, records, start, horizon=horizon, runs=runs)
    except InputError as error:
        notes.append(f"no residuals: {error}")
    bands: list[Band] = []
    try:
        if BANDS in header:
            calibration = Calibration.from_header(header, reported.label)
            # bands of 90 %, where there are enough calibration records
            options = BandOptions(min(0.9, calibration.highest_level))
            others = find_alternatives(model, header, reported.label)
            bands = make_bands(calibration, options, model, others, records, scores)
    except InputError as error:
        notes.append(f"no bands: {error}")
    # predictions up to 100 steps ahead
    steps = min(100, max(map(len, records)) - model.warm_up - 1)
    # more predictions give the same curve, and take seconds
    every = -(-sum(map(len, records)) // 1500)
    ahead = np.zeros((0, len(model.channels.units)))
    if steps > 0:
        errors = coordinate_rmse_ahead(model, records, steps, every=every)
        ahead = rmse_ahead_by_unit(errors, model.channels)
    measured = energy_along(model, records, [e.measured_states() for e in records])
    simulated = energy_along(model, records, runs)
    equations, energies = family_of(model).equations(model), None
    if measured is not None and simulated is not None:
        lowest = min(float(energy.min()) for energy in measured)  # where 0 is, is a choice
        energies = [e - lowest for e in measured], [e - lowest for e in simulated]
    return ModelResult(
        reported,
        scores,
        whole,
        training_range,
        extrapolations,
        ahead,
        every,
        residuals,
        bands,
        energies,
        "" if equations is None else equations.system.energy_unit,
        tuple(notes),
    )
