"""Closed loops: what becomes of goals, and over which variants of a model a controller works."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from every_family import example
from swinging import CART, DT, SWING, TRUTH

import tustinnet as tn
from tustinnet.control.closed_loop import ClosedLoopResult, Goal, closed_loop
from tustinnet.control.design import ControlTask, design_controller
from tustinnet.control.estimator import ExtendedKalmanFilter
from tustinnet.control.plants import ModelPlant, qube_twin
from tustinnet.control.robustness import Robustness, assess_robustness, draw_starts
from tustinnet.control.sampled_plant import PlantOptions
from tustinnet.control.trial import try_design
from tustinnet.control.variants import FRICTION, make_variants, with_friction_factor
from tustinnet.errors import InputError
from tustinnet.families.euler_lagrange import draw_values
from tustinnet.models.physical_values import with_values
from tustinnet.report.control import sentences
from tustinnet.simulate.filtering import FilterNoise
from tustinnet.systems.qube_servo2_twin import COUNT, TWIN_VALUES

NOISE = FilterNoise(
    np.array([COUNT, COUNT, 1.0, 1.0]), np.array([1e-4, 1e-4, 0.05, 0.05]), np.full(2, COUNT / 3)
)
LEVEL = {"gravity": jnp.zeros(())}
UPRIGHT = Goal({"alpha": 0.0}, hold=1.0, limits={"theta": (-2.5, 2.5)})


class Regulator:
    """State feedback about the upright equilibrium, as scipy's Riccati equation has it."""

    def __init__(self, model: tn.Model, limit: float = 10.0) -> None:
        moment = tn.linearize(model, np.zeros(4), np.zeros(1))
        cost, price = np.diag([1.0, 5.0, 0.01, 0.01]), np.eye(1) * 0.02
        value = scipy.linalg.solve_discrete_are(moment.a, moment.b, cost, price)
        self.gain = np.linalg.solve(
            price + moment.b.T @ value @ moment.b, moment.b.T @ value @ moment.a
        )
        self.limit = limit

    def reset(self) -> None:
        """Nothing is remembered."""

    def inputs(self, k: int, x: np.ndarray) -> np.ndarray:
        error = x.copy()
        error[1] = (error[1] + np.pi) % (2 * np.pi) - np.pi
        return np.clip(-self.gain @ error, -self.limit, self.limit)


class Constant:
    def __init__(self, u: float) -> None:
        self.u = np.array([u])

    def reset(self) -> None:
        """Nothing is remembered."""

    def inputs(self, k: int, x: np.ndarray) -> np.ndarray:
        return self.u


def grey_box() -> tn.Model:
    """The twin without its cable's memory and dry friction, as an identification would have it."""
    system = tn.load_system("qube-servo2")
    values = {p.name: jnp.asarray(TWIN_VALUES[p.name]) for p in system.parameters}
    values["arm_damping"] = jnp.asarray(4e-4)
    return tn.discretise(system.model(values), 0.01, 2)


@pytest.mark.thorough
def test_a_grey_box_balances_the_unseen_twin_through_encoders():
    model = grey_box()
    estimator = ExtendedKalmanFilter(model, NOISE)
    starts = draw_starts([0.0, 2 * np.pi], [0.2, 0.15], 5)

    def run(i: int) -> ClosedLoopResult:
        return closed_loop(qube_twin(), Regulator(model), estimator, 300, starts[i], i, UPRIGHT)

    results = [run(i) for i in range(5)]
    for result in results:
        assert result.is_success, result.outcome
        outcome = result.outcome
        assert outcome is not None
        assert outcome.sentence.startswith("held from ")
        assert outcome.worst["alpha"] < 0.02
        assert outcome.time_to_reach is not None
        np.testing.assert_allclose(outcome.energy, np.sum(result.inputs**2) * 0.01)
    result = results[-1]
    assert result.states.shape == (301, 5)
    assert result.measurements.shape == (301, 2)
    assert result.estimates.shape == (301, 4)
    assert np.abs(result.estimates[50:, :2] - result.states[50:, :2]).max() < COUNT
    np.testing.assert_array_equal(run(4).states, result.states)


@pytest.mark.thorough
def test_a_grey_box_swings_up_the_unseen_twin_through_encoders():
    model, limits = grey_box(), {"voltage": (-4.0, 4.0)}
    deviations = {"der_theta": 10.0, "der_alpha": 20.0, "voltage": 4.0}
    hanging = np.array([0.0, np.pi, 0.0, 0.0])
    feedback = tn.control.lqr(
        model, np.zeros(4), np.zeros(1), deviations=deviations, limits={"voltage": (-10.0, 10.0)}
    )
    plan = tn.control.ilqr(
        model,
        hanging,
        np.zeros(4),
        250,
        deviations=deviations,
        limits=limits,
        within={"theta": (-1.8, 1.8)},
        guesses=3,
    )
    assert plan.reached
    tracking = tn.control.time_varying_lqr(model, plan, feedback, deviations=deviations)
    controller = tn.control.TrackingFeedback(tracking)
    estimator = ExtendedKalmanFilter(model, NOISE)
    for i, start in enumerate(draw_starts(hanging[:2], [0.1, 0.05], 4)):
        outcome = closed_loop(qube_twin(), controller, estimator, 500, start, i, UPRIGHT).outcome
        assert outcome is not None
        assert outcome.is_success, outcome.sentence


@pytest.mark.parametrize(
    ("voltage", "start", "goal", "end", "sentence"),
    [
        (0.0, 3.0, UPRIGHT, "never reached", "alpha came to 3 from"),
        (0.0, 1e-4, UPRIGHT, "lost", "reached at 0.00 s and lost at"),
        (9.0, 3.0, UPRIGHT, "left its limits", "theta left -2.5..2.5 at"),
    ],
)
def test_a_goal_that_is_not_met_says_why(voltage, start, goal, end, sentence):
    estimator = ExtendedKalmanFilter(example("qube"), NOISE)
    plant = ModelPlant(example("qube"), {"pendulum_damping": 1e-3})
    begin = np.array([0.0, start])
    outcome = closed_loop(plant, Constant(voltage), estimator, 150, begin, 0, goal).outcome
    assert outcome is not None
    assert outcome.end == end
    assert sentence in outcome.sentence
    assert not outcome.is_success
    assert outcome.time_to_reach is None


class Alternating(Constant):
    """One input, then the other one, for a sample each."""

    def inputs(self, k, x):
        return (-1) ** k * super().inputs(k, x)


def test_inputs_that_jump_between_their_limits_hold_nothing():
    model = example("qube")
    estimator, plant = ExtendedKalmanFilter(model, NOISE), ModelPlant(model)
    goal = Goal({"alpha": np.pi}, {"alpha": 0.3}, hold=1.0)
    begin = np.array([0.0, np.pi])
    run = closed_loop(plant, Alternating(2.0), estimator, 200, begin, 0, goal)
    assert run.outcome is not None
    assert run.outcome.end == "swings"
    assert "inputs swing between limits" in run.outcome.sentence


def test_what_is_reached_late_is_held_for_as_long_as_it_is_to_be():
    model = example("qube")
    estimator, plant = ExtendedKalmanFilter(model, NOISE), ModelPlant(model)
    goal = Goal({"alpha": -np.pi}, {"alpha": 0.1}, hold=2.0)
    begin = np.array([0.0, 2.5])
    alone = closed_loop(plant, Constant(0.0), estimator, 3000, begin, 0, goal)
    assert alone.outcome is not None
    assert alone.outcome.time_to_reach is not None
    reached = round(alone.outcome.time_to_reach / model.dt)
    run = closed_loop(plant, Constant(0.0), estimator, reached + 10, begin, 0, goal)
    assert run.outcome is not None
    assert run.outcome.end == "held"
    assert len(run.inputs) == pytest.approx(reached + 200, abs=2)


@pytest.mark.thorough
def test_saturation_is_said():
    model = grey_box()
    estimator = ExtendedKalmanFilter(model, NOISE)
    weak = Regulator(model, limit=0.3)
    start = np.array([0.0, 0.2])
    outcome = closed_loop(qube_twin(), weak, estimator, 300, start, 0, UPRIGHT).outcome
    assert outcome is not None
    assert not outcome.is_success
    assert outcome.saturated > 0.5
    assert "inputs at their limits" in outcome.sentence


def test_without_a_goal_there_is_no_outcome():
    model = example("qube")
    estimator = ExtendedKalmanFilter(model, NOISE)
    result = closed_loop(ModelPlant(model), Constant(0.0), estimator, 5, np.array([0.0, 3.0]))
    assert result.outcome is None
    assert not result.is_success


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (Goal({}), "no position"),
        (Goal({"beta": 0.0}), "'beta'; expected one of theta, alpha"),
        (Goal({"alpha": 0.0}, hold=0.0), "positive numbers"),
        (Goal({"alpha": 0.0}, limits={"theta": (1.0, -1.0)}), "limits 1..-1 of theta"),
    ],
)
def test_goals_of_nothing_are_refused(goal, message):
    with pytest.raises(InputError, match=message):
        goal.check(example("qube").channels)
    with pytest.raises(InputError, match="no window of 'x'"):
        Goal({"x": 0.0}).check(tn.Channels(CART.coordinates, CART.inputs, 0.01))


def test_friction_is_multiplied_whatever_its_parameters():
    model = with_friction_factor(example("qube memory"))
    plant = ModelPlant(model, {FRICTION: 2.0})
    nominal = tn.load_system("qube-servo2-memory").nominal()
    frictions = ("arm_damping", "pendulum_damping", "arm_friction")
    doubled = {name: 2 * nominal[name] for name in frictions}
    other = ModelPlant(example("qube memory"), doubled)
    for one in (plant, other):
        one.reset(np.array([0.0, 2.0]), 0)
        for _ in range(50):
            one.apply(np.array([1.0]))
    np.testing.assert_allclose(plant.state, other.state, rtol=1e-9, atol=1e-12)


def estimates() -> dict[str, object]:
    """An identification of two parameters, as a model file has it."""
    rows = [
        {
            "name": name,
            "unit": "",
            "value": TWIN_VALUES[name],
            "error": 0.02 * TWIN_VALUES[name],
            "naive_error": None,
            "interval": None,
            "lower": 0.0,
            "upper": 1.0,
            "bound": "",
        }
        for name in ("arm_mass", "pendulum_centre")
    ]
    return {"identification": {"estimates": rows, "correlation": [[1.0, 0.5], [0.5, 1.0]]}}


def test_a_table_says_over_which_variants_a_controller_works():
    model = grey_box()
    kinds = make_variants(model, NOISE, estimates(), count=3)
    assert [kind.name for kind in kinds] == [
        "nominal",
        "parameters",
        "moved 10 %",
        "moved 20 %",
        "friction",
        "heavier",
        "delay 1",
        "delay 2",
        "noise",
        "disturbance",
    ]
    estimator = ExtendedKalmanFilter(model, NOISE)
    starts = draw_starts([0.0, 0.0], [0.2, 0.1], 3)
    robustness = assess_robustness(kinds, Regulator(model), estimator, starts, UPRIGHT, 250)
    assert robustness["nominal"].successes == robustness["parameters"].successes == 3
    assert robustness["delay 2"].successes == 0
    assert robustness.worst_kind.kind == "delay 2"
    assert "(inputs act 2 samples later): 0 of 3" in robustness.sentence
    assert 0.5 < robustness.share < 1
    row = robustness["delay 2"].as_plain()
    assert row["runs"] == 3
    assert row["time_to_reach"] is None
    assert "first: " in str(row["failures"])
    with pytest.raises(InputError, match="2 starts; expected as many"):
        assess_robustness(kinds, Regulator(model), estimator, starts[:2], UPRIGHT, 10)


@pytest.mark.thorough
def test_a_network_has_no_physics_and_a_committee_has_members():
    network = example("qube network")
    names = [kind.name for kind in make_variants(network, NOISE, count=1)]
    assert names == ["nominal", "delay 1", "delay 2", "noise", "disturbance"]
    members = [network, grey_box()]
    both = tn.committee(members)
    kinds = {kind.name: kind for kind in make_variants(both, NOISE, count=3)}
    assert {"members", "friction"} <= kinds.keys()
    sizes = [len(plant.model.internal) for plant in kinds["members"].plants]  # pyright: ignore[reportAttributeAccessIssue]
    assert sizes == [0, 0, 0]
    hybrid = make_variants(example("qube hybrid"), replace(NOISE), count=1)
    assert "moved 10 %" in [kind.name for kind in hybrid]


def test_what_holds_its_own_model_alone_is_no_promise():
    """Beside another candidate whose gravity pulls the other way."""
    model = grey_box()
    turned = with_values(model, {"pendulum_centre": -0.06})
    by_records = make_variants(model, NOISE, count=1, has_records=True)
    assert [kind.name for kind in by_records if kind.allowed] == ["disturbance"]
    kinds = make_variants(model, NOISE, count=4, candidates=[turned])
    estimator, starts = ExtendedKalmanFilter(model, NOISE), draw_starts([0.0, 0.0], [0.2, 0.1], 4)

    def play(controller: Regulator, *names: str) -> Robustness:
        chosen = [kind for kind in kinds if kind.name in names]
        return assess_robustness(chosen, controller, estimator, starts, UPRIGHT, 250)

    table = play(Regulator(model), "nominal", "candidates")
    assert table.problem.startswith("meets the goal in 0 of 4 runs on other candidates of its run")
    # a delay that the records do not allow speaks against nothing
    alone = play(Regulator(model), "nominal", "delay 2")
    assert alone["delay 2"].share < 0.5
    assert not alone.problem
    assert "runs on the model" in play(Regulator(model, limit=0.1), "nominal").problem


def test_a_motion_of_several_turns_is_refused_and_turns_are_named():
    motor = tn.discretise(SWING.model({k: jnp.asarray(v) for k, v in TRUTH.items()} | LEVEL), DT)
    limits = {"voltage": (-5.0, 5.0)}
    held = ControlTask({"angle": 0.0}, limits=limits, trust_beyond=True)
    assert "held at the nearest whole turn: angle" in sentences(design_controller(motor, held))
    far = ControlTask({"angle": 20.0}, {"angle": 0.0}, limits=limits, trust_beyond=True)
    with pytest.raises(InputError, match=r"to=.*20 rad from where the motion begins.*linear"):
        design_controller(motor, far)


def test_what_stays_where_it_is_put_is_to_be_brought_to_its_goal():
    """Runs begin outside of the window, and last as long as the loop is slow."""
    motor = tn.discretise(SWING.model({k: jnp.asarray(v) for k, v in TRUTH.items()} | LEVEL), DT)
    for limit in (5.0, 0.2):
        task = ControlTask({"angle": 0.0}, limits={"voltage": (-limit, limit)}, trust_beyond=True)
        design = design_controller(motor, task)
        robustness = try_design(design, count=6).robustness
        assert robustness["nominal"].successes == 6
        assert robustness.without is not None
        assert robustness.without.successes < 6
        settling = max(design.goal.hold, 3 * design.margins.slowest)
        assert design.steps * DT == pytest.approx(design.goal.hold + settling, abs=DT)
    assert settling > design.goal.hold
    # whatever it holds, a model that is worse than none
    reference = {"predictor": "standing still", "share": 2.0}
    doubted = try_design(design, {"scores": {"reference": reference}}, count=1).robustness
    assert doubted["nominal"].successes == 1
    assert doubted.problem.startswith("its model is 2 times as far off as standing still")


def test_encoders_of_variants_count_as_the_filter_assumes():
    (nominal, *_) = make_variants(grey_box(), NOISE, count=1)
    plant = nominal.plants[0]
    readings = set()
    for q in np.linspace(0.0, 10 * COUNT, 300):
        plant.reset(np.array([q, 0.0]), 0)
        readings.add(round(float(plant.measure()[0]), 9))
    assert 8 <= len(readings) <= 12 + 1
    own = make_variants(grey_box(), NOISE, count=1, options=PlantOptions(counts=[0.5, 0.5]))
    plant = own[0].plants[0]
    plant.reset(np.array([0.1, 0.0]), 0)
    assert abs(plant.measure()[0] - 0.1) <= 0.25


def test_values_near_the_end_of_a_range_are_drawn_with_their_correlation():
    model = grey_box()
    names = ("arm_mass", "pendulum_centre")
    values = {n: TWIN_VALUES[n] for n in names}
    rows = [
        {"name": n, "value": x, "error": x, "lower": 0.5 * x, "upper": 3 * x}
        for n, x in values.items()
    ]
    header = {"identification": {"estimates": rows, "correlation": [[1.0, 0.999], [0.999, 1.0]]}}
    drawn = draw_values(model, header, 50)
    shares = np.array([[d[n] / values[n] for n in names] for d in drawn])
    assert len(drawn) == 50
    assert np.abs(shares[:, 0] - shares[:, 1]).max() < 0.2
    assert shares.min() >= 0.5
    assert shares.std() > 0.3
