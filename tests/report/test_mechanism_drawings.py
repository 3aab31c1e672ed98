"""Drawings of mechanisms by their links: shapes, and what stays within the picture."""

import json
import shutil
import subprocess
from importlib import resources
from typing import Any

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.report.page.content import mechanism_content

if shutil.which("node") is None:
    pytest.skip("node is not installed", allow_module_level=True)

WIDTH, HEIGHT = 500, 400
# a canvas that keeps the points and lines that are drawn on it
CANVAS = """
const TURN = 2 * Math.PI, colours = { line: "#a0a0a0", grey: "#808080", paper: "#ffffff" };
colours.ink = "#000000";
const faint = (colour) => colour;
const endsOf = (pairs) => [Math.min(...pairs.flat()), Math.max(...pairs.flat())];
const points = [], names = new Set();
const seen = (name, ...of) => { names.add(name); points.push(...of); };
const context = {
  beginPath() {}, save() {}, restore() {}, setLineDash() {}, stroke() {}, fill() {}, closePath() {},
  lineTo: (x, y) => seen("line", [x, y]),
  arc: (x, y, r) => seen("arc", [x - r, y - r], [x + r, y + r]),
  roundRect: (x, y, w, h) => seen("box", [x, y], [x + w, y + h]),
};
"""
DRAW = """
const { links, coordinates, ends, size, poses } = JSON.parse(process.argv[1]);
const linkage = new Linkage(links, coordinates, ends);
linkage.draw(context, ...size, poses.map((q) => ({ q, colour: "#000000" })));
console.log(JSON.stringify({ points, names: [...names], tips: linkage.tips,
  outlines: links.map((_, i) => linkage.outline(linkage.links[i], linkage.places(poses[0])[i])) }));
"""
SYSTEMS = (
    "cart-pole",
    "2-link-chain",
    "3-link-chain",
    "two-mass-drive",
    "crane",
    "ball-and-beam",
    "reaction-wheel",
    "propeller-pendulum",
    "positioning-axis",
    "duffing",
    "qube-servo2",
)


def draw(system: tn.LagrangianSystem, reach: float, poses: list[list[float]]) -> dict[str, Any]:
    """What is drawn of poses, where records reach so far from 0."""
    content = mechanism_content(system.channels, system.links)
    content |= {
        "ends": [[-reach, reach]] * len(system.coordinates),
        "size": [WIDTH, HEIGHT],
        "poses": poses,
    }
    source = resources.files("tustinnet.report.page").joinpath("assets/linkage.js").read_text()
    done = subprocess.run(
        ["node", "--eval", CANVAS + source + DRAW, json.dumps(content)],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def swinging(*links: tn.Link) -> tn.LagrangianSystem:
    """A system that is drawn by some links; one that slides is called `x`."""
    coordinates = tuple(
        tn.Coordinate(of.coordinate, "linear" if of.coordinate == "x" else "angular")
        for of in links
    )
    return tn.LagrangianSystem(
        "drawn",
        coordinates,
        (),
        (tn.Parameter("mass", "kg", 1.0, 0.5, 2.0),),
        lambda q, v, p: p["mass"] * (v**2).sum() / 2,
        links=links,
    )


@pytest.mark.thorough
@pytest.mark.parametrize("name", SYSTEMS)
def test_packaged_systems_stay_within_the_picture(name):
    system = tn.load_system(name)
    grid = np.meshgrid(*[[-0.3, 0.0, 0.3]] * len(system.coordinates))
    drawn = draw(system, 0.3, np.stack(grid, -1).reshape(-1, len(system.coordinates)).tolist())
    points = np.array(drawn["points"], float)
    assert np.isfinite(points).all()
    assert (points >= 0).all()
    assert (points <= [WIDTH, HEIGHT]).all()
    # and fill it: a direction at least
    assert (np.ptp(points, axis=0) / [WIDTH, HEIGHT]).max() > 0.4


def test_a_wheel_is_round_about_its_axis_and_leaves_no_trail():
    wheel = tn.Link("b", (0, -1, 0), (0.1, 0, 0), shape="wheel")
    system = swinging(tn.Link("a", (0, -1, 0), (0, 0, -1)), wheel)
    drawn = draw(system, 1.0, [[0.5, 2.0]])
    hub = np.array([np.sin(0.5), 0, -np.cos(0.5)])
    spokes = np.array(drawn["outlines"][1]) - hub
    np.testing.assert_allclose(np.linalg.norm(spokes, axis=1), 0.1)
    np.testing.assert_allclose(spokes[:, 1], 0, atol=1e-12)
    np.testing.assert_allclose(spokes.sum(axis=0), 0, atol=1e-12)
    # a positive angle about -y turns x towards z, seen from the viewer against the clock
    np.testing.assert_allclose(spokes[0], [0.1 * np.cos(2.5), 0, 0.1 * np.sin(2.5)])
    assert drawn["tips"] == [0]


def test_a_beam_reaches_to_both_sides_and_a_ball_rests_on_it():
    beam = tn.Link("a", (0, -1, 0), (0.4, 0, 0), shape="beam")
    ball = tn.Link("x", (1, 0, 0), (0, 0, 0.02), at=(0, 0, 0), shape="ball")
    left, right = draw(swinging(beam, ball), 0.3, [[0.2, 0.1]])["outlines"][0]
    np.testing.assert_allclose(right, [0.4 * np.cos(0.2), 0, 0.4 * np.sin(0.2)], atol=1e-12)
    np.testing.assert_allclose(left, -np.array(right), atol=1e-12)
    around = np.array(draw(swinging(beam, ball), 0.3, [[0.2, 0.1]])["outlines"][1])
    centre = 0.1 * np.array([np.cos(0.2), 0, np.sin(0.2)])
    centre += 0.02 * np.array([-np.sin(0.2), 0, np.cos(0.2)])
    np.testing.assert_allclose(around.mean(axis=0), centre, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(around - centre, axis=1), 0.02)


@pytest.mark.usefixtures("unchecked")
def test_an_unknown_shape_is_refused():
    told = "link of 'a': the shape 'disc'; expected one of rod, rope, beam, wheel"
    with pytest.raises(tn.InputError, match=told):
        # a wrong shape on purpose
        tn.Link("a", (0, 1, 0), (0, 0, 1), shape="disc")  # pyright: ignore[reportArgumentType]


def test_what_slides_is_a_cart_unless_it_is_a_ball():
    cart = draw(swinging(tn.Link("x", (1, 0, 0), (0, 0, 0))), 0.3, [[0.1]])
    spring = draw(swinging(tn.Link("x", (1, 0, 0), (0, 0, 0), shape="spring")), 0.3, [[0.1]])
    ball = draw(swinging(tn.Link("x", (1, 0, 0), (0, 0, 0.1), shape="ball")), 0.3, [[0.1]])
    assert set(cart["names"]) == set(spring["names"]) == {"line", "box"}
    assert set(ball["names"]) == {"arc"}
    assert len(spring["points"]) > len(cart["points"]) + 18  # its coil
