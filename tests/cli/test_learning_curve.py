"""`learning-curve`: accuracy on records left out, against the number of those fitted to."""

import json
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import SYSTEM, record
from test_verbs import tustinnet
from torture.pendulum import SYSTEM as SMALL

import tustinnet as tn
from tustinnet.fitting.recipe import Recipe
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.report.drawing import write_figure
from tustinnet.report.learning import learning_figure
from tustinnet.selection.learning import (
    Draw,
    DrawFitter,
    DrawResult,
    LearningCurve,
    LearningCurveOptions,
    LearningPoint,
    draw_records,
    make_learning_curve_options,
)
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.systems.twin import imitate_records

TINY = """
name = "tiny"
[model]
{}
[[stages]]
name = "only"
windows = {{ draw = "strided", length = 8, count = 20 }}
rate = 1e-2
epochs = 2
batch = 8
keep = "last"
"""


class Recipes(NamedTuple):
    network: str
    hybrid: str


@pytest.fixture
def recipes(tmp_path) -> Recipes:
    kinds = {
        "network": "hidden = [4]",
        "hybrid": 'kind = "hybrid"\ncorrection = { kind = "tustin-net", hidden = [4] }',
    }
    for name, model in kinds.items():
        (tmp_path / f"{name}.toml").write_text(TINY.format(model))
    return Recipes(*(str(tmp_path / f"{name}.toml") for name in kinds))


@pytest.fixture(scope="session")
def six(tmp_path_factory):
    """Six records of the small pendulum as a folder: four are left in each draw."""
    records = [record(f"r{k}", 80, k, "train", forced=k % 2 == 0) for k in range(6)]
    place = tmp_path_factory.mktemp("six") / "logs"
    write_data_set(tn.DataSet("six", tuple(records)), place, "six records")
    return place


def test_every_way_to_a_model_is_drawn_against_the_number_of_records(
    six, recipes, tmp_path, capsys
):
    system, out = tmp_path / "small_pendulum.py", tmp_path / "curve"
    system.write_text(SYSTEM)
    command = (
        "learning-curve",
        six,
        "--out",
        out,
        "--recipe",
        recipes.network,
        "--draws",
        2,
        "--system",
        system,
        "--hybrid",
        recipes.hybrid,
        "--physics",
        "best-grey",
        "--twin",
        "identified",
        "--start",
        "derived-6",
        "--records",
        "2,4",
        "--quiet",
    )
    code, told, err = tustinnet(capsys, *command, "--json")
    assert code == 0, err
    curve = json.loads(told)
    assert curve == json.loads((out / "learning-curve.json").read_text())
    assert (curve["sizes"], curve["start"], curve["unit"]) == ([2, 4], "derived-6", "rad")
    assert list(curve["enough"]) == ["network", "grey box", "hybrid", "pre-trained"]
    assert len(curve["points"]) == 4 * 2 * 2
    physics = [p["rmse"] for p in curve["points"] if p["approach"] == "grey box"]
    assert max(physics) < 0.05
    assert (out / "learning-curve.png").read_bytes().startswith(b"\x89PNG")
    table = (out / "learning-curve.md").read_text()
    assert "pre-trained" in table
    assert "* grey box: " in table
    code, _, err = tustinnet(capsys, *command)
    assert code == 1
    assert "add --overwrite" in err


def test_a_network_alone_is_drawn_without_a_system(six, recipes, tmp_path, monkeypatch, capsys):
    """Of: learning-curve, with what is there replaced."""

    def train(self, draws, recipe, **models):
        return [DrawResult(None, "not trained", {})] * len(draws)

    monkeypatch.setattr(DrawFitter, "train", train)
    out = tmp_path / "curve"
    out.mkdir()
    (out / "learning-curve.md").write_text("of before")
    command = ("learning-curve", six, "--out", out, "--recipe", recipes.network)
    code, told, err = tustinnet(capsys, *command, "--overwrite")
    assert code == 0, err
    assert "* network: 4 records are not known to be enough (3 draws: 4 to 4)" in told
    assert "none (none..none)" in (out / "learning-curve.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--records", "2,two"], "--records: '2,two'"),
        (["--records", "4,2"], "two or more rising numbers from 2 on"),
        (["--records", "1,2"], "rising numbers from 2 on"),
        (["--records", "2,9"], "6 records, of which 4 remain in each draw; expected 9"),
        (["--physics", "grey"], "--physics: not applicable without a system"),
        (["--hybrid", "hybrid"], "--hybrid: not applicable without a system"),
        (["--twin", "nominal"], "--twin: not applicable without a system"),
        (["--system", "qube-servo2", "--hybrid", "standard"], "--hybrid: a recipe of kind"),
        (["--recipe", "grey"], "the recipe of a network by itself"),
        (["--start", "zero"], "unknown start 'zero'"),
        (["--card", "nowhere.toml"], "nowhere.toml"),
        (["--device", "gpu"], "--device gpu"),
        (["--strict", "--card", "nowhere.toml"], "nowhere.toml"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_what_cannot_be_drawn_is_one_line(arguments, told, six, tmp_path, capsys):
    out = tmp_path / "curve"
    code, printed, err = tustinnet(capsys, "learning-curve", six, "--out", out, *arguments)
    assert (code, printed) == (1, "")
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    assert told in line
    assert not out.exists()


def test_three_records_are_too_few_for_a_curve(folder, tmp_path, capsys):
    for name in ("fall2", "noise1"):
        (folder / f"{name}.csv").unlink()
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace(', "fall2.csv", "noise1.csv"', ""))
    code, _, err = tustinnet(capsys, "learning-curve", folder, "--out", tmp_path / "curve")
    assert code == 1
    assert "3 records, of which 0 remain in each draw; expected 4 that remain" in err


def test_what_is_scored_was_used_for_nothing_and_draws_are_nested():
    records = [record(f"r{k}", 60, k, "train") for k in range(11)]
    data = tn.DataSet("d", (*records, replace(record("t", 60, 99, "train"), split="test")))
    draws = draw_records(data, make_learning_curve_options("standard", draws=3))
    assert [d.size for d in draws[:3]] == [2, 4, 8]
    for draw in draws:
        used, scored = ({e.name for e in of} for of in (draw.records, draw.scored))
        assert not used & scored
        assert "t" not in used | scored
        roles = draw.split.roles_for(read_recipe("standard"))
        assert len(roles.train) + len(roles.validation) == draw.size
        assert len(roles.validation) == {2: 1, 4: 1, 8: 2}[draw.size]
        assert not draw.split.roles_for(read_recipe("best-grey")).validation
    first, second = draws[0], draws[1]
    assert second.records[:2] == first.records


def network_of(draw: Draw, recipe: Recipe, *beside: Draw) -> np.ndarray:
    """A step of the network of a draw, trained with others beside."""
    fitter = DrawFitter(tn.DataSet("draw", draw.records), "derived-6")
    result = fitter.train([*beside, draw], recipe)[-1]
    assert result.model is not None
    return np.asarray(result.model.step(jnp.array([0.3, -0.2]), jnp.zeros(1)))


def test_few_records_take_no_windows_from_the_points_with_more(recipes):
    records = tuple(record(f"r{k}", 60, k, "train") for k in range(8))
    few, many = (Draw(0, n, records[:n], ()) for n in (1, 8))
    recipe = read_recipe(recipes.network, ["stages.0.windows.count=200"])
    np.testing.assert_array_equal(network_of(many, recipe), network_of(many, recipe, few))


def test_records_of_two_devices_may_share_their_names(recipes):
    one, other = (
        Draw(d, 2, tuple(record(f"r{k}", 60, 10 * d + k, "train") for k in range(2)), ())
        for d in range(2)
    )
    recipe = read_recipe(recipes.network)
    beside = network_of(other, recipe, one)
    np.testing.assert_allclose(network_of(other, recipe), beside, rtol=1e-4)


def curve_of(*draws) -> LearningCurve:
    points = [
        LearningPoint("network", d, n, x, "")
        for d, of in enumerate(draws)
        for n, x in zip((2, 4, 8), of, strict=True)
    ]
    return LearningCurve("rad", "file", (2, 4, 8), tuple(points), (3,) * len(draws))


def test_enough_is_where_more_gain_less_than_a_tenth():
    flat = curve_of([0.3, 0.105, 0.1], [0.3, 0.2, 0.1], [np.inf, 0.1, 0.1])
    assert flat.find_enough("network").by_draw == (4, 8, 4)
    assert flat.sentence("network") == (
        "network: 4 records are enough (3 draws: 4 to 8): the error is within 10 % of what 8 leave"
    )
    falling = curve_of([0.4, 0.2, 0.1], [0.4, 0.3, 0.1])
    assert falling.find_enough("network").records is None
    assert "8 records are not known to be enough (2 draws: 8 to 8): from 4 to 8" in (
        falling.sentence("network")
    )
    # nothing is enough where even the most gave no model
    assert curve_of([np.inf] * 3).find_enough("network").records is None
    # a dip that does not last is not enough
    assert curve_of([0.1, 0.3, 0.1]).find_enough("network").by_draw == (8,)


@pytest.mark.parametrize("draws", [([np.inf, 0.2, 0.1], [0.4, 0.3, 0.2]), ([np.inf] * 3,) * 2])
def test_points_without_a_model_leave_gaps_in_the_figure(draws, tmp_path):
    write_figure(learning_figure(curve_of(*draws)), tmp_path, "curve.png")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")


def test_a_twin_stays_where_records_were(pendulum):
    records = list(pendulum.split("train"))
    values = SMALL.nominal() | {"gravity": 20.0, "damping": 0.8, "gain": 4.0}
    arrays = {name: jnp.asarray(x) for name, x in values.items()}
    model = tn.discretise(SMALL.model(arrays), 0.02, 4)
    made = imitate_records(model, records, 6, np.random.default_rng(0))
    assert len(made) == 6
    assert {e.channels for e in made} == {records[0].channels}
    assert all(np.abs(e.q).max() < 10 for e in made)
    again = imitate_records(model, records, 6, np.random.default_rng(0))
    np.testing.assert_array_equal(made[3].q, again[3].q)


def test_a_question_keeps_what_it_is_asked():
    options = make_learning_curve_options(
        "standard", None, (2, 4), draws=5, twin="nominal", start="file"
    )
    assert isinstance(options, LearningCurveOptions)
    assert (options.sizes, options.draws, options.twin, options.start) == (
        (2, 4),
        5,
        "nominal",
        "file",
    )
