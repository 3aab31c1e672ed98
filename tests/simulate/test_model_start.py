"""Initial states by least squares through the model."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from every_family import network
from swinging import CREEPING, DT, SWING, TRUTH, swing_model

import tustinnet as tn
from tustinnet.engine.equations import Equations
from tustinnet.families.committee import committee
from tustinnet.models.contract import with_dtype
from tustinnet.simulate.input_signal import input_signal
from tustinnet.simulate.rollout import rollout
from tustinnet.simulate.starts import initial_state, start_named, start_states
from tustinnet.simulate.state_fits import fit_states_with_derivatives, newton_step

SAMPLES = 20


def grey_box(creeping: bool = False, **changed: float) -> tn.LagrangianModel:
    return swing_model(changed, CREEPING if creeping else SWING)


def simulated(model, x0: np.ndarray, counts: int | None = None) -> tn.Experiment:
    """A record of a model's free run, read exactly or by encoders."""
    u = 0.5 * np.sin(np.arange(SAMPLES) * 0.3)[:, None]
    q = np.asarray(rollout(model, x0, u[:-1]))[:, :1]
    if counts:
        step = 2 * np.pi / counts
        q = np.round(q / step) * step
    return tn.from_arrays(
        q, u, dt=DT, coordinates=list(model.coordinates), inputs=list(model.inputs)
    )


@pytest.mark.thorough
@pytest.mark.parametrize("creeping", [False, True])
def test_exact_positions_give_back_the_state_they_came_from(creeping):
    model = tn.discretise(grey_box(creeping), DT, substeps=2)
    truth = np.array([2.5, 3.0])
    padded = np.pad(truth, (0, model.state_size - 2))
    result = start_states(model, [simulated(model, padded)], f"model-{SAMPLES}")[0]
    # an internal state is only known as well as it moves the positions in the first samples
    np.testing.assert_allclose(result[:2], truth, atol=2e-5)
    assert np.all(np.abs(result[2:]) < 1e-3)


def test_encoder_counts_hurt_it_less_than_the_parabola():
    model = tn.discretise(grey_box(), DT, substeps=2)
    errors = {"model-20": [], "derived-6": []}
    for seed in range(10):
        truth = np.random.default_rng(seed).normal(size=2) * [1.5, 4.0]
        e = simulated(model, truth, counts=2048)
        for start, result in errors.items():
            result.append(start_states(model, [e], start)[0] - truth)
    rms = {start: np.sqrt(np.mean(np.square(result), axis=0)) for start, result in errors.items()}
    assert rms["model-20"][1] < 0.3 * rms["derived-6"][1], rms


def test_a_model_that_forgets_its_start_does_not_begin_far_away():
    servo = tn.discretise(grey_box(damping=60 * TRUTH["damping"]), DT, substeps=4)
    e = simulated(servo, np.array([0.3, 0.0]))
    off = replace(e, q=e.q + 0.004 * np.sin(np.arange(SAMPLES) * 0.7)[:, None])  # unmodelled
    start = start_states(servo, [off], f"model-{SAMPLES}")[0]
    assert abs(start[0] - off.q[0, 0]) < 0.02
    assert abs(start[1]) < 1.0


def error_after_a_hand(model, x0: np.ndarray, held_samples: int) -> float:
    """The largest error in the second half of the samples, of which a hand held so many."""
    e = simulated(model, x0, counts=2048)
    q = e.q.copy()
    q[:held_samples] = q[held_samples]  # then the record goes on as simulated
    disturbed = tn.from_arrays(
        q, e.u, dt=DT, coordinates=list(model.coordinates), inputs=list(model.inputs)
    )
    start = start_states(model, [disturbed], f"model-{SAMPLES}")[0]
    run = np.asarray(rollout(model, start, e.u[:-1]))
    return float(np.abs(run[SAMPLES // 2 :, 0] - e.q[SAMPLES // 2 :, 0]).max())


@pytest.mark.parametrize("held_samples", [4, 9])
def test_samples_before_a_release_are_left_out(held_samples):
    model = tn.discretise(grey_box(), DT, substeps=2)
    assert error_after_a_hand(model, np.array([1.0, 2.0]), held_samples) < 2 * np.pi / 2048


@pytest.mark.thorough
def test_internal_states_do_not_lead_away_from_the_motion_after_a_release():
    # from the parabola of the held samples the search does not find it in its few turns
    members = [
        tn.discretise(grey_box(creeping=True, **changed), DT, substeps=2)
        for changed in ({}, {"damping": 1.2 * TRUTH["damping"]})
    ]
    assert error_after_a_hand(committee(members), np.array([1.0, 12.0, 0, 0]), 6) < 0.01


def test_a_model_that_never_explains_the_samples_is_fitted_to_all_of_them():
    model = tn.discretise(grey_box(), DT, substeps=2)
    e = simulated(model, np.array([1.0, 2.0]), counts=2048)
    wrong = tn.discretise(grey_box(gravity=20 * TRUTH["gravity"]), DT, substeps=2)
    start = jnp.asarray(start_states(wrong, [e], f"model-{SAMPLES}")[0])

    def cost(x):
        return jnp.sum((rollout(wrong, x, e.u[:-1])[:, :1] - e.q) ** 2)

    nearby = [cost(start + d * np.array(way)) for d in (-1e-3, 1e-3) for way in ((1, 0), (0, 1))]
    assert cost(start) < min(nearby)


def test_several_records_are_fitted_at_once_each_for_itself():
    model = tn.discretise(grey_box(), DT, substeps=1)
    records = [simulated(model, np.array([a, -a]), 2048) for a in (0.1, 0.4, 0.9)]
    together = start_states(model, records, "model-12")
    alone = np.concatenate([start_states(model, [e], "model-12") for e in records])
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-12)


def test_its_derivative_by_a_parameter_is_that_of_the_solution():
    model = tn.discretise(grey_box(), DT)
    e = simulated(model, np.array([1.0, 2.0]))
    guess = initial_state(e, "derived-6")[None]
    drive = jax.tree.map(lambda a: np.asarray(a)[None], input_signal(model, e))
    moving = Equations(
        lambda x, u, p, c: grey_box(gravity=p[0]).derivative(x, u), n_x=2, n_u=1, n_p=1
    )

    def start(value):
        given = np.array([[value]]), guess, np.zeros((1, 1, 2))
        return fit_states_with_derivatives(model, moving, *given, signal=drive, q=e.q[None])

    nominal = TRUTH["gravity"]
    step = 1e-5 * nominal
    numeric = (start(nominal + step)[0] - start(nominal - step)[0])[0] / (2 * step)
    exact = start(nominal)[1][0, 0]
    # exact residuals are 0 at the solution, so that Gauss-Newton leaves nothing out
    np.testing.assert_allclose(exact, numeric, rtol=1e-3, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("engine", ["llvm", "jax"])
@pytest.mark.parametrize("creeping", [False, True])
def test_a_compiled_program_finds_the_same(creeping, engine, monkeypatch):
    monkeypatch.setenv("TUSTINNET_ENGINE", engine)
    physics = tn.discretise(grey_box(creeping, gravity=1.1 * TRUTH["gravity"]), DT)
    model = with_dtype(tn.HybridModel(physics, network(0, physics.channels)), np.float64)
    truth = tn.discretise(grey_box(creeping), DT)
    states = [[2.5, 3.0], [1.0, -2.0], [0.1, 4.0]]
    records = [simulated(truth, np.pad(x, (0, truth.state_size - 2)), 2048) for x in states]
    rule = start_named("model-20")
    material = rule.start_data(model, records)
    inside = jax.jit(lambda model: rule.traced_states(model, material))(model)
    np.testing.assert_allclose(inside, rule.numeric_states(model, material), rtol=1e-5, atol=1e-6)


@pytest.mark.thorough
def test_networks_and_training_start_there_too(pendulum, small_recipe):
    small = tn.read_recipe(small_recipe).model_dump()
    # a program a stage: one will do
    recipe = {**small, "start": "model-12", "stages": small["stages"][:1]}
    result = tn.fit(pendulum, recipe)
    assert result.start == "model-12"
    scores = tn.evaluate(result.model, list(pendulum.split("validation")), "model-12")
    assert result.validation_rmse == pytest.approx(tn.mean_rmse(scores), rel=1e-2)
    for score, e in zip(scores, pendulum.split("validation"), strict=True):
        error = np.sum((score.simulated[:, :1] - e.q) ** 2, axis=1)
        assert score.rmse == pytest.approx(np.sqrt(error.mean()))
        assert score.rmse_after == pytest.approx(np.sqrt(error[12:].mean()))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("model-2", "^start: 'model-2'; expected at least 3 samples for the fit$"),
        ("model-21", "20 samples; expected at least 21 for the start 'model-21'"),
        ("model-x", "unknown start 'model-x'"),
    ],
)
def test_too_few_or_too_many_samples_are_refused(start, message):
    model = tn.discretise(grey_box(), DT)
    e = simulated(model, np.array([1.0, 2.0]))
    with pytest.raises(tn.InputError, match=message):
        start_states(model, [e], start)


def test_initial_state_says_that_it_needs_a_model():
    e = simulated(tn.discretise(grey_box(), DT), np.array([1.0, 2.0]))
    with pytest.raises(tn.InputError, match=r"'model-20' without a model.*start_states"):
        initial_state(e, "model-20")


def test_a_state_that_no_sample_depends_on_stays():
    products = np.array([[[4.0, 0.0], [0.0, 0.0]], [[4.0, 1.0], [1.0, 2.0]]])
    gradient = np.array([[2.0, 0.0], [1.0, 1.0]])
    step = newton_step(products, gradient, np.zeros(2))
    np.testing.assert_allclose(step[0], [0.5, 0.0])
    np.testing.assert_allclose(step[1], np.linalg.solve(products[1], gradient[1]))
