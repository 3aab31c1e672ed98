"""The paper's Euler-Lagrange rows on the measured records."""

import pytest

import tustinnet as tn


@pytest.mark.real
def test_the_spring_matters_as_the_paper_says(real_data):
    data = tn.load(real_data)
    records = [e for e in data if e.split != "test"]
    material = tn.DataSet(data.name, tuple(records))
    scores = {}
    for name in ("qube-servo2", "qube-servo2-naive"):
        found = tn.identify(material, tn.load_system(name))
        assert found.sound
        assert all(e.lower <= e.value <= e.upper for e in found.estimates)
        scores[name] = tn.mean_rmse(
            tn.evaluate(found.model, list(material.split("validation")), "file")
        )
    assert scores["qube-servo2"] < 0.18
    assert scores["qube-servo2-naive"] > 1.5 * scores["qube-servo2"]
