"""How large a report is, how long it takes to write, and how fast it moves in Chromium.

    python benchmarks/report_page.py write MODEL... DATA [--split validation] [--out report.html]
    python benchmarks/report_page.py open report.html [--rounds 7]

`write` evaluates first and counts what follows: the first round reads the models' steps for the
playground for the first time in the process, as the command does. `open` needs the extra `browser`
and Chromium.
"""

import argparse
import json
import shutil
import time
from pathlib import Path
from statistics import median
from typing import Any

import jax

jax.config.update("jax_enable_x64", True)

import tustinnet as tn
from tustinnet.report.page.model_result import compute_model_result
from tustinnet.report.page.reported_model import model_file, read_reported_models
from tustinnet.report.page.write import ReportOptions, make_page
from tustinnet.simulate.starts import default_start
from tustinnet.store.files import write_into

SECONDS = 4.0  # of an animation whose frames are counted
# counts what the stage draws: each drawing begins by clearing the canvas
COUNTING = """
globalThis.frames_ = 0;
const clear = CanvasRenderingContext2D.prototype.clearRect;
CanvasRenderingContext2D.prototype.clearRect = function (...box) {
  if (this.canvas.id === "stage") globalThis.frames_ += 1;
  return clear.apply(this, box);
};
"""


def write(given: argparse.Namespace) -> dict[str, Any]:
    """Seconds after the evaluation, and the size."""
    files = [model_file(Path(path)) for path in given.models]
    models = read_reported_models(files, [tn.load_model(file) for file in files])
    records = list(tn.load(given.data).split(given.split))
    start = default_start(records, models[0].model)
    begin = time.perf_counter()
    results = [compute_model_result(m, records, start, None) for m in models]
    evaluation, seconds, page = time.perf_counter() - begin, [], ""
    for _ in range(given.rounds):
        begin = time.perf_counter()
        page = make_page(results, records, ReportOptions(start))
        write_into(given.out.parent, given.out.name, page)
        seconds.append(time.perf_counter() - begin)
    return {
        "models": len(files),
        "records": len(records),
        "evaluation": round(evaluation, 2),
        "first": round(seconds[0], 2),
        "median": round(median(seconds), 2),
        "bytes": len(page.encode()),
    }


def opened(given: argparse.Namespace) -> dict[str, Any]:
    """Seconds to the first frame and frames a second, of fresh pages."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    first, rates, busy = [], [], []
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for _ in range(given.rounds):
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            page.add_init_script(COUNTING)
            page.goto(given.file.resolve().as_uri())
            page.wait_for_selector("html[data-ready=yes]")
            marks = page.evaluate("performance.getEntriesByName('first-frame')[0].startTime")
            first.append(marks / 1000)
            page.wait_for_timeout(500)
            measured = page.context.new_cdp_session(page)
            measured.send("Performance.enable")
            before = _seconds(measured)
            rates.append(
                page.evaluate(
                    """async (seconds) => {
                  const [from, before] = [performance.now(), globalThis.frames_];
                  await new Promise((done) => setTimeout(done, 1000 * seconds));
                  return (globalThis.frames_ - before) / ((performance.now() - from) / 1000);
                }""",
                    SECONDS,
                )
            )
            busy.append(1000 * (_seconds(measured) - before) / (rates[-1] * SECONDS))
            page.close()
        browser.close()
    return {
        "rounds": given.rounds,
        "first frame": [round(x, 3) for x in (median(first), min(first), max(first))],
        "frames a second": [round(x, 1) for x in (median(rates), min(rates), max(rates))],
        "ms of work a frame": [round(x, 1) for x in (median(busy), min(busy), max(busy))],
    }


def _seconds(session: Any) -> float:
    """What the page's own thread has worked so far."""
    found = session.send("Performance.getMetrics")["metrics"]
    return next(of["value"] for of in found if of["name"] == "TaskDuration")


def main() -> None:
    """Reads the arguments, measures, prints."""
    asked = argparse.ArgumentParser()
    verbs = asked.add_subparsers(required=True)
    writing = verbs.add_parser("write")
    writing.add_argument("models", nargs="+")
    writing.add_argument("data")
    writing.add_argument("--split", default="validation")
    writing.add_argument("--out", type=Path, default=Path("results/report.html"))
    writing.add_argument("--rounds", type=int, default=5)
    writing.set_defaults(measure=write)
    opening = verbs.add_parser("open")
    opening.add_argument("file", type=Path)
    opening.add_argument("--rounds", type=int, default=7)
    opening.set_defaults(measure=opened)
    given = asked.parse_args()
    print(json.dumps(given.measure(given), indent=1))


if __name__ == "__main__":
    main()
