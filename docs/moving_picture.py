"""Makes the README's moving picture from a page that `tustinnet report` wrote.

    tustinnet report grey/model.safetensors hybrid/model.safetensors DATA --split validation \
        --start model-20 --out report.html
    python docs/moving_picture.py report.html --record fallVal3 --out docs/images/free_run.gif

Needs Chromium and the extra `browser`.
"""

import argparse
import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

VIEW = {"width": 620, "height": 1400}
COLOURS = 64
COORDINATES = 2  # plots that are shown beside the mechanism


def main() -> None:
    """Opens the page, lets its time pass, and keeps what is to be seen."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--record", required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seconds", type=float, default=7.0)
    parser.add_argument("--rate", type=float, default=10, help="pictures a second")
    asked = parser.parse_args()
    pictures = frames(asked.page, asked.record, asked.seconds, asked.rate)
    # one palette for all, so that a picture holds only what changed
    palette = pictures[-1].quantize(COLOURS, dither=Image.Dither.NONE)
    first, *others = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    first.save(
        asked.out, save_all=True, append_images=others, duration=round(1000 / asked.rate), loop=0
    )
    print(f"{asked.out}: {len(pictures)} pictures, {asked.out.stat().st_size / 1e3:.0f} kB")


def frames(page: Path, record: str, seconds: float, rate: float) -> list[Image.Image]:
    """What a record's free run looks like at times that are equally far apart."""
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"))
        tab = browser.new_page(viewport=VIEW, color_scheme="light")
        tab.goto(page.resolve().as_uri())
        tab.select_option("#record", label=record)
        pictures = [at(tab, k / rate) for k in range(round(seconds * rate) + 1)]
        browser.close()
    return pictures


def at(tab: Page, time: float) -> Image.Image:
    """The mechanism and the plots at a time."""
    tab.evaluate(
        "t => { const e = document.getElementById('time'); e.value = t;"
        " e.dispatchEvent(new Event('input')); return new Promise(requestAnimationFrame); }",
        time,
    )
    mechanism = shot(tab, "#stage")
    plots = shot(tab, "#plots-run")
    whole = tab.locator("#plots-run").bounding_box()
    last = tab.locator("#plots-run > *").nth(COORDINATES - 1).bounding_box()
    if not (whole and last):
        raise SystemExit("the page shows no plots")
    plots = plots.crop((0, 0, plots.width, round(last["y"] + last["height"] - whole["y"])))
    picture = Image.new("RGB", (mechanism.width + plots.width, plots.height))
    picture.paste(mechanism, (0, (plots.height - mechanism.height) // 2))
    picture.paste(plots, (mechanism.width, 0))
    return picture


def shot(tab: Page, part: str) -> Image.Image:
    """A part of the page as it is now."""
    return Image.open(io.BytesIO(tab.locator(part).screenshot())).convert("RGB")


if __name__ == "__main__":
    main()
