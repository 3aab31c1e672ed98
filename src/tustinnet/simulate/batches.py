"""Records that are simulated side by side: those that share a model."""

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import equinox as eqx

from tustinnet.data.experiment import Experiment
from tustinnet.models.contract import AnyModel

Answer = TypeVar("Answer")


def batches(model: AnyModel, experiments: Sequence[Experiment]) -> list[tuple[AnyModel, list[int]]]:
    """The models that records need, see their `of`, each with the indices of its records.

    Raises:
        InputError: a record of a group that the model does not know.
    """
    found: list[tuple[AnyModel, list[int]]] = []
    for i, e in enumerate(experiments):
        own = model.for_record(e)
        for shared, rows in found:
            if own is shared or eqx.tree_equal(own, shared):
                rows.append(i)
                break
        else:
            found.append((own, [i]))
    return found


def in_batches(
    model: AnyModel,
    experiments: Sequence[Experiment],
    run: Callable[[AnyModel, Sequence[Experiment]], Iterable[Answer]],
) -> list[Answer]:
    """What `run` answers of every record, asked batch by batch with the model of each."""
    answers: dict[int, Answer] = {}
    for own, rows in batches(model, experiments):
        found = run(own, [experiments[i] for i in rows])
        answers.update(zip(rows, found, strict=True))
    return [answers[i] for i in range(len(experiments))]
