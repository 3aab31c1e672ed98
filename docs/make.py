"""Makes the documentation site: `python docs/make.py`.

The pages of this folder are copied into a folder of their own, joined there by those that a
program writes (the tutorials with what they print and draw, the reference of the command), and
built by Zensical, which refuses links that lead nowhere.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent
# shell cells without the line that makes them shell cells; pictures with the words of their cell
PAGE = """{% extends 'markdown/index.md.j2' %}
{% block input %}
{%- set shell = cell.source.startswith('%%bash') %}
```{{ 'sh' if shell else 'python' }}
{{ cell.source | replace('%%bash\n', '') }}
```
{% endblock input %}
{% block data_png %}
![{{ cell.metadata['alt'] }}]({{ output.metadata.filenames['image/png'] | path2url }})
{% endblock data_png %}
"""
# what a tutorial that could not be run says below its title
LACKING = """!!! note
    This page shows no results. It needs the recordings `{data}`, and the variable `TUSTINNET_DATA`,
    which names their folder, was not set when the page was made."""
BESIDE = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"


def main(arguments: list[str] | None = None) -> int:
    """Makes the pages, then the site."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "docs")
    parser.add_argument(
        "--unexecuted", action="store_true", help="tutorials without what they print and draw"
    )
    asked = parser.parse_args(arguments)
    pages = asked.out / "pages"
    shutil.rmtree(pages, ignore_errors=True)
    shutil.copytree(DOCS, pages, ignore=shutil.ignore_patterns("*.py"))
    command_line(pages / "reference" / "command-line.md")
    tutorials(pages / "tutorials", asked.out / "tutorials", executed=not asked.unexecuted)
    shutil.copy(ROOT / "zensical.toml", asked.out)
    site = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    ended = subprocess.run([*site, "--config-file", asked.out / "zensical.toml"], check=False)
    print(f"{asked.out / 'site' / 'index.html'}" if ended.returncode == 0 else "no site was made")
    return ended.returncode


def command_line(page: Path) -> None:
    """Writes what every verb and option of the command is."""
    described = [sys.executable, "-m", "typer", "tustinnet.cli.main", "utils", "docs"]
    told = subprocess.run(
        [*described, "--name", "tustinnet", "--title", "Command line"],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | {"TERMINAL_WIDTH": "100"},
    )
    page.write_text(told.stdout, encoding="utf-8")


def tutorials(pages: Path, kept: Path, *, executed: bool) -> None:
    """Writes the tutorials as pages, all at once; one whose program did not change is kept."""
    kept.mkdir(parents=True, exist_ok=True)
    state = source_digest() if executed else None
    scripts = sorted((DOCS / "tutorials").glob("*.py"))
    with ThreadPoolExecutor() as pool:
        for _ in pool.map(lambda s: tutorial(s, pages, kept, state), scripts):
            pass


def tutorial(script: Path, pages: Path, kept: Path, state: str | None) -> None:
    """Writes a tutorial as a page: run, unless the state of the sources is `None`.

    One whose recordings are not at hand is not run either, and says so.
    """
    import nbformat
    from nbconvert import MarkdownExporter
    from nbconvert.writers import FilesWriter

    name = f"{script.stem}-{hashlib.sha256(script.read_bytes()).hexdigest()[:12]}-{state}.ipynb"
    notebook = kept / name
    book = read(script)
    if state is None:
        pass
    elif data := lacking(book):
        print(f"not running {script.relative_to(ROOT)}: TUSTINNET_DATA does not name {data}")
        book.cells.insert(1, nbformat.v4.new_markdown_cell(LACKING.format(data=data)))
    elif notebook.is_file():
        book = nbformat.read(notebook, as_version=4)
    else:
        print(f"running {script.relative_to(ROOT)}", flush=True)
        book = run(script, kept / script.stem)
        nbformat.write(book, notebook)
    body, resources = MarkdownExporter(raw_template=PAGE).from_notebook_node(
        book, {"unique_key": script.stem, "output_files_dir": f"{script.stem}_files"}
    )
    FilesWriter(build_directory=str(pages)).write(body, resources, notebook_name=script.stem)


def read(script: Path):  # noqa: ANN201 - a notebook has no useful type
    """Reads a tutorial, a script in the percent format, as a notebook."""
    import jupytext

    return jupytext.read(script)


def lacking(book) -> str | None:  # noqa: ANN001
    """The recordings that a tutorial needs and that are not at hand, if there are any.

    A tutorial names them in its header, as `data: qube-servo2` below `jupyter:`.
    """
    return None if os.environ.get("TUSTINNET_DATA") else book.metadata.get("data")


def run(script: Path, folder: Path):  # noqa: ANN201
    """Runs a tutorial in an empty folder and gives the notebook with what it printed and drew.

    Raises:
        CellExecutionError: If a cell fails.
    """
    from nbclient import NotebookClient

    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    book = read(script)
    resources = {"metadata": {"path": str(folder)}}
    # shell cells find the command that belongs to this Python
    env = os.environ | {"PATH": BESIDE, "COLUMNS": "110", "TTY_COMPATIBLE": "0"}
    if data := os.environ.get("TUSTINNET_DATA"):
        env["TUSTINNET_DATA"] = str(Path(data).resolve())  # the tutorial runs elsewhere
    quiet = ["--log-level=40"]
    client = NotebookClient(
        book, timeout=600, resources=resources, extra_arguments=quiet, coalesce_streams=True
    )
    return client.execute(env=env)


def source_digest() -> str:
    """What the tutorials' output depends on besides their own text: the package's sources."""
    digest = hashlib.sha256()
    for path in sorted((ROOT / "src").rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


if __name__ == "__main__":
    sys.exit(main())
