"""Bands of the chosen model, calibrated on the records that each fold left out."""

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.evaluate.bands import Calibration, Prediction, calibrate_bands, predict
from tustinnet.families.family import family_of
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.selection.final_models import FinalModel
from tustinnet.selection.jobs import RunContext
from tustinnet.selection.ranking import CandidateResult
from tustinnet.store.header import read_header

_WHERE = "the chosen model"


def calibrate_on_folds(
    result: CandidateResult,
    final: FinalModel,
    context: RunContext,
    deadline: Deadline = NEVER,
) -> Calibration:
    """Calibrates the bands of a candidate.

    The model of each fold simulates the records that it has not seen. The chosen model has seen
    all records: its own errors are rather smaller.

    Args:
        result: the fits of the candidate.
        final: the model that it was made into.
        context: where the models are, and how they were scored.
        deadline: after it there are no bands.

    Raises:
        InputError: the model of a fold, or the chosen one, does not say how sure it is, free runs
            diverge, or time is up.
    """
    unsure = InputError(_WHERE, "does not say how sure it is")
    if not family_of(final.model).alternatives(final.model, dict(final.header)):
        raise unsure
    start, horizon = result.start, context.scoring.horizon
    predictions, records = list[Prediction](), list[Experiment]()
    for fold, (fit, *_) in sorted(result.fits_by_fold.items()):
        model = context.load_model(fit.model)
        alternatives = family_of(model).alternatives(model, read_header(context.folder / fit.model))
        if not alternatives:
            raise unsure
        if deadline.remaining <= 0:
            raise InputError(_WHERE, "no time was left")
        scored = context.splits[fold].scored
        predictions += predict(model, alternatives, scored, start, horizon=horizon)
        records += scored
    return calibrate_bands(predictions, records, start, horizon)
