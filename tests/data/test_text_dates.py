"""Dates and times of day in text files."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import tustinnet as tn
from tustinnet.data.drafting.draft import draft_card
from tustinnet.data.readers import read_columns
from tustinnet.data.text_dates import is_date, read_dates

DATES = {
    "ISO 8601": (["2024-03-01T12:00:00.123Z", "2024-03-02 00:00:01Z"], [43200.123, 86401.0]),
    "a zone": (["2024-03-01 12:00:00+01:00", "2024-03-01 11:00:01Z"], [39600.0, 39601.0]),
    "German": (["29.02.2024 23:59:59,99", "01.03.2024 00:00:00,01"], [86399.99, 86400.01]),
    "German months": (["1. Mrz 2024 1:00:00", "01-Mär-2024 01:00:01"], [3600.0, 3601.0]),
    "American": (["2/29/2024 11:59:59 PM", "3/1/2024 12:00:01 AM"], [86399.0, 86401.0]),
    "days first": (["31/01/2024 0:00:00", "01/02/2024 0:00:00"], [0.0, 86400.0]),
    "over midnight": (["23:59:59.5", "00:00:00.5", "00:00:01"], [86399.5, 86400.5, 86401.0]),
    "over noon": (["11:59:59.5 AM", "12:00:00 PM"], [43199.5, 43200.0]),
    "a colon before ms": (["12:00:00:123", "12:00:00:133"], [43200.123, 43200.133]),
    "minutes of a spreadsheet": (["59:59.9", "00:00.0"], [3599.9, 3600.0]),
    "durations of MATLAB": (["0 sec", "0.01 sec", "1e-05 sec"], [0.0, 0.01, 1e-5]),
    "minutes and ms": (["1.5 min", "2 hr"], [90.0, 7200.0]),
    "durations of pandas": (["0 days 00:00:00.5", "1 days 00:00:00.25"], [0.5, 86400.25]),
    "no such day": (["2024-03-01 0:00:00", "2024-02-30 0:00:00"], [0.0, None]),
}


@pytest.mark.parametrize("case", DATES)
def test_dates_are_seconds_since_midnight(case: str) -> None:
    texts, seconds = DATES[case]
    assert all(map(is_date, texts))
    for t, expected in zip(read_dates(pl.Series(texts)), seconds, strict=True):
        assert t == expected if expected is None else abs(t - expected) < 1e-9


@pytest.mark.parametrize(
    "cell", ["1.5", "12", "1.2.3", "1.000.000", "angle", "", "-", "20240301", "-1500", "+0130"]
)
def test_numbers_and_words_are_no_dates(cell: str) -> None:
    assert not is_date(cell)


FILES = {
    "with names": ("Uhrzeit;Winkel [deg]\n", "01.03.2024 10:00:{:06.3f};{}\n", "Uhrzeit", ","),
    "without names": ("", "2024-03-01 10:00:{:06.3f},{}\n", "column 1", "."),
    "between tabs": ("time\tangle\n", "10:00:{:06.3f}\t{}\n", "time", "."),
}


@pytest.mark.parametrize("case", FILES)
def test_a_column_of_dates_is_the_clock_of_a_draft(case: str, tmp_path: Path) -> None:
    header, row, name, decimal = FILES[case]
    angle = np.round(40 * np.sin(0.2 * np.arange(200)), 3)
    rows = [row.format(0.02 * k, f"{q}").replace(".", decimal) for k, q in enumerate(angle)]
    rows = [line.replace("01,03,2024", "01.03.2024") for line in rows]
    (tmp_path / "log.csv").write_text(header + "".join(rows), encoding="utf-8")
    columns = read_columns(tmp_path / "log.csv")
    np.testing.assert_allclose(columns[name] - 36_000, 0.02 * np.arange(200), atol=1e-9)
    assert f"'{name}': dates or times of day, read as seconds since midnight" in columns.notes
    draft = draft_card(tmp_path, ["log.csv"])
    assert (draft.clock.column, draft.clock.unit, draft.dt) == (name, "s", 0.02)
    (tmp_path / "dataset.toml").write_text(draft.text, encoding="utf-8")
    assert sum(len(record) for record in tn.load(tmp_path)) == 200


def test_a_row_without_a_date_is_named(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,q\n10:00:01,1\nnoon,2\n", encoding="utf-8")
    with pytest.raises(tn.InputError, match=r"row 3, t: the text 'noon'; expected a date"):
        read_columns(tmp_path / "log.csv")["t"]
