"""Records that are simulated side by side: those that share a model."""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import equinox as eqx

from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import AnyModel

Result = TypeVar("Result")


def batches(model: AnyModel, experiments: Sequence[Experiment]) -> list[tuple[AnyModel, list[int]]]:
    """The models that records need, see `Model.for_record`, each with the indices of its records.

    Raises:
        InputError: a record of a group that the model does not know.
    """
    shared: list[tuple[AnyModel, list[int]]] = []
    for i, e in enumerate(experiments):
        model_of_record = model.for_record(e)
        for other, rows in shared:
            if model_of_record is other or eqx.tree_equal(model_of_record, other):
                rows.append(i)
                break
        else:
            shared.append((model_of_record, [i]))
    return shared


def map_in_batches(
    model: AnyModel,
    experiments: Sequence[Experiment],
    function: Callable[[AnyModel, Sequence[Experiment]], Iterable[Result]],
) -> list[Result]:
    """Results of a function for every record; it is called once for all that share a model.

    Args:
        model: the model.
        experiments: the records.
        function: from a model and the records of one batch to a result for each of them.
    """
    results: dict[int, Result] = {}
    for shared, rows in batches(model, experiments):
        results.update(zip(rows, function(shared, [experiments[i] for i in rows]), strict=True))
    return [results[i] for i in range(len(experiments))]
