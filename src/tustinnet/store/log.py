"""Logs: a line of JSON an epoch of a training, or an iteration of an identification."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from tustinnet.fitting.gradient.state import Progress
from tustinnet.fitting.listener import EpochReport, Iteration, StageResult
from tustinnet.store.files import nonfinite_to_none, unwritable_error, write_into

LOG = "log.jsonl"
DAMAGED = "log.damaged.jsonl"


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The training log of a member's folder, a mapping an epoch, up to where it is damaged."""
    return _valid_epochs(_read_bytes(folder))


def _read_bytes(folder: Path) -> bytes:
    """A folder's log, empty where there is none."""
    try:
        return (folder / LOG).read_bytes()
    except OSError:
        return b""


def is_stage_end(entry: Mapping[str, Any]) -> bool:
    """Whether a line of an identification's log is the end of a stage, not an iteration."""
    return "parameters" in entry


def read_search_log(folder: Path) -> list[dict[str, Any]]:
    """The log of an identification, up to where it is damaged: iterations, and ends of stages."""
    entries = []
    for entry in _entries(_read_bytes(folder)):
        if not any(_has_types(entry, types) for types in (_ITERATION, _STAGE)):
            break
        values = entry.get("parameters", {}).values()
        if not all(value is None or isinstance(value, int | float) for value in values):
            break
        entries.append(entry)
    return entries


_ITERATION: dict[str, Any] = {
    "stage": str,
    "iteration": int,
    "cost": float | None,
    "damping": float | None,
    "initial": str,
}
_STAGE: dict[str, Any] = {
    "stage": str,
    "initial": str,
    "iterations": int,
    "cost": float | None,
    "why": str,
    "parameters": dict,
}


# a line has the report of an epoch; numbers that are not finite are null. Each member has a log of
# its own, and the time that it took differs when a run is resumed
_LEFT_OUT = ("member", "seconds", "compiling")
_TYPES: dict[str, Any] = {
    field.name: float | None if field.type is float else field.type
    for field in dataclasses.fields(EpochReport)
    if field.name not in _LEFT_OUT
}


def _valid_epochs(content: bytes) -> list[dict[str, Any]]:
    """The epochs of a log up to the first line that is none."""
    epochs: list[dict[str, Any]] = []
    stages = set[str]()
    for entry in _entries(content):
        last = epochs[-1] if epochs else None
        if not _has_types(entry, _TYPES):
            break
        if last is None or entry["stage"] != last["stage"]:  # a stage has its name alone
            follows = entry["epoch"] == 1 and entry["stage"] not in stages
            stages.add(entry["stage"])
        else:  # the next one, or one that was taken back
            again = entry["epoch"] == last["epoch"] and bool(last["event"])
            follows = again or entry["epoch"] == last["epoch"] + 1
        if not follows:
            break
        epochs.append(entry)
    return epochs


def _entries(content: bytes) -> Iterator[dict[str, Any]]:
    """The mappings of a log, a line each, up to the first line that is none."""
    for line in content.decode("utf-8", "replace").split("\n"):
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            return
        if not isinstance(entry, dict):
            return
        yield entry


def _has_types(entry: Mapping[str, Any], types: Mapping[str, Any]) -> bool:
    """Whether a line has just these keys, with values of these kinds."""
    return entry.keys() == types.keys() and all(
        isinstance(entry[key], kind) for key, kind in types.items()
    )


class TrainingLog:
    """A line of JSON an epoch; a resumed run drops the lines it is about to repeat.

    A log that is damaged, or shorter than the checkpoint says, is set aside with a remark.
    """

    def __init__(
        self, folder: Path, resumed: Progress | None, remark: Callable[[str], None]
    ) -> None:
        self._path = folder / LOG
        kept: list[dict[str, Any]] = []
        if resumed:
            before = self._path.read_bytes() if self._path.is_file() else b""
            kept = _valid_epochs(before)[: resumed.reported]
            if len(kept) < resumed.reported:
                write_into(folder, DAMAGED, before)
                remark(
                    f"{self._path}: {len(kept)} sound lines, expected {resumed.reported}; what "
                    f"was there is kept as {DAMAGED}, the log goes on behind the sound lines"
                )
        write_into(folder, LOG, "".join(json.dumps(line) + "\n" for line in kept))
        self._lines = _Lines(self._path)

    def write(self, report: EpochReport) -> None:
        """Adds an epoch."""
        self._lines.write({name: getattr(report, name) for name in _TYPES})

    def close(self) -> None:
        """Ends it."""
        self._lines.close()


class SearchLog:
    """A line of JSON an iteration, and one with the parameters at the end of every stage."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @cached_property
    def _lines(self) -> "_Lines":
        """The file, made with the first line: what is refused before leaves none behind."""
        write_into(self._folder, LOG, "")
        return _Lines(self._folder / LOG)

    def write_iteration(self, iteration: Iteration) -> None:
        """Adds an iteration."""
        line = dataclasses.asdict(iteration)
        self._lines.write({"stage": line.pop("stage"), "iteration": line.pop("number"), **line})

    def write_stage(self, stage: StageResult) -> None:
        """Adds the end of a stage."""
        self._lines.write(dataclasses.asdict(stage))

    def close(self) -> None:
        """Ends it."""
        if "_lines" in self.__dict__:
            self._lines.close()


class _Lines:
    """A file that is written line by line, each at once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._file = path.open("ab")
        except OSError as error:
            raise unwritable_error(path, error) from error

    def write(self, line: dict[str, Any]) -> None:
        """Adds a line."""
        try:
            self._path.stat()  # raises where the folder was removed, which writing would not
            self._file.write(json.dumps(nonfinite_to_none(line)).encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise unwritable_error(self._path, error) from error

    def close(self) -> None:
        """Ends it."""
        with suppress(OSError):  # errors of writing were raised before
            self._file.close()
