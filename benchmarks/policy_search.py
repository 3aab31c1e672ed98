"""A policy searched on a model with and without random parameters, tried on twins it never saw.

python benchmarks/control_twins.py fit OUT "grey box"
python benchmarks/policy_search.py OUT

The policy swings the rotary pendulum up by its energy and balances by linear feedback: eight
numbers, which SciPy's differential evolution finds on many environments at once. Then it is played
on twins of the Qube-Servo 2 through their encoders, from 20 starts each, three seeds of the search.
"""

import sys
import time
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

import gymnasium
import numpy as np
import scipy.optimize
from control_twins import GOAL, GREY, SHARES, STARTS, STEPS, folder_of, moved_twins, records, starts

import tustinnet as tn
import tustinnet.control as tc

SEEDS = 3
POPULATION, GENERATIONS = 96, 200
EPISODES, LENGTH = 4, 600  # of each policy; samples
LIMIT = 4.0  # V, as was recorded
KINDS = {"none": False, "from their errors": True, "uniform, 30 %": 0.3}
# gains of theta, alpha, der_theta, der_alpha near upright; where that begins [rad]; gain and
# weight of the energy, and of theta, elsewhere
BOUNDS = [(-10, 10), (-100, 100), (-6, 6), (-12, 12), (0.2, 0.9), (-30, 30), (0.002, 0.02), (-5, 5)]


def policy(parameters: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Voltages at states [theta, alpha, der_theta, der_alpha], alpha 0 upright."""
    theta, alpha, der_theta, der_alpha = x.T
    p = np.atleast_2d(parameters).T
    alpha = np.arctan2(np.sin(alpha), np.cos(alpha))
    near = -(p[0] * theta + p[1] * alpha + p[2] * der_theta + p[3] * der_alpha)
    lack = np.cos(alpha) - 1 + p[6] * der_alpha**2
    far = p[5] * lack * np.sign(der_alpha * np.cos(alpha)) - p[7] * theta
    return np.clip(np.where(np.abs(alpha) < p[4], near, far), -LIMIT, LIMIT)


def search(file: Path, *, randomise: bool | float, seed: int) -> tuple[np.ndarray, float]:
    """The best policy on a model, and the share of the reward that it earns there."""
    count = POPULATION * EPISODES
    envs = gymnasium.make_vec(
        "tustinnet.gym:TustinNet-v0",
        count,
        model=file,
        reward="swing-up",
        randomise=randomise,
        start=[0.0, np.pi, 0.0, 0.0],
        noise=0.02,
        margin=1.0,
    )
    ends = envs.unwrapped.rules.inputs[0]  # pyright: ignore[reportAttributeAccessIssue]
    drawn = np.random.default_rng(seed)

    def cost(columns: np.ndarray) -> np.ndarray:
        """Costs of policies, (8, some) to (some,)."""
        some = columns.reshape(len(BOUNDS), -1).T
        which = np.arange(count) % len(some)
        rows = some[which]
        # every generation has episodes of its own
        x, _ = envs.reset(seed=int(drawn.integers(2**31)))
        earned, alive = np.zeros(count), np.ones(count, bool)
        for _ in range(LENGTH):
            u = policy(rows, x[:, :4])
            x, reward, out, _, _ = envs.step((2 * (u - ends[0]) / np.ptp(ends) - 1)[:, None])
            alive &= ~out
            earned += np.where(alive, reward - 0.05 * np.abs(x[:, 0]), 0.0)
        sums = np.bincount(which, earned, len(some)) / np.bincount(which, minlength=len(some))
        return -sums / LENGTH

    result = scipy.optimize.differential_evolution(
        cost,
        BOUNDS,
        popsize=POPULATION // len(BOUNDS),
        maxiter=GENERATIONS,
        seed=seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        tol=0,
    )
    return result.x, float(-result.fun)


class Policy:
    """A policy as a controller."""

    def __init__(self, parameters: np.ndarray) -> None:
        self._parameters = parameters

    def reset(self) -> None:
        """Does nothing: it remembers nothing."""

    def inputs(self, k: int, x: np.ndarray) -> np.ndarray:
        """The voltage at the estimated state."""
        return policy(self._parameters, x[None, :4])


def main(out: Path) -> None:
    """Prints a row for each kind of randomisation."""
    file = folder_of(out, GREY) / "model.safetensors"
    model, data = tn.load_model(file), tn.load(records(out, driven=False))
    estimator = tc.ExtendedKalmanFilter(model, tc.find_noise(model, list(data.split("train"))))
    print(
        f"| parameters of an episode | reward | of {STARTS} twins moved by 0, 10, 20 % | time [s] |"
    )
    for name, randomise in KINDS.items():
        for seed in range(SEEDS):
            begun = time.perf_counter()
            found, reward = search(file, randomise=randomise, seed=seed)
            seconds = time.perf_counter() - begun
            successes = []
            for share in SHARES:
                kind = tc.VariantKind("twin", "", moved_twins(share, STARTS))
                table = tc.assess_robustness(
                    [kind], Policy(found), estimator, starts(), GOAL, STEPS, seed=77
                )
                successes.append(table.rows[0].successes)
            told = ", ".join(map(str, successes))
            print(f"| {name}, seed {seed} | {reward:.2f} | {told} | {seconds:.0f} |", flush=True)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
