"""Declarations read from TOML files."""

import os
from pathlib import Path

import pytest

from tustinnet.data.card import Card
from tustinnet.data.declaration import (
    Declaration,
    Name,
    Sentence,
    Text,
    declare,
    read_declaration,
)
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


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"name = ", "not valid TOML"),
        (b"name: toy", "not valid TOML"),
        (b'name = "\xff"', "cannot be read .*utf-8"),
        (b"dt = " + b"9" * 5000, "not valid TOML .*digits"),
        (b"dt = " + b"9" * 100, "an integer of more than 64 bits"),
        (b"a = " + b"[" * 3000, "not valid TOML .*nested deeper than 20"),
        (b"a" + b".a" * 100_000 + b" = 1", ".*nested deeper than 20"),
        (b"[a" + b' . "a"' * 30 + b"]", ".*nested deeper than 20"),
        (b"a = " + b"[" * 25 + b"]" * 25, "nested deeper than 20"),
        (CARD.encode() + b"#" * 1_000_001, "more than 1 MB"),
    ],
    ids=lambda part: repr(part)[:20],
)
def test_a_file_that_is_no_toml_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "card.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"card\.toml: {message}"):
        read_declaration(path, Card)


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    path.write_text(CARD, encoding="utf-8-sig")
    assert read_declaration(path, Card).name == "toy"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes by name on this system")
def test_a_pipe_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "card.toml"
    os.mkfifo(path)
    with pytest.raises(InputError, match=r"card\.toml: a folder or pipe"):
        read_declaration(path, Card)


@pytest.mark.parametrize("number", ["inf", "-inf", "nan"])
def test_numbers_are_finite(tmp_path: Path, number: str) -> None:
    path = tmp_path / "card.toml"
    path.write_text(CARD.replace("0.01", number))
    with pytest.raises(InputError, match=r"card\.toml, dt: .*finite"):
        read_declaration(path, Card)


class Texts(Declaration):
    name: Name = "a"
    unit: Text = ""
    description: Sentence = ""


@pytest.mark.parametrize(
    ("key", "text", "message"),
    [
        ("name", "a/b", "the name 'a/b'"),
        ("name", "a\x1b[31m", r"holds the character '.x1b'"),
        ("unit", "\x07", r"holds the character '.x07'"),
        ("unit", "m" * 101, "of 101 bytes"),
        ("description", "fine, but \u202e", "holds the character"),
    ],
)
def test_what_is_printed_is_printable(key: str, text: str, message: str) -> None:
    with pytest.raises(InputError, match=f"^card, {key}: .*{message}"):
        declare({key: text}, Texts, "card")


def test_a_sentence_may_be_long_and_on_several_lines() -> None:
    text = declare({"description": "word \n" * 100}, Texts, "card").description
    assert text == " ".join(["word"] * 100)


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
