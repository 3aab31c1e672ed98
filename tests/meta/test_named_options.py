"""Messages name only options that the command has."""

import ast
import re
from pathlib import Path
from typing import Any

import typer

from tustinnet.cli.main import app
from tustinnet.cli.options import with_options

SOURCE = Path(__file__).parents[2] / "src" / "tustinnet"
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")
OF_OTHERS = {"--eval", "--input-type", "--address", "--head", "--port"}  # of Node.js and Ray


def texts(tree: ast.AST) -> set[str]:
    """All texts of a module but its docstrings, which speak to programmers."""
    documentation = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in documentation
    }


def named_options(path: Path) -> set[str]:
    """The options in the texts of a module; of texts that name a verb, its options are others."""
    said = [text for text in texts(ast.parse(path.read_text())) if "tustinnet " not in text]
    said = [with_options(text) for text in said]
    return {option for text in said for option in OPTION.findall(text)} - OF_OTHERS


def of_command(command) -> set[str]:
    return {"--help"} | {o for p in command.params for o in (*p.opts, *p.secondary_opts)}


COMMAND: Any = typer.main.get_command(app)
VERBS = {name: of_command(command) for name, command in COMMAND.commands.items()}
OF_ONE_VERB = [  # modules whose errors people see from one verb
    *(("control", path) for path in sorted((SOURCE / "control").rglob("*.py"))),
    ("control", SOURCE / "cli" / "control.py"),
    ("export", SOURCE / "cli" / "export.py"),
]


def test_the_library_speaks_of_its_arguments_and_the_command_of_its_options():
    of_command = {SOURCE / "old_names.py", *(SOURCE / "cli").glob("*.py")}
    library = [path for path in SOURCE.rglob("*.py") if path not in of_command]
    said = {text for path in library for text in texts(ast.parse(path.read_text()))}
    assert not {t for t in said if set(OPTION.findall(t)) - OF_OTHERS or t.endswith(" --")}
    of_a_file = "`per=` of `load_robot`"
    text = "more time (`budget=`); `trust_beyond=`, `changes=` a=1, `origin=` M: `name`, x=`y`, "
    expected = "more time (--budget); --trust-beyond, --set a=1, --from M: `name`, x=`y`, "
    assert with_options(text + of_a_file) == expected + of_a_file


def test_every_option_that_a_message_names_is_one_of_a_verb():
    known = of_command(COMMAND).union(*VERBS.values())
    files = [path for path in SOURCE.rglob("*.py") if path.name != "old_names.py"]
    named = {path.name: named_options(path) for path in files}
    assert not {name: options - known for name, options in named.items() if options - known}


def test_messages_of_a_verb_name_its_own_options():
    named = {path.name: (named_options(path), VERBS[verb]) for verb, path in OF_ONE_VERB}
    assert not {name: said - own for name, (said, own) in named.items() if said - own}
