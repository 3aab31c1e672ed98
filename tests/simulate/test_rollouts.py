"""Free runs of a batch: the same values and gradients as one by one."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import ACTIVATIONS, Scaling
from tustinnet.models.contract import with_dtype
from tustinnet.simulate.rollout import rollout, rollouts

ANGLE, SLIDE = tn.Coordinate("a", "angular"), tn.Coordinate("s", "linear")
OTHER = tn.Coordinate("b", "angular")


def network(coordinates, hidden, stem, activation, output_bias, seed) -> TustinNet:
    linear = sum(c.kind == "linear" for c in coordinates)
    n_q = len(coordinates)
    scaling = Scaling(
        jnp.full(linear, 0.1, jnp.float32),
        jnp.full(linear, 0.7, jnp.float32),
        jnp.full(n_q, 2.0, jnp.float32),
        jnp.full(1, 1.5, jnp.float32),
        jnp.full(n_q, 3.0, jnp.float32),
    )
    return random_tustin_net(
        tn.Channels(coordinates, (tn.Input("u", "V"),), 0.02),
        scaling,
        jax.random.key(seed),
        hidden=hidden,
        stem=stem,
        activation=activation,
        output_bias=output_bias,
    )


def one_by_one(model, x0, u):
    return jax.vmap(lambda x, drive: rollout(model, x, drive))(x0, u)


def value_and_gradients(simulate):
    """Loss, states and gradients by model, states and inputs, compiled once a structure."""

    def loss(model, x0, u, target):
        # folding the stem makes a layer depend on two sets of weights
        states = simulate(model.simplify(), x0, u)
        return jnp.mean((states - target) ** 2), states

    return jax.jit(jax.value_and_grad(loss, argnums=(0, 1, 2), has_aux=True))


results_by_batch, results_one_by_one = (
    value_and_gradients(rollouts),
    value_and_gradients(one_by_one),
)

STRUCTURES = [
    ((ANGLE,), (7,), None, "leaky_relu", False, 1, 1, True),
    ((ANGLE, OTHER), (12, 9), 6, "relu", True, 5, 17, False),
    ((SLIDE, ANGLE), (20, 20, 5), 6, "tanh", False, 3, 75, True),
    ((SLIDE,), (12, 9), None, "silu", True, 2, 50, True),
    ((ANGLE, OTHER), (9,), None, "softplus", False, 4, 2, False),
]


def test_every_activation_is_tried():
    assert {structure[3] for structure in STRUCTURES} == set(ACTIVATIONS)


# a program each, which takes longer to compile than to run: few of them, and many weights in each
@pytest.mark.thorough
@pytest.mark.parametrize(
    ("coordinates", "hidden", "stem", "activation", "output_bias", "batch", "steps", "double"),
    STRUCTURES,
)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**20))
def test_values_and_gradients_are_those_of_the_plain_scan(
    coordinates, hidden, stem, activation, output_bias, batch, steps, double, seed
):
    kind, tolerance = (np.float64, 1e-12) if double else (np.float32, 1e-5)
    model = with_dtype(network(coordinates, hidden, stem, activation, output_bias, seed), kind)
    generator = np.random.default_rng(seed)
    x0 = generator.normal(size=(batch, 2 * len(coordinates))).astype(kind)
    u = generator.normal(size=(batch, steps, 1)).astype(kind)
    target = generator.normal(size=(batch, steps + 1, x0.shape[1])).astype(kind)

    (value, states), gradient = results_by_batch(model, x0, u, target)
    (expected_value, expected_states), expected = results_one_by_one(model, x0, u, target)
    size = np.max(np.abs(expected_states))
    np.testing.assert_allclose(states, expected_states, rtol=0, atol=tolerance * max(size, 1.0))
    np.testing.assert_allclose(value, expected_value, rtol=tolerance)
    # by NumPy: JAX compiles for each shape
    found, wanted = (
        [np.asarray(leaf) for leaf in jax.tree.leaves(g)] for g in (gradient, expected)
    )
    whole = np.sqrt(sum(np.sum(leaf.astype(np.float64) ** 2) for leaf in wanted))
    for ours, plain in zip(found, wanted, strict=True):
        assert ours.dtype == plain.dtype
        # a part that cancels has the rounding of what cancelled in it
        near = np.linalg.norm(plain) + 0.1 * whole
        assert np.linalg.norm(ours - plain) <= tolerance * near + 1e-30


@pytest.mark.thorough
def test_frozen_layers_and_models_without_layers_work_too(pendulum):
    model = network((ANGLE,), (5, 4), None, "tanh", True, 0)
    x0, u = jnp.ones((3, 2), jnp.float32), jnp.ones((3, 9, 1), jnp.float32)
    mask = jax.tree.map(lambda leaf: leaf is model.network.output.weight, model)
    trained, frozen = eqx.partition(model, mask)

    def loss(trained):
        return jnp.sum(rollouts(eqx.combine(trained, frozen), x0, u) ** 2)

    gradient = jax.jit(jax.grad(loss))(trained)
    assert [leaf.shape for leaf in jax.tree.leaves(gradient)] == [model.network.output.weight.shape]
    system = tn.load_system("qube-servo2")
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    grey = tn.discretise(tn.LagrangianModel(system, values), 0.01, substeps=1)
    start, drive = jnp.zeros((2, 4)).at[:, 1].set(0.3), jnp.zeros((2, 6, 1))
    together, alone = (jax.jit(way)(grey, start, drive) for way in (rollouts, one_by_one))
    np.testing.assert_allclose(together, alone, rtol=1e-12)


def test_beyond_the_long_horizon_memory_is_saved_instead(monkeypatch):
    monkeypatch.setattr("tustinnet.simulate.rollout.LONG_ROLLOUT", 10)
    model = network((ANGLE,), (5,), None, "tanh", False, 0)
    x0, u = jnp.ones((2, 2), jnp.float32), jnp.ones((2, 33, 1), jnp.float32)
    np.testing.assert_allclose(rollouts(model, x0, u), one_by_one(model, x0, u), rtol=1e-6)


class Twice(TustinNet):
    """Its second layer acts twice a step."""

    def acceleration(self, x, u):
        first, second = self.network.hidden
        z = first(self.scaling.features(self.channels, x, u))
        return self.network.output(jnp.tanh(second(jnp.tanh(second(z)))))


@pytest.mark.thorough
def test_a_layer_that_acts_twice_has_the_gradient_of_both():
    plain = network((ANGLE,), (3, 3), None, "tanh", False, 0)
    model = with_dtype(Twice(plain.network, plain.channels), np.float64)
    x0, u = jnp.ones((2, 2)), jnp.ones((2, 4, 1))

    def gradient(simulate):
        return jax.jit(jax.grad(lambda m: jnp.sum(simulate(m, x0, u) ** 2)))(model)

    pairs = zip(
        jax.tree.leaves(gradient(rollouts)), jax.tree.leaves(gradient(one_by_one)), strict=True
    )
    for ours, expected in pairs:
        np.testing.assert_allclose(ours, expected, rtol=1e-11, atol=1e-13)


@pytest.mark.thorough
@pytest.mark.parametrize("hold", ["zero-order", "first-order", "band-limited"])
def test_constants_of_numpy_in_a_system_work_with_every_hold(hold):
    """Their double precision is that of the state, not of the model without parameters in it."""
    gravity = np.array([1.2])
    inputs = [tn.Input("torque", "N m", hold)]
    system = tn.LagrangianSystem(
        "swing",
        (tn.Coordinate("angle", "angular"),),
        (tn.Input("torque", "N m"),),
        (tn.Parameter("inertia", "kg m^2", 0.1, 0.01, 1.0),),
        kinetic=lambda q, v, p: 0.5 * p["inertia"] * v[0] ** 2,
        potential=lambda q, p: -gravity[0] * jnp.cos(q[0]),
        dissipation=lambda q, v, p: 0.01 * gravity * v,
        input_map=lambda q, v, u, p: u,
    )
    model = tn.discretise(system.model({"inertia": jnp.asarray(0.1)}), 0.02, inputs=inputs)
    record = tn.from_arrays(
        np.linspace(0, 1e-3, 61)[:, None],
        np.sin(np.arange(61.0))[:, None],
        dt=0.02,
        coordinates={"angle": "angular"},
        inputs=inputs,
    )
    signal = tn.input_signal(model, record)
    states = np.asarray(tn.rollout(model, np.array([0.1, 0.0]), signal))
    x, step = jnp.array([0.1, 0.0]), jax.jit(lambda x, u: model.step(x, u))
    for k, u in enumerate(signal.u):
        x = step(x, jnp.asarray(u))
        np.testing.assert_allclose(states[k + 1], x, atol=1e-9)
