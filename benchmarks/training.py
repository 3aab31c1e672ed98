"""Training, measured: against PyTorch and plain JAX, many seeds at once, many windows, any device.

python benchmarks/training.py compare FOLDER     an epoch beside eager PyTorch and a plain JAX scan
python benchmarks/training.py seeds FOLDER       8 seeds at once against one after another
python benchmarks/training.py windows FOLDER     an epoch of 1, 10 and 100 times as many windows
python benchmarks/training.py engines FOLDER     networks and hybrids by machine code and by XLA
python benchmarks/training.py throughput FOLDER  1, 32 and 1024 seeds on what JAX prefers (a GPU)

But for `engines`, always stage 1 of the transfer recipe on measured records: the same windows, the
same folded network (7-100-100-2, leaky ReLU), the same number of steps and the same loss. Rates
against what a large float32 matrix product reaches in the same run.
"""

import os
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax

# before the first computation: a device for each core, as the command has it
jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))

import tustinnet as tn
from tustinnet.engine.engines import VARIABLE
from tustinnet.fitting.gradient.epoch import EPOCHS_A_CALL, compile_epochs
from tustinnet.fitting.gradient.plan import TrainingPlan, make_plan
from tustinnet.fitting.gradient.windows import StageWindows
from tustinnet.fitting.task import Member, make_task
from tustinnet.simulate.rollout import rollout

Call = Callable[[], None]

REPETITIONS = 5
HIDDEN = 100


def median_seconds(call: Callable[[], object], repetitions: int = REPETITIONS) -> float:
    """Median time of a call, after one that is not counted."""
    call()
    times = []
    for _ in range(repetitions):
        begun = time.perf_counter()
        call()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


def prepared(folder: str, batch: int, seeds: int = 1) -> TrainingPlan:
    """Stage 1 of the public code's transfer recipe without its stem, which folds away."""
    recipe = tn.read_recipe("paper-code-transfer").model_dump()
    recipe["model"]["stem"] = None
    recipe["stages"] = [recipe["stages"][0] | {"batch": batch}]
    members = [Member(seed) for seed in range(seeds)]
    return make_plan(make_task(tn.load(folder), recipe, members))


def this_package(work: TrainingPlan) -> Call:
    """The epochs of a compiled call as the training loop makes it, without validation."""
    blind = replace(work, validation_runs=None)
    epochs = compile_epochs(blind, blind.stages[0])
    state = work.begin(0)

    def call() -> None:
        jax.block_until_ready(epochs(state, EPOCHS_A_CALL))

    return call


def plain_scan(work: TrainingPlan, batch: int) -> Call:
    """What one would write in JAX: a jitted step on copied-out windows, called from Python."""
    length, model = work.stages[0].windows.length, jax.tree.map(lambda a: a[0], work.models)
    rows = work.stages[0].windows.rows[0]
    x = np.stack([np.asarray(work.records.x)[r : r + length + 1] for r in rows])
    u = np.stack([np.asarray(work.records.u)[r : r + length] for r in rows])
    optimiser = optax.adam(1e-3)

    def loss(weights, x, u):  # noqa: ANN001, ANN202
        def one(target, inputs):  # noqa: ANN001, ANN202
            return work.stages[0].residual.window_loss(rollout(weights, target[0], inputs), target)

        return jnp.mean(jax.vmap(one)(x, u))

    @jax.jit
    def step(weights, state, x, u):  # noqa: ANN001, ANN202
        value, gradient = jax.value_and_grad(loss)(weights, x, u)
        update, state = optimiser.update(gradient, state)
        return optax.apply_updates(weights, update), state, value

    state, generator = optimiser.init(model), np.random.default_rng(0)

    def call() -> None:
        weights, current, order = model, state, generator.permutation(len(rows))
        for begin in range(0, len(rows), batch):
            chosen = order[begin : begin + batch]
            weights, current, value = step(weights, current, x[chosen], u[chosen])
        jax.block_until_ready(value)

    return call


def eager_torch(work: TrainingPlan, batch: int) -> Call:
    """The same as a user of PyTorch would write it."""
    import torch

    length, dt = work.stages[0].windows.length, work.models.dt
    rows = work.stages[0].windows.rows[0]
    x = torch.tensor(np.stack([np.asarray(work.records.x)[r : r + length + 1] for r in rows]))
    u = torch.tensor(np.stack([np.asarray(work.records.u)[r : r + length] for r in rows]))
    scale = torch.tensor(np.asarray(work.models.network.scaling.velocity)[0])
    gain = torch.tensor(np.asarray(work.models.network.scaling.acceleration)[0]) * dt
    net = torch.nn.Sequential(
        torch.nn.Linear(7, HIDDEN),
        torch.nn.LeakyReLU(0.01),
        torch.nn.Linear(HIDDEN, HIDDEN),
        torch.nn.LeakyReLU(0.01),
        torch.nn.Linear(HIDDEN, 2),
    )
    optimiser = torch.optim.Adam(net.parameters(), 1e-3)

    def call() -> None:
        order = torch.randperm(len(rows))
        for begin in range(0, len(rows), batch):
            chosen = order[begin : begin + batch]
            target, inputs = x[chosen], u[chosen]
            q, v = target[:, 0, :2], target[:, 0, 2:]
            positions, velocities = [], []
            for k in range(length):
                features = torch.cat([q.sin(), q.cos(), v / scale, inputs[:, k]], 1)
                v_next = v + gain * net(features)
                q = q + dt / 2 * (v + v_next)
                v = v_next
                positions.append(q)
                velocities.append(v)
            q_all, v_all = torch.stack(positions, 1), torch.stack(velocities, 1)
            periodic = 2 * (1 - torch.cos(q_all - target[:, 1:, :2]))
            loss = (periodic + (v_all - target[:, 1:, 2:]) ** 2).sum(2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()

    return call


def product_rate() -> float:
    """What a large float32 matrix product reaches [FLOP/s]."""
    a = jnp.ones((2048, 2048), jnp.float32)
    product = jax.jit(lambda a: a @ a)
    return 2 * 2048**3 / median_seconds(lambda: jax.block_until_ready(product(a)))


def flops(work: TrainingPlan) -> float:
    """Arithmetic of the products of an epoch: forward once, backward twice."""
    windows = work.stages[0].windows
    per_step = 2 * (7 * HIDDEN + HIDDEN * HIDDEN + HIDDEN * 2)
    return 3.0 * per_step * windows.rows.size * windows.length


def compare(folder: str) -> None:
    """Prints the table."""
    rate = product_rate()
    print(f"large float32 product: {rate / 1e9:.0f} GFLOP/s")
    for batch in (32, 256):
        work = prepared(folder, batch)
        count = work.stages[0].windows.rows.size
        print(f"batch {batch}, {count} windows of {work.stages[0].windows.length}")
        seconds: dict[str, float] = {}
        try:
            import torch

            for threads in (1, 2):
                torch.set_num_threads(threads)
                name = f"eager PyTorch, {threads} thread{'s' if threads > 1 else ''}"
                seconds[name] = median_seconds(eager_torch(work, batch))
        except ImportError:
            print("  PyTorch is not installed: pip install 'tustinnet[bench]'")
        seconds["plain JAX scan, a call a batch"] = median_seconds(plain_scan(work, batch))
        seconds["this package"] = median_seconds(this_package(work)) / EPOCHS_A_CALL
        torch_best = min((s for n, s in seconds.items() if "PyTorch" in n), default=float("nan"))
        for name, value in seconds.items():
            speed = flops(work) / value
            print(
                f"  {name:<32}{value:8.4f} s an epoch  {torch_best / value:6.1f} x PyTorch"
                f"  {speed / 1e9:6.1f} GFLOP/s  {100 * speed / rate:5.1f} % of the large product"
            )


def several_seeds(folder: str, seeds: int = 8) -> None:
    """Prints what training seeds together gains, an epoch with validation as in a training."""
    together, alone = prepared(folder, 32, seeds), prepared(folder, 32)
    seconds = {name: seconds_an_epoch(work) for name, work in {"8": together, "1": alone}.items()}
    print(f"an epoch of 1 seed, windows shared by the cores: {seconds['1']:.4f} s")
    print(f"an epoch of {seeds} seeds, a share for each core: {seconds['8']:.4f} s")
    print(f"gain over one after another: {seeds * seconds['1'] / seconds['8']:.2f} x")


def seconds_an_epoch(work: TrainingPlan) -> float:
    """Median time of an epoch with all that a training does in it."""
    epochs = compile_epochs(work, work.stages[0])
    state = work.begin(0)
    return (
        median_seconds(lambda: jax.block_until_ready(epochs(state, EPOCHS_A_CALL))) / EPOCHS_A_CALL
    )


def many_windows(folder: str) -> None:
    """Prints the time of an epoch against the number of windows."""
    work = prepared(folder, 32)
    [stage], per_window = work.stages[:1], {}
    for times in (1, 10, 100):
        rows = np.tile(stage.windows.rows, (1, times))
        longer = replace(stage, windows=StageWindows(rows, stage.windows.length))
        call = this_package(replace(work, stages=(longer,)))
        seconds = median_seconds(call, 5 if times < 100 else 3) / EPOCHS_A_CALL
        per_window[times] = seconds / rows.size
        share = per_window[times] / per_window[1]
        print(
            f"{rows.size:>6} windows: {seconds:8.4f} s an epoch, {1e6 * per_window[times]:6.2f} us "
            f"a window, {share:.3f} of the first"
        )


def engines(folder: str) -> None:
    """Prints epochs of recipes, with validation, by both engines."""
    data = tn.load(folder)
    system = tn.load_system("qube-servo2-turned")
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    physics = tn.discretise(system.model(values), data.experiments[0].dt, 4)
    for name in ("best-tustin", "tustin-memory", "gru", "neural-ode", "best-hybrid"):
        given = physics if name == "best-hybrid" else None
        seconds = {}
        for engine in ("llvm", "jax"):
            os.environ[VARIABLE] = engine
            jax.clear_caches()
            work = make_plan(make_task(data, name, [Member(0)], physics=given))
            begun = time.perf_counter()
            jax.block_until_ready(
                compile_epochs(work, work.stages[0])(work.begin(0), EPOCHS_A_CALL)
            )
            first, each = time.perf_counter() - begun, seconds_an_epoch(work)
            seconds[engine] = first - EPOCHS_A_CALL * each, each
        (compiling, fast), (by_xla, slow) = seconds["llvm"], seconds["jax"]
        print(
            f"{name:<14} an epoch {fast:7.3f} s, by XLA {slow:7.3f} s: {slow / fast:4.1f} x;"
            f" compiling {compiling:5.1f} s, by XLA {by_xla:5.1f} s"
        )


def throughput(folder: str) -> None:
    """Prints what the device makes of 1, 32 and 1024 seeds."""
    device = jax.devices()[0]
    rate = product_rate()
    print(f"{device.device_kind} ({device.platform}), large product {rate / 1e9:.0f} GFLOP/s")
    for seeds in (1, 32, 1024):
        work = prepared(folder, 32, seeds)
        seconds = median_seconds(this_package(work), 3) / EPOCHS_A_CALL
        steps = work.stages[0].windows.rows.size * work.stages[0].windows.length
        print(
            f"{seeds:>5} seeds: {seconds:8.4f} s an epoch, {steps / seconds / 1e6:8.2f} million "
            f"steps a second, {flops(work) / seconds / 1e9:8.1f} GFLOP/s"
        )


VERBS = {
    "compare": compare,
    "seeds": several_seeds,
    "windows": many_windows,
    "engines": engines,
    "throughput": throughput,
}

if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[1] not in VERBS:
        sys.exit(__doc__)
    VERBS[sys.argv[1]](sys.argv[2])
