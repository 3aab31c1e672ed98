"""Parameters that are fitted once more after a search."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import (
    CREEPING,
    TRUTH,
    changed,
    data_set,
    falls,
    noises,
    read_by_encoder,
    records,
    simulated,
    swing_model,
    voltage,
)

import tustinnet as tn
from tustinnet.families.family import family_of
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.fitting.report import Identification
from tustinnet.fitting.shooting import refit
from tustinnet.report.fits import parameter_table

START = "model-20"


@pytest.fixture(autouse=True)
def _any_gain_is_worth_it(request, monkeypatch):
    """Where nothing else is asked for, parameters are refitted however little that gains."""
    if "small_gain" not in request.node.name:
        monkeypatch.setattr(refit, "_WORTH", 0.0)


SYSTEM = swing_model().system
QUICK = ("search.initial=anchored",)


def recipe(*changes: str, refine: str | None = START) -> tn.Recipe:
    more = [f"search.refine={refine}"] if refine else []
    return tn.read_recipe("grey", [*QUICK, *more, *changes])


def creeping() -> list[tn.Experiment]:
    """Records that creep; the system that is identified does not."""
    values = {"offset": 0.0, "stiffness": 0.9, "relaxation": 6.0}
    return [
        read_by_encoder(
            simulated(
                e.name,
                [float(e.q[0, 0]), float(e.velocities("file")[0, 0]), 0.0],
                e.u[:, 0],
                values,
                CREEPING,
            )
        )
        for e in (*falls(), *noises())
    ]


def values_of(identification: Identification) -> dict[str, float]:
    continuous = identification.model.continuous
    assert isinstance(continuous, tn.LagrangianModel)
    return {name: float(x) for name, x in continuous.values.items()}


def test_where_physics_is_missing_free_runs_get_better():
    data, steps = data_set(creeping()), list[Iteration]()
    usual = tn.identify(data, SYSTEM, recipe(refine=None))
    identification = tn.identify(
        data, SYSTEM, recipe(), listener=Listener(on_iteration=steps.append)
    )
    refitted = identification.refit
    assert usual.refit is None
    assert refitted is not None
    assert identification.estimates == usual.estimates  # with their errors
    before, after = (
        tn.mean_rmse(tn.evaluate(each.model, list(data), START)) for each in (usual, identification)
    )
    assert refitted.before == pytest.approx(before, rel=1e-3)
    assert refitted.after == pytest.approx(after, rel=1e-3)
    assert after < before
    values = values_of(identification)
    for name, value in refitted.values.items():
        assert values[name] == pytest.approx(value, rel=1e-9), name
    assert values["inertia"] == TRUTH["inertia"]  # fixed
    mine = [step for step in steps if step.stage == f"refit to free runs from {START}"]
    assert [step.number for step in mine] == list(range(1, refitted.iterations + 1))
    message = f"mean RMSE went from {refitted.before:.3g} to {refitted.after:.3g}"
    assert any(message in finding.text for finding in identification.findings)
    assert identification.as_plain()["refined"]["values"] == refitted.values
    table = parameter_table(identification)
    assert list(table.columns)[-1] == "in the model"
    shown = {row[0]: row[-1] for row in table.rows}
    assert shown["gravity"] == f"{values['gravity']:.4g}"
    assert shown["inertia"] == f"{TRUTH['inertia']:.4g}"
    assert list(parameter_table(usual).columns)[-1] == "range"


def test_where_the_model_is_right_the_truth_stays():
    data = data_set([read_by_encoder(e) for e in records()])
    identification = tn.identify(data, SYSTEM, recipe())
    for name, value in values_of(identification).items():
        assert value == pytest.approx(TRUTH[name], rel=0.02, abs=1e-3), name


def test_a_small_gain_leaves_parameters_as_identified():
    data = data_set([read_by_encoder(e) for e in records()])
    identification = tn.identify(data, SYSTEM, recipe())
    assert identification.refit is None
    assert any("as identified" in finding.text for finding in identification.findings)
    values = values_of(identification)
    assert {e.name: values[e.name] for e in identification.estimates} == {
        e.name: pytest.approx(e.value) for e in identification.estimates
    }


@pytest.mark.thorough
def test_what_a_recipe_fixes_is_not_refined():
    identification = tn.identify(data_set(creeping()), SYSTEM, recipe("model.fixed.gravity=1.3"))
    assert identification.refit is not None
    assert "gravity" not in identification.refit.values
    assert values_of(identification)["gravity"] == 1.3


@pytest.mark.thorough
def test_parameters_stay_within_their_ranges():
    narrow = changed("gravity", lower=1.6, nominal=1.65, upper=5.0)  # the truth is below
    identification = tn.identify(
        data_set([read_by_encoder(e) for e in records()]), narrow, recipe()
    )
    assert identification.refit is not None
    assert identification.refit.values["gravity"] == pytest.approx(1.6, rel=1e-6)
    assert identification.refit.after <= identification.refit.before


def test_free_runs_that_leave_all_numbers_leave_the_model_as_it_is(monkeypatch):
    def diverging(values):
        n = len(values)
        return refit._FreeRunProducts(np.array([np.inf]), np.zeros((1, n, n)), np.zeros((1, n)))

    monkeypatch.setattr(refit, "_make_simulation", lambda *_: diverging)
    data = data_set(creeping())
    identification = tn.identify(data, SYSTEM, recipe())
    assert identification.refit is None
    text = " ".join(finding.text for finding in identification.findings)
    assert "no refit to free runs: free runs diverge" in text
    assert {e.name: values_of(identification)[e.name] for e in identification.estimates} == {
        e.name: pytest.approx(e.value) for e in identification.estimates
    }


def test_validation_is_of_the_refined_model():
    *train, last = creeping()
    data = data_set(
        [*(replace(e, split="train") for e in train), replace(last, split="validation")]
    )
    identification = tn.identify(data, SYSTEM, recipe())
    scores = tn.evaluate(identification.model, [last], identification.start)
    assert identification.validation_rmse == pytest.approx(tn.mean_rmse(scores), rel=1e-3)


def test_parameters_per_group_are_refined_for_their_records():
    per = changed("gravity", per="place")
    experiments = [
        replace(
            read_by_encoder(simulated(f"r{i}", [1.0, 0.0], voltage(120, i), {"gravity": g})),
            groups=(("place", place),),
        )
        for i, (place, g) in enumerate([("here", 1.5), ("there", 1.2)] * 2)
    ]
    identification = tn.identify(data_set(experiments), per, recipe())
    assert identification.refit is not None
    assert identification.refit.values["gravity[here]"] == pytest.approx(1.5, rel=0.01)
    assert identification.refit.values["gravity[there]"] == pytest.approx(1.2, rel=0.01)
    assert identification.refit.after < 0.01


@pytest.mark.thorough
def test_a_delay_stays_as_it_was_found():
    data = data_set([read_by_encoder(e) for e in records()])
    identification = tn.identify(data, SYSTEM, recipe('model.free=["voltage.delay"]'))
    assert identification.refit is not None
    assert "voltage.delay" in identification.values
    assert "voltage.delay" not in identification.refit.values


def test_where_nothing_is_left_to_refine_it_says_so():
    data = data_set([read_by_encoder(e) for e in records()])
    fixed = [f"model.fixed.{name}={TRUTH[name]}" for name in ("damping", "gravity", "gain")]
    identification = tn.identify(data, SYSTEM, recipe('model.free=["voltage.delay"]', *fixed))
    assert identification.refit is None
    assert identification.findings[-1].text == "no refit to free runs: nothing but delays is free"
    identification = tn.identify(data, SYSTEM, recipe(f"search.horizon={12 * data[0].dt}"))
    assert identification.refit is None
    assert (
        identification.findings[-1].text
        == "no refit to free runs: model-20 requires longer segments"
    )


def test_records_shorter_than_the_start_are_refused():
    short = [read_by_encoder(e[:8]) for e in records()]
    message = r"search\.refine: 'model-20', and record .* has 8 samples; .*search\.refine=none"
    with pytest.raises(tn.InputError, match=message):
        tn.identify(data_set(short), SYSTEM, recipe())


def test_a_start_that_records_do_not_have_is_refused_before_the_search():
    iterations: list[Iteration] = []
    without = [replace(e, v=None) for e in records()]
    with pytest.raises(tn.InputError, match="velocities"):
        tn.identify(
            data_set(without),
            SYSTEM,
            recipe(refine="file"),
            listener=Listener(on_iteration=iterations.append),
        )
    assert not iterations


def test_bands_are_about_the_model():
    """What is drawn from the errors of the parameters lies about the refined values."""
    result = tn.fit(data_set(creeping()), recipe(), system=SYSTEM, listener=Listener())
    identification = result.identification
    assert identification is not None
    assert identification.refit is not None
    drawn = family_of(result.model).alternatives(result.model, result.as_header())
    assert len(drawn) > 1
    for e in identification.estimates:
        values = [float(each.continuous.values[e.name]) for each in drawn]  # pyright: ignore[reportAttributeAccessIssue]
        middle = np.mean(values)
        assert e.error
        assert abs(middle - identification.refit.values[e.name]) < 2 * e.error, e.name
