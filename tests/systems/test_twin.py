"""The simulated Qube-Servo 2 and how simulated records are logged."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import tustinnet as tn
from tustinnet.systems import qube_servo2, qube_servo2_twin
from tustinnet.systems.qube_servo2 import WITH_MEMORY
from tustinnet.systems.qube_servo2_twin import COUNT, TWIN_VALUES
from tustinnet.systems.twin import Logger, TwinRun, log_runs


@pytest.fixture(scope="module")
def twin() -> tn.DataSet:
    return qube_servo2_twin.twin()


def of(twin: tn.DataSet, kind: str) -> list[tn.Experiment]:
    return [e for e in twin if kind in e.name]


def model() -> tn.LagrangianModel:
    return tn.LagrangianModel(WITH_MEMORY, {k: jnp.asarray(v) for k, v in TWIN_VALUES.items()})


def same(one: tn.DataSet, other: tn.DataSet) -> bool:
    return all(
        np.array_equal(a.q, b.q) and np.array_equal(a.u, b.u) and np.array_equal(a.t, b.t)
        for a, b in zip(one, other, strict=True)
    )


@pytest.mark.thorough
def test_the_seed_decides_everything(twin):
    assert same(twin, qube_servo2_twin.twin(0))
    assert not same(twin, qube_servo2_twin.twin(1))


@pytest.mark.thorough
def test_there_are_as_many_records_as_were_published(twin):
    counts = {
        split: (len(of(twin.split(split), "_fall")), len(of(twin.split(split), "_noise")))
        for split in twin.splits
    }
    assert counts == {"train": (10, 5), "validation": (4, 2), "test": (4, 4)}
    assert {len(e) for e in of(twin, "_noise")} == {1500}
    assert all(716 <= len(e) < 800 for e in of(twin, "_fall"))


def test_every_record_says_that_it_is_the_twins(twin):
    assert twin.name == "qube-servo2-twin"
    assert all(e.name.startswith("twin_") for e in twin)
    assert {e.source for e in twin} == {"simulated"}


def test_records_are_of_the_packaged_system(twin):
    assert [(c.name, c.kind) for c in twin.coordinates] == [
        ("theta", "angular"),
        ("alpha", "angular"),
    ]
    assert [c.resolution for c in twin.coordinates] == [COUNT, COUNT]
    assert twin.inputs == qube_servo2.SYSTEM.inputs
    assert twin.dt == 0.01


def test_positions_are_whole_counts_apart(twin):
    for e in twin:
        counts = (e.q - e.q[0]) / COUNT
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


def test_where_the_counts_lie_differs_between_records(twin):
    places = np.array([e.q[0] / COUNT % 1 for e in twin])
    assert len(np.unique(places.round(6), axis=0)) == len(twin)


def test_timestamps_jitter_by_ten_microseconds(twin):
    for e in twin:
        assert e.t[0] == 0.0
        assert np.diff(e.t).std() == pytest.approx(np.sqrt(2) * 1e-5, rel=0.15)
        drift = e.t - np.arange(len(e)) * 0.01
        assert drift.std() == pytest.approx(1e-5, rel=0.15)


def test_velocities_are_padded_with_zero_rows_as_in_real_logs(twin):
    for e in twin:
        assert e.v is not None
        assert not e.v_measured
        assert not e.v[:3].any()
        assert not e.v[-2:].any()
    falling = twin["twin_fall1"]
    assert falling.v is not None
    assert falling.v[3:100].any(axis=1).all()
    np.testing.assert_allclose(falling.v[3:-2], falling.velocities("stencil")[3:-2])


def test_falls_begin_near_upright_on_either_side(twin):
    starts = np.array([e.q[0] for e in of(twin, "_fall")])
    tilt = np.minimum(np.abs(starts[:, 1]), np.abs(starts[:, 1] - 2 * np.pi))
    assert np.all((tilt > 0.25 - COUNT) & (tilt < 0.76 + COUNT))
    assert np.any(starts[:, 1] < np.pi)
    assert np.any(starts[:, 1] > np.pi)
    assert np.all((starts[:, 0] > -1.7 - COUNT) & (starts[:, 0] < 1.0 + COUNT))


def test_falls_begin_with_speeds_that_lead_away_from_upright(twin):
    starts = np.array([tn.initial_state(e, "derived-6") for e in of(twin, "_fall")])
    away = np.where(starts[:, 1] < np.pi, 1.0, -1.0) * starts[:, 3]
    assert np.abs(starts[:, 2]).max() < 3.0 + 0.5
    assert np.all((away > -0.3) & (away < 3.0 + 0.5))


def test_falls_are_not_driven_and_end_hanging(twin):
    for e in of(twin, "_fall"):
        assert not e.u.any()
        assert e.q[-1, 1] == pytest.approx(np.pi, abs=0.1)


def test_noise_is_uniform_of_two_to_four_volts_from_hanging_at_rest(twin):
    amplitudes = []
    for e in of(twin, "_noise"):
        amplitudes.append(np.abs(e.u).max())
        assert e.u.std() == pytest.approx(amplitudes[-1] / np.sqrt(3), rel=0.05)
        assert e.q[0] == pytest.approx([0.0, np.pi], abs=0.05 + COUNT)
        assert np.abs(e.q[:, 1] - np.pi).max() < np.pi / 2
    assert min(amplitudes) == pytest.approx(2.0, rel=0.01)
    assert max(amplitudes) == pytest.approx(4.0, rel=0.01)


def test_records_are_numbers_throughout(twin):
    for e in twin:
        assert all(np.isfinite(a).all() for a in (e.t, e.q, e.u, e.v))


# --- logging ---


def runs() -> list[TwinRun]:
    """Two of unequal length."""
    generator = np.random.default_rng(2)
    return [
        TwinRun(
            "long", "train", np.array([0.1, 0.5, 0.0, 1.0, 0.0]), generator.uniform(-3, 3, (60, 1))
        ),
        TwinRun("short", "test", np.array([0.0, 1.0, 2.0, 3.0, 0.0]), np.zeros((41, 1))),
    ]


def log(logger: Logger) -> tuple[tn.Experiment, ...]:
    coordinates = tuple(replace(c, resolution=COUNT) for c in WITH_MEMORY.coordinates)
    channels = tn.Channels(coordinates, WITH_MEMORY.inputs)
    return log_runs(model(), channels, runs(), logger, np.random.default_rng(0))


@pytest.mark.thorough
def test_without_jitter_and_counts_a_log_is_a_rollout():
    for e, run in zip(log(Logger(jitter=0.0, counts=False, substeps=4)), runs(), strict=True):
        expected = tn.rollout(tn.discretise(model(), 0.01, 4), run.x0, run.u[:-1])
        np.testing.assert_allclose(e.q, np.asarray(expected)[:, :2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(e.t, np.arange(len(run.u)) * 0.01, atol=1e-15)
        np.testing.assert_array_equal(e.u, run.u)
        assert (e.name, e.split) == (run.name, run.split)


def test_counts_round_to_the_nearest():
    read = log(Logger(jitter=0.0, substeps=4))
    exact = log(Logger(jitter=0.0, counts=False, substeps=4))
    errors = np.concatenate([a.q - b.q for a, b in zip(read, exact, strict=True)])
    assert np.abs(errors).max() <= COUNT / 2 + 1e-12
    assert errors.std() == pytest.approx(COUNT / np.sqrt(12), rel=0.2)


def test_samples_are_taken_at_the_times_that_are_written_down():
    late, punctual = (
        log(Logger(jitter=jitter, counts=False, substeps=4))[1] for jitter in (1e-3, 0.0)
    )
    inside = late.t <= punctual.t[-1]
    moved = CubicSpline(punctual.t, punctual.q)(late.t[inside])
    assert np.abs(late.q[inside] - moved).max() < 1e-3
    assert np.abs(late.q - punctual.q).max() > 1e-2
