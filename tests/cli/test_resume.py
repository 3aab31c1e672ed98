"""`--resume` goes on with what is there, and with nothing else."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
import safetensors.numpy
from small_selection import NETWORK_ONLY, plan_in
from test_verbs import tustinnet

from tustinnet.cli.main import run
from tustinnet.fits import run as runs
from tustinnet.selection import jobs

GREY_TOO = NETWORK_ONLY.replace(
    "candidates = [",
    'candidates = [{ name = "grey", recipe = "grey.toml", when = "always" }, ',
).replace("folds = 3", "folds = 3\nscored = 1")
SYSTEM = """
import jax.numpy as jnp
import tustinnet as tn
SYSTEM = tn.LagrangianSystem(
    name="small pendulum",
    coordinates=(tn.Coordinate("angle", "angular"),),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(
        tn.Parameter("gravity", "1/s^2", 15.0, 1.0, 100.0),
        tn.Parameter("damping", "1/s", 1.0, 0.01, 10.0),
        tn.Parameter("gain", "1/(kg m^2)", 3.0, 0.1, 50.0),
    ),
    kinetic=lambda q, v, p: v[0] ** 2 / 2,
    potential=lambda q, p: -p["gravity"] * jnp.cos(q[0]),
    dissipation=lambda q, v, p: p["damping"] * v,
    input_map=lambda q, v, u, p: p["gain"] * u,
)
"""


class Place(NamedTuple):
    """What is there: logs, recipes and plans, a training, a selection, an identification."""

    root: Path
    logs: Path

    def fit(self, out: str, *more: object) -> tuple[object, ...]:
        return ("fit", self.logs, "--out", self.root / out, "--quiet", *more)

    def training(self, *more: object) -> tuple[object, ...]:
        return self.fit("training", "--recipe", self.root / "small.toml", "--no-report", *more)

    def selection(self, *more: object) -> tuple[object, ...]:
        system = self.root / "pendulum.py"
        return self.fit("selection", "--plan", self.root / "plan.toml", "--system", system, *more)


@pytest.fixture(scope="module")
def made_once(pendulum, tmp_path_factory) -> Place:
    from conftest import write_folder

    root = tmp_path_factory.mktemp("resumed")
    write_folder(pendulum, root / "logs")
    plan_in(root, GREY_TOO)
    (root / "pendulum.py").write_text(SYSTEM)
    place = Place(root, root / "logs")
    with_system = ("--system", root / "pendulum.py", "--no-report")
    grey = place.fit("grey", "--recipe", root / "grey.toml", *with_system)
    for verb in (place.training(), place.selection("--no-report"), grey):
        with pytest.raises(SystemExit) as ended:
            run([str(word) for word in verb])
        assert not ended.value.code
    return place


@pytest.fixture
def place(made_once, tmp_path) -> Place:
    root = shutil.copytree(made_once.root, tmp_path / "place")
    return Place(root, root / "logs")


def another_recipe(place: Place) -> None:
    path = place.root / "small.toml"
    path.write_text(path.read_text().replace("rate = 1e-2", "rate = 2e-2"))


def another_plan(place: Place) -> None:
    path = place.root / "plan.toml"
    path.write_text(path.read_text().replace('start = "model-10"', 'start = "model-12"'))


def another_record(place: Place) -> None:
    path = place.logs / "fall2.csv"
    path.write_text("\n".join(path.read_text().splitlines()[:-9]) + "\n")


def fewer_records(place: Place) -> None:
    path = place.logs / "dataset.toml"
    path.write_text(path.read_text().replace('"fall2.csv", ', ""))


def another_declaration(place: Place) -> None:
    path = place.logs / "dataset.toml"
    path.write_text(path.read_text().replace("4096", "2048"))


def another_system(place: Place) -> None:
    path = place.root / "pendulum.py"
    path.write_text(path.read_text().replace("15.0", "16.0"))


Change = Callable[[Place], None]

CASES: dict[str, tuple[str, Change, str]] = {
    "training, recipe": ("training", another_recipe, "another recipe (stages.0.rate)"),
    "training, record": ("training", another_record, "another data (train.fall2)"),
    "training, fewer": ("training", fewer_records, "another data (train.fall2)"),
    "training, card": ("training", another_declaration, "another data (train.fall1, "),
    "selection, plan": ("selection", another_plan, "another plan (start)"),
    "selection, recipe": (
        "selection",
        another_recipe,
        "another plan (candidates.1.recipe.stages.0.rate)",
    ),
    "selection, record": ("selection", another_record, "another data (fall2)"),
    "selection, fewer": ("selection", fewer_records, "another data (fall2)"),
    "selection, system": ("selection", another_system, "another system"),
}


def everything(root: Path) -> dict[str, bytes]:
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def arrays(run: Path) -> dict[str, bytes]:
    found = safetensors.numpy.load_file(run / "model.safetensors")
    return {name: array.tobytes() for name, array in found.items()}


@pytest.fixture
def refused(place, capsys, monkeypatch):
    """Runs the command, which must refuse with one line, fit nothing, and change no file."""

    def fits(*arguments, **named):
        pytest.fail("fitted before it refused")

    def check(*verb: object, names: str) -> None:
        monkeypatch.setattr(runs, "fit_in_folder", fits)
        monkeypatch.setattr(jobs, "fit_in_folder", fits)
        before = everything(place.root)
        code, out, err = tustinnet(capsys, *verb)
        assert (code, out) == (1, ""), err
        (line,) = [line for line in err.splitlines() if line.startswith("error: ")]
        assert names in line
        assert everything(place.root) == before

    return check


@pytest.mark.parametrize("whole", [True, False], ids=["finished", "stopped"])
@pytest.mark.parametrize("case", CASES)
def test_what_is_asked_otherwise_is_refused_by_name(case, whole, place, refused):
    what, change, told = CASES[case]
    if not whole:
        for name in ("model.safetensors", "summary.json"):
            (place.root / what / name).unlink()
    change(place)
    verb = place.training if what == "training" else place.selection
    refused(*verb("--resume"), names=told)


@pytest.mark.parametrize("told", [True, False], ids=["kept", "not kept"])
def test_a_run_of_another_kind_is_refused(told, place, refused):
    if not told:
        for path in place.root.rglob("question.json"):
            path.unlink()
    recipe, plan = (place.root / name for name in ("small.toml", "plan.toml"))
    refused(
        *place.fit("selection", "--recipe", recipe, "--resume"),
        names="holds a selection by a plan, not a run of a recipe",
    )
    refused(
        *place.fit("training", "--plan", plan, "--resume"),
        names="holds a run of a recipe, not a selection by a plan",
    )
    refused(*place.fit("grey", "--plan", plan, "--resume"), names="holds a run of a recipe, not")
    refused(*place.fit("grey", "--recipe", recipe, "--resume"), names="another recipe (")


@pytest.mark.thorough
@pytest.mark.parametrize("damage", ["", "[]", "{}", '"recipe"', "{", '{"recipe": 3}'])
def test_where_the_question_is_lost_the_model_tells_the_recipe(damage, place, refused):
    (place.root / "training" / "question.json").write_text(damage)
    another_recipe(place)
    refused(*place.training("--resume"), names="another recipe")


@pytest.mark.thorough
def test_the_same_goes_on_and_is_kept(place, capsys):
    for verb, what in ((place.training, "training"), (place.selection, "selection")):
        before = arrays(place.root / what)
        (place.root / what / "summary.json").unlink()
        code, _, err = tustinnet(capsys, *verb("--resume", "--no-report"))
        assert code == 0, err
        assert arrays(place.root / what) == before
    assert tustinnet(capsys, *place.training("--resume", "--seeds", "2"))[0] == 0
    another_recipe(place)
    assert tustinnet(capsys, *place.training("--overwrite"))[0] == 0
    assert tustinnet(capsys, *place.training("--resume"))[0] == 0
