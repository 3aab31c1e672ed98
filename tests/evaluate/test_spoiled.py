"""Parts of records that spoil a fit: named at the right place, left out, none on clean records."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import DT, SYSTEM
from spoilt_records import BEGIN, END, HAND, SAMPLES, records, simulate, write
from swinging import LAGGING, simulated, swing_model, voltage

import tustinnet as tn
from tustinnet.data.inspection import held_equilibrium
from tustinnet.data.spoiled import card_entry, find_without_model, leave_out, spoiled_stretch
from tustinnet.evaluate.spoiled import _simulate_pieces, find_by_model


@pytest.fixture(scope="module")
def system_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("system") / "small_pendulum.py"
    path.write_text(SYSTEM)
    return path


def fit(spoilt: str, system_file):
    return tn.fit(tn.DataSet("runs", records(spoilt)), "grey", system=system_file).model


@pytest.mark.thorough
def test_clean_records_raise_no_alarm(system_file):
    assert find_by_model(fit("", system_file), records()) == []
    for e in records():
        assert find_without_model(e, held_equilibrium(e)) == []


@pytest.mark.thorough
def test_a_hand_is_named_at_its_record_and_time(system_file):
    (part,) = find_by_model(fit("hand", system_file), records("hand"))
    assert (part.record, part.cause) == ("run2", "unlogged force")
    assert part.seconds is not None
    assert part.seconds == pytest.approx((BEGIN, END), abs=0.5)
    assert part.seconds[0] < BEGIN + 0.1
    assert part.seconds[1] > END - 0.1


def test_starts_that_are_expected_elsewhere_leave_no_error_of_a_piece():
    """The internal state of a lag is found though the model expects another."""
    known = {"share": 0.0}
    e = simulated("lag", [0.3, 0.0, 0.5], np.repeat(voltage(40, 3), 10), known, LAGGING)
    noisy = e.q + np.random.default_rng(0).normal(size=e.q.shape) * 1e-5
    model = tn.discretise(swing_model(known, LAGGING), e.dt, 8, inputs=e.inputs)
    (pieces,) = _simulate_pieces(model, [replace(e, q=noisy, v=None)], 20)
    assert np.abs(pieces.residual).max() < 1e-4


def test_friction_that_is_not_modelled_is_no_hand(system_file):
    assert find_by_model(fit("friction", system_file), records("friction")) == []


@pytest.mark.thorough
def test_a_hand_is_named_beside_friction_that_is_not_modelled(system_file):
    parts = find_by_model(fit("both", system_file), records("both"))
    (hand,) = [p for p in parts if p.cause == "unlogged force"]
    assert hand.record == "run2"
    assert hand.seconds == pytest.approx((BEGIN, END), abs=0.5)


@pytest.mark.thorough
def test_what_a_model_lacks_in_several_records_is_no_hand(system_file):
    # an actuator that gives no more than a third of what is asked for in three of the records
    data = records("weak")
    parts = find_by_model(fit("weak", system_file), data)
    assert [p.record for p in parts if p.cause == "unlogged force"] == []


def test_records_with_another_payload_are_named_as_a_whole(system_file):
    parts = find_by_model(fit("payload", system_file), records("payload"))
    assert [(p.record, p.cause, p.samples) for p in parts] == [
        ("run1", "other conditions", None),
        ("run2", "other conditions", None),
    ]


def test_leaving_out_cuts_stretches_and_drops_records_but_never_those_of_the_test():
    data = tn.DataSet("runs", (*records("hand"), simulate("last", 9, split="test")))
    e = data["run2"]
    stretch = stretch_of(e, HAND.start, HAND.stop)
    whole = replace(stretch, record="run4", samples=None, seconds=None)
    on_test = replace(stretch, record="last")
    named = replace(stretch, record="run0", removable=False)
    remaining, findings = leave_out(data, [stretch, whole, on_test, named])
    assert [x.name for x in remaining] == [
        "run0",
        "run1",
        "run2[0:150]",
        "run2[225:400]",
        "run3",
        "run5",
        "last",
    ]
    assert [f.values["place"] for f in findings] == ["run2, 3 to 4.48 s", "run4"]
    np.testing.assert_array_equal(remaining["run2[225:400]"].q, e.q[225:])


def test_a_split_never_loses_its_last_record():
    data = tn.DataSet("one", (replace(records()[0], split="validation"), *records()[1:]))
    whole = replace(stretch_of(data["run0"], 0, SAMPLES), samples=None, seconds=None)
    assert leave_out(data, [whole]) == (data, ())


def stretch_of(e: tn.Experiment, first: int, stop: int):
    return spoiled_stretch(e, first, stop, "unlogged force", "moved by a hand")


# --- without a model ---


def pushed(*, from_rest: bool) -> tn.Experiment:
    """A record in which the torque is zero for a while and the pendulum is pushed meanwhile."""
    n = 600
    t = np.arange(n) * DT
    u = np.where(t < 2, 2 * np.sin(3 * t), 0.0) + np.where(t > 10, np.sin(3 * t), 0.0)
    swing = np.exp(-2 * (t - 2)) * np.sin(4 * (t - 2)) * (t >= 2)
    q = np.where(t < 2, 0.5 * np.sin(4 * t) * (2 - t), 0.1 * swing)
    if from_rest:
        q = q + np.where(t >= 7, 0.8 * np.exp(-(t - 7)) * np.sin(4 * (t - 7)), 0.0)
    return tn.from_arrays(
        q, u, dt=DT, coordinates={"angle": "angular"}, inputs={"torque": "N m"}, name="pushed"
    )


def test_motion_from_rest_without_an_input_is_a_hand():
    e = pushed(from_rest=True)
    (part,) = find_without_model(e, held_equilibrium(e))
    assert (part.cause, part.removable) == ("unlogged force", True)
    assert part.seconds is not None
    assert 6.4 < part.seconds[0] < 7.1
    assert part.seconds[1] == pytest.approx(10.0, abs=0.1)
    quiet = pushed(from_rest=False)
    assert find_without_model(quiet, held_equilibrium(quiet)) == []


@pytest.mark.parametrize("kind", ["prbs", "kick", "zigzag", "clipped"])
def test_what_an_input_does_spoils_nothing(kind):
    e, rng = records()[0], np.random.default_rng(0)
    n, t = SAMPLES, records()[0].t
    u = {
        "prbs": np.repeat(rng.choice([-4.0, 4.0], n // 8), 8),
        "kick": np.where(np.arange(n) < 80, 6.0, 0.0),
        "zigzag": np.clip(30 * np.sin(0.8 * t), -10, 10),
        "clipped": np.clip(3 * np.sin(2 * t), -2.0, 2.0),
    }[kind]
    jittered = replace(e, u=u[:, None], t=t + DT * rng.uniform(-0.2, 0.2, n)).resample(DT)
    assert find_without_model(jittered, None) == []


# --- lines for the card ---


def test_lines_for_the_card_load_as_the_parts_that_remain(tmp_path):
    folder = tmp_path / "logs"
    write(folder, records("hand"))
    data = tn.load(folder)
    part = stretch_of(data["run2"], HAND.start, HAND.stop)
    group = card_entry(data["run1"], 0, SAMPLES, {"setup": "run1"})
    card = folder / "dataset.toml"
    card.write_text(card.read_text() + f'[splits]\ntrain = ["run0.csv", {part.card}, {group}]\n')
    loaded = tn.load(folder)
    cut, _ = leave_out(data, [part])
    for a, b in zip(
        (loaded[1], loaded[2]), (cut["run2[0:150]"], cut["run2[225:400]"]), strict=True
    ):
        np.testing.assert_array_equal(a.t, b.t)
        np.testing.assert_array_equal(a.q, b.q)
    assert loaded["run1"].group("setup") == "run1"
    # of a record that is a part of its file, in rows of the file
    later = stretch_of(loaded[2], 75, 100).card
    assert "rows = [225, 300]" in later
    assert "rows = [325, 400]" in later


def test_an_unstable_phase_under_control_is_named_from_its_beginning_on():
    rng, n, h = np.random.default_rng(0), 700, DT / 10
    wanted = np.interp(np.arange(n) * DT, [2.0, 4.0], [0.0, np.pi])
    u, q, x = np.empty(n), np.empty(n), np.zeros(2)
    for k in range(n):
        pull = 20 * np.sin(wanted[k]) + 60 * (wanted[k] - x[0]) - 12 * x[1]
        q[k], u[k] = x[0], pull / 4 + rng.uniform(-2, 2)
        for _ in range(10):
            x = x + h * np.array([x[1], -20 * np.sin(x[0]) - 0.8 * x[1] + 4 * u[k]])
    e = tn.from_arrays(
        q, u, dt=DT, coordinates={"angle": "angular"}, inputs={"torque": "N m"}, name="raised"
    )
    (part,) = find_without_model(replace(e, source="raised.csv"), held_equilibrium(e))
    assert (part.cause, part.removable) == ("unstable phase", False)
    assert part.seconds is not None
    assert 3.0 < part.seconds[0] < 4.5
    assert part.card.startswith('{ file = "raised.csv", seconds = [0, ')
