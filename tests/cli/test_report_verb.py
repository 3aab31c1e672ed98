"""`tustinnet report` by the command: what its options change, what it refuses."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from test_bands_verb import place  # noqa: F401 (a fixture)
from test_verbs import tustinnet

LINKED = """
import tustinnet as tn

SYSTEM = tn.LagrangianSystem(
    name="drawn",
    coordinates=(tn.Coordinate("{name}", "angular"),),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(tn.Parameter("inertia", "kg m^2", 1.0, 0.1, 10.0),),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
    links=(tn.Link("{name}", (0, -1, 0), (0, 0, -0.3)),),
)
"""


def numbers_in(page: Path) -> dict[str, Any]:
    """The numbers that a page draws."""
    text = page.read_text(encoding="utf-8")
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    return json.loads(found)


def test_a_run_is_reported_as_its_options_say(run_folder, folder, tmp_path, capsys, refused):
    page = tmp_path / "pages" / "report.html"
    command = ("report", run_folder, folder, "--split", "validation", "--out", page)
    code, out, err = tustinnet(capsys, *command)
    assert (code, out) == (0, "")
    assert f"report: {page} (" in err
    told = numbers_in(page)
    assert [of["name"] for of in told["records"]] == ["fall3", "noise2"]
    assert [len(of["training"]) for of in told["models"]] == [2]
    text = page.read_text(encoding="utf-8")
    assert "2 validation records that it was not fitted to" in text
    assert f"tustinnet report {run_folder} {folder} --out {page} --split validation" in text
    refused(*command, names="add --overwrite")
    again = (*command, "--horizon", 1, "--start", "derived-8", "--overwrite")
    assert tustinnet(capsys, *again)[0] == 0
    text = page.read_text(encoding="utf-8")
    assert "Each run restarts every 1 s" in text
    assert re.search(r"restarted every 1 s, it is off by .* Without restarts, it is off by ", text)
    assert numbers_in(page)["records"][0]["runs"][0]["rmse"] < told["records"][0]["runs"][0]["rmse"]


def test_a_system_with_links_draws_a_network(run_folder, folder, tmp_path, capsys, refused):
    drawn, page = tmp_path / "drawn.py", tmp_path / "report.html"
    command = ("report", run_folder / "model.safetensors", folder, "--out", page, "--system", drawn)
    drawn.write_text(LINKED.format(name="elbow"))
    refused(*command, names="error: --system: 'drawn', which is the system of no model")
    drawn.write_text(LINKED.format(name="angle"))
    refused(*command, "--system", "qube-servo2", names="error: --system: 'drawn'")
    assert not page.exists()
    assert tustinnet(capsys, *command)[0] == 0
    assert numbers_in(page)["links"] == [
        {
            "coordinate": 0,
            "axis": [0, -1, 0],
            "reach": [0, 0, -0.3],
            "parent": None,
            "at": None,
            "shape": "rod",
        }
    ]


def test_what_cannot_be_reported_is_one_line(run_folder, folder, tmp_path, refused):
    page, model = tmp_path / "report.html", run_folder / "model.safetensors"
    refused("report", tmp_path / "gone", folder, "--out", page, names="no such file")
    refused("report", folder, folder, "--out", page, names="a folder without model.safetensors")
    refused("report", *[model] * 6, folder, "--out", page, names="6 models; expected 1 to 5")
    card = folder / "dataset.toml"
    card.write_text(card.read_text().replace('name = "angle"', 'name = "elbow"'))
    refused("report", model, folder, "--out", page, names="elbow")
    assert not page.exists()


@pytest.mark.thorough
def test_parameters_have_both_errors_and_calibrated_models_bands(place, tmp_path, capsys):  # noqa: F811 (the fixture)
    page = tmp_path / "report.html"
    command = (
        "report",
        place.banded,
        place.plain,
        place.logs,
        "--split",
        "validation",
        "--start",
        "model-20",
        "--system",
        place.system,
        "--out",
        page,
    )
    code, _, err = tustinnet(capsys, *command)
    assert code == 0, err
    text, (record, _) = page.read_text(encoding="utf-8"), numbers_in(page)["records"]
    assert "Shaded: bands that contain 66.7 % (banded) of the time." in text
    assert [len(run.get("band", ())) for run in record["runs"]] == [2, 0]
    assert [len(run["energy"]) for run in record["runs"]] == [2, 2]
    assert '<th scope="col">std. error</th>' in text
    assert '<th scope="col">error of J&#39;J</th>' in text
    assert text.count('class="place"') == 2 * 3
    assert tustinnet(capsys, *command, "--overwrite", "--horizon", 1)[0] == 0
    assert "no bands: `band=`: start" in page.read_text(encoding="utf-8")


def test_an_identification_shows_its_stages_and_the_way_of_its_parameters(identified):
    page = identified / "report.html"  # left by the fit
    (of,) = numbers_in(page)["models"]
    lines = [json.loads(line) for line in (identified / "log.jsonl").read_text().splitlines()]
    ends = [line for line in lines if "parameters" in line]
    assert [stage["name"] for stage in of["search"]["stages"]] == [end["stage"] for end in ends]
    costs = [cost for stage in of["search"]["stages"] for cost in stage["cost"]]
    steps = [line["cost"] for line in lines if "iteration" in line]
    assert [cost for cost in costs if cost in steps] == steps
    # of a stage that had nothing to do the cost at its end
    assert {*costs} - {*steps} <= {end["cost"] for end in ends}
    ways = {p["name"]: p for p in of["search"]["parameters"]}
    assert "inertia" not in ways  # fixed: it never moves
    assert ways["gravity"]["unit"]
    assert ways["gravity"]["values"] == [end["parameters"]["gravity"] for end in ends]
    text = page.read_text(encoding="utf-8")
    assert "1: equation-error estimate" in text
    assert 'id="plots-parameters"' in text


def test_a_network_has_no_stages_of_an_identification(run_folder, folder, tmp_path, capsys):
    page = tmp_path / "report.html"
    assert tustinnet(capsys, "report", run_folder, folder, "--out", page)[0] == 0
    assert [of["search"] for of in numbers_in(page)["models"]] == [None]
    assert 'id="plots-search"' not in page.read_text(encoding="utf-8")
