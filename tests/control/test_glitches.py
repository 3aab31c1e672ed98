"""Wrong samples of encoders: the filter does not use them, and is found again."""

from functools import cache

import numpy as np
import pytest
from every_family import example
from hypothesis import given, settings
from hypothesis import strategies as st
from test_control_loops import NOISE, UPRIGHT, Regulator, grey_box

import tustinnet as tn
from tustinnet.control.closed_loop import Goal, closed_loop
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.plants import ModelPlant, qube_twin
from tustinnet.control.robustness import draw_starts
from tustinnet.control.sampled_plant import PlantOptions, SampledPlant
from tustinnet.control.variants import make_variants
from tustinnet.errors import InputError
from tustinnet.simulate.filtering import LOST_AFTER, FilterNoise
from tustinnet.systems.qube_servo2_twin import COUNT

# as `find_noise` has it of records of the twin
FOUND = FilterNoise(
    np.array([9e-4, 9e-4, 5.0, 8.5]), np.array([9e-4, 9e-4, 0.18, 0.18]), np.full(2, 9e-4)
)
DEVIATIONS = {"der_theta": 10.0, "der_alpha": 20.0, "voltage": 4.0}
LIMITS = {"voltage": (-10.0, 10.0)}
WRONG = [np.nan, np.inf, -np.inf, 1e300, -1e12, 3.0, -3.0]


class Swinging:
    """The pendulum swings from 2 rad, and a filter follows it through encoders."""

    def __init__(self, **options: int) -> None:
        model = example("qube")
        self.plant = ModelPlant(model, options=PlantOptions(counts=[COUNT, COUNT]))
        self.estimator = ExtendedKalmanFilter(model, FOUND, **options)
        self.plant.reset(np.array([0.0, 2.0]), 0)
        self.x = self.estimator.reset(self.plant.measure())

    def go_on(self, error: float = 0.0, coordinate: int = 1) -> np.ndarray:
        """The estimate a sample later, where a position is wrong by so much."""
        self.plant.apply(np.zeros(1))
        y = self.plant.measure()
        y[coordinate] += error
        self.x = self.estimator.update(y, np.zeros(1))
        return self.x

    def is_near(self) -> bool:
        """Whether the estimate is the state of the plant."""
        return bool((np.abs(self.x - self.plant.state) < [0.01, 0.01, 0.5, 0.5]).all())


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("coordinate", [0, 1])
def test_a_wrong_sample_changes_nothing(wrong, coordinate):
    run = Swinging()
    for k in range(100):
        run.go_on(wrong if k % 10 == 9 else 0.0, coordinate)
        assert run.is_near(), k
    assert run.estimator.unused == 10
    assert not run.estimator.is_lost


@pytest.mark.parametrize("push", [3.0, -6.0, 20.0])
def test_a_push_costs_a_sample_at_most(push):
    run = Swinging()
    for _ in range(30):
        run.go_on()
    run.plant.state[3] += push
    for _ in range(3):
        run.go_on()
    assert run.is_near()
    assert run.estimator.unused <= 1


@pytest.mark.parametrize("wrong", [np.nan, 3.0])
def test_after_many_it_is_lost_and_after_as_many_more_found(wrong):
    run = Swinging()
    lost = [bool(np.isnan(run.go_on(wrong, 0)).all()) for _ in range(LOST_AFTER + 20)]
    if wrong == 3.0:  # counts that are lost for good are the position: it begins anew there
        assert lost == [k >= LOST_AFTER - 1 and k < 2 * LOST_AFTER - 1 for k in range(len(lost))]
    if np.isnan(wrong):
        assert lost == [k >= LOST_AFTER - 1 for k in range(len(lost))]
        back = [bool(np.isnan(run.go_on()).any()) for _ in range(LOST_AFTER + 20)]
        assert sum(back) <= LOST_AFTER + 1
        assert run.is_near()
    assert run.estimator.unused >= LOST_AFTER


def test_a_first_sample_that_is_none_is_waited_for():
    run = Swinging(lost_after=3)
    assert np.isnan(run.estimator.reset(np.array([np.nan, 2.0]))).all()
    assert run.estimator.is_lost
    for _ in range(5):
        run.go_on()
    assert run.is_near()
    with pytest.raises(InputError, match="lost_after 0"):
        Swinging(lost_after=0)


@pytest.mark.thorough
@settings(deadline=None, max_examples=8)
@given(
    st.lists(st.one_of(st.just(0.0), st.floats(), st.sampled_from(WRONG)), min_size=1, max_size=60)
)
def test_whatever_comes_it_finds_back(errors):
    run = Swinging()
    for k, error in enumerate(errors):
        run.go_on(error, k % 2)
        assert np.isfinite(run.x).all() != run.estimator.is_lost
        assert np.isfinite(run.estimator.covariance).all()
    for _ in range(4 * LOST_AFTER):
        run.go_on()
    assert run.is_near()


@cache
def swing_up() -> tn.control.Tracking:
    """A swing-up that begins again after a fall."""
    model = grey_box()
    hanging = np.array([0.0, np.pi, 0.0, 0.0])
    feedback = tn.control.lqr(
        model,
        np.zeros(4),
        np.zeros(1),
        deviations=DEVIATIONS,
        limits=LIMITS,
        safe={"voltage": 0.25},
    )
    plan = tn.control.ilqr(
        model,
        hanging,
        np.zeros(4),
        250,
        deviations=DEVIATIONS,
        limits={"voltage": (-4.0, 4.0)},
        within={"theta": (-1.8, 1.8)},
        guesses=3,
    )
    settle = tn.control.lqr(model, hanging, np.zeros(1), deviations=DEVIATIONS, limits=LIMITS)
    return tn.control.time_varying_lqr(model, plan, feedback, deviations=DEVIATIONS, settle=settle)


@pytest.mark.thorough
def test_loops_without_wrong_samples_use_all_and_with_some_still_reach_their_goal():
    model = grey_box()
    controller = tn.control.TrackingFeedback(swing_up())
    estimator = ExtendedKalmanFilter(model, FOUND)
    kinds = {kind.name: kind.plants for kind in make_variants(model, FOUND, count=1)}
    starts = draw_starts([0.0, np.pi], [0.1, 0.05], 2)
    plants: list[SampledPlant] = [qube_twin(), qube_twin()]
    for name in ("nominal", "moved 10 %", "friction", "heavier", "delay 1", "disturbance"):
        plants += kinds[name]
    for i, plant in enumerate(plants):
        run = closed_loop(plant, controller, estimator, 400, starts[i % 2], i, UPRIGHT)
        assert run.is_success, run.outcome
        assert estimator.unused == 0
    for seed in range(2):
        plant = qube_twin(options=PlantOptions(glitches=0.1))
        run = closed_loop(plant, controller, estimator, 800, starts[0], seed, Goal({"alpha": 0.0}))
        assert run.is_success, run.outcome
        assert estimator.unused > 100
        assert np.isfinite(run.inputs).all()


@pytest.mark.thorough
def test_ten_thousand_wrong_samples_leave_it_finite_and_in_command():
    model = grey_box()
    controller = tn.control.TrackingFeedback(swing_up())
    estimator = ExtendedKalmanFilter(model, FOUND)
    plant, generator = qube_twin(), np.random.default_rng(0)
    plant.reset(np.array([0.0, np.pi]), 0)
    controller.reset()
    x, wrong, k, burst = estimator.reset(np.full(2, np.nan)), 0, 0, 0
    while wrong < 10_000 or burst > -1500:
        u = controller.inputs(k, x)
        assert np.abs(u).max() <= 10
        assert np.isfinite(x).all() or u[0] == 0.25
        plant.apply(u)
        y, k = plant.measure(), k + 1
        burst = burst - 1 if wrong >= 10_000 or burst > 0 else int(generator.integers(-100, 60))
        if burst > 0 and wrong < 10_000:
            kinds = [np.nan, np.inf, -np.inf, 1e300, 1e9, 0.0, *(y[0] + generator.normal(0, 3, 4))]
            y = generator.choice(kinds, 2)
            wrong += 2
        x = estimator.update(y, u)
    assert abs(np.remainder(plant.state[1] + np.pi, 2 * np.pi) - np.pi) < 0.1
    assert not estimator.is_lost


@pytest.mark.thorough
def test_while_it_is_lost_the_inputs_are_the_safe_ones():
    model, unknown = grey_box(), np.full(4, np.nan)
    at_goal = (model, np.zeros(4), np.zeros(1))
    feedback = tn.control.lqr(
        *at_goal, limits=LIMITS, integral=["theta"], delay=1, safe={"voltage": 2.0}
    )
    controller, undisturbed = (tn.control.LinearFeedback(feedback) for _ in range(2))
    for k in range(5):
        np.testing.assert_array_equal(controller.inputs(k, unknown), [2.0])
    undisturbed.reset(np.array([2.0]))
    x = np.array([0.01, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(controller.inputs(5, x), undisturbed.inputs(0, x))
    safe_feedback = tn.control.lqr(*at_goal, limits=LIMITS, safe={"voltage": -1.0})
    mpc = tn.control.Mpc(model, safe_feedback, steps=10)
    np.testing.assert_array_equal(mpc.inputs(0, unknown), [-1.0])
    assert np.isfinite(mpc.inputs(1, x)).all()
    one_sided = tn.control.lqr(*at_goal, limits={"voltage": (1.0, 4.0)})
    np.testing.assert_array_equal(one_sided.safe, [1.0])
    for safe, message in [
        ({"voltage": 11.0}, "voltage=11; expected -10 to 10"),
        ({"a": 0.0}, "no 'a'"),
    ]:
        with pytest.raises(InputError, match=message):
            tn.control.lqr(*at_goal, limits=LIMITS, safe=safe)


@pytest.mark.thorough
def test_a_plan_waits_for_the_state_or_begins_again():
    unknown = np.full(4, np.nan)
    tracking = swing_up()
    plan = tracking.plan
    patient = tn.control.TrackingFeedback(tn.control.Tracking(plan, tracking.gains, tracking.final))
    for k in range(3):
        np.testing.assert_array_equal(patient.inputs(k, unknown), [0.25])
    for k in range(10):
        np.testing.assert_allclose(patient.inputs(3 + k, plan.x[k]), plan.u[k], atol=1e-9)
    again = tn.control.TrackingFeedback(tracking)
    again.inputs(0, plan.x[0])
    again.inputs(1, unknown)
    assert again.phase == "settle"
    np.testing.assert_allclose(again.inputs(2, plan.x[0]), plan.u[0], atol=1e-9)
    assert again.phase == "plan"


def test_a_controller_without_glitches_of_its_own_holds_through_some():
    estimator = ExtendedKalmanFilter(grey_box(), NOISE)
    plant = qube_twin(options=PlantOptions(glitches=0.05))
    start = np.array([0.0, 0.1])
    run = closed_loop(plant, Regulator(grey_box()), estimator, 300, start, 1, UPRIGHT)
    assert run.is_success, run.outcome
    assert estimator.unused > 10
