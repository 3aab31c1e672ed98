"""Are records that `rank_proposals` prefers worth more than others? On the twin of the pendulum.

    python benchmarks/next_record.py [--seeds 5]

24 records of 4 s can be made: falls, small swings, white noise of 0.5 to 4 V, sines. Models are
fitted to a few drawn at random, then `rank_proposals` ranks the others: the first of them are made
and added, and the models fitted anew, and so on; beside that others at random are. Each is scored
on the 6 validation records of the twin.

The twin's own equations of motion are identified, and a record is added a round.
"""

import argparse
import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax

jax.config.update("jax_num_cpu_devices", 2)
jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from rich.console import Console

import tustinnet as tn
from tustinnet.evaluate.next_record import Proposal, rank_proposals
from tustinnet.fitting.fit import fit_task
from tustinnet.fitting.listener import Listener
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.task import Fold, Task
from tustinnet.report.progress import FitProgress
from tustinnet.report.tables import Table, number
from tustinnet.systems.qube_servo2 import WITH_MEMORY
from tustinnet.systems.qube_servo2_twin import TWIN_VALUES, twin
from tustinnet.systems.twin import AS_LOGGED, TwinRun, log_runs

SAMPLES, EACH = 400, 6
RANDOM, CHOSEN = "random", "chosen"
SIZES = (3, 4, 5, 6)


def proposals() -> list[Proposal]:
    """What could be recorded."""
    generator, proposals = np.random.default_rng(0), []
    t, still = np.arange(SAMPLES) * 0.01, np.zeros((SAMPLES, 1))
    for i in range(EACH):
        side = (-1) ** i
        tilt, arm = generator.uniform(0.2, 0.8), generator.uniform(-1.5, 1.5)
        proposals.append(Proposal(f"fall {i}", np.array([arm, side * tilt]), np.zeros(2), still))
        low, arm = generator.uniform(0.2, 1.5), generator.uniform(-0.3, 0.3)
        proposals.append(
            Proposal(f"swing {i}", np.array([arm, np.pi + side * low]), np.zeros(2), still)
        )
        level = 0.5 + 0.7 * i
        u = generator.uniform(-level, level, (SAMPLES, 1))
        proposals.append(Proposal(f"noise {level:.1f} V", np.array([0, np.pi]), np.zeros(2), u))
        hertz = 0.5 * 1.5**i
        u = 2 * np.sin(2 * np.pi * hertz * t)[:, None]
        proposals.append(Proposal(f"sine {hertz:.1f} Hz", np.array([0, np.pi]), np.zeros(2), u))
    return proposals


def recorded(of: Sequence[Proposal], channels: tn.Experiment) -> dict[str, tn.Experiment]:
    """What the twin makes of proposals."""
    values = {name: jnp.asarray(value) for name, value in TWIN_VALUES.items()}
    runs = [TwinRun(p.name, "train", np.concatenate([p.q, p.v, [0.0]]), p.u) for p in of]
    made = log_runs(
        WITH_MEMORY.model(values), channels.channels, runs, AS_LOGGED, np.random.default_rng(1)
    )
    return {e.name: e for e in made}


@dataclass
class Arm:
    """Records that are added to in one way.

    Attributes:
        seed: what the first ones were drawn by.
        way: how others are added.
        names: those it has.
    """

    seed: int
    way: str
    names: list[str]


Ranked = tuple[list[float], Callable[[Sequence[Proposal]], list[str]]]


def grey(
    arms: Sequence[Arm],
    made: dict[str, tn.Experiment],
    held_out: Sequence[tn.Experiment],
    listener: Listener,
) -> list[Ranked]:
    """Identifies the records of each arm: RMSE and error of parameters, and who ranks."""
    ranked: list[Ranked] = []
    # positions alone: their units are the same for all records, so that programs compile once
    recipe = tn.read_recipe("grey", ["search.initial=anchored"])
    for arm in arms:
        roles = Roles(tuple(made[name] for name in arm.names), ())
        task = Task(recipe, (Fold(roles),), system=WITH_MEMORY)
        result = fit_task(task, listener)[0]
        scores = tn.evaluate(result.model, held_out, "model-20")
        assert result.identification is not None
        off = [
            abs(np.log(max(e.value, 1e-12) / TWIN_VALUES[e.name]))
            for e in result.identification.estimates
            if TWIN_VALUES[e.name] > 0
        ]

        def rank(of: Sequence[Proposal], result: tn.FitResult = result) -> list[str]:
            return [g.name for g in rank_proposals(result.model, result.as_header(), of)]

        ranked.append(([tn.mean_rmse(scores), float(np.median(off))], rank))
    return ranked


def needed(curves: dict[tuple[str, int], list[float]], sizes: Sequence[int], seeds: int) -> str:
    """With how many records chosen ones are as good as random ones are with the most."""
    goal_at = sizes[-1]
    medians = {
        way: [statistics.median(curves[way, s][k] for s in range(seeds)) for k in range(len(sizes))]
        for way in (RANDOM, CHOSEN)
    }
    goal = medians[RANDOM][sizes.index(goal_at)]
    reached = [n for n, x in zip(sizes, medians[CHOSEN], strict=True) if x <= goal]
    with_ = f"with {reached[0]}" if reached else "never"
    return f"what {goal_at} random records give, chosen ones give {with_}"


def main() -> None:
    """Reads the arguments, runs the rounds, prints."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("results"))
    given = parser.parse_args()
    held_out = list(twin(7).split("validation"))
    pool = proposals()
    made = recorded(pool, held_out[0])
    names = [p.name for p in pool]
    orders = [np.random.default_rng(s).permutation(names).tolist() for s in range(given.seeds)]
    arms = [
        Arm(s, way, orders[s][: SIZES[0]]) for s in range(given.seeds) for way in (RANDOM, CHOSEN)
    ]
    lines: list[dict] = []
    with FitProgress(Console(stderr=True, soft_wrap=True), quiet=True) as progress:
        for n, more in zip(SIZES, (*np.diff(SIZES).tolist(), 0), strict=True):
            for arm, (figures, rank) in zip(
                arms, grey(arms, made, held_out, progress.listener()), strict=True
            ):
                lines.append(
                    {
                        "way": arm.way,
                        "seed": arm.seed,
                        "records": n,
                        "figures": figures,
                        "names": list(arm.names),
                    }
                )
                print(f"{n} records, seed {arm.seed}, {arm.way}: {figures}", flush=True)
                others = [name for name in orders[arm.seed] if name not in arm.names]
                if arm.way == CHOSEN and more:
                    try:
                        others = rank([p for p in pool if p.name not in arm.names])
                    except tn.InputError as error:  # a model that can simulate nothing
                        print(f"seed {arm.seed}: at random, {error}", flush=True)
                arm.names += others[:more]
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "next_record.json").write_text(json.dumps(lines, indent=1))
    for i in range(len(lines[0]["figures"])):
        curves: dict[tuple[str, int], list[float]] = {}
        for of in lines:
            curves.setdefault((of["way"], of["seed"]), []).append(of["figures"][i])
        rows = []
        for k, n in enumerate(SIZES):
            row = [str(n)]
            for way in (RANDOM, CHOSEN):
                each = [curves[way, s][k] for s in range(given.seeds)]
                texts = [number(f(each)) for f in (statistics.median, min, max)]
                row.append(f"{texts[0]} ({texts[1]}..{texts[2]})")
            rows.append(row)
        print(Table(["records", RANDOM, CHOSEN], rows).markdown())
        print(f"* {needed(curves, SIZES, given.seeds)}\n")


if __name__ == "__main__":
    main()
