"""Errors some steps ahead of models whose internal states say what the past was."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from swinging import CREEPING, DT, SWING, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.evaluate import ahead
from tustinnet.families.tustin_net import TustinNet, random_tustin_net
from tustinnet.models.blocks import make_scaling
from tustinnet.models.contract import with_dtype

HORIZON = 20


def network(times: tuple[float, ...] = (), kind: type[TustinNet] = TustinNet) -> TustinNet:
    """A Tustin-Net whose internal states matter."""
    one = np.ones(1)
    channels = swing_model().channels
    channels = tn.Channels(channels.coordinates, channels.inputs, DT)
    units = make_scaling(
        position_offset=np.zeros(0),
        position_scale=np.zeros(0),
        velocity=one,
        input=one,
        acceleration=20 * one,
        memory=0.05 * np.ones(len(times)),
    )
    net = random_tustin_net(
        channels, units, jax.random.key(3), relaxation_times=times, hidden=(6,), output_bias=True
    )
    return with_dtype(kind(net.network, net.channels, net.relaxation_times), np.float64)


def of_network() -> tuple[tn.Model, list[tn.Experiment]]:
    """A network that remembers, and what it simulates."""
    model, records = network((0.2, 1.0)), []
    for k, x0 in enumerate([[0.5, 1.0], [-1.0, 0.0]]):
        u = voltage(80, k)
        x = np.asarray(tn.rollout(model, np.array([*x0, 0.0, 0.0]), u[:-1, None]))
        records.append(
            tn.from_arrays(
                x[:, 0],
                u,
                v=x[:, 1],
                dt=DT,
                name=f"run{k}",
                coordinates=model.coordinates,
                inputs=model.inputs,
            )
        )
    return model, records


def of_system() -> tuple[tn.Model, list[tn.Experiment]]:
    """Equations of motion that remember, and what they simulate."""
    model = tn.discretise(swing_model(system=CREEPING), DT, 8)
    starts = [[2.0, 0.0, 0.0], [-1.0, 3.0, 0.0]]
    return model, [
        simulated(f"run{k}", x0, voltage(80, k), system=CREEPING) for k, x0 in enumerate(starts)
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("made", [of_network, of_system])
def test_internal_states_start_as_the_record_led_to_them(made, monkeypatch):
    model, records = made()
    assert model.internal
    assert np.all(tn.rmse_ahead(model, records, HORIZON) < 1e-8)

    along = ahead.states_along

    def forgetful(*arguments):
        of = model.channels
        states = along(*arguments)
        return [np.where(np.arange(x.shape[1]) < of.internal.start, x, 0.0) for x in states]

    monkeypatch.setattr(ahead, "states_along", forgetful)
    assert tn.rmse_ahead(model, records, HORIZON)[-1] > 1e-3


class Warming(TustinNet):
    """A model that needs some samples before it says anything."""

    @property
    def warm_up(self) -> int:
        return 15


def test_samples_that_a_warm_up_needs_are_not_started_from():
    warm, cold = network(kind=Warming), network()
    e = simulated("run", [1.0, 0.0], voltage(60, 3), system=SWING)
    found = tn.rmse_ahead(warm, [e], 10)
    np.testing.assert_allclose(found, tn.rmse_ahead(cold, [e[15:]], 10), rtol=1e-9)
    assert not np.allclose(found, tn.rmse_ahead(cold, [e], 10), rtol=1e-3)
    with pytest.raises(tn.InputError, match="45 steps; expected 1 to 44"):
        tn.rmse_ahead(warm, [e], 45)


@pytest.mark.thorough
def test_every_sample_with_so_many_behind_it_is_started_from():
    model = network()
    e = simulated("run", [1.0, 0.0], voltage(30, 3))
    found = tn.rmse_ahead(model, [e], 5)
    assert e.v is not None
    squares = [[] for _ in range(5)]
    for k in range(len(e) - 1):
        x = jnp.asarray([*e.q[k], *e.v[k]])
        for ahead_by in range(min(5, len(e) - 1 - k)):
            x = model.step(x, jnp.asarray(e.u[k + ahead_by]))
            squares[ahead_by].append(float(x[0] - e.q[k + ahead_by + 1, 0]) ** 2)
    assert [len(s) for s in squares] == [29, 28, 27, 26, 25]
    np.testing.assert_allclose(found, [np.sqrt(np.mean(s)) for s in squares], rtol=1e-9)
