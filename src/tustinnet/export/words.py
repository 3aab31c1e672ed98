"""Texts in languages with the operators of C: operations, templates, functions where called."""

import re
from collections.abc import Sequence
from pathlib import Path

# operations with operators; most others are functions
INFIX = {
    "add": "{} + {}",
    "sub": "{} - {}",
    "mul": "{} * {}",
    "div": "{} / {}",
    "neg": "-{}",
    "lt": "{} < {}",
    "le": "{} <= {}",
    "gt": "{} > {}",
    "ge": "{} >= {}",
    "eq": "{} == {}",
    "ne": "{} != {}",
    "and": "{} && {}",
    "or": "{} || {}",
    "not": "!{}",
    "select": "{} ? {} : {}",
}


def apply_form(form: str | None, function: str, operands: Sequence[str]) -> str:
    """An operation as text: its form with the operands in it, or the call of a function."""
    return f"{function}({', '.join(operands)})" if form is None else form.format(*operands)


TEMPLATES = Path(__file__).parent / "templates"


def fill_template(name: str, templates: Path = TEMPLATES, **values: object) -> str:
    """The text of a file of a folder of templates, with `@name@` replaced by a value."""
    text = (templates / name).read_text(encoding="utf-8")
    return re.sub("@([a-z_]+)@", lambda match: str(values.get(match[1], match[0])), text)


def called_functions(template: str, code: str) -> list[str]:
    """The functions of a template that a code calls; in the template blank lines separate them."""
    called = set(re.findall(r"(\w+)\(", code))
    functions = fill_template(template).rstrip("\n").split("\n\n")
    return [f"{text}\n" for text in functions if re.findall(r"(\w+)\(", text)[0] in called]
