"""Makes the pictures of the systems of the library, as a report draws them.

    python docs/library_pictures.py --out docs/images/library

A record of each twin is simulated, and the mechanism is drawn as it is at a time of that record.
Needs Chromium and the extra `browser`.
"""

import argparse
import io
import shutil
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import jax.numpy as jnp
from PIL import Image, ImageChops
from playwright.sync_api import Page, sync_playwright

import tustinnet as tn
from tustinnet.systems.twin import Twin

# seconds after the beginning of the record of seed 0
MOMENTS = {
    "cart_pole": 1.2,
    "link_chain": 2.8,
    "two_mass_drive": 2.0,
    "crane": 2.4,
    "ball_and_beam": 0.56,
    "reaction_wheel": 1.2,
    "propeller_pendulum": 1.2,
    "positioning_axis": 0.8,
    "duffing": 1.2,
}
WIDTH, HEIGHT = 460, 1200  # of the window
MARGIN = 12  # pixels around what is drawn
COLOURS = 16


def main() -> None:
    """Draws each system and writes its picture."""
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as driver, TemporaryDirectory() as folder:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"))
        for name, moment in MOMENTS.items():
            twin = import_module(f"tustinnet.systems.library.{name}").TWIN
            tab = browser.new_page(
                viewport={"width": WIDTH, "height": HEIGHT}, color_scheme="light"
            )
            tab.goto(write_page(twin, Path(folder) / f"{name}.html").as_uri())
            picture = mechanism_at(tab, moment)
            picture.quantize(COLOURS, dither=Image.Dither.NONE).save(
                out / f"{name}.png", optimize=True
            )
            print(f"{out / name}.png: {(out / f'{name}.png').stat().st_size / 1e3:.1f} kB")
            tab.close()
        browser.close()


def write_page(twin: Twin, path: Path) -> Path:
    """The report of the true model on a record of a twin."""
    records = twin.records(train=1, validation=0, test=0)
    values = {name: jnp.asarray(value) for name, value in twin.true_values().items()}
    model = tn.discretise(twin.system.model(values), twin.dt, twin.substeps)
    return tn.write_report({"true": model}, records, path).resolve()


def mechanism_at(tab: Page, time: float) -> Image.Image:
    """What the page draws of the record at a time, without what is empty around it."""
    tab.uncheck(".shown")
    tab.evaluate(
        "t => { const e = document.getElementById('time'); e.value = t;"
        " e.dispatchEvent(new Event('input')); return new Promise(requestAnimationFrame); }",
        time,
    )
    shot = tab.locator("#stage").screenshot()
    picture = Image.open(io.BytesIO(shot)).convert("RGB")
    paper = Image.new("RGB", picture.size, picture.getpixel((0, 0)))
    box = ImageChops.difference(picture, paper).getbbox()
    if box is None:
        raise SystemExit("the page shows no mechanism")
    left, top, right, bottom = box
    return picture.crop(
        (
            max(left - MARGIN, 0),
            max(top - MARGIN, 0),
            min(right + MARGIN, picture.width),
            min(bottom + MARGIN, picture.height),
        )
    )


if __name__ == "__main__":
    main()
