"""Damaged files of laboratories: every one ends in columns or in an `InputError` of one line."""

import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lab_files import (
    BEGIN,
    hdf5_file,
    lerobot_data_set,
    mcap_file,
    mdf_file,
    ros1_bag,
    ros2_bag,
    tdms_file,
    ulog_file,
    workbook,
)

from tustinnet.data.readers import read_columns
from tustinnet.errors import InputError


def excel(path: Path) -> Path:
    return workbook(path, {"a": [["x", "y"], *([k, k / 7] for k in range(200))]})


def lists(path: Path) -> Path:
    (file,) = lerobot_data_set(path.parent, "v3.0")
    return file


WRITERS: dict[str, Callable[[Path], Path]] = {
    "log.bag": ros1_bag,
    "log.db3": ros2_bag,
    "log.mcap": mcap_file,
    "log.ulg": ulog_file,
    "log.mf4": mdf_file,
    "log.mdf": mdf_file,
    "log.tdms": tdms_file,
    "log.h5": hdf5_file,
    "log.xlsx": excel,
    "file-000.parquet": lists,
}


def attempt(path: Path) -> str:
    """Reads all columns; the message where they cannot be."""
    try:
        columns = read_columns(path)
        columns.fetch(columns.names[:40])
    except InputError as error:
        message = str(error)
        assert "\n" not in message
        assert len(message) < 500 + 2 * len(str(path))
        assert "Traceback" not in message
        return message
    return ""


@pytest.mark.parametrize("name", WRITERS)
def test_bytes_that_flip(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = WRITERS[name](tmp_path / name)
    whole, generator = path.read_bytes(), np.random.default_rng(11)
    assert not attempt(path)
    capfd.readouterr()
    for _ in range(12):
        damaged = bytearray(whole)
        for place in generator.integers(0, len(whole), 3):
            damaged[place] = generator.integers(0, 256)
        path.write_bytes(damaged)
        attempt(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_a_file_that_is_cut_short_is_refused(name: str, share: float, tmp_path: Path) -> None:
    path = WRITERS[name](tmp_path / name)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole)) or 12])
    message = attempt(path)
    # logs of PX4 have no mark of their end: where the power was cut they are whole until then
    assert message or name == "log.ulg"


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("content", [b"\x07noise" * 500, b"\0" * 3000, b"PK\x03\x04" * 300])
def test_another_kind_of_file_is_refused(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert attempt(path).startswith(str(path))


# --- sizes that are declared ---


def huge_ulog(path: Path) -> None:
    """A format of an array of 4e9 numbers."""
    text = b"arm:uint64_t timestamp;float[4000000000] q;"
    head = b"ULog\x01\x12\x35\x01" + bytes(8)
    subscription = struct.pack("<BH", 0, 0) + b"arm"
    path.write_bytes(
        head
        + struct.pack("<HB", len(text), ord("F"))
        + text
        + struct.pack("<HB", len(subscription), ord("A"))
        + subscription
        + struct.pack("<HB", 14, ord("D"))
        + bytes(14)
    )


def huge_mcap(path: Path) -> None:
    """A chunk of 2**50 bytes."""
    head = b"\x89MCAP0\r\n"
    path.write_bytes(head + b"\x06" + struct.pack("<Q", 2**50) + bytes(200) + head)


def huge_tdms(path: Path) -> None:
    """A segment of 2**40 values of a channel."""
    tdms_file(path)
    content = bytearray(path.read_bytes())
    at = content.index(struct.pack("<IIQ", 10, 1, 200))
    content[at : at + 16] = struct.pack("<IIQ", 10, 1, 2**40)
    path.write_bytes(content)


def huge_sequence(path: Path) -> None:
    """A message of ROS 2 whose list declares 2**32 - 1 numbers."""
    ros2_bag(path)
    with sqlite3.connect(path) as base:
        (topic,) = base.execute("select id from topics where name = '/command'").fetchone()
        message = b"\0\1\0\0" + struct.pack("<4I", 0, 0, 2**32 - 1, 0)
        base.execute("delete from messages where topic_id = ?", (topic,))
        base.execute(
            "insert into messages (topic_id, timestamp, data) values (?, ?, ?)",
            (topic, BEGIN, message),
        )
    base.close()


def deep_json(path: Path) -> None:
    """Objects of JSON in one another, 100,000 of them."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("deep", "jsonschema", b"{}")
        channel = writer.register_channel("/deep", "json", schema)
        data = b'{"a":' * 100_000 + b"1" + b"}" * 100_000
        writer.add_message(channel, BEGIN, data, BEGIN)
        data = b'{"a":' * 50 + b"1" + b"}" * 50
        shallow = writer.register_channel("/shallow", "json", schema)
        writer.add_message(shallow, BEGIN, data, BEGIN)
        writer.finish()


def bomb(path: Path) -> None:
    """A workbook whose sheet expands to 40 MB of blanks."""
    import zipfile

    excel(path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, data in parts.items():
            if not name.endswith("sheet1.xml"):
                archive.writestr(name, data)
        with archive.open("xl/worksheets/sheet1.xml", "w", force_zip64=True) as sheet:
            sheet.write(b'<worksheet><sheetData><row r="1"><c r="A1" t="str"><v>')
            for _ in range(40):
                sheet.write(bytes([32]) * 2**20)
            sheet.write(b"</v></c></row></sheetData></worksheet>")


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("log.ulg", huge_ulog),
        ("log.mcap", huge_mcap),
        ("log.tdms", huge_tdms),
        ("log.db3", huge_sequence),
        ("log.mcap", deep_json),
        ("log.xlsx", bomb),
    ],
)
def test_sizes_that_are_declared_are_not_believed(
    tmp_path: Path, name: str, write: Callable[[Path], None]
) -> None:
    path = tmp_path / name
    write(path)
    if not attempt(path):  # what else is in the file can be read
        others = read_columns(path).others
        assert {"command", "deep", "shallow"} & {text.partition("/")[0] for text in others}
