"""Dates and times of day as text, read as seconds."""

import datetime
import re
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import polars as pl

_HOUR, _DAY = 3600.0, 86_400.0  # s
_MONTHS = {
    "jan": 1,
    "feb": 2,
    "mar": 3,
    "m\u00e4r": 3,
    "mrz": 3,
    "apr": 4,
    "may": 5,
    "mai": 5,
    "jun": 6,
    "jul": 7,
    "aug": 8,
    "sep": 9,
    "oct": 10,
    "okt": 10,
    "nov": 11,
    "dec": 12,
    "dez": 12,
}
_DATE = (
    r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.](?:\d{4}|\d{2})|\d{8}"
    r"|\d{1,2}[-. ]{1,2}[A-Za-z\u00e4]{3}[-. ]\d{4}"
)
# hours and minutes, or minutes and seconds with decimals, as spreadsheets write them
_TIME = (
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<decimals>\d{1,9}))?)?"
    r"|(?P<minute_only>\d{1,2}):(?P<second_only>\d{2})[.,](?P<decimals_only>\d{1,9})"
)
# durations, as tables of MATLAB (`0.01 sec`) and of pandas (`0 days 00:00:00.010000`) have them
_SECONDS = {"sec": 1.0, "min": 60.0, "hr": _HOUR, "ms": 1e-3, "msec": 1e-3, "s": 1.0}
_DURATION = r"(?P<amount>[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?) ?(?P<of>sec|min|hr|ms|msec|s)"
_PATTERN = (
    rf"{_DURATION}|(?:(?P<days>\d{{1,5}}) days? )?(?:(?P<date>{_DATE})(?:[T_ -]+|$))?(?:{_TIME})?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?(?: ?(?P<zone>Z|UTC|[+-]\d{2}:?\d{2}))?"
)
_WHOLE = re.compile(_PATTERN)


def is_date(cell: str) -> bool:
    """Whether a cell is a date, a time of day, both, or a duration."""
    # the shortest is as 1s
    if len(cell) < 2 or (":" not in cell and cell.isdigit()):
        return False
    match = _WHOLE.fullmatch(cell)
    # a zone alone is none: -1500 is a number
    return match is not None and (":" in cell or bool(match["date"] or match["of"]))


def read_dates(cells: "pl.Series") -> "pl.Series":
    """Seconds since the midnight before the first of some dates; null where a cell is none.

    Times of day alone go on over midnight, minutes and seconds alone over the full hour. Durations
    are seconds as they are.

    Args:
        cells: the texts.
    """
    import polars as pl

    parts = cells.str.strip_chars().str.extract_groups(f"^(?:{_PATTERN})$").struct.unnest()

    def number(name: str) -> pl.Expr:
        return pl.col(name).cast(pl.Float64).fill_null(0.0)

    def fraction(name: str) -> pl.Expr:
        return ("0." + pl.col(name)).cast(pl.Float64).fill_null(0.0)

    half = pl.col("half").str.to_lowercase()
    hour = number("hour") % pl.when(half.is_not_null()).then(12).otherwise(24)
    hour = hour + pl.when(half == "p").then(12).otherwise(0)
    minute, second = number("minute") + number("minute_only"), number("second")
    second = second + number("second_only") + fraction("decimals") + fraction("decimals_only")
    ahead = pl.col("zone").str.replace(":", "").str.extract(r"^[+-]\d{4}$", 0).cast(pl.Int64)
    ahead = (ahead.abs() // 100 * 60 + ahead.abs() % 100) * ahead.sign()
    seconds = 3600 * hour + 60 * (minute - ahead.fill_null(0)) + second
    amount = pl.col("amount").str.replace(",", ".").cast(pl.Float64)
    duration = amount * pl.col("of").replace_strict(_SECONDS, default=None, return_dtype=pl.Float64)
    seconds = seconds + _DAY * number("days") + duration.fill_null(0.0)
    clock = parts.select(seconds.alias("t"))["t"]
    known = pl.col("date", "hour", "minute_only", "amount").is_not_null()
    is_known = parts.select(pl.any_horizontal(known).alias("known"))["known"]
    t = clock.to_numpy()
    if parts["amount"].null_count() + parts["days"].null_count() < 2 * len(parts):
        pass
    elif parts["date"].null_count() < len(parts):
        t = t + _DAY * _days(parts["date"])
    else:
        turn = _HOUR if parts["hour"].null_count() == len(parts) else _DAY
        t = t + turn * np.cumsum(np.diff(t, prepend=t[:1]) < -turn / 2)
    return pl.Series(t).set(~is_known | pl.Series(t).is_nan(), None)


def _days(dates: "pl.Series") -> np.ndarray:
    """Days since the first date."""
    texts = [text for text in dates.unique(maintain_order=True) if text is not None]
    day_first = _is_day_first(texts)
    ordinals = {text: _ordinal(text, day_first=day_first) for text in texts}
    first = ordinals[texts[0]]
    return np.array([ordinals.get(text, np.nan) - first for text in dates.to_list()])


def _is_day_first(texts: list[str]) -> bool:
    """Whether dates of three numbers with the year last begin with the day."""
    numbers = [re.split(r"[-/.]", text) for text in texts]
    pairs = [(int(n[0]), int(n[1])) for n in numbers if len(n) == 3 and n[1].isdigit()]
    if any(day > 12 for day, _ in pairs):
        return True
    return not any(month > 12 for _, month in pairs) and "/" not in texts[0]


def _ordinal(text: str, *, day_first: bool) -> float:
    """The number of a day; not a number where there is no such day."""
    if text.isdigit():
        text = f"{text[:4]}-{text[4:6]}-{text[6:]}"
    a, b, c = [part for part in re.split(r"[-/. ]+", text) if part]
    if len(a) == 4:
        year, month, day = a, b, c
    elif not b.isdigit():
        year, month, day = c, str(_MONTHS.get(b.lower(), 0)), a
    else:
        year, (day, month) = c, (a, b) if day_first else (b, a)
    try:
        years = int(year) + (2000 if len(year) == 2 else 0)
        return float(datetime.date(years, int(month), int(day)).toordinal())
    except ValueError:
        return float("nan")
