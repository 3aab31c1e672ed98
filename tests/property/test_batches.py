"""Free runs of a batch whose layers act several times a step, or that are put back to a record."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.families.gru import GRU, random_gru
from tustinnet.families.neural_ode import NeuralODE
from tustinnet.models.blocks import Layers, Scaling, feature_count, random_network
from tustinnet.models.contract import with_dtype
from tustinnet.models.integrate import Discretised
from tustinnet.simulate.rollout import rollout, rollouts

RUNS, STEPS = 3, 12
CHANNELS = tn.Channels(
    (tn.Coordinate("arm", "angular"), tn.Coordinate("slide", "linear")), (tn.Input("u", "V"),), 0.05
)
SCALING = Scaling(
    jnp.full(1, 0.2),
    jnp.full(1, 0.7),
    jnp.array([2.0, 1.5]),
    jnp.full(1, 1.5),
    jnp.array([3.0, 5.0]),
)
seeds = given(seed=st.integers(0, 2**20))


def neural_ode(seed: int, substeps: int) -> Discretised:
    layers = Layers(hidden=(5, 4), stem=3, output_bias=True)
    seen, said = feature_count(CHANNELS), 2 * CHANNELS.n_q
    network = random_network(SCALING, jax.random.key(seed), seen, said, layers)
    model = tn.discretise(NeuralODE(network, CHANNELS), CHANNELS.dt, substeps, unrolled=True)
    return with_dtype(model, np.float64)


def gru(seed: int) -> GRU:
    return with_dtype(random_gru(CHANNELS, SCALING, jax.random.key(seed), 4, 6), np.float64)


def material(model: tn.Model, seed: int, known: int = 0) -> tuple[np.ndarray, ...]:
    """Initial states, inputs, states to be compared with, positions and velocities of a record."""
    generator = np.random.default_rng(seed)
    sizes = (
        (RUNS, model.state_size),
        (RUNS, STEPS, 1),
        (RUNS, STEPS + 1, model.state_size),
        (RUNS, known, 2 * CHANNELS.n_q),
    )
    return tuple(generator.normal(size=size) for size in sizes)


def one_by_one(model, x0, u, measured=None):
    if measured is None:
        return jax.vmap(lambda x, drive: rollout(model, x, drive))(x0, u)
    return jax.vmap(lambda x, drive, q: rollout(model, x, drive, q))(x0, u, measured)


def loss(simulate, model, x0, u, target, measured=None):
    states = simulate(model, x0, u, measured)
    return jnp.mean((states - target) ** 2), states


# compiled once; the weights are arguments
@jax.jit
def both(model, x0, u, target, measured=None):
    """Values, states and gradients by model, states and inputs: of batches and of single runs."""
    return tuple(
        jax.value_and_grad(lambda *a, of=of: loss(of, *a), argnums=(0, 1, 2), has_aux=True)(
            model, x0, u, target, measured
        )
        for of in (rollouts, one_by_one)
    )


def require_equal(ours, plain) -> None:
    (value, states), gradient = ours
    (expected_value, expected_states), expected = plain
    np.testing.assert_allclose(value, expected_value, rtol=1e-12)
    np.testing.assert_allclose(states, expected_states, rtol=1e-11, atol=1e-12)
    leaves, wanted = jax.tree.leaves(gradient), jax.tree.leaves(expected)
    assert len(leaves) == len(wanted)
    for a, b in zip(leaves, wanted, strict=True):
        assert a.dtype == b.dtype
        assert jnp.linalg.norm(a - b) <= 1e-11 * jnp.linalg.norm(b)
    assert any(np.any(b) for b in wanted)


@pytest.mark.thorough
@pytest.mark.parametrize("substeps", [1, 2])
@settings(deadline=None, max_examples=5)
@seeds
def test_layers_that_act_at_every_stage_of_a_step_have_the_gradients_of_the_plain_scan(
    substeps, seed
):
    model = neural_ode(seed, substeps)
    x0, u, target, _ = material(model, seed)
    require_equal(*both(model, x0, u, target))


@pytest.mark.thorough
@pytest.mark.parametrize("known", [1, 5, STEPS + 1])
@settings(deadline=None, max_examples=5)
@seeds
def test_runs_put_back_to_a_record_have_the_gradients_of_the_plain_scan(known, seed):
    model = gru(seed)
    x0, u, target, measured = material(model, seed, known)
    require_equal(*both(model, x0, u, target, measured))


@pytest.mark.thorough
@settings(deadline=None, max_examples=5)
@seeds
def test_what_is_measured_takes_the_place_of_what_the_model_said(seed):
    model, known = gru(seed), 5
    x0, u, _, measured = material(model, seed, known)
    states = np.asarray(rollouts(model, x0, u, measured))
    # the first row is x0, but from the first measured sample on the model steps
    np.testing.assert_array_equal(states[:, 0], x0)
    for run in range(RUNS):
        x = x0[run]
        for k in range(STEPS):
            if k < known:
                x = np.concatenate([measured[run, k], x[2 * CHANNELS.n_q :]])
            x = np.asarray(rollout(model, x, u[run, k : k + 1]))[1]
            np.testing.assert_allclose(states[run, k + 1], x, rtol=1e-11, atol=1e-12)
