"""Records cut into segments."""

from dataclasses import replace

import numpy as np
import pytest
from swinging import COUNT, CREEPING, DT, falls, noises, read_by_encoder, records, swing_model

import tustinnet as tn
from tustinnet.fitting.residual import Residual
from tustinnet.fitting.shooting.segments import CutOptions, Segments, cut_records
from tustinnet.simulate.starts import initial_state


def cut_into(
    length: int | None,
    experiments: list[tn.Experiment] | None = None,
    *,
    initial_treatment: str = "anchored",
    units: tuple[float, ...] = (1.0,),
    timestamps: bool = False,
    model: tn.LagrangianModel | None = None,
) -> Segments:
    residual = Residual((False,) * len(units), units)
    return cut_records(
        records() if experiments is None else experiments,
        tn.discretise(model or swing_model(), DT),
        CutOptions(residual, length, initial_treatment, timestamps),
    )


@pytest.mark.parametrize("length", [None, 7, 30, 60, 1000])
def test_segments_cover_every_step_of_every_record_once(length):
    s = cut_into(length)
    for i, e in enumerate(records()):
        rows = np.flatnonzero(s.record == i)
        assert s.steps[rows].sum() == len(e) - 1
        steps = [s.measurements[s.rows(row)][:-1, 0] for row in rows.tolist()]
        np.testing.assert_array_equal(np.concatenate(steps), e.q[:-1, 0])
        driven = [s.inputs[s.rows(row)][:-1, 0] for row in rows.tolist()]
        np.testing.assert_array_equal(np.concatenate(driven), e.u[:-1, 0])


def test_segments_are_about_as_long_as_asked_for():
    assert set(cut_into(30).steps) <= set(range(24, 42))
    assert cut_into(None).steps.tolist() == [199, 199, 199, 159]
    # longer ones begin where shorter ones did
    assert set(cut_into(100).first_row) < set(cut_into(30).first_row)


def test_every_record_weighs_the_same_whatever_its_length():
    s = cut_into(None, units=(1 / 3,))
    weights = [np.sum(s.weights[s.rows(row)] ** 2) for row in range(4)]
    np.testing.assert_allclose(weights, 9.0)
    np.testing.assert_allclose(s.share, [1 / 200, 1 / 200, 1 / 200, 1 / 160])
    pieces = cut_into(40)
    for i, e in enumerate(records()):
        rows = pieces.record == i
        joints = rows.sum() - 1  # a joint ends one segment and begins the next
        rows_of_segments = [pieces.rows(row) for row in np.flatnonzero(rows).tolist()]
        weights = [np.sum(pieces.weights[at] ** 2) for at in rows_of_segments]
        assert sum(weights) == pytest.approx((len(e) + joints) / len(e))


def test_states_inside_a_record_are_read_from_its_neighbourhood():
    s = cut_into(25)
    for row in np.flatnonzero(np.diff(s.record, prepend=-1) == 0):
        e = records()[s.record[row]]
        k = int(s.steps[:row][s.record[:row] == s.record[row]].sum())
        assert e.v is not None
        assert s.x0[row, 0] == pytest.approx(e.q[k, 0], abs=0.01)
        assert s.x0[row, 1] == pytest.approx(e.v[k, 0], abs=0.4)  # of speeds up to 9 rad/s


def test_a_records_first_state_is_the_parabolas_or_the_named_one():
    first, noise = falls()[0], noises()[0]
    estimated = cut_into(None, [first, noise])
    np.testing.assert_allclose(estimated.x0[0], initial_state(first, "derived-6"))
    assert estimated.is_free.all()
    named = cut_into(50, [first, noise], initial_treatment="file")
    np.testing.assert_array_equal(named.x0[0], [2.5, 0.0])
    begins = np.diff(named.record, prepend=-1) != 0
    assert not named.is_free[begins].any()
    assert named.is_free[~begins].all()


def test_only_measured_positions_hold_the_states_that_are_searched_for():
    s = cut_into(40)
    assert (s.precision[:, 0] > 0).all()
    assert not s.precision[:, 1].any()
    assert not cut_into(40, initial_treatment="unanchored").precision.any()
    named = cut_into(None, initial_treatment="file")
    assert not named.precision.any()


def test_a_position_is_trusted_to_half_a_count_at_best():
    read = cut_into(40, [read_by_encoder(e) for e in falls()])
    assert read.precision[:, 0].max() == pytest.approx(2 / COUNT)
    assert cut_into(40, list(falls())).precision[:, 0].max() > 4 / COUNT


def test_internal_states_start_at_zero_and_are_searched_for_further_on():
    s = cut_into(50, model=swing_model(system=CREEPING))
    begins = np.diff(s.record, prepend=-1) != 0
    assert s.x0.shape[1] == 3
    assert not s.x0[:, 2].any()
    assert not s.is_free[begins, 2].any()
    assert s.is_free[~begins, 2].all()
    assert not s.precision[:, 2].any()


def test_velocities_are_targets_where_the_loss_is_of_the_state():
    e = noises()[1]
    s = cut_into(None, [e], units=(1.0, 2.0))
    np.testing.assert_array_equal(s.measurements, np.column_stack([e.q, e.velocities()]))
    np.testing.assert_allclose(s.weights * np.sqrt(160), [[1.0, 0.5]] * 160)


def test_periods_are_the_timestamps_or_the_nominal_ones():
    e = falls()[0]
    late = replace(e, t=e.t + 1e-3 * np.sin(np.arange(200)))
    recorded = cut_into(None, [late], timestamps=True)
    np.testing.assert_allclose(recorded.periods[:-1], np.diff(late.t))
    np.testing.assert_array_equal(cut_into(None, [late]).periods[:-1], DT)
