"""Linear models about a point."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn

SYSTEM = tn.LagrangianSystem(
    name="pendulum with a cable",
    coordinates=(tn.Coordinate("angle", "angular"), tn.Coordinate("cart", "linear")),
    inputs=(tn.Input("force", "N"),),
    parameters=(tn.Parameter("pull", "N/m", 3.0, 0.0, 10.0),),
    kinetic=lambda q, v, p: v[1] ** 2 + (v[1] + jnp.cos(q[0]) * v[0]) ** 2 + v[0] ** 2,
    potential=lambda q, p: -9.81 * jnp.cos(q[0]),
    dissipation=lambda q, v, p: 0.2 * v,
    input_map=lambda q, v, u, p: jnp.stack([0.0 * u[0], u[0]]),
    memory=tn.Memory(
        ("creep",),
        lambda q, v, z, p: v[1:] - 5.0 * z,
        lambda q, v, z, p: jnp.stack([0.0 * z[0], -p["pull"] * z[0]]),
    ),
)
MODEL = tn.LagrangianModel(SYSTEM, {"pull": jnp.asarray(3.0)})
DISCRETE = tn.discretise(MODEL, 0.01, 2)
X, U = np.array([0.7, -0.2, 1.5, 0.4, 0.1]), np.array([0.6])


def differences(function, at: np.ndarray) -> np.ndarray:
    """Central differences of a function, a column an entry."""
    h = 1e-6
    steps = h * np.eye(len(at))
    return np.stack([(function(at + s) - function(at - s)) / (2 * h) for s in steps], axis=1)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("model", "function"), [(MODEL, MODEL.derivative), (DISCRETE, DISCRETE.step)]
)
def test_matrices_are_the_slopes_of_the_model(model, function):
    result = tn.linearize(model, X, U)
    compiled = eqx.filter_jit(function)

    def at(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.asarray(compiled(jnp.asarray(x), jnp.asarray(u)))

    np.testing.assert_allclose(result.a, differences(lambda x: at(x, U), X), atol=1e-7)
    np.testing.assert_allclose(result.b, differences(lambda u: at(X, u), U), atol=1e-7)
    assert result.a.shape == (5, 5)
    assert result.b.shape == (5, 1)


def test_the_drift_is_how_fast_the_point_moves():
    moving = tn.linearize(MODEL, X, U)
    np.testing.assert_allclose(moving.drift, MODEL.derivative(jnp.asarray(X), jnp.asarray(U)))
    assert moving.dt is None
    step = tn.linearize(DISCRETE, X, U)
    np.testing.assert_allclose(step.drift, DISCRETE.step(jnp.asarray(X), jnp.asarray(U)) - X)
    assert step.dt == 0.01


@pytest.mark.parametrize("model", [MODEL, DISCRETE])
def test_there_is_no_drift_where_it_hangs_at_rest(model):
    result = tn.linearize(model, np.array([0.0, 2.0, 0.0, 0.0, 0.0]), np.zeros(1))
    np.testing.assert_allclose(result.drift, 0.0, atol=1e-15)


@pytest.mark.parametrize(("x", "u"), [((4,), (1,)), ((5,), (2,)), ((5,), (0,))])
def test_points_of_another_size_are_refused(x, u):
    with pytest.raises(tn.InputError, match=r"linearize: x of shape .* \(5,\) and \(1,\)"):
        tn.linearize(MODEL, np.zeros(x), np.zeros(u))


def root_mean_square(errors: list[np.ndarray]) -> float:
    """Of the 2-norms of errors."""
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


# --- a model with memory is simulated and scored like any other ---


@pytest.fixture(scope="module")
def logged() -> tn.Experiment:
    u = np.random.default_rng(0).uniform(-3, 3, (40, 1))
    x = np.asarray(tn.rollout(DISCRETE, np.array([0.5, 0.1, 0.2, -0.3, 0.0]), u[:-1]))
    return tn.from_arrays(
        x[:, :2], u, v=x[:, 2:4], dt=0.01, coordinates=SYSTEM.coordinates, inputs=SYSTEM.inputs
    )


def test_internal_states_start_at_zero(logged):
    (simulated,) = tn.free_run(DISCRETE, [logged], "file")
    assert simulated.shape == (40, 5)
    assert simulated[0, 4] == 0.0
    assert np.abs(simulated[1:, 4]).min() > 0
    assert tn.evaluate(DISCRETE, [logged], "file")[0].rmse < 1e-12


def test_errors_steps_ahead_start_with_the_memory_that_the_record_led_to(logged):
    other = tn.discretise(SYSTEM.model({"pull": jnp.asarray(9.0)}), 0.01, 2)
    result = tn.rmse_ahead(other, [logged], 2, "file")
    state, forgetful, errors = np.zeros(5), [], []
    for k in range(38):
        state[:4] = np.concatenate([logged.q[k], logged.v[k]])
        simulated = np.asarray(tn.rollout(other, state, logged.u[k : k + 2]))
        errors.append(simulated[2, :2] - logged.q[k + 2])
        without = np.asarray(tn.rollout(other, np.append(state[:4], 0.0), logged.u[k : k + 2]))
        forgetful.append(without[2, :2] - logged.q[k + 2])
        state[4] = simulated[1, 4]
    assert result[1] == pytest.approx(root_mean_square(errors))
    assert result[1] != pytest.approx(root_mean_square(forgetful), rel=1e-3)
    # of the model that made the record nothing is left, memory included
    assert np.all(tn.rmse_ahead(DISCRETE, [logged], 2, "file") < 1e-12)


def test_a_model_with_memory_wants_a_whole_state(logged):
    with pytest.raises(tn.InputError, match=r"x0 of shape \(4,\).* \(5,\)"):
        tn.rollout(DISCRETE, np.zeros(4), logged.held_inputs)
