"""The rollout and its starts."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.models.contract import Model
from tustinnet.simulate.starts import default_start, initial_state


class Adder(Model):
    """x[k+1] = x[k] + [u, 0]: makes visible which input acts when."""

    channels: tn.Channels = eqx.field(
        static=True,
        default=tn.Channels((tn.Coordinate("q", "angular"),), (tn.Input("u", "V"),), 1.0),
    )

    def step(self, x, u):
        return x + jnp.array([u[0], 0.0])


def test_rollout_begins_with_x0_and_holds_u_k_from_k_to_k_plus_1():
    x = tn.rollout(Adder(), jnp.array([1.0, 0.0]), jnp.array([[10.0], [100.0]]))
    assert x[:, 0].tolist() == [1.0, 11.0, 111.0]


@pytest.mark.parametrize("x0", [np.float32, np.float64])
@pytest.mark.parametrize("u", [np.float32, np.float64])
def test_any_mix_of_precisions_can_be_rolled_out(x0, u):
    x = tn.rollout(Adder(), np.array([1, 0], x0), np.array([[10], [100]], u))
    assert x[:, 0].tolist() == [1.0, 11.0, 111.0]


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(
        tn.InputError, match=r"u of shape \(2, 3\); expected \(2,\) and \(steps, 1\)"
    ):
        tn.rollout(Adder(), np.zeros(2), np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("x0", "u"),
    [((3,), (2, 1)), ((2,), (2,)), ((2,), (2, 2, 3)), ((2,), (2, 3, 1)), ((2,), (2, 2, 1, 1))],
)
def test_states_and_drives_of_other_sizes_are_refused(x0, u):
    with pytest.raises(tn.InputError, match=r"rollout: x0 of shape .* \(2,\) and \(steps, 1\)"):
        tn.rollout(Adder(), np.zeros(x0), np.zeros(u))


def parabola(samples: int = 30, **options) -> tn.Experiment:
    t = np.arange(samples) * 0.01
    return tn.from_arrays(
        0.3 + 2.0 * t - 4.0 * t**2, dt=0.01, coordinates={"a": "angular"}, **options
    )


def test_file_start_is_the_first_row_as_stored_with_its_velocity():
    e = parabola(v=np.zeros(30), v_measured=False)
    np.testing.assert_allclose(initial_state(e, "file"), [0.3, 0.0])


def test_file_start_without_velocity_columns_names_the_other_start():
    with pytest.raises(tn.InputError, match="derived-6"):
        initial_state(parabola(), "file")


@pytest.mark.parametrize("start", ["derived-3", "derived-6", "derived-20"])
def test_derived_start_finds_the_velocity_of_a_parabola(start):
    np.testing.assert_allclose(initial_state(parabola(), start), [0.3, 2.0], rtol=1e-9)


def test_derived_start_uses_the_recorded_times():
    t = np.array([0.0, 0.004, 0.014, 0.024, 0.034, 0.044, 0.054])
    e = tn.from_arrays(1.0 + 3.0 * t, dt=0.01, t=t, coordinates={"a": "angular"})
    np.testing.assert_allclose(initial_state(e, "derived-6"), [1.0, 3.0], rtol=1e-9)


@pytest.mark.parametrize("start", ["derived-2", "derived-31", "derived", "row 1"])
def test_other_starts_are_refused(start):
    with pytest.raises(tn.InputError):
        initial_state(parabola(), start)


def test_default_start_is_file_only_where_a_sensor_measured_all_velocities():
    v = 2.0 - 8.0 * 0.01 * np.arange(30)
    stored = parabola(v=v)
    assert default_start([stored]) == "file"
    assert default_start([stored, parabola()]) == "derived-6"
    assert default_start([parabola(v=v, v_measured=False)]) == "derived-6"  # late, if filtered
    assert default_start([parabola(v=np.zeros(30))]) == "derived-6"  # rows that are padding
