"""Free runs of a batch: the same values and gradients as one by one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.models.base import with_dtype
from tustinnet.models.network import ACTIVATIONS
from tustinnet.models.tustin import Scaling, TustinNet, random_tustin_net
from tustinnet.simulation.rollout import rollout, rollouts

ANGLE, SLIDE = tn.Coordinate("a", "angular"), tn.Coordinate("s", "linear")


def network(coordinates, hidden, stem, activation, output_bias, seed) -> TustinNet:
    linear = sum(c.kind == "linear" for c in coordinates)
    n_q = len(coordinates)
    scaling = Scaling(
        jnp.full(linear, 0.1, jnp.float32), jnp.full(linear, 0.7, jnp.float32),
        jnp.full(n_q, 2.0, jnp.float32), jnp.full(1, 1.5, jnp.float32),
        jnp.full(n_q, 3.0, jnp.float32),
    )  # fmt: skip
    return random_tustin_net(
        coordinates, (tn.Input("u", "V"),), 0.02, scaling, jax.random.key(seed), hidden=hidden,
        stem=stem, activation=activation, output_bias=output_bias,
    )  # fmt: skip


def one_by_one(model, x0, u):
    return jax.vmap(lambda x, drive: rollout(model, x, drive))(x0, u)


@settings(max_examples=15, deadline=None)
@given(
    coordinates=st.sampled_from([(ANGLE,), (ANGLE, ANGLE), (SLIDE, ANGLE), (SLIDE,)]),
    hidden=st.sampled_from([(7,), (12, 9), (20, 20, 5)]),
    stem=st.sampled_from([None, 6]),
    activation=st.sampled_from(sorted(ACTIVATIONS)),
    output_bias=st.booleans(),
    batch=st.integers(1, 5),
    steps=st.sampled_from([1, 2, 17, 50, 75]),
    double=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_values_and_gradients_are_those_of_the_plain_scan(
    coordinates, hidden, stem, activation, output_bias, batch, steps, double, seed
):
    kind, tolerance = (np.float64, 1e-12) if double else (np.float32, 1e-5)
    model = with_dtype(network(coordinates, hidden, stem, activation, output_bias, seed), kind)
    generator = np.random.default_rng(seed)
    x0 = generator.normal(size=(batch, 2 * len(coordinates))).astype(kind)
    u = generator.normal(size=(batch, steps, 1)).astype(kind)
    target = generator.normal(size=(batch, steps + 1, x0.shape[1])).astype(kind)

    def loss(simulate):
        def of(model, x0, u):
            # folding the stem makes a layer depend on two sets of weights
            states = simulate(model.folded(), x0, u)
            return jnp.mean((states - target) ** 2), states

        return jax.jit(jax.value_and_grad(of, argnums=(0, 1, 2), has_aux=True))(model, x0, u)

    (value, states), gradient = loss(rollouts)
    (expected_value, expected_states), expected = loss(one_by_one)
    size = float(jnp.max(jnp.abs(expected_states)))
    np.testing.assert_allclose(states, expected_states, rtol=0, atol=tolerance * max(size, 1.0))
    np.testing.assert_allclose(value, expected_value, rtol=tolerance)
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True)
    for ours, plain in pairs:
        assert ours.dtype == plain.dtype
        assert jnp.linalg.norm(ours - plain) <= tolerance * jnp.linalg.norm(plain) + 1e-30


def test_frozen_layers_and_models_without_layers_work_too(pendulum):
    model = network((ANGLE,), (5, 4), None, "tanh", True, 0)
    x0, u = jnp.ones((3, 2), jnp.float32), jnp.ones((3, 9, 1), jnp.float32)
    mask = jax.tree.map(lambda leaf: leaf is model.output.weight, model)
    trained, frozen = eqx.partition(model, mask)

    def loss(trained):
        return jnp.sum(rollouts(eqx.combine(trained, frozen), x0, u) ** 2)

    gradient = jax.grad(loss)(trained)
    assert [leaf.shape for leaf in jax.tree.leaves(gradient)] == [model.output.weight.shape]
    system = tn.load_system("qube-servo2")
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    grey = tn.discretise(tn.LagrangianModel(system, values), 0.01, substeps=1)
    start, drive = jnp.zeros((2, 4)).at[:, 1].set(0.3), jnp.zeros((2, 6, 1))
    np.testing.assert_allclose(
        rollouts(grey, start, drive), one_by_one(grey, start, drive), rtol=1e-12
    )


def test_beyond_the_long_horizon_memory_is_saved_instead(monkeypatch):
    monkeypatch.setattr("tustinnet.simulation.rollout.LONG", 10)
    model = network((ANGLE,), (5,), None, "tanh", False, 0)
    x0, u = jnp.ones((2, 2), jnp.float32), jnp.ones((2, 33, 1), jnp.float32)
    np.testing.assert_allclose(rollouts(model, x0, u), one_by_one(model, x0, u), rtol=1e-6)


def test_a_layer_that_acts_twice_is_refused():
    model = network((ANGLE,), (3, 3), None, "tanh", False, 0)

    class Twice(TustinNet):
        def acceleration(self, x, u):
            z = self.hidden[0](self.features(x, u))
            return self.output(self.hidden[1](self.hidden[1](z)))

    fields = {f: getattr(model, f) for f in model.__dataclass_fields__}
    with pytest.raises(tn.InputError, match="acts twice"):
        jax.grad(lambda m: jnp.sum(rollouts(m, jnp.ones((2, 2)), jnp.ones((2, 4, 1)))))(
            Twice(**fields)
        )
