"""Learning curves: accuracy on records left out, against the number of those fitted to."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import SYSTEM, record
from test_verbs import tustinnet

import tustinnet as tn
from tustinnet.fitting.recipe_reading import read_recipe
from tustinnet.report.drawing import write_figure
from tustinnet.report.learning import learning_figure
from tustinnet.selection.learning import LearningCurve, LearningPoint, draw_records, learning_curve
from tustinnet.store.data_set_folder import write_data_set

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
HYBRID = 'kind = "hybrid"\ncorrection = { kind = "tustin-net", hidden = [4] }'


@pytest.fixture(scope="session")
def six(tmp_path_factory):
    """Six records of the small pendulum as a folder: four are left in each draw."""
    records = [record(f"r{k}", 80, k, "train", forced=k % 2 == 0) for k in range(6)]
    place = tmp_path_factory.mktemp("six") / "logs"
    write_data_set(tn.DataSet("six", tuple(records)), place, "six records")
    return place


def test_a_hybrid_is_drawn_against_the_number_of_records(six, tmp_path, capsys):
    system, out = tmp_path / "small_pendulum.py", tmp_path / "curve"
    system.write_text(SYSTEM)
    (tmp_path / "hybrid.toml").write_text(TINY.format(HYBRID))
    command = ("cross-validate", six, "--out", out, "--recipe", tmp_path / "hybrid.toml")
    command += ("--system", system, "--start", "derived-6", "--quiet")
    command += ("--records", "2,4", "--draws", 2)
    code, told, err = tustinnet(capsys, *command, "--json")
    assert code == 0, err
    curve = json.loads(told)
    assert curve == json.loads((out / "learning-curve.json").read_text())
    assert (curve["sizes"], curve["start"], curve["unit"]) == ([2, 4], "derived-6", "rad")
    assert list(curve["enough"]) == ["tiny"]
    assert len(curve["points"]) == 2 * 2
    assert max(p["rmse"] for p in curve["points"]) < 0.2
    assert (out / "learning-curve.png").read_bytes().startswith(b"\x89PNG")
    assert "* tiny: " in (out / "learning-curve.md").read_text()
    code, _, err = tustinnet(capsys, *command)
    assert code == 1
    assert "add --overwrite" in err


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--records", "2,two"], "--records: '2,two'"),
        (["--records", "4,2"], "two or more rising numbers from 2 on"),
        (["--records", "1,2"], "rising numbers from 2 on"),
        (["--records", "2,9"], "6 records, of which 4 remain in each draw; expected 9"),
        (["--draws", "2"], "--draws: not applicable without --records"),
        (["--records", "all", "--seeds", "2"], "--seeds: not applicable to a learning curve"),
        (["--records", "all", "--cluster", "auto"], "--cluster: not applicable to a learning"),
        (
            ["--records", "all", "--start", "file", "--start", "model-20"],
            "--start: not applicable to a learning curve",
        ),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_what_cannot_be_drawn_is_one_line(arguments, told, six, tmp_path, capsys):
    out = tmp_path / "curve"
    code, printed, err = tustinnet(capsys, "cross-validate", six, "--out", out, *arguments)
    assert (code, printed) == (1, "")
    (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
    assert told in line
    assert not list(out.glob("*")), "nothing was written"


def test_three_records_are_too_few_for_a_curve(folder, tmp_path, capsys):
    for name in ("fall2", "noise1"):
        (folder / f"{name}.csv").unlink()
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace(', "fall2.csv", "noise1.csv"', ""))
    command = ("cross-validate", folder, "--out", tmp_path / "curve", "--records", "all")
    code, _, err = tustinnet(capsys, *command)
    assert code == 1
    assert "3 records, of which 2 remain in each draw; expected 4 that remain" in err


def test_what_is_scored_was_used_for_nothing_and_draws_are_nested():
    records = [record(f"r{k}", 60, k, "train") for k in range(11)]
    data = tn.DataSet("d", (*records, replace(record("t", 60, 99, "train"), split="test")))
    by_size = draw_records(data, (), 3, 5)
    assert [*by_size] == [2, 4, 8]
    for size, split in ((size, split) for size, splits in by_size.items() for split in splits):
        used, scored = ({e.name for e in of} for of in (split.roles.all, split.scored))
        assert not used & scored
        assert "t" not in used | scored
        roles = split.roles_for(read_recipe("standard"))
        assert len(roles.train) + len(roles.validation) == size
        assert len(roles.validation) == {2: 1, 4: 1, 8: 2}[size]
        assert not split.roles_for(read_recipe("best-grey")).validation
    first, second = by_size[2][0].roles.all, by_size[4][0].roles.all
    assert {e.name for e in first} < {e.name for e in second}


@pytest.mark.thorough
def test_a_point_without_a_model_says_why_and_no_point_at_all_is_an_error(system, monkeypatch):
    records = [record(f"r{k}", 80, k, "train", forced=True) for k in range(6)]
    data = tn.DataSet("six", tuple(records))
    options = tn.make_cross_validation_options("grey", system=system)
    from tustinnet.fitting import fit

    identify = fit.identify_task

    fewest = 4

    def fail_with_few(task, member, *more):
        if len(task.folds[member.fold].roles.all) < fewest:
            raise tn.InputError("six", "too few records", "more")
        return identify(task, member, *more)

    monkeypatch.setattr(fit, "identify_task", fail_with_few)
    curve = learning_curve(data, options, (2, 4), 2)
    assert curve.by_draw("grey", 2) == [np.inf, np.inf]
    assert max(curve.by_draw("grey", 4)) < 0.1
    assert "too few records" in curve.points[0].outcome
    fewest = 9
    with pytest.raises(tn.InputError, match="grey: no model of any draw"):
        learning_curve(data, options, (2, 4), 2)


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
