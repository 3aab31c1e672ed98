"""Bands of the chosen model, calibrated on the records that each fold left out."""

from tustinnet.errors import InputError
from tustinnet.evaluate.bands import Calibration, Prediction, calibrate_bands, predict
from tustinnet.families.family import family_of
from tustinnet.fits.deadline import NEVER, Deadline
from tustinnet.selection.committees import combine, member_weights
from tustinnet.selection.final_models import FinalModel, SelectionResults
from tustinnet.selection.jobs import RunContext
from tustinnet.store.header import read_header


def calibrate_on_folds(
    candidates: SelectionResults,
    name: str,
    final: FinalModel,
    context: RunContext,
    deadline: Deadline = NEVER,
) -> Calibration | None:
    """Calibrates the bands of a candidate or committee; None where they cannot be.

    The models of each fold, put together as the chosen one is, simulate the records that none of
    them has seen. The chosen model has seen all records: its own errors are rather smaller.

    Args:
        candidates: the candidates and committees.
        name: the candidate or committee.
        final: the model that it was made into.
        context: where the models are, and how they were scored.
        deadline: after it there are no bands.

    Returns:
        None where the models of a fold, or the chosen one, do not say how sure they are, where
        free runs diverge, and where time was up.
    """
    if not family_of(final.model).alternatives(final.model, dict(final.header)):
        return None
    members = candidates.members(name)
    shares = [share for _, share in members]
    folds = sorted(set.intersection(*(set(r.fits_by_fold) for r, _ in members)))
    start, horizon = candidates.result(name).starts[0], context.scoring.horizon
    predictions: list[Prediction] = []
    for fold in folds:
        scores = [r.fits_by_fold[fold] for r, _ in members]
        files = [s.model for member in scores for s in member]
        models = [context.load_model(file) for file in files]
        model = combine(models, member_weights(scores, shares))
        header = read_header(context.folder / files[0]) if len(files) == 1 else {}
        alternatives = family_of(model).alternatives(model, header)
        if not alternatives or deadline.remaining <= 0:
            return None
        records = context.splits[fold].scored
        predictions += predict(model, alternatives, records, start, horizon=horizon)
    try:
        records = [e for fold in folds for e in context.splits[fold].scored]
        return calibrate_bands(predictions, records, start, horizon)
    except InputError:
        return None
