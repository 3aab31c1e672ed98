"""The page on the architecture names every package, and only files that exist."""

import re
from functools import cache
from pathlib import Path

import pytest
from documented import DOCS

ROOT = DOCS.parent
SOURCE = ROOT / "src" / "tustinnet"
PACKAGES = [SOURCE, *sorted(init.parent for init in SOURCE.rglob("*/__init__.py"))]
PAGE = (DOCS / "explanation" / "architecture.md").read_text(encoding="utf-8")
# files that users or runs write
WRITTEN = {"scores.json"}


@cache
def entries() -> dict[Path, list[str]]:
    """The files that the overview names, by the folder of their entry."""
    (overview,) = re.findall(r"```\n(.*?)```", PAGE, flags=re.S)
    folders: list[tuple[int, Path]] = []
    texts: dict[Path, str] = {}
    for line in overview.splitlines():
        if match := re.match(r"( *)(\S+)/ +(.*)", line):
            depth = len(match[1])
            folders = [entry for entry in folders if entry[0] < depth]
            folders.append((depth, (folders[-1][1] if folders else ROOT) / match[2]))
            texts[folders[-1][1]] = match[3].partition(": ")[2]
        else:
            texts[folders[-1][1]] += f" {line}"
    return {folder: re.sub(r"\([^)]*\)", " ", text).split() for folder, text in texts.items()}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda p: p.relative_to(SOURCE).as_posix())
def test_every_package_has_an_entry(package):
    assert entries()[package]


def test_every_file_of_the_overview_exists():
    missing = [
        f"{folder.relative_to(ROOT)}/{name}"
        for folder, names in entries().items()
        for name in names
        if not any([*folder.glob(name), *folder.glob(f"{name}.py")])
    ]
    assert not missing


def test_every_file_is_in_the_overview():
    named = {
        folder / Path(name).with_suffix("").name
        for folder, names in entries().items()
        for name in names
    }
    missing = [
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*.py")
        if not path.name.startswith("__") and path.with_suffix("") not in named
    ]
    assert not missing


@cache
def existing_paths() -> list[str]:
    places = (ROOT / name for name in ("src", "tests", "docs", "benchmarks", "examples"))
    return [f"/{path.relative_to(ROOT).as_posix()}" for p in places for path in p.rglob("*")]


PATHS = sorted(set(re.findall(r"`([\w./-]+(?:/|\.(?:py|pyi|md|toml|json)))`", PAGE)) - WRITTEN)


@pytest.mark.parametrize("path", PATHS)
def test_every_path_in_the_text_exists(path):
    assert any(known.endswith(f"/{path.rstrip('/')}") for known in existing_paths())
