"""Holds that nobody declares, found by trying."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.channels import Hold
from tustinnet.models.integrate import discretise
from tustinnet.simulate.drive import drive_of

DT = 0.05
SYSTEM = tn.LagrangianSystem(
    name="oscillator",
    coordinates=(tn.Coordinate("x", "linear", 1e-4),),
    inputs=(tn.Input("force", "N"),),
    parameters=(
        tn.Parameter("stiffness", "N/m", 30.0, 5.0, 500.0),
        tn.Parameter("damping", "N s/m", 1.0, 0.01, 10.0),
    ),
    kinetic=lambda q, v, p: v[0] ** 2 / 2,
    potential=lambda q, p: p["stiffness"] * q[0] ** 2 / 2,
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: u,
)
TRUTH = {"stiffness": 80.0, "damping": 0.6}


def logged(hold: Hold, seed: int, n: int = 300) -> tn.Experiment:
    """A record of the oscillator under noise up to a quarter of the sampling rate."""
    generator = np.random.default_rng(seed)
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[1 : n // 4] = np.exp(2j * np.pi * generator.uniform(size=n // 4 - 1))
    u = np.fft.irfft(spectrum, n) * n / 4
    e = tn.from_arrays(
        u, u, dt=DT, coordinates=SYSTEM.coordinates, inputs=[tn.Input("force", "N", hold)],
        name=f"record{seed}",
    )  # fmt: skip
    values = {name: jnp.asarray(value) for name, value in TRUTH.items()}
    model = discretise(SYSTEM.model(values), DT, 4, inputs=e.inputs)
    q = np.asarray(tn.rollout(model, np.zeros(2), drive_of(model, e)))[:, :1]
    return replace(e, q=np.round(q / 1e-4) * 1e-4)


def unsaid(e: tn.Experiment) -> tn.Experiment:
    """The same record by somebody who does not know what the input did."""
    return replace(e, channels=replace(e.channels, inputs=(tn.Input("force", "N", "unknown"),)))


@pytest.mark.parametrize("hold", ["zero-order", "band-limited"])
def test_the_right_hold_is_found_and_told(hold):
    asked = tn.DataSet("d", tuple(unsaid(logged(hold, seed)) for seed in range(2)))
    found = tn.identify(asked, SYSTEM)
    assert found.model.inputs[0].hold == hold
    told = next(f for f in found.findings if f.startswith("hold of 'force'"))
    assert told.startswith(f"hold of 'force': {hold}, by the simulation error")
    assert all(f"{name} " in told for name in ("zero-order", "first-order", "band-limited"))
    assert f'declare hold = "{hold}"' in told
    for name, value in TRUTH.items():
        assert found.values[name] == pytest.approx(value, rel=0.01)


def test_terms_nobody_needs_are_left_out_before_holds_are_tried():
    asked = tn.DataSet("d", tuple(unsaid(logged("zero-order", seed)) for seed in range(2)))
    found = tn.identify(asked, "mechanism", "mechanism")
    assert found.model.inputs[0].hold == "zero-order"
    values = {e.name: e.value for e in found.estimates}
    # one that relaxes slowly is a spring, too
    stiffness = values["x.spring"] + values["x.maxwell"]
    assert stiffness == pytest.approx(TRUTH["stiffness"], rel=0.02)
    assert values["x.by_force"] == pytest.approx(1.0, rel=0.02)
    assert "x.quadratic" not in values


def test_other_kinds_of_models_refuse_what_nobody_knows():
    unknown = unsaid(logged("first-order", 0))
    with pytest.raises(tn.InputError, match=r"record0, input 'force': hold 'unknown'"):
        tn.fit(tn.DataSet("d", (unknown,)), "standard")
