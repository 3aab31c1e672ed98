"""Identification from end to end, on records made with known values."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import (
    CREEPING,
    DT,
    FAR,
    SWING,
    TRUTH,
    changed,
    data_set,
    falls,
    noises,
    noisy,
    read_by_encoder,
    records,
    simulated,
    voltage,
)

import tustinnet as tn
from tustinnet.fitting.listener import Iteration, Listener
from tustinnet.fitting.recipe import Recipe

SEARCHED = ("damping", "gravity", "gain")


def grey(*changes: str) -> Recipe:
    """The recipe `grey` with other values of keys under `[search]`."""
    return tn.read_recipe("grey", [f"search.{change}" for change in changes])


def errors(result: tn.Identification, truth: dict[str, float] = TRUTH) -> dict[str, float]:
    """Relative errors of the estimates."""
    return {e.name: e.value / truth[e.name] - 1 for e in result.estimates}


def worst(result: tn.Identification, truth: dict[str, float] = TRUTH) -> float:
    return max(abs(error) for error in errors(result, truth).values())


def with_validation() -> tn.DataSet:
    first, *others = records()
    return data_set(
        [replace(first, split="validation"), *(replace(e, split="train") for e in others)]
    )


@pytest.fixture(scope="module")
def clean() -> tn.Identification:
    """From records without noise, starting a factor of 3 away."""
    return tn.identify(data_set(records()), SWING, begin=FAR)


def test_the_truth_is_found_from_a_factor_of_three_away(clean):
    assert [e.name for e in clean.estimates] == list(SEARCHED)
    assert worst(clean) < 1e-4
    assert clean.converged
    assert clean.outcome.startswith("converged")
    assert clean.values == pytest.approx(TRUTH, rel=1e-4)


def test_the_model_found_is_the_identified_one(clean):
    assert clean.model.substeps == clean.substeps
    assert clean.model.dt == DT
    values = {name: float(value) for name, value in clean.model.continuous.values.items()}  # pyright: ignore[reportAttributeAccessIssue]
    assert values == pytest.approx(clean.values)
    assert tn.mean_rmse(tn.evaluate(clean.model, records(), "file")) < 1e-4


def test_a_result_says_what_was_found_and_fixed(clean):
    assert clean.fixed == {"inertia": 0.05}
    assert set(clean.rmse) == set(clean.initial_states) == {"fall1", "fall2", "noise1", "noise2"}
    assert max(clean.rmse.values()) < 1e-4
    assert clean.initial_states["fall2"] == pytest.approx((-1.5, 3.0), abs=1e-3)
    assert clean.initial == "anchored"
    assert clean.validation_rmse is None
    assert len(clean.autocorrelation) == 1
    assert clean.condition < 10
    assert clean.seconds > 0


def test_rmse_is_that_of_the_simulations_from_the_initial_states_found():
    experiments = [noisy(e, 0.01, i) for i, e in enumerate(records())]
    result = tn.identify(data_set(experiments), SWING)
    for e in experiments:
        x = tn.rollout(result.model, np.array(result.initial_states[e.name]), e.held_inputs)
        error = np.asarray(x)[:, 0] - e.q[:, 0]
        assert result.rmse[e.name] == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.02)


def test_the_correlation_is_symmetric_with_a_unit_diagonal(clean):
    np.testing.assert_allclose(np.diag(clean.correlation), 1.0)
    np.testing.assert_allclose(clean.correlation, clean.correlation.T)
    assert np.abs(clean.correlation).max() < 1 + 1e-9


def test_an_estimate_carries_its_unit_range_errors_and_interval():
    read = [read_by_encoder(e) for e in records()]
    for e in tn.identify(data_set(read), SWING).estimates:
        p = SWING.parameter(e.name)
        assert (e.unit, e.lower, e.upper, e.bound) == (p.unit, p.lower, p.upper, "")
        assert e.error is not None
        assert e.naive_error is not None
        assert e.interval is not None
        assert e.interval[0] < e.value < e.interval[1]
        assert 1 / 20 < e.error / e.naive_error < 20


@pytest.mark.thorough
def test_intervals_contain_the_truth_as_an_encoder_reads():
    generator = np.random.default_rng(0)
    inside = []
    for seed in range(6):
        experiments = []
        for i in range(4):
            u = voltage(200, 10 * seed + i) if i % 2 else np.zeros(200)
            x0 = [generator.uniform(-1.5, 2.5), generator.uniform(-2, 2)]
            experiments.append(read_by_encoder(simulated(f"e{i}", x0, u)))
        result = tn.identify(data_set(experiments), SWING)
        for e in result.estimates:
            assert e.interval is not None
            inside.append(e.interval[0] <= TRUTH[e.name] <= e.interval[1])
        assert worst(result) < 0.01
    assert np.mean(inside) > 0.7


def test_every_stage_is_told():
    iterations: list[Iteration] = []
    tn.identify(data_set(records()), SWING, listener=Listener(on_iteration=iterations.append))
    stages = list(dict.fromkeys(i.stage for i in iterations))
    assert stages[0] == "equation-error estimate"
    assert stages[1].startswith("segments of ")
    assert stages[-1] == "whole records, anchored start"
    for stage in stages[1:]:
        assert next(i.number for i in iterations if i.stage == stage) == 1


# --- keys of [search] ---


def test_angles_can_be_compared_by_the_periodic_distance():
    """One record is a full turn off, which no simulation can follow otherwise."""
    first, *others = records()
    whole_turn = replace(first, q=first.q + 2 * np.pi * (np.arange(200) > 60)[:, None], v=None)
    result = tn.identify(
        data_set([replace(whole_turn, v_measured=False), *others]), SWING, grey("periodic=true")
    )
    assert worst(result) < 1e-3


def test_only_transients_can_be_compared():
    """Two seconds after the beginning the pendulum is put elsewhere by hand."""
    spoilt = [
        replace(e, q=np.where(np.arange(200)[:, None] < 100, e.q, 1.0), k_bar=100) for e in falls()
    ]
    experiments = [*spoilt, *noises()]
    result = tn.identify(data_set(experiments), SWING, grey("part=transients"))
    assert worst(result) < 1e-4
    assert worst(tn.identify(data_set(experiments), SWING)) > 1e-2


def test_a_start_can_be_named():
    result = tn.identify(data_set(records()), SWING, grey("initial=file"))
    assert worst(result) < 1e-4
    assert result.initial == "file"
    assert result.initial_states["fall1"] == (2.5, 0.0)


def test_initial_states_can_be_searched_for_without_an_anchor():
    result = tn.identify(data_set(records()), SWING, grey("initial=unanchored"))
    assert worst(result) < 1e-4
    assert result.initial == "unanchored"


def test_an_unknown_start_is_refused():
    with pytest.raises(tn.InputError, match="unknown start 'guessed'"):
        tn.identify(data_set(records()), SWING, grey("initial=guessed"))


def test_integration_steps_are_chosen_unless_they_are_given():
    assert tn.identify(data_set(records()), SWING, grey("substeps=2")).substeps == 2


def test_the_better_start_on_the_validation_records_is_chosen():
    result = tn.identify(with_validation(), SWING)
    assert worst(result) < 1e-4
    assert result.initial in ("anchored", "unanchored")
    assert set(result.rmse) == {"fall2", "noise1", "noise2"}
    score = tn.mean_rmse(
        tn.evaluate(result.model, list(with_validation().split("validation")), "file")
    )
    assert result.validation_rmse == pytest.approx(score, rel=1e-3)


# --- systems of other kinds ---


@pytest.mark.thorough
def test_internal_states_are_identified_with_the_rest():
    values = {"offset": -0.1, "stiffness": 0.9, "relaxation": 6.0}
    experiments = [
        simulated(
            e.name,
            [float(e.q[0, 0]), float(e.velocities("file")[0, 0]), 0.0],
            e.u[:, 0],
            values,
            CREEPING,
        )
        for e in records()
    ]
    result = tn.identify(data_set(experiments), CREEPING)
    assert worst(result, TRUTH | values) < 1e-3
    assert all(len(x) == 3 for x in result.initial_states.values())
    assert result.initial_states["fall1"][2] == 0.0


def test_inputs_on_straight_lines_are_followed():
    ramped = replace(SWING, inputs=(replace(SWING.inputs[0], hold="first-order"),))
    experiments = [
        simulated(f"e{i}", [1.0 + i, 0.0], voltage(200, i), system=ramped) for i in range(2)
    ]
    assert worst(tn.identify(data_set(experiments), ramped)) < 1e-4


def test_a_system_without_inputs_is_identified():
    cart = tn.LagrangianSystem(
        name="cart",
        coordinates=(tn.Coordinate("place", "linear"),),
        inputs=(),
        parameters=(
            tn.Parameter("stiffness", "N/m", 20.0, 1.0, 500.0),
            tn.Parameter("damping", "N s/m", 0.5, 0.0, 10.0),
        ),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
        potential=lambda q, p: p["stiffness"] * q[0] ** 2 / 2,
        dissipation=lambda q, v, p: p["damping"] * v,
    )
    t = np.arange(100) * DT
    wave = np.sqrt(40.0 - 0.15**2)
    q = 0.2 * np.exp(-0.15 * t) * np.cos(wave * t)
    e = tn.from_arrays(q, dt=DT, coordinates=cart.coordinates)
    result = tn.identify(data_set([e]), cart, grey("tolerance=1e-7"))
    assert worst(result, {"stiffness": 40.0, "damping": 0.3}) < 1e-4


def test_intervals_of_a_fast_oscillator_hold_the_truth():
    """At 12 samples a period a parabola of some tells neither place nor velocity."""
    cart = tn.LagrangianSystem(
        name="cart",
        coordinates=(tn.Coordinate("place", "linear"),),
        inputs=(),
        parameters=(tn.Parameter("mass", "kg", 1.0, 0.1, 10.0),),
        kinetic=lambda q, v, p: p["mass"] * v[0] ** 2 / 2,
        potential=lambda q, p: (2 * np.pi / (12 * DT)) ** 2 * (q[0] ** 2 + q[0] ** 4 / 2) / 2,
    )
    model = tn.discretise(cart.model({"mass": jnp.asarray(1.0)}), DT, 8)
    random = np.random.default_rng(0)
    fast = []
    for i in range(6):
        x = np.asarray(tn.rollout(model, np.array([0.3 + 0.15 * i, 0.0]), np.zeros((199, 0))))
        q = x[:, 0] + random.normal(0, 1e-3, 200)
        fast.append(tn.from_arrays(q, dt=DT, coordinates=cart.coordinates, name=f"e{i}"))
    (mass,) = tn.identify(data_set(fast), cart, "best-grey").estimates
    assert mass.interval is not None
    assert mass.interval[0] < 1.0 < mass.interval[1]
    assert mass.interval[1] - mass.interval[0] < 1e-3


# --- what there is to say ---


def test_a_confounded_parameter_is_fixed_at_its_first_value_and_told():
    loose = changed("inertia", fixed=False)
    result = tn.identify(data_set(records()), loose, begin={"inertia": 0.1})
    assert result.fixed == pytest.approx({"inertia": 0.1})
    doubled = {name: 2 * value for name, value in TRUTH.items()}
    assert worst(result, doubled) < 1e-4
    (finding,) = [f for f in result.findings if f.code == "only ratios"]
    assert finding.values["fixed"] == "inertia"
    assert "fixed at its first value" in finding.text


def test_first_values_that_need_small_steps_are_checked_with_such():
    """Damping that is over in an eighth of a period; with a step a period simulations diverge."""
    stiff = changed("damping", changed("inertia", fixed=False), upper=100.0)
    result = tn.identify(data_set(records()), stiff, begin={"inertia": 0.1, "damping": 40.0})
    assert "only ratios" in {f.code for f in result.findings}


def test_a_parameter_without_effect_is_fixed_and_told():
    result = tn.identify(data_set(list(falls())), SWING)
    assert result.fixed == pytest.approx({"inertia": 0.05, "gain": 0.1})
    assert any("'gain' has no effect" in f.text for f in result.findings)
    assert worst(result) < 1e-4


def test_fixed_values_stay():
    result = tn.identify(data_set(records()), SWING, fixed={"gain": 0.15})
    assert result.fixed == {"inertia": 0.05, "gain": 0.15}
    assert worst(result) < 1e-4


def test_a_recipe_fixes_parameters_and_says_where_to_begin_unless_arguments_do(clean):
    changes = ("model.fixed.gain=0.3", "model.fixed.inertia=nominal", "model.begin.damping=0.9")
    recipe = tn.read_recipe("grey", changes)
    with pytest.raises(tn.InputError, match="'damping': 9 "):
        tn.identify(data_set(records()), SWING, recipe, begin={"damping": 9.0})
    result = tn.identify(data_set(records()), SWING, recipe, fixed={"gain": 0.15})
    assert result.fixed == {"inertia": 0.05, "gain": 0.15}
    assert result.values == pytest.approx(clean.values, rel=1e-4)
    assert tn.identify(data_set(records()), SWING, recipe).fixed["gain"] == 0.3
    wild = tn.read_recipe("grey", ["model.begin.damping=9"])
    with pytest.raises(tn.InputError, match="'damping': 9 "):
        tn.identify(data_set(records()), SWING, wild)


def test_a_reversed_input_is_told_with_the_bound_it_leads_to():
    result = tn.identify(data_set([replace(e, u=-e.u) for e in records()]), SWING)
    gain = result.estimates[2]
    assert (gain.name, gain.bound) == ("gain", "lower")
    assert gain.error is None
    assert gain.interval is None
    assert np.isnan(result.correlation[2]).all()
    assert result.reversed_signs == (("voltage",),)
    assert not result.sound
    assert any("'gain' is at its lower bound" in f.text for f in result.findings)
    assert any("sign of 'voltage' is probably reversed" in f.text for f in result.findings)


def test_a_record_that_is_stuck_raises_no_doubt_of_the_signs():
    stuck = replace(falls()[0], name="stuck", q=np.full((200, 1), -0.1), v=np.zeros((200, 1)))
    assert tn.identify(data_set([*records(), stuck]), SWING).reversed_signs == ()


def test_right_signs_are_not_doubted(clean):
    assert clean.reversed_signs == ()
    assert clean.sound
    assert not any("reversed" in f.text for f in clean.findings)


@pytest.mark.thorough
def test_a_prior_pulls_a_parameter_that_the_records_say_little_of():
    experiments = [noisy(e, 0.05, i)[:60] for i, e in enumerate(records())]
    loose = tn.identify(data_set(experiments), SWING)
    narrow_prior = changed("damping", nominal=0.04, prior=1e-4)
    pulled = tn.identify(data_set(experiments), narrow_prior)
    assert loose.values["damping"] < 0.03
    assert pulled.values["damping"] == pytest.approx(0.04, abs=4e-4)


def test_a_parameter_known_only_beforehand_has_the_error_of_its_prior():
    experiments = [noisy(e, 0.05, i)[:60] for i, e in enumerate(records())]
    narrow_prior = changed("damping", nominal=0.02, prior=1e-4)
    damping = tn.identify(data_set(experiments), narrow_prior).estimates[0]
    assert damping.naive_error == pytest.approx(1e-4, rel=0.1)
    assert damping.error is not None
    assert 0.9e-4 < damping.error < 2e-4


def test_records_that_leave_all_of_a_range_do_not_inform():
    hidden = [noisy(e, 1.0, i)[:40] for i, e in enumerate(records())]
    damping, gravity, _ = tn.identify(data_set(hidden), SWING).estimates
    assert damping.interval == pytest.approx((damping.lower, damping.upper))
    assert not damping.is_informed
    assert gravity.is_informed


def test_few_records_say_nothing_of_how_they_disagree():
    white = [noisy(e, 0.01, i) for i, e in enumerate(noises())]
    few = tn.identify(data_set(white), SWING)
    assert few.trust == "residuals"
    assert "J'J" in few.findings[-1].text
    assert "too few" in few.findings[-1].text
    assert all(e.error == pytest.approx(e.naive_error) for e in few.estimates)
    every = tn.identify(data_set([noisy(e, 0.01, i) for i, e in enumerate(records())]), SWING)
    assert every.trust == "records"
    assert "4 records disagree" in every.findings[-1].text


@pytest.mark.thorough
def test_white_residuals_are_called_independent_and_others_are_not():
    white = tn.identify(data_set([noisy(e, 0.01, i) for i, e in enumerate(records())]), SWING)
    assert abs(white.autocorrelation[0]) < 0.1
    assert "residuals independent" in [f.code for f in white.findings]
    poor = changed("damping", lower=0.1, upper=1.0, nominal=0.2)
    missing = tn.identify(data_set(records()), poor)
    assert missing.autocorrelation[0] > 0.5
    assert "residuals correlated" in [f.code for f in missing.findings]


def test_residuals_are_compared_with_the_encoders_counts():
    result = tn.identify(data_set([read_by_encoder(e) for e in records()]), SWING)
    assert "no larger than the encoders' quantisation" in result.findings[-1].text


# --- as a fit ---


def test_a_fit_of_a_system_is_its_identification(clean):
    iterations: list[Iteration] = []
    result = tn.fit(
        data_set(records()), "grey", system=SWING, listener=Listener(on_iteration=iterations.append)
    )
    assert result.recipe.name == "grey"
    assert result.identification is not None
    assert result.identification.values == pytest.approx(clean.values, rel=1e-4)
    assert result.model is result.identification.model
    assert (result.outcome, result.sound) == (result.identification.outcome, True)
    assert (result.start, result.validation_rmse) == ("file", None)
    assert result.details == {"identification": result.identification.as_plain()}
    assert result.detail("fixed") == {"inertia": 0.05}
    assert {i.stage for i in iterations} >= {
        "equation-error estimate",
        "whole records, anchored start",
    }
    with pytest.raises(tn.InputError, match="a fit that is no training has no seeds"):
        tn.fit(data_set(records()), "grey", system=SWING, seed=3)
    (again,) = tn.fit_many(data_set(records()), "grey", system=SWING)
    assert again.identification is not None
    assert again.identification.values == result.identification.values


# --- what is refused ---


SINGULAR = replace(SWING, kinetic=lambda q, v, p: p["inertia"] * jnp.cos(q[0]) * v[0] ** 2 / 2)
HEIGHT = replace(SWING, coordinates=(tn.Coordinate("height", "linear"),))


@pytest.mark.parametrize(
    ("system", "arguments", "message"),
    [
        (SINGULAR, {}, r"swing', kinetic: a mass matrix .* at angle"),
        (HEIGHT, {}, r"fall1: coordinates angle.*the system 'swing'"),
        (
            replace(SWING, inputs=(), input_map=None),
            {},
            r"inputs voltage.*the system 'swing'",
        ),
        (SWING, {"begin": {"gain": 3.0}}, "'gain': 3 N m/V"),
        (SWING, {"fixed": {"gain": "a"}}, r"identify, fixed\.gain.*valid number.*\(got 'a'\)"),
        (SWING, {"recipe": "standard"}, "not applicable to a recipe of kind 'tustin-net'"),
    ],
    ids=[
        "singular mass matrix",
        "other coordinates",
        "other inputs",
        "outside its range",
        "a text for a value",
        "a training",
    ],
)
def test_what_cannot_be_identified_is_refused(system, arguments, message):
    with pytest.raises(tn.InputError, match=message):
        tn.identify(data_set(records()), system, **arguments)


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(tn.InputError, match=r"identify: .*float64"):
        tn.identify(data_set(records()), SWING)


def test_records_that_say_nothing_of_any_parameter_are_refused():
    with pytest.raises(tn.InputError, match="gain"):
        tn.identify(data_set(list(falls())), SWING, fixed={"damping": 0.02, "gravity": 1.5})
