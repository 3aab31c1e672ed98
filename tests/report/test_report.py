"""Tables, figures and progress."""

import io
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from swinging import SWING, data_set, records

import tustinnet as tn
from tustinnet.evaluate.scores import Score
from tustinnet.fitting.gradient.plan import TrainingPlan, make_plan
from tustinnet.fitting.listener import EpochReport, Listener, SearchProgress
from tustinnet.fitting.task import Member, Task, make_task
from tustinnet.report.drawing import write_figure
from tustinnet.report.figures import (
    ahead_figure,
    free_run_figure,
    inspection_figure,
    training_figure,
)
from tustinnet.report.progress import FitProgress, duration
from tustinnet.report.tables import Table, number, numbers


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.1664, "0.166"),
        (12.0, "12.000"),
        (-7.5416e23, "-7.54e+23"),
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


def test_a_table_that_is_too_wide_is_printed_in_parts():
    rows = [["one", "q", "1", "x"], ["one", "u", "2", ""]]
    table = Table(["record", "channel", "a long heading", "b"], rows, "t")
    printed = {}
    for width in (34, 80, None):
        table.print(Console(file=(out := io.StringIO()), width=12), width)
        lines = [line.split() for line in out.getvalue().splitlines()]
        printed[width] = [line for line in lines if line and "─" not in line[0]]
    whole = [
        ["t"],
        ["record", "channel", "a", "long", "heading", "b"],
        *map(str.split, ["one q 1 x", "one u 2"]),
    ]
    assert printed[80] == printed[None] == whole
    # without the row that has nothing in the second part
    assert printed[34] == [
        ["t"],
        ["record", "channel", "a", "long", "heading"],
        ["one", "q", "1"],
        ["one", "u", "2"],
        ["record", "channel", "b"],
        ["one", "q", "x"],
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["ahead.svg", "ahead.pdf", "ahead.png"])
def test_the_bytes_of_a_figure_say_nothing_of_when_it_was_written(name, pendulum, tmp_path):
    folders = [tmp_path / "first", tmp_path / "second"]
    for folder in folders:
        write_figure(ahead_figure({"m": np.array([[0.1], [0.2]])}, pendulum.channels), folder, name)
    first, second = ((folder / name).read_bytes() for folder in folders)
    assert first == second
    assert b"CreationDate" not in first


def test_figures_are_written_whole_or_not_at_all(pendulum, tmp_path):
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
        "ahead.pdf": ahead_figure({"model": np.array([[0.1], [0.2]])}, pendulum.channels),
        "records.png": inspection_figure(
            list(pendulum), [tn.inspect_experiment(x) for x in pendulum]
        ),
    }
    for name, figure in pictures.items():
        write_figure(figure, tmp_path / "deep", name)
    assert {p.name for p in (tmp_path / "deep").iterdir()} == set(pictures)
    with pytest.raises(tn.InputError, match=r"xyz.*expected .*png"):
        write_figure(pictures["run.png"], tmp_path, "picture.xyz")
    assert not (tmp_path / "picture.xyz").exists()


def test_a_long_free_run_is_drawn_by_its_extremes_with_its_error_below(tmp_path):
    n = 40_000
    t = np.arange(n) * 0.01
    q = np.sin(3 * t) + 1e-3 * np.sin(1.7e3 * t)
    q[12_345] = 2.0  # a single sample stays in the picture
    e = tn.from_arrays(q, dt=0.01, coordinates={"angle": "angular"}, name="long")
    run = np.column_stack([e.q[:, 0] + 0.05 * np.sin(t / 20), np.cos(t)])
    run[30_000:] = np.inf
    score = Score("long", "file", 0.1, 0.1, (0.1,), (1.0,), (0.0,), run)
    figure = free_run_figure(e, {"model": score})
    positions, errors = figure.axes
    measured, simulated = positions.lines
    for line in (measured, simulated, *errors.lines):
        assert 1000 < len(np.asarray(line.get_xdata())) < 2500
    assert np.max(measured.get_ydata()) == 2.0
    assert np.isnan(np.asarray(simulated.get_ydata())[-1])
    assert errors.get_ylabel() == "error [rad]"
    assert np.nanmax(errors.lines[0].get_ydata()) == pytest.approx(0.05, rel=1e-3)
    short = free_run_figure(e[:300], {"model": replace(score, simulated=run[:300])})
    assert [len(axes.lines) for axes in short.axes] == [2]
    write_figure(figure, tmp_path, "long.png")


def begun(progress: FitProgress, prepared: TrainingPlan | Task, label: str = "") -> Listener:
    """The listener of fits that have begun."""
    listener = progress.listener(label)
    listener.on_begin(prepared)
    return listener


def test_progress_shows_loss_validation_rate_and_time_left(pendulum, small_recipe):
    prepared = make_plan(make_task(pendulum, small_recipe))
    for terminal in (True, False):
        out = io.StringIO()
        console = Console(file=out, force_terminal=terminal, width=160)
        with FitProgress(console) as progress:
            told = begun(progress, prepared).on_epoch
            told(EpochReport("first", 1, 0.5, 0.25, 1e-3, 0.25))
            told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2, "back to the last good state"))
        text = out.getvalue()
        for word in ("9/9", "loss 0.4", "rmse 0.200", "rate 5.0e-04", "back to the last good"):
            assert word in text, text
        assert ("\x1b[" in text) is terminal
        assert "left" not in text  # all is done
        assert ("compiling, 0 s" in text) is terminal


def test_time_left_is_told_from_the_first_epoch_with_what_later_stages_need_to_compile(
    pendulum, small_recipe
):
    prepared = make_plan(make_task(pendulum, small_recipe))
    first, second = prepared.stages
    works = [s.windows.rows.shape[1] * s.windows.length for s in prepared.stages]
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=160)
    with FitProgress(console) as progress:
        told = begun(progress, prepared).on_epoch
        told(EpochReport("first", 1, 0.5, 0.2, 1e-3, 0.2, seconds=2.0, compiling=7.0))
    rest = 2.0 * (first.recipe.epochs - 1 + second.recipe.epochs * works[1] / works[0])
    assert f", {rest + 7:.0f} s left" in out.getvalue()


def test_durations_are_told_in_units_of_their_size():
    assert [duration(s) for s in (7.4, 99, 150, 9000)] == ["7 s", "99 s", "2 min", "2.5 h"]


@pytest.mark.thorough
def test_a_training_tells_how_long_epochs_take_apart_from_compiling(pendulum, tiny_recipe):
    reports = []
    # as wide as nothing else here: nothing is compiled yet
    recipe = tn.read_recipe(tiny_recipe, ["model.hidden=[9]"])
    begun = time.perf_counter()
    tn.fit(pendulum, recipe, listener=Listener(on_epoch=reports.append))
    spent = time.perf_counter() - begun
    assert all(r.seconds > 0 for r in reports)
    compiled = sum(r.compiling for r in reports if r.epoch == 1)
    assert 0 < compiled < compiled + sum(r.seconds for r in reports) < spent


def test_progress_shows_three_digits_of_small_motion(pendulum, small_recipe):
    small = tn.DataSet("small", tuple(replace(e, q=1e-4 * e.q, v=None) for e in pendulum))
    out = io.StringIO()
    with FitProgress(Console(file=out, width=160)) as progress:
        told = begun(progress, make_plan(make_task(small, small_recipe))).on_epoch
        told(EpochReport("second", 4, 0.4, 1.234e-6, 5e-4, 1.2e-6))
    assert "rmse 0.0000012" in out.getvalue()


def test_a_column_shows_three_digits_of_its_largest_number():
    assert numbers([2.5e-4, 1.2e-6, math.inf, None]) == ["0.000250", "0.000001", "diverged", "–"]
    assert numbers([0.25, 12.0]) == ["0.250", "12.000"]
    assert numbers([0.0, 0.0]) == ["0.000", "0.000"]


def test_progress_of_trainings_that_run_together_tells_the_slowest_and_the_best(
    pendulum, small_recipe
):
    out = io.StringIO()
    with FitProgress(Console(file=out, width=160)) as progress:
        members = [Member(3), Member(4, 0.5)]
        told = begun(progress, make_plan(make_task(pendulum, small_recipe, members))).on_epoch
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.15))
        assert out.getvalue() == ""
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2, "something happened", 1))
    assert "small, seed 3 and 1 more: 100 %" in out.getvalue()
    assert "best 0.150" in out.getvalue()
    assert "small, seed 4 rate 0.5: something happened" in out.getvalue()


@pytest.mark.parametrize("terminal", [True, False])
def test_progress_of_an_identification_shows_its_stages(terminal, monkeypatch):
    out, now = io.StringIO(), [0.0]
    monkeypatch.setattr("tustinnet.report.progress.time.monotonic", lambda: now[0])
    task = make_task(data_set(records()), "grey", system=SWING)
    with FitProgress(Console(file=out, force_terminal=terminal, width=160)) as progress:
        report = begun(progress, task, "swing").on_progress
        report(SearchProgress("equation-error estimate", 0, 0, 1, 0.5))
        for iteration, cost in enumerate((0.25, 0.2, 0.15, 0.125)):
            now[0] += 2.0
            report(SearchProgress("whole records", 2, 3, iteration, cost))
    text = out.getvalue()
    assert ("\x1b[" in text) is terminal
    if terminal:
        assert "swing" in text
        assert "stage 2 of 3, whole records, iteration 3, cost 0.125" in text
    else:  # a line a stage, and every few seconds
        assert text.splitlines() == [
            "swing: equation-error estimate, iteration 1, cost 0.5, 0 s",
            "swing: stage 2 of 3, whole records, iteration 0, cost 0.25, 2 s",
            "swing: stage 2 of 3, whole records, iteration 3, cost 0.125, 8 s",
        ]


def test_quiet_progress_of_an_identification_says_nothing():
    out = io.StringIO()
    with FitProgress(Console(file=out), quiet=True) as progress:
        task = make_task(data_set(records()), "grey", system=SWING)
        begun(progress, task).on_progress(SearchProgress("equation-error estimate", 0, 0, 1, 0.5))
    assert out.getvalue() == ""


def test_a_message_that_several_fits_have_is_printed_once():
    out = io.StringIO()
    with FitProgress(Console(file=out)) as progress:
        for fold in range(3):
            progress.listener(f"grey-box, fold {fold}").on_message("left out: short")
        progress.listener().on_message("left out: another")
    assert out.getvalue().splitlines() == ["left out: short", "left out: another"]


def test_quiet_progress_tells_events_only(pendulum, small_recipe):
    out = io.StringIO()
    with FitProgress(Console(file=out), quiet=True) as progress:
        told = begun(progress, make_plan(make_task(pendulum, small_recipe))).on_epoch
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2))
        assert out.getvalue() == ""
        told(EpochReport("second", 4, 0.4, 0.2, 5e-4, 0.2, "something happened"))
    assert "something happened" in out.getvalue()
