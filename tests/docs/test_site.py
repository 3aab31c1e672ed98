"""The documentation site: every page is reached, nothing is fetched from other hosts."""

import re
import sys
import tomllib
from html.parser import HTMLParser
from pathlib import Path
from subprocess import run

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FETCHED = {"src", "srcset", "poster", "data"}  # attributes whose address a browser fetches


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site, its tutorials unexecuted; Zensical fails where a link leads nowhere."""
    out = tmp_path_factory.mktemp("docs")
    command = [sys.executable, DOCS / "make.py", "--unexecuted", "--out", out]
    made = run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stdout + made.stderr
    return out / "site"


def named(entry) -> list[str]:
    """The pages that an entry of the navigation names."""
    if isinstance(entry, str):
        return [entry]
    if isinstance(entry, dict):
        return [page for value in entry.values() for page in named(value)]
    return [page for value in entry for page in named(value)]


def test_every_page_is_in_the_navigation_and_made(site):
    settings = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))
    pages = named(settings["project"]["nav"])
    assert len(pages) == len(set(pages))
    for page in pages:
        assert (site / page).with_suffix(".html").is_file(), page
    written = {str(p.relative_to(DOCS)) for p in DOCS.rglob("*.md")}
    assert written <= set(pages)


def test_every_note_is_in_the_table_of_the_notes():
    notes = ROOT / "notes"
    table = (notes / "index.md").read_text(encoding="utf-8")
    for page in notes.glob("20*.md"):
        assert f"({page.name})" in table
        assert re.match(r"\d{4}-\d\d-\d\d-", page.name)


class _Fetches(HTMLParser):
    """Addresses that a browser fetches by itself when it shows a page."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag, attrs):
        for name, value in attrs:
            if name in FETCHED or (tag == "link" and name == "href" and value):
                self.found.append(value or "")


def test_no_page_fetches_from_other_hosts(site):
    for page in site.rglob("*.html"):
        parser = _Fetches()
        parser.feed(page.read_text(encoding="utf-8"))
        assert parser.found
        foreign = [a for a in parser.found if "//" in a]
        assert not foreign, (page.name, foreign)
    for sheet in site.rglob("*.css"):
        assert not re.findall(r"url\(['\"]?https?:", sheet.read_text(encoding="utf-8")), sheet.name


def test_every_picture_has_words(site):
    for page in site.rglob("*.html"):
        for picture in re.findall(r"<img [^>]*>", page.read_text(encoding="utf-8")):
            assert re.search(r'alt="[^"]+"', picture), (page.name, picture)
