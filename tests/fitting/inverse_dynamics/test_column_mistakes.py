"""Columns with a reversed sign, in another unit or exchanged are named after inverse dynamics."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robot_twins import ARM, record_in_loop, true_values, with_payload

import tustinnet as tn
from tustinnet.fitting.inverse_dynamics.column_mistakes import (
    COLUMN_MISTAKES,
    describe_beyond_limits,
    take_busiest_part,
)
from tustinnet.fitting.shooting.findings import describe_bounds
from tustinnet.models.lagrangian import LagrangianSystem


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> LagrangianSystem:
    """An arm of two joints that gravity pulls down."""
    (file := tmp_path_factory.mktemp("arm") / "arm.urdf").write_text(ARM)
    return tn.load_system(file)


@pytest.fixture(scope="module")
def twin(system: LagrangianSystem) -> tn.DataSet:
    return record_in_loop(system, true_values(system, seed=3), count=2, seconds=4.0)


def mistaken(
    data: tn.DataSet,
    q: Sequence[float],
    u: Sequence[float],
    q_order: Sequence[int],
    u_order: Sequence[int],
) -> tn.DataSet:
    """Records whose columns have other factors, and are in another order."""
    experiments = [
        replace(e, q=e.q[:, list(q_order)] * np.array(q), u=e.u[:, list(u_order)] * np.array(u))
        for e in data
    ]
    return replace(data, experiments=tuple(experiments))


def sentences(data: tn.DataSet, system: LagrangianSystem, changes: Sequence[str] = ()) -> list[str]:
    """The findings about columns of a fit."""
    findings = tn.identify(data, system, tn.read_recipe("inverse-dynamics", changes)).findings
    codes = COLUMN_MISTAKES | {"forces missing"}
    return [f.text for f in findings if f.code in codes]


@pytest.mark.thorough
def test_right_columns_are_not_doubted(system: LagrangianSystem, twin: tn.DataSet) -> None:
    assert sentences(twin, system) == []
    assert describe_beyond_limits(system, [*twin]) == ()


def test_a_record_unlike_all_others_is_named_and_no_column(system: LagrangianSystem) -> None:
    """One of three carries something, and nobody said so."""
    truth = true_values(system, seed=3)
    carrying = with_payload(truth, "lower", 3.0, np.array([0.0, 0.0, -0.3]))
    experiments = [
        replace(e, name=f"{e.name}-{k}")
        for k, values in enumerate((truth, carrying))
        for e in record_in_loop(system, values, count=3 - k, seconds=3.0)
    ]
    experiments = [replace(e, split="train") for e in experiments[:-1]]
    recipe = tn.read_recipe("inverse-dynamics", ["search.candidates=[]"])
    findings = tn.identify(tn.DataSet("arm", tuple(experiments)), system, recipe).findings
    (finding,) = [f for f in findings if f.code in {"record apart", "forces missing"}]
    assert (finding.code, finding.values["without"]) == ("record apart", ["run0-1"])
    assert finding.values["after"] < 0.4 * finding.values["before"]


def test_torques_before_gears_are_told_though_light_masses_explain_them(system, twin) -> None:
    recipe = tn.read_recipe("inverse-dynamics", ["search.candidates=[]"])
    small = mistaken(twin, [1, 1], [1 / 8, 1 / 8], [0, 1], [0, 1])
    findings = tn.identify(small, system, recipe).findings
    assert [f.code for f in findings if "force" in f.code] == ["missing forces", "forces small"]


@pytest.mark.thorough
def test_what_counts_otherwise_than_the_file_has_it_is_a_finding(
    twin: tn.DataSet, tmp_path: Path
) -> None:
    tip = '<link name="tip"><inertial><mass value="0"/><inertia ixx="1e-6"/></inertial></link>'
    carried = '<joint name="t" type="fixed"><parent link="lower"/><child link="tip"/></joint>'
    (file := tmp_path / "arm.urdf").write_text(ARM.replace("</robot>", f"{tip}{carried}</robot>"))
    recipe = tn.read_recipe("inverse-dynamics", ["search.candidates=[]"])
    findings = tn.identify(twin, tn.load_system(file), recipe).findings
    assert "arm.urdf, tip: an inertia without a mass, which is 1e-12 kg to begin with" in [
        f.text for f in findings
    ]


CASES = {
    "sign of a torque": (
        ((1, 1), (1, -1), (0, 1), (0, 1)),
        "the sign of the force of '{1}' is probably reversed",
    ),
    "sign of a position": (
        ((-1, 1), (1, 1), (0, 1), (0, 1)),
        "the sign of the position of '{0}' is probably reversed",
    ),
    "mN m": (((1, 1), (1000, 1), (0, 1), (0, 1)), "the forces of '{0}' explain the motion as"),
    "before a gear": (((1, 1), (0.02, 1), (0, 1), (0, 1)), "the torque of a motor before a gear"),
    "signs of both torques": (
        ((1, 1), (-1, -1), (0, 1), (0, 1)),
        "the sign of the forces of '{0}' and '{1}' is probably reversed",
    ),
    "degrees": (((1, 57.3), (1, 1), (0, 1), (0, 1)), "of '{1}' explains the motion as degrees"),
    "radians": (((1 / 57.3, 1), (1, 1), (0, 1), (0, 1)), "of '{0}' explains the motion as radians"),
    "exchanged torques": (
        ((1, 1), (1, 1), (0, 1), (1, 0)),
        "the forces of '{0}' and '{1}' are probably exchanged",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_mistake_is_named(case: str, system: LagrangianSystem, twin: tn.DataSet) -> None:
    change, message = CASES[case]
    found = sentences(mistaken(twin, *change), system, ["search.candidates=[]"])
    assert len(found) == 1
    assert message.format(*(c.name for c in system.coordinates)) in found[0]
    assert "falls from" in found[0]
    assert ("mN m" in found[0]) == (case == "mN m")


def test_most_masses_at_one_bound_are_a_sign_of_another_unit(
    system: LagrangianSystem, twin: tn.DataSet
) -> None:
    """As of currents without a gain: light links explain small forces as well."""
    result = tn.identify(twin, system, tn.read_recipe("inverse-dynamics", ["search.candidates=[]"]))
    light = [
        replace(e, bound="lower" if e.name.endswith(".mass") else "") for e in result.estimates
    ]
    (finding,) = [f for f in describe_bounds(light, np.inf, system) if f.code == "masses at bound"]
    assert finding.what.startswith("the masses of 2 of 2 links are at their lower bound")
    findings = describe_bounds(result.estimates, np.inf, system)
    assert "masses at bound" not in [f.code for f in findings]


def test_records_are_compared_where_they_move(twin: tn.DataSet) -> None:
    """At rest dry friction holds whatever column is taken for the torque."""
    record = next(iter(twin))
    q, u = (np.pad(x, [(300, 300), (0, 0)], mode="edge") for x in (record.q, record.u))
    resting = replace(record, t=record.dt * np.arange(len(q)), q=q, u=u, v=None, v_measured=False)
    np.testing.assert_array_equal(take_busiest_part(resting, len(record)).q, record.q)
    assert len(take_busiest_part(record, 2 * len(record))) == len(record)


def test_motion_far_beyond_the_limits_of_the_file_is_named(tmp_path: Path) -> None:
    limit = '<limit lower="-2" upper="2" effort="10" velocity="4"/>'
    (file := tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="b"/><link name="a"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1"/></inertial></link><joint name="hip" type="revolute">'
        f'<parent link="b"/><child link="a"/>{limit}</joint></robot>'
    )
    system = tn.load_system(file)
    t = np.arange(0, 3, 0.01)

    def record(angle: float, torque: float) -> tn.Experiment:
        return tn.from_arrays(
            angle * np.sin(t)[:, None],
            torque * np.cos(t)[:, None],
            dt=0.01,
            coordinates=system.coordinates,
            inputs=system.inputs,
        )

    assert describe_beyond_limits(system, [record(2.2, 10.5)]) == (), "a little beyond"
    (torque,) = map(str, describe_beyond_limits(system, [record(1.0, 14.0)]))
    assert "hip_torque is up to 14 N m, and hip has 10 N m by arm.urdf: what a controller" in torque
    (angle,) = map(str, describe_beyond_limits(system, [record(60.0, 8.0)]))
    assert "hip moves from 0.0 to 60" in angle.replace("from 0 to", "from 0.0 to")
    assert "degrees taken for rad" in angle
    (torque,) = map(str, describe_beyond_limits(system, [record(1.0, 8000.0)]))
    assert "hip_torque is up to 8e+03 N m, and hip has 10 N m by arm.urdf" in torque
