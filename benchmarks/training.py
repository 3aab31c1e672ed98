"""An epoch of training, side by side: eager PyTorch, a plain JAX scan, this package.

    python benchmarks/training.py FOLDER     stage 1 of the transfer recipe on measured records

The same windows, the same folded network (7-100-100-2, leaky ReLU), the same number of steps and
the same loss; batches of 32 and of 256. Rates against what a large float32 matrix product reaches
in the same run.
"""

import statistics
import sys
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import optax

import tustinnet as tn
from tustinnet.simulation.rollout import rollout
from tustinnet.training.epoch import compiled_epoch
from tustinnet.training.fit import Plan, plan
from tustinnet.training.losses import window_loss

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


def prepared(folder: str, batch: int) -> Plan:
    """Stage 1 of the public code's transfer recipe without its stem, which folds away."""
    recipe = tn.read_recipe("paper-code-transfer").model_dump()
    recipe["model"]["stem"] = None
    recipe["stages"] = [recipe["stages"][0] | {"batch": batch}]
    return plan(tn.load(folder), tn.Recipe.model_validate(recipe), 0)


def this_package(work: Plan) -> Call:
    """An epoch as the training loop calls it."""
    epoch = compiled_epoch(work.stages[0])
    weights = work.template(0)
    rows = jnp.asarray(work.stages[0].windows.rows)
    rate = jnp.asarray(1e-3, jnp.float32)

    def call() -> None:
        jax.block_until_ready(epoch(weights, rate, rows, work.records)[1])

    return call


def plain_scan(work: Plan, batch: int) -> Call:
    """What one would write in JAX: a jitted step on copied-out windows, called from Python."""
    length, model = work.stages[0].windows.length, work.model
    rows = np.asarray(work.stages[0].windows.rows)
    x = np.stack([np.asarray(work.records.x)[r : r + length + 1] for r in rows])
    u = np.stack([np.asarray(work.records.u)[r : r + length] for r in rows])
    optimiser = optax.adam(1e-3)

    def loss(weights, x, u):  # noqa: ANN001, ANN202
        def one(target, inputs):  # noqa: ANN001, ANN202
            return window_loss(rollout(weights, target[0], inputs), target, model.angular, "state")

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


def eager_torch(work: Plan, batch: int) -> Call:
    """The same as a user of PyTorch would write it."""
    import torch

    length, dt = work.stages[0].windows.length, work.model.dt
    rows = np.asarray(work.stages[0].windows.rows)
    x = torch.tensor(np.stack([np.asarray(work.records.x)[r : r + length + 1] for r in rows]))
    u = torch.tensor(np.stack([np.asarray(work.records.u)[r : r + length] for r in rows]))
    scale = torch.tensor(np.asarray(work.model.scaling.velocity))
    gain = torch.tensor(np.asarray(work.model.scaling.acceleration)) * dt
    net = torch.nn.Sequential(
        torch.nn.Linear(7, HIDDEN), torch.nn.LeakyReLU(0.01), torch.nn.Linear(HIDDEN, HIDDEN),
        torch.nn.LeakyReLU(0.01), torch.nn.Linear(HIDDEN, 2),
    )  # fmt: skip
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


def flops(work: Plan) -> float:
    """Arithmetic of the products of an epoch: forward once, backward twice."""
    windows = work.stages[0].windows
    per_step = 2 * (7 * HIDDEN + HIDDEN * HIDDEN + HIDDEN * 2)
    return 3.0 * per_step * len(windows.rows) * windows.length


def compare(folder: str) -> None:
    """Prints the table."""
    rate = product_rate()
    print(f"large float32 product: {rate / 1e9:.0f} GFLOP/s")
    for batch in (32, 256):
        work = prepared(folder, batch)
        count = len(work.stages[0].windows.rows)
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
        seconds["this package"] = median_seconds(this_package(work))
        torch_best = min((s for n, s in seconds.items() if "PyTorch" in n), default=float("nan"))
        for name, value in seconds.items():
            speed = flops(work) / value
            print(
                f"  {name:<32}{value:8.4f} s an epoch  {torch_best / value:6.1f} x PyTorch"
                f"  {speed / 1e9:6.1f} GFLOP/s  {100 * speed / rate:5.1f} % of the large product"
            )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    compare(sys.argv[1])
