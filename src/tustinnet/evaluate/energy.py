"""Mechanical energy along records and their free runs."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from tustinnet.data.experiment import Experiment
from tustinnet.engine.engines import evaluate
from tustinnet.engine.equations import Formula
from tustinnet.families.family import family_of
from tustinnet.models.contract import Model
from tustinnet.simulate.batches import map_in_batches


def energy_along(
    model: Model,
    experiments: Sequence[Experiment],
    runs: Sequence[Float[np.ndarray, "_ n_x"]],
) -> list[Float[np.ndarray, " _"]] | None:
    """Kinetic and potential energy `T + V` at states of records, by a model's equations of motion.

    Args:
        model: the model.
        experiments: the records.
        runs: of each record states [q, v, ...], measured or simulated, (n, n_x).

    Returns:
        Of each record the energy at its states, (n,) [J]; None of a model without equations of
        motion.
    """
    if family_of(model).equations(model) is None:
        return None
    states = {e.name: x[:, e.channels.measured] for e, x in zip(experiments, runs, strict=True)}

    def evaluate_batch(folded: Model, batch: Sequence[Experiment]) -> list[np.ndarray]:
        equations = family_of(folded).equations(folded)
        assert equations is not None
        rows = [states[e.name] for e in batch]
        formula = Formula(lambda x: equations.energy(x)[None], rows[0].shape[1])
        energy = evaluate(formula, np.concatenate(rows))[:, 0]
        return np.split(energy, np.cumsum([len(x) for x in rows])[:-1])

    return map_in_batches(model, experiments, evaluate_batch)
