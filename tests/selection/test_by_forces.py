"""Candidates by inverse dynamics: which systems get them, what begins with them, how they score."""

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from robot_twins import ARM, record_in_loop, true_values
from small_selection import plan_in, swings
from swinging import CREEPING, SWING, TRUTH

import tustinnet as tn
from tustinnet.fits.in_folder import fit_in_folder
from tustinnet.fitting.inverse_dynamics.along import find_obstacle
from tustinnet.fitting.inverse_dynamics.cutoff import choose_cutoff
from tustinnet.fitting.inverse_dynamics.identification import are_all_driven
from tustinnet.fitting.inverse_dynamics.of_model import unexplained_forces
from tustinnet.fitting.roles import Roles
from tustinnet.fitting.shooting.stages import ESTIMATE
from tustinnet.fitting.task import Task
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.models.physical_values import physical_parameters
from tustinnet.report.selection import candidates_table
from tustinnet.selection import jobs
from tustinnet.selection.applicability import applicable_candidates
from tustinnet.selection.choice import Choice
from tustinnet.selection.folds import FoldSplit
from tustinnet.selection.jobs import Job, RunContext, make_job_task
from tustinnet.selection.plan import packaged_plans, read_plan
from tustinnet.selection.scoring import Scorer
from tustinnet.selection.select import Reporter, SelectionOptions, select_model
from tustinnet.store.run_folder import Earlier
from tustinnet.systems.files import find_system

PENDULUM = Path(__file__).parents[2] / "examples" / "robots" / "double_pendulum.urdf"
PLAN = """
name = "by forces"
folds = 3
keep = 1.0
start = "model-10"

[[candidates]]
name = "inverse-dynamics"
recipe = "inverse-dynamics"
when = "fully-actuated"

[[candidates]]
name = "grey"
recipe = "grey.toml"
begins_with = ["inverse-dynamics"]
"""

ALONE = """
name = "alone"
folds = 3
[[candidates]]
name = "inverse-dynamics"
recipe = "inverse-dynamics"
set = ["search.candidates=[]"]
"""


class Made(NamedTuple):
    choice: Choice
    tasks: list[Task]
    messages: list[str]


def selected(folder: Path, earlier: Earlier = "refuse") -> Made:
    """A selection of a machine with one coordinate and one input, and the tasks of its jobs."""
    tasks, messages = list[Task](), list[str]()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            jobs,
            "fit_in_folder",
            lambda out, task, *more, **named: (
                tasks.append(task),
                fit_in_folder(out, task, *more, **named),
            )[1],
        )
        choice = select_model(
            swings(),
            folder / "run",
            SelectionOptions(plan_in(folder, PLAN), SWING),
            earlier,
            Reporter(messages.append),
        )
    return Made(choice, tasks, messages)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Made:
    return selected(tmp_path_factory.mktemp("forces"))


def test_a_search_by_simulation_begins_at_the_values_by_forces_of_its_fold(made):
    grey = [task for task in made.tasks if task.recipe.name == "short-grey"]
    by_forces = made.choice.result("inverse-dynamics").fits_by_fold
    assert sorted(task.members[0].fold for task in grey) == [0, 1, 2]
    for task in grey:
        fold = task.members[0].fold
        model = made.choice.context.load_model(by_forces[fold][0].model)
        values = {name: value for name, _, value in physical_parameters(model)}
        begin = task.identification_recipe.model.begin
        assert begin["gravity"] == pytest.approx(values["gravity"], rel=1e-12)
        assert begin["gravity"] != SWING.nominal()["gravity"]
        # it needs no first estimate then
        log = made.choice.context.folder / f"candidates/grey/fold-{fold}-seeds-0/log.jsonl"
        assert "segments" in log.read_text()
        assert ESTIMATE not in log.read_text()


def test_forces_stand_beside_the_free_runs_that_decide(made):
    choice, folder = made.choice, made.choice.context.folder
    summary = json.loads((folder / "summary.json").read_text())
    for candidate in summary["candidates"]:
        assert 0 < candidate["unexplained"]["angle"] < 0.5
    (sentence,) = [s.text for s in choice.findings if s.code == "forces unexplained"]
    assert sentence.startswith("forces along these records")
    assert choice.context.scoring.horizon is None
    table = candidates_table(choice)
    assert "unexplained force [%]" in table.columns
    model = tn.load_model(folder / "model.safetensors", SWING)
    assert tn.evaluate(model, [swings()[1]], "model-10")[0].rmse < 0.02


@pytest.mark.thorough
def test_resumed_nothing_is_fitted_again_but_the_last_model(made):
    folder = made.choice.context.folder.parent
    again = selected(folder, "resume")
    assert again.tasks == []
    assert again.choice.result("grey").unexplained == made.choice.result("grey").unexplained


@pytest.mark.thorough
def test_columns_that_forces_show_to_be_mistaken_end_the_search(tmp_path):
    """Torques that are exchanged: no candidate that follows could be worth its time."""
    (arm := tmp_path / "arm.urdf").write_text(ARM)
    system = tn.load_system(arm)
    data = record_in_loop(system, true_values(system, seed=3), count=3, seconds=3.0)
    exchanged = replace(data, experiments=tuple(replace(e, u=e.u[:, ::-1]) for e in data))
    plan = PLAN.replace("[[candidates]]", '[[candidates]]\nset = ["search.candidates=[]"]', 1)
    options = SelectionOptions(plan_in(tmp_path, plan), system)
    with pytest.raises(tn.InputError, match=r"forces of .* are probably exchanged"):
        select_model(exchanged, tmp_path / "run", options)
    assert not (tmp_path / "run/candidates/grey").exists()
    assert not (tmp_path / "run/model.safetensors").exists()


def test_values_by_group_are_begun_with_where_the_fold_has_the_group():
    gravity = replace(SWING.parameters[2], per="load")
    system = replace(SWING, parameters=(*SWING.parameters[:2], gravity, SWING.parameters[3]))
    loads = ("none", "none", "ball", "ball", "heavy")
    records = tuple(
        replace(e, groups=(("load", load),)) for e, load in zip(swings(), loads, strict=True)
    )
    values = {**system.nominal(), "damping": 0.07}
    values |= {f"gravity[{load}]": float(k) for k, load in enumerate(dict.fromkeys(loads), 1)}
    del values["gravity"]
    model = tn.discretise(system.model({k: jnp.asarray(x) for k, x in values.items()}), 0.02, 1)
    split = FoldSplit(records[4:], Roles(records[:4], ()))
    context = RunContext(
        tn.DataSet("loads", records),
        Scorer(3, "model-20"),
        models={"m": model},
        system=system,
        drawn=(split,),
    )
    context = context.with_changes(delays=("torque",))
    task = make_job_task([Job("grey", tn.read_recipe("grey"), 0, origin="m")], context)
    assert task.identification_recipe.model.free == ("torque.delay",)
    begin = task.identification_recipe.model.begin
    assert begin == pytest.approx(
        {
            "inertia": values["inertia"],
            "damping": 0.07,
            "gain": values["gain"],
            "gravity[none]": 1.0,
            "gravity[ball]": 2.0,
        }
    )


def applicable(plan: str, system: LagrangianSystem | None, data=None) -> tuple[list[str], str]:
    """Names of the candidates of a plan that can take part, and why others cannot."""
    context = RunContext(data or swings(), Scorer(3, "model-20"), system=system)
    candidates, findings = applicable_candidates(read_plan(plan), context, None)
    return [c.name for c in candidates], "; ".join(f.text for f in findings)


@pytest.mark.thorough
@pytest.mark.parametrize("plan", packaged_plans())
def test_packaged_plans_begin_with_forces_where_they_tell_all_parameters(plan):
    names, _ = applicable(plan, SWING)
    assert "inverse-dynamics" in names
    grey = [c for c in read_plan(plan).candidates if c.recipe == "best-grey"]
    assert grey
    assert all(c.begins_with for c in grey)
    names, sentences = applicable(plan, CREEPING)
    assert "inverse-dynamics" not in names
    assert "best-grey" in names
    assert "left out, no inverse dynamics of a system with internal states: inv" in sentences
    names, sentences = applicable(plan, None)
    assert "inverse-dynamics" not in names
    assert "requires a system (`system=`): inverse-dynamics" in sentences


def with_second_coordinate(gains: np.ndarray) -> LagrangianSystem:
    """A system of two swings whose inputs act on each by some gains, (2, n_u)."""
    second = tn.Coordinate("other", "angular")
    return replace(
        SWING,
        coordinates=(*SWING.coordinates, second),
        inputs=tuple(tn.Input(f"u{k}", "V") for k in range(gains.shape[1])),
        kinetic=lambda q, v, p: p["inertia"] * jnp.sum(v**2) / 2,
        potential=lambda q, p: -p["gravity"] * jnp.sum(jnp.cos(q)),
        input_map=lambda q, v, u, p: p["gain"] * jnp.asarray(gains) @ u,
    )


@pytest.mark.parametrize(
    ("gains", "are_driven"),
    [
        ([[1.0, 0.0], [0.0, 1e-4]], True),
        ([[1.0, -1.0], [1.0, 1.0]], True),
        ([[0.0, 1.0, 1.0], [1.0, 0.0, 0.0]], True),
        ([[1.0, 2.0], [0.0, 0.0]], False),
        ([[1.0, 2.0], [1.0, 2.0]], False),
        ([[1.0], [1.0]], False),
    ],
)
def test_inputs_drive_all_coordinates_each_by_itself(gains, are_driven):
    system = with_second_coordinate(np.array(gains))
    e = swings()[0]
    record = tn.from_arrays(
        np.hstack([e.q, e.q]),
        np.zeros((len(e), len(system.inputs))),
        dt=e.dt,
        coordinates=list(system.coordinates),
        inputs=list(system.inputs),
    )
    assert are_all_driven(system, [record]) is are_driven
    if not are_driven:
        records = tuple(replace(record, name=f"r{k}") for k in range(3))
        _, sentences = applicable("quick", system, tn.DataSet("two", records))
        assert "as inputs are no forces on every coordinate: inv" in sentences


def test_forces_of_the_true_system_explain_records_and_those_of_another_do_not():
    data = swings()
    records = [e for e in data if e.forced]
    assert find_obstacle(SWING, records) is None
    cutoff = choose_cutoff(SWING, records)
    true = SWING.model({name: jnp.asarray(x) for name, x in TRUTH.items()})
    other = SWING.model({**true.values, "gravity": jnp.asarray(2 * TRUTH["gravity"])})
    little, much = (unexplained_forces(m, records, cutoff)["angle"] for m in (true, other))
    assert much > 4 * little


@pytest.mark.thorough
def test_a_robot_is_judged_in_the_loop_of_its_controller(tmp_path):
    robot = tn.load_robot(PENDULUM)
    data = record_in_loop(robot, true_values(robot, 0), 4, 2.0, knows_controller=True)
    messages = list[str]()
    choice = select_model(
        data,
        tmp_path / "run",
        SelectionOptions(plan_in(tmp_path, ALONE), find_system(PENDULUM)),
        reporter=Reporter(messages.append),
    )
    assert messages[0].startswith("judged by free runs in the loop of the controller in the data")
    assert messages[0] in [f.text for f in choice.findings]
    assert choice.context.scoring.horizon is None
    (result,) = choice.candidates.results
    assert len(result.rmse()) == 4
    assert max(result.rmse().values()) < 0.01
    assert set(result.unexplained) == {"upper_joint", "lower_joint"}
    tn.write_robot(choice.model, tmp_path / "identified.urdf")
    assert "<mass" in (tmp_path / "identified.urdf").read_text()
