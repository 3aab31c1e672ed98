"""Rollouts by machine code inside of compiled programs: values and gradients are those of JAX."""

import gc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import CHANNELS, LAYERED, NAMES, example, hybrid, network, physics, scaling

import tustinnet as tn
from tustinnet.engine import machine, text, xla
from tustinnet.engine.machine import CompiledModule
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import is_layer
from tustinnet.models.contract import with_dtype
from tustinnet.simulate import engine_rollouts
from tustinnet.simulate.engine_rollouts import layered_steps
from tustinnet.simulate.input_signal import InputSignal
from tustinnet.simulate.rollout import rollouts
from tustinnet.simulate.simulation import simulate_runs

STEPS = 12


@pytest.fixture(autouse=True)
def _small_ones_too(monkeypatch):
    """Steps of a few operations are not left to XLA, where a test does not say otherwise."""
    monkeypatch.setattr(engine_rollouts, "FEWEST_OPERATIONS", 0)
    engine_rollouts._rollouts.cache_clear()
    yield
    engine_rollouts._rollouts.cache_clear()


def drive_shape(model: tn.Model) -> tuple[int, ...]:
    """What a step of the model takes."""
    layout = model.step_layout
    rows = layout.polynomial + layout.mean + len(layout.taps)
    return (rows, model.channels.n_u) if rows > 1 else (model.channels.n_u,)


def layers_of(model: tn.Model) -> list:
    return [leaf for leaf in jax.tree.leaves(model, is_leaf=is_layer) if is_layer(leaf)]


def results(model: tn.Model, x0, u, seeds, *, only_layers: bool):
    """States, and the gradient of a loss of them by the layers and the initial states."""
    mask = jax.tree.map(
        lambda node: jax.tree.map(lambda _: is_layer(node), node), model, is_leaf=is_layer
    )
    trained, rest = eqx.partition(model, mask)

    def loss(given):
        trained, x0 = given
        states = rollouts(eqx.combine(trained, rest), x0, u, only_layers=only_layers)
        return jnp.sum(jnp.sin(states) * seeds), states

    (_, states), gradient = jax.jit(jax.value_and_grad(loss, has_aux=True))((trained, x0))
    return states, gradient


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "batch"),
    # a run alone does not depend on what a step consists of
    [*((name, 11) for name in LAYERED), ("gru", 1), ("hybrid", 1)],
)
def test_every_family_with_layers_has_the_values_and_gradients_of_jax(name, batch):
    model = with_dtype(example(name), np.float64)
    shape = drive_shape(model)
    generator = np.random.default_rng(batch)
    x0 = jnp.asarray(0.3 * generator.normal(size=(batch, model.state_size)))
    u = jnp.asarray(generator.normal(size=(batch, STEPS, *shape)))
    seeds = generator.normal(size=(batch, STEPS + 1, model.state_size))
    assert layered_steps(model, shape, np.float64) is not None
    states, gradient = results(model, x0, u, seeds, only_layers=True)
    expected_states, expected = results(model, x0, u, seeds, only_layers=False)
    np.testing.assert_allclose(states, expected_states, rtol=1e-10, atol=1e-11)
    for ours, theirs in zip(*map(jax.tree.leaves, (gradient, expected)), strict=True):
        size = np.max(np.abs(theirs), initial=1e-300)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-10 * size)


def test_all_families_with_layers_are_among_them():
    assert [name for name in NAMES if layers_of(example(name))] == list(LAYERED)


@pytest.mark.thorough
def test_single_precision_stays_single():
    model = with_dtype(hybrid(0), np.float32)
    x0, u = jnp.full((5, model.state_size), 0.2, jnp.float32), jnp.ones((5, STEPS, 1), jnp.float32)
    states, gradient = results(model, x0, u, 1.0, only_layers=True)
    expected_states, expected = results(model, x0, u, 1.0, only_layers=False)
    assert states.dtype == np.float32
    np.testing.assert_allclose(states, expected_states, rtol=1e-5, atol=1e-6)
    for ours, theirs in zip(*map(jax.tree.leaves, (gradient, expected)), strict=True):
        assert ours.dtype == np.float32
        size = np.max(np.abs(theirs))
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4 * size)


def test_a_run_that_leaves_all_bounds_is_seen():
    model = with_dtype(network(0), np.float32)
    wild = eqx.tree_at(lambda m: m.network.output.weight, model, replace_fn=lambda w: 1e30 * w)
    x0, u = jnp.ones((3, 2), jnp.float32), jnp.ones((3, STEPS, 1), jnp.float32)
    states = jax.jit(lambda m: rollouts(m, x0, u, only_layers=True))(wild)
    assert not np.isfinite(states).all()


def test_members_side_by_side_are_done_one_by_one():
    models = [with_dtype(network(seed), np.float64) for seed in (0, 1)]
    together = jax.tree.map(lambda *arrays: jnp.stack(arrays), *models)
    x0, u = jnp.ones((3, 2)), jnp.ones((3, STEPS, 1))

    def run(model):
        return rollouts(model, x0, u, only_layers=True)

    both = jax.jit(jax.vmap(run))(together)
    for model, states in zip(models, both, strict=True):
        np.testing.assert_allclose(states, jax.jit(run)(model), rtol=1e-12)


@pytest.mark.thorough
def test_what_machine_code_cannot_do_is_left_to_jax(monkeypatch):
    assert layered_steps(physics(), (1,), np.float64) is None  # no layers

    class Turning(tn.TustinNet):
        def step(self, x, u):
            following = super().step(x, u)
            return jnp.sort(following)

    plain = with_dtype(network(0), np.float64)
    sorting = Turning(plain.network, plain.channels)
    assert layered_steps(sorting, (1,), np.float64) is None  # no program can hold it
    x0, u = jnp.ones((2, 2)), jnp.ones((2, STEPS, 1))
    np.testing.assert_array_equal(
        rollouts(sorting, x0, u, only_layers=True), rollouts(sorting, x0, u)
    )
    monkeypatch.setenv("TUSTINNET_ENGINE", "jax")
    assert layered_steps(plain, (1,), np.float64) is None


def test_networks_without_physics_are_left_to_xla(monkeypatch):
    monkeypatch.setattr(engine_rollouts, "FEWEST_OPERATIONS", 200)
    assert layered_steps(with_dtype(network(0), np.float64), (1,), np.float64) is None
    assert layered_steps(with_dtype(hybrid(0), np.float64), (1,), np.float64) is not None


def test_machine_code_that_is_dropped_leaves_the_next_unharmed():
    code = "define void @f() {{\nentry:\nret void\n}}\n; {}\n"
    for i in range(3):
        CompiledModule(code.format(i))
        gc.collect(1)  # what is new; all that other tests have made would take seconds


def test_code_is_registered_once_though_it_left_the_cache_of_compiled_modules():
    xla.available.cache_clear()
    assert xla.available()
    machine._compile.cache_clear()
    xla.available.cache_clear()
    assert xla.available()


def test_a_jax_that_calls_no_machine_code_trains_by_xla_and_says_so_once(monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise ValueError("unknown interface 0.1")

    xla.available.cache_clear()
    monkeypatch.setattr("jax.ffi.ffi_call", refuse)
    with pytest.warns(UserWarning, match=r"does not call machine code \(.*unknown interface 0\.1"):
        assert layered_steps(with_dtype(hybrid(0), np.float64), (1,), np.float64) is None
    xla.available.cache_clear()


def test_wide_layers_have_memory_beyond_the_stack(monkeypatch):
    monkeypatch.setattr(text, "_STACK", 2**12)  # bytes: with fewer, narrower layers are beyond it
    wide = random_tustin_net(CHANNELS, scaling(), jax.random.key(0), hidden=(200, 3))
    model = with_dtype(wide, np.float64)
    x0, u = jnp.full((3, 2), 0.3), jnp.ones((3, STEPS, 1))
    result, expected = (results(model, x0, u, 1.0, only_layers=fast) for fast in (True, False))
    for ours, theirs in zip(*map(jax.tree.leaves, (result, expected)), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    free = simulate_runs(model, np.asarray(x0), InputSignal(np.asarray(u)))
    np.testing.assert_allclose(free, expected[0], rtol=1e-9, atol=1e-9)
