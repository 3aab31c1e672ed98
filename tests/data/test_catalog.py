"""Data sets by name, by card or by folder."""

import hashlib
import shutil
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.data import catalog
from tustinnet.data.card import Card
from tustinnet.data.catalog import QUBE_SERVO2, PublishedDataSet
from tustinnet.data.declaration import declare

FILES = {
    f"{split}/swing.csv": "\n".join(f"{np.sin(0.1 * k + phase):.6f},{k}" for k in range(30)) + "\n"
    for split, phase in (("train", 0.0), ("validation", 1.0))
}
CARD = {
    "name": "toy",
    "dt": 0.01,
    "format": {"header": False},
    "coordinates": [{"name": "angle", "kind": "angular", "column": 1}],
    "splits": {
        "train": [{"file": "train/swing.csv", "name": "swing"}],
        "validation": [{"file": "validation/swing.csv", "name": "other"}],
    },
}


@dataclass(frozen=True)
class ToyDataSet(PublishedDataSet):
    """A published data set whose card, checksums and cache are given here."""

    sums: tuple[tuple[str, str], ...]
    place: Path

    def card(self) -> Card:
        return declare(CARD, Card, self.name)

    def checksums(self) -> dict[str, str]:
        return dict(self.sums)

    def cache(self) -> Path:
        return self.place


def write_files(folder: Path) -> Path:
    for name, content in FILES.items():
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text(content)
    return folder


def publish(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, address: str = "http://127.0.0.1:1/"
) -> ToyDataSet:
    """Puts a data set `toy` that is served at an address into the catalog."""
    sums = tuple((name, hashlib.sha256(text.encode()).hexdigest()) for name, text in FILES.items())
    known = ToyDataSet("toy", "toy_stem", address, sums, tmp_path / "cache")
    monkeypatch.setitem(catalog.CATALOG, "toy", known)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    return known


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Says nothing."""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder of the files and the address at which it is served."""
    folder = write_files(tmp_path / "served")

    def handler(*args: object) -> QuietHandler:
        return QuietHandler(*args, directory=str(folder))  # pyright: ignore[reportArgumentType]

    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield folder, f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


@pytest.fixture
def closed_address() -> str:
    """An address at which nobody answers."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"http://127.0.0.1:{probe.getsockname()[1]}/"


def files_in(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


# --- folders and cards ---


def test_a_folder_with_a_card_needs_nothing_else(folder: Path) -> None:
    assert tn.load(folder).name == "pendulum"
    assert tn.load(str(folder)).name == "pendulum"


def test_a_card_stands_for_its_folder(folder: Path) -> None:
    card = (folder / "dataset.toml").rename(folder / "mine.toml")
    assert len(tn.load(card)) == 5


def test_a_card_may_lie_elsewhere(folder: Path, tmp_path: Path) -> None:
    card = shutil.move(folder / "dataset.toml", tmp_path / "elsewhere.toml")
    assert len(tn.load(folder, card=card)) == 5


def test_a_card_for_other_logs_makes_them_test_records(tmp_path: Path) -> None:
    card, new = tmp_path / "dataset.toml", tmp_path / "new"
    card.write_text(
        'name = "toy"\ndt = 0.01\nformat.header = false\n'
        'inputs = [{ name = "u", column = 2, unit = "V" }]\n'
        'coordinates = [{ name = "angle", kind = "angular", column = 1 }]\n'
        'splits.train = ["run1.csv", "run2.csv"]\n'
    )
    new.mkdir()
    (new / "run8.csv").write_text(FILES["train/swing.csv"])
    assert [(e.name, e.split) for e in tn.load(new, card)] == [("run8", "test")]
    (new / "run1.csv").write_text(FILES["train/swing.csv"])
    with pytest.raises(tn.InputError, match=r"run2.csv: no such file"):
        tn.load(new, card)


def test_a_log_of_inputs_alone_can_be_simulated(tmp_path: Path) -> None:
    (tmp_path / "dataset.toml").write_text(
        'name = "toy"\ndt = 0.01\ninputs = [{ name = "u", column = "u", unit = "V" }]\n'
        'coordinates = [{ name = "angle", kind = "angular", column = "q" }]\n'
        'splits.train = ["step.csv"]\n'
    )
    rows = "".join(f"0.0,{k // 15}\n" for k in range(30))
    (tmp_path / "step.csv").write_text("q,u\n" + rows)
    (tmp_path / "other.csv").write_text("q,u\n" + rows)
    (record,) = tn.load(tmp_path / "other.csv")
    assert np.ptp(record.u) == 1.0
    with pytest.raises(tn.InputError, match="nothing moves"):
        tn.load(tmp_path / "step.csv")


def test_a_given_card_goes_before_the_folders_own(folder: Path, tmp_path: Path) -> None:
    card = tmp_path / "other.toml"
    text = (folder / "dataset.toml").read_text()
    card.write_text(text.replace('name = "pendulum"', 'name = "other"'))
    assert tn.load(folder, card=card).name == "other"


def test_a_folder_of_a_published_data_set_needs_no_card(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    publish(monkeypatch, tmp_path)
    assert tn.load(write_files(tmp_path / "mine")).name == "toy"


def test_a_folder_without_a_card_is_refused_with_what_to_do(tmp_path: Path) -> None:
    told = r"no logs and no dataset\.toml.*add-a-reader\.md.*`card=` FILE"
    with pytest.raises(tn.InputError, match=told):
        tn.load(tmp_path)
    (tmp_path / "read me.pdf").touch()
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "run 1.csv").touch()
    told = r"no dataset\.toml.*`tustinnet init .*` writes one.*`card=` FILE"
    with pytest.raises(tn.InputError, match=told):
        tn.load(tmp_path)


def test_a_misspelt_name_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(tn.InputError, match=r"qube-servo2\); did you mean 'qube-servo2'\?"):
        tn.load("qube-servo")


def test_what_is_no_folder_is_refused(folder: Path) -> None:
    (folder / "rig.png").touch()
    with pytest.raises(tn.InputError, match=r"rig\.png: a file; expected a folder"):
        tn.load(folder / "rig.png")
    with pytest.raises(tn.InputError, match=r"absent\.toml: no such file"):
        tn.load(folder / "absent.toml")


def test_a_name_and_a_card_do_not_get_a_pointless_hint(folder: Path) -> None:
    with pytest.raises(tn.InputError) as caught:
        tn.load("qube-servo2", card=folder / "dataset.toml")
    assert "did you mean 'qube-servo2'" not in str(caught.value)


# --- the variable ---


@pytest.mark.parametrize("below", ["", "toy_stem", "toy"])
def test_the_variable_names_the_folder_or_the_one_above(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, below: str
) -> None:
    publish(monkeypatch, tmp_path)
    write_files(tmp_path / "named" / below)
    monkeypatch.setenv("TUSTINNET_DATA", str(tmp_path / "named"))
    assert [e.name for e in tn.load("toy")] == ["swing", "other"]


def test_the_variable_with_a_wrong_folder_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    publish(monkeypatch, tmp_path)
    monkeypatch.setenv("TUSTINNET_DATA", str(tmp_path))
    with pytest.raises(
        tn.InputError,
        match=r"TUSTINNET_DATA=.*no files of 'toy' there.*train/swing\.csv.*unset TUSTINNET_DATA",
    ):
        tn.load("toy")


# --- downloads ---


def test_a_name_is_downloaded_once_and_then_taken_from_the_cache(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, served: tuple[Path, str]
) -> None:
    folder, address = served
    known = publish(monkeypatch, tmp_path, address)
    data = tn.load("toy")
    assert [(e.name, e.split, len(e)) for e in data] == [
        ("swing", "train", 30),
        ("other", "validation", 30),
    ]
    assert files_in(known.cache()) == sorted(FILES)
    shutil.rmtree(folder)
    np.testing.assert_array_equal(tn.load("toy")["swing"].q, data["swing"].q)


def test_a_file_changed_in_the_cache_is_fetched_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, served: tuple[Path, str]
) -> None:
    known = publish(monkeypatch, tmp_path, served[1])
    tn.load("toy")
    (known.cache() / "train/swing.csv").write_text("1,2\n3,4\n")
    assert len(tn.load("toy")["swing"]) == 30
    assert known.changed_files(known.cache()) == []


def test_a_download_with_another_checksum_is_refused_and_not_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, served: tuple[Path, str]
) -> None:
    folder, address = served
    known = publish(monkeypatch, tmp_path, address)
    for name in FILES:
        (folder / name).write_text("1,2\n3,4\n")
    with pytest.raises(tn.InputError, match=r"hash|checksum"):
        tn.load("toy")
    assert files_in(known.cache()) == []


def test_a_file_that_is_not_served_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, served: tuple[Path, str]
) -> None:
    folder, address = served
    publish(monkeypatch, tmp_path, address)
    (folder / "validation/swing.csv").unlink()
    with pytest.raises(tn.InputError, match=rf"{address}validation/swing\.csv could not.*404"):
        tn.load("toy")


def test_without_a_network_the_error_says_where_the_files_belong(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, closed_address: str
) -> None:
    known = publish(monkeypatch, tmp_path, closed_address)
    with pytest.raises(tn.InputError) as caught:
        tn.load("toy")
    told = str(caught.value)
    for part in (closed_address, str(known.cache()), "TUSTINNET_DATA", "train, validation"):
        assert part in told
    assert "\n" not in told


def test_an_error_without_words_is_told_all_the_same(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def silent(*_: object, **__: object) -> None:
        raise TimeoutError

    publish(monkeypatch, tmp_path)
    monkeypatch.setattr("urllib.request.urlopen", silent)
    with pytest.raises(tn.InputError, match=r"could not be fetched.*TimeoutError"):
        tn.load("toy")


def test_files_that_differ_from_the_published_ones_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    known = publish(monkeypatch, tmp_path)
    folder = write_files(tmp_path / "mine")
    assert known.changed_files(folder) == []
    (folder / "train/swing.csv").write_text("1,2\n")
    assert known.changed_files(folder) == ["train/swing.csv"]
    (folder / "train/swing.csv").unlink()  # absent is not different
    assert known.changed_files(folder) == []
    assert known.is_in(folder)
    assert not known.is_in(tmp_path)


# --- the packaged data set ---


def test_the_packaged_card_declares_hold_and_delay_so_that_nothing_is_searched_for() -> None:
    (voltage,) = QUBE_SERVO2.card().channels(0.01).inputs
    assert (voltage.hold, voltage.delay) == ("zero-order", 0.0)
    assert voltage.is_delay_declared


def test_the_packaged_card_and_checksums_name_the_same_files() -> None:
    card, sums = QUBE_SERVO2.card(), QUBE_SERVO2.checksums()
    assert {f.file for files in card.splits.values() for f in files} == set(sums)
    assert all(len(digest) == 64 for digest in sums.values())
    assert QUBE_SERVO2.address.endswith("/data/")
    assert QUBE_SERVO2.cache().name == "qube_servo2"


@pytest.mark.real
def test_the_measured_data_is_the_published_one(
    real_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TUSTINNET_DATA", str(real_data))
    data = tn.load("qube-servo2")
    assert QUBE_SERVO2.changed_files(real_data) == []
    train, validation = data.split("train"), data.split("validation")
    assert [e.name for e in train] == [
        *(f"fall{k}" for k in range(1, 11)),
        "wN_2V_1",
        "wN_2_5V_1",
        "wN_3V_1",
        "wN_3_5V_1",
        "wN_4V_1",
    ]
    assert [e.name for e in validation] == [
        *(f"fallVal{k}" for k in range(1, 5)),
        "wN_2_5V_val",
        "wN_3_5V_val",
    ]
    assert [len(e) for e in train] == [
        786,
        785,
        779,
        745,
        732,
        799,
        775,
        752,
        760,
        716,
        1499,
        1500,
        1500,
        1499,
        1500,
    ]
    assert all(e.sha256 == QUBE_SERVO2.checksums()[e.source] for e in data)
    assert [e.forced for e in data] == [not e.name.startswith("fall") for e in data]


@pytest.mark.real
def test_a_folder_of_the_measured_data_is_recognised(real_data: Path) -> None:
    assert tn.load(real_data).name == "qube-servo2"


def test_a_log_stands_for_itself_with_the_card_above_it(tmp_path):
    folder = write_files(tmp_path / "logs")
    (folder / "dataset.toml").write_text(
        'name = "toy"\ndt = 0.01\nformat.header = false\n'
        'coordinates = [{ name = "angle", kind = "angular", column = 1 }]\n'
        'splits.train = [{ file = "train/swing.csv", name = "swing" }]\n'
    )
    (record,) = tn.load(folder / "train/swing.csv")
    assert (record.name, record.split) == ("swing", "train")
    later = folder / "later.csv"
    later.write_text(FILES["train/swing.csv"])
    (record,) = tn.load(later)
    assert (record.name, record.split) == ("later", "test")
    elsewhere = tmp_path / "elsewhere.csv"
    later.rename(elsewhere)
    (record,) = tn.load(elsewhere, folder / "dataset.toml")
    assert record.name == "elsewhere"
    with pytest.raises(tn.InputError, match=r"no dataset\.toml"):
        tn.load(elsewhere)
