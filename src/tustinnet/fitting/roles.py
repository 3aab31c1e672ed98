"""Roles of records: which train, which choose and rank; one rule for everything that fits."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.wording import counted

TRAIN, VALIDATION = "train", "validation"


@dataclass(frozen=True)
class Roles:
    """The records of a data set by what they are for.

    Attributes:
        train: the model is fitted to them.
        validation: their free runs choose between epochs, initial states and seeds; may be none.
    """

    train: tuple[Experiment, ...]
    validation: tuple[Experiment, ...]

    @property
    def ranking(self) -> tuple[Experiment, ...]:
        """The records whose free runs rank the fits: validation, or training without."""
        return self.validation or self.train

    @property
    def ranking_split(self) -> str:
        """The name of the split of the ranking records."""
        return VALIDATION if self.validation else TRAIN

    @property
    def all(self) -> tuple[Experiment, ...]:
        """All records, training records first."""
        return (*self.train, *self.validation)

    def with_long_validation(
        self, fewest: int, on_message: Callable[[str], None] = lambda sentence: None
    ) -> "Roles":
        """The roles without validation records of fewer samples, unless all are that short.

        A free run cannot start in them; the rest still chooses.

        Args:
            fewest: samples that a free run needs.
            on_message: called with a sentence on each record that is left out.
        """
        kept = tuple(e for e in self.validation if len(e) >= fewest)
        if not kept:
            return self
        for e in self.validation:
            if len(e) < fewest:
                on_message(
                    f"left out of validation: {e.name}: {counted(len(e), 'sample')}; "
                    f"expected at least {fewest}"
                )
        return replace(self, validation=kept)


def records_without_test(data: DataSet) -> list[Experiment]:
    """The records that may take part in a fit: all but those of the split `test`."""
    return [e for e in data if e.split != "test"]


def require_data_set(data: object) -> None:
    """Raises unless records are a `DataSet`."""
    if not isinstance(data, DataSet):
        raise InputError(
            "data",
            type(data).__name__,
            "a DataSet",
            "use tn.load(folder) or tn.DataSet(name, experiments)",
        )


def assign_roles(data: DataSet) -> Roles:
    """The split `train` trains, `validation` chooses; `test` records take part in nothing.

    A data set without splits is trained on as a whole.

    Raises:
        InputError: no `DataSet`, or splits without one for training.
    """
    require_data_set(data)
    train = data.split(TRAIN) if data.splits else data
    validation = data.split(VALIDATION) if VALIDATION in data.splits else ()
    return Roles(tuple(train), tuple(validation))
