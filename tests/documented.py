"""What the pages of the documentation tell users to type."""

import re
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"


def section(heading: str, page: str = "reference/export.md") -> str:
    """A section of a page, from its heading to the next one of its level."""
    text = (DOCS / page).read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(heading)}$(.*?)(?=^## |\Z)", text, flags=re.M | re.S)
    assert found, f"{page} has no section '{heading}'"
    return found.group(1)


def anchor(heading: str) -> str:
    """How links name a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def blocks(heading: str, language: str, page: str = "reference/export.md") -> list[str]:
    """What stands in a section as code of a language, block by block."""
    return re.findall(rf"^```{language}\n(.*?)^```", section(heading, page), flags=re.M | re.S)
