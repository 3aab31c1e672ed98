"""What a target of the Makefile installs is enough for the programs that it runs."""

import ast
import re
import sys
import tomllib
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
# of the file, as what is installed may be of an earlier one
META = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# what a program runs beside itself: pages are made of the tutorials
RUNS = {"docs/make.py": sorted((ROOT / "docs/tutorials").glob("*.py"))}


@cache
def rules() -> dict[str, tuple[str, str]]:
    """Prerequisites and recipe of each target."""
    found = re.findall(r"^([\w./-]+):([^\n=]*)\n((?:\t[^\n]*\n|[^\S\n]+[^\n]*\n)*)", MAKEFILE, re.M)
    return {target: (needs, recipe) for target, needs, recipe in found}


def whole_recipe(target: str) -> str:
    """The recipe of a target with those of what it needs."""
    if target not in rules():
        return ""
    needs, recipe = rules()[target]
    return recipe + "".join(map(whole_recipe, needs.split()))


def programs(target: str) -> list[Path]:
    recipe = rules()[target][1]
    files = re.findall(
        r"(?:bin/|\(BIN\)/)(?:python|pytest)[^\n;|&]*?((?:docs|benchmarks|tests)/[\w/]+\.py)",
        recipe,
    )
    paths = [ROOT / file for file in files]
    if "tests.torture" in recipe:
        paths += sorted((ROOT / "tests/torture").glob("*.py"))
    return [*paths, *(path for file in files for path in RUNS.get(file, ()))]


@cache
def closure(requirement: str) -> frozenset[str]:
    """The distributions that a requirement installs, by normalised name."""
    parsed = Requirement(requirement)
    name = re.sub(r"[-_.]+", "-", parsed.name).lower()
    try:
        needed = requires(parsed.name) or []
    except PackageNotFoundError:
        needed = []  # of an extra that is not installed here
    found = {name}
    for text in needed:
        inner = Requirement(text)
        extras = [{"extra": extra} for extra in parsed.extras or {""}]
        if inner.marker is None or any(inner.marker.evaluate(extra) for extra in extras):
            plain = f"{inner.name}[{','.join(inner.extras)}]" if inner.extras else inner.name
            found |= closure(plain) if inner.name != parsed.name else set()
    return frozenset(found)


def imported(path: Path) -> set[str]:
    """The modules of other packages that a program imports, those beside it followed."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module]
        for name in names:
            beside = path.parent / f"{name.replace('.', '/')}.py"
            found |= imported(beside) if beside.exists() else {name.partition(".")[0]}
    local = {p.stem for p in (ROOT / "tests").glob("*.py")} | {"tests", "tustinnet", "simulated"}
    return found - {*sys.stdlib_module_names} - local


TARGETS = [target for target in rules() if not target.startswith(".") and programs(target)]


def test_the_targets_with_programs_are_found() -> None:
    assert {*TARGETS} >= {"docs", "bench", "torture", "test-browser"}


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_installs_what_its_programs_import(target: str) -> None:
    extras = re.findall(r"'\.\[(\w+)\]'", whole_recipe(target))
    needed = [*META["dependencies"], *(x for e in extras for x in META["optional-dependencies"][e])]
    installed = frozenset[str]().union(*map(closure, needed))
    distributions = packages_distributions()
    for path in programs(target):
        for module in imported(path):
            names = {re.sub(r"[-_.]+", "-", d).lower() for d in distributions.get(module, [module])}
            assert names & installed, f"{path.relative_to(ROOT)} imports {module}"
