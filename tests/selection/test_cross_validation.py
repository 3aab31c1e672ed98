"""Cross-validation by jobs comes to what it comes to in one piece."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import pytest
from small_selection import GREY, HYBRID, NETWORK, swings
from swinging import SWING

import tustinnet as tn
from tustinnet.data.declaration import parse_toml
from tustinnet.fitting.listener import Listener
from tustinnet.selection.cross_validation import (
    CrossValidationOptions,
    cross_validate,
    make_cross_validation_options,
    prepare_for_validation,
    remove_results,
)
from tustinnet.selection.jobs import JobResult
from tustinnet.store.header import read_header


class Counting(ThreadPoolExecutor):
    """Threads; counts the jobs that were not done before."""

    def __init__(self) -> None:
        super().__init__(2)
        self.fitted: set[tuple[str, int]] = set()

    def submit(self, fn, /, *args, **named) -> Future:  # pyright: ignore[reportIncompatibleMethodOverride]
        def call() -> JobResult:
            result = fn(*args, **named)
            if not result.earlier:
                self.fitted.add((result.candidate, result.fold))
            return result

        return super().submit(call)


def options_for(kind: str) -> CrossValidationOptions:
    brief = ["stages.*.epochs=5"]
    if kind == "network":
        network = tn.read_recipe(parse_toml(NETWORK), brief)
        return make_cross_validation_options(
            network, folds=3, seeds=(2, 5), starts=("derived-6", "model-10")
        )
    hybrid = tn.read_recipe(parse_toml(HYBRID), brief)
    grey = tn.read_recipe(parse_toml(GREY))
    return make_cross_validation_options(hybrid, system=SWING, physics=grey, folds=3)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["network", pytest.param("hybrid", marks=pytest.mark.thorough)])
def test_scores_are_those_of_one_piece_and_jobs_that_are_done_are_kept(kind, tmp_path):
    options, made = options_for(kind), [Counting() for _ in range(3)]
    whole = cross_validate(swings(), options)
    system = SWING if kind == "hybrid" else None
    found = [
        cross_validate(swings(), options, folder=tmp_path, executor=executor, system=system)
        for executor in made[:2]
    ]
    for of in found:
        assert of.outcomes == whole.outcomes
        assert (of.recipe, of.unit) == (whole.recipe, whole.unit)
        assert sorted(of.scores, key=str) == sorted(whole.scores, key=str)
    folds = {("recipe", fold) for fold in range(3)}
    physics = {("physics", fold) for fold in range(3)} if kind == "hybrid" else set()
    assert [of.fitted for of in made[:2]] == [physics | folds, set()]
    (tmp_path / "folds.json").touch()
    remove_results(tmp_path, ["folds.json", "folds.md"], jobs=True)
    assert not (tmp_path / "folds.json").exists()
    cross_validate(swings(), options, folder=tmp_path, executor=made[2], system=system)
    assert made[2].fitted == physics | folds


def test_holds_and_delays_that_were_determined_are_said():
    messages: list[str] = []
    listener = Listener(on_message=messages.append)
    channels = swings().channels
    unknown = (replace(channels.inputs[0], hold="unknown"),)
    channels = replace(channels, inputs=unknown)
    late = tn.DataSet("late", tuple(replace(e, channels=channels) for e in swings()))
    data = prepare_for_validation(late, options_for("network"), listener)
    assert data.channels.inputs[0].hold == "zero-order"
    assert any("'voltage' acts" in sentence for sentence in messages)


def test_a_job_that_fails_is_told_with_its_fold(tmp_path):
    short = tn.DataSet("short", tuple(e[:18] for e in swings()))
    with pytest.raises(tn.InputError, match=r"fold 0: .*18 samples; expected more than a window"):
        cross_validate(
            short, options_for("network"), folder=tmp_path, executor=ThreadPoolExecutor(1)
        )


def test_a_horizon_that_no_record_has_is_refused_before_anything_is_fitted(tmp_path):
    options = options_for("network")
    far = options.recipe.model_copy(update={"horizon": 100.0})
    with pytest.raises(tn.InputError, match="horizon"):
        cross_validate(
            swings(), replace(options, recipe=far), folder=tmp_path, executor=ThreadPoolExecutor(1)
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.thorough
def test_the_header_of_a_fold_s_model_has_the_horizon_of_its_scores(tmp_path):
    recipe = tn.read_recipe(parse_toml(GREY), ["search.horizon=1.0"])
    options = make_cross_validation_options(recipe, system=SWING, folds=3)
    cross_validate(swings(), options, folder=tmp_path, executor=ThreadPoolExecutor(1))
    paths = sorted(tmp_path.glob("candidates/**/model.safetensors"))
    assert len(paths) == 3
    for path in paths:
        scores = read_header(path)["scores"]
        assert scores["horizon"] == 1.0
        records = [e for e in swings() if e.name in scores["rmse"]]
        model = tn.load_model(path, SWING)
        again = tn.evaluate(model, records, scores["start"], horizon=scores["horizon"])
        assert {s.experiment: s.rmse for s in again} == pytest.approx(scores["rmse"], rel=1e-6)
