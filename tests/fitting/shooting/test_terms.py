"""Which optional terms a system needs."""

import jax.numpy as jnp
import numpy as np
import pytest
from swinging import SWING, TILT, TRUTH, changed, data_set, read_by_encoder, records

import tustinnet as tn
from tustinnet.models.lagrangian import LagrangianModel, Parameter

PULL = TRUTH["gravity"] / TRUTH["inertia"]  # 1/s^2


@pytest.fixture(scope="module")
def found() -> tn.Identification:
    """The swing, identified by somebody who knows nothing of it."""
    return tn.identify(data_set([read_by_encoder(e) for e in records()]), "mechanism", "mechanism")


def test_a_mechanism_is_found_from_its_records_alone(found):
    model = found.model.continuous
    assert isinstance(model, LagrangianModel)
    values = {name: float(x) for name, x in model.values.items()}
    assert values["angle.gravity_cos"] == pytest.approx(-PULL * np.cos(TILT), rel=0.01)
    assert values["angle.gravity_sin"] == pytest.approx(-PULL * np.sin(TILT), rel=0.01)
    assert values["angle.by_voltage"] == pytest.approx(TRUTH["gain"] / TRUTH["inertia"], rel=0.01)
    assert values["angle.viscous"] == pytest.approx(TRUTH["damping"] / TRUTH["inertia"], rel=0.03)
    assert not {"angle.cubic", "angle.quadratic", "angle.spring", "angle.pull"} & values.keys()


def test_it_says_which_terms_it_kept(found):
    told = next(f for f in found.findings if f.startswith("optional terms"))
    assert "angle.gravity_cos" in told
    assert "angle.cubic" not in told


def test_the_model_is_one_like_any_other(found, tmp_path):
    path = tmp_path / "model.safetensors"
    tn.save(found.model, path)
    again = tn.load_model(path)
    e = records()[2]
    np.testing.assert_allclose(
        tn.free_run(again, e, "file"), tn.free_run(found.model, e, "file"), rtol=1e-6
    )
    of = tn.evaluate(again, [e], "file")[0]
    assert of.rmse < 0.01


def test_terms_of_a_system_of_ones_own_may_be_optional_too():
    extra = tuple(
        Parameter(name, "N m", 0.0, -1.0, 1.0, optional=True) for name in ("offset", "twice")
    )
    base = changed("gain", nominal=TRUTH["gain"], fixed=True)

    def potential(q, p):
        own = -p["gravity"] * jnp.cos(q[0] - TILT)
        return own + p.get("offset", 0.0) * q[0] + p.get("twice", 0.0) * jnp.cos(2 * q[0])

    system = tn.LagrangianSystem(
        "offered", base.coordinates, base.inputs, (*base.parameters, *extra), base.kinetic,
        potential, base.dissipation, base.input_map,
    )  # fmt: skip
    data = data_set([read_by_encoder(e) for e in records()])
    result = tn.identify(data, system, "grey")
    assert {"offset", "twice"}.isdisjoint(e.name for e in result.estimates)
    assert any("0 of 2 kept (none)" in f for f in result.findings)
    assert result.system.optional == ()
    held = tn.identify(
        data, system, {"name": "held", "model": {"kind": "euler-lagrange", "fixed": {
            "offset": 0.0, "twice": 0.0}}},
    )  # fmt: skip
    assert not any("optional" in f for f in held.findings), "nobody asked for them"
    assert SWING.optional == ()
