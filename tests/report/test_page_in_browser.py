"""The report page in a real browser: Chromium by Playwright (`make test-browser`)."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.simulate.range import Range, recorded_range
from tustinnet.systems.qube_servo2 import SYSTEM

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("chromium is not installed", allow_module_level=True)
playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (extra 'browser')"
)

DT, STEPS = 0.01, 500
HOSTILE = "<b onmouseover=alert(1)>"
SHARES = {"nominal": 1.0, "heavier": 1.2, HOSTILE: 0.9}  # of the arm's mass
FIRST_FRAME, RATE = 1.5, 30  # s and 1/s; loose, as machines of tests are busy


def pendulum(share: float) -> tn.Model:
    """The rotary pendulum with another mass of its arm."""
    values = SYSTEM.nominal() | {"arm_mass": share * SYSTEM.nominal()["arm_mass"]}
    return tn.discretise(SYSTEM.model({k: jnp.asarray(v) for k, v in values.items()}), DT, 2)


def record(name: str, model: tn.Model, alpha: float, volts: float) -> tn.Experiment:
    u = volts * np.random.default_rng(0).uniform(-1, 1, (STEPS, 1))
    x = np.asarray(tn.rollout(model, np.array([0.3, alpha, 0.0, 0.0]), u))
    return tn.from_arrays(
        x[:, :2],
        np.concatenate([u, u[-1:]]),
        v=x[:, 2:],
        dt=DT,
        name=name,
        split="test",
        coordinates=model.coordinates,
        inputs=model.inputs,
    )


@pytest.fixture(scope="module")
def models() -> dict[str, tn.Model]:
    return {label: pendulum(share) for label, share in SHARES.items()}


@pytest.fixture(scope="module")
def records(models) -> list[tn.Experiment]:
    nominal = models["nominal"]
    return [record("fall", nominal, 0.4, 0.0), record(HOSTILE, nominal, np.pi, 4.0)]


@pytest.fixture(scope="module")
def page_file(models, records, tmp_path_factory) -> Path:
    return tn.write_report(models, records, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as running:
        opened = running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


class Opened:
    """A page, with what it asked for and what it complained of."""

    def __init__(self, browser: Any, file: Path, **context: Any) -> None:
        self.context = browser.new_context(**context)
        self.page = self.context.new_page()
        self.asked: list[str] = []
        self.told: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("console", lambda message: self.told.append(message.text))
        self.page.on("pageerror", lambda error: self.told.append(str(error)))
        self.page.on("dialog", lambda dialog: self.told.append(dialog.message))
        self.page.goto(file.as_uri())
        self.page.wait_for_selector("html[data-ready=yes]")


@pytest.fixture
def opened(browser, page_file) -> Iterator[Opened]:
    found = Opened(browser, page_file, viewport={"width": 1280, "height": 800})
    yield found
    found.context.close()
    assert found.asked == [page_file.as_uri()]
    assert found.told == []


def drawn(page: Any, canvas: str) -> str:
    return page.evaluate("(id) => document.getElementById(id).toDataURL()", canvas)


def test_the_mechanism_moves_and_stops(opened):
    page = opened.page
    first = page.evaluate("performance.getEntriesByName('first-frame')[0].startTime") / 1000
    assert first < FIRST_FRAME
    before = drawn(page, "stage")
    page.wait_for_timeout(300)
    assert drawn(page, "stage") != before
    page.get_by_role("button", name="Pause").click()
    page.wait_for_timeout(50)
    before = drawn(page, "stage")
    page.wait_for_timeout(200)
    assert drawn(page, "stage") == before
    page.get_by_label("Time in the record").fill("2.5")
    assert page.locator("#clock").inner_text() == "2.50 s"
    page.get_by_label("Speed").select_option("0.1")
    page.get_by_role("button", name="Play").click()
    page.wait_for_timeout(500)
    assert 2.5 < float(page.locator("#clock").inner_text().split()[0]) < 2.7


def test_frames_come_fast_with_three_models(opened):
    frames = opened.page.evaluate("""() => new Promise((done) => {
      let count = 0;
      const tell = () => { count += 1; };
      const from = performance.now();
      const tick = () => {
        tell();
        if (performance.now() - from < 1000) requestAnimationFrame(tick); else done(count);
      };
      requestAnimationFrame(tick);
    })""")
    assert frames >= RATE


@pytest.mark.parametrize("which", range(len(SHARES)))
def test_the_playgrounds_steps_are_the_models(opened, models, records, which):
    model, e = list(models.values())[which], records[1]
    u = e.u[:STEPS]
    x0 = np.array([0.3, 2.5, 0.0, 0.0])
    expected = np.asarray(tn.rollout(model, x0, u))
    given = [which, x0.tolist(), u.tolist()]
    found = np.array(opened.page.evaluate("([k, x, u]) => freeRun(k, x, u)", given))
    assert found.shape == (STEPS + 1, 4)
    size = np.abs(expected).max(axis=0)
    assert np.max(np.abs(found - expected) / size) < 1e-12


def test_the_mechanism_is_dragged_let_go_pushed_and_driven(opened):
    page = opened.page
    page.get_by_role("button", name="Pause").click()
    toy = page.locator("#toy")
    toy.scroll_into_view_if_needed()
    box = toy.bounding_box()
    start = page.get_by_role("slider", name="alpha [rad]")
    start.fill("3.3")
    hanging = drawn(page, "toy")
    # the pendulum hangs below the arm's end, in the lower half
    place = page.evaluate("""() => {
      const canvas = document.getElementById("toy"), { width, height } = canvas;
      const pixels = canvas.getContext("2d").getImageData(0, 0, width, height).data;
      let lowest = null;
      for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
        const [r, g, b, a] = pixels.slice(4 * (y * width + x), 4 * (y * width + x) + 4);
        if (a === 255 && r > 180 && g < 90 && b < 40) lowest = [x, y];
      }
      return lowest;
    }""")
    page.mouse.move(box["x"] + place[0], box["y"] + place[1] - 4)
    page.mouse.down()
    page.mouse.move(box["x"] + place[0] + 80, box["y"] + place[1] - 40, steps=4)
    dragged = drawn(page, "toy")
    assert dragged != hanging
    assert abs(float(start.input_value()) - 3.3) > 0.2
    page.mouse.up()
    page.wait_for_timeout(300)
    assert drawn(page, "toy") != dragged
    page.get_by_role("button", name="Hold").click()
    page.get_by_role("button", name="Push").click()
    page.wait_for_timeout(100)
    page.get_by_role("button", name="Back to the start").click()
    still = drawn(page, "toy")
    toy.focus()
    page.keyboard.down("ArrowRight")
    page.wait_for_timeout(300)
    page.keyboard.up("ArrowRight")
    assert drawn(page, "toy") != still
    assert page.locator("#toy-state").inner_text() == "Nobody knows what was recorded."


def test_every_control_has_a_name(opened):
    page = opened.page
    tree = page.locator("body").aria_snapshot()
    for role in ("button", "slider", "checkbox", "combobox", "img", "region", "group"):
        for line in tree.splitlines():
            stripped = line.strip().removeprefix("- ")
            if stripped.split(":")[0].split(" ")[0] == role:
                assert '"' in stripped, line
    for name in (
        "Play",
        "Time in the record",
        "Speed",
        "Record",
        "Show nominal",
        "Zoom in",
        "Let go",
        "Push",
        "alpha [rad]",
        "voltage [V]",
        "Model",
    ):
        assert name in tree.replace("Pause", "Play"), name


def test_plots_zoom_by_buttons_and_keys(opened):
    page = opened.page
    plot = page.get_by_role("group", name="theta against time", exact=True)
    before = drawn_in(plot)
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Zoom in").click()
    page.wait_for_timeout(100)
    closer = drawn_in(plot)
    assert closer != before
    plot.focus()
    page.keyboard.press("0")
    page.wait_for_timeout(100)
    assert drawn_in(plot) != closer


def drawn_in(plot: Any) -> str:
    return plot.evaluate("(of) => of.querySelector('canvas').toDataURL()")


def test_another_record_and_fewer_models_are_drawn(opened):
    page = opened.page
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("combobox", name="Record", exact=True).select_option("1")
    assert page.locator("#chosen").inner_text() == HOSTILE
    assert page.locator("b").count() == 0
    before = drawn(page, "stage")
    page.get_by_label("Time in the record").fill("1")
    assert drawn(page, "stage") != before
    before = drawn(page, "stage")
    page.get_by_label("Show heavier").uncheck()
    assert drawn(page, "stage") != before


@pytest.mark.parametrize("width", [360, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_and_follows_the_scheme(browser, page_file, width, scheme):
    size = {"width": width, "height": 800}
    found = Opened(browser, page_file, viewport=size, color_scheme=scheme, reduced_motion="reduce")
    wide, theme = found.page.evaluate(
        "[document.documentElement.scrollWidth, document.documentElement.dataset.theme]"
    )
    assert (wide, theme) == (width, scheme)
    assert found.page.get_by_role("button", name="Play").is_visible()  # nothing moves by itself
    assert found.told == []
    found.context.close()


def test_it_prints(browser, page_file):
    found = Opened(browser, page_file, color_scheme="dark", reduced_motion="reduce")
    found.page.evaluate(
        "addEventListener('beforeprint', () => { globalThis.printed = "
        "[document.documentElement.dataset.theme, document.body.scrollWidth]; })"
    )
    pdf = found.page.pdf(prefer_css_page_size=True)
    assert pdf.startswith(b"%PDF")
    theme, wide = found.page.evaluate("globalThis.printed")
    assert theme == "light"
    assert wide <= 182 / 25.4 * 96 + 1
    assert found.page.evaluate("document.documentElement.dataset.theme") == "dark"
    found.context.close()


def test_the_playground_says_where_it_leaves_what_was_recorded(browser, models, records, tmp_path):
    known = recorded_range(models["nominal"], records).as_header()
    tn.save(models["nominal"], tmp_path / "known.safetensors", range=known)
    file = tn.write_report([tmp_path / "known.safetensors"], records, tmp_path / "report.html")
    found = Opened(browser, file, reduced_motion="reduce")
    drawn = np.random.default_rng(0).uniform(-1, 1, (200, 5)) * [2, 4, 12, 25, 5]
    states, inputs = drawn[:, :4], drawn[:, 4:]
    header = tn.read_header(tmp_path / "known.safetensors")
    read = Range.from_header(header, models["nominal"])
    assert read is not None
    left = [
        read.extrapolation_point(models["nominal"].channels, x[None], u[None]) is not None
        for x, u in zip(states, inputs, strict=True)
    ]
    told = found.page.evaluate("([x, u]) => isOutside(0, x, u)", [states.tolist(), inputs.tolist()])
    assert told == left
    assert 10 < sum(left) < 190
    said = found.page.locator("#toy-state")
    assert said.inner_text() == "Within what was recorded."
    for _ in range(4):
        found.page.get_by_role("button", name="Push").click()
    found.page.get_by_role("button", name="Hold").click()
    assert said.inner_text().startswith("Outside of what was recorded: der_")
    assert found.page.locator("#toy[data-outside=true]").count() == 1
    assert found.told == []
    found.context.close()


def test_models_without_links_have_dials(browser, models, records, tmp_path):
    bare = replace(SYSTEM, links=())
    values = {k: jnp.asarray(v) for k, v in SYSTEM.nominal().items()}
    model = tn.discretise(bare.model(values), DT, 2)
    file = tn.write_report({"bare": model}, records[:1], tmp_path / "report.html")
    found = Opened(browser, file, reduced_motion="reduce")
    assert len(drawn(found.page, "stage")) > 3000
    assert found.told == []
    found.context.close()


def test_links_that_form_a_tree_are_drawn_and_dragged(browser, models, records, tmp_path):
    links = (
        tn.Link("theta", (0, -1, 0), (0, 0, -0.2)),
        tn.Link("alpha", (0, -1, 0), (0, 0, -0.2), parent="base", at=(0.3, 0, 0)),
    )
    values = {k: jnp.asarray(v) for k, v in SYSTEM.nominal().items()}
    model = tn.discretise(replace(SYSTEM, links=links).model(values), DT, 2)
    file = tn.write_report({"tree": model}, records[:1], tmp_path / "report.html")
    found = Opened(browser, file, reduced_motion="reduce")
    page = found.page
    places = page.evaluate(
        "Object.keys(JSON.parse(document.getElementById('data').textContent)"
        ".links[1]).sort().join()"
    )
    assert places == "at,axis,coordinate,parent,reach,shape"
    before = drawn(page, "stage")
    page.get_by_label("Time in the record").fill("1")
    assert drawn(page, "stage") != before
    before = drawn(page, "toy")
    page.get_by_role("slider", name="alpha [rad]").fill("1.0")
    assert drawn(page, "toy") != before
    assert found.told == []
    found.context.close()
