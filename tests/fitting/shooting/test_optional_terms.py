"""Which optional terms a system needs."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import (
    SWING,
    TILT,
    TRUTH,
    changed,
    data_set,
    driven_again,
    read_by_encoder,
    records,
)

import tustinnet as tn
from tustinnet.families.euler_lagrange import EulerLagrangeFamily, EulerLagrangeHyper
from tustinnet.fitting.shooting.added_forces import with_added
from tustinnet.models.lagrangian import LagrangianModel, Parameter

PULL = TRUTH["gravity"] / TRUTH["inertia"]  # 1/s^2


@pytest.fixture(scope="module")
def result() -> tn.Identification:
    """The swing, identified by somebody who knows nothing of it."""
    return tn.identify(data_set([read_by_encoder(e) for e in records()]), "mechanism", "mechanism")


@pytest.mark.thorough
def test_a_mechanism_is_found_from_its_records_alone(result):
    model = result.model.continuous
    assert isinstance(model, LagrangianModel)
    values = {name: float(x) for name, x in model.values.items()}
    assert values["angle.gravity_cos"] == pytest.approx(-PULL * np.cos(TILT), rel=0.01)
    assert values["angle.gravity_sin"] == pytest.approx(-PULL * np.sin(TILT), rel=0.01)
    assert values["angle.by_voltage"] == pytest.approx(TRUTH["gain"] / TRUTH["inertia"], rel=0.01)
    assert values["angle.viscous"] == pytest.approx(TRUTH["damping"] / TRUTH["inertia"], rel=0.03)
    assert not {"angle.cubic", "angle.quadratic", "angle.spring", "angle.pull"} & values.keys()


def test_a_mechanism_takes_signs_as_they_are(result):
    reversed_records = [replace(read_by_encoder(e), u=-e.u) for e in records()]
    other = tn.identify(data_set(reversed_records), "mechanism", "mechanism")
    assert other.reversed_signs == result.reversed_signs == ()
    model, reversed_model = result.model.continuous, other.model.continuous
    assert isinstance(model, LagrangianModel)
    assert isinstance(reversed_model, LagrangianModel)
    gain, reversed_gain = (float(m.values["angle.by_voltage"]) for m in (model, reversed_model))
    assert reversed_gain == pytest.approx(-gain, rel=1e-3)


def test_it_says_which_terms_it_kept(result):
    message = next(f.text for f in result.findings if f.text.startswith("optional terms"))
    assert "angle.gravity_cos" in message
    assert "angle.cubic" not in message


def test_the_model_is_one_like_any_other(result, tmp_path):
    path = tmp_path / "model.safetensors"
    tn.save(result.model, path)
    again = tn.load_model(path)
    e = records()[2]
    np.testing.assert_allclose(
        tn.free_run(again, e, "file"), tn.free_run(result.model, e, "file"), rtol=1e-6
    )
    score = tn.evaluate(again, [e], "file")[0]
    assert score.rmse < 0.01


@pytest.mark.thorough
def test_terms_of_a_system_of_ones_own_may_be_optional_too():
    extra = tuple(
        Parameter(name, "N m", 0.0, -1.0, 1.0, optional=True) for name in ("offset", "twice")
    )
    base = changed("gain", nominal=TRUTH["gain"], fixed=True)

    def potential(q, p):
        own = -p["gravity"] * jnp.cos(q[0] - TILT)
        return own + p.get("offset", 0.0) * q[0] + p.get("twice", 0.0) * jnp.cos(2 * q[0])

    system = tn.LagrangianSystem(
        "offered",
        base.coordinates,
        base.inputs,
        (*base.parameters, *extra),
        base.kinetic,
        potential,
        base.dissipation,
        base.input_map,
    )
    data = data_set([read_by_encoder(e) for e in records()])
    result = tn.identify(data, system, "grey")
    assert result.reversed_signs == ()
    assert {"offset", "twice"}.isdisjoint(e.name for e in result.estimates)
    assert any("0 of 2 kept (none)" in f.text for f in result.findings)
    assert result.system.optional == ()
    fixed = tn.identify(
        data,
        system,
        {
            "name": "held",
            "model": {"kind": "euler-lagrange", "fixed": {"offset": 0.0, "twice": 0.0}},
        },
    )
    assert not any("optional" in f.text for f in fixed.findings), "nobody asked for them"
    assert SWING.optional == ()


@pytest.mark.thorough
def test_a_stiff_machine_is_found_though_its_period_is_a_few_samples():
    """A mass on a spring, 50 times as fast as the swing, whose nominal values have no forces."""
    dt, rng = 0.002, np.random.default_rng(0)
    axis, push = tn.Coordinate("x", "linear"), tn.Input("force", "N")
    spring = tn.LagrangianSystem(
        "spring",
        (axis,),
        (push,),
        (Parameter("k", "N/m", 1.6e5, 1e4, 1e6), Parameter("b", "N s/m", 40.0, 1.0, 400.0)),
        lambda q, v, p: v[0] ** 2 / 2,
        lambda q, p: p["k"] * q[0] ** 2 / 2,
        lambda q, v, p: p["b"] * v,
        lambda q, v, u, p: 1e5 * u,
    )
    model = tn.discretise(spring.model({"k": jnp.asarray(1.6e5), "b": jnp.asarray(40.0)}), dt, 16)
    made = []
    for k in range(4):
        t = np.arange(800) * dt
        phases = rng.uniform(0, 2 * np.pi, 30)
        waves = np.sin(2 * np.pi * np.linspace(3, 120, 30) * t[:, None] + phases)
        u = 0.02 * (k + 1) * waves.sum(axis=1)
        x = np.asarray(tn.rollout(model, np.zeros(2), u[:-1, None]))
        q = x[:, :1] + 1e-4 * rng.normal(size=(len(t), 1))
        made.append(
            tn.from_arrays(q, u[:, None], dt=dt, name=f"r{k}", coordinates=(axis,), inputs=(push,))
        )
    result = tn.identify(data_set(made), "mechanism", "mechanism")
    values = {e.name: e.value for e in result.estimates}
    assert values["x.spring"] == pytest.approx(1.6e5, rel=0.02)
    assert values["x.by_force"] == pytest.approx(1e5, rel=0.02)


def offering(*parameters: Parameter) -> tn.LagrangianSystem:
    """The swing, with a spring that may be there and an inertia that may have grown."""
    base = changed("gain", nominal=TRUTH["gain"], fixed=True)
    return tn.LagrangianSystem(
        "offering",
        base.coordinates,
        base.inputs,
        (*base.parameters, *parameters),
        lambda q, v, p: (p["inertia"] + 0.05 * p.get("more", 0.0)) * v[0] ** 2 / 2,
        lambda q, p: -p["gravity"] * jnp.cos(q[0] - TILT) + p.get("spring", 0.0) * q[0] ** 2 / 2,
        base.dissipation,
        base.input_map,
    )


@pytest.mark.thorough
def test_a_reversed_sign_is_looked_for_where_terms_are_optional():
    spring = Parameter("spring", "N m/rad", 0.0, -5.0, 5.0, optional=True)
    system = replace(SWING, parameters=(*SWING.parameters, spring))
    reversed_records = [replace(read_by_encoder(e), u=-e.u) for e in records()]
    result = tn.identify(data_set(reversed_records), system, "grey")
    assert any(f.text.startswith("optional terms") for f in result.findings)
    assert result.reversed_signs == (("voltage",),)
    assert not result.sound
    assert any("sign of 'voltage' is probably reversed" in f.text for f in result.findings)


@pytest.mark.thorough
def test_what_is_kept_brings_forces_which_a_file_keeps(tmp_path):
    truth = {"angle.spring": 0.8, "angle.maxwell": 0.5, "angle.relaxation": 2.0}
    made = driven_again(with_added(SWING, ["spring", "maxwell"], records(), {}), truth)
    spring = Parameter(
        "spring", "N m/rad", 0.0, -5.0, 5.0, optional=True, brings=("maxwell:angle",)
    )
    system = offering(spring)
    result = tn.identify(data_set(made), system, "grey")
    values = {e.name: e.value for e in result.estimates}
    assert values["spring"] == pytest.approx(0.8, rel=0.1)
    assert values["angle.maxwell"] == pytest.approx(0.5, rel=0.1)
    tn.save(result.model, tmp_path / "model.safetensors")
    again = tn.load_model(tmp_path / "model.safetensors", system)
    assert again.internal == ("maxwell:angle",)
    np.testing.assert_allclose(
        tn.free_run(again, made[0], "derived-6"),
        tn.free_run(result.model, made[0], "derived-6"),
        rtol=1e-6,
    )
    options = EulerLagrangeHyper(kind="euler-lagrange")
    table = EulerLagrangeFamily().with_initial_values(options, again, system)
    assert table.begin["spring"] == pytest.approx(0.8, rel=0.1)
    assert "angle.maxwell" not in table.begin, "it is not there when a search begins"
    without = tn.identify(data_set([read_by_encoder(e) for e in records()]), system, "grey")
    assert without.system.optional == without.system.added == ()


@pytest.mark.thorough
def test_a_usual_value_is_taken_where_records_do_not_say_otherwise():
    """The inertia of the records is that of the swing and once more a bit of it, or not."""
    heavy = changed("inertia", nominal=0.1)
    made = driven_again(heavy, {"inertia": 0.1, "gain": 0.3, "gravity": 3.0, "damping": 0.04})
    usual = Parameter("more", "1", 0.0, -5.0, 5.0, optional=True, usual=(1.0, 3.0))
    system = offering(usual)
    gains = {"name": "known", "model": {"kind": "euler-lagrange", "fixed": {"gain": 0.3}}}
    result = tn.identify(data_set(made), system, gains)
    assert result.fixed["more"] == 1.0
    assert any("more at 1" in f.text for f in result.findings)
    free = tn.identify(
        data_set(made),
        offering(Parameter("more", "1", 0.0, -5.0, 5.0, optional=True, usual=(0.9,))),
        gains,
    )
    assert {e.name: e.value for e in free.estimates}["more"] == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"usual": (1.0,)}, "usual values; expected an optional parameter"),
        ({"brings": ("cubic:angle",)}, "forces that it brings; expected an optional parameter"),
        ({"usual": (7.0,), "optional": True}, "the usual value 7; expected values within -5..5"),
        ({"usual": (0.0,), "optional": True}, "the usual value 0; expected values within -5..5"),
    ],
)
def test_what_means_nothing_is_refused(given, message):
    with pytest.raises(tn.InputError, match=message):
        Parameter("more", "1", 0.0, -5.0, 5.0, **given)
