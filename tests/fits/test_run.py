"""Run folders: what is kept, and going on after a kill."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

import tustinnet as tn
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import Run, run_fit
from tustinnet.fitting.listener import Iteration, Listener, StageResult
from tustinnet.fitting.task import Member
from tustinnet.store.log import SearchLog, read_log, read_search_log
from tustinnet.store.run_folder import MODEL, Earlier, discard_results


def arrays(path: Path) -> dict[str, bytes]:
    return {name: a.tobytes() for name, a in safetensors.numpy.load_file(path).items()}


def run(data, recipe, seeds, folder: Path, earlier: Earlier = "refuse", rates=(1.0,)) -> Run:
    """Trains seeds at some rates and keeps everything in a folder."""
    members = [Member(seed, rate) for seed in seeds for rate in rates]
    return run_fit(prepare(FitRequest(data, recipe, members)), folder, earlier)


def small(small_recipe: Path) -> tn.Recipe:
    return tn.read_recipe(small_recipe)


def test_a_run_keeps_model_log_and_summary_of_every_seed(run_folder):
    kept = json.loads((run_folder / "summary.json").read_text())
    for seed in (0, 1):
        folder = run_folder / f"seed-{seed}"
        lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
        assert len(lines) == 9
        assert {"stage", "epoch", "loss", "validation", "rate"} <= set(lines[0])
        header = tn.read_header(folder / MODEL)
        assert header["training"]["seed"] == seed
        assert header["training"]["epochs"] == kept["seeds"][seed]["epochs"] == [5, 4]
        assert header["scores"]["mean"] == pytest.approx(kept["seeds"][seed]["mean"])
    best = run_folder / f"seed-{kept['best_seed']}" / MODEL
    assert arrays(run_folder / MODEL) == arrays(best)


def test_the_spread_is_reported_not_only_the_best(run_folder):
    told = json.loads((run_folder / "summary.json").read_text())
    means = sorted(seed["mean"] for seed in told["seeds"])
    assert told["spread"]["min"] == means[0] < means[1] == told["spread"]["max"]
    assert told["spread"]["median"] == pytest.approx(np.mean(means))
    assert told["spread"]["std"] > 0


def test_the_header_names_recipe_data_and_scores(run_folder):
    header = tn.read_header(run_folder / MODEL)
    assert header["recipe"]["name"] == "small"
    assert [r["source"] for r in header["data"]["records"]][:2] == ["fall1.csv", "fall2.csv"]
    assert all(len(r["sha256"]) == 64 for r in header["data"]["records"])
    assert header["scores"]["split"] == "validation"
    assert header["scores"]["start"] == "derived-6"


def test_the_header_says_where_the_training_records_lie(run_folder, pendulum):
    told = tn.read_header(run_folder / MODEL)["range"]
    training = list(pendulum.split("train"))
    angles = np.concatenate([e.q for e in training])
    np.testing.assert_allclose(told["states"][0], [angles.min(), angles.max()], atol=1e-6)
    torques = np.concatenate([e.u for e in training])
    np.testing.assert_allclose(told["inputs"], [[torques.min(), torques.max()]], atol=1e-6)


def test_a_seed_that_joins_later_does_not_disturb_those_that_are_done(
    run_folder, folder, small_recipe
):
    before = arrays(run_folder / "seed-1" / MODEL)
    # two are new, as many as were trained there together: by the same program
    members = [Member(0), Member(1), Member(1, 0.5), Member(2)]
    request = FitRequest(tn.load(folder), small(small_recipe), members)
    joined = run_fit(prepare(request), run_folder, "resume")
    assert arrays(run_folder / "seed-1" / MODEL) == before
    assert [(r.result.seed, r.result.member.rate) for r in joined.members] == [
        (0, 1.0),
        (1, 1.0),
        (1, 0.5),
        (2, 1.0),
    ]
    assert (run_folder / "seed-1-rate-0.5" / MODEL).is_file()
    assert all(r.result.finished for r in joined.members)


def test_an_earlier_run_is_not_overwritten_unasked(run_folder, folder, small_recipe):
    data, recipe = tn.load(folder), small(small_recipe)
    with pytest.raises(tn.InputError, match="`resume=`"):
        run(data, recipe, [0], run_folder)
    again = run(data, recipe, [0], run_folder, "discard")
    assert [p.name for p in run_folder.glob("seed-*")] == ["seed-0"]
    assert len(again.members) == 1


def test_resuming_a_finished_run_changes_nothing(run_folder, folder, small_recipe):
    before = arrays(run_folder / MODEL), (run_folder / "seed-0" / "log.jsonl").read_text()
    run(tn.load(folder), small(small_recipe), [0, 1], run_folder, "resume")
    after = arrays(run_folder / MODEL), (run_folder / "seed-0" / "log.jsonl").read_text()
    assert after == before


def test_a_checkpoint_of_another_run_is_refused(run_folder, folder, small_recipe):
    data, recipe = tn.load(folder), small(small_recipe)
    for name in ("question.json", MODEL):  # what would refuse before it
        (run_folder / name).unlink()
    other = recipe.model_copy(update={"name": "other"})
    for arguments in ((data, other), (data.exclude("fall1"), recipe)):
        with pytest.raises(tn.InputError, match="another recipe, seed, rate, data set"):
            run(*arguments, [0], run_folder, "resume")


def test_a_damaged_checkpoint_is_refused(run_folder, folder, small_recipe):
    path = run_folder / "seed-0" / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(tn.InputError, match="cut short"):
        run(tn.load(folder), small(small_recipe), [0], run_folder, "resume")


@pytest.mark.parametrize("damage", ["gone", "cut", "list", "binary", "other keys", "deep", "again"])
def test_a_damaged_log_is_set_aside_and_said_so(run_folder, folder, small_recipe, damage):
    log = run_folder / "seed-0" / "log.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    content = {
        "gone": b"",
        "cut": ("".join(lines[:4]) + lines[4][:9]).encode(),
        "binary": b"\xff\x00",
        "list": ("".join(lines[:3]) + "[1]\n").encode(),
        "deep": b"[" * 100_000,
        "again": "".join([*lines[:6], lines[0], *lines[6:]]).encode(),  # a stage that was over
        "other keys": (lines[0] + '{"stage": 3}\n').encode(),
    }[damage]
    log.write_bytes(content)
    if damage == "gone":
        log.unlink()
    sound = {"cut": 4, "list": 3, "other keys": 1, "again": 6}.get(damage, 0)
    told: list[str] = []
    fit = prepare(FitRequest(tn.load(folder), small(small_recipe), [Member(0), Member(1)]))
    run_fit(fit, run_folder, "resume", Listener(on_message=told.append))
    assert len(told) == 1
    assert f"seed-0/log.jsonl: {sound} sound lines, expected 9" in told[0]
    assert log.read_text() == "".join(lines[:sound])
    assert log.with_name("log.damaged.jsonl").read_bytes() == content
    assert len(read_log(run_folder / "seed-0")) == sound


def test_results_of_every_kind_of_run_are_discarded_and_nothing_else(tmp_path):
    results = [
        "model.safetensors",
        "summary.json",
        "report.html",
        "log.jsonl",
        "question.json",
        "candidates.md",
        "candidates/grey/model.safetensors",
        "candidates/grey/fold-0/scores.json",
        "seed-0/model.safetensors",
        "seed-0/log.jsonl",
        "seed-0/checkpoint.safetensors",
        "figures/fall1.png",
        "figures/fall2.png",
        "figures/training.png",
        "figures/candidates.png",
    ]
    others = ["notes.txt", "figures/mine.png", "seed-1/notes.txt", "candidates/grey/notes.txt"]
    for name in (*results, *others):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "summary.json").write_text(
        '{"seeds": [{"rmse": {"fall1": 1.0}}],'
        ' "candidates": [{"starts": {"file": {"rmse": {"fall2": 1.0}}}}]}'
    )
    discard_results(tmp_path)
    left = [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()]
    assert sorted(left) == sorted(others)
    assert not (tmp_path / "seed-0").exists()


@pytest.mark.thorough
def test_a_diverged_training_is_resumed_with_its_whole_log(folder, tiny_recipe, tmp_path):
    tiny_recipe.write_text(tiny_recipe.read_text().replace("rate = 3e-3", "rate = 1e3"))
    first = run(tn.load(folder), small(tiny_recipe), [0], tmp_path / "run")
    log = tmp_path / "run" / "seed-0" / "log.jsonl"
    before = log.read_bytes()
    assert before
    again = run(tn.load(folder), small(tiny_recipe), [0], tmp_path / "run", "resume")
    assert log.read_bytes() == before
    assert again.best.result.outcome == first.best.result.outcome
    assert first.best.result.outcome.startswith("diverged")


def test_a_folder_that_is_removed_while_it_is_written_into_ends_the_run(
    folder, tiny_recipe, tmp_path
):
    place = tmp_path / "run"

    def remove(report) -> None:
        if report.epoch == 1 and place.exists():
            shutil.rmtree(place)

    fit = prepare(FitRequest(tn.load(folder), small(tiny_recipe)))
    with pytest.raises(tn.InputError, match=r"log\.jsonl: cannot be written \(No such file"):
        run_fit(fit, place, "refuse", Listener(on_epoch=remove))


@pytest.mark.thorough
def test_a_run_without_validation_records_is_judged_on_its_training_records(
    pendulum, tiny_recipe, tmp_path
):
    alone = run(pendulum.split("train"), small(tiny_recipe), [0], tmp_path / "run")
    assert alone.judging_split == "train"
    assert len(alone.members[0].scores) == 3


PROGRAM = """
import sys, jax
jax.config.update("jax_enable_x64", True)
from pathlib import Path
import tustinnet as tn
from tustinnet.fits.request import FitRequest, prepare
from tustinnet.fits.run import run_fit
from tustinnet.store import checkpoint
checkpoint._INTERVAL = 0.0
data = tn.load(sys.argv[1])
for place in map(Path, sys.argv[3:]):
    earlier = "resume" if place.exists() else "refuse"
    run_fit(prepare(FitRequest(data, sys.argv[2])), place, earlier)
"""


def test_killed_at_any_moment_and_resumed_it_ends_with_the_same_bits(folder, tiny_recipe, tmp_path):
    tiny_recipe.write_text(tiny_recipe.read_text().replace("epochs = 2", "epochs = 60"))
    out = [str(tmp_path / name) for name in ("whole", "killed")]

    def start(*places: str) -> subprocess.Popen:
        command = [sys.executable, "-c", PROGRAM, str(folder), str(tiny_recipe), *places]
        return subprocess.Popen(command, env={**os.environ, "JAX_PLATFORMS": "cpu"})

    log = Path(out[1]) / "seed-0" / "log.jsonl"
    process = start(out[1])
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and (not log.is_file() or len(log.read_text()) < 900):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait(30) == -signal.SIGKILL
    assert not (Path(out[1]) / MODEL).exists()
    assert start(*out).wait(120) == 0
    assert arrays(Path(out[0]) / MODEL) == arrays(Path(out[1]) / MODEL)
    assert log.read_text() == (Path(out[0]) / "seed-0" / "log.jsonl").read_text()


@pytest.mark.parametrize(
    "bad",
    [
        "{",
        "5",
        '{"stage": "a"}',
        '{"stage": 1, "iteration": 1, "cost": 1.0, "damping": 0.0, "initial": ""}',
        '{"stage": "a", "initial": "", "iterations": 1, "cost": 1.0, "why": "limit", '
        '"parameters": {"mass": "heavy"}}',
    ],
)
def test_the_log_of_an_identification_is_read_up_to_its_damage(tmp_path, bad):
    log = SearchLog(tmp_path)
    log.write_iteration(Iteration("equation-error estimate", 1, float("nan"), 0.0))
    log.write_stage(StageResult("equation-error estimate", "", 1, 0.5, "converged", {"mass": 2.0}))
    log.close()
    assert read_log(tmp_path) == []
    whole = read_search_log(tmp_path)
    assert [line.get("cost") for line in whole] == [None, 0.5]
    assert whole[1]["parameters"] == {"mass": 2.0}
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write(bad + "\n")
    assert read_search_log(tmp_path) == whole
    assert read_search_log(tmp_path / "nowhere") == []
