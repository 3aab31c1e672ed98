"""Roles of records: which train, which choose and rank; one rule for everything that fits."""

from collections.abc import Iterable
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

    def with_long_validation(self, fewest: int) -> "Roles":
        """The roles without validation records of fewer samples, unless all are that short.

        A free run cannot start in them; the rest still chooses.
        """
        kept = tuple(e for e in self.validation if len(e) >= fewest)
        return replace(self, validation=kept) if kept else self


def records_without_test(data: DataSet) -> list[Experiment]:
    """The records that may take part in a fit: all but those of the split `test`."""
    return [e for e in data if e.split != "test"]


def describe_left_out(records: Iterable[Experiment], fewest: int) -> list[str]:
    """Sentences on validation records that are left out for having fewer samples."""
    return [
        f"left out of validation: {e.name}: {counted(len(e), 'sample')}; expected at least {fewest}"
        for e in records
    ]


def assign_roles(data: DataSet) -> Roles:
    """The split `train` trains, `validation` chooses; `test` records take part in nothing.

    A data set without splits is trained on as a whole.

    Raises:
        InputError: no `DataSet`, or splits without one for training.
    """
    if not isinstance(data, DataSet):
        raise InputError(
            "data",
            f"a {type(data).__name__}",
            "a DataSet",
            "use tn.load(folder) or tn.DataSet(name, experiments)",
        )
    train = data.split(TRAIN) if data.splits else data
    validation = data.split(VALIDATION) if VALIDATION in data.splits else ()
    return Roles(tuple(train), tuple(validation))
