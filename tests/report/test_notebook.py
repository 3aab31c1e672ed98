"""What notebooks show of records and results."""

from dataclasses import replace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import polars as pl
import pytest
from conftest import SMALL_RECIPE

import tustinnet as tn
from tustinnet.evaluate.reference import find_reference
from tustinnet.fitting.report import Refit

mpl.use("agg")


@pytest.fixture(autouse=True)
def _no_open_figures():
    yield
    plt.close("all")


def test_records_are_frames(pendulum):
    e = pendulum[0]
    frame = e.to_frame()
    assert frame.columns == ["time", "angle", "torque"]
    np.testing.assert_array_equal(frame["angle"].to_numpy(), e.q[:, 0])
    whole = pendulum.to_frame()
    assert len(whole) == sum(map(len, pendulum))
    assert whole["record"].unique(maintain_order=True).to_list() == [e.name for e in pendulum]
    assert set(whole["split"]) == {"train", "validation"}


def test_records_are_drawn_into_axes_of_ones_own(pendulum):
    from matplotlib.figure import Figure

    axes = Figure().subplots(2, 1)
    drawn = pendulum[0].plot(axes)
    assert list(drawn) == list(axes)
    assert axes[0].get_ylabel() == "angle [rad]"
    assert axes[1].get_ylabel() == "torque [N m]"
    assert len(pendulum.plot()[0].lines) == len(pendulum)
    assert axes[0].get_title() == ""
    more = tn.DataSet("more", (*pendulum, *(replace(e, name=f"{e.name}b") for e in pendulum)))
    assert more.plot()[0].get_title() == "the first 5 of 10 records"
    assert f"{more[0].name}, the first of 10 records</figcaption>" in more._repr_html_()
    with pytest.raises(tn.InputError, match="2 axes, one a panel"):
        pendulum[0].plot(axes[:1])


@pytest.mark.parametrize("count", [1, 2])
def test_inputs_of_a_record_are_told_apart(count):
    q, u = np.zeros((50, 1)), np.ones((50, 2))
    inputs, e = {"lift": "N", "turn": "N m"}, []
    for name in ("one", "two")[:count]:
        record = tn.from_arrays(q, u, dt=0.1, coordinates={"x": "linear"}, inputs=inputs, name=name)
        e.append(record)
    panel = tn.DataSet("machine", tuple(e)).plot()[-1]
    assert panel.get_ylabel() == "inputs"
    labels = [text.get_text() for text in panel.get_legend().get_texts()]
    assert labels == ["lift [N]", "turn [N m]"]
    looks = {(line.get_color(), line.get_linestyle()) for line in panel.lines}
    assert len(looks) == 2 * count


def test_a_notebook_shows_tables_and_a_picture(pendulum, system):
    shown = pendulum._repr_html_()
    assert "pendulum: angle [rad], torque [N m], 20 ms a sample" in shown
    assert shown.count("<tr>") == len(pendulum) + 1
    assert "data:image/png;base64," in shown
    result = tn.fit(pendulum, "grey", system=system)
    assert "gravity" in result._repr_html_()
    frame = result.to_frame()
    assert result.identification is not None
    assert set(frame["name"]) == {e.name for e in result.identification.estimates}
    intervals = frame.select("interval_lower", "interval_upper").rows()
    assert intervals == [e.interval for e in result.identification.estimates]
    header = frame.write_csv().splitlines()[0]
    assert header.startswith("name,unit,value,error,naive_error,lower,upper,bound,")
    again = Refit(0.2, 0.1, 1, {"gravity": 7.0})
    rows = replace(result.identification, refit=again).to_frame().rows(named=True)
    expected = {e.name: e.value for e in result.identification.estimates} | {"gravity": 7.0}
    assert {row["name"]: row["in_model"] for row in rows} == expected


def test_results_are_shown_in_a_few_lines(pendulum, folder, system):
    result = tn.fit(pendulum, "grey", system=system)
    score = tn.evaluate(result.model, pendulum)[0]
    validation = tn.cross_validate(pendulum, tn.make_cross_validation_options("linear", folds=3))
    report = tn.inspect_experiment(pendulum[0])
    for shown in (result, result.identification, score, validation, report, tn.draft(folder)):
        assert repr(shown).startswith(f"{type(shown).__name__}(")
        assert len(repr(shown)) < 700
    for drawn in (result.plot(), score.plot()):
        assert drawn.shape == (2,)
        assert [line.get_label() for line in drawn[0].lines][-1] == "free run"
    with pytest.raises(tn.InputError, match="its records"):
        replace(result, roles=None).plot()
    assert f"rmse={score.rmse:.4g}" in repr(score)
    assert "simulated=array(300, 2)" in repr(score)
    assert "5 scores, mean RMSE" in repr(validation)
    assert repr(tn.Listener()) == "Listener()", "in signatures"
    frame = validation.to_frame()
    assert frame.columns == ["record", "fold", "seed", "start", "rmse"]
    assert len(frame) == len(pendulum) * len(validation.summary())
    assert "<td>&quot;fall1&quot;</td>" in validation._repr_html_()
    assert pl.DataFrame([score]).select("experiment", "rmse").row(0) == ("fall1", score.rmse)
    assert score.to_frame()["reference"].to_list() == [score.reference]
    assert (score.reference or 0.0) > score.rmse


def test_systems_models_and_drafts_are_shown_in_a_line(pendulum, folder, system):
    model = tn.fit(pendulum, "grey", system=system).model
    assert repr(model) == "Discretised(angle, torque, 0.02 s a sample, 1 LagrangianModel)"
    pair = tn.committee([model, model])
    assert repr(pair) == "Committee(angle, torque, 0.02 s a sample, 2 Discretised)"
    loaded = tn.load_system(system)
    names = f"{loaded.name!r}, angle, torque, {len(loaded.parameters)} parameters"
    assert repr(loaded) == f"LagrangianSystem({names})"
    draft = tn.draft(folder)
    assert "numbers=Numbers" in repr(draft.columns[0])
    assert draft.to_frame()["name"].to_list() == [c.name for c in draft.columns]
    assert "<pre># drafted from the logs" in draft._repr_html_()


def test_a_training_is_a_row(pendulum, tmp_path):
    (tmp_path / "small.toml").write_text(SMALL_RECIPE)
    result = tn.fit(pendulum, tmp_path / "small.toml")
    assert result.recipe.name in result._repr_html_()
    (row,) = result.to_frame().rows(named=True)
    assert (row["recipe"], row["validation_rmse"]) == ("small", result.validation_rmse)
    assert row["reference"] == find_reference(list(pendulum.split("validation")), None).mean
    assert row["horizon"] is None
    short = tn.fit(pendulum, tn.read_recipe(tmp_path / "small.toml", "horizon=1.0"))
    assert "<td>1 s</td>" in short._repr_html_()
    assert short.to_frame()["horizon"].to_list() == [1.0]
    assert short.to_frame()["reference"][0] < row["reference"]


def test_free_runs_start_where_they_usually_do(pendulum, system):
    model = tn.fit(pendulum, "grey", system=system).model
    given, usual = (tn.evaluate(model, pendulum, *start) for start in (["model-20"], []))
    assert [s.start for s in usual] == ["model-20"] * len(pendulum)
    assert tn.mean_rmse(usual) == tn.mean_rmse(given)
    np.testing.assert_array_equal(tn.free_run(model, pendulum)[0], usual[0].simulated)
