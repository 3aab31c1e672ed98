"""A coordinate that never moves has units of 1, and does not spoil what is learnt of others."""

from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.channels import Kind
from tustinnet.fitting.recipe import SearchRecipe
from tustinnet.fitting.residual import make_residual
from tustinnet.models.blocks import learn_scaling
from tustinnet.reproduce.published import published_scaling


def with_still(data: tn.DataSet, kind: Kind, value: float) -> tn.DataSet:
    """The same records with a second coordinate that stands at a value."""
    records = []
    for e in data:
        q = np.column_stack([e.q, np.full(len(e), value)])
        coordinates = [*e.coordinates, tn.Coordinate("still", kind, 1e-3)]
        records.append(
            tn.from_arrays(
                q,
                e.u,
                dt=e.dt,
                coordinates=coordinates,
                inputs=list(e.inputs),
                name=e.name,
                split=e.split,
                v=np.column_stack([e.velocities(), np.zeros(len(e))]),
            )
        )
    return tn.DataSet("with still", tuple(records))


@pytest.mark.thorough
@pytest.mark.parametrize("value", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["angular", "linear"])
def test_its_units_are_one(pendulum: tn.DataSet, kind: Kind, value: float) -> None:
    data = with_still(pendulum, kind, value)
    records = list(data)
    for velocity in ("file", "stencil", "savgol", "kalman"):
        scaling = learn_scaling(records, velocity, (0.25,))
        assert scaling.velocity[1] == scaling.acceleration[1] == scaling.memory[1] == 1.0
        assert np.all(scaling.position_scale == 1.0)
        assert scaling.velocity[0] == pytest.approx(
            float(
                learn_scaling(
                    list(pendulum), "stencil" if velocity == "file" else velocity
                ).velocity[0]
            )
        )
    unit = make_residual(SearchRecipe(), records).unit
    assert unit[1] == 1.0
    assert np.all(np.array(unit) > 1e-3)


def test_its_published_unit_is_one(pendulum: tn.DataSet) -> None:
    records = list(with_still(pendulum, "angular", 0.0))
    assert published_scaling(records).velocity[1] == 1.0
    alone = published_scaling(
        [
            tn.from_arrays(
                e.q[:, :1],
                e.u,
                dt=e.dt,
                coordinates=[e.coordinates[0]],
                inputs=list(e.inputs),
                v=np.asarray(e.velocities("file"))[:, :1],
            )
            for e in records
        ]
    )
    assert published_scaling(records).velocity[0] == alone.velocity[0]


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["angular", "linear"])
def test_a_network_and_a_linear_model_are_still_fitted(
    pendulum: tn.DataSet, tiny_recipe: Path, kind: Kind
) -> None:
    data = with_still(pendulum, kind, 0.3)
    quick = ["stages.*.epochs=2"]
    for recipe in (tn.read_recipe(tiny_recipe, quick), tn.read_recipe("linear")):
        result = tn.fit(data, recipe)
        assert result.finished
        for score in tn.evaluate(result.model, list(data), start="derived-6"):
            assert score.rmse < 20
