"""Declarations read from TOML files."""

from pathlib import Path

import pytest

from tustinnet.data.card import Card
from tustinnet.data.declaration import read_declaration
from tustinnet.errors import InputError

CARD = """
name = "toy"
dt = 0.01
[[coordinates]]
name = "angle"
kind = "angular"
column = 1
"""


def test_a_file_is_read_as_what_it_declares(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    path.write_text(CARD)
    card = read_declaration(path, Card)
    assert (card.name, card.dt, card.coordinates[0].column) == ("toy", 0.01, 1)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"absent\.toml: no such file"):
        read_declaration(tmp_path / "absent.toml", Card)


def test_a_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read_declaration(tmp_path, Card)


@pytest.mark.parametrize("content", [b"name = ", b"name: toy", b'name = "\xff"'])
def test_a_file_that_is_no_toml_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "card.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"card\.toml: not valid TOML"):
        read_declaration(path, Card)


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    path.write_text(CARD.replace('kind = "angular"', ""))
    with pytest.raises(InputError, match=r"card\.toml, coordinates\.0\.kind: missing"):
        read_declaration(path, Card)


def test_a_declaration_cannot_be_changed(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    path.write_text(CARD)
    card = read_declaration(path, Card)
    with pytest.raises(ValueError, match="frozen"):
        card.name = "other"
