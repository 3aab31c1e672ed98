"""Units of a network in which all features are of the size of 1."""

import jax
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.families.tustin_net import TustinNet
from tustinnet.models.blocks import learn_scaling, learn_standard_scaling

DT = 0.01


def shaft(twist: float = 0.02, small: float = 0.01) -> tn.DataSet:
    """A motor and a load on a shaft that turn by several rad, and a pole that hardly leaves 0.3."""
    t = np.arange(600) * DT
    records = []
    for k in range(3):
        motor = 3 * np.sin(2 * t + k)
        load = motor + twist * np.sin(5 * t + k)
        pole = 0.3 + small * np.sin(7 * t)
        q = np.stack([motor, load, pole], axis=1)
        split = "validation" if k == 2 else "train"
        records.append(
            tn.from_arrays(
                q,
                np.cos(5 * t)[:, None],
                dt=DT,
                name=f"r{k}",
                split=split,
                coordinates=[tn.Coordinate(n, "angular") for n in ("motor", "load", "pole")],
                inputs=[tn.Input("torque", "N m")],
            )
        )
    return tn.DataSet("shaft", tuple(records))


def features(data: tn.DataSet, learn) -> np.ndarray:
    scaling, channels = learn(list(data)), data.channels
    x = np.concatenate([e.measured_states() for e in data])
    u = np.concatenate([e.u for e in data])
    return np.asarray(jax.vmap(lambda x, u: scaling.features(channels, x, u))(x, u))


@pytest.mark.thorough
def test_a_small_angle_counts_as_much_as_one_that_turns():
    data = shaft()
    plain, standard = (features(data, f) for f in (learn_scaling, learn_standard_scaling))
    assert plain[:, 2].std() < 0.02  # the sine of the pole
    assert standard[:, 2].std() == pytest.approx(1.0, rel=0.05)
    assert np.abs(standard.mean(axis=0)[:6]).max() < 1e-3
    assert 0.3 < standard[:, 0].std() < 1.0  # that of the motor, whose cosine has the rest


def test_coordinates_that_move_together_also_enter_by_their_differences():
    data = shaft()
    scaling = learn_standard_scaling(list(data))
    assert scaling.pairs == ((0, 1),)
    pair = features(data, learn_standard_scaling)[:, 9:11]  # 6 of angles, 3 velocities, the pair
    np.testing.assert_allclose(np.sqrt(np.mean(pair**2, axis=0)), 1.0, rtol=0.02)
    assert learn_standard_scaling(list(shaft(twist=3.0))).pairs == ()


def test_a_coordinate_that_never_moves_has_a_unit_of_1():
    scaling = learn_standard_scaling(list(shaft(small=0.0)))
    assert scaling.angle_scale[2] == 1.0
    assert np.isfinite(np.concatenate([scaling.angle_centre, scaling.pair_scale])).all()


@pytest.mark.thorough
def test_a_trained_network_with_pairs_is_read_as_it_was_written(tmp_path):
    stage = {"name": "one", "epochs": 1, "batch": 16, "rate": 1e-3}
    stage["windows"] = {"draw": "strided", "length": 8, "count": 16}
    known = {"kind": "tustin-net", "hidden": [3], "scaling": "standard"}
    recipe = {"name": "short", "model": known, "stages": [stage]}
    model = tn.fit(shaft().split("train"), recipe).model
    tn.save(model, tmp_path / "model.safetensors")
    again = tn.load_model(tmp_path / "model.safetensors")
    assert isinstance(again, TustinNet)
    assert again.scaling.pairs == ((0, 1),)
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(model), strict=True):
        np.testing.assert_array_equal(one, other)
