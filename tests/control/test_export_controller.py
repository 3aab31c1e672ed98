"""A controller that was exported is the controller: in C, as gains, as a problem for solvers."""

import json
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import groupby

import numpy as np
import pytest
from every_family import example
from linear_machines import double_integrator

import tustinnet as tn
from tustinnet.control.closed_loop import closed_loop
from tustinnet.control.controllers import LinearFeedback, TrackingFeedback
from tustinnet.control.cost import Cost
from tustinnet.control.dynamics import controlled, input_limits
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.export.check import BOUND, check_loop
from tustinnet.control.export.code import make_code
from tustinnet.control.export.compiled import compile_loop
from tustinnet.control.export.gains import JSON, MAT
from tustinnet.control.export.write import export_controller
from tustinnet.control.ilqr import make_cost
from tustinnet.control.input_history import find_causal_layout
from tustinnet.control.lqr import Feedback, Tracking
from tustinnet.control.mpc import Mpc
from tustinnet.control.plants import ModelPlant
from tustinnet.export.source import make_source
from tustinnet.simulate.filtering import FilterNoise

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

COUNT = 2 * np.pi / 2048
STRICT = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Werror",
]
SOURCES = ["main.c", "controller.c", "estimator.c", "model.c"]
DEVIATIONS = {"theta": 1.0, "alpha": 0.3, "der_theta": 10.0, "der_alpha": 10.0, "voltage": 5.0}
COST = {"deviations": DEVIATIONS, "within": {"theta": (-0.5, 0.4)}}
START, UPRIGHT = np.array([0.3, 0.1, 0.0, 0.0]), np.zeros(4)


@cache
def pendulum(resolution: float | None = COUNT) -> tn.Model:
    """The rotary pendulum, its voltage limited."""
    model = example("qube")
    channels = model.channels
    coordinates = tuple(replace(c, resolution=resolution) for c in channels.coordinates)
    inputs = tuple(replace(i, limits=(-10.0, 10.0)) for i in channels.inputs)
    return replace(model, channels=replace(channels, coordinates=coordinates, inputs=inputs))


def noise(model: tn.Model) -> FilterNoise:
    """Some noise, larger for velocities than for positions."""
    size = np.full(model.state_size, 1e-4)
    size[model.channels.velocity] = 0.03
    return FilterNoise(100 * size, size, np.full(model.channels.n_q, COUNT / 3.5))


@cache
def balance(delay: int = 0, integral: tuple[str, ...] = ()) -> Feedback:
    return tn.control.lqr(
        pendulum(), UPRIGHT, np.zeros(1), deviations=DEVIATIONS, delay=delay, integral=integral
    )


@cache
def motion() -> Tracking:
    """The arm turns back while the pendulum is up; the first guess is what the balance does."""
    step, x, guess = tn.compiled_step(pendulum()), START, []
    for _ in range(60):
        guess.append(np.clip(-balance().gain @ x, -10, 10))
        x = step(x, guess[-1])
    plan = tn.control.ilqr(
        pendulum(), START, UPRIGHT, 60, guesses=[np.array(guess)], turns=False, **COST
    )
    return tn.control.time_varying_lqr(pendulum(), plan, balance(), deviations=DEVIATIONS)


@cache
def late_motion() -> Tracking:
    """The motion where commands act a sample late."""
    plan = replace(motion().plan, delay=1, before=np.array([2.0]))
    return tn.control.time_varying_lqr(pendulum(), plan, balance(1), deviations=DEVIATIONS)


@cache
def swing_up() -> Tracking:
    """A motion from hanging that begins again after a fall, integrals at its end, commands late."""
    model, hanging = pendulum(), np.array([0.0, np.pi, 0.0, 0.0])
    plan = tn.control.ilqr(
        model,
        hanging,
        UPRIGHT,
        200,
        deviations=DEVIATIONS,
        limits={"voltage": (-8.0, 8.0)},
        delay=1,
    )
    settle = tn.control.lqr(model, hanging, np.zeros(1), deviations=DEVIATIONS, delay=1)
    tracking = tn.control.time_varying_lqr(
        model, plan, balance(1), deviations=DEVIATIONS, settle=settle
    )
    return replace(tracking, final=balance(1, ("theta",)))


def cost() -> Cost:
    """What the motion's plan minimises."""
    cost, _ = make_cost(
        controlled(pendulum()), input_limits(pendulum()), UPRIGHT, np.zeros(1), range=None, **COST
    )
    return cost


def some_feedback(model: tn.Model, integral: tuple[int, ...] = ()) -> Feedback:
    """Feedback with small gains, of no use but finite."""
    n_x, n_u = model.state_size, model.channels.n_u
    n_z = n_x + len(integral) + n_u * controlled(model).previous
    gain = 0.1 * np.random.default_rng(0).normal(size=(n_u, n_z))
    return Feedback(
        gain=gain,
        x0=np.linspace(-0.1, 0.1, n_x),
        u0=np.full(n_u, 0.05),
        lower=np.full(n_u, -0.2),
        upper=np.full(n_u, 0.15),
        dt=model.dt,
        speeds=np.full(model.channels.n_q, 0.3),
        integral=integral,
        periodic=(0,),
        safe=np.full(n_u, 0.1),
    )


def predictive(gains: Feedback | Tracking, model: tn.Model | None = None, **options) -> Mpc:
    """Predictive control of the pendulum, or of another model, some steps ahead."""
    return Mpc(model or pendulum(), gains, **{"steps": 15, "deviations": DEVIATIONS} | options)


CASES = {
    "balance": lambda: (pendulum(), balance()),
    "integral": lambda: (pendulum(), balance(integral=("theta",))),
    "late": lambda: (pendulum(), balance(2, ("theta",))),
    "motion": lambda: (pendulum(), motion()),
    "late motion": lambda: (pendulum(), late_motion()),
    "swing-up": lambda: (pendulum(), swing_up()),
    "input before": lambda: (example("hybrid"), some_feedback(example("hybrid"), (0,))),
    "straight inputs": lambda: (example("first-order"), some_feedback(example("first-order"))),
    "actuator lag": lambda: (example("actuator lag"), some_feedback(example("actuator lag"))),
    "cart": lambda: (example("cart"), some_feedback(example("cart"), (1, 0))),
    "network": lambda: (example("network memory"), some_feedback(example("network memory"))),
    "predictive": lambda: (pendulum(), predictive(balance(), iterations=3, within=COST["within"])),
    "predictive late": lambda: (pendulum(), predictive(balance(2))),
    "predictive late motion": lambda: (pendulum(), predictive(late_motion())),
    "predictive swing-up": lambda: (pendulum(), predictive(replace(swing_up(), final=balance(1)))),
    "predictive cart": lambda: (
        example("cart"),
        predictive(some_feedback(example("cart")), example("cart"), deviations={}, steps=5),
    ),
}


# each kind of code once; the others differ in what is combined
USUAL = ("balance", "integral", "motion", "swing-up", "actuator lag", "network", "predictive")
MARKED = [pytest.param(name, marks=() if name in USUAL else pytest.mark.thorough) for name in CASES]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Folders with the exports of the cases, by name, and what was checked."""

    @cache
    def write(name: str):
        model, controller = CASES[name]()
        folder = tmp_path_factory.mktemp("controller")
        return folder, export_controller(model, controller, noise(model), folder)

    return write


@pytest.mark.thorough
@needs_gcc
@pytest.mark.parametrize("name", MARKED)
def test_its_loop_in_c_is_that_of_python(name, exported):
    folder, result = exported(name)
    assert result.checked.steps >= 300
    assert result.checked.difference is not None
    assert result.checked.difference < BOUND
    assert sorted(result.files) == sorted(p.name for p in folder.iterdir())
    card = json.loads((folder / "card.json").read_text())
    assert (card["target"], card["check"]["steps"]) == ("controller", result.checked.steps)


@needs_gcc
@pytest.mark.parametrize("precision", ["-DMODEL_DOUBLE", "-DMODEL_FLOAT"])
@pytest.mark.parametrize("name", MARKED)
def test_compilers_have_nothing_to_say_of_it(name, precision, exported):
    folder, _ = exported(name)
    done = subprocess.run(
        ["gcc", *STRICT, "-fsyntax-only", precision, *SOURCES],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


def run_main(folder, *flags: str) -> np.ndarray:
    """What the program of an exported folder prints, a row a sample."""
    build = ["gcc", *STRICT, "-O1", *flags, *SOURCES, "-lm", "-o", "main"]
    subprocess.run(build, cwd=folder, check=True)
    text = subprocess.run(
        ["./main"], cwd=folder, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    names = "theta,alpha,der_theta,der_alpha"
    estimated = ",".join(f"estimated_{name}" for name in names.split(","))
    assert text[0] == f"time,{names},{estimated},voltage"
    return np.array([line.split(",") for line in text[1:]], float)


@pytest.mark.thorough
@needs_gcc
def test_the_program_runs_the_loop_of_python(tmp_path):
    model, controller = pendulum(resolution=None), motion()
    export_controller(model, controller, noise(model), tmp_path, start=START)
    rows = run_main(tmp_path)
    expected = closed_loop(
        ModelPlant(model),
        TrackingFeedback(controller),
        ExtendedKalmanFilter(model, noise(model)),
        len(rows),
        START[:2],
    )
    assert len(rows) * model.dt > 3
    np.testing.assert_allclose(rows[:, 0], model.dt * np.arange(len(rows)))
    columns = [expected.states[:-1], expected.estimates[:-1], expected.inputs]
    np.testing.assert_allclose(rows[:, 1:], np.hstack(columns), rtol=0, atol=1e-9)
    assert np.abs(rows[-100:, 2]).max() < 0.01


@pytest.mark.thorough
@needs_gcc
def test_in_c_it_begins_again_after_a_fall_as_in_python():
    model, tracking = pendulum(), swing_up()
    source = make_source(model)
    source = replace(source, layout=find_causal_layout(source.model, 1))
    phases: list[str] = []

    class Recorded(TrackingFeedback):
        def inputs(self, k: int, x: np.ndarray) -> np.ndarray:
            command = super().inputs(k, x)
            phases.append(self.phase)
            return command

    start = tracking.plan.x[0]
    files = make_code(tracking, source, noise(model), start, 400)
    fall = start + np.array([0.5, 1.0, 0.0, 0.0])
    check = check_loop(files, Recorded(tracking), source, noise(model), start, 400, fall)
    assert check.steps == 800
    assert check.difference is not None
    assert check.difference < BOUND
    assert [phase for phase, _ in groupby(phases)] == ["plan", "hold", "settle", "plan", "hold"]
    assert phases.index("hold") == 200


@needs_gcc
def test_a_strict_controller_whose_memory_is_unstable_by_itself_is_compared():
    model = double_integrator(limit=100.0)
    strict = tn.control.lqr(model, UPRIGHT[:2], np.zeros(1), deviations={"s": 1e-2}, delay=1)
    assert strict.gain[0, -1] > 1.5  # by which a difference of the last command grows
    source = make_source(model)
    source = replace(source, layout=find_causal_layout(source.model, 1))
    files = make_code(strict, source, noise(model), np.array([0.1, 0.0]), 200)
    controller = LinearFeedback(strict)
    check = check_loop(files, controller, source, noise(model), np.array([0.1, 0.0]), 200)
    assert check.difference is not None
    assert check.difference < BOUND


@needs_gcc
@pytest.mark.parametrize("name", ["integral", "late", "motion", "late motion"])
def test_it_holds_the_pendulum_in_single_precision_through_encoders(name, exported):
    rows = run_main(exported(name)[0], "-DMODEL_FLOAT")
    assert np.abs(rows[-100:, 2]).max() < 0.02
    assert np.abs(rows[:, -1]).max() <= 10


GLITCHES = """
#include <assert.h>
#include <math.h>
#include <stdio.h>
#include "controller.h"
#include "estimator.h"
enum { GLITCHES = 10000, SAMPLES = 200000, AFTER = 3000, HELD = 200 };
static unsigned long long seed = 1;
static double uniform(void)
{
    seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(seed >> 33) / 2147483648.0;
}
static double wrong(double q)
{
    const double kinds[] = {NAN, INFINITY, -INFINITY, 1e300, -1e30, 1e9, q + 3, q - 3, 0, 1e-310};
    const double u = uniform();
    return u < 0.7 ? kinds[(int)(uniform() * 10)] : q + 12 * (u - 0.85);
}
int main(void)
{
    static model_state device;
    static model_real acting[MODEL_INPUTS];
    model_real y[MODEL_POSITIONS], u[CONTROLLER_INPUTS], kept[MODEL_POSITIONS] = {0};
    const model_real begin[] = {0, (model_real)3.14, 0, 0};
    estimator e;
    controller c;
    int wrongs = 0, burst = 0, stuck = 0, lost = 0, end = SAMPLES;
    model_init(&device, begin);
    for (int k = 0; k < end + AFTER; k++) {
        for (int i = 0; i < MODEL_POSITIONS; i++)
            y[i] = (model_real)(COUNT * floor((double)device.x[i] / COUNT + 0.5));
        const int is_over = wrongs >= GLITCHES;
        if (is_over && end == SAMPLES)
            end = k;
        if (!is_over && burst == 0 && uniform() < 0.003) {
            burst = 1 + (int)(60 * uniform());
            stuck = uniform() < 0.5;
            for (int i = 0; i < MODEL_POSITIONS; i++)
                kept[i] = y[i];
        }
        for (int i = 0; i < MODEL_POSITIONS && !is_over; i++)
            if (burst > 0 || uniform() < 0.02 || k == 0) {
                y[i] = stuck && burst > 0 ? kept[i] : (model_real)wrong((double)y[i]);
                wrongs++;
            }
        burst -= burst > 0;
        if (k == 0) {
            estimator_reset(&e, y);
            controller_reset(&c);
        } else
            estimator_update(&e, y, u);
        controller_inputs(&c, e.x, u);
        for (int i = 0; i < MODEL_STATES; i++)
            assert(isfinite(e.filter.state.x[i]) && isnan(e.x[i]) == (e.filter.missed < 0));
        for (int i = 0; i < MODEL_STATES * MODEL_STATES; i++)
            assert(isfinite(e.filter.covariance[i]));
        for (int i = 0; i < CONTROLLER_INPUTS; i++)
            assert(u[i] >= -10 && u[i] <= 10);
        for (int i = 0; i < CONTROLLER_INTEGRALS; i++)
            assert(isfinite(c.integral[i]));
        if (e.filter.missed < 0) {
            lost++;
            assert(u[0] == (model_real)0.5);
        }
        estimator_remember(acting, u);
        model_step(&device, acting);
        if (fabs((double)device.x[2]) > 40 || fabs((double)device.x[3]) > 40)
            device.x[2] = device.x[3] = 0; /* a hand stops it; a step is not exact at such speeds */
        if (k >= end + AFTER - HELD)
            assert(fabs(remainder((double)device.x[1], 6.283185307179586)) < 0.05);
    }
    printf("%d %d %u %d\\n", end, wrongs, e.filter.unused, lost);
    return 0;
}
"""


@pytest.mark.thorough
@needs_gcc
@pytest.mark.parametrize("precision", ["-DMODEL_DOUBLE", "-DMODEL_FLOAT"])
def test_ten_thousand_wrong_readings_leave_it_finite_and_in_command(precision, tmp_path):
    tracking = swing_up()
    tracking = replace(tracking, final=replace(tracking.final, safe=np.array([0.5])))
    export_controller(pendulum(), tracking, noise(pendulum()), tmp_path)
    (tmp_path / "glitches.c").write_text(GLITCHES)
    build = [
        "gcc",
        "-std=c99",
        "-O1",
        "-g",
        precision,
        f"-DCOUNT={COUNT}",
        "glitches.c",
        *SOURCES[1:],
        "-lm",
        "-o",
        "glitches",
    ]
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    if subprocess.run(
        [*build, *sanitize], cwd=tmp_path, capture_output=True, check=False
    ).returncode:
        subprocess.run(build, cwd=tmp_path, check=True)  # a compiler without sanitizers
    done = subprocess.run(["./glitches"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    samples, wrong, unused, lost = (int(word) for word in done.stdout.split())
    assert wrong >= 10_000
    assert 0.3 * wrong < unused < samples / 2
    assert 0 < lost < samples / 2


@needs_gcc
def test_make_builds_what_the_readme_says(exported):
    folder, _ = exported("motion")
    assert shutil.which("make"), "make is part of every compiler's set-up"
    told = subprocess.run(["make"], cwd=folder, capture_output=True, text=True, check=True)
    assert "warning" not in told.stderr
    assert (folder / "main").is_file()
    readme = (folder / "README.md").read_text()
    assert "a plan of 60 periods" in readme
    assert "| `u[0]` | voltage | V | -10 | 10 | 0 | 0 |" in readme
    subprocess.run(["make", "clean"], cwd=folder, capture_output=True, check=True)


@needs_gcc
def test_nothing_that_changes_is_kept_outside_of_its_structures(exported):
    folder, _ = exported("late motion")
    sources = ["controller.c", "estimator.c", "model.c"]
    subprocess.run(["gcc", "-std=c99", "-c", "-O2", *sources], cwd=folder, check=True)
    for source in sources:
        told = subprocess.run(
            ["nm", source.replace(".c", ".o")],
            cwd=folder,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        lines = [line.split() for line in told.splitlines()]
        assert {words[-2] for words in lines} <= {"T", "t", "r", "U"}
        assert not {"malloc", "calloc", "free"} & {words[-1] for words in lines}


@pytest.mark.thorough
@pytest.mark.parametrize("file", ["", JSON, MAT])
@pytest.mark.parametrize("name", ["late", "motion", "late motion", "swing-up", "cart"])
def test_what_is_read_is_what_was_written(name, file, exported):
    folder, _ = exported(name)
    _, controller = CASES[name]()
    read = tn.control.read_controller(folder / file)
    assert type(read) is type(controller)
    final, expected = read, controller
    if isinstance(read, Tracking):
        final, expected = read.final, controller.final
        np.testing.assert_array_equal(read.gains, controller.gains)
        plan, planned = vars(read.plan), vars(controller.plan)
        assert plan.keys() == planned.keys()
        for key, value in planned.items():
            np.testing.assert_array_equal(plan[key], value)
            assert np.shape(plan[key]) == np.shape(value)
        assert (read.recovery is None) == (controller.recovery is None)
    pairs = [(final, expected)]
    if isinstance(read, Tracking) and read.recovery is not None:
        way_back, written = vars(read.recovery), vars(controller.recovery)
        pairs.append((way_back.pop("feedback"), written["feedback"]))
        for key, value in way_back.items():
            np.testing.assert_array_equal(value, written[key])
    for found, wanted in pairs:
        for key, value in vars(wanted).items():
            np.testing.assert_array_equal(getattr(found, key), value)
            assert np.shape(getattr(found, key)) == np.shape(value)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"form": "something"}, "no exported controller"),
        ({"feedback": 3}, "without its feedback"),
        ({"period": None}, "entry 'period' is not finite"),
        ({"gains": [1.0]}, r"entry 'gains' of shape \(1,\); expected 60 x 1 x 4"),
        ({"plan": {"u": [[0.0]]}}, "no entry 'plan.x'"),
        ({"recovery": {"settled_within": []}}, "a recovery without its feedback"),
    ],
)
def test_other_files_are_no_controllers(change, told, exported, tmp_path):
    folder, _ = exported("motion")
    content = json.loads((folder / JSON).read_text()) | change
    (tmp_path / JSON).write_text(json.dumps(content))
    with pytest.raises(tn.InputError, match=told):
        tn.control.read_controller(tmp_path)


def test_files_that_cannot_be_read_are_told(tmp_path):
    with pytest.raises(tn.InputError, match=r"ending '\.c'"):
        tn.control.read_controller(tmp_path / "controller.c")
    (tmp_path / MAT).write_bytes(b"nothing of MATLAB")
    with pytest.raises(tn.InputError, match="cannot be read"):
        tn.control.read_controller(tmp_path / MAT)


# --- scripts of solvers ---


@pytest.fixture(scope="module")
def scripts(tmp_path_factory):
    """A folder with the scripts of the motion."""
    folder = tmp_path_factory.mktemp("scripts")
    result = export_controller(pendulum(), motion(), noise(pendulum()), folder, **COST)
    assert {"step.casadi", "problem.py", "acados_problem.py", "do_mpc_controller.py"} <= set(
        result.files
    )
    return folder


@pytest.fixture
def problem(scripts, monkeypatch):
    """The module `problem` of the folder, as its neighbours import it."""
    monkeypatch.syspath_prepend(str(scripts))
    monkeypatch.delitem(sys.modules, "problem", raising=False)
    import problem  # pyright: ignore[reportMissingImports]

    yield problem
    del sys.modules["problem"]


@pytest.mark.thorough
def test_ipopt_ends_near_the_plan(problem):
    plan = motion().plan
    states, inputs = problem.first_guess()
    np.testing.assert_array_equal(states, plan.x)
    planned = cost().total(plan.x[None], plan.u[None])[0]
    assert float(problem.cost(states.T, inputs.T)) == pytest.approx(planned, rel=1e-9)
    far = np.linspace([-2.0, 1.0, -1.0, 2.0], [1.5, -1.0, 4.0, -3.0], len(states))
    expected = cost().total(far[None], inputs[None])[0]
    assert float(problem.cost(far.T, inputs.T)) == pytest.approx(expected, rel=1e-12)
    states, inputs, stats = problem.solve()
    assert stats["success"]
    assert 0.98 * planned < float(problem.cost(states.T, inputs.T)) < planned * (1 + 1e-9)
    np.testing.assert_allclose(states[:, :2], plan.x[:, :2], atol=0.02)


@pytest.mark.thorough
def test_the_problem_of_a_feedback_begins_with_a_line(tmp_path):
    export_controller(pendulum(), balance(), noise(pendulum()), tmp_path, start=START, **COST)
    found = runpy.run_path(str(tmp_path / "problem.py"))
    states, inputs = found["first_guess"]()
    np.testing.assert_array_equal(states[[0, -1]], [START, UPRIGHT])
    assert inputs.shape == (found["STEPS"], 1)


def test_the_problem_of_late_commands_has_earlier_ones_in_its_state(exported):
    folder, result = exported("swing-up")
    found = runpy.run_path(str(folder / "problem.py"))
    plan = swing_up().plan
    assert found["STATES"][-1] == "voltage_before_1"
    states, inputs = found["first_guess"]()
    np.testing.assert_array_equal(states[:, :4], plan.x)
    np.testing.assert_array_equal(states[:-1, 4:], plan.previous_inputs(1))
    np.testing.assert_array_equal(found["START"], states[0])
    # the plan is a motion of the script's step, which is that of the C code
    following = found["STEP"].map(len(inputs))(states[:-1].T, inputs.T).full().T
    np.testing.assert_allclose(following, states[1:], rtol=0, atol=1e-9)
    assert float(found["final_cost"](found["GOAL"])) == 0
    assert not any("hold the input" in note for note in result.notes)


class Anything:
    """Takes whatever is set, and has whatever is asked."""

    def __getattr__(self, name: str) -> "Anything":
        value = Anything()
        object.__setattr__(self, name, value)
        return value


def test_the_script_for_acados_says_the_problem(problem, scripts):
    found = runpy.run_path(str(scripts / "acados_problem.py"))
    x, u, following = found["expressions"]()
    import casadi

    step = casadi.Function("step", [x, u], [following])
    np.testing.assert_array_equal(step(START, 1.0).full(), problem.STEP(START, 1.0).full())
    written: list[Anything] = []

    def take(ocp: Anything, json_file: str) -> str:
        written.append(ocp)
        return json_file

    assert found["make_solver"](Anything, Anything, take) == "controller.json"
    (ocp,) = written
    y = np.r_[START, 2.0] - ocp.cost.yref
    half = y @ np.asarray(ocp.cost.W) @ y / 2
    assert half == pytest.approx(float(problem.step_cost(START, np.array([2.0]))), rel=1e-12)
    of_x, of_u = np.asarray(ocp.cost.Vx), np.asarray(ocp.cost.Vu)
    np.testing.assert_array_equal(of_x @ START + of_u @ [2.0], np.r_[START, 2.0])
    assert (ocp.constraints.idxbx, ocp.constraints.lbx, ocp.constraints.ubx) == ([0], [-0.5], [0.4])
    np.testing.assert_array_equal(ocp.cost.Zl, problem.PENALTY[:1])


def test_acados_is_told_to_be_missing(scripts):
    done = subprocess.run(
        [sys.executable, "acados_problem.py"], cwd=scripts, capture_output=True, text=True
    )
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "install acados" in done.stderr


# what do-mpc says of itself when it is loaded and when it calls CasADi
@pytest.mark.filterwarnings("ignore::UserWarning:do_mpc")
@pytest.mark.filterwarnings("ignore::FutureWarning:casadi")
def test_do_mpc_follows_the_plan(problem, scripts, capsys):
    found = runpy.run_path(str(scripts / "do_mpc_controller.py"))
    states, inputs = found["play"](8)
    np.testing.assert_allclose(states[:, :2], motion().plan.x[:9, :2], atol=0.05)
    assert np.abs(inputs).max() <= 10
    capsys.readouterr()


# --- what is refused, and what is told ---


def test_without_casadi_there_are_no_scripts(tmp_path, monkeypatch):
    monkeypatch.setattr("tustinnet.control.export.write.find_spec", lambda name: None)
    result = export_controller(pendulum(), balance(), noise(pendulum()), tmp_path)
    assert not any(name.endswith(".py") for name in result.files)
    assert "step.casadi" not in (tmp_path / "README.md").read_text()
    assert any("tustinnet[casadi]" in note for note in result.notes)


@pytest.mark.thorough
@needs_gcc
@pytest.mark.parametrize(
    "gains", [lambda: predictive(balance(2)), lambda: balance(2), motion, late_motion]
)
def test_its_code_in_c_plays_a_loop(gains, monkeypatch):
    model, made = pendulum(), gains()
    played, estimator = compile_loop(made, model, noise(model))
    monkeypatch.setenv("CC", "no-such-compiler")
    own, own_estimator = compile_loop(made, model, noise(model))
    assert type(played) is not type(own)
    rng = np.random.default_rng(0)
    for _ in range(2):
        y = 0.01 * rng.normal(size=2)
        for one in (played, own):
            one.reset()
        x = estimator.reset(y)
        np.testing.assert_allclose(x, own_estimator.reset(y), rtol=1e-9, atol=1e-12)
        for k in range(30):
            y = np.full(2, np.nan) if 5 <= k < 20 else 0.01 * rng.normal(size=2)
            u = played.inputs(k, x)
            np.testing.assert_allclose(u, own.inputs(k, x), rtol=1e-9, atol=1e-12)
            x = estimator.update(y, u)
            np.testing.assert_allclose(x, own_estimator.update(y, u), rtol=1e-8, atol=1e-10)


def test_without_a_compiler_it_is_written_and_told(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    result = export_controller(pendulum(), balance(), noise(pendulum()), tmp_path)
    assert result.checked.difference is None
    assert any("set CC" in note for note in result.notes)
    assert (tmp_path / "controller.c").is_file()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"gain": np.zeros((1, 3))}, r"gain of the controller: shape \(1, 3\)"),
        ({"x0": np.full(4, np.nan)}, "x0 of the controller"),
        ({"dt": 0.02}, "period 0.02 s; expected that of the model, 0.01 s"),
    ],
)
def test_a_controller_of_another_model_is_refused(change, told, tmp_path):
    with pytest.raises(tn.InputError, match=told):
        export_controller(
            pendulum(), replace(balance(), **change), noise(pendulum()), tmp_path / "out"
        )
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("change", "told"),
    [({"reached": False}, "in theta, .* beside its")],
)
def test_a_plan_that_leads_nowhere_is_not_exported(change, told, tmp_path):
    tracking = replace(motion(), plan=replace(motion().plan, **change))
    with pytest.raises(tn.InputError, match=told):
        export_controller(pendulum(), tracking, noise(pendulum()), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@needs_gcc
def test_a_loop_that_diverges_is_not_exported(tmp_path):
    cart = example("cart")
    mad = replace(
        some_feedback(cart),
        gain=np.full((1, 4), -1e6),
        lower=np.full(1, -1e12),
        upper=np.full(1, 1e12),
    )
    with pytest.raises(tn.InputError, match="closed loop diverges after"):
        export_controller(cart, mad, noise(cart), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_only_an_export_is_replaced(tmp_path, exported):
    folder, _ = exported("balance")
    with pytest.raises(tn.InputError, match="there already"):
        export_controller(pendulum(), balance(), noise(pendulum()), folder)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(tn.InputError, match="a folder that holds something else"):
        export_controller(pendulum(), balance(), noise(pendulum()), tmp_path, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["notes.txt"]
