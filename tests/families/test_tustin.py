"""The Tustin-Net as the paper's equations define it."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import (
    ACTIVATIONS,
    Affine,
    Scaling,
    feature_count,
    fold,
    learn_scaling,
)
from tustinnet.models.contract import require_fit, with_dtype
from tustinnet.registry import FAMILIES
from tustinnet.simulate.along import states_along
from tustinnet.simulate.rollout import rollouts
from tustinnet.store.header import read_description

MIXED = (tn.Coordinate("cart", "linear"), tn.Coordinate("pole", "angular"))
FORCE = (tn.Input("force", "N"),)


def unit_scaling(coordinates: tuple[tn.Coordinate, ...], inputs: int) -> Scaling:
    linear = sum(c.kind == "linear" for c in coordinates)
    n_q = len(coordinates)
    return Scaling(
        jnp.zeros(linear), jnp.ones(linear), jnp.ones(n_q), jnp.ones(inputs), jnp.ones(n_q)
    )


def network(
    coordinates: tuple[tn.Coordinate, ...] = MIXED,
    inputs: tuple[tn.Input, ...] = FORCE,
    seed: int = 0,
    **options,
) -> TustinNet:
    scaling = unit_scaling(coordinates, len(inputs))
    channels = tn.Channels(coordinates, inputs, 0.01)
    return random_tustin_net(
        channels, scaling, jax.random.key(seed), **{"hidden": (8, 6), **options}
    )


def test_step_is_the_papers_equations_written_out():
    model = with_dtype(
        network((tn.Coordinate("a", "angular"), tn.Coordinate("b", "angular"))), np.float64
    )
    q, v, u = np.array([0.3, 4.0]), np.array([-1.0, 2.0]), np.array([0.7])
    z = np.concatenate([np.sin(q), np.cos(q), v, u])
    for layer in model.network.hidden:
        z = np.asarray(layer.weight) @ z + np.asarray(layer.bias)
        z = np.where(z > 0, z, 0.01 * z)
    v_next = v + 0.01 * np.asarray(model.network.output.weight) @ z
    q_next = q + 0.01 * (v + v_next) / 2
    x = model.step(jnp.concatenate([q, v]), jnp.asarray(u))
    np.testing.assert_allclose(x, np.concatenate([q_next, v_next]), rtol=1e-13)


def test_output_has_no_bias_unless_asked_for():
    assert network().network.output.bias is None
    assert network(output_bias=True).network.output.bias is not None


def test_linear_coordinates_enter_as_they_are_and_angles_by_sine_and_cosine():
    model = network()
    x, u = jnp.array([2.0, 0.5, 3.0, 4.0]), jnp.array([5.0])
    features = model.scaling.features(model.channels, x, u)
    expected = [np.sin(0.5), np.cos(0.5), 2.0, 3.0, 4.0, 5.0]
    np.testing.assert_allclose(features, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("coordinates", "inputs", "count"),
    [
        (MIXED, FORCE, 6),
        ((tn.Coordinate("a", "angular"), tn.Coordinate("b", "angular")), FORCE, 7),
        ((tn.Coordinate("a", "angular"),), (), 3),
        ((tn.Coordinate("x", "linear"),), (*FORCE, tn.Input("brake", "N")), 4),
    ],
)
def test_any_number_of_coordinates_and_inputs(coordinates, inputs, count):
    assert feature_count(tn.Channels(coordinates, inputs)) == count
    model = network(coordinates, tuple(tn.Input(f"u{i}", "V") for i in range(len(inputs))))
    x = model.step(jnp.ones(2 * len(coordinates)), jnp.ones(len(inputs)))
    assert x.shape == (2 * len(coordinates),)
    assert bool(jnp.all(jnp.isfinite(x)))


@pytest.mark.parametrize("hidden", [(5,), (7, 5), (4, 6, 3)])
def test_any_number_of_hidden_layers(hidden):
    model = network(hidden=hidden)
    assert [layer.weight.shape[0] for layer in model.network.hidden] == list(hidden)


def test_angles_a_full_turn_apart_move_alike():
    model = with_dtype(
        network((tn.Coordinate("a", "angular"), tn.Coordinate("b", "angular"))), np.float64
    )
    x, u = jnp.array([0.3, -2.0, 1.0, 0.5]), jnp.array([0.2])
    turned = x + jnp.array([2 * jnp.pi, -4 * jnp.pi, 0.0, 0.0])
    np.testing.assert_allclose(model.step(turned, u)[2:], model.step(x, u)[2:], atol=1e-12)


@pytest.mark.parametrize("activation", sorted(ACTIVATIONS))
def test_activation_is_chosen(activation):
    x = network(activation=activation).step(jnp.ones(4), jnp.ones(1))
    assert bool(jnp.all(jnp.isfinite(x)))


def test_unknown_activation_is_refused_with_the_known_ones():
    with pytest.raises(tn.InputError, match=r"unknown 'step'.*leaky_relu"):
        network(activation="step")


def test_folding_the_stem_changes_nothing():
    model = with_dtype(network(stem=9), np.float64)
    x, u = jnp.array([0.1, 0.2, -0.5, 0.9]), jnp.array([0.4])
    assert model.network.stem is not None
    assert model.simplify().network.stem is None
    np.testing.assert_allclose(model.simplify().step(x, u), model.step(x, u), rtol=1e-12)


def test_fold_composes_affine_maps_with_and_without_bias():
    first = Affine(jnp.array([[1.0, 2.0], [0.0, 1.0]]), jnp.array([1.0, -1.0]))
    second = Affine(jnp.array([[3.0, 1.0]]), None)
    z = jnp.array([0.5, 2.0])
    np.testing.assert_allclose(fold(first, second)(z), second(first(z)))


def test_layers_that_do_not_fit_are_refused():
    model = network()
    with pytest.raises(tn.InputError, match="layer takes"):
        eqx.tree_at(lambda n: n.hidden, model.network, model.network.hidden[::-1]).__check_init__()


def test_scaling_is_learnt_from_the_records(pendulum):
    train = list(pendulum.split("train"))
    scaling = learn_scaling(train)
    v = np.concatenate([e.velocities() for e in train])
    np.testing.assert_allclose(scaling.velocity, np.sqrt(np.mean(v**2, axis=0)), rtol=1e-6)
    u = np.concatenate([e.u for e in train])
    np.testing.assert_allclose(scaling.input, np.sqrt(np.mean(u**2, axis=0)), rtol=1e-6)
    assert scaling.position_scale.shape == (0,)


def test_scaling_of_a_signal_that_never_acts_is_one():
    q = np.sin(np.arange(50) * 0.1)
    still = tn.from_arrays(q, np.zeros(50), dt=0.1, coordinates={"a": "angular"}, inputs={"u": "V"})
    assert learn_scaling([still]).input.tolist() == [1.0]


def test_a_model_refuses_other_coordinates_inputs_and_periods(pendulum):
    model = network((tn.Coordinate("angle", "angular"),), (tn.Input("torque", "N m"),))
    with pytest.raises(tn.InputError, match=r"sampling period 0\.02 s; expected 0\.01 s"):
        require_fit(model, pendulum[0])
    other = network((tn.Coordinate("height", "linear"),), (tn.Input("torque", "N m"),))
    with pytest.raises(tn.InputError, match=r"angle \(angular\).*height \(linear\)"):
        require_fit(other, pendulum[0])
    unforced = network((tn.Coordinate("angle", "angular"),), ())
    with pytest.raises(tn.InputError, match=r"inputs torque.*\(none\)"):
        require_fit(unforced, pendulum[0])


def test_internal_states_relax_and_follow_the_velocity():
    times = (0.2, 1.0)
    scaling = dataclasses.replace(unit_scaling(MIXED, 1), memory=jnp.ones(4, jnp.float32))
    model = random_tustin_net(
        tn.Channels(MIXED, FORCE, 0.01),
        scaling,
        jax.random.key(0),
        hidden=(5,),
        relaxation_times=times,
    )
    model = with_dtype(model, np.float64)
    assert model.state_size == 8
    assert model.internal[1:3] == ("pole, relaxing in 0.2 s", "cart, relaxing in 1 s")
    x = jnp.asarray(np.linspace(-1.0, 1.0, 8))
    following = np.asarray(model.step(x, jnp.ones(1)))
    speed = (np.asarray(x[2:4]) + following[2:4]) / 2
    left = np.exp(-0.01 / np.repeat(times, 2))
    expected = left * np.asarray(x[4:]) + np.repeat(times, 2) * (1 - left) * np.tile(speed, 2)
    np.testing.assert_allclose(following[4:], expected, rtol=1e-12)


def test_the_network_sees_internal_states_in_their_unit(pendulum):
    records = list(pendulum.split("train"))
    scaling = learn_scaling(records, relaxation_times=(0.5,))
    model = random_tustin_net(
        pendulum.channels, scaling, jax.random.key(0), hidden=(5,), relaxation_times=(0.5,)
    )
    z = np.concatenate(states_along(model, records, "auto"))[:, 2:]
    np.testing.assert_allclose(scaling.memory, np.sqrt(np.mean(z**2, axis=0)), rtol=1e-2)
    x, u = jnp.array([0.1, 0.2, 0.3]), jnp.zeros(1)
    seen = model.scaling.features(model.channels, x, u)
    np.testing.assert_allclose(seen[3], 0.3 / scaling.memory[0], rtol=1e-6)


@pytest.mark.parametrize("time", [0.0, -1.0])
def test_relaxation_times_are_positive(time):
    with pytest.raises(tn.InputError, match="relaxation times"):
        network(relaxation_times=(time,))


def remembering(**changed) -> TustinNet:
    """Two relaxation times; the cart rests at 1 m, the pole hangs."""
    options = {
        "relaxation_times": (0.2, 1.0),
        "remembered": 0.5,
        "rest": jnp.array([1.0, jnp.pi]),
    } | changed
    own = {key: options.pop(key) for key in ("remembered", "rest")}
    memory = 2 * len(options["relaxation_times"])
    scaling = dataclasses.replace(unit_scaling(MIXED, 1), memory=0.1 * jnp.arange(1.0, memory + 1))
    channels = tn.Channels(MIXED, FORCE, 0.01)
    net = random_tustin_net(channels, scaling, jax.random.key(0), hidden=(5,), **options)
    return dataclasses.replace(net, **own)


def test_internal_states_begin_with_a_share_of_the_way_from_rest():
    model = with_dtype(remembering(), np.float64)
    lifted = jnp.array([1.4, -3.0, 0.7, 0.2])  # beyond the bottom the way round is the short one
    expected = [0.2, (np.pi - 3.0) / 2] * 2
    np.testing.assert_allclose(model.initial_internal(lifted), expected, rtol=1e-6)
    np.testing.assert_array_equal(model.initial_state(lifted)[:4], lifted)
    np.testing.assert_allclose(model.simplify().initial_state(lifted)[4:], expected, rtol=1e-6)
    np.testing.assert_allclose(model.internal_spread, [0.01, 0.02, 0.03, 0.04], rtol=1e-6)
    forgetful = remembering(remembered=0.0, rest=None)
    assert not np.asarray(forgetful.initial_internal(lifted)).any()


def test_what_is_remembered_is_kept_in_the_file(tmp_path):
    model = remembering()
    tn.save(model, tmp_path / "m.safetensors")
    again = tn.load_model(tmp_path / "m.safetensors")
    assert isinstance(again, TustinNet)
    assert again.remembered == 0.5
    np.testing.assert_array_equal(again.rest, model.rest)
    told = dict(read_description(tmp_path / "m.safetensors")[1])
    assert told["memory"] == "relaxing in 0.2 s, 1 s; begins with 0.5 of the way from (1, 3.14)"


@pytest.mark.parametrize("changed", [{"rest": None}, {"remembered": 0.0}, {"relaxation_times": ()}])
def test_a_share_needs_memory_and_rest(changed):
    with pytest.raises(tn.InputError, match="remembered"):
        remembering(**changed)


def test_a_recipe_with_memory_remembers_half_unless_it_says_otherwise(pendulum):
    train = tuple(e[:60] for e in pendulum.split("train"))
    for changes, share in (
        ([], 0.5),
        (["model.remembered=0.2"], 0.2),
        (["model.remembered=0"], 0.0),
    ):
        recipe = tn.read_recipe("standard", ["model.memory=[0.2]", "model.hidden=[4]", *changes])
        model = FAMILIES["tustin-net"].builder(recipe.model, train, "stencil", None)(
            jax.random.key(0)
        )
        assert isinstance(model, TustinNet)
        x = jnp.array([0.9, 0.0])
        rest = np.median(np.concatenate([e.q for e in train]))
        expected = share * (0.9 - rest)
        np.testing.assert_allclose(model.initial_internal(x), [expected], rtol=1e-5, atol=1e-9)


@pytest.mark.thorough
def test_a_linear_map_beside_the_network_begins_as_least_squares_say(pendulum, tmp_path):
    train = tuple(e[:60] for e in pendulum.split("train"))
    recipe = tn.read_recipe("standard", ["model.linear=true", "model.hidden=[4]"])
    model = FAMILIES["tustin-net"].builder(recipe.model, train, "stencil", None)(jax.random.key(0))
    assert isinstance(model, TustinNet)
    x = jnp.asarray(np.concatenate([e.measured_states("stencil")[:-1] for e in train]))
    u = jnp.asarray(np.concatenate([e.held_inputs for e in train]))
    change = np.concatenate([np.diff(e.velocities("stencil"), axis=0) for e in train])
    left = change - model.dt * np.asarray(jax.vmap(model.acceleration)(x, u))
    features = jax.vmap(lambda x, u: model.network.scaling.features(model.channels, x, u))(x, u)
    assert np.abs(np.asarray(features).T @ left).max() < 1e-4 * np.abs(change).max() * len(x)
    assert left.std() < 0.5 * change.std()
    tn.save(model, tmp_path / "m.safetensors")
    again = tn.load_model(tmp_path / "m.safetensors")
    np.testing.assert_array_equal(again.step(x[0], u[0]), model.step(x[0], u[0]))
    assert model.network.bypass in model.network.trainable_layers(1)


def test_an_odd_network_accelerates_a_mirrored_mechanism_to_the_other_side(tmp_path):
    model = with_dtype(network(odd=True, stem=3), np.float64)
    x, u = jnp.array([0.4, -2.0, 1.0, 0.5]), jnp.array([0.7])
    np.testing.assert_allclose(model.step(-x, -u), -model.step(x, u), rtol=1e-12)
    assert float(jnp.abs(model.acceleration(x, u)).min()) > 1e-3
    np.testing.assert_allclose(model.simplify().step(x, u), model.step(x, u), rtol=1e-12)
    tn.save(model, tmp_path / "m.safetensors")
    again = tn.load_model(tmp_path / "m.safetensors")
    np.testing.assert_array_equal(again.step(x, u), model.step(x, u))


def test_an_odd_network_has_no_bias_of_its_output():
    with pytest.raises(tn.InputError, match="odd, with a bias"):
        network(odd=True, output_bias=True)


@pytest.mark.thorough
def test_an_odd_network_trains_as_its_gradient_says():
    model = with_dtype(network(odd=True, linear=True), np.float64)
    x = jnp.array([[0.4, -2.0, 1.0, 0.5], [0.1, 0.3, -0.2, 2.0]])
    u = jnp.full((2, 7, 1), 0.7)
    together = jax.grad(lambda m: jnp.sum(rollouts(m, x, u) ** 2))(model)
    alone = jax.grad(lambda m: jnp.sum(jax.vmap(lambda *of: tn.rollout(m, *of))(x, u) ** 2))(model)
    for ours, plain in zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(ours, plain, rtol=1e-10, atol=1e-14)


def test_a_linear_map_beside_an_odd_network_is_fitted_to_the_odd_features(pendulum):
    train = tuple(e[:60] for e in pendulum.split("train"))
    changes = ["model.linear=true", "model.hidden=[4]", "model.odd=true"]
    recipe = tn.read_recipe("standard", changes)
    model = FAMILIES["tustin-net"].builder(recipe.model, train, "stencil", None)(jax.random.key(0))
    assert isinstance(model, TustinNet)
    beside = model.network.bypass
    assert beside is not None
    cosines = slice(1, 2)
    np.testing.assert_allclose(np.asarray(beside.weight)[:, cosines], 0.0, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(beside.bias), 0.0)
    x = jnp.asarray(np.concatenate([e.measured_states("stencil")[:-1] for e in train]))
    u = jnp.asarray(np.concatenate([e.held_inputs for e in train]))
    change = np.concatenate([np.diff(e.velocities("stencil"), axis=0) for e in train])
    left = change - model.dt * np.asarray(jax.vmap(model.acceleration)(x, u))
    assert left.std() < 0.5 * change.std()
