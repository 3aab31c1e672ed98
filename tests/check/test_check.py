"""The check of records: planted faults are named, clean logs are not."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated.faults import FAULTS, Fault, logs_of

import tustinnet as tn
from tustinnet.check.card_lines import file_parts, without_record
from tustinnet.check.check import check
from tustinnet.check.drafting import find_scales
from tustinnet.check.levels import LEVELS
from tustinnet.check.motion_model import Equations, fit_motion_model
from tustinnet.data.catalog import locate
from tustinnet.data.drafting.draft import draft_card, draft_examined, examine_logs
from tustinnet.data.loading import load_folder
from tustinnet.data.recording import describe_recording
from tustinnet.finding import Finding, make_finding, merge_findings, sort_findings

DT, COUNT = 0.01, 2 * np.pi / 4096
# machines that are simulated in a second; `benchmarks/check.py` runs all faults
QUICK = [f for f in FAULTS if f.machine in ("unbalanced-disc", "positioning-axis")]


def check_folder(folder: Path) -> tuple[Finding, ...]:
    place, card = locate(folder)
    return check(load_folder(place, card), card)


def serious(findings: tuple[Finding, ...]) -> list[str]:
    return [f.text for f in findings if f.is_serious]


@pytest.mark.parametrize("fault", QUICK, ids=lambda f: f.name)
def test_a_planted_fault_is_named_at_its_record_and_channel(fault: Fault, tmp_path: Path) -> None:
    findings = check_folder(fault.write(tmp_path / "logs"))
    assert fault.is_found(findings), [f.text for f in findings]
    named = next(f for f in findings if fault.is_named_by(f))
    assert any(c.isdigit() for c in named.text)
    assert named.mend
    line = named.mend.partition(": ")[2]
    if " = " in line:
        assert tomllib.loads(f"parts = [{line}]" if "[splits]" in named.mend else line)
    key = {"sign": "sign = -1", "offset": "offset = ", "lag": "delay = ", "period": "dt = "}
    if fault.channels and named.channel in fault.channels:
        assert key.get(named.code, "") in named.mend


@pytest.mark.thorough
@pytest.mark.parametrize("machine", ["unbalanced-disc", "positioning-axis"])
def test_clean_logs_have_no_severe_finding_and_no_warning(machine: str, tmp_path: Path) -> None:
    assert serious(check_folder(logs_of(machine).write(tmp_path / "logs"))) == []


def test_counts_that_are_off_by_the_factor_of_a_unit_name_the_unit(tmp_path: Path) -> None:
    """Radians that a card has in degrees; the counts of the encoder are right."""
    q = COUNT * np.round(swing() / COUNT)
    np.savetxt(tmp_path / "a.csv", q, header="arm", comments="")
    card = """name = "arm"
dt = 0.01
[[coordinates]]
name = "arm"
column = "arm"
kind = "angular"
unit = "deg"
counts_per_revolution = 4096
[splits]
train = ["a.csv"]
"""
    (tmp_path / "dataset.toml").write_text(card)
    (found,) = [f for f in check_folder(tmp_path) if f.code == "encoder count"]
    assert found.mend == 'under [[coordinates]] arm: unit = "rad"'


# --- what is no fault ---


def arm(q: np.ndarray, v: np.ndarray | None = None, **record: Any) -> tn.Experiment:
    return tn.from_arrays(
        q, v=v, dt=DT, coordinates=[tn.Coordinate("arm", "angular", COUNT)], **record
    )


def swing(samples: int = 800) -> np.ndarray:
    return np.cos(6 * np.arange(samples) * DT) * np.exp(-0.1 * np.arange(samples) * DT)


def test_velocities_of_an_arm_that_rests_are_no_padding() -> None:
    rng = np.random.default_rng(0)
    rest = COUNT * np.round(rng.uniform(-0.6, 0.6, 428))  # an encoder that flickers
    t = np.arange(600) * DT
    motion = 1 - np.cos(2 * t)
    q = np.concatenate([rest, np.round(motion / COUNT) * COUNT])
    v = np.concatenate([np.zeros(428), np.round(2 * np.sin(2 * t) / 0.01) * 0.01])
    e = arm(q, v)
    assert e.padded_rows == (0, 0)
    assert serious(check([e])) == []


def test_of_velocities_that_no_fit_uses_nothing_is_to_be_done() -> None:
    q = swing()
    v = np.gradient(q, DT)
    v[:3] = 0
    computed, measured = (check([arm(q, v, v_measured=m)]) for m in (False, True))
    assert not [f for f in computed if f.code == "padded velocity"]
    assert [f.severity for f in measured if f.code == "padded velocity"] == ["warning"]


@pytest.mark.parametrize("rate", [2.0, 20.0, 60.0])
def test_a_reversal_at_a_dead_band_is_no_jump(rate: float) -> None:
    # a load behind backlash: it rests at each reversal, and then moves at once at full speed
    motor = 0.5 * np.sin(rate * np.arange(800) * DT)
    load = np.zeros(800)
    for k in range(1, 800):
        load[k] = np.clip(load[k - 1], motor[k] - 0.2, motor[k] + 0.2)
    e = arm(np.round(load / COUNT) * COUNT)
    assert not {"jump", "counter", "frozen sensor"} & {f.code for f in check([e])}


def test_a_joint_that_sticks_where_it_turns_has_no_frozen_sensor() -> None:
    # slower before than after, as friction and gravity have it
    steps = [*range(-9, -1), *[-1] * 9, *[0] * 14, 1, 1, *[2] * 9, *range(3, 9)]
    once = np.cumsum(steps)
    q = np.tile(np.concatenate([once, np.linspace(once[-1], 0, 200)]), 3)
    late = np.random.default_rng(0).uniform(-0.1, 0.1, len(q))
    e = arm(np.round(q) * COUNT, t=DT * (np.arange(len(q)) + late)).resample(DT)
    assert "frozen sensor" not in {f.code for f in check([e])}


def test_a_sensor_that_freezes_over_a_turning_point_is_frozen() -> None:
    q = swing() + 2e-4 * np.random.default_rng(0).normal(size=800)
    q[150:180] = q[150]  # it turns at 157
    found = {f.code for f in check([arm(q)])}
    assert "frozen sensor" in found
    assert "jump" not in found


def test_two_values_a_count_apart_are_a_dead_encoder() -> None:
    flicker = np.cumsum(np.random.default_rng(1).uniform(size=800) < 0.02) % 2
    q = np.stack([swing(), COUNT * flicker], axis=1)
    e = tn.from_arrays(
        q, dt=DT, coordinates=[tn.Coordinate(n, "angular", COUNT) for n in ("arm", "other")]
    )
    (finding,) = [f for f in check([e]) if f.is_serious]
    assert (finding.code, finding.channel) == ("dead sensor", "other")
    assert "more than one count" in finding.what


@cache
def wheel(seed: int) -> list[np.ndarray]:
    """Times, turns [rev] and volts of a wheel: kS sign(v) + kV v + kA a = u, no gravity.

    Ramps that begin with creeping, and steps, in both directions, every 20 ms.
    """
    rng, dt = np.random.default_rng(seed), 0.02
    friction, back_emf, inertia = np.array([0.25, 2.3, 0.35]) * rng.uniform(0.8, 1.25, 3)
    t = np.arange(1000) * dt
    tables = []
    for volts in (0.25 * t, -0.25 * t, np.full(200, 7.0), np.full(200, -7.0)):
        x, v, turns = 0.0, 0.0, []
        for u in volts.tolist():
            turns.append(x)
            for _ in range(100):
                v += dt / 100 * (u - friction * math.tanh(v / 0.005) - back_emf * v) / inertia
                x += dt / 100 * v
        noisy = np.array(turns) + rng.normal(0, 2e-4, len(volts))
        tables.append(np.column_stack([t[: len(volts)], noisy, volts]))
    return tables


@pytest.mark.thorough
@pytest.mark.parametrize("unit", ["rad", "deg", "rev"])
@pytest.mark.parametrize("seed", [0, 2])
def test_a_wheel_without_gravity_is_in_its_unit(unit: str, seed: int, tmp_path: Path) -> None:
    for k, table in enumerate(wheel(seed)):
        table = table * [1.0, {"rad": 2 * np.pi, "deg": 360.0, "rev": 1.0}[unit], 1.0]
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.9g", ",", header="t,turn,u", comments="")
    (tmp_path / "dataset.toml").write_text(
        'name = "wheel"\ndt = 0.02\n[time]\ncolumn = "t"\n[[coordinates]]\nname = "turn"\n'
        f'kind = "angular"\ncolumn = "turn"\nunit = "{unit}"\n'
        '[[inputs]]\nname = "u"\ncolumn = "u"\nunit = "V"\n'
    )
    found = check_folder(tmp_path)
    assert not [f.text for f in found if f.severity == "severe" or "angle" in f.code]


def driven(force: Callable[[float], float], seed: int, size: float = 20.0) -> tn.Experiment:
    """An angle under a known torque and a force that depends on the angle."""
    rng, q, v, angles = np.random.default_rng(seed), 0.0, 0.0, []
    torque = size * np.repeat(rng.uniform(-1, 1, 30), 40)
    for u in torque:
        angles.append(q)
        for _ in range(5):
            v += DT / 5 * (u - force(q) - 0.5 * v)
            q += DT / 5 * v
    return arm(np.array(angles), u=torque, inputs={"u": "N m"}, name=f"r{seed}")


def test_a_position_that_a_spring_holds_over_many_turns_is_not_in_another_unit() -> None:
    found = check([driven(lambda q: 6.0 * q, k, 150.0) for k in range(4)])
    assert max(np.ptp(driven(lambda q: 6.0 * q, k, 150.0).q) for k in range(4)) > 20
    assert not [f.text for f in found if f.severity == "severe"]


def test_a_wheel_that_is_fast_for_its_log_is_no_fault_for_sure() -> None:
    turns = np.cumsum(np.linspace(0, 2.5, 800))
    assert [f.severity for f in check([arm(turns)]) if f.code == "fast angle"] == ["note"]
    missed = np.delete(turns, slice(100, None, 50))  # rows that the log lost
    assert [f.severity for f in check([arm(missed)]) if f.code == "fast angle"] == ["warning"]


@pytest.mark.parametrize("late", [1.25, 0.75])
def test_a_slower_machine_is_no_other_period_for_sure(late: float) -> None:
    def pendulum(rate: float, k: int) -> tn.Experiment:
        q, v, angles = 0.6 + 0.2 * k, 0.0, []
        for _ in range(600):
            angles.append(q)
            for _ in range(5):
                v += DT / 5 * rate**2 * -np.sin(q)
                q += DT / 5 * v
        return arm(np.array(angles), name=f"r{k}")

    records = [pendulum(6.0 * (late if k == 2 else 1.0), k) for k in range(5)]
    found = [f for f in check(records) if f.is_serious]
    assert found, "it is not like the others"
    assert {f.severity for f in found} == {"warning"}


def test_another_load_of_a_slide_is_no_fault_of_its_log_for_sure(tmp_path: Path) -> None:
    for k, load in enumerate((0.0, 0.0, 5.0, 5.0, 10.0, 10.0)):
        rng, x, v, positions = np.random.default_rng(k), 0.0, 0.0, []
        force = 20.0 * np.repeat(rng.uniform(-1, 1, 30), 40)
        for f in force.tolist():
            positions.append(x)
            for _ in range(5):
                v += DT / 5 * (f - 6.0 * v - 3.0 * math.tanh(v / 0.01) - 40.0 * x) / (4.0 + load)
                x += DT / 5 * v
        table = np.column_stack([DT * np.arange(len(force)), np.round(positions, 5), force])
        np.savetxt(tmp_path / f"r{k}.csv", table, "%.9g", ",", header="t,x,f", comments="")
    (tmp_path / "dataset.toml").write_text(
        f'name = "slide"\ndt = {DT}\n[time]\ncolumn = "t"\n[[coordinates]]\nname = "x"\n'
        'kind = "linear"\ncolumn = "x"\nunit = "m"\n'
        '[[inputs]]\nname = "f"\ncolumn = "f"\nunit = "N"\n'
    )
    found = [f for f in check_folder(tmp_path) if f.is_serious]
    assert {"r1"} <= {record for f in found for record in f.records} <= {"r0", "r1"}
    assert {f.severity for f in found} == {"warning"}
    assert {f.code for f in found} <= {"gain", "other machine"}
    assert all('{ "machine" = "other" }' in str(f.mend) for f in found)
    card = tmp_path / "dataset.toml"
    named = ", ".join(
        f'{{ file = "{record}.csv", groups = {{ load = "none" }} }}' for record in ("r0", "r1")
    )
    others = ", ".join(f'"r{k}.csv"' for k in range(2, 6))
    card.write_text(card.read_text() + f"[splits]\ntrain = [{named}, {others}]\n")
    assert serious(check_folder(tmp_path)) == []


def servo(goals: np.ndarray, name: str) -> tn.Experiment:
    """A pendulum that a servo brings to goals, where friction holds it."""
    q, v, angles = float(goals[0]), 0.0, []
    for goal in goals:
        angles.append(q)
        for _ in range(10):
            push = np.clip(350.0 * (goal - q), -159.0, 159.0) - 26.0 * v - 32.0 * math.sin(q)
            v += DT / 10 * push
            v = math.copysign(max(abs(v) - 6.0 * DT / 10, 0.0), v)
            q += DT / 10 * v
    late = np.random.default_rng(len(name)).normal(0, 0.02, len(goals))
    return arm(
        np.round(np.array(angles) / COUNT) * COUNT,
        u=goals,
        t=DT * (np.arange(len(goals)) + late),
        inputs={"goal": "rad"},
        name=name,
    ).resample(DT)


def test_a_servo_that_holds_goals_is_at_no_stop() -> None:
    goals = np.repeat([0.0, 1.08, -0.87, 1.07, -0.48, -0.2, 0.8, -0.24, 0.12, -1.13, 0.61], 137)
    assert serious(check([servo(goals, "steps")])) == []


@pytest.mark.parametrize("far", [False, True])
def test_a_misfit_where_a_record_goes_beyond_the_others_is_of_no_other_machine(far: bool) -> None:
    rng = np.random.default_rng(0)
    rights = [rng.normal(size=(200, 3)) for _ in range(5)]
    rights[0][:10] *= 5.0
    lefts = [right @ np.ones((3, 1)) + 0.01 * rng.normal(size=(200, 1)) for right in rights]
    wrong = slice(0, 10) if far else slice(10, None)  # as where a servo saturates
    lefts[0][wrong] *= 0.5
    equations = [Equations(left, right) for left, right in zip(lefts, rights, strict=True)]
    model = fit_motion_model(equations, np.ones(5))
    assert (model.novelty(equations[0], 0) > LEVELS.novel) == far


# --- velocity columns ---


@settings(max_examples=30, deadline=None)
@given(
    rows=st.lists(st.integers(10, 780), min_size=1, max_size=3, unique=True),
    size=st.floats(20.0, 1e3),
    seed=st.integers(0, 5),
)
def test_outliers_of_velocities_are_named_and_change_nothing_else(
    rows: list[int], size: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    q = swing()
    v = np.gradient(q, DT) + 0.01 * rng.normal(size=len(q))
    assert serious(check([arm(q, v, v_measured=True)])) == []
    v[rows] += size * rng.choice([-1.0, 1.0], len(rows))
    found = [f for f in check([arm(q, v, v_measured=True)]) if f.is_serious]
    assert [(f.code, f.severity) for f in found] == [("velocity", "warning")]
    assert f"outliers at sample {', '.join(map(str, sorted(rows)))}" in found[0].what
    assert found[0].values["how"].values["largest"] == pytest.approx(size, abs=0.5)
    reversed_ = check([arm(q, -v, v_measured=True)])
    assert "opposite sign" in next(f for f in reversed_ if f.severity == "severe").what


@pytest.mark.parametrize("factor", [500.0, 0.002])
def test_a_velocity_of_a_scale_that_no_unit_explains_is_to_be_left_alone(factor: float) -> None:
    q = swing()
    found = check([arm(q, factor * np.gradient(q, DT), v_measured=True)])
    (severe,) = [f for f in found if f.severity == "severe"]
    assert severe.values["how"].values["gain"] == pytest.approx(factor, rel=0.01)
    assert severe.mend.endswith("velocity = { measured = false }")
    assert not check([arm(q, factor * np.gradient(q, DT), v_measured=False)])


def test_a_velocity_column_that_no_fit_uses_is_no_severe_finding() -> None:
    q = swing()
    found = check([arm(q, -np.gradient(q, DT), v_measured=False)])
    assert [f.severity for f in found if f.code == "velocity"] == ["warning"]


def test_a_command_beyond_its_limits_is_clipped_as_the_mend_says(tmp_path: Path) -> None:
    table = np.column_stack([swing(), 3 * np.sin(np.arange(len(swing())) / 20)])
    np.savetxt(tmp_path / "r.csv", table, "%.8g", ",", header="q,u", comments="")
    card = 'name = "a"\ndt = 0.01\n[[coordinates]]\nname = "q"\nkind = "angular"\ncolumn = "q"\n'
    card += '[[inputs]]\nname = "u"\ncolumn = "u"\nunit = "V"\nlimits = [-2, 2]\n'
    (tmp_path / "dataset.toml").write_text(card)
    (beyond,) = [f for f in check_folder(tmp_path) if f.code == "limits"]
    (tmp_path / "dataset.toml").write_text(card + beyond.mend.rpartition(": ")[2] + "\n")
    assert not [f for f in check_folder(tmp_path) if f.code == "limits"]
    (record,) = tn.load(tmp_path)
    assert np.ptp(record.u) == 4.0
    (tmp_path / "dataset.toml").write_text(card.replace("limits = [-2, 2]", "clip = true"))
    with pytest.raises(tn.InputError, match="`clip` without `limits`"):
        tn.load(tmp_path)


def test_a_part_of_a_file_has_no_sign_of_its_own() -> None:
    whole = np.sin(np.arange(500) * DT)
    parts = [
        replace(arm(whole[first : first + 125], name=f"run1_{first}"), source="run1.csv")
        for first in range(0, 500, 125)
    ]
    assert not [f.text for f in check(parts) if f.code == "sign"]
    apart = [replace(e, source=f"{e.name}.csv") for e in parts]
    assert [f.code for f in check(apart) if f.is_serious] == ["sign"]


def test_a_record_that_hardly_differs_may_be_a_repeated_experiment() -> None:
    again = swing() + 1e-4 * np.random.default_rng(0).normal(size=800)
    (found,) = check([arm(swing()), arm(again, name="again", split="test")])
    assert (found.code, found.severity) == ("near copy", "warning")
    assert not check([arm(swing()), arm(swing()[::-1], name="other")])


@pytest.mark.parametrize(
    ("rows", "mend"),
    [
        ([(0, 400), (300, 700)], '{ file = "log.csv", rows = [400, 700] }'),
        ([(300, 700), (0, 400)], '{ file = "log.csv", seconds = [0, 2.995] }'),
        ([(0, 700), (300, 500)], 'leave out "log.csv"'),
        ([(0, 300), (300, 700)], None),
    ],
)
def test_ranges_of_a_file_that_overlap_are_cut_to_what_they_do_not_share(
    rows: list[tuple[int, int]], mend: str | None
) -> None:
    whole = replace(arm(swing()), source="log.csv", sha256="one")
    parts = [replace(whole[a:b], name=f"r{a}") for a, b in rows]
    found = [f.mend for f in check(parts) if f.code == "overlap"]
    assert found == ([] if mend is None else [f"under [splits] train: {mend}"])


# --- findings ---


def test_findings_are_sorted_by_severity_and_equal_ones_are_merged() -> None:
    note = replace(make_finding("degrees wrap"), records=("r1",), time=1.0)
    severe = replace(note, severity="severe")
    merged = merge_findings([note, severe, replace(note, records=("r2",), time=2.0)])
    assert [f.severity for f in sort_findings(merged)] == ["severe", "note"]
    assert sort_findings(merged)[1].records == ("r1", "r2")
    assert sort_findings(merged)[1].time is None


def test_no_records_have_no_findings() -> None:
    assert check([]) == ()


@pytest.mark.real
def test_faults_in_copies_of_the_measured_records_are_named(real_data: Path) -> None:
    records = list(tn.load(real_data))
    assert serious(check(records)) == []
    faults: dict[str, tuple[str, str, Callable[[tn.Experiment], dict[str, np.ndarray]]]] = {
        "wN_3V_1": ("sign", "voltage", lambda e: {"u": -e.u}),
        "wN_2V_1": ("lag", "voltage", lambda e: {"u": np.roll(e.u, 6, axis=0)}),
        "wN_4V_1": ("gain", "voltage", lambda e: {"u": 2.0 * e.u}),
        "fall4": ("swap", "alpha", lambda e: {"q": e.q[:, ::-1]}),
    }
    unchanged = ("", "", lambda e: {})
    found = check([replace(e, **faults.get(e.name, unchanged)[2](e)) for e in records])
    for record, (name, channel, _) in faults.items():
        named = [f for f in found if f.code == name and f.records == (record,)]
        assert named, (name, [f.text for f in found])
        assert named[0].channel == channel
    copy = replace(records[0], name="fresh", split="test", sha256="")
    (found_copy,) = [f for f in check([*records, copy]) if f.is_serious]
    assert (found_copy.code, found_copy.severity) == ("copy", "severe")


@pytest.mark.real
def test_measured_records_have_no_severe_finding(real_data: Path) -> None:
    measured = real_data.parent / "measured"
    if not measured.is_dir():
        pytest.skip("no measured data beside the Qube-Servo 2 data")
    folders = [(f, None) for f in sorted(measured.iterdir()) if (f / "dataset.toml").is_file()]
    cards = (Path(__file__).parents[2] / "examples").glob("*.toml")
    folders += [(real_data.parent / c.stem, c) for c in cards]
    for folder, card in folders:
        if folder.is_dir():
            place, content = locate(folder, card)
            found = check(load_folder(place, content), content)
            assert not [f.text for f in found if f.severity == "severe"], folder.name


# --- records that hold little ---


def poor_records() -> list[tuple[str, list[tn.Experiment]]]:
    """Records without motion, of few samples, or of numbers at the ends of their range."""
    still = np.zeros(300)
    ramp = np.linspace(0.0, 1.0, 300)
    huge = 1e99 * swing(300)
    return [
        ("two samples", [arm(np.array([0.0, 1.0]))]),
        ("three of two samples", [arm(np.array([0.0, 1.0]), name=f"r{k}") for k in range(3)]),
        ("six samples", [arm(swing(6), name=f"r{k}") for k in range(4)]),
        ("constant", [arm(still, name=f"r{k}") for k in range(4)]),
        ("constant with inputs", [arm(still, u=u, inputs={"u": "V"}) for u in (still, ramp)]),
        ("constant velocity", [arm(ramp, np.full(300, 1.0), name=f"r{k}") for k in range(3)]),
        ("zero velocity", [arm(swing(300), still)]),
        ("huge", [arm(huge, u=huge, inputs={"u": "V"}, name=f"r{k}") for k in range(3)]),
        ("tiny", [arm(1e-300 * swing(300), name=f"r{k}") for k in range(3)]),
        ("one that moves", [arm(still), arm(still, name="b"), arm(swing(300), name="c")]),
        ("mixed lengths", [arm(swing(n), name=f"r{n}") for n in (2, 5, 33, 300)]),
    ]


@pytest.mark.parametrize(("what", "records"), poor_records(), ids=lambda x: str(x)[:24])
def test_records_that_hold_little_are_checked_without_an_error(
    what: str, records: list[tn.Experiment]
) -> None:
    for finding in check(records):
        assert finding.text
        assert "nan" not in finding.text, what
    for e in records:
        check([e])


# --- what the card assumes ---


def test_keys_that_the_card_assumes_are_notes_until_they_are_deleted(tmp_path: Path) -> None:
    table = np.column_stack([DT * np.arange(800), swing(), np.sin(7 * DT * np.arange(800))])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,theta,u", comments="")
    card = (
        'name = "arm"\ndt = 0.01\nassumed = ["dt"]\n[time]\ncolumn = "t"\nunit = "s"\n'
        'assumed = ["unit"]\n[[coordinates]]\nname = "theta"\nkind = "angular"\n'
        'column = "theta"\nunit = "rad"\nassumed = ["kind", "unit"]\n[[inputs]]\n'
        'name = "motor"\ncolumn = "u"\nunit = "V"\nassumed = ["unit"]\n'
    )
    (tmp_path / "dataset.toml").write_text(card)
    found = check_folder(tmp_path)
    assert "assumed together" not in {f.code for f in found}
    found = [f for f in found if f.code == "assumed"]
    assert {f.severity for f in found} == {"note"}
    assert [(f.channel, f.what) for f in found] == [
        ("", "the sampling period [s] was assumed to be 0.01"),
        ("", "the unit of the times was assumed to be s"),
        ("theta", "the kind and unit of theta were assumed to be angular and rad"),
        ("motor", "the unit of motor was assumed to be V"),
    ]
    assert "to 1 rad" in found[2].size
    assert found[2].mend.startswith("under [[coordinates]] theta: correct")
    kept = [line for line in card.splitlines() if not line.startswith("assumed")]
    (tmp_path / "dataset.toml").write_text("\n".join(kept))
    assert not [f for f in check_folder(tmp_path) if f.code == "assumed"]


def test_channels_of_which_the_same_is_assumed_are_in_one_finding(tmp_path: Path) -> None:
    table = np.column_stack([DT * np.arange(800), swing(), 2 * swing()])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="t,a,b", comments="")
    card = 'name = "arm"\ndt = 0.01\n[time]\ncolumn = "t"\nunit = "s"\n'
    for name in "ab":
        card += f'[[coordinates]]\nname = "{name}"\nkind = "angular"\ncolumn = "{name}"\n'
        card += 'unit = "rad"\nassumed = ["unit"]\n'
    (tmp_path / "dataset.toml").write_text(card)
    (found,) = [f for f in check_folder(tmp_path) if f.code == "assumed"]
    assert found.what == "the unit of a and b was assumed to be rad"
    assert found.mend.startswith("under each of them: correct")
    assert (found.channel, found.column) == ("", "")


def double_pendulum(folder: Path, factor: float) -> None:
    """Records of two links, whose angles are written in another unit than rad, and a card."""
    rng = np.random.default_rng(0)
    u = 20 * np.repeat(rng.uniform(-1, 1, (3, 30)), 40, axis=1)
    t = DT * np.arange(u.shape[1])
    for k in range(3):
        q, v, rows = np.zeros(2), np.zeros(2), []
        for torque in u[k]:
            rows.append([*(factor * q), torque])
            for _ in range(8):
                spring = np.array([5.0, -9.0]) * np.sin(q[1] - q[0])
                gravity = np.array([40.0, 30.0]) * np.sin(q)
                v = v + DT / 8 * ([torque, 0] - gravity - [0.5, 0.3] * v + spring)
                q = q + DT / 8 * v
        table = np.column_stack([t, rows])
        np.savetxt(folder / f"r{k}.csv", table, "%.8g", ",", header="t,y1,y2,u_V", comments="")


def test_angles_that_all_are_in_another_unit_are_found_together(tmp_path: Path) -> None:
    double_pendulum(tmp_path, 1.0)
    files = ["r0.csv", "r1.csv", "r2.csv"]
    draft = draft_card(tmp_path, files, {"unit y1": "deg", "unit y2": "deg"})
    (tmp_path / "dataset.toml").write_text(draft.text)
    found = [f for f in check_folder(tmp_path) if f.code == "angle unit"]
    assert {f.severity for f in found} == {"severe"}
    units = {f.channel: f.mend for f in found}
    assert {*units} == {"y1", "y2"}
    assert all(remedy.endswith('unit = "rad"') for remedy in units.values())


def test_a_draft_takes_the_unit_that_the_motion_shows(tmp_path: Path) -> None:
    double_pendulum(tmp_path, 1.0)
    files = ["r0.csv", "r1.csv", "r2.csv"]
    draft = draft_card(tmp_path, files)
    wrong = [c for c in draft.choice.coordinates if c.unit != "rad"]
    assert wrong, "the range says degrees"
    assert all("unit" in c.assumed for c in wrong)
    scales = find_scales(draft, tmp_path)
    corrected = draft_examined(examine_logs(tmp_path, files), scales).choice.coordinates
    assert [c.unit for c in corrected] == ["rad", "rad"]
    assert all(
        "in rad as the motion shows" in c.because
        for c in corrected
        if c.name in {w.name for w in wrong}
    )
    assert not [c for c in corrected if c.column in scales and "unit" in c.assumed]


def test_remedies_name_entries_of_a_card_only_where_there_are_some() -> None:
    t = 0.01 * np.arange(200)
    e = tn.from_arrays(np.sin(3 * t), dt=0.01, coordinates={"x": "linear"}, name="a")
    assert file_parts(e, [(90, 100)]) == ""
    assert without_record(e) == 'leave out "a"'
    logged = replace(e, source="a.csv", split="validation")
    parts = file_parts(logged, [(90, 100)])
    assert parts.startswith('under [splits] validation: { file = "a.csv", seconds = [0, ')
    assert without_record(logged) == 'under [splits] validation: leave out "a.csv"'
    # of a part of a file that was resampled nothing says the rows
    part = replace(logged, first_row=1200, recording=describe_recording(e.t, e.q, 0.01))
    assert file_parts(part, [(90, 100)]).endswith("no entry: correct the file")
