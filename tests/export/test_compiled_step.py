"""One step at a time, compiled, is the model's step."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import ACTIVATIONS, Scaling, random_affine
from tustinnet.models.contract import with_dtype

ARM = tn.Coordinate("arm", "angular")
SLIDE = tn.Coordinate("slide", "linear")
ELBOW = tn.Coordinate("elbow", "angular")


def network(coordinates, activation="leaky_relu", **options):
    linear = sum(c.kind == "linear" for c in coordinates)
    n_q = len(coordinates)
    scaling = Scaling(
        0.3 * jnp.ones(linear),
        2.0 * jnp.ones(linear),
        jnp.arange(1.0, n_q + 1),
        3 * jnp.ones(1),
        jnp.arange(5.0, n_q + 5),
        0.5 * jnp.ones(len(options.get("relaxation_times", ())) * n_q),
    )
    model = random_tustin_net(
        tn.Channels(coordinates, (tn.Input("voltage", "V"),), 0.02),
        scaling,
        jax.random.key(1),
        hidden=(9, 7),
        activation=activation,
        **options,
    )
    return with_dtype(model, np.float64)


@pytest.mark.thorough
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_it_equals_the_models_step_for_every_activation(activation):
    model = network((ARM, SLIDE), activation, stem=5, output_bias=True)
    step = tn.compiled_step(model)
    generator = np.random.default_rng(0)
    for _ in range(5):
        x, u = generator.normal(size=4), generator.normal(size=1)
        np.testing.assert_allclose(
            step(x, u), model.step(jnp.asarray(x), jnp.asarray(u)), rtol=1e-12
        )


@pytest.mark.thorough
@pytest.mark.parametrize("coordinates", [(ARM,), (SLIDE,), (SLIDE, ARM, ELBOW), (ARM, ELBOW)])
def test_it_follows_a_whole_rollout_for_any_mix_of_coordinates(coordinates):
    model = network(coordinates)
    step = tn.compiled_step(model)
    u = np.random.default_rng(1).normal(size=(40, 1))
    x = np.full(2 * len(coordinates), 0.2)
    expected = np.asarray(tn.rollout(model, x, u))
    for k in range(40):
        x = step(x, u[k])
    np.testing.assert_allclose(x, expected[-1], rtol=1e-10)


@pytest.mark.thorough
def test_it_carries_internal_states_along():
    model = network((SLIDE, ARM), relaxation_times=(0.1, 0.7), output_bias=True)
    step, x = tn.compiled_step(model), np.linspace(0.1, 0.8, 8)
    expected = np.asarray(tn.rollout(model, x, np.ones((20, 1))))
    for _ in range(20):
        x = step(x, np.ones(1))
    np.testing.assert_allclose(x, expected[-1], rtol=1e-10)


@pytest.mark.thorough
def test_a_linear_map_beside_the_network_counts():
    model = network((SLIDE, ARM), relaxation_times=(0.1,), linear=True)
    beside = random_affine(*model.network.shape, jax.random.key(2))
    model = with_dtype(eqx.tree_at(lambda m: m.network.bypass, model, beside), np.float64)
    x, u = np.linspace(0.1, 0.6, 6), np.ones(1)
    expected = model.step(jnp.asarray(x), jnp.asarray(u))
    np.testing.assert_allclose(tn.compiled_step(model)(x, u), expected, rtol=1e-12)
    silent = model.with_zero_output().step(jnp.asarray(x), jnp.asarray(u))
    np.testing.assert_array_equal(silent[2:4], x[2:4])


@pytest.mark.parametrize("options", [{}, {"linear": True}])
def test_an_odd_network_is_odd_here_as_well(options):
    model = network((SLIDE, ARM), odd=True, relaxation_times=(0.1,), **options)
    if options:
        beside = random_affine(*model.network.shape, jax.random.key(2))
        model = with_dtype(eqx.tree_at(lambda m: m.network.bypass, model, beside), np.float64)
    x, u = np.linspace(0.1, 0.6, 6), np.ones(1)
    expected = model.step(jnp.asarray(x), jnp.asarray(u))
    np.testing.assert_allclose(tn.compiled_step(model)(x, u), expected, rtol=1e-12)


def test_inputs_and_results_are_left_alone():
    step = tn.compiled_step(network((ARM, ELBOW)))
    x, u = np.ones(4), np.ones(1)
    first = step(x, u)
    kept = first.copy()
    step(2 * x, u)
    np.testing.assert_array_equal(first, kept)
    assert (x == 1).all()
    assert (u == 1).all()


@pytest.mark.parametrize("engine", ["llvm", "jax"])
@pytest.mark.parametrize(
    ("x", "u", "message"),
    [
        (np.zeros(3), np.zeros(1), r"a state of shape \(3,\); expected \(4,\); give all positions"),
        (np.zeros(1), np.zeros(1), r"a state of shape \(1,\); expected \(4,\)"),
        (np.zeros(4), np.zeros(2), r"inputs of shape \(2,\); expected \(1,\)"),
        (np.zeros(4), np.zeros(0), r"inputs of shape \(0,\); expected \(1,\)"),
    ],
)
def test_arrays_of_other_sizes_are_refused(engine, x, u, message, monkeypatch):
    monkeypatch.setenv("TUSTINNET_ENGINE", engine)
    step = tn.compiled_step(network((ARM, ELBOW)))
    with pytest.raises(tn.InputError, match=rf"the model \(TustinNet\): {message}"):
        step(x, u)


def test_a_model_without_inputs_steps():
    system = tn.LagrangianSystem(
        name="mass",
        coordinates=(SLIDE,),
        inputs=(),
        parameters=(),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
    )
    model = tn.LagrangianModel(system, {})
    step = tn.compiled_step(tn.discretise(model, 0.5))
    np.testing.assert_allclose(step(np.array([1.0, 2.0]), np.zeros(0)), [2.0, 2.0])


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["network", "grey box"])
def test_a_compiled_step_equals_the_models_step(kind):
    if kind == "network":
        model = network((ARM, ELBOW), stem=4)
    else:
        system = tn.load_system("qube-servo2-memory")
        values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
        model = tn.discretise(tn.LagrangianModel(system, values), 0.01, substeps=2)
    step = tn.compiled_step(model)
    x, u = np.linspace(0.1, 0.4, model.state_size), np.array([0.5])
    expected = model.step(jnp.asarray(x), jnp.asarray(u))
    following = step(x, u)
    assert isinstance(following, np.ndarray)
    np.testing.assert_allclose(following, expected, rtol=1e-12)
