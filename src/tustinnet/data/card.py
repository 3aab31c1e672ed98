"""The data card: a TOML file that declares the columns of a folder of logs."""

from pathlib import PureWindowsPath
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    StrictBool,
    StrictInt,
    StrictStr,
    field_validator,
    model_validator,
)

from tustinnet.channels import (
    LONGEST_DT,
    MOST_DELAY,
    SHORTEST_DT,
    Channels,
    ColumnUnit,
    Coordinate,
    Hold,
    Input,
    Kind,
    PDController,
    PDLoop,
)
from tustinnet.data.declaration import Declaration, Name, Sentence, Text
from tustinnet.data.experiment import SplitName
from tustinnet.data.units import TIME, convert, convert_to_si
from tustinnet.signals.resampling import JITTER

_MOST_COLUMNS = 10**6
_SMALLEST_FACTOR = 1e-15  # of inputs: their squares are numbers
_LONGEST_PART = 255  # bytes of a file's name, as file systems have it


def _column(key: int | str) -> int | str:
    if isinstance(key, int) and not 1 <= key <= _MOST_COLUMNS:
        raise ValueError("columns count from 1")
    return key


def _rising(message: str) -> AfterValidator:
    """A check that the first of two numbers is the smaller one."""

    def check(pair: tuple[Any, Any]) -> tuple[Any, Any]:
        if pair[0] >= pair[1]:
            raise ValueError(message)
        return pair

    return AfterValidator(check)


def _require_assumed(block: Declaration, assumed: tuple[str, ...]) -> None:
    """Raises unless the keys that `assumed` names are in its table."""
    missing = next((key for key in assumed if key not in block.model_fields_set), None)
    if missing is not None:
        raise ValueError(f"`assumed` names '{missing}', which this table lacks; delete it there")


def _nonzero(factor: float) -> float:
    if abs(factor) < _SMALLEST_FACTOR:
        raise ValueError(f"a factor of at least {_SMALLEST_FACTOR:g} in size, of either sign")
    return factor


ColumnKey = Annotated[StrictInt | StrictStr, AfterValidator(_column)]  # a number counts from 1
Amount = Annotated[float, Field(ge=-1e15, le=1e15)]
Scale = Annotated[Amount, AfterValidator(_nonzero)]
Delay = Annotated[float, Field(ge=-1e4, le=1e4)]
Resolution = Annotated[float, Field(ge=1e-12, le=1e6)]
Gain = Annotated[float, Field(ge=0, le=1e15)]
Row = Annotated[StrictInt, Field(ge=0, le=10**12)]
Second = Annotated[float, Field(ge=0, le=1e12)]
Limits = Annotated[tuple[Amount, Amount], _rising("the smaller limit comes first")]
Rows = Annotated[tuple[Row, Row], _rising("the first row, then the row after the last")]
Seconds = Annotated[tuple[Second, Second], _rising("the time of the beginning, then a later one")]


class VelocityCard(Declaration):
    """A velocity column.

    Attributes:
        column: name or number.
        unit: e.g. `rad/s`, `deg/s`, `rpm`, `mm/s`; the coordinate's unit per second by default,
            counts per second of a position in counts.
        measured: whether a sensor measured it; a computed column is not `measured`, and training
            derives velocities from the positions instead.
    """

    column: ColumnKey
    unit: str | None = None
    measured: bool = False


class CoordinateCard(Declaration):
    """A coordinate: `SI value = sign * scale * factor(unit) * (column - offset)`.

    `name`, `kind` and `resolution` are those of `Coordinate`, the latter in its SI unit.

    Attributes:
        column: name or number of the position column.
        unit: rad, deg, rev, ... of an angle; m, mm, in, ... of a linear coordinate, or a unit that
            is no length (V, mA, K, 1), of which the records have the SI unit; or `counts` of the
            encoder. See `units` for the others.
        scale: units of `unit` in one unit of the column, as of a gear or of a sensor in volts; also
            applies to a velocity column without a unit.
        sine: column of the sine of an angle whose cosine `column` has; the unit is then rad.
        sign: 1 or -1; also applies to the velocity column.
        offset: reading of the column where the coordinate is 0, in the column's unit.
        counts_per_revolution: encoder counts in a turn of an angle, instead of `resolution`.
        unwrap: whether jumps of more than half a turn are taken for wraps and removed.
        wraps: whether the encoder starts again after each turn, so that every record is moved by
            whole turns to begin above -135 and at most at 225 degrees; by default where a record
            jumps by a turn.
        velocity: the velocity column, if there is one.
        assumed: keys of this table that nothing in the logs says; the check reminds of them.
    """

    name: Name
    kind: Kind
    column: ColumnKey
    unit: str | None = None
    scale: Annotated[float, Field(ge=1e-12, le=1e12)] = 1.0
    sine: ColumnKey | None = None
    sign: Literal[1, -1] = 1
    offset: Amount = 0.0
    resolution: Resolution | None = None
    counts_per_revolution: float | None = Field(default=None, ge=1, le=1e12)
    unwrap: bool = True
    wraps: bool | None = None
    velocity: VelocityCard | None = None
    assumed: tuple[
        Literal["kind", "unit", "scale", "resolution", "counts_per_revolution"], ...
    ] = ()

    @model_validator(mode="after")
    def _check_units(self) -> "CoordinateCard":
        _require_assumed(self, self.assumed)
        if (self.si_unit == "rad") != (self.kind == "angular"):
            raise ValueError(
                f"unit '{self.unit}' of an angular coordinate; an angle, e.g. rad, deg, rev, counts"
                if self.kind == "angular"
                else f"unit '{self.unit}' of a linear coordinate; an angle is `angular`"
            )
        if self.unit == "counts" and self.count is None:
            raise ValueError("unit 'counts' needs `resolution` or `counts_per_revolution`")
        if self.sine is not None and (self.kind, self.factor()) != ("angular", 1.0):
            raise ValueError("`sine` of a position that is no angle in rad; omit unit and scale")
        if self.unit == "counts" and self.scale != 1:
            raise ValueError("`scale` of counts; scale `resolution` or `counts_per_revolution`")
        if self.counts_per_revolution and self.kind == "linear":
            raise ValueError("`counts_per_revolution` of a linear coordinate; give `resolution`")
        if self.wraps is not None and (self.kind == "linear" or not self.unwrap):
            owner = "a linear coordinate" if self.kind == "linear" else "`unwrap = false`"
            raise ValueError(f"`wraps` of {owner}; an angle that is unwrapped, or leave it out")
        if self.velocity is not None:
            self.velocity_factor()
        return self

    @property
    def si_unit(self) -> str:
        """The SI unit in which the records have the positions."""
        if self.unit is None or self.unit == "counts":
            return "rad" if self.kind == "angular" else "m"
        return convert_to_si(self.unit)[1]

    @property
    def count(self) -> float | None:
        """Encoder count in the SI unit."""
        if self.resolution is None and self.counts_per_revolution is not None:
            return 2 * np.pi / self.counts_per_revolution
        return self.resolution

    def factor(self, unit: str | None = None) -> float:
        """SI units in one unit of a column of positions, by default its own column.

        Raises:
            ValueError: a unit of something else.
        """
        # a scale belongs to the coordinate's own column, and to set points in its unit
        scale = self.scale if unit in (None, self.unit) else 1.0
        unit = unit or self.unit
        if unit == "counts":
            return float(self.count or np.nan)
        if unit is None:
            return scale
        return scale * convert(unit, self.si_unit)

    def velocity_factor(self, unit: str | None = None) -> float:
        """SI units in one unit of a column of velocities, by default that of its own column."""
        unit = unit or (self.velocity.unit if self.velocity else None)
        if unit is None:
            return self.factor()
        counts, _, per = unit.partition("/")
        if counts == "counts" and self.count and per in TIME:
            return self.count / TIME[per]
        return convert(unit, f"{self.si_unit}/s")

    def coordinate(self) -> Coordinate:
        """The coordinate as records have it."""
        unit = self.unit and ColumnUnit(self.unit, self.factor() / self.scale)
        return Coordinate(self.name, self.kind, self.count, self.si_unit, unit or None)


class InputColumn(NamedTuple):
    """The column of an input of records: `value = factor * (column - offset)`.

    Attributes:
        input: the input.
        column: name or number.
        factor: units of the input in one unit of the column.
        offset: reading of the column where the input is 0.
        ends: range that values are clipped to, in units of the input.
    """

    input: Input
    column: ColumnKey
    factor: float
    offset: float
    ends: tuple[float, float] = (-np.inf, np.inf)


class InputCard(Declaration):
    """An input: `value = sign * scale * (column - offset)`; the other keys are those of `Input`.

    Attributes:
        column: name or number; it may be left out of inputs that a controller computes.
        scale: units of `value` in one unit of the column.
        sign: 1 or -1.
        offset: reading of the column where the input is 0.
        hold: if it is `unknown`, `fit` finds it, also where neither this key nor the system says
            one; elsewhere it is then that of the model, or `zero-order`.
        delay: time from a logged sample to its effect [s], or `unknown`: `fit` finds it, also
            where there is no such key.
        clip: whether values beyond `limits` are taken for these, as of a command that was logged
            before its amplifier limited it.
        assumed: keys of this table that nothing in the logs says; the check reminds of them.
    """

    name: Name
    column: ColumnKey | None = None
    unit: Text
    scale: Scale = 1.0
    sign: Literal[1, -1] = 1
    offset: Amount = 0.0
    hold: Hold = "zero-order"
    limits: Limits | None = None
    delay: Delay | Literal["unknown"] = 0.0
    clip: bool = False
    assumed: tuple[Literal["unit", "scale"], ...] = ()

    @model_validator(mode="after")
    def _check_keys(self) -> "InputCard":
        _require_assumed(self, self.assumed)
        if self.clip and self.limits is None:
            raise ValueError("`clip` without `limits`; give both")
        return self

    def input_columns(self) -> list[InputColumn]:
        """Its column; none where it has none."""
        if self.column is None:
            return []
        ends = self.limits if self.clip and self.limits else (-np.inf, np.inf)
        factor = self.sign * self.scale
        return [InputColumn(self.input(), self.column, factor, self.offset, ends)]

    def input(self) -> Input:
        """The input as records have it."""
        delay = None if self.delay == "unknown" else self.delay
        hold = self.hold if "hold" in self.model_fields_set else None
        is_declared = delay is not None and "delay" in self.model_fields_set
        own = self.model_dump(exclude={"column", "scale", "sign", "offset", "clip", "assumed"})
        own |= {"hold": hold, "delay": delay, "is_delay_declared": is_declared}
        return Input(**own)


class SetPointCard(Declaration):
    """The column of a set point.

    Attributes:
        column: name or number.
        unit: unit of the column, by default that of the coordinate's own column.
    """

    column: ColumnKey
    unit: str | None = None


class PDLoopCard(Declaration):
    """The loop by which a controller computes an input; the other keys are those of `PDLoop`.

    Gains that are left out are found, `ki` of the kind `pid` only.

    Attributes:
        position: the column of the set point, which has the sign and the zero of the coordinate's
            own column.
        velocity: the column of the set point of the velocity; without it that is 0.
        feedforward: the column of what is added, read as the input's own: its sign, scale, offset.
    """

    input: Name
    coordinate: Name
    position: SetPointCard
    velocity: SetPointCard | None = None
    feedforward: ColumnKey | None = None
    kp: Gain | None = None
    kd: Gain | None = None
    ki: Gain | None = None
    velocity_filter: float = Field(default=0.0, ge=0, le=1e3)
    delay: StrictInt = Field(default=0, ge=0, le=MOST_DELAY)

    @field_validator("position", "velocity", mode="before")
    @classmethod
    def _expand_column(cls, content: object) -> object:
        # "q_desired" is short for { column = "q_desired" }
        return {"column": content} if isinstance(content, str | int) else content

    def loop(self, *, has_integral: bool) -> PDLoop:
        """The loop as records have it.

        Args:
            has_integral: whether the controller has integrals, whose gains may be missing.
        """
        has_feedforward = self.feedforward is not None
        own = self.model_dump() | {
            "position": f"{self.coordinate}_setpoint",
            "velocity": f"{self.coordinate}_velocity_setpoint" if self.velocity else "",
            "feedforward": f"{self.input}_feedforward" if has_feedforward else "",
            "ki": self.ki if has_integral else 0.0,
        }
        return PDLoop(**own)


class ControllerCard(Declaration):
    """The controller that was in the loop.

    Attributes:
        kind: `pd`: proportional and derivative feedback to set points; `pid`: also the integral of
            deviations.
        loops: one for each input that it computes.
    """

    kind: Literal["pd", "pid"]
    loops: list[PDLoopCard] = Field(min_length=1)

    @model_validator(mode="after")
    def _check_integrals(self) -> "ControllerCard":
        for k, loop in enumerate(self.loops):
            if self.kind == "pd" and loop.ki is not None:
                raise ValueError(f'loops.{k}.ki: an integral is of kind = "pid"')
        return self


class TimeCard(Declaration):
    """The time column and the treatment of irregular times.

    Attributes:
        column: name or number.
        unit: s, ms, us or ns.
        tolerance: largest |interval - dt| that is accepted as jitter, as a share of dt.
        irregular: beyond it, `refuse` the record, `resample` it onto a grid, or `keep` the
            samples as they are.
        assumed: keys of this table that nothing in the logs says; the check reminds of them.
    """

    column: ColumnKey
    unit: Literal["s", "ms", "us", "ns"] = "s"
    tolerance: float = Field(default=JITTER, ge=0, le=1e3)
    irregular: Literal["refuse", "resample", "keep"] = "refuse"
    assumed: tuple[Literal["unit"], ...] = ()

    @model_validator(mode="after")
    def _check_assumed(self) -> "TimeCard":
        _require_assumed(self, self.assumed)
        return self

    def factor(self) -> float:
        """Seconds in one unit of the column."""
        return TIME[self.unit]


class FileCard(Declaration):
    """Entry of a card for a record: a file, or a range of its rows.

    Attributes:
        file: path below the card's folder, or a pattern (`train/*.csv`); no `..` and no `**`.
        name: name of the record; the file's name without ending by default.
        cell: number, from 1 on, of the element of the cell or struct arrays of a MAT file that is
            the record; without it each element that has the columns is a record.
        record: name of the group of an HDF5 file, or number of the episode of a LeRobot file, that
            is the record; without it each that has the columns is a record.
        rows: first row and the row after the last, counted from 0 after any header.
        seconds: instead of rows, the times at which the record begins and before which it ends,
            from the file's first timestamp on [s], as logged: before it is put on a grid.
        k_bar: end of the transient as a row of the record, instead of the detected one.
        groups: conditions of the record: `{ payload = "1kg" }`.
        join: other files of the record, by the labels of their tables `[join.LABEL]`.
    """

    file: str
    name: Name | None = None
    cell: StrictInt | None = Field(default=None, ge=1, le=10**9)
    record: Name | None = None
    rows: Rows | None = None
    seconds: Seconds | None = None
    k_bar: Row | None = None
    groups: dict[Name, Name] = Field(default_factory=dict)
    join: dict[Name, str] = Field(default_factory=dict)

    @field_validator("join")
    @classmethod
    def _require_files(cls, join: dict[str, str]) -> dict[str, str]:
        return {label: cls._require_below_folder(file) for label, file in join.items()}

    @field_validator("file")
    @classmethod
    def _require_below_folder(cls, file: str) -> str:
        path = PureWindowsPath(file)  # knows the separators of every system
        if not path.parts or path.drive or path.root or ".." in path.parts:
            raise ValueError("a path below the card's folder, without '..'")
        if "**" in file:
            raise ValueError("a pattern without '**'; name every folder")
        if any(len(part.encode(errors="replace")) > _LONGEST_PART for part in path.parts):
            raise ValueError(f"a file name of more than {_LONGEST_PART} bytes")
        return file

    @model_validator(mode="after")
    def _check_ranges(self) -> "FileCard":
        if self.rows is not None and self.seconds is not None:
            raise ValueError(f"`rows` and `seconds` of '{self.file}'; give one of them")
        if self.cell is not None and self.record is not None:
            raise ValueError(f"`cell` and `record` of '{self.file}'; give one of them")
        if self.join and (self.cell is not None or self.record is not None):
            raise ValueError(f"`join` of a part of '{self.file}'; only whole files are joined")
        return self

    @property
    def part(self) -> str:
        """Suffix that distinguishes records of one file: `[3]`, `_0-900`, `_0.5-3s`."""
        label = self.cell if self.record is None else self.record
        cell = "" if label is None else f"[{label}]"
        if self.rows is not None:
            return f"{cell}_{self.rows[0]}-{self.rows[1]}"
        return cell + ("" if self.seconds is None else "_{:g}-{:g}s".format(*self.seconds))


class FormatCard(Declaration):
    """Layout of text files.

    Attributes:
        header: whether the first row names the columns; by default it does unless it holds
            nothing but numbers. Or the row, from 1 on, that names them.
        delimiter: the mark between columns, a blank for any number of blanks; found by default.
        decimal: the mark before the decimals of numbers, `.` or `,`; found by default.
        encoding: encoding of the text, as Python names it; found by default.
        columns: required number of columns, None for any.
        damaged_rows: what happens to rows that are no samples, as lines that a serial link broke,
            and headers that are repeated: `refuse` the file, or `skip` them.
    """

    header: StrictBool | Annotated[StrictInt, Field(ge=1, le=10**6)] | None = None
    delimiter: str | None = None
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    columns: StrictInt | None = Field(default=None, ge=1, le=_MOST_COLUMNS)
    damaged_rows: Literal["refuse", "skip"] = "refuse"

    @field_validator("delimiter")
    @classmethod
    def _check_delimiter(cls, mark: str | None) -> str | None:
        if mark is not None and (len(mark) != 1 or mark not in "\t !$%&*,/:;<=>?@^_|~"):
            raise ValueError("one mark, e.g. ';', ',', '|' or a tab")
        return mark

    @field_validator("encoding")
    @classmethod
    def _check_encoding(cls, name: str | None) -> str | None:
        try:
            if name is not None:
                "1".encode(name)
        except (LookupError, ValueError):
            raise ValueError(f"no encoding '{name}'; utf-8, utf-16, latin-1, cp1252, ...") from None
        return name


class JoinCard(Declaration):
    """Files that have more columns of the records, one for each record.

    Attributes:
        column: their column of times, name or number; without it, row belongs to row.
        unit: unit of these times: s, ms, us or ns.
        starts_together: whether they begin at the same instant as the records' own files, for
            clocks that have nothing else in common.
        format: layout of text files.
        assumed: keys of this table that nothing in the logs says; the check reminds of them.
    """

    column: ColumnKey | None = None
    unit: Literal["s", "ms", "us", "ns"] = "s"
    starts_together: StrictBool = False
    format: FormatCard = FormatCard()
    assumed: tuple[Literal["unit", "starts_together"], ...] = ()

    @model_validator(mode="after")
    def _check_assumed(self) -> "JoinCard":
        _require_assumed(self, self.assumed)
        if self.column is None and self.model_fields_set & {"unit", "starts_together"}:
            raise ValueError("`unit` or `starts_together` without `column`; give the times' column")
        return self


class Card(Declaration):
    """The data card.

    Attributes:
        name: name of the data set.
        description: a sentence for people.
        dt: nominal sampling period [s]; the median interval of all records where it is left out.
        splits: files of `train`, `validation` and `test`; without any, all files beside the card
            that can be read are records of no split.
        optional_splits: splits whose files may all be absent.
        format: layout of text files.
        time: the time column; without it samples are taken to be `dt` apart.
        coordinates: at least one.
        inputs: any number.
        join: files with more columns of the records, by a label.
        assumed: keys of the top level that nothing in the logs says; the check reminds of them.
        controller: the controller that was in the loop, if it is to be simulated.
    """

    name: Text
    description: Sentence = ""
    dt: float | None = Field(default=None, ge=SHORTEST_DT, le=LONGEST_DT)
    splits: dict[SplitName, list[FileCard]] = Field(default_factory=dict)
    optional_splits: list[SplitName] = Field(default_factory=list)
    format: FormatCard = FormatCard()
    time: TimeCard | None = None
    coordinates: list[CoordinateCard] = Field(min_length=1)
    inputs: list[InputCard] = Field(default_factory=list)
    join: dict[Name, JoinCard] = Field(default_factory=dict)
    assumed: tuple[Literal["dt"], ...] = ()
    controller: ControllerCard | None = None

    @field_validator("splits", mode="before")
    @classmethod
    def _expand_paths(cls, splits: object) -> object:
        # "train/*.csv" is short for { file = "train/*.csv" }
        if not isinstance(splits, dict):
            return splits
        return {
            split: [{"file": f} if isinstance(f, str) else f for f in files]
            if isinstance(files, list)
            else files
            for split, files in splits.items()
        }

    @model_validator(mode="after")
    def _check_controller(self) -> "Card":
        computed = self._loops()
        without = [i.name for i in self.inputs if i.column is None]
        for k, own in enumerate(self.inputs):
            if own.column is None and own.name not in computed:
                raise ValueError(
                    f"inputs.{k}.column: missing; a column of '{own.name}', or a loop under "
                    "[controller] that computes it"
                )
        if without and len(without) < len(computed):
            raise ValueError(
                f"no column of the input '{without[0]}', which the controller computes, and some "
                "of others; give the columns of all of them, or of none"
            )
        if self.controller is None:
            return self
        controller = self._controller()
        assert controller is not None
        controller.require_loops([c.coordinate() for c in self.coordinates], "controller.loops")
        for own in self.inputs:
            if own.name not in computed:
                continue
            loop = computed[own.name]
            if own.delay != 0:
                raise ValueError(
                    f"`delay` of the input '{own.name}', which the controller computes; leave it "
                    "out, or give whole samples as `delay` of its loop"
                )
            gains = loop.loop(has_integral=self.controller.kind == "pid")
            missing = [gain for gain in gains.gains if getattr(gains, gain) is None]
            if own.column is None and missing:
                raise ValueError(
                    f"no {missing[0]} in the loop of '{own.name}', and no "
                    "column of this input, from which a gain is found; give one of both"
                )
            if loop.delay and own.hold == "first-order":
                raise ValueError(
                    f"`delay` of the loop of '{own.name}', which computes all the time; it counts "
                    'samples: declare hold = "zero-order" of this input, or leave it out'
                )
        holds = {i.hold for i in self.inputs if i.name in computed}
        if len(holds) > 1:
            raise ValueError(
                f"`hold` of the inputs that the controller computes: {', '.join(sorted(holds))}; "
                "one for all: zero-order where it computes at every sample, else first-order"
            )
        self.input_columns()  # units that fit
        return self

    @model_validator(mode="after")
    def _check_names(self) -> "Card":
        _require_assumed(self, self.assumed)
        _ = self.channels(1.0).plant  # all names differ, those of the logs and of the system
        return self

    @model_validator(mode="after")
    def _check_labels(self) -> "Card":
        files = {label for entries in self.splits.values() for e in entries for label in e.join}
        if missing := files - {*self.join}:
            raise ValueError(f"a file joins '{min(missing)}'; add a table [join.{min(missing)}]")
        if unused := {*self.join} - files:
            label = min(unused)
            raise ValueError(
                f"no file of [splits] joins '{label}'; "
                f'{{ file = "...", join = {{ {label} = "..." }} }}'
            )
        return self

    @property
    def columns(self) -> list[ColumnKey]:
        """All columns that the card names, by name or number."""
        velocities = [c.velocity.column for c in self.coordinates if c.velocity is not None]
        times = [] if self.time is None else [self.time.column]
        positions = [key for c in self.coordinates for key in (c.column, c.sine) if key is not None]
        inputs = [i.column for i in (*self.input_columns(), *self.output_columns())]
        return [*positions, *inputs, *velocities, *times]

    def input_columns(self) -> list[InputColumn]:
        """The columns of the inputs of records; set points, where a controller computes inputs.

        Raises:
            ValueError: a unit of a set point that does not fit its coordinate.
        """
        computed, columns = self._loops(), []
        coordinates = {c.name: c for c in self.coordinates}
        for own in self.inputs:
            if own.name not in computed:
                columns += own.input_columns()
                continue
            card = computed[own.name]
            loop, coordinate = card.loop(has_integral=False), coordinates[card.coordinate]
            # set points act as the input that is computed from them
            hold = "zero-order" if own.hold in ("zero-order", "unknown") else "first-order"

            def set_point(name: str, unit: str, hold: Hold = hold) -> Input:
                return Input(name, unit, hold, is_delay_declared=True)

            factor = coordinate.factor(card.position.unit)
            columns.append(
                InputColumn(
                    set_point(loop.position, coordinate.si_unit),
                    card.position.column,
                    coordinate.sign * factor,
                    coordinate.offset * coordinate.factor() / factor,
                )
            )
            if card.velocity is not None:
                factor = coordinate.velocity_factor(card.velocity.unit)
                columns.append(
                    InputColumn(
                        set_point(loop.velocity, f"{coordinate.si_unit}/s"),
                        card.velocity.column,
                        coordinate.sign * factor,
                        0.0,
                    )
                )
            if card.feedforward is not None:
                columns.append(
                    InputColumn(
                        set_point(loop.feedforward, own.unit),
                        card.feedforward,
                        own.sign * own.scale,
                        own.offset,
                    )
                )
        return columns

    def output_columns(self) -> list[InputColumn]:
        """The columns of what a controller computed, one for each loop; none without."""
        own = {i.name: i for i in self.inputs}
        return [column for name in self._loops() for column in own[name].input_columns()]

    def _loops(self) -> dict[str, PDLoopCard]:
        """The loops of the controller by their inputs."""
        return {loop.input: loop for loop in self.controller.loops} if self.controller else {}

    def _controller(self) -> PDController | None:
        """The controller as records have it."""
        if self.controller is None:
            return None
        return PDController(
            tuple(i.input() for i in self.inputs),
            tuple(
                loop.loop(has_integral=self.controller.kind == "pid")
                for loop in self.controller.loops
            ),
        )

    def channels(self, dt: float) -> Channels:
        """Coordinates and inputs as records have them, at a sampling period [s]."""
        return Channels(
            tuple(c.coordinate() for c in self.coordinates),
            tuple(i.input for i in self.input_columns()),
            dt,
            self._controller(),
        )
