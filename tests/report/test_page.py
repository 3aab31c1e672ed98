"""The report page without a browser: what it says, what it escapes, what it draws."""

import base64
import hashlib
import json
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from conftest import write_folder
from scipy.spatial.transform import Rotation
from swinging import SWING, TRUTH, falls

import tustinnet as tn
from tustinnet.control.controllers import TrackingFeedback
from tustinnet.control.export.gains import controller_json
from tustinnet.control.lqr import Feedback, Recovery, Tracking
from tustinnet.control.plan import Plan
from tustinnet.errors import InputError
from tustinnet.evaluate.energy import energy_along
from tustinnet.export.javascript import MODULE, TARGET
from tustinnet.export.source import make_source
from tustinnet.models.kinematics import parent_indices
from tustinnet.report.page import content, write
from tustinnet.report.page import controller as controller_page
from tustinnet.report.page.signals import bounded, pack, thin
from tustinnet.simulate.range import Range, training_support
from tustinnet.store.header import read_header

HOSTILE = '"><img src=x onerror=alert(1)>'
UNIT = "</script><script>alert(2)</script>"


class Elements(HTMLParser):
    """The elements of a page with their attributes, and the texts of its scripts and styles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag in ("script", "style"):
            self.texts.append((tag, ""))

    def handle_data(self, data):
        if self.elements and self.elements[-1][0] in ("script", "style"):
            tag, before = self.texts[-1]
            self.texts[-1] = (tag, before + data)

    def handle_endtag(self, tag):
        self.elements.append((f"/{tag}", {}))


def unpacked(signal: dict[str, Any]) -> np.ndarray:
    whole = np.frombuffer(base64.b64decode(signal["k"]), "<i2").astype(float)
    values = signal["low"] + (signal["high"] - signal["low"]) * (whole + 32767) / 65534
    return np.where(whole == -32768, np.nan, values)


def numbers_in(text: str) -> dict[str, Any]:
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    return json.loads(found)


@pytest.fixture(scope="module")
def page(trained_once, pendulum, tmp_path_factory) -> str:
    """The report of a training on a few records."""
    place = tmp_path_factory.mktemp("page")
    data = tn.load(write_folder(pendulum, place / "logs"))
    runs = [trained_once, trained_once / "seed-1" / "model.safetensors"]
    return tn.write_report(runs, list(data), place / "report.html").read_text(encoding="utf-8")


def hostile_model() -> tuple[tn.Model, tn.Experiment]:
    e = falls()[0]
    coordinates = (tn.Coordinate(HOSTILE, "angular"),)
    inputs = (tn.Input("voltage", UNIT),)
    channels = replace(e.channels, coordinates=coordinates, inputs=inputs)
    system = replace(SWING, coordinates=coordinates, inputs=inputs)
    values = {name: jnp.asarray(x) for name, x in TRUTH.items()}
    model = tn.discretise(system.model(values), e.dt, 2)
    return model, replace(e, channels=channels, name=HOSTILE.replace("/", ""))


def test_a_page_is_one_file_that_may_ask_for_nothing(page):
    found = Elements(page)
    assert len(page.encode()) < 1_000_000
    policy = next(of["content"] for tag, of in found.elements if "http-equiv" in of)
    assert policy is not None
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    allowed = set(re.findall(r"'(sha256-[^']+)'", policy))
    said = {
        f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
        for (tag, text), of in zip(
            found.texts,
            [of for tag, of in found.elements if tag in ("script", "style")],
            strict=True,
        )
        if of.get("type") != "application/json"
    }
    assert said == allowed
    for _, of in found.elements:
        assert not {"src", "onclick", "style", "action"} & of.keys()
        assert (of.get("href") or "#").startswith("#")


def test_every_control_has_a_name_and_every_reference_a_target(page):
    found = Elements(page).elements
    ids = [of["id"] for _, of in found if of.get("id")]
    assert len(ids) == len(set(ids))
    for tag, of in found:
        for key in ("aria-labelledby", "for"):
            assert of.get(key) is None or of[key] in ids
        if tag == "canvas":
            assert of.get("aria-label")


def test_a_page_says_what_it_is_about(page):
    for text in (
        "A Tustin-Net model of angle",
        "Driven by torque (N m), in steps of 20 ms",
        "5 train and validation records, 3 of which it was fitted to",
        "run",
        "seed-1",
        "Every sample is drawn",
        "Copyright (c) 2022 Leon Sorokin",
        "Made by",
    ):
        assert (text in page) == (text != "Made by"), text  # nobody typed a command


def test_signals_are_those_of_the_evaluation(page, pendulum, trained_once):
    told = numbers_in(page)
    model = tn.load_model(trained_once / "model.safetensors")
    scores = tn.evaluate(model, list(pendulum), "derived-6")
    for e, score, of in zip(pendulum, scores, told["records"], strict=True):
        assert of["runs"][0]["rmse"] == [pytest.approx(score.rmse, rel=1e-6)]
        error = score.simulated[:, 0] - e.q[:, 0]
        for signal, values in ((of["q"][0], e.q[:, 0]), (of["runs"][0]["error"][0], error)):
            span = signal["high"] - signal["low"]
            np.testing.assert_allclose(unpacked(signal), values, atol=1e-4 * span)
    lines = told["models"][0]["training"]
    assert [line["name"] for line in lines] == ["seed-0", "seed-1"]
    assert len(unpacked(lines[0]["loss"])) == 9


def test_hostile_names_are_text(tmp_path):
    model, e = hostile_model()
    path = tn.write_report({HOSTILE: model}, e, tmp_path / "report.html")
    text = path.read_text(encoding="utf-8")
    found = Elements(text)
    assert not [of for tag, of in found.elements if tag == "img" or "onerror" in of]
    assert UNIT not in text
    told = numbers_in(text)
    assert told["coordinates"][0]["name"] == told["models"][0]["label"] == HOSTILE
    assert told["inputs"][0]["unit"] == UNIT
    assert len([of for tag, of in found.elements if tag == "script"]) == 5


def test_thinning_keeps_every_peak():
    generator = np.random.default_rng(0)
    signals = generator.normal(size=(10_000, 3))
    signals[5000:5300, 2] = np.nan
    signals[777, 1] = 50.0
    at = thin(signals, 300)
    assert 150 < len(at) <= 300
    assert np.all(np.diff(at) > 0)
    assert {0, 777, 9999} <= set(at.tolist())
    np.testing.assert_array_equal(np.nanmax(signals[at], axis=0), np.nanmax(signals, axis=0))
    np.testing.assert_array_equal(np.nanmin(signals[at], axis=0), np.nanmin(signals, axis=0))
    assert np.isnan(signals[at, 2]).any()
    assert len(thin(signals, 10_000)) == 10_000
    # what rises evenly needs the ends of its stretches alone
    assert len(thin(np.arange(10_000.0)[:, None], 300)) > 250


def test_packed_signals_come_back_to_a_part_in_65534():
    values = np.array([-3.0, np.nan, 0.1, 7.0, np.inf])
    found = unpacked(pack(values))
    np.testing.assert_array_equal(np.isnan(found), ~np.isfinite(values))
    np.testing.assert_allclose(found[[0, 2, 3]], values[[0, 2, 3]], atol=10 / 65534)
    assert unpacked(pack([2.0, 2.0])).tolist() == [2.0, 2.0]
    assert len(unpacked(pack([]))) == 0


def test_long_records_are_thinned_and_the_page_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(content, "_POINTS", (100,))
    values = {name: jnp.asarray(x) for name, x in TRUTH.items()}
    e = falls()[0]
    assert len(e) > 100
    model = tn.discretise(SWING.model(values), e.dt, 2)
    text = tn.write_report({"swing": model}, [e], tmp_path / "report.html").read_text()
    assert "1 of 1 records are drawn by at most 100 samples" in " ".join(text.split())
    (of,) = numbers_in(text)["records"]
    assert 50 < len(unpacked(of["q"][0])) == len(unpacked(of["t"])) <= 100
    assert unpacked(of["q"][0]).max() == pytest.approx(e.q.max(), abs=1e-3)


def test_a_simulation_that_leaves_the_picture_is_cut():
    measured = np.array([[0.0], [1.0]])
    found = bounded(np.array([[0.5], [1e300]]), measured)
    assert np.isnan(found).tolist() == [[False], [True]]


def test_energy_is_that_of_the_equations():
    values = {name: jnp.asarray(x) for name, x in TRUTH.items()}
    several = falls()
    model = tn.discretise(SWING.model(values), several[0].dt, 2)
    states = [e.measured_states() for e in several]
    found = energy_along(model, several, states)
    assert found is not None
    for x, energy in zip(states, found, strict=True):
        assert energy[7] == pytest.approx(float(SWING.model(values).energy(jnp.asarray(x[7]))))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"axis": (0, 0, 0)}, "an axis of length 0"),
        ({"reach": (0, 0)}, "3 numbers"),
        ({"at": (0, 0, np.inf)}, "3 numbers"),
        ({"coordinate": "elbow"}, "a link of the coordinate 'elbow'"),
        ({"parent": "angle"}, "the link of 'angle' on 'angle'; expected base"),
        ({"shape": "wheel", "reach": (0, 0, 0)}, "a reach of length 0"),
        ({"shape": "ball"}, "'angle'; expected this shape only for linear coordinates"),
    ],
)
def test_links_that_cannot_be_drawn_are_refused(change, told):
    known: dict[str, Any] = {"coordinate": "angle", "axis": (0, 0, 1), "reach": (0, 0, 1)}
    with pytest.raises(InputError, match=re.escape(told)):
        replace(SWING, links=(tn.Link(**(known | change)),))


def test_what_cannot_be_written_is_refused(pendulum, tmp_path):
    there = tmp_path / "there.html"
    there.write_text("mine")
    with pytest.raises(InputError, match="there already"):
        tn.write_report({}, pendulum[0], there)
    with pytest.raises(InputError, match="0 models"):
        tn.write_report({}, pendulum[0], tmp_path / "new.html")
    with pytest.raises(InputError, match="no records"):
        tn.write_report({"a": hostile_model()[0]}, [], tmp_path / "new.html")
    with pytest.raises(InputError, match="no such file"):
        tn.write_report([tmp_path / "nowhere"], pendulum[0], tmp_path / "new.html")
    assert Path(there).read_text() == "mine"


def test_points_are_as_many_as_have_room():
    def judging(samples: int) -> Any:
        return [replace(falls()[0][:samples], name=f"r{i}") for i in range(20)]

    few = content.choose_thinning([], judging(150), 1e6)
    assert (few.points, few.records) == (2000, 0)
    tight = content.choose_thinning([], judging(200), 30_000)
    assert (tight.points, tight.records) == (100, 20)


JUDGING = """
const { range, cloud, angular, states, inputs } = JSON.parse(process.argv[1]);
const n = angular.length;
console.log(JSON.stringify(states.map((x, k) => {
  const { by, together } = leaving(range, cloud, angular, x.slice(0, n), x.slice(n), inputs[k]);
  return [by.length > 0, together];
})));
"""


def test_a_page_knows_what_was_recorded_as_the_package_does():
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    generator = np.random.default_rng(0)
    coordinates = [
        tn.Coordinate("arm", "angular"),
        tn.Coordinate("cart", "linear"),
        tn.Coordinate("tip", "angular"),
    ]
    records = []
    for i in range(4):  # turning on one way, the cart and the input tied to the tip
        t = 0.02 * np.arange(150)
        tip = np.sin((2 + i / 50) * t)
        q = np.stack([2 * t + i / 20, 0.3 * tip, tip], axis=1)
        records.append(
            tn.from_arrays(
                q,
                2 * tip,
                v=np.gradient(q, t, axis=0),
                dt=0.02,
                name=f"r{i}",
                coordinates=coordinates,
                inputs=[tn.Input("motor", "V")],
            )
        )
    channels = records[0].channels
    every = np.concatenate([np.concatenate([e.measured_states(), e.u], axis=1) for e in records])
    ends = np.stack([every.min(axis=0), every.max(axis=0)], axis=1)
    cloud = training_support(channels, records)
    assert cloud is not None
    known = Range(ends[:6], ends[6:], cloud)
    # beyond the ends, near what was recorded, and each from another sample
    span, mixed = np.ptp(ends, axis=1), generator.permuted(every, axis=0)[:100]
    far = ends.mean(axis=1) + span * generator.uniform(-0.8, 0.8, (50, 7))
    near = every[::10][:50] + 0.02 * span * generator.normal(size=(50, 7))
    drawn = np.concatenate([far, near, mixed])
    drawn[0, 4] = np.inf
    states, inputs = drawn[:, :6], drawn[:, 6:]
    left = [
        known.extrapolation_point(channels, x[None], u[None])
        for x, u in zip(states, inputs, strict=True)
    ]
    content = {
        "range": {
            "q": known.states[:3].tolist(),
            "v": known.states[3:].tolist(),
            "u": known.inputs.tolist(),
        },
        "cloud": {
            "points": cloud.points.tolist(),
            "spread": cloud.spread.tolist(),
            "reach": cloud.reach,
        },
        "angular": channels.angular.tolist(),
        "states": np.where(np.isfinite(states), states, 1e308).tolist(),
        "inputs": inputs.tolist(),
    }
    source = resources.files("tustinnet.report.page").joinpath("assets/range.js").read_text()
    done = subprocess.run(
        ["node", "--eval", source + JUDGING, json.dumps(content)],
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)
    assert [any(of) for of in found] == [of is not None for of in left]
    # each by itself, together only, not at all: all three happen
    kinds = ["by" if by else "together" if together else "" for by, together in found]
    assert min(kinds.count(kind) for kind in ("by", "together", "")) > 20
    said = ["" if of is None else "by" if of.signal else "together" for of in left]
    assert kinds == said


COMMANDING = """
const wrapped = (angle) => angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
const { controller: pilotOf, states } = JSON.parse(process.argv[1]), data = { controller: pilotOf };
"""


def test_a_page_commands_what_python_does_after_a_fall_too():
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    generator, steps = np.random.default_rng(0), 20
    about = {
        "lower": np.array([-1.0]),
        "upper": np.array([1.5]),
        "dt": 0.02,
        "delay": 1,
        "speeds": np.ones(1),
        "periodic": (0,),
    }
    final = Feedback(
        gain=0.3 * generator.normal(size=(1, 4)),
        x0=np.zeros(2),
        u0=np.array([0.1]),
        integral=(0,),
        **about,
    )
    start = np.array([np.pi, 0.0])
    settle = Feedback(
        gain=0.3 * generator.normal(size=(1, 3)), x0=start, u0=np.array([-0.2]), **about
    )
    plan = Plan(
        x=np.linspace(start, [0.0, 0.0], steps + 1),
        u=generator.normal(size=(steps, 1)),
        cost=0.0,
        converged=True,
        reached=True,
        iterations=1,
        dt=0.02,
        goal=np.zeros(2),
        before=np.array([0.3]),
        delay=1,
    )
    recovery = Recovery(settle, np.array([0.8, 0.0]), np.array([0.3, 1.0]))
    tracking = Tracking(plan, 0.3 * generator.normal(size=(steps, 1, 3)), final, recovery)
    # along the plan, at its end, fallen with whole turns, near the start but quick, slow, again
    states = np.concatenate(
        [
            plan.x[:-1],
            np.tile([0.2, 0.0], (30, 1)),
            np.tile([2.0 + 2 * np.pi, 1.0], (10, 1)),
            np.tile([-3.0, 2.0], (5, 1)),
            np.tile([3.0 - 2 * np.pi, 0.5], (1, 1)),
            plan.x[1:],
        ]
    )
    states += 0.02 * generator.normal(size=states.shape)
    python, phases, commands = TrackingFeedback(tracking), [], []
    for k, x in enumerate(states):
        commands.append(python.inputs(k, x))
        phases.append(python.phase)
    expected = ["plan"] * 20 + ["hold"] * 30 + ["settle"] * 15 + ["plan"] * 20 + ["hold"]
    assert phases == expected
    channels = tn.Channels((tn.Coordinate("arm", "angular"),), (tn.Input("motor", "V"),), 0.02)
    controller = json.loads(controller_json(tracking, channels))
    controller["feedback"]["period"] = controller["period"]
    source = resources.files("tustinnet.report.page").joinpath("assets/pilot.js").read_text()
    call = "console.log(JSON.stringify(commandsFor(states)));"
    done = subprocess.run(
        [
            "node",
            "--eval",
            COMMANDING + source + call,
            json.dumps({"controller": controller, "states": states.tolist()}),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    np.testing.assert_allclose(json.loads(done.stdout), commands, rtol=0, atol=1e-13)


# a cart with an arm of two links and a pendulum beside it, and a crank on the base
TREE = (
    tn.Link("cart", (1, 0, 0), (0, 0, 0)),
    tn.Link("arm", (0, -1, 0), (0, 0, -0.4)),
    tn.Link("hand", (0, 0, 1), (0.2, 0, 0)),
    tn.Link("tail", (0, -1, 0), (0, 0, -0.3), parent="cart", at=(-0.1, 0, 0)),
    tn.Link("crank", (0, 2, 0), (0.5, 0, 0), parent="base", at=(1, 0, -1)),
)


@pytest.mark.parametrize(("span", "turning"), [((-0.03, 0.03), False), ((-4.0, 1.0), True)])
def test_an_angle_that_moves_little_is_drawn_over_what_was_recorded(span, turning):
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    assets = resources.files("tustinnet.report.page").joinpath("assets")
    (line,) = re.findall(r"^const isTurning.*", assets.joinpath("data.js").read_text(), re.M)
    code = f"{line} console.log(isTurning('angular', {list(span)}));"
    done = subprocess.run(["node", "--eval", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == turning
    for name in ("states.js", "playground.js"):
        source = assets.joinpath(name).read_text()
        assert "isTurning(" in source
        subprocess.run(["node", "--check", "-"], input=source, text=True, check=True)


PLACED = """
const TURN = 2 * Math.PI, endsOf = () => [0, 1];
const placed = ({ links, coordinates, q }) =>
  new Linkage(links, coordinates, coordinates.map(() => [-1, 1])).places(q);
"""


def test_a_tree_of_links_is_placed_as_its_frames_say():
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    names = [link.coordinate for link in TREE]
    assert parent_indices(TREE) == [None, 0, 1, 0, None]
    kinds = ["linear", *["angular"] * 4]
    cart, arm, hand, tail, crank = q = [0.3, 0.5, -0.7, 1.1, 2.0]
    content = {
        "links": [
            {
                "coordinate": names.index(of.coordinate),
                "axis": of.axis,
                "reach": of.reach,
                "parent": parent,
                "at": of.at,
                "shape": of.shape,
            }
            for of, parent in zip(TREE, parent_indices(TREE), strict=True)
        ],
        "coordinates": [{"kind": kind} for kind in kinds],
        "q": q,
    }
    source = resources.files("tustinnet.report.page").joinpath("assets/linkage.js").read_text()
    call = "console.log(JSON.stringify(placed(JSON.parse(process.argv[1]))));"
    done = subprocess.run(
        ["node", "--eval", PLACED + source + call, json.dumps(content)],
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)

    def about(axis: list[int], angle: float) -> np.ndarray:
        return Rotation.from_rotvec(angle * np.array(axis, float)).as_matrix()

    first = np.array([cart, 0, 0])
    hung = first - np.array([0.1, 0, 0])
    elbow = first + about([0, -1, 0], arm) @ [0, 0, -0.4]
    expected = [
        (first, first),
        (first, elbow),
        (elbow, elbow + about([0, -1, 0], arm) @ about([0, 0, 1], hand) @ [0.2, 0, 0]),
        (hung, hung + about([0, -1, 0], tail) @ [0, 0, -0.3]),
        (np.array([1, 0, -1]), [1, 0, -1] + about([0, 1, 0], crank) @ [0.5, 0, 0]),
    ]
    for of, (begin, end) in zip(found, expected, strict=True):
        np.testing.assert_allclose(of["begin"], begin, atol=1e-12)
        np.testing.assert_allclose(of["end"], end, atol=1e-12)


def test_split_start_and_horizon_are_by_default_those_of_the_command(
    trained_once, pendulum, tmp_path, monkeypatch
):
    pages = []

    def keep(models, records, path, options):
        pages.append(([e.name for e in records], options.start, options.horizon))
        return path

    monkeypatch.setattr(write, "write_page", keep)
    judged = read_header(trained_once / "model.safetensors")["scores"]
    page = tmp_path / "report.html"
    tn.write_report([trained_once], pendulum, page)
    tn.write_report([trained_once], pendulum, page, split="all", start="derived-6", horizon=1.0)
    tn.write_report([trained_once], list(pendulum)[:2], page, horizon=np.inf)
    tn.write_report({"mine": tn.load_model(trained_once / "model.safetensors")}, pendulum[0], page)
    validation = [e.name for e in pendulum.split("validation")]
    assert pages == [
        (validation, judged["start"], judged.get("horizon")),
        ([e.name for e in pendulum], "derived-6", 1.0),
        ([e.name for e in list(pendulum)[:2]], judged["start"], None),
        ([pendulum[0].name], None, None),
    ]
    with pytest.raises(InputError, match="split: 'test' of records that are no data set"):
        tn.write_report([trained_once], list(pendulum), page, split="test")


def test_models_that_would_fill_the_page_stay_out_of_the_playground(
    trained_once, pendulum, tmp_path, monkeypatch
):
    model = tn.load_model(trained_once / "model.safetensors")
    size = len(str(TARGET.files(make_source(model, None))[MODULE]))
    monkeypatch.setattr(write, "_MAX_MODULES", int(1.5 * size))
    given = {"first": model, "second": model}
    file = tn.write_report(given, pendulum[0], tmp_path / "report.html", start="derived-6")
    text = file.read_text(encoding="utf-8")
    assert numbers_in(text)["exported"] == [0]
    assert "second: not in the playground: its size: " in text


def test_a_closed_loop_without_any_estimate_near_it_has_no_error_and_no_warning():
    assert np.isnan(controller_page._rms(np.full((5, 2), np.nan)))
    assert controller_page._rms(np.array([[np.nan, 3.0], [-3.0, np.nan]])) == 3.0
