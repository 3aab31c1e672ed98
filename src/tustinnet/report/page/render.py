"""The page as one HTML text; its security policy allows no scripts and styles but its own."""

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
    "data.js",
    "theme.js",
    "clock.js",
    "linkage.js",
    "dials.js",
    "stage.js",
    "plots.js",
    "charts.js",
    "range.js",
    "states.js",
    "pilot.js",
    "playground.js",
    "main.js",
)
_ENDING_TAG = re.compile(r"</(script|style)|<!--", re.IGNORECASE)
_BEGIN = "globalThis.exported = [];"
_REGISTER = "globalThis.exported.push({ init, step, states, inputs, period, samples, range });"


def render(
    context: Mapping[str, Any],
    content: Any,
    modules: Mapping[int, str],
    template: str = "page.html",
) -> str:
    """Renders a page as HTML.

    Args:
        context: variables of the template.
        content: the numbers that scripts draw, plain values.
        modules: models exported to JavaScript, by their index among the models.
        template: the template of the page.
    """
    environment = Environment(
        loader=PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    style = _embed(f"{_read_asset('vendor/uplot/uPlot.min.css')}\n{_read_asset('assets/page.css')}")
    scripts = [_embed(_read_asset("vendor/uplot/uPlot.iife.min.js")), _embed(_BEGIN)]
    exported = [_embed(f"{text}\n{_REGISTER}\n") for text in modules.values()]
    program = _embed("\n".join(_read_asset(f"assets/{name}") for name in _SCRIPTS))
    policy = {
        "default-src": "'none'",
        "script-src": " ".join(map(_hash_source, (*scripts, *exported, program))),
        "style-src": _hash_source(style),
        "base-uri": "'none'",
        "form-action": "'none'",
    }
    return environment.get_template(template).render(
        **context,
        policy="; ".join(f"{key} {value}" for key, value in policy.items()),
        style=style,
        licence=_read_asset("vendor/uplot/LICENSE"),
        scripts=scripts,
        exported=exported,
        program=program,
        data=nonfinite_to_none({**content, "exported": list(modules)}),
    )


@cache
def _read_asset(name: str) -> str:
    return resources.files(_PACKAGE).joinpath(name).read_text(encoding="utf-8")


def _embed(text: str) -> Markup:
    """Marks text of a script or style as safe; it must not contain the end of that element."""
    assert not _ENDING_TAG.search(text), "the end of a script or style"
    return Markup(text)


def _hash_source(text: str) -> str:
    """Source expression of a content security policy that allows only this text."""
    return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
