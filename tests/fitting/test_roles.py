"""Which records train, which choose, which take part in nothing."""

from dataclasses import replace

import pytest

import tustinnet as tn
from tustinnet.fitting.roles import Roles, assign_roles


def split_as(pendulum: tn.DataSet, *splits: str | None) -> tn.DataSet:
    """The first records of the small system in other splits."""
    records = tuple(replace(e, split=s) for e, s in zip(pendulum, splits, strict=False))
    return tn.DataSet("split", records)


def names(records: tuple[tn.Experiment, ...]) -> list[str]:
    return [e.name for e in records]


def test_train_records_train_and_validation_records_choose_and_judge(pendulum):
    found = assign_roles(pendulum)
    assert names(found.train) == ["fall1", "fall2", "noise1"]
    assert names(found.validation) == ["fall3", "noise2"]
    assert found.ranking == found.validation
    assert found.ranking_split == "validation"
    assert found.all == (*found.train, *found.validation)


def test_test_records_and_those_of_other_splits_take_part_in_nothing(pendulum):
    found = assign_roles(split_as(pendulum, "train", "test", "validation", "spare", None))
    assert names(found.all) == ["fall1", "noise1"]


def test_without_validation_records_the_training_records_judge(pendulum):
    found = assign_roles(split_as(pendulum, "train", "train", "test"))
    assert found.validation == ()
    assert found.ranking == found.train
    assert found.ranking_split == "train"
    assert names(found.train) == ["fall1", "fall2"]


def test_a_data_set_without_splits_is_trained_on_as_a_whole(pendulum):
    found = assign_roles(split_as(pendulum, None, None, None))
    assert names(found.train) == ["fall1", "fall2", "noise1"]
    assert found == Roles(found.train, ())


def test_splits_without_one_for_training_are_refused(pendulum):
    with pytest.raises(tn.InputError, match="train"):
        assign_roles(split_as(pendulum, "validation", "test"))


@pytest.mark.usefixtures("unchecked")
def test_something_else_than_a_data_set_is_refused_with_the_remedy(pendulum):
    with pytest.raises(tn.InputError, match=r"a list; expected a DataSet; use tn\.load"):
        assign_roles(list(pendulum))  # type: ignore[arg-type] # what people try
