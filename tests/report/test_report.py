"""Tables, figures and progress."""

import io
import math

import numpy as np
import pytest
from rich.console import Console

import tustinnet as tn
from tustinnet.evaluation.free_run import Score
from tustinnet.report.figures import (
    ahead_figure,
    free_run_figure,
    inspection_figure,
    training_figure,
    write_figure,
)
from tustinnet.report.progress import TrainingProgress
from tustinnet.report.tables import Table, number
from tustinnet.training.plan import Member, plan
from tustinnet.training.state import EpochReport


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1664, "0.166"),
        (12.0, "12.000"),
        (0.0012345, "0.00123"),
        (0.0, "0.000"),
        (None, "–"),
        (math.nan, "–"),
        (math.inf, "diverged"),
    ],
)
def test_numbers_keep_three_digits_that_mean_something(value, text):
    assert number(value) == text


def test_units_in_brackets_are_printed_as_they_are():
    out = io.StringIO()
    Table(["record", "period [ms]"], [["a_1", "[4]"]], title="x [rad]").print(
        Console(file=out, width=80)
    )
    for text in ("period [ms]", "[4]", "x [rad]"):
        assert text in out.getvalue()


def test_figures_are_written_whole_or_not_at_all(pendulum, run_folder, tmp_path):
    model = tn.load_model(run_folder / "model.safetensors")
    e = pendulum[0]
    run = np.column_stack([e.q, e.velocities()])
    run[200:] = np.inf  # a free run that diverged must not spoil the picture
    score = Score(e.name, "file", math.inf, math.inf, (1.0,), (1.0,), (0.0,), run)
    lines = [
        {"stage": "a", "loss": 1.0, "best": 1.0, "validation": None, "rate": 1e-3},
        {"stage": "b", "loss": None, "best": None, "validation": None, "rate": 1e-3},
    ]
    pictures = {
        "run.png": free_run_figure(e, {"model": score}),
        "training.svg": training_figure({"seed-0": lines, "seed-1": lines}),
        "ahead.pdf": ahead_figure({"model": np.array([0.1, 0.2])}, model),
        "records.png": inspection_figure(
            list(pendulum), [tn.inspect_experiment(x) for x in pendulum]
        ),
    }
    for name, figure in pictures.items():
        write_figure(figure, tmp_path / "deep" / name)
    assert {p.name for p in (tmp_path / "deep").iterdir()} == set(pictures)
    with pytest.raises(tn.InputError, match=r"xyz.*expected .*png"):
        write_figure(pictures["run.png"], tmp_path / "picture.xyz")
    assert not (tmp_path / "picture.xyz").exists()


def test_progress_shows_loss_validation_rate_and_time_left(pendulum, small_recipe):
    prepared = plan(pendulum, small_recipe)
    for terminal in (True, False):
        out = io.StringIO()
        console = Console(file=out, force_terminal=terminal, width=160)
        with TrainingProgress(console) as progress:
            told = progress.follow(prepared)
            told(EpochReport("first", 1, 0.5, 0.25, 1e-3, 0.25))
            told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2, "back to the last good state"))
        text = out.getvalue()
        for word in ("9/9", "loss 0.4", "rmse 0.200", "rate 5.0e-04", "back to the last good"):
            assert word in text, text
        assert ("\x1b[" in text) is terminal
        assert terminal or "s left" in text


def test_progress_of_trainings_that_run_together_tells_the_slowest_and_the_best(
    pendulum, small_recipe
):
    out = io.StringIO()
    with TrainingProgress(Console(file=out, width=160)) as progress:
        told = progress.follow(plan(pendulum, small_recipe, [Member(3), Member(4, 0.5)]))
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.15))
        assert out.getvalue() == ""
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2, "something happened", 1))
    assert "small, seed 3 and 1 more: 100 %" in out.getvalue()
    assert "best 0.150" in out.getvalue()
    assert "small, seed 4 rate 0.5: something happened" in out.getvalue()


def test_quiet_progress_tells_events_only(pendulum, small_recipe):
    out = io.StringIO()
    with TrainingProgress(Console(file=out), quiet=True) as progress:
        told = progress.follow(plan(pendulum, small_recipe))
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2))
        assert out.getvalue() == ""
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2, "something happened"))
    assert "something happened" in out.getvalue()
