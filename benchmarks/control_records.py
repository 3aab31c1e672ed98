"""How many records, and which, a controller needs; what its own failures add to them.

python benchmarks/control_records.py records OUT     success by number and kind of records
python benchmarks/control_records.py rounds OUT      failures recorded, added, fitted again

The machine is the twin of the Qube-Servo 2, as in `control_twins.py`: plan, filter and feedback by
models of its records, played on it from 20 starts. Each set of records is drawn three times.
"""

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np
from control_twins import GOAL, GREY, STARTS, STEPS, Design, design_on, play, starts

import tustinnet as tn
import tustinnet.control as tc
from tustinnet.errors import InputError
from tustinnet.store.data_set_folder import write_data_set
from tustinnet.systems import qube_servo2_twin

DRAWS = 3
COUNTS = (2, 5, 15)
KINDS = ("falls", "noise", "both")
GREY_BOX = ("--recipe", "grey", "--system", "qube-servo2")
ROUNDS = 5
ADDED = 5  # failures that a round adds at most
LOGGED = 500  # samples of their logs
FAMILIES = {  # what is fitted, and to what in the first round
    GREY: (GREY_BOX, "2 falls"),
    "grey box from noise": (GREY_BOX, "2 noise"),
    "Tustin-Net, silu": (("--recipe", "network"), "the demo's 15"),
}


def pool(draw: int) -> dict[str, list[tn.Experiment]]:
    """Training records of the twin by kind, those of each draw other ones."""
    by_kind: dict[str, list[tn.Experiment]] = {"falls": [], "noise": []}
    for part in range(3):
        for e in qube_servo2_twin.twin(100 * draw + part + 1):
            if e.split == "train":
                kind = by_kind["noise" if e.forced else "falls"]
                kind.append(replace(e, name=f"{e.name}_{part}"))
    generator = np.random.default_rng(draw)
    return {kind: [es[i] for i in generator.permutation(len(es))] for kind, es in by_kind.items()}


def choose(draw: int, kind: str, count: int) -> list[tn.Experiment]:
    """Some records of a kind; of both kinds half each, of two records one each."""
    by_kind = pool(draw)
    if kind != "both":
        return by_kind[kind][:count]
    return by_kind["falls"][: count - count // 2] + by_kind["noise"][: count // 2]


def fit(folder: Path, training: Sequence[tn.Experiment], recipe: Sequence[str]) -> Path:
    """Fits a recipe to records by the command; the model's file."""
    data, file = folder / "logs", folder / "run" / "model.safetensors"
    if not file.is_file():
        held_out = [replace(e, split="validation") for e in (training[-1],)]
        split = (
            [replace(e, split="train") for e in training]
            if len(training) < 3
            else [*(replace(e, split="train") for e in training[:-1]), *held_out]
        )
        write_data_set(tn.DataSet("twin", tuple(split)), data, "Simulated twin", overwrite=True)
        words = [
            "fit",
            str(data),
            *recipe,
            "--out",
            str(file.parent),
            "--no-report",
            "-q",
            "--overwrite",
        ]
        subprocess.run(
            [sys.executable, "-m", "tustinnet", *words],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    return file


def design_for(file: Path, training: Sequence[tn.Experiment]) -> Design | str:
    """The controller of a model, or why there is none."""
    model, header = tn.load_model(file), tn.read_header(file)
    try:
        return design_on(str(file.parent), model, header, list(training)[:15])
    except InputError as error:
        return str(error)


def records(out: Path) -> None:
    """Success by number and kind of records, and the models' errors on the test records."""
    test = list(qube_servo2_twin.twin(0).split("test"))
    print("| records | free-run error [rad] | swing-ups of 20 | why there is no controller |")
    for kind in KINDS:
        for count in COUNTS:
            errors, successes, why = [], [], set[str]()
            for draw in range(DRAWS):
                training = choose(draw, kind, count)
                file = fit(out / f"{kind}-{count}-{draw}", training, GREY_BOX)
                errors.append(tn.mean_rmse(tn.evaluate(tn.load_model(file), test, "model-20")))
                made = design_for(file, training)
                if isinstance(made, str):
                    why.add(made.split(";")[0])
                successes.append(0 if isinstance(made, str) else play(made, 0.0).successes)
            error = ", ".join(f"{e:.2f}" for e in errors)
            print(f"| {count} {kind} | {error} | {successes} | {' / '.join(why)} |", flush=True)


def first_records(which: str, draw: int) -> list[tn.Experiment]:
    """The records of the first round, without velocities, which logs of closed loops lack, too."""
    if which.startswith("2 "):
        chosen = choose(draw, which.removeprefix("2 "), 2)
    else:
        chosen = list(qube_servo2_twin.twin(draw).split("train"))
    return [replace(e, v=None) for e in chosen]


def failures(made: Design, seed: int, number: int) -> tuple[tc.RobustnessRow, list[tn.Experiment]]:
    """What became of the goal on the twin, and logs of runs that fail.

    Where a run ends early, as the arm leaves its limits, the motor is off for the rest of the log.
    """
    twin, logs, outcomes = tc.qube_twin(), [], []
    for i, start in enumerate(starts()):
        run = tc.closed_loop(twin, made.controller, made.estimator, STEPS, start, seed + i, GOAL)
        assert run.outcome is not None
        outcomes.append(run.outcome)
        if run.is_success or len(logs) == ADDED:
            continue
        q, u = list(run.measurements), list(run.inputs)
        while len(u) < LOGGED:
            u.append(np.zeros(1))
            twin.apply(u[-1])
            q.append(twin.measure())
        logs.append(
            tn.from_arrays(
                np.stack(q[:LOGGED]),
                np.stack(u[:LOGGED]),
                dt=run.dt,
                name=f"failure_{number}_{i}",
                coordinates=twin.channels.coordinates,
                inputs=twin.channels.inputs,
            )
        )
    return tc.RobustnessRow("twin", "the twin", tuple(outcomes)), logs


def upright_effect(model: tn.Model) -> float:
    """The effect of a volt on the pendulum's speed after a sample, upright at rest [rad/s]."""
    stepped, volt = tc.SteppedModel(model), np.ones(1)
    values = stepped.vector({})
    x = stepped.start(np.zeros(2), np.zeros(2), values)
    up, down = (stepped.step(x, stepped.history().add(u), values) for u in (volt, -volt))
    return float(up[3] - down[3]) / 2


def seconds_upright(logs: Sequence[tn.Experiment]) -> float:
    """How long inputs act within 0.4 rad of upright [s]."""
    near = [(np.cos(e.q[:, 1]) > np.cos(0.4)) & (e.u[:, 0] != 0) for e in logs]
    return sum(float(samples.sum()) * e.dt for samples, e in zip(near, logs, strict=True))


def rounds(out: Path, only: Sequence[str]) -> None:
    """Success round by round, each with logs of the failures of the one before."""
    for name, (recipe, which) in FAMILIES.items():
        if only and name not in only:
            continue
        for draw in range(DRAWS):
            training = first_records(which, draw)
            print(f"{name}, {which}, draw {draw}:", flush=True)
            for number in range(ROUNDS + 1):
                folder = out / f"{name.replace(' ', '-').replace(',', '')}-{draw}-{number}"
                file = fit(folder, training, recipe)
                effect = f"effect of a volt upright {upright_effect(tn.load_model(file)):.2f} rad/s"
                made = design_for(file, training)
                print(f"  {len(training)} records: {effect}; ", end="", flush=True)
                if isinstance(made, str):
                    print(f"no controller ({made})", flush=True)
                    break
                row, logs = failures(made, 1000 * draw + 100 * number, number)
                why = f"; {row.failures}" if row.failures else ""
                print(f"{row.successes} of {STARTS}{why}", flush=True)
                if not logs:
                    break
                seconds = seconds_upright(logs)
                print(f"    in their logs inputs act near upright for {seconds:.1f} s", flush=True)
                training = [*logs, *training]


if __name__ == "__main__":
    if len(sys.argv) < 3 or sys.argv[1] not in ("records", "rounds"):
        sys.exit(__doc__)
    if sys.argv[1] == "records":
        records(Path(sys.argv[2]))
    else:
        rounds(Path(sys.argv[2]), sys.argv[3:])
