"""Messages are one short line that steers no terminal; names can be file names."""

import pickle

import numpy as np
import pytest

import tustinnet as tn
from tustinnet.errors import (
    convert_errors,
    describe_error,
    require_name,
    require_number,
    require_text,
)
from tustinnet.evaluate.reference import Persistence


class Panic(BaseException):
    """What libraries in Rust raise: no `Exception`."""


class Mute(Exception):
    """An error whose text cannot be made."""

    def __str__(self) -> str:
        raise GeneratorExit


def test_a_message_is_one_line_without_control_characters():
    told = str(tn.InputError("a\x1b[31mb", "two\nlines", "x" * 5000))
    assert told.startswith("a\\x1b[31mb: two lines; expected xxx")
    assert told.isprintable()
    assert len(told) < 500


@pytest.mark.parametrize("raised", [Panic("oh"), Mute(), ValueError("v" * 9999), SystemExit(3)])
def test_whatever_a_library_raises_becomes_an_input_error(raised):
    with (
        pytest.raises(tn.InputError, match="records: cannot be read") as told,
        convert_errors("records", "cannot be read", "a whole file"),
    ):
        raise raised
    assert type(raised).__name__ in str(told.value)
    assert len(str(told.value)) < 300


def test_memory_that_is_not_there_is_told():
    with (
        pytest.raises(tn.InputError, match="does not fit into memory"),
        convert_errors("f", "big", "x"),
    ):
        raise MemoryError


def test_input_errors_and_interruptions_pass():
    with pytest.raises(KeyboardInterrupt), convert_errors("f", "x", "y"):
        raise KeyboardInterrupt
    with pytest.raises(tn.InputError, match="own: found"), convert_errors("f", "x", "y"):
        raise tn.InputError("own", "found")


def test_an_error_without_a_text_is_named_by_its_kind():
    assert describe_error(Mute()) == "Mute: without a text"


BAD_NAMES = [
    "",
    " ",
    "../x",
    "/x",
    "a/b",
    "a\\b",
    ".x",
    "..",
    "a\x1b[31m",
    "a\nb",
    "\u202ex",
    "é" * 51,
]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_that_are_no_file_names_are_refused(name):
    with pytest.raises(tn.InputError, match="record"):
        require_name(name, "record")


@pytest.mark.parametrize("name", BAD_NAMES)
def test_channels_and_records_check_their_names(name):
    with pytest.raises(tn.InputError, match="coordinate"):
        tn.Coordinate(name, "angular")
    with pytest.raises(tn.InputError, match="input"):
        tn.Input(name, "V")
    with pytest.raises(tn.InputError, match="record"):
        tn.from_arrays([0.0, 1.0], dt=1.0, coordinates={"a": "angular"}, name=name)


@pytest.mark.parametrize("name", ["fall 1", "Arm-2_b", "é" * 50, "θ", "a.b"])
def test_other_names_are_taken(name):
    require_name(name, "record")


def test_units_may_hold_a_slash_and_nothing_unprinted():
    require_text("N m/rad", "unit")
    with pytest.raises(tn.InputError, match=r"unit: .*'\\x07'"):
        require_text("V\x07", "unit")


@pytest.mark.usefixtures("unchecked")
def test_kinds_and_holds_that_are_none_are_refused():
    with pytest.raises(tn.InputError, match="kind 'round'"):
        tn.Coordinate("a", "round")  # pyright: ignore[reportArgumentType]
    with pytest.raises(tn.InputError, match="hold 'none'"):
        tn.Input("a", "V", "none")  # pyright: ignore[reportArgumentType]


def test_an_error_that_a_worker_sends_has_its_message():
    error = pickle.loads(pickle.dumps(tn.InputError("a", "b", "c", "d")))
    assert isinstance(error, tn.InputError)
    assert str(error) == "a: b; expected c; d"


def test_a_text_is_no_number_and_one_fold_is_none():
    for number in (1, 0.5, np.float32(2), np.int64(3)):
        require_number(number, "x")
    with pytest.raises(tn.InputError, match="parameter 'mass': '1'; expected a number"):
        require_number("1", "parameter 'mass'")
    with pytest.raises(tn.InputError, match="`folds=`: 1; expected 3 or more"):
        tn.make_cross_validation_options("network", folds=1)


def test_arrays_are_no_records_and_one_record_is_checked(pendulum):
    with pytest.raises(tn.InputError, match="experiments: ndarray; expected Iterable of Exp"):
        tn.free_run(Persistence(pendulum.channels, False), pendulum[0].q)
    with pytest.raises(tn.InputError, match="data: Experiment; expected"):
        tn.fit(pendulum[0], "linear")
    assert tn.check(pendulum[0]) == tn.check([pendulum[0]])
