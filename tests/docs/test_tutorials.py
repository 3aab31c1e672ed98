"""Every tutorial runs to its end, and every picture in it has words."""

import importlib.util
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from cells_in_process import SHELL, Notebook, run_shell

DOCS = Path(__file__).parents[2] / "docs"
SCRIPTS = sorted((DOCS / "tutorials").glob("*.py"))

_spec = importlib.util.spec_from_file_location("make_documentation", DOCS / "make.py")
assert _spec is not None
assert _spec.loader is not None
make = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(make)


# parts of a tutorial as it stands, and so short that all cells still run: nothing here looks at
# how good a model becomes, and `make docs` runs the tutorials in full
NO_REPORT = "--no-report"  # what a page does not show: other tests write it
SEARCH = f"{NO_REPORT} --set search.initial=anchored --set search.substeps=1"
FIRST = "from-logs"  # the tutorial that is run by `make test`
SHORTER = {
    FIRST: {
        "for _ in range(20)]": "for _ in range(8)]",
        "--seeds 3 ": f"--seeds 2 {NO_REPORT} ",
        "model.hidden=[32,32]": "model.hidden=[4]",
        "stages.0.epochs=60": "stages.0.epochs=2",
        "windows.count=800": "windows.count=50",
        "--recipe linear --out linear": f"--recipe linear {NO_REPORT} --out linear",
    },
    "into-the-controller": {
        '"fall2", "fall3", "noise1", "noise3", "noise5", ': '"noise1", ',
        "--out pendulum": f"--out pendulum {SEARCH}",
        "--data logs --out": "--data logs --starts 1 --out",
        "[0.1, 0.05], 5)": "[0.1, 0.05], 1)",
    },
    "own-physics": {
        ", (1.2, 0), (0, 4), (-0.8, 3), (0, 4)])": ", (1.2, 0)])",
        "--out first": f"--out first {SEARCH} --set search.iterations=3",
        "--out weighed": f"--out weighed {SEARCH} --set search.iterations=3",
        "--out rubbing": f"--out rubbing {SEARCH} --set search.iterations=3",
    },
    "publication": {
        "train[::2]": "train[::6]",
        "stages.0.epochs=20": "stages.0.epochs=1",
        '"stages.0.epochs=30", "stages.1.epochs=12"': '"stages.0.epochs=1", "stages.1.epochs=1"',
    },
}


def marked(script):
    """A tutorial as a parameter, with the marks that it needs."""
    marks = [pytest.mark.real] if make.read(script).metadata.get("data") else []
    marks += [] if script.stem == FIRST else [pytest.mark.thorough]
    return pytest.param(script, id=script.stem, marks=marks)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("script", [marked(script) for script in SCRIPTS])
def test_a_tutorial_runs_to_its_end(script, tmp_path, monkeypatch, request):
    if "cc -" in script.read_text(encoding="utf-8") and shutil.which("cc") is None:
        pytest.skip("no C compiler (cc)")
    if make.lacking(make.read(script)):
        monkeypatch.setenv("TUSTINNET_DATA", str(request.getfixturevalue("real_data").resolve()))
    text = script.read_text(encoding="utf-8")
    for part, shorter in SHORTER.get(script.stem, {}).items():
        assert text.count(part) == 1
        text = text.replace(part, shorter)
    short = tmp_path / script.name
    short.write_text(text, encoding="utf-8")
    (folder := tmp_path / "run").mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr(plt, "show", lambda: None)
    book, notebook, drawn = make.read(short), Notebook(), []
    assert not make.lacking(book)
    for cell in book.cells:
        if cell.cell_type != "code":
            continue
        if cell.source.startswith(SHELL):
            run_shell(cell.source.removeprefix(SHELL), tmp_path)
        elif notebook.run(cell.source):
            drawn.append(cell)
    assert drawn
    assert all(len(cell.metadata.get("alt", "")) > 20 for cell in drawn)


NOTEBOOK = """# %% [markdown]
# # Two cells

# %%
import matplotlib.pyplot as plt

plt.plot([1, 2])
plt.show()

# %% language="bash"
# tustinnet --version | cut -d " " -f 1
# pwd
"""


def test_cells_are_run_in_an_empty_folder_with_the_command_of_this_python(tmp_path):
    (script := tmp_path / "two.py").write_text(NOTEBOOK)
    book = make.run(script, tmp_path / "run")
    drawing, typing = (cell for cell in book.cells if cell.cell_type == "code")
    assert drawing.execution_count
    assert any("image/png" in output.get("data", {}) for output in drawing.outputs)
    (printed,) = typing.outputs
    assert printed.text.split() == ["tustinnet", str(tmp_path / "run")]


def test_a_tutorial_without_its_recordings_is_not_run_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(make, "run", None)  # would fail
    script = DOCS / "tutorials" / "publication.py"
    make.tutorial(script, tmp_path, tmp_path, "state")
    page = (tmp_path / "publication.md").read_text(encoding="utf-8")
    title, _, rest = page.partition("\n")
    assert title.startswith("# ")
    note = rest.index("!!! note")
    assert note < rest.index("## ")  # before the first section
    assert "TUSTINNET_DATA" in rest[note : rest.index("## ")]
