"""What the command loads, and when: heavy modules only where they are used."""

import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = {"jax", "equinox", "scipy", "matplotlib", "polars", "rich", "h5py", "jinja2"}
READING = {"polars", "rich"}  # records of text, and tables of them
# prints whether matplotlib is loaded when a table is printed, instead of the table
TELLING = """
from tustinnet.cli import terminal
terminal.print_tables = lambda *tables: print("printed, matplotlib:", "matplotlib" in sys.modules)
"""


def python(program: str) -> str:
    """What a program prints in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{program}"],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def heavy_after(program: str) -> set[str]:
    """The heavy modules that a program loads."""
    told = python(f"{program}\nprint('loaded:', *sys.modules)")
    return set(told.rpartition("loaded:")[2].split()) & HEAVY


def command(*arguments: object) -> str:
    """A program that runs the command and goes on."""
    given = [str(a) for a in arguments]
    return (
        "from tustinnet.cli.entry import run\n"
        f"sys.argv = ['tustinnet', *{given}]\n"
        "try: run()\nexcept SystemExit as end: assert not end.code"
    )


@pytest.fixture
def model(run_folder) -> Path:
    return run_folder / "model.safetensors"


def test_the_verbs_load_nothing_heavy_before_they_run():
    assert not heavy_after("import tustinnet.cli.main")


def test_help_loads_nothing_heavy():
    helps = (
        "from tustinnet.cli.main import _VERBS, run\n"
        "for verb in _VERBS:\n"
        "    try: run([verb.__name__.replace('_', '-'), '--help'])\n"
        "    except SystemExit as end: assert not end.code\n"
        "    else: raise AssertionError(verb)\n"
        "print('loaded:', *sys.modules)"
    )
    loaded = python(helps).rpartition("loaded:")[2].split()
    assert not {*HEAVY, "numpy"} & set(loaded)


def test_a_module_of_a_room_is_loaded_when_it_is_used():
    told = python(
        "from tustinnet.signals import windows\n"
        "assert 'tustinnet.signals.windows' not in sys.modules\n"
        "windows.replaced = 1\n"
        "import tustinnet.signals.windows as loaded\n"
        "print(loaded is not windows, loaded.replaced, windows.__file__ == loaded.__file__)"
    )
    assert told.split() == ["True", "1", "True"]
    with pytest.raises(ImportError, match="cannot import name 'nothing'"):
        from tustinnet.signals import nothing  # noqa: F401 # pyright: ignore


@pytest.mark.parametrize(("set_by_the_user", "threads"), [(None, "1"), ("4", "4")])
def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(
    set_by_the_user, threads, monkeypatch
):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if set_by_the_user:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", set_by_the_user)
    telling = (
        "\nimport os\nprint('threads', os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)"
    )
    assert f"threads {threads} False" in python(command("--version") + telling)


def test_records_are_inspected_without_jax_and_scipy(folder):
    assert heavy_after(command("inspect", folder)) <= READING


def test_a_card_is_drafted_and_drawn_without_jax(folder, tmp_path):
    for log in folder.glob("*.csv"):
        (tmp_path / log.name).write_bytes(log.read_bytes())
    assert "jax" not in heavy_after(command("init", tmp_path, "--yes"))
    assert (tmp_path / "init.png").is_file()


def test_a_header_is_shown_by_its_family_and_without_what_reads_records_and_draws(model):
    assert heavy_after(command("show", model)) == {"jax", "equinox"}


def test_what_identifies_loads_its_solvers_only_where_it_needs_them():
    loaded = python("import tustinnet.selection.select\nprint(*sys.modules)").split()
    assert not {"scipy.optimize", "scipy.signal", "scipy.spatial"} & set(loaded)


@pytest.mark.thorough
@pytest.mark.parametrize("verb", ["evaluate", "fit"])
def test_results_are_printed_before_matplotlib_is_loaded(verb, folder, model, tmp_path):
    figures = tmp_path / "figures"
    given = {
        "evaluate": (model, folder, "--figures", figures),
        "fit": (
            folder,
            "--recipe",
            "linear",
            "--out",
            tmp_path / "f",
            "--quiet",
            "--no-report",
        ),
    }[verb]
    told = python(TELLING + command(verb, *given))
    assert "printed, matplotlib: False" in told
    assert "printed, matplotlib: True" not in told
    assert list(tmp_path.rglob("fall3.png"))
