"""Folds, and cross-validation in this process: every record scored by models without it."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from swinging import DT, SWING, TRUTH, records, swing_model

import tustinnet as tn
from tustinnet.fitting.gradient.plan import TrainingPlan, groups_alike, make_plan
from tustinnet.fitting.gradient.train import train_plan
from tustinnet.fitting.gradient.windows import RecordPool
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.report import FitResult
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Member, Task
from tustinnet.models.integrate import Discretised
from tustinnet.selection.cross_validation import (
    CrossValidationOptions,
    CrossValidationResult,
    FoldScore,
    cross_validate,
    make_cross_validation_options,
)
from tustinnet.selection.folds import FoldSplit, are_cut, prepare_for_folds, split_into_folds
from tustinnet.store.files import to_json

TINY: dict[str, Any] = {
    "name": "tiny",
    "model": {"hidden": [5]},
    "stages": [
        {
            "name": "only",
            "windows": {"draw": "strided", "length": 10, "step": 8},
            "rate": 3e-3,
            "epochs": 2,
            "batch": 16,
        }
    ],
}
HYBRID = {**TINY, "model": {"kind": "hybrid", "correction": {"hidden": [4]}, "substeps": 1}}


def names(experiments) -> list[str]:
    return [e.name for e in experiments]


def short(split: str | None = None, kinds: str = "aaaabbbc") -> tn.DataSet:
    """Records of some kinds."""
    made = [
        tn.from_arrays(
            np.sin(np.arange(20) * 0.1 + i),
            dt=DT,
            coordinates={"a": "angular"},
            name=f"{kind}{i}",
            split=split,
        )
        for i, kind in enumerate(kinds)
    ]
    return tn.DataSet("short", tuple(made))


# --- how records are split_into_folds ---


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_every_record_is_scored_once_and_has_no_other_part_in_its_fold(count):
    data = short()
    splits = split_into_folds(data, count)
    assert len(splits) == count
    assert sorted(names(e for d in splits for e in d.scored)) == sorted(names(data))
    for d in splits:
        parts = [set(names(of)) for of in (d.scored, d.roles.train, d.roles.validation)]
        assert all(parts)
        assert set.union(*parts) == set(names(data))
        assert sum(map(len, parts)) == len(data)


def test_the_fold_after_the_scored_one_chooses():
    splits = split_into_folds(short(), 4)
    assert [d.roles.validation for d in splits] == [d.scored for d in (*splits[1:], splits[0])]


def test_records_of_a_kind_are_spread_over_the_folds():
    for d in split_into_folds(short(kinds="aaaabbbb"), 4):
        assert sorted(name[0] for name in names(d.scored)) == ["a", "b"]


def test_a_few_short_records_beside_long_ones_are_left_out_and_named():
    """No model could begin on them, and every candidate would fail for their sake."""
    made = records()
    long = [replace(e, name=f"{e.name}-{i}") for i in range(3) for e in made]
    brief = replace(made[0][:12], name="brief")
    kept, findings = prepare_for_folds(tn.DataSet("some", (*long, brief)))
    assert names(kept) == names(long)
    assert [f.text for f in findings] == ["left out, of fewer than 100 samples: brief"]
    alike = [replace(e[:40], name=e.name) for e in long]  # all are short: none is left out
    assert prepare_for_folds(tn.DataSet("some", tuple(alike)))[1] == []


def test_records_of_the_split_test_stay_out():
    data = short(split="train")
    without = tn.DataSet(
        "some", tuple(replace(e, split="test") if e.name in ("a0", "b4") else e for e in data)
    )
    splits = split_into_folds(without, 3)
    seen = {e.name for d in splits for e in (*d.scored, *d.roles.all)}
    assert seen == set(names(data)) - {"a0", "b4"}


@pytest.mark.parametrize(
    ("kinds", "count", "told"),
    [
        ("aaaa", 2, "2 folds of 4 records; expected 3 to 4"),
        ("aaaa", 5, "5 folds of 4 records; expected 3 to 4"),
        ("aa", 3, "expected at least 3 records"),
    ],
)
def test_too_few_folds_or_records_are_refused(kinds, count, told):
    with pytest.raises(tn.InputError, match=told):
        split_into_folds(short(kinds=kinds), count)


# --- what is asked ---


@pytest.mark.parametrize(
    ("recipe", "given", "told"),
    [
        ("standard", {"physics": "best-grey"}, "`physics=`: not applicable to .* 'tustin-net'"),
        ("grey", {"physics": "best-grey"}, "`physics=`: not applicable to .* 'euler-lagrange'"),
        (
            "grey",
            {"seeds": (0, 1), "system": SWING},
            "`seeds=`: a fit that is no training has no seeds",
        ),
        ("standard", {"system": SWING}, "`system=`: a system, not applicable"),
        ("grey", {}, "`system=`: no system"),
        ("best-hybrid", {}, "`system=`: no system"),
        ("best-hybrid", {"physics": "standard"}, "`physics=`: a recipe of kind 'tustin-net'"),
        ("standard", {"seeds": (1, 1)}, r"`seeds=`: \[1, 1\]; expected at least one, all diff"),
        ("standard", {"seeds": ()}, r"`seeds=`: \[\]"),
        ("standard", {"starts": ("here",)}, "unknown start 'here'"),
        ("nothing", {}, "no recipe 'nothing'"),
    ],
)
def test_what_means_nothing_or_is_missing_is_refused_by_name(recipe, given, told):
    with pytest.raises(tn.InputError, match=told):
        make_cross_validation_options(recipe, **given)


def test_a_question_is_filled_with_what_is_usual():
    asked = make_cross_validation_options("best-hybrid", system=SWING)
    assert asked.physics == tn.read_recipe("best-grey")
    assert asked.system is SWING
    assert (asked.folds, asked.seeds, asked.starts) == (None, (0,), ())
    grey = make_cross_validation_options("grey", system="qube-servo2")
    assert grey.physics is None
    assert grey.system is not None
    assert grey.system.name == "qube-servo2"


def test_a_recipe_may_name_the_system():
    named = tn.read_recipe("best-grey", ["model.system=qube-servo2"])
    for asked in (
        make_cross_validation_options(named),
        make_cross_validation_options("best-hybrid", physics=named),
    ):
        assert asked.system is not None
        assert asked.system.name == "qube-servo2"


# --- what is done: trainings ---


@pytest.fixture(scope="module")
def done(pendulum) -> tuple[CrossValidationResult, list[TrainingPlan], list[FitResult]]:
    """Three folds and two seeds, and every plan that was trained, and what came of it."""
    plans: list[TrainingPlan] = []
    results: list[FitResult] = []

    def train(prepared, listener, *more):
        plans.append(prepared)
        results.extend(train_plan(prepared, listener, *more))
        return results[-len(prepared.members) :]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tustinnet.fitting.fit.train_plan", train)
        asked = make_cross_validation_options(
            TINY, folds=3, seeds=(4, 7), starts=("derived-6", "derived-8")
        )
        return cross_validate(pendulum, asked), plans, results


@pytest.mark.thorough
def test_every_record_is_scored_by_all_seeds(done, pendulum):
    found, _, _ = done
    scored = sorted((s.record, s.seed) for s in found.scores)
    assert scored == sorted((e.name, seed) for e in pendulum for seed in (4, 7))
    fold_of = {e.name: f for f, d in enumerate(split_into_folds(pendulum, 3)) for e in d.scored}
    assert all(s.fold == fold_of[s.record] for s in found.scores)
    assert all(set(s.rmse) == {"derived-6", "derived-8"} for s in found.scores)
    assert all(math.isfinite(r) for s in found.scores for r in s.rmse.values())


def test_members_of_all_folds_train_together(done):
    found, plans, results = done
    assert len(plans) == 1
    assert [(m.fold, m.seed) for m in plans[0].members] == [
        (fold, seed) for fold in (0, 1, 2) for seed in (4, 7)
    ]
    assert list(found.outcomes) == [
        f"fold {fold}, seed {seed}" for fold in (0, 1, 2) for seed in (4, 7)
    ]
    assert set(found.outcomes.values()) == {"finished"}
    assert found.seconds > sum(r.seconds for r in results)


def test_no_member_sees_the_records_that_it_is_scored_on(done, pendulum):
    _, [prepared], _ = done
    splits = split_into_folds(pendulum, 3)
    pool = RecordPool([e for d in splits for e in d.roles.all])
    length = prepared.stages[0].windows.length
    for m, member in enumerate(prepared.members):
        split = splits[member.fold]
        assert prepared.task.folds[member.fold].roles == split.roles
        rows = prepared.stages[0].windows.rows[m]
        own = {
            int(pool.window_rows(np.array([[i, k]]), split.roles.train)[0]): e.name
            for i, e in enumerate(split.roles.train)
            for k in range(len(e) - length)
        }
        assert {own[row] for row in rows.tolist()} == set(names(split.roles.train))
        assert prepared.validation_runs is not None
        counted = np.asarray(prepared.run_indices[m])[np.asarray(prepared.run_counts[m]) > 0]
        assert len(counted) == len(split.roles.validation)
        for i, e in zip(counted, split.roles.validation, strict=True):
            judged = np.asarray(prepared.validation_runs.q[i, 0, : len(e)])
            np.testing.assert_allclose(judged, e.q, rtol=1e-6)


@pytest.mark.thorough
def test_records_that_have_nothing_to_choose_train(pendulum, monkeypatch):
    plans: list[TrainingPlan] = []

    def train(prepared, listener, *more):
        plans.append(prepared)
        return train_plan(prepared, listener, *more)

    monkeypatch.setattr("tustinnet.fitting.fit.train_plan", train)
    blind = tn.read_recipe(TINY, ["stages.0.keep=last", "stages.0.decay=cosine"])
    found = cross_validate(
        pendulum, make_cross_validation_options(blind, folds=3, starts=("derived-6",))
    )
    splits = split_into_folds(pendulum, 3)
    [prepared] = plans
    assert [f.roles for f in prepared.task.folds] == [Roles(d.roles.all, ()) for d in splits]
    assert {(s.record, s.fold) for s in found.scores} == {
        (e.name, f) for f, d in enumerate(splits) for e in d.scored
    }


def test_the_score_of_a_record_is_that_of_its_folds_model(done, pendulum):
    found, _, results = done
    by = {(r.member.fold, r.seed): r.model for r in results}
    for s in (found.scores[0], found.scores[-1]):
        [score] = tn.evaluate(by[s.fold, s.seed], pendulum[s.record], "derived-6")
        # alone it is not summed in the order in which it is beside other records
        assert s.rmse["derived-6"] == pytest.approx(score.rmse, rel=1e-6)


@pytest.mark.thorough
def test_members_of_folds_are_what_they_are_alone(done):
    # the first fold trains on the fewest windows: together, all have as many
    _, [prepared], results = done
    [alone] = train_plan(make_plan(prepared.task.with_members(prepared.members[:1])))
    assert alone.member == results[0].member == Member(4, fold=0)
    assert alone.detail("windows") == results[0].detail("windows")
    assert alone.validation_rmse == pytest.approx(results[0].validation_rmse, rel=1e-3)


def test_the_summary_is_what_one_computes_by_hand(done, pendulum):
    found, _, _ = done
    for start in ("derived-6", "derived-8"):
        table = {
            e.name: [s.rmse[start] for s in found.scores if s.record == e.name] for e in pendulum
        }
        means = [sum(of) / 2 for of in table.values()]
        mean = sum(means) / 5
        error = math.sqrt(sum((m - mean) ** 2 for m in means) / 4) / math.sqrt(5)
        told = found.summary()[start]
        assert told["mean"] == pytest.approx(mean)
        assert told["standard_error"] == pytest.approx(error)
        assert found.means(start) == pytest.approx(
            {name: sum(of) / 2 for name, of in table.items()}
        )
        for i, seed in enumerate((4, 7)):
            by_seed = sum(of[i] for of in table.values()) / 5
            assert told["by_seed"][str(seed)] == pytest.approx(by_seed)


def test_what_was_found_is_the_same_after_a_file(done):
    found, _, _ = done
    plain = found.as_plain()
    assert json.loads(to_json(plain)) == plain
    assert plain["unit"] == "rad"
    assert len(plain["records"]) == 10


def test_a_free_run_that_left_all_bounds_is_null_in_a_file():
    scores = tuple(FoldScore(f"r{i}", i, 0, {"file": x}) for i, x in enumerate((1.0, math.inf)))
    kept = json.loads(to_json(CrossValidationResult("tiny", "rad", scores, {}, 0.0).as_plain()))
    assert [r["rmse"]["file"] for r in kept["records"]] == [1.0, None]
    assert kept["summary"]["file"]["mean"] is None
    assert kept["summary"]["file"]["standard_error"] is None


def test_folds_whose_windows_differ_in_length_do_not_train_together(pendulum):
    adapting = tn.read_recipe(TINY, ["stages.0.windows.adapt=true", "stages.0.windows.length=50"])
    whole, cut = (Fold(Roles((part,), (pendulum[1],))) for part in (pendulum[0], pendulum[0][:60]))
    members = tuple(Member(seed, fold=f) for f in range(3) for seed in (0, 1))
    task = Task(adapting, (whole, cut, whole), members)
    assert [[m.fold for m in group] for group in groups_alike(task)] == [[0, 0, 2, 2], [1, 1]]
    alike = Task(tn.read_recipe(TINY), (whole, cut, whole), members)
    assert groups_alike(alike) == [list(members)]


# --- what is done: identifications ---


@pytest.fixture
def identified(monkeypatch) -> list[Task]:
    """Instead of identifying, the true model is the answer; every task that was asked for."""
    asked: list[Task] = []

    def identify_task(task, member, listener):
        if not any(task is other for other in asked):
            asked.append(task)
        return FitResult(
            tn.discretise(swing_model(TRUTH | {"gain": 0.15 + member.fold}), DT, 8),
            task.recipe,
            member,
            "finished",
            True,
            "file",
            None,
            1.0,
        )

    monkeypatch.setattr("tustinnet.fitting.fit.identify_task", identify_task)
    return asked


def swinging() -> tuple[tn.DataSet, list[FoldSplit]]:
    made = []
    for e in records():
        # declared, so that nothing is searched for and the records stay as they are
        inputs = tuple(replace(i, hold="zero-order", is_delay_declared=True) for i in e.inputs)
        made.append(replace(e, channels=replace(e.channels, inputs=inputs)))
    data = tn.DataSet("swing", tuple(made))
    return data, split_into_folds(data, 3)


def test_an_identification_has_all_records_that_are_not_scored(identified):
    data, splits = swinging()
    found = cross_validate(
        data, make_cross_validation_options("best-grey", system=SWING, folds=3, starts=["file"])
    )
    assert all(task.system is SWING for task in identified)
    assert [task.members for task in identified] == [(Member(fold=f),) for f in range(3)]
    used = [task.folds[f].roles for f, task in enumerate(identified)]
    assert used == [Roles(d.roles.all, ()) for d in splits]
    # the model of fold 0 has the gain that made the records
    right = [s for s in found.scores if s.fold == 0]
    assert all(s.rmse["file"] < 1e-6 for s in right)
    assert sorted(s.record for s in found.scores) == sorted(names(data))


def test_records_that_choose_how_to_begin_are_left_to_an_identification_that_needs_them(identified):
    data, splits = swinging()
    cross_validate(
        data, make_cross_validation_options("grey", system=SWING, folds=3, starts=["file"])
    )
    assert [f.roles for f in identified[0].folds] == [d.roles for d in splits]


@pytest.mark.thorough
def test_a_hybrid_corrects_the_physics_of_its_own_fold(identified, monkeypatch):
    data, splits = swinging()
    plans: list[TrainingPlan] = []

    def train_by_hand(prepared, listener, *more):
        plans.append(prepared)
        return [
            FitResult(model, prepared.recipe, m, "finished", True, "file", None, 1.0)
            for m, model in zip(prepared.members, prepared.initial_models, strict=True)
        ]

    monkeypatch.setattr("tustinnet.fitting.fit.train_plan", train_by_hand)
    asked = make_cross_validation_options(
        HYBRID, system=SWING, folds=3, seeds=(0, 1), starts=["file"]
    )
    found = cross_validate(data, asked)
    assert [f.roles for f in identified[0].folds] == [Roles(d.roles.all, ()) for d in splits]
    [prepared] = plans
    assert prepared.task.system is None
    assert [f.roles for f in prepared.task.folds] == [d.roles for d in splits]
    gains = []
    for model in prepared.initial_models:
        assert isinstance(model, tn.HybridModel)
        assert isinstance(model.physics, Discretised)
        assert isinstance(model.physics.continuous, tn.LagrangianModel)
        gains.append(model.physics.continuous.values["gain"])
    assert [round(float(g), 2) for g in gains] == [0.15, 0.15, 1.15, 1.15, 2.15, 2.15]
    assert len(found.scores) == 2 * len(data)


def test_whoever_wants_to_know_is_given_what_runs_together(identified):
    data, _ = swinging()
    told: list[object] = []
    cross_validate(
        data,
        make_cross_validation_options("best-grey", system=SWING, folds=3, starts=["file"]),
        Listener(on_begin=told.append),
    )
    assert told == identified


def test_the_usual_start_is_that_of_the_records(identified):
    data, _ = swinging()
    found = cross_validate(
        data, CrossValidationOptions(tn.read_recipe("best-grey"), system=SWING, folds=3)
    )
    assert set(found.scores[0].rmse) == {"file"}


def test_fewer_records_are_as_many_folds():
    assert len(split_into_folds(short(kinds="abcd"))) == 4
    assert len(split_into_folds(short())) == 5


def test_parts_of_a_file_that_follow_each_other_are_pieces_of_a_record():
    whole = records()[0]
    parts = [replace(whole[a : a + 30], source="log.csv") for a in (0, 30, 60)]
    assert are_cut(parts)
    assert not are_cut([parts[0], parts[2]])
    assert not are_cut([replace(p, source=f"{i}.csv") for i, p in enumerate(parts)])
