"""Controllers made on models of every family, played on twins that the models never saw.

python benchmarks/control_twins.py fit OUT [NAME...]         fits the families to the demo's records
python benchmarks/control_twins.py twins OUT [NAME...]       success on twins moved by 0, 10, 20 %
python benchmarks/control_twins.py robustness OUT [NAME...]  the table, its promise, what came of it
python benchmarks/control_twins.py falls OUT [NAME...]       pushed over when they stand: up again?
python benchmarks/control_twins.py figure OUT FILE.png       a swing-up of each family on the twin

NAME is one of `FITS`; those that end in `+` have eleven records more, of driven falls from upright.
"""

import itertools
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
import tustinnet.control as tc
from tustinnet.channels import Channels
from tustinnet.errors import InputError
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.systems import qube_servo2_twin
from tustinnet.systems.qube_servo2 import WITH_MEMORY
from tustinnet.systems.twin import AS_LOGGED, TwinRun, log_runs

GREY = "grey box"
FITS = {
    GREY: ["--recipe", "grey", "--system", "qube-servo2"],
    "hybrid": ["--recipe", "best-hybrid"],
    "Tustin-Net, silu": ["--recipe", "network", "--seeds", "3"],
    "Tustin-Net, relu": ["--recipe", "network", "--set", "model.activation=relu"],
    "Tustin-Net, standard": ["--recipe", "standard"],
    "Tustin-Net, odd with memory": ["--recipe", "tustin-memory"],
    "GRU": ["--recipe", "gru"],
    "linear": ["--recipe", "linear"],
    "Tustin-Net, silu+": ["--recipe", "network"],
    "Tustin-Net, standard+": ["--recipe", "standard"],
}
COMMITTEE = "committee of 3, silu"
SHARES = (0.0, 0.1, 0.2)  # by which the twins' parameters are moved
STARTS, STEPS = 20, 1000
PROMISED = 100  # runs by which promises are compared with what came of them
# V of the plan, as much as was recorded, and of the feedback; chosen, as the deviations, by the
# success of the grey box and the hybrid on their own variants
PLANNED, COMMANDED, STEPS_OF_PLAN = 4.0, 10.0, 300
DEVIATIONS = {"theta": 1.0, "alpha": 1.0, "der_theta": 10.0, "der_alpha": 20.0, "voltage": 4.0}
GOAL = tc.Goal({"alpha": 0.0}, limits={"theta": (-2.5, 2.5)})
# rad/s by which a push changes the pendulum's velocity, at which sample, and samples of such a run
PUSHES, PUSHED, LONG = (6.0, 8.0, 10.0, 15.0, 20.0), 600, 2000


def folder_of(out: Path, name: str) -> Path:
    """The folder of a fit."""
    return out / name.replace(" ", "-").replace(",", "")


def records(out: Path, *, driven: bool) -> Path:
    """The folder of the demo's records, with driven falls from upright where they are wanted."""
    folder = out / ("twin-driven" if driven else "twin")
    if not folder.exists():
        twin = qube_servo2_twin.twin(0)
        more = driven_falls() if driven else ()
        write_data_set(tn.DataSet("twin", (*twin, *more)), folder, "Simulated twin")
    return folder


def driven_falls() -> tuple[tn.Experiment, ...]:
    """Falls from upright under a noisy voltage, which the demo's records lack."""
    generator = np.random.default_rng(100)
    runs = []
    for split, count in (("train", 8), ("validation", 3)):
        for i in range(count):
            alpha = generator.uniform(-0.15, 0.15) + 2 * np.pi * (i % 2)
            x0 = np.array([generator.uniform(-0.5, 0.5), alpha, 0.0, 0.0, 0.0])
            u = generator.uniform(-4.0, 4.0, (400, 1))
            runs.append(TwinRun(f"twin_driven_{split}{i + 1}", split, x0, u))
    values = {name: jnp.asarray(x) for name, x in qube_servo2_twin.TWIN_VALUES.items()}
    channels = Channels(tc.qube_twin().channels.coordinates, WITH_MEMORY.inputs)
    return log_runs(WITH_MEMORY.model(values), channels, runs, AS_LOGGED, generator)


def fit(out: Path, names: list[str]) -> None:
    """Fits families by the command, each into a folder."""
    for name in names or list(FITS):
        data, folder = records(out, driven=name.endswith("+")), folder_of(out, name)
        arguments = [str(data), *FITS[name], "--out", str(folder), "--no-report", "--overwrite"]
        if name == "hybrid":
            arguments += ["--physics", str(folder_of(out, GREY) / "model.safetensors")]
        start_time = time.perf_counter()
        subprocess.run([sys.executable, "-m", "tustinnet", "fit", *arguments, "-q"], check=True)
        print(f"{name}: {time.perf_counter() - start_time:.0f} s", flush=True)


@dataclass
class Design:
    """A model with its estimator, and a controller that swings up and balances."""

    name: str
    model: tn.Model
    header: dict[str, object]
    noise: tn.FilterNoise
    controller: tc.TrackingFeedback
    balance: tc.LinearFeedback
    estimator: tc.ExtendedKalmanFilter
    seconds: float


def load(out: Path, name: str) -> tuple[tn.Model, dict[str, object]]:
    """A model and the header of its file; of a committee that of its first member."""
    if name == COMMITTEE:
        folder = folder_of(out, "Tustin-Net, silu")
        seeds = sorted(folder.glob("seed-*/model.safetensors"))
        return tn.committee([tn.load_model(file) for file in seeds]), tn.read_header(seeds[0])
    file = folder_of(out, name) / "model.safetensors"
    return tn.load_model(file), tn.read_header(file)


def design(out: Path, name: str) -> Design:
    """The controller of a family."""
    data = tn.load(records(out, driven=name.endswith("+")))
    return design_on(name, *load(out, name), list(data.split("train")))


def design_on(
    name: str, model: tn.Model, header: dict[str, object], training: list[tn.Experiment]
) -> Design:
    """Filter by the training records, plan and feedback by the model alone."""
    start_time = time.perf_counter()
    try:
        point = tc.find_equilibrium(model, {"alpha": 0.0, "theta": 0.0})
    except InputError:
        point = tc.find_equilibrium(model, {"alpha": 0.0})
    feedback = tc.lqr(
        model, point.x, point.u, deviations=DEVIATIONS, limits={"voltage": (-COMMANDED, COMMANDED)}
    )
    hanging = np.asarray(model.initial_state(jnp.array([0, jnp.pi, 0, 0]), jnp.zeros(1)))
    low, high = np.array(header["range"]["states"], float)[model.channels.velocity].T  # pyright: ignore[reportIndexIssue, reportArgumentType, reportCallIssue]
    plan = tc.ilqr(
        model,
        hanging,
        point.x,
        STEPS_OF_PLAN,
        goal_inputs=point.u,
        deviations=DEVIATIONS,
        limits={"voltage": (-PLANNED, PLANNED)},
        guesses=3,
        within={
            "theta": (-1.8, 1.8),
            "der_theta": (low[0], high[0]),
            "der_alpha": (low[1], high[1]),
        },
    )
    seconds = time.perf_counter() - start_time
    noise = tc.find_noise(model, training)
    rest = tc.find_equilibrium(model, {"alpha": np.pi})
    settle = tc.lqr(
        model, rest.x, rest.u, deviations=DEVIATIONS, limits={"voltage": (-COMMANDED, COMMANDED)}
    )
    tracking = tc.time_varying_lqr(model, plan, feedback, deviations=DEVIATIONS, settle=settle)
    if not plan.reached:
        print(f"{name}: the plan misses the goal by {np.round(plan.miss[:4], 2)}")
    estimator = tc.ExtendedKalmanFilter(model, noise)
    return Design(
        name,
        model,
        header,
        noise,
        tc.TrackingFeedback(tracking),
        tc.LinearFeedback(feedback),
        estimator,
        seconds,
    )


def starts(count: int = STARTS) -> np.ndarray:
    """Positions near hanging from which runs start."""
    return tc.draw_starts([0.0, np.pi], [0.1, 0.05], count)


def moved_twins(share: float, count: int) -> tuple[tc.ModelPlant, ...]:
    """Twins whose parameters are all moved by up to a share; all of one machine code."""
    generator = np.random.default_rng(1000)
    stepped = tc.SteppedModel(tc.qube_twin().model)
    values = qube_servo2_twin.TWIN_VALUES
    return tuple(
        tc.ModelPlant(stepped, tc.moved_values(values, share, generator)) for _ in range(count)
    )


def play(made: Design, share: float, count: int = STARTS) -> tc.RobustnessRow:
    """A controller on moved twins, one from each start."""
    kind = tc.VariantKind("twin", f"moved by {100 * share:.0f} %", moved_twins(share, count))
    table = tc.assess_robustness(
        [kind], made.controller, made.estimator, starts(count), GOAL, STEPS, seed=77
    )
    return table.rows[0]


def designs(out: Path, names: list[str]) -> Iterator[Design]:
    """The controllers of the models that were fitted; why there is none is printed."""
    for name in names or [*FITS, COMMITTEE]:
        if name != COMMITTEE and not folder_of(out, name).exists():
            continue
        try:
            yield design(out, name)
        except InputError as error:
            print(f"{name}: {error}", flush=True)


def twins(out: Path, names: list[str]) -> None:
    """Success by family, and the error of the models' free runs."""
    test = list(tn.load(records(out, driven=False)).split("test"))
    print(
        "model: free-run error; time to plan; successes of 20: balance, and swing-up of twins "
        "moved by 0, 10, 20 %"
    )
    for made in designs(out, names):
        error = tn.mean_rmse(tn.evaluate(made.model, test, "model-20"))
        rows = [play(made, share) for share in SHARES]
        upright = tc.draw_starts([0.0, 0.0], [0.2, 0.1], STARTS)
        balanced = sum(
            tc.closed_loop(
                tc.qube_twin(), made.balance, made.estimator, STEPS, start, i, GOAL
            ).is_success
            for i, start in enumerate(upright)
        )
        print(
            f"{made.name}: {error:.3f} rad; {made.seconds:.1f} s; balanced {balanced}; "
            + ", ".join(str(row.successes) for row in rows)
            + f"; alpha within {rows[0].worst['alpha']:.3f} rad, {rows[0].energy:.1f} V^2 s",
            flush=True,
        )
        for row in rows:
            if row.failures:
                print(f"    {row.help}: {row.failures}")


def robustness(out: Path, names: list[str]) -> None:
    """The table of a controller's robustness, and what came of it on the twins."""
    for made in designs(out, names or [GREY, "hybrid"]):
        start_time = time.perf_counter()
        kinds = tc.make_variants(made.model, made.noise, made.header)
        table = tc.assess_robustness(kinds, made.controller, made.estimator, starts(), GOAL, STEPS)
        seconds = time.perf_counter() - start_time
        print(f"{made.name}: {len(kinds)} kinds of {STARTS} runs of 10 s in {seconds:.1f} s")
        for row in table.rows:
            worst, spent = row.worst["alpha"], row.energy
            print(
                f"  {row.help}: {row.successes}; {worst:.3f} rad, {spent:.1f} V^2 s {row.failures}"
            )
        print(f"  {table.sentence}")
        kinds = tc.make_variants(made.model, made.noise, made.header, count=PROMISED)
        promised = {0.0: "nominal", 0.1: "moved 10 %", 0.2: "moved 20 %"}
        compared = [kind for kind in kinds if kind.name in promised.values()]
        more = tc.assess_robustness(
            compared, made.controller, made.estimator, starts(PROMISED), GOAL, STEPS
        )
        for share, kind in promised.items():
            if kind not in [row.kind for row in more.rows]:
                continue
            row = play(made, share, PROMISED)
            print(
                f"  {row.help}: promised {more[kind].share:.2f}, played {row.share:.2f} "
                f"{row.failures}",
                flush=True,
            )


class Pushed:
    """A plant whose last coordinate is pushed once, by a change of its velocity.

    Args:
        plant: the plant.
        push: the change [rad/s].
    """

    def __init__(self, plant: tc.ModelPlant, push: float) -> None:
        self.plant, self.push = plant, push
        self.dt, self.channels, self.state = plant.dt, plant.channels, plant.state

    def reset(self, q: np.ndarray, seed: int) -> None:
        """Puts it to rest at positions."""
        self.plant.reset(q, seed)
        self.state, self.samples = self.plant.state, 0

    def measure(self) -> np.ndarray:
        """What the encoders read."""
        return self.plant.measure()

    def apply(self, u: np.ndarray) -> None:
        """Goes on by one period."""
        self.plant.apply(u)
        self.state, self.samples = self.plant.state, self.samples + 1
        if self.samples == PUSHED:
            self.state[self.channels.velocity.stop - 1] += self.push


def falls(out: Path, names: list[str]) -> None:
    """Runs that are pushed over when they stand, with and without recovery."""
    goal = tc.Goal(GOAL.at)
    for made in designs(out, names or [GREY, "hybrid"]):
        tracking = made.controller.tracking
        alone = tc.TrackingFeedback(replace(tracking, recovery=None))
        print(f"{made.name}: twins moved by, push: fell; stand at the end, without recovery")
        for share, push in itertools.product(SHARES, PUSHES):
            twins = moved_twins(share, STARTS)
            plants = [Pushed(twin, push * (-1) ** i) for i, twin in enumerate(twins)]
            runs, without = (
                [
                    tc.closed_loop(plant, controller, made.estimator, LONG, start, i, goal)
                    for i, (plant, start) in enumerate(zip(plants, starts(), strict=True))
                ]
                for controller in (made.controller, alone)
            )
            fallen = [run for run in runs if (np.cos(run.states[PUSHED:, 1]) < 0).any()]
            reached = [run.outcome.time_to_reach for run in fallen if run.outcome]
            times = [t for t in reached if t is not None]
            when = f"; from {np.median(times):.1f} s on, at last {max(times):.1f}" if times else ""
            arm = max([float(np.abs(run.states[PUSHED:, 0]).max()) for run in fallen], default=0)
            print(
                f"  {100 * share:.0f} %, {push:g} rad/s: {len(fallen)} fell; "
                f"{sum(run.is_success for run in runs)} of {STARTS} stand, "
                f"{sum(run.is_success for run in without)} without recovery{when}"
                f"; the arm within {arm:.1f} rad",
                flush=True,
            )


def figure(out: Path, file: str) -> None:
    """A swing-up of each family on the twin."""
    import matplotlib.pyplot as plt

    made = list(designs(out, [GREY, "hybrid", "Tustin-Net, silu", "Tustin-Net, silu+"]))
    shown, panels = plt.subplots(3, 1, figsize=(7, 5.5), sharex=True, layout="constrained")
    twin = tc.qube_twin()
    for one in made:
        run = tc.closed_loop(twin, one.controller, one.estimator, 600, starts()[0], 0, GOAL)
        t = run.dt * np.arange(len(run.states))
        for axes, rows in zip(panels, (*run.states[:, :2].T, run.inputs[:, 0]), strict=True):
            axes.plot(t[: len(rows)], rows, label=one.name, lw=1.1)
    for axes, label in zip(panels, ("theta [rad]", "alpha [rad]", "voltage [V]"), strict=True):
        axes.set_ylabel(label)
    panels[0].legend(frameon=False, ncols=2)
    panels[-1].set_xlabel("time [s]")
    shown.savefig(file, dpi=110)


if __name__ == "__main__":
    parts = {"fit": fit, "twins": twins, "robustness": robustness, "falls": falls}
    if len(sys.argv) < 3 or sys.argv[1] not in (*parts, "figure"):
        sys.exit(__doc__)
    if sys.argv[1] == "figure":
        figure(Path(sys.argv[2]), sys.argv[3])
    else:
        parts[sys.argv[1]](Path(sys.argv[2]), sys.argv[3:])
