"""The sampling rate above a table, beside columns or in a file's name, of files without times."""

import re
from collections.abc import Mapping
from itertools import pairwise, starmap
from pathlib import Path

from tustinnet.data.text_dialect import SAMPLE_LINES, comment_text, decode, is_comment
from tustinnet.data.units import TIME
from tustinnet.errors import InputError

_NUMBER = r"(\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)"
_BETWEEN = r"[^\d\n]{0,25}?"
_WORDS = r"sampl\w*|abtast\w*|scan|frame|data|acquisition|logging|messrate|echantillonnage"
_RATE = re.compile(
    rf"(?i)(?:(?:{_WORDS}|freq\w*|rate|fs)\b{_BETWEEN}{_NUMBER}\s*(k?)(?:hz|sps|fps|1/s|s/s)"
    rf"|\b(?:frequency|fps|fs|sampl\w*[ _]?rate|frame[ _]?rate)\W{{1,4}}{_NUMBER}\s*$)"
)
_INTERVAL = re.compile(
    rf"(?i)(?:(?:{_WORDS})[ _]?(?:time|interval|period|zeit|intervall)|abtastzeit|\bts|\bdt"
    rf"|\bdelta_?[xt])\b{_BETWEEN}{_NUMBER}\s*\[?(s|ms|us|\u00b5s|ns)(?:ec\w*)?\b"
)
_ALONE = re.compile(r"(?:the number )?(\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)")
_NAME_OF_PERIOD = re.compile(
    r"(?i)(?:^|[/_.])(?:t_?s|dt|sampl\w*_?(?:time|period|interval)|abtastzeit)$"
)
_NAME_OF_RATE = re.compile(
    r"(?i)(?:^|[/_.])(?:fs|f_s|hz|fps|sampl\w*_?(?:rate|freq\w*)|abtastrate)$"
)
_INCREMENT = re.compile(r"(?i)(?:t_?)?increment")
# a period of 100 ms or more is rather how long something lasts
_IN_NAME = re.compile(r"(?<![\d.,])(\d{1,2}(?=ms)|\d{1,5}(?=us))(ms|us)(?![a-z])")

_NUMERAL = r"(\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+)"
_ASSIGNMENT = re.compile(
    rf"(?m)^[ \t]*([\w.]+)\s*=\s*{_NUMERAL}(?:\s*/\s*{_NUMERAL})?\s*(?:[;#%,]|$)"
)
_DATA_OBJECT = re.compile(rf"\biddata\([^\n]{{0,300}},\s*{_NUMERAL}\s*[,)]")  # of MATLAB


def period_in_name(name: str) -> float | None:
    """The period [s] that a file's name may say, as `run_4000us`; None where it says none."""
    match = _IN_NAME.search(name)
    return int(match[1]) * TIME[match[2]] if match else None


def period_in_numbers(texts: Mapping[str, str]) -> float | None:
    """The period [s] that a number beside columns says, as `Ts` or `fs`; None where none does.

    Args:
        texts: what is beside the columns, by name; of numbers `the number 0.02`, or `50`.
    """
    for name, text in texts.items():
        number = _ALONE.fullmatch(text)
        value = float(number[1]) if number else 0.0
        if value > 0 and _NAME_OF_PERIOD.search(name):
            return value
        if value > 0 and _NAME_OF_RATE.search(name):
            return 1 / value
    return None


def period_in_script(text: str) -> float | None:
    """The period [s] in a script: that of a data object or of a variable, as `Ts = 0.01`."""
    if made := _DATA_OBJECT.search(text):
        return float(made[1]) or None
    values = {
        name: float(number) / float(divisor or 1)
        for name, number, divisor in _ASSIGNMENT.findall(text)
        if float(divisor or 1)
    }
    return period_in_numbers({name: f"{value:.9g}" for name, value in values.items()})


def find_period(path: Path) -> float | None:
    """The sampling period [s] that the first lines of a text file say, None where they say none.

    Such lines are `Abtastrate: 1000 Hz`, `FREQUENCY 200`, `# sampling interval = 5 ms`, or a
    number below the name `Increment`, as of an oscilloscope.

    Args:
        path: the file.
    """
    try:
        lines = decode(path, None)[0].splitlines()[:SAMPLE_LINES]
    except InputError:
        return None
    return (
        next(filter(None, map(_period_in, lines)), None)
        or period_in_script("\n".join(map(comment_text, filter(is_comment, lines))))
        or next(filter(None, starmap(_period_below, pairwise(lines))), None)
    )


def period_in_prose(text: str) -> float | None:
    """The only period [s] that a text about records says, as `Sampling time: 0.02 sec`."""
    parts = re.split(r"(?<=[.;])\s|\n\s*\n", text)
    (period, *others) = {*map(_period_in, parts)} - {None} or {None}
    return None if others else period


def _period_below(names: str, values: str) -> float | None:
    """The period [s] below its name in two lines of settings."""
    cells = (re.split(r"\s*[,;\t]\s*", line) for line in (names, values))
    below = [x for name, x in zip(*cells, strict=False) if _INCREMENT.fullmatch(name)]
    return float(below[0]) or None if below and _ALONE.fullmatch(below[0]) else None


def _period_in(line: str) -> float | None:
    """The period [s] that a line says, None where it says none."""
    plain = " ".join(line.replace(";", " ").split())
    if (match := _INTERVAL.search(plain)) is not None:
        unit = match[2].lower().replace("\u00b5", "u")
        return float(match[1].replace(",", ".")) * TIME[unit] or None
    if (match := _RATE.search(plain)) is not None:
        rate = float((match[1] or match[3]).replace(",", "."))
        return 1 / (rate * (1000 if match[2] else 1)) if rate else None
    return None
