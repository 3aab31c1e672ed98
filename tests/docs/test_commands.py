"""Commands in the README and in the pages are those of the command: their verbs and options."""

import re
import shlex
from pathlib import Path

import typer.main

from tustinnet.cli.main import app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page: Path) -> list[list[str]]:
    """The words of each command in the shell blocks of a page."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", text, flags=re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [own[1:] for own in words if own[:1] == ["tustinnet"]]


def test_verbs_and_options_are_those_of_the_command():
    verbs = getattr(typer.main.get_command(app), "commands")  # noqa: B009 (of a group alone)
    known = {
        name: {option for p in verb.params for option in p.opts + p.secondary_opts}
        for name, verb in verbs.items()
    }
    written = [(page, words) for page in PAGES for words in commands(page) if words]
    assert len(written) > 80
    for page, (verb, *words) in written:
        options = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}
        assert options <= known[verb] | {"--help"}, (page, verb, words)
