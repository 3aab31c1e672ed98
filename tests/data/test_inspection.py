"""What inspecting a record finds."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from balancing import balanced

import tustinnet as tn
from tustinnet.check.report import inspect_experiment
from tustinnet.data.inspection import still_coordinates, transient_end
from tustinnet.systems.qube_servo2_twin import twin

DT = 0.01
COUNT = 2 * np.pi / 4096


def swing(samples: int = 800, rate: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Position and velocity of a damped swing."""
    z = np.exp((-rate + 6j) * np.arange(samples) * DT)
    return np.real(z), np.real((-rate + 6j) * z)


def quantised(q: np.ndarray, count: float = COUNT) -> np.ndarray:
    return np.round(q / count) * count


def record(
    q: np.ndarray,
    v: np.ndarray | None = None,
    u: np.ndarray | None = None,
    *,
    resolution: float | None = COUNT,
    limits: tuple[float, float] | None = None,
) -> tn.Experiment:
    return tn.from_arrays(
        q,
        u,
        v=v,
        dt=DT,
        coordinates=[tn.Coordinate("angle", "angular", resolution)],
        inputs=[] if u is None else [tn.Input("torque", "N m", limits=limits)],
    )


@pytest.mark.real
def test_the_count_of_the_measured_data_is_found_in_every_record(real_data: Path) -> None:
    for e in tn.load(real_data):
        found = [c.count for c in inspect_experiment(e).coordinates]
        assert found == pytest.approx([0.00306640625] * 2, rel=1e-3), e.name


# --- the transient ---


def test_a_free_record_has_its_transient_until_it_settles() -> None:
    report = inspect_experiment(record(quantised(swing()[0])))
    assert report.k_bar * DT == pytest.approx(np.log(20), abs=0.6)
    assert not report.k_bar_declared
    assert not report.forced


def test_a_forced_record_has_no_end_of_its_transient() -> None:
    q, _ = swing()
    e = record(q, u=np.arange(len(q)) % 2)
    assert transient_end(e) == len(e)
    assert inspect_experiment(e).forced


@pytest.mark.parametrize("u", [None, np.arange(800) % 2])
def test_a_declared_end_of_the_transient_wins(u: np.ndarray | None) -> None:
    report = inspect_experiment(replace(record(swing()[0], u=u), k_bar=123))
    assert (report.k_bar, report.k_bar_declared) == (123, True)


def test_a_record_that_moves_to_its_end_never_settles() -> None:
    e = record(swing(rate=0.0)[0])
    assert transient_end(e) == len(e)


def test_a_coordinate_that_never_moves_does_not_prolong_the_transient() -> None:
    q, _ = swing()
    both = tn.from_arrays(
        np.stack([q, np.full_like(q, 0.3)], 1), dt=DT, coordinates={"a": "angular", "b": "angular"}
    )
    assert transient_end(both) == transient_end(record(q, resolution=None))


def test_the_share_at_rest_is_the_time_near_an_equilibrium() -> None:
    q, _ = swing(400)
    report = inspect_experiment(record(np.concatenate([q, np.full(400, q[-1])])))
    assert 0.5 < report.rest_share < 0.8
    assert inspect_experiment(record(swing(rate=0.0)[0])).rest_share == 0.0


# --- time, coordinates, inputs ---


def test_the_report_says_what_the_time_base_is() -> None:
    t = np.delete(np.arange(805) * DT, slice(100, 105))
    e = replace(record(swing()[0]), t=t, split="train", notes=("kept",))
    report = inspect_experiment(e)
    assert (report.name, report.split, report.samples) == ("experiment", "train", 800)
    assert report.seconds == pytest.approx(8.04)
    assert report.dt == DT
    assert report.recording.worst_interval == pytest.approx(0.06)
    assert report.recording.worst_sample == 100
    assert report.notes == ("kept",)


def test_the_report_of_a_resampled_record_tells_of_the_log() -> None:
    t = np.delete(np.arange(805) * DT, slice(100, 105))
    e = replace(record(quantised(np.cos(4 * t))), t=t)
    report = inspect_experiment(e.resample(0.02))
    assert (report.samples, report.recording.samples) == (403, 800)
    assert report.recording.median_dt == pytest.approx(DT)
    assert report.recording.gaps == (pytest.approx((0.99, 1.05)),)
    assert report.coordinates[0].count == pytest.approx(COUNT, rel=1e-3)


def test_the_report_says_what_the_coordinates_do() -> None:
    q, v = swing()
    (angle,) = inspect_experiment(record(quantised(q))).coordinates
    assert angle.name == "angle"
    assert angle.range == pytest.approx((q.min(), q.max()), abs=COUNT)
    assert angle.peak_speed == pytest.approx(np.abs(v).max(), rel=0.05)
    assert angle.count == pytest.approx(COUNT, rel=1e-3)
    assert angle.declared_count == COUNT
    assert angle.resting == pytest.approx(0, abs=COUNT)


def test_the_report_says_how_the_system_is_excited() -> None:
    t = np.arange(800) * DT
    u = 3 * np.sin(2 * np.pi * 4 * t)
    (torque,) = inspect_experiment(record(swing()[0], u=u)).inputs
    assert torque.name == "torque"
    assert torque.range == pytest.approx((-3, 3), abs=0.05)
    assert torque.rms == pytest.approx(3 / np.sqrt(2), rel=1e-3)
    assert torque.bandwidth == pytest.approx(4.0, abs=0.2)
    assert torque.saturated == 0.0


def test_a_wide_excitation_has_a_wide_band_and_a_constant_none() -> None:
    q, _ = swing()
    noise = np.random.default_rng(0).normal(size=len(q))
    (wide,) = inspect_experiment(record(q, u=noise)).inputs
    assert wide.bandwidth == pytest.approx(0.9 * 50, rel=0.05)
    (constant,) = inspect_experiment(record(q, u=np.full_like(q, 2.0))).inputs
    assert constant.bandwidth is None


@pytest.mark.parametrize("limits", [None, (-1.0, 1.0)])
def test_an_input_cut_at_its_limits_is_saturated(limits: tuple[float, float] | None) -> None:
    q, _ = swing()
    u = np.clip(np.random.default_rng(0).normal(size=len(q)), -1, 1)
    (torque,) = inspect_experiment(record(q, u=u, limits=limits)).inputs
    assert torque.saturated == pytest.approx(np.mean(np.abs(u) == 1))
    assert torque.saturated > 0.2


def test_an_input_of_a_few_levels_is_not_called_saturated() -> None:
    q, _ = swing()
    u = np.sign(np.random.default_rng(0).normal(size=len(q)))
    assert inspect_experiment(record(q, u=u)).inputs[0].saturated == 0.0


def test_held_levels_are_not_called_saturated_where_they_are_put_on_a_grid() -> None:
    rng, q = np.random.default_rng(0), swing()[0]
    u = np.repeat(rng.choice([-4.0, 4.0], len(q) // 20), 20)
    e = record(q, u=u)
    jitter = DT * rng.uniform(-0.2, 0.2, len(q))
    on_grid = replace(e, t=e.t + jitter).resample(DT)
    assert len(np.unique(on_grid.u)) > 10
    assert inspect_experiment(on_grid).inputs[0].saturated == 0.0


def test_declared_limits_decide_what_is_saturated() -> None:
    q, _ = swing()
    u = np.sign(np.random.default_rng(0).normal(size=len(q)))
    for limit, share in ((2.0, 0.0), (1.0, 1.0)):
        report = inspect_experiment(record(q, u=u, limits=(-limit, limit)))
        assert report.inputs[0].saturated == share


# --- suspicious rows ---


def suspicious(e: tn.Experiment) -> str:
    return "\n".join(inspect_experiment(e).suspicious)


def test_a_sound_record_is_not_suspicious() -> None:
    q, v = swing()
    assert suspicious(record(quantised(q), v)) == ""


def test_padded_velocities_are_suspicious() -> None:
    q, v = (x[50:] for x in swing(rate=0.1))
    v[:2] = v[-3:] = 0
    assert "zero rows (2 at the beginning, 3 at the end," in suspicious(record(q, v))


def test_a_jump_is_suspicious_with_its_sample() -> None:
    q, _ = swing()
    q[300] += 1.0
    assert "angle jumps at sample 300, 301: bad rows, lost counts, runs in a row?" in suspicious(
        record(quantised(q))
    )


def test_a_jump_in_a_short_record_is_suspicious() -> None:
    q, _ = swing(60)
    q[33:] += 1000.0
    assert (
        "angle jumps at sample 33: bad rows, lost counts, runs in a row? (1 jump of up to 0.973"
        in suspicious(record(q))
    )


def test_degrees_declared_as_radians_are_suspicious() -> None:
    told = suspicious(record(np.rad2deg(1.5 * swing(rate=0.1)[0]), resolution=None))
    assert "angle moves more than a quarter turn in" in told
    assert "another unit" in told
    assert "jumps" not in told


def test_a_spike_of_an_input_is_suspicious_with_its_sample() -> None:
    q, _ = swing()
    u = np.random.default_rng(0).normal(size=len(q))
    assert suspicious(record(q, u=u)) == ""
    u[55] = 1e4
    assert "torque has spikes at sample 55" in suspicious(record(q, u=u))


@pytest.mark.real
def test_the_measured_records_have_padded_velocities_and_nothing_else(real_data: Path) -> None:
    for e in tn.load(real_data):
        assert all("padded" in text for text in inspect_experiment(e).suspicious), e.name


@pytest.mark.thorough
def test_records_of_the_twin_have_padded_velocities_and_nothing_else() -> None:
    for e in twin(0):
        assert all("padded" in text for text in inspect_experiment(e).suspicious), e.name


@pytest.mark.parametrize("factor", [-1.0, 180 / np.pi, np.pi / 180, 1e3])
@pytest.mark.parametrize("padded", [False, True])
def test_velocities_of_another_unit_or_sign_are_suspicious(factor: float, padded: bool) -> None:
    q, v = swing(rate=0.1)
    if padded:
        v[:2] = v[-2:] = 0
    told = suspicious(record(q, factor * v))
    expected = "the opposite sign of" if factor < 0 else "another scale than"
    assert f"angle: the velocity column has {expected}" in told


def test_another_count_than_declared_is_suspicious() -> None:
    told = suspicious(record(quantised(swing()[0]), resolution=COUNT / 1.5))
    assert "encoder count 0.001534 rad found (0.0010227 rad declared, 1.5 times)" in told


def test_a_multiple_of_the_declared_count_is_suspicious_too() -> None:
    found = suspicious(record(quantised(swing()[0], 2 * COUNT)))
    assert "encoder count 0.003068 rad found (0.001534 rad declared, 2 times)" in found


def test_a_few_levels_are_no_count_of_an_encoder() -> None:
    positions = np.repeat([0.0, 0.5, 1.0, 0.5, 1.5], 40)  # a stage that is driven from stop to stop
    assert "encoder count" not in suspicious(record(positions, resolution=1e-3))


def test_a_coordinate_that_never_changes_is_suspicious() -> None:
    q, _ = swing()
    e = tn.from_arrays(
        np.stack([q, 0 * q], 1), dt=DT, coordinates={"moving": "angular", "still": "angular"}
    )
    assert inspect_experiment(e).suspicious == ("still never changes (0 rad in all 800 samples)",)
    assert still_coordinates([e]) == ["still"]
    assert still_coordinates([e, replace(e, q=e.q[:, ::-1])]) == []


def test_the_rounding_of_a_constant_is_no_motion() -> None:
    q, _ = swing()
    both = np.stack([q, 0.3 + 1e-16 * np.arange(len(q)) / len(q)], 1)
    e = tn.from_arrays(both, dt=DT, coordinates={"a": "angular", "b": "angular"})
    assert still_coordinates([e]) == ["b"]
    for source in ("stencil", "savgol"):
        assert not e.velocities(source)[:, 1].any()


# --- what a controller holds ---


def test_an_unstable_equilibrium_that_is_held_is_told_and_ends_no_transient() -> None:
    (e,) = balanced(1, 4.0)
    report = inspect_experiment(e)
    assert report.held is not None
    assert report.held.sample == 0
    assert report.held.e_fold == pytest.approx(1 / 11.2, rel=0.25)
    assert report.k_bar == len(e)


def test_the_hold_begins_where_the_swing_up_ends() -> None:
    (e,) = balanced(1, 4.0)
    swung = 2.0 + np.cos(np.arange(100) * 0.2)
    q = np.concatenate([np.stack([np.zeros(100), swung], axis=1), e.q])
    u = np.concatenate([np.sin(np.arange(100.0))[:, None], e.u])
    whole = tn.from_arrays(q, u, dt=e.dt, coordinates=e.coordinates, inputs=e.inputs)
    report = inspect_experiment(whole)
    assert report.held is not None
    assert report.held.sample == 100


@pytest.mark.thorough
def test_nothing_is_held_where_motion_is_stable(pendulum: tn.DataSet) -> None:
    assert all(inspect_experiment(e).held is None for e in [*pendulum, *twin(0)])
