"""The public names are documented, the README's program runs, the repository keeps its rules."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from documented import anchor

import tustinnet as tn

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", dir(tn))
def test_public_names_are_documented_with_their_arguments(name):
    thing = getattr(tn, name)
    text = inspect.getdoc(thing) or ""
    assert text.strip(), name
    if inspect.isfunction(thing):
        for argument, parameter in inspect.signature(thing).parameters.items():
            if parameter.kind is not parameter.VAR_KEYWORD:
                assert argument in text, f"{name}: argument '{argument}' is not explained"


def test_importing_the_package_loads_nothing_heavy():
    program = "import sys, tustinnet; assert not {'jax', 'numpy', 'polars'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_unknown_names_are_refused():
    with pytest.raises(AttributeError, match="has no attribute 'simulate_all'"):
        getattr(tn, "simulate_all")  # noqa: B009 (a name that the type checker would refuse)


def test_the_readmes_program_runs_as_it_stands(folder, tmp_path, monkeypatch, capsys):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", readme, flags=re.S)
    assert len([line for line in program.splitlines() if line.strip()]) <= 10
    quick = tn.read_recipe("standard", ["stages.*.epochs=2"])  # as written, but two epochs a stage
    monkeypatch.setattr("tustinnet.fitting.task.read_recipe", lambda which: quick)
    folder.rename(tmp_path / "LOGS")
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "README.md", "exec"), {})
    assert "fall3" in capsys.readouterr().out
    assert tn.load_model(tmp_path / "my-model.safetensors").dt == 0.02


def test_the_readmes_card_is_valid():
    import tomllib

    from tustinnet.data.card import Card
    from tustinnet.data.declaration import declare

    for page in ("README.md", "docs/reference/data.md"):
        text = (ROOT / page).read_text(encoding="utf-8")
        cards = [
            c for c in re.findall(r"```toml\n(.*?)```", text, flags=re.S) if "coordinates" in c
        ]
        assert cards, page
        for card in cards:
            declare(tomllib.loads(card), Card, page)


@pytest.mark.parametrize("card", sorted((ROOT / "examples").glob("*.toml")), ids=lambda p: p.stem)
def test_the_example_cards_are_valid(card):
    from tustinnet.data.card import Card
    from tustinnet.data.declaration import read_declaration

    assert read_declaration(card, Card).coordinates


SYSTEM_FILES = [
    p for p in sorted((ROOT / "examples").glob("*.py")) if "__main__" not in p.read_text("utf-8")
]


@pytest.mark.parametrize("file", SYSTEM_FILES, ids=lambda p: p.stem)
def test_the_example_systems_accelerate_by_numbers(file):
    system = tn.load_system(file)
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    x = jnp.full(2 * len(system.coordinates) + len(system.internal), 0.1)
    rate = np.asarray(system.model(values).derivative(x, jnp.full(len(system.inputs), 0.5)))
    assert rate.shape == x.shape
    assert np.isfinite(rate).all()
    np.testing.assert_allclose(rate[: len(system.coordinates)], 0.1, rtol=1e-6)


@pytest.mark.real
@pytest.mark.parametrize(
    ("card", "files", "samples"),
    [("double_pendulum_dfki", "double_pendulum_dfki", 2500), ("emps", "emps", 3600)],
)
def test_other_measured_systems_load_with_the_example_cards(real_data, card, files, samples):
    place = real_data.parent / files
    if not place.is_dir():
        pytest.skip(f"the measured data of {card} is not at hand")
    data = tn.load(place, ROOT / "examples" / f"{card}.toml")
    assert len(data.split("train")[0]) == samples
    for e in data:
        report = tn.inspect_experiment(e)
        assert report.recording.samples > len(e)
        assert not report.suspicious


def test_links_in_the_pages_lead_somewhere():
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                file, _, heading = target.partition("#")
                linked = (page.parent / file).resolve() if file else page
                if linked in made_pages():
                    continue
                assert linked.exists(), f"{page.name}: {target}"
                assert not heading or heading in headings(linked), f"{page.name}: {target}"


def made_pages() -> set[Path]:
    """Pages that are written while the documentation is built."""
    docs = ROOT / "docs"
    tutorials = {script.with_suffix(".md") for script in (docs / "tutorials").glob("*.py")}
    return tutorials | {docs / "reference" / "command-line.md"}


def headings(page: Path) -> list[str]:
    """The headings of a page as links name them."""
    found = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.M)
    return [anchor(title) for title in found]


def test_every_dependency_is_pinned():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"]]
    for extra in project["optional-dependencies"].values():
        wanted += extra
    pinned = re.findall(r"^([\w.-]+)==", (ROOT / "constraints.txt").read_text(), flags=re.M)
    known = {name.lower().replace("_", "-") for name in pinned}
    for dependency in wanted:
        name = re.split(r"[<>=\[]", dependency)[0].lower().replace("_", "-")
        assert name in known, f"{name} is not pinned in constraints.txt"
