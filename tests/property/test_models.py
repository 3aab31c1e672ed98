"""Properties that every model must have, whatever its weights."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import Scaling
from tustinnet.models.contract import with_dtype
from tustinnet.simulate.rollout import rollout

COORDINATES = (tn.Coordinate("arm", "angular"), tn.Coordinate("slide", "linear"))
INPUTS = (tn.Input("voltage", "V"),)


def network(seed: int, dt: float) -> TustinNet:
    scaling = Scaling(jnp.zeros(1), jnp.ones(1), jnp.ones(2), jnp.ones(1), 5 * jnp.ones(2))
    model = random_tustin_net(
        tn.Channels(COORDINATES, INPUTS, dt), scaling, jax.random.key(seed), hidden=(6, 5), stem=4
    )
    return with_dtype(model, np.float64)


def random_run(model: TustinNet, seed: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    u = generator.normal(size=(steps, 1))
    return np.asarray(rollout(model, jnp.asarray(generator.normal(size=4)), jnp.asarray(u))), u


@pytest.mark.thorough
@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**20), dt=st.floats(1e-4, 0.1))
def test_positions_follow_the_trapezoidal_rule_to_machine_precision(seed, dt):
    x, _ = random_run(network(seed, dt), seed, 40)
    q, v = x[:, :2], x[:, 2:]
    residual = q[1:] - q[:-1] - dt * (v[1:] + v[:-1]) / 2
    scale = np.abs(q).max() + dt * np.abs(v).max()
    assert np.abs(residual).max() <= 4 * np.finfo(float).eps * scale


@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 2**20))
def test_folding_keeps_the_whole_rollout(seed):
    model = network(seed, 0.01)
    x, u = random_run(model, seed, 60)
    folded = rollout(model.simplify(), jnp.asarray(x[0]), jnp.asarray(u))
    np.testing.assert_allclose(folded, x, rtol=1e-9, atol=1e-12)


@settings(deadline=None, max_examples=3)
@given(seed=st.integers(0, 2**20))
def test_vmap_equals_a_loop(seed):
    model = network(seed, 0.01)
    runs = [random_run(model, seed + i, 20) for i in range(3)]
    x0 = jnp.stack([jnp.asarray(x[0]) for x, _ in runs])
    u = jnp.stack([jnp.asarray(u) for _, u in runs])
    together = jax.vmap(lambda a, b: rollout(model, a, b))(x0, u)
    np.testing.assert_allclose(together, np.stack([x for x, _ in runs]), rtol=1e-12, atol=1e-13)


@pytest.mark.thorough
def test_gradient_equals_finite_differences():
    model = network(3, 0.01)
    x, u = random_run(model, 3, 25)

    def energy(weight):
        moved = eqx.tree_at(lambda m: m.network.output.weight, model, weight)
        return jnp.sum(rollout(moved, jnp.asarray(x[0]), jnp.asarray(u))[:, :2] ** 2)

    weight = model.network.output.weight
    gradient = jax.grad(energy)(weight)
    h = 1e-6
    for i, j in [(0, 0), (1, 3)]:
        up, down = weight.at[i, j].add(h), weight.at[i, j].add(-h)
        estimate = (energy(up) - energy(down)) / (2 * h)
        np.testing.assert_allclose(gradient[i, j], estimate, rtol=1e-5)


@pytest.mark.thorough
def test_a_long_rollout_and_its_gradient_equal_the_plain_ones(monkeypatch):
    model = network(5, 0.01)
    x, u = random_run(model, 5, 75)

    def energy(m):
        return jnp.sum(rollout(m, jnp.asarray(x[0]), jnp.asarray(u))[:, :2] ** 2)

    plain, gradient = eqx.filter_value_and_grad(energy)(model)
    monkeypatch.setattr("tustinnet.simulate.rollout.LONG_ROLLOUT", 10)
    long, other = eqx.filter_value_and_grad(energy)(model)
    np.testing.assert_allclose(long, plain, rtol=1e-12)
    for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(other), strict=True):
        assert np.linalg.norm(a - b) <= 1e-12 * np.linalg.norm(a)
