"""Identification, measured: time, starts, recovery and coverage.

python benchmarks/identification.py time FOLDER   seconds on measured records, first and later
python benchmarks/identification.py scipy FOLDER  an iteration, against scipy with solve_ivp
python benchmarks/identification.py starts        20 starts on the twin, within a factor of 3
python benchmarks/identification.py recovery      noise-free twin: relative errors
python benchmarks/identification.py coverage      20 noisy twins: truth inside the 95 % interval
python benchmarks/identification.py memory N R    R records of N samples: memory of the process
"""

import resource
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import tustinnet as tn
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.shooting.problem import Problem
from tustinnet.fitting.shooting.space import make_search_space
from tustinnet.systems import qube_servo2, qube_servo2_twin
from tustinnet.systems.twin import Logger

SYSTEM, TRUTH = qube_servo2.WITH_MEMORY, qube_servo2_twin.TWIN_VALUES
SEARCHED = [p for p in SYSTEM.parameters if not p.fixed]
EXACT = Logger(jitter=0.0, counts=False, substeps=2)
RECIPE = tn.read_recipe("grey", ["search.initial=anchored"])
EXACT_RECIPE = tn.read_recipe(RECIPE, [f"search.substeps={EXACT.substeps}"])


def training_records(seed: int, *, exact: bool) -> tn.DataSet:
    """The twin's training records, through encoders or exactly as simulated."""
    data = qube_servo2_twin.twin(seed, EXACT if exact else Logger())
    records = tuple(data.split("train"))
    if exact:
        records = tuple(
            replace(e, channels=replace(e.channels, coordinates=SYSTEM.coordinates))
            for e in records
        )
    return tn.DataSet(data.name, records)


def errors(result: tn.Identification) -> dict[str, float]:
    """Relative error of every parameter."""
    return {e.name: e.value / TRUTH[e.name] - 1 for e in result.estimates}


def measure_time(folder: str) -> None:
    """The paper's structure on measured training records; the first run compiles."""
    data = tn.load(folder)
    train = tn.DataSet(data.name, tuple(data.split("train")))
    for label, records in (("with the choice by validation", data), ("training only", train)):
        jax.clear_caches()
        seconds = []
        for _ in range(6):
            begun = time.perf_counter()
            result = tn.identify(records, qube_servo2.SYSTEM)
            seconds.append(time.perf_counter() - begun)
        later = statistics.median(seconds[1:])
        print(
            f"{label}: first {seconds[0]:.1f} s, later {later:.2f} s (median of 5, "
            f"{min(seconds[1:]):.2f}..{max(seconds[1:]):.2f}); {result.outcome}"
        )


def starts(count: int = 20) -> None:
    """Starts log-uniform within a factor of 3 either way."""
    data = training_records(0, exact=True)
    generator = np.random.default_rng(0)
    reached = 0
    for k in range(count):
        begin = {
            p.name: float(np.clip(TRUTH[p.name] * 3 ** generator.uniform(-1, 1), p.lower, p.upper))
            for p in SEARCHED
        }
        result = tn.identify(data, SYSTEM, EXACT_RECIPE, begin=begin)
        worst = max(abs(e) for e in errors(result).values())
        reached += worst < 1e-4
        print(f"start {k}: largest relative error {worst:.1e}, {result.outcome}", flush=True)
    print(f"{reached} of {count} reached the truth within 1e-4")


def recovery() -> None:
    """The generator's own integration steps, no encoders, no jitter."""
    result = tn.identify(training_records(0, exact=True), SYSTEM, EXACT_RECIPE)
    for name, error in errors(result).items():
        print(f"{name:<18}{error:+.1e}")


def coverage(count: int = 20) -> None:
    """Fresh initial states, inputs, jitter and encoder phases for every seed."""
    inside: dict[str, list[bool]] = {}
    naive: dict[str, list[bool]] = {}
    for seed in range(100, 100 + count):
        result = tn.identify(training_records(seed, exact=False), SYSTEM, RECIPE)
        for e in result.estimates:
            low, high = e.interval or (np.nan, np.nan)
            inside.setdefault(e.name, []).append(bool(low <= TRUTH[e.name] <= high))
            half = 1.96 * (e.naive_error or np.nan)
            naive.setdefault(e.name, []).append(bool(abs(e.value - TRUTH[e.name]) <= half))
        print(f"seed {seed}: {result.outcome}, {result.seconds:.1f} s", flush=True)
    print(f"{'parameter':<18}{'records':>9}{'J-J':>7}")
    for name in inside:
        print(f"{name:<18}{np.mean(inside[name]):>9.2f}{np.mean(naive[name]):>7.2f}")
    pooled = [np.mean(list(table.values())) for table in (inside, naive)]
    print(f"{'pooled':<18}{pooled[0]:>9.3f}{pooled[1]:>7.3f}")


def numpy_furuta(p: dict[str, float]) -> Callable[..., list[float]]:
    """The paper's structure as one would write it in NumPy: the derivative of [q, v]."""
    hub = p["hub_mass"] * p["hub_radius"] ** 2 / 2
    a1 = p["rotor_inertia"] + hub + p["arm_mass"] * p["arm_length"] ** 2 / 3
    a1 += p["pendulum_mass"] * p["arm_length"] ** 2
    a2 = p["pendulum_mass"] * p["pendulum_centre"] ** 2 + p["pendulum_inertia"]
    a3 = -p["pendulum_mass"] * p["arm_length"] * p["pendulum_centre"]
    a5 = p["pendulum_mass"] * 9.81 * p["pendulum_centre"]
    gain = p["torque_constant"] / p["resistance"]

    def derivative(t: float, x: np.ndarray, u: float) -> list[float]:
        theta, alpha, w, s = x
        sine, cosine = np.sin(alpha), np.cos(alpha)
        arm = -gain * (u + p["back_emf"] * w) - p["arm_damping"] * w
        arm -= p["cable_stiffness"] * theta - p["cable_quadratic"] * theta**2
        arm += -2 * a2 * sine * cosine * w * s + a3 * sine * s**2
        swing = a2 * sine * cosine * w**2 + a5 * sine - p["pendulum_damping"] * s
        m11, m12, m22 = a1 + a2 * sine**2, a3 * cosine, a2
        det = m11 * m22 - m12**2
        return [w, s, (m22 * arm - m12 * swing) / det, (m11 * swing - m12 * arm) / det]

    return derivative


def against_scipy(folder: str) -> None:
    """An iteration: the same residuals of all training records, and their derivatives."""
    data = tn.load(folder)
    records = list(data.split("train"))
    system = qube_servo2.SYSTEM
    space = make_search_space(system, {}, {})
    vector = space.to_vector(system.nominal())
    search = SearchRecipe(initial="file")
    problem = Problem(system, tuple(records), (), search)
    segments = problem.segments(None, "file", {})

    def ours() -> tuple[np.ndarray, ...]:
        return problem.products(space, vector, segments, 2).error

    errors, times = ours(), []
    for _ in range(5):
        begun = time.perf_counter()
        ours()
        times.append(time.perf_counter() - begun)
    begun = time.perf_counter()
    derivative = numpy_furuta(space.to_values_in_range(vector))
    worst = 0.0
    for e, x0, error in zip(records, segments.x0, errors, strict=True):
        q = scipy_run(derivative, e, x0)
        worst = max(worst, float(np.abs(q - e.q - error[: len(e)]).max()))
    one = time.perf_counter() - begun
    theirs, mine = one * (1 + len(vector)), statistics.median(times)
    print(f"largest difference of the two: {worst:.1e} rad")
    print(
        f"scipy: {one:.1f} s for the residuals, {theirs:.0f} s an iteration by finite differences "
        f"of {len(vector)} parameters; here {mine:.3f} s: {theirs / mine:.0f} times"
    )


def memory(samples: int, count: int) -> None:
    """A driven pendulum through an encoder, a time of its own for each of two identifications."""
    pendulum = tn.LagrangianSystem(
        name="pendulum",
        coordinates=(tn.Coordinate("angle", "angular", resolution=2 * np.pi / 4096),),
        inputs=(tn.Input("torque", "N m"),),
        parameters=(
            tn.Parameter("inertia", "kg m^2", 0.05, 0.01, 0.2, fixed=True),
            tn.Parameter("damping", "N m s", 0.04, 1e-3, 1.0),
            tn.Parameter("gravity", "N m", 1.0, 0.1, 10.0),
            tn.Parameter("gain", "1", 0.7, 0.01, 10.0),
        ),
        kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2,
        potential=lambda q, p: -p["gravity"] * jnp.cos(q[0] - 0.4),
        dissipation=lambda q, v, p: p["damping"] * v,
        input_map=lambda q, v, u, p: p["gain"] * u,
    )
    truth = {"inertia": 0.05, "damping": 0.05, "gravity": 1.5, "gain": 1.0}
    model = tn.discretise(pendulum.model({k: jnp.asarray(v) for k, v in truth.items()}), 0.01, 2)
    encoder, experiments = pendulum.coordinates[0].resolution, []
    for i in range(count):
        u = np.random.default_rng(i).uniform(-1, 1, -(-samples // 10)).repeat(10)[:samples, None]
        q = np.asarray(tn.rollout(model, np.array([1.0, 0.0]), u[:-1]))[:, :1]
        read = np.round(q / encoder) * encoder
        experiments.append(
            tn.from_arrays(
                read,
                u,
                dt=0.01,
                name=f"r{i}",
                coordinates=pendulum.coordinates,
                inputs=pendulum.inputs,
            )
        )
    seconds = []
    for _ in range(2):
        begun = time.perf_counter()
        result = tn.identify(tn.DataSet("long", tuple(experiments)), pendulum)
        seconds.append(time.perf_counter() - begun)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{count} x {samples} samples: at most {most:.0f} MiB; first {seconds[0]:.1f} s, "
        f"later {seconds[1]:.2f} s; {result.outcome}"
    )


def scipy_run(
    derivative: Callable[..., list[float]], e: tn.Experiment, x0: np.ndarray
) -> np.ndarray:
    """Positions of a free run: a call as long as the input stays, a new one at every change."""
    x, rows, k = x0, [x0], 0
    while k < len(e) - 1:
        last = k + 1
        while last < len(e) - 1 and e.u[last, 0] == e.u[k, 0]:
            last += 1
        solved = solve_ivp(
            derivative,
            (e.t[k], e.t[last]),
            x,
            "RK45",
            e.t[k + 1 : last + 1],
            rtol=1e-6,
            args=(e.u[k, 0],),
        )
        rows += list(solved.y.T)
        x, k = rows[-1], last
    return np.array(rows)[:, :2]


if __name__ == "__main__":
    verbs = {"starts": starts, "recovery": recovery, "coverage": coverage}
    on_records = {"time": measure_time, "scipy": against_scipy}
    if len(sys.argv) == 4 and sys.argv[1] == "memory":
        memory(int(sys.argv[2]), int(sys.argv[3]))
    elif len(sys.argv) == 3 and sys.argv[1] in on_records:
        on_records[sys.argv[1]](sys.argv[2])
    elif len(sys.argv) == 2 and sys.argv[1] in verbs:
        verbs[sys.argv[1]]()
    else:
        sys.exit(__doc__)
