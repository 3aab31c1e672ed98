"""The page as one text, with a policy that allows no other scripts and styles than its own."""

import hashlib
import re
from base64 import b64encode
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from tustinnet.store.files import nonfinite_to_none

_PACKAGE = "tustinnet.report.page"
# in the order in which they build on one another
_SCRIPTS = (
    "data.js", "theme.js", "clock.js", "linkage.js", "dials.js", "stage.js", "plots.js",
    "charts.js", "range.js", "states.js", "playground.js", "main.js",
)  # fmt: skip
_ENDS = re.compile(r"</(script|style)|<!--", re.IGNORECASE)
_BEGIN = "globalThis.exported = [];"
_REGISTER = "globalThis.exported.push({ init, step, states, inputs, period, samples, range });"


def rendered(context: Mapping[str, Any], content: Any, modules: Mapping[int, str]) -> str:
    """The page.

    Args:
        context: what the template says in words and tables.
        content: the numbers that scripts draw, plain values.
        modules: exported models as JavaScript modules, by their place among the models.
    """
    style = _whole(f"{_file('vendor/uplot/uPlot.min.css')}\n{_file('assets/page.css')}")
    scripts = [_whole(_file("vendor/uplot/uPlot.iife.min.js")), _whole(_BEGIN)]
    exported = [_whole(f"{text}\n{_REGISTER}\n") for text in modules.values()]
    program = _whole("\n".join(_file(f"assets/{name}") for name in _SCRIPTS))
    policy = {
        "default-src": "'none'",
        "script-src": " ".join(map(_allowed, (*scripts, *exported, program))),
        "style-src": _allowed(style),
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return _environment().get_template("page.html").render(
        **context,
        policy="; ".join(f"{key} {value}" for key, value in policy.items()),
        style=style,
        licence=_file("vendor/uplot/LICENSE"),
        scripts=scripts,
        exported=exported,
        program=program,
        data=nonfinite_to_none({**content, "exported": list(modules)}),
    )  # fmt: skip


@cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def _file(name: str) -> str:
    return resources.files(_PACKAGE).joinpath(name).read_text(encoding="utf-8")


def _whole(text: str) -> Markup:
    """Text that stands in a script or style as it is; nothing in it ends that element."""
    assert not _ENDS.search(text), "the end of a script or style"
    return Markup(text)


def _allowed(text: str) -> str:
    """The source expression of a content security policy that allows just this text."""
    return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
