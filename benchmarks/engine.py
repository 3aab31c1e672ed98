"""Machine code for simulation and identification: how long it takes, part by part.

    python benchmarks/engine.py [compile products one runs step chain memory]   (default: all)
    python benchmarks/engine.py commands DATA [--source CHECKOUT/src ...] [--rounds 5] [--only grey]

The parts need no records: the rotary pendulum is driven by noise. Each is the median of five calls
in this process; `products`, `one` and `runs` also by JAX, in the same run (TUSTINNET_ENGINE=jax),
and how many times as long that takes. `commands` times whole processes with empty caches, those of
several sources one after the other in each round; hybrids correct the grey box of the last source.
"""

import jax

jax.config.update("jax_enable_x64", True)

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import jax.numpy as jnp
import numpy as np

import tustinnet as tn
from tustinnet.engine import engines as engine
from tustinnet.engine.equations import ResidualFormula
from tustinnet.engine.runs import Directions, Runs, Samples
from tustinnet.fitting.shooting.equations import system_equations
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.simulation import simulate_runs
from tustinnet.systems import qube_servo2

DT, STEPS, RECORDS, SUBSTEPS = 0.01, 1500, 15, 4
POSITIONS = ResidualFormula(lambda error: error, 2)


def timed(call: Callable[[], object], repeats: int = 5) -> float:
    """Median seconds of some calls, after one that compiles."""
    call()
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - begin)
    return median(seconds)


def both_engines(call: Callable[[], object]) -> dict[str, float]:
    """Seconds by machine code and by JAX."""
    fast = timed(call)
    os.environ[engine.VARIABLE] = "jax"
    slow = timed(call)
    del os.environ[engine.VARIABLE]
    return {"s": round(fast, 4), "jax_s": round(slow, 4), "ratio": round(slow / fast, 1)}


def pendulum(records: int) -> Callable[[], object]:
    """Errors, derivatives and products of records of the rotary pendulum, 13 parameters."""
    system = qube_servo2.WITH_INITIAL_DEFLECTION
    equations = system_equations(system, tuple(p.name for p in system.parameters if not p.fixed))
    n_x, rows, generator = 5, records * (STEPS + 1), np.random.default_rng(0)
    start = np.zeros((records, n_x))
    start[:, 1] = np.linspace(2.3, 3.0, records)
    runs = Runs(
        start,
        equations.parameter_rows(system.nominal(), np.zeros((records, 0), int)),
        np.full(records, STEPS),
        np.arange(records) * (STEPS + 1),
        generator.normal(size=(rows, 1, 1)),
        np.full(rows, DT),
    )
    seeds = np.zeros((records, equations.n_p + n_x, n_x))
    seeds[:, equations.n_p :] = np.eye(n_x)
    samples = Samples(np.zeros((rows, 2)), np.ones((rows, 2)))
    given = equations.motion, POSITIONS, runs, SUBSTEPS, Directions(seeds, True), samples
    return lambda: engine.compare(*given)


def first_call() -> dict[str, float]:
    """The first call for `qube-servo2-turned`, equations read and compiled, once JAX is loaded."""
    jnp.zeros(1).block_until_ready()
    begin = time.perf_counter()
    pendulum(1)()
    return {"s": round(time.perf_counter() - begin, 2)}


def free_runs() -> dict[str, float]:
    """Free runs of 15 records with a network."""
    channels = tn.Channels(qube_servo2.SYSTEM.coordinates, qube_servo2.SYSTEM.inputs, DT)
    from tustinnet.families.tustin_net import random_tustin_net
    from tustinnet.models.blocks import Scaling
    from tustinnet.models.contract import with_dtype

    ones = jnp.ones(2)
    scaling = Scaling(ones[:0], ones[:0], 10 * ones, ones[:1], 100 * ones, ones[:0])
    network = random_tustin_net(channels, scaling, jax.random.key(0), hidden=(64, 64))
    model = with_dtype(network, np.float64)
    x0 = 0.1 * np.random.default_rng(0).normal(size=(RECORDS, 4))
    drive = InputSignal(np.random.default_rng(1).normal(size=(RECORDS, STEPS, 1)))
    return both_engines(lambda: simulate_runs(model, x0, drive))


def one_step() -> dict[str, float]:
    """One step of a grey box from Python."""
    system = qube_servo2.WITH_INITIAL_DEFLECTION
    values = {name: jnp.asarray(x) for name, x in system.nominal().items()}
    step = tn.compiled_step(tn.discretise(system.model(values), DT, SUBSTEPS))
    x, u, count = np.full(5, 0.1), np.array([0.5]), 20_000

    def steps() -> None:
        for _ in range(count):
            step(x, u)

    return {"us": round(1e6 * timed(steps) / count, 2)}


def chain(joints: int = 7) -> tn.LagrangianSystem:
    """Links that hang on one another, their energies written in a loop."""
    parameters = [
        tn.Parameter(f"{name}{i}", unit, value, value / 10, value * 10)
        for i in range(joints)
        for name, unit, value in (
            ("mass", "kg", 1.0),
            ("length", "m", 0.5),
            ("inertia", "kg m^2", 0.05),
            ("damping", "N m s", 0.05),
        )
    ]
    parameters += [
        tn.Parameter("gravity", "m/s^2", 9.81, 9.0, 10.0),
        tn.Parameter("gain", "N m/V", 1.0, 0.1, 10.0),
    ]

    def kinetic(q, v, p):  # noqa: ANN001, ANN202
        total = angle = speed = along = up = 0.0
        for i in range(joints):
            angle, speed, length = angle + q[i], speed + v[i], p[f"length{i}"]
            half = [length / 2 * f(angle) * speed for f in (jnp.cos, jnp.sin)]
            centre = (along + half[0]) ** 2 + (up + half[1]) ** 2
            total += (p[f"mass{i}"] * centre + p[f"inertia{i}"] * speed**2) / 2
            along, up = along + 2 * half[0], up + 2 * half[1]
        return total

    def potential(q, p):  # noqa: ANN001, ANN202
        total = angle = height = 0.0
        for i in range(joints):
            angle, length = angle + q[i], p[f"length{i}"]
            total += p[f"mass{i}"] * p["gravity"] * (height - length / 2 * jnp.cos(angle))
            height -= length * jnp.cos(angle)
        return total

    return tn.LagrangianSystem(
        "chain",
        tuple(tn.Coordinate(f"q{i}", "angular") for i in range(joints)),
        (tn.Input("voltage", "V"),),
        tuple(parameters),
        kinetic,
        potential,
        lambda q, v, p: jnp.stack([p[f"damping{i}"] * v[i] for i in range(joints)]),
        lambda q, v, u, p: jnp.concatenate([p["gain"] * u, jnp.zeros(joints - 1)]),
    )


def seven_joints() -> dict[str, float]:
    """A chain of 7 links, 30 parameters: the first call, and 1e4 steps with derivatives."""
    system, steps = chain(), 10_000
    equations = system_equations(system, tuple(p.name for p in system.parameters))

    def compared(steps: int) -> object:
        runs = Runs(
            np.full((1, 14), 0.3),
            equations.parameter_rows(system.nominal(), np.zeros((1, 0), int)),
            np.array([steps]),
            np.zeros(1, int),
            np.zeros((steps + 1, 1, 1)),
            np.full(steps + 1, 1e-3),
        )
        seeds = np.zeros((1, 44, 14))
        seeds[:, 30:] = np.eye(14)
        samples = Samples(np.zeros((steps + 1, 7)), np.ones((steps + 1, 7)))
        residual = ResidualFormula(lambda error: error, 7)
        return engine.compare(equations.motion, residual, runs, 1, Directions(seeds, True), samples)

    begin = time.perf_counter()
    compared(1)
    compiled = time.perf_counter() - begin
    return {
        "first_call_s": round(compiled, 2),
        "1e4_steps_s": round(timed(lambda: compared(steps), 3), 2),
    }


def long_record() -> dict[str, float]:
    """Memory of a process that identifies a pendulum from one record of 1e6 samples."""
    channels = {"coordinates": [tn.Coordinate("q", "angular")], "inputs": [tn.Input("u", "N m")]}
    system = tn.LagrangianSystem(
        "swing",
        tuple(channels["coordinates"]),
        tuple(channels["inputs"]),
        (
            tn.Parameter("damping", "N m s", 0.1, 0.01, 1.0),
            tn.Parameter("gravity", "N m", 1.0, 0.1, 10.0),
        ),
        lambda q, v, p: 0.05 * v[0] ** 2,
        lambda q, p: -p["gravity"] * jnp.cos(q[0]),
        lambda q, v, p: p["damping"] * v,
        lambda q, v, u, p: u,
    )
    truth = {"damping": jnp.asarray(0.15), "gravity": jnp.asarray(1.3)}
    model = tn.discretise(system.model(truth), DT)
    u = np.repeat(np.random.default_rng(0).normal(size=(10_000, 1)), 100, axis=0)
    states = simulate_runs(model, np.zeros((1, 2)), InputSignal(u[None, :-1]))[0]
    data = tn.from_arrays(states[:, :1], u, dt=DT, **channels)
    found = tn.identify(tn.DataSet("long", (data,)), system)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"peak_MiB": round(peak), "seconds": round(found.seconds, 1)}


PARTS: dict[str, Callable[[], dict[str, float]]] = {
    "compile": first_call,
    "products": lambda: both_engines(pendulum(RECORDS)),
    "one": lambda: both_engines(pendulum(1)),
    "runs": free_runs,
    "step": one_step,
    "chain": seven_joints,
    "memory": long_record,
}
COMMAND = "from tustinnet.cli.entry import run; run()"


def whole_command(source: Path, arguments: list[str]) -> float:
    """Seconds of a command by a source, with empty caches."""
    with tempfile.TemporaryDirectory() as caches:
        begin = time.perf_counter()
        subprocess.run(
            [sys.executable, "-c", COMMAND, *arguments],
            env={**os.environ, "PYTHONPATH": str(source), "XDG_CACHE_HOME": caches},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=True,
        )
        return time.perf_counter() - begin


def commands(data: str, sources: list[Path], rounds: int, only: list[str]) -> None:
    """Whole commands with empty caches, by every source in turn."""
    with tempfile.TemporaryDirectory() as folder:
        fit = ["fit", data, "--overwrite"]
        best = [*fit, "--recipe", "best-grey", "--system", "qube-servo2-turned"]
        one = ["--seeds", "1", "--physics", f"{folder}/grey/model.safetensors"]
        hybrid, scratch = [*fit, "--recipe", "hybrid", *one], ["--out", f"{folder}/scratch"]
        judge = ["--split", "validation", "--start", "model-20"]
        wanted = {
            "grey": [*fit, "--recipe", "grey", "--system", "qube-servo2", *scratch],
            "best-grey": [*best, *scratch],
            "hybrid": [*hybrid, *scratch],
            "best-hybrid": [*fit, "--recipe", "best-hybrid", *one, *scratch],
            "evaluate grey": ["evaluate", f"{folder}/grey/model.safetensors", data, *judge],
            "evaluate hybrid": ["evaluate", f"{folder}/hybrid/model.safetensors", data, *judge],
        }
        whole_command(sources[-1], [*best, "--out", f"{folder}/grey"])
        whole_command(sources[-1], [*hybrid, "--out", f"{folder}/hybrid"])
        for name, arguments in wanted.items():
            if only and name not in only:
                continue
            seconds: dict[str, list[float]] = {str(source): [] for source in sources}
            for _ in range(rounds):
                for source in sources:
                    seconds[str(source)].append(whole_command(source, arguments))
            medians = {source: round(median(s), 1) for source, s in seconds.items()}
            print(json.dumps({name: medians}), flush=True)


def main() -> None:
    """Reads the arguments, measures, prints."""
    parser = argparse.ArgumentParser()
    parser.add_argument("parts", nargs="*", default=list(PARTS))
    parser.add_argument("--source", type=Path, nargs="+")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", nargs="+", default=[])
    given = parser.parse_args()
    if given.parts[:1] == ["commands"]:
        here = Path(tn.__file__).parents[1]
        sources = [path.resolve() for path in given.source or [here]]
        commands(given.parts[1], sources, given.rounds, given.only)
        return
    if len(given.parts) > 1:  # each in a process of its own: nothing is compiled before
        for name in given.parts:
            subprocess.run([sys.executable, __file__, name], check=True)
        return
    print(json.dumps({given.parts[0]: PARTS[given.parts[0]]()}))


if __name__ == "__main__":
    main()
