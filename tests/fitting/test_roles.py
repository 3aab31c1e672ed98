"""Which records train, which choose, which take part in nothing."""

from dataclasses import replace
from pathlib import Path

import pytest

import tustinnet as tn
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.recipe_reading import read_recipe
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


def test_test_records_and_those_of_no_split_take_part_in_nothing(pendulum):
    found = assign_roles(split_as(pendulum, "train", "test", "validation", None, None))
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
    with pytest.raises(tn.InputError, match=r"data: list; expected a DataSet; use tn\.load"):
        assign_roles(list(pendulum))  # type: ignore[arg-type] # what people try


def test_validation_records_too_short_to_start_in_are_left_out_unless_all_are(pendulum):
    roles = assign_roles(pendulum)
    short = replace(roles, validation=(roles.validation[0], pendulum["noise2"][:12]))
    assert names(short.with_long_validation(20).validation) == ["fall3"]
    assert names(short.with_long_validation(20).train) == names(roles.train)
    assert short.with_long_validation(12) == short
    only = replace(roles, validation=(pendulum["noise2"][:12],))
    assert only.with_long_validation(20) is only


def with_short_validation(pendulum: tn.DataSet) -> tn.DataSet:
    short = replace(pendulum["noise2"][:12], name="short")
    return tn.DataSet("toy", (*pendulum, short))


@pytest.mark.thorough
def test_a_training_leaves_short_validation_records_out(pendulum, tiny_recipe, tmp_path):
    data, messages = with_short_validation(pendulum), []
    recipe = read_recipe(tiny_recipe, ["start=model-20", "stages.*.epochs=1"])
    run = run_fit(
        prepare(FitRequest(data, recipe)),
        tmp_path / "run",
        listener=Listener(on_message=messages.append),
    )
    assert messages == ["left out of validation: short: 12 samples; expected at least 20"]
    assert [score.experiment for score in run.best.scores] == ["fall3", "noise2"]
    without = tn.fit(pendulum, recipe)
    assert run.best.result.validation_rmse == without.validation_rmse
    only = tn.DataSet("toy", (*pendulum.split("train"), data["short"]))
    with pytest.raises(tn.InputError, match="short: 12 samples; expected at least 20"):
        tn.fit(only, recipe)


@pytest.mark.thorough
def test_an_identification_leaves_short_validation_records_out(pendulum):
    messages: list[str] = []
    system = Path(__file__).parents[1] / "torture" / "pendulum.py"
    found = tn.fit(
        with_short_validation(pendulum),
        "grey",
        system=system,
        listener=Listener(on_message=messages.append),
    )
    assert messages == ["left out of validation: short: 12 samples; expected at least 20"]
    assert found.validation_rmse == tn.fit(pendulum, "grey", system=system).validation_rmse
