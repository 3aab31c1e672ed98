"""Plain text files are read as numbers at once, with the numbers and messages of any other file."""

from itertools import product

import numpy as np
import pytest

from tustinnet.data import text_file
from tustinnet.data.text_file import read_text
from tustinnet.errors import InputError

TOKENS = (
    "1",
    "-1",
    "+1",
    "1.",
    "-.5",
    "1E-5",
    "1e999",
    "nan",
    "-inf",
    "Infinity",
    "",
    "  1",
    "1 ",
    " ",
    "x",
    "1_0",
    "0x1F",
    "1,5",
    "1e",
    "1d3",
    "--1",
    "9" * 400,
    "1e-400",
    "-0.0",
    "1e+05",
    "null",
    "1;2",
    "-",
    ".",
    '"1"',
    "ä",
    "#",
)
FILES = (
    "a,b\n1,2\n{},3\n4,5\n",
    "a,b\r\n1,{}\r\n",
    "{},1\n2,3",
    "# remark\na,b\n1,2\n\n3,4\n5,{}\n#\n6,7",
    "a,b\n1,2\n3,{},4\n",
    "{}\n",
)


@pytest.fixture(autouse=True)
def _small_files_too(monkeypatch):
    monkeypatch.setattr(text_file, "_LARGE", -1)


def content(path, header, delimiter):
    """Names, numbers, places and notes of a file, or the message that refuses it."""
    try:
        columns = read_text(path, header=header, delimiter=delimiter)
        numbers = [columns[name].tobytes() for name in columns.names]
        return columns.names, numbers, columns.place(len(numbers[0]) // 8 - 1), columns.notes
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("text", FILES)
def test_a_cell_is_read_or_refused_alike(text, tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    for token in TOKENS:
        path.write_text(text.format(token))
        for header, delimiter in product((None, True, False), (None, ",")):
            found = content(path, header, delimiter)
            with monkeypatch.context() as patched:
                patched.setattr(text_file, "_plain_rows", lambda *_: None)
                assert found == content(path, header, delimiter), (token, header, delimiter)


def test_numbers_are_those_of_python(tmp_path):
    path, generator = tmp_path / "log.csv", np.random.default_rng(0)
    numbers = generator.normal(size=3000) * 10.0 ** generator.integers(-300, 300, 3000)
    texts = [(repr(x), f"{x:.9g}", f"{x:.25e}")[i % 3] for i, x in enumerate(numbers.tolist())]
    path.write_text("x,y\n" + "\n".join(f"{text},1" for text in texts))
    assert text_file._plain_rows(path, None) is not None
    assert read_text(path)["x"].tolist() == [float(text) for text in texts]
