"""Correlations of the errors of free runs: over how many lags."""

import numpy as np
import pytest
from linear_machines import double_integrator

import tustinnet as tn
from tustinnet.evaluate.residuals import residual_reports


def pushed(name, samples):
    model, rng = double_integrator(), np.random.default_rng(samples)
    force = rng.normal(size=(samples, 1))
    states = [np.zeros(2)]
    for u in force[:-1]:
        states.append(model.a @ states[-1] + model.b @ u)
    noise = 1e-3 * rng.normal(size=(samples, 1))
    channels = model.channels
    return tn.from_arrays(
        np.asarray(states)[:, :1] + noise,
        force,
        dt=model.dt,
        coordinates=channels.coordinates,
        inputs=channels.inputs,
        name=name,
    )


def test_records_have_as_many_lags_as_the_shortest_allows():
    records, model = [pushed("long", 200), pushed("short", 25)], double_integrator()
    (report,) = residual_reports(model, records, "model-20")
    assert len(report.autocorrelation) == 25  # lags 0 to 24
    (report,) = residual_reports(model, records[:1], "model-20")
    assert len(report.autocorrelation) == 51
    with pytest.raises(tn.InputError, match="25 samples; expected 1 to 24"):
        residual_reports(model, records, "model-20", 25)
