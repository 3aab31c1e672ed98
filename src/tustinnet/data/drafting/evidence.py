"""Evidence on the roles of columns: points of their names, shapes and relations, which add up."""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.data.columns import NUMBERED
from tustinnet.data.drafting.names import INPUTS, NameReading, Quantity
from tustinnet.data.drafting.numbers import Numbers, is_decimal
from tustinnet.data.drafting.relations import (
    Pairs,
    Slopes,
    Table,
    find_alike,
    find_causes,
    find_copies,
    find_distances,
    find_followers,
    find_other_units,
    find_sums,
)
from tustinnet.data.drafting.vocabulary import AXES, CONTAINERS, QUALIFIERS, STRONG, WEAK
from tustinnet.data.units import ANGLE, LENGTH

Role = Literal[
    "time",
    "counter",
    "position",
    "velocity",
    "acceleration",
    "input",
    "set point",
    "constant",
    "other",
    "no numbers",
]
ROLES: tuple[Role, ...] = (
    "position",
    "velocity",
    "acceleration",
    "input",
    "set point",
    "other",
)
"""The roles among which an assignment chooses."""

_ROLE_OF: dict[Quantity, Role] = {
    **dict.fromkeys(INPUTS, "input"),
    "position": "position",
    "velocity": "velocity",
    "acceleration": "acceleration",
    "time": "other",
    "error": "other",
    "flag": "other",
    "counter": "other",
    "other": "other",
}
Stage = Literal["command", "torque", "current", "pressure"]
_STAGES: tuple[Stage, ...] = ("command", "torque", "current", "pressure")
_STAGE_OF: dict[Quantity, Stage] = {
    "torque": "torque",
    "force": "torque",
    "current": "current",
    "pressure": "pressure",
}
_MOTION: tuple[Quantity, ...] = ("position", "velocity")
_DRIVES: tuple[Quantity, ...] = ("torque", "force", "current")
# SI units in units of speeds, of angles and of lengths
ANGULAR_SPEEDS = {**{f"{u}/s": f for u, f in ANGLE.items()}, "rpm": 2 * np.pi / 60}
LINEAR_SPEEDS = {**{f"{u}/s": f for u, f in LENGTH.items()}, "km/h": 1 / 3.6}
FEWEST_JOINTS = 3  # of an arm with a tool
_MOTION_UNITS = {*ANGLE, *LENGTH, *ANGULAR_SPEEDS, *LINEAR_SPEEDS}


@dataclass(frozen=True)
class Weights:
    """Points of evidence and prices of assignments; a point is about a factor of e of belief.

    They were set by hand, in halves, on recorded machines, folders in which a user had seen a
    mistake, and one half of made-up laboratories; the other half only judged them.

    Attributes:
        letter: of a letter or word that has several meanings, as `u` or `motor`; a word or unit
            that has one counts as `read_name` weighs it, 3 to 8.
        against: for each role that a name does not say, where it says another one; twice where it
            says that by a word or unit that has one meaning.
        command: of a name that says a command, for a set point.
        derived: of a name that says a filtered or simulated value, for a column that is not used.
        later: less for an input for each stage of its drive before it, of which one is the input.
        held: of levels that are held, for an input, and three times against a motion.
        white: of steps as large as those of white noise, against a position.
        smooth: of small steps, for a position.
        wrap: of values that start again after a turn, for a position.
        count: of steps of one encoder count, for a position.
        derivative: at most, for a velocity whose integral is the change of a position.
        increment: less for one that is the change in a sample, as what a program adds up.
        per_sample: relative deviation from that.
        member: for a velocity that has the place of its position in a block.
        follow: at most, for a set point that a position follows one to one, and later, unless a
            name says a command.
        cause: at most, for an input whose past helps to foresee a position.
        back: share that counts against it where the position foresees the input.
        no_input: price of a machine that nothing drives; a quarter less where no name says an
            input.
        no_position: price of a machine without a motion.
        further_input: price of each further family of inputs.
        stage: price of two stages of one drive, as voltage and current, that are both inputs.
        copy: price of a second column of the same values.
        no_velocity: price of a position without a velocity, where others have one.
        alone: price of a velocity that is the slope of no position.
        useless: for leaving out what no card uses: a supply's voltage, a direction of a circle, a
            control error.
        no_slope: price of a velocity of a position of which it is not the slope.
        other_unit: less for a velocity whose factor the units in the names do not explain.
        same_units: for one whose factor is 1, where no unit is known.
        same_unit: relative deviation of a factor that they explain.
        no_follow: price of a set point that nothing follows; a third of it for a named command.
        near: a smaller margin is a question.
        near_of_used: the same of a position or an input: in first drafts of 58 folders 38 of 100
            were wrong below it, and 4 of 50 columns that they left out by less than `near`.
        slopes: shares of the variance that a slope explains: below the first it is none, below the
            second unclear.
        copies: shares of the variance from which on a column repeats another one, for the price
            of a copy, and for one and a half.
        circle: deviation of a radius, relative to it.
        small: control error in the last quarter of a record, by the size of what is controlled.
        clear_slope: points, from which on a column is the derivative of another one.
    """

    letter: float = 2.0
    against: float = 2.0
    command: float = 2.0
    derived: float = 2.5
    later: float = 0.5
    held: float = 2.0
    white: float = 5.0
    smooth: float = 1.0
    wrap: float = 4.0
    count: float = 1.0
    derivative: float = 6.0
    increment: float = 3.0
    per_sample: float = 0.01
    member: float = 1.0
    follow: float = 4.0
    cause: float = 5.0
    back: float = 0.6
    no_input: float = 4.0
    no_position: float = 12.0
    further_input: float = 2.5
    stage: float = 8.0
    copy: float = 4.0
    no_velocity: float = 1.5
    alone: float = 4.0
    useless: float = 8.0
    no_slope: float = 2.0
    other_unit: float = 1.0
    same_units: float = 1.0
    same_unit: float = 0.1
    no_follow: float = 3.0
    near: float = 2.0
    near_of_used: float = 5.0
    slopes: tuple[float, float] = (0.4, 0.8)
    copies: tuple[float, float] = (0.7, 0.9)
    circle: float = 0.03
    small: float = 0.5
    clear_slope: float = 3.0


WEIGHTS = Weights()


class Evidence(NamedTuple):
    """A reason for or against taking a column for something, its points, and it in words."""

    role: Role
    points: float
    sentence: str


def name_evidence(reading: NameReading) -> list[Evidence]:
    """Evidence in the words and the unit of a name."""
    w, is_command = WEIGHTS, reading.qualifier == "command"
    evidence: list[Evidence] = []
    named_roles: set[Role] = set()
    is_stated = bool(reading.stated(reading.quantities))
    for quantity, weight in reading.quantities.items():
        word, role = reading.word[quantity], _ROLE_OF[quantity]
        if (is_stated and (len(word) == 1 or word in CONTAINERS)) or word == "t":
            continue  # `acc_x` is no position x, `joint_torque` none of a joint; `T1` is no clock
        text = f"in {reading.unit} by its name" if word.startswith("[") else f"'{word}' in its name"
        if word == "[us]" and not reading.stated(q for q in reading.quantities if q != "time"):
            role, weight = "input", w.letter  # of pulses that drive a servo, as it is no clock
        named_roles.add(role)
        if is_command and role in ("position", "velocity", "acceleration"):
            role = "set point"
        evidence.append(Evidence(role, max(weight, w.letter), text))
    evidence += [
        Evidence(role, -w.against * (2 if is_stated else 1), "")
        for role in ROLES[:-1]
        if named_roles
        and role not in named_roles
        and not (is_command and role == "set point")
        # an acceleration may be commanded, as of a cart on a stepper
        and not (role == "input" and named_roles == {"acceleration"})
    ]
    if "input" in named_roles:
        evidence.append(Evidence("input", -w.later * _STAGES.index(stage_of(reading)), ""))
    if is_command:
        points = 0.25 * w.command if "input" in named_roles else w.command
        evidence += [
            Evidence("set point", points, "named a command"),
            Evidence("input", 0.5 * w.command, "named a command"),
            Evidence("position", -w.command, ""),
            Evidence("velocity", -2 * w.command, ""),
        ]
    elif reading.qualifier in ("filtered", "model"):
        evidence.append(Evidence("other", w.derived, f"named {reading.qualifier}"))
    elif reading.qualifier == "measured" and "input" in named_roles:
        evidence.append(Evidence("other", 0.5 * w.derived, "a measured value of an input"))
    return evidence


def shape_evidence(numbers: Numbers, reading: NameReading) -> list[Evidence]:
    """Evidence in the numbers of a column alone."""
    w = WEIGHTS
    may_rest = numbers.binary or reading.stated(["voltage", "pressure"])
    if may_rest and numbers.is_nearly_constant:
        return [Evidence("other", 2 * w.useless, "nearly constant")]
    if numbers.binary and reading.stated(["flag"]):
        return [Evidence("other", 2 * w.useless, "a flag by its name")]
    if numbers.binary:
        return [
            Evidence("other", 0.75 * w.held, "only two values"),
            Evidence("input", 0.25 * w.held, "only two values"),
            *(Evidence(role, -2 * w.held, "") for role in ("position", "velocity")),
        ]
    if numbers.levels:
        return [
            Evidence("input", w.held, "held levels"),
            Evidence("set point", 0.5 * w.held, "held levels"),
            *(Evidence(role, -3 * w.held, "") for role in ("position", "velocity", "acceleration")),
        ]
    evidence: list[Evidence] = []
    if numbers.wrap is not None:
        evidence.append(Evidence("position", w.wrap, f"it wraps at {numbers.wrap:.6g}"))
    elif numbers.is_white:
        evidence += [
            Evidence("position", -w.white, ""),
            Evidence("set point", -0.5 * w.white, ""),
            Evidence("velocity", -0.25 * w.white, ""),
            Evidence("other", 0.25 * w.white, "only noise"),
        ]
    if numbers.smooth:
        count = numbers.count
        if count is not None and (numbers.whole or not is_decimal(count)):
            text = f"steps of {count:.6g}, as of a sensor's counts"
            evidence.append(Evidence("position", w.count, text))
        evidence.append(Evidence("position", w.smooth, "smooth"))
        evidence.append(Evidence("velocity", 0.3 * w.smooth, "smooth"))
    return evidence


class EvidenceTable:
    """All evidence on the columns of some records.

    Attributes:
        names: the columns that move, in the order of the files.
        readings: the meaning of their names.
        own: evidence in the name and the shape of each.
        points: the sum of this evidence, by column and role.
        slope: points for column j as the derivative of column i, [i, j].
        follow: points for column i as the set point of column j, [i, j].
        cause: net points for column i as what moves column j, [i, j].
        repeats: prices of using two columns of the same values.
        is_copy: whether two columns differ by rounding only, apart from unit and zero.
        signal: the first of the columns that are copies of one another, for each.
        sums: columns of which two add up to the third.
        is_on_circle: whether two are the directions of a point on a circle.
        is_nameless: whether a name says nothing at all.
        is_silent: whether a name says nothing where another one states a motion.
        blocks: of columns without names, positions and their velocities, see `find_blocks`.
        family: the family of each column; those of one family have one role.
        stage: the stage of a drive of which a column speaks.
        joint: the words that say at which of several positions a column acts.
    """

    def __init__(
        self,
        readings: Mapping[str, NameReading],
        numbers: Mapping[str, Numbers],
        records: Sequence[Table],
        slopes: Slopes,
    ) -> None:
        self.names = tuple(readings)
        self.readings = [*readings.values()]
        self.own = [
            [*name_evidence(r), *shape_evidence(numbers[n], r)] for n, r in readings.items()
        ]
        self.is_nameless = [not r.quantities for r in self.readings]
        # where a name states a motion, one that says nothing is no position
        is_stated = any(r.stated(["position", "velocity"]) for r in self.readings)
        self.is_silent = [
            is_stated and bool(r.name) and r.quantity in (None, "time") for r in self.readings
        ]
        for own, is_silent in zip(self.own, self.is_silent, strict=True):
            own += [Evidence("position", -WEIGHTS.against, "")] if is_silent else []
        factors = find_copies(records, [numbers[n].count or 0.0 for n in readings])
        # a torque that a controller makes of a position is none in another unit
        are_motion, are_drives = (
            np.array([bool(r.stated(some)) and not r.stated(others) for r in self.readings])
            for some, others in itertools.permutations((_MOTION, _DRIVES))
        )
        is_law = np.outer(are_motion, are_drives)
        factors = np.where(is_law | is_law.T, 0.0, factors)
        # a set point is not what follows it
        kinds = [(r.quantity, r.qualifier == "command") for r in self.readings]
        are_alike = [[a == b and a[0] in ("position", "velocity") for a in kinds] for b in kinds]
        # one sensor in volts and in millimetres
        words = [(r.words if "position" in r.quantities else (), r.unit) for r in self.readings]
        are_one = [[bool(a[0]) and a[0] == b[0] and a[1] != b[1] for a in words] for b in words]
        is_other_unit = (find_other_units(records) & are_alike) | (find_alike(records) & are_one)
        self.is_copy = (factors != 0) | is_other_unit
        self.slope = _slope_points(slopes, self.readings)
        self.slope[factors != 0] = -WEIGHTS.no_slope  # what repeats a column is not its rate
        self.blocks = find_blocks(self.names, self.slope, factors != 0)
        for one, other in itertools.permutations(self.blocks, 2):
            for joint in one.keys() & other.keys():
                self.slope[one[joint], other[joint]] += WEIGHTS.member
        distances = find_distances(records)
        are_apart = (self.slope >= WEIGHTS.clear_slope) | distances
        sums = find_sums(records)
        self.sums = [(i, j, k) for i, j, k in sums if k is not None]
        for three in self.sums:
            are_apart[np.ix_(three, three)] = True
        self.family = find_families(self.readings, are_apart, self._find_multiples(factors))
        for block in self.blocks:
            for column in block.values():
                self.family[column] = min(block.values())
        family = np.array(self.family)
        self.is_copy &= family[:, None] != family
        self.signal = np.argmax(self.is_copy | np.eye(len(family), dtype=bool), axis=1)
        fit, late = find_followers(records)
        self.repeats = _repeat_prices(records, fit)
        self.follow = self._follow_points(fit, late)
        push = np.minimum(WEIGHTS.cause, 2 * np.log10(1 + 100 * find_causes(records)))
        self.cause = push - WEIGHTS.back * push.T
        self.is_on_circle = np.zeros_like(self.is_copy)
        self._add_circles(records)
        self._add_quaternions(records)
        self._add_errors(records, sums)
        self._add_copies()
        self._add_distances(distances)
        self._add_nameless(records)
        self._add_commanded_rates()
        self._add_tool()
        self.points = self._sum_points()
        self.stage = [stage_of(r) for r in self.readings]
        self.joint = find_joints(self.readings)

    def _sum_points(self) -> Float[np.ndarray, "c r"]:
        """The points of the evidence so far, by column and role."""
        return np.array(
            [[sum(e.points for e in own if e.role == role) for role in ROLES] for own in self.own]
        )

    def says(self, column: int, role: Role) -> bool:
        """Whether the name of a column speaks of a role, most of all."""
        quantity = self.readings[column].quantity
        return quantity is not None and _ROLE_OF[quantity] == role

    def contradicting(self, column: int, role: Role) -> Role | None:
        """Another role that the name of a column states, None where it states none."""
        reading = self.readings[column]
        quantity = reading.quantity
        if quantity is None or reading.qualifier == "command" or not reading.stated([quantity]):
            return None
        stated = _ROLE_OF[quantity]
        return stated if stated != role else None

    @np.errstate(all="ignore")  # of columns that stand still in the samples that are compared
    def _add_circles(self, records: Sequence[Table]) -> None:
        """Evidence on two directions of a point on a circle.

        Alone they are no inputs, and beside the angle they are not used.
        """
        w, named = WEIGHTS, {k for k in range(len(self.names)) if self.says(k, "position")}
        for i, j in itertools.permutations(range(len(self.names)), 2):
            points = [(r[:, i], r[:, j]) for r in records]
            radii = [np.hypot(x, y) for x, y in points]
            if any(
                np.std(radius) > min(w.circle * radius.mean(), 0.3 * np.std(x), 0.3 * np.std(y))
                for radius, (x, y) in zip(radii, points, strict=True)
            ):
                continue
            if {i, j} == named:
                self.is_on_circle[i, j] = True
                self.own[i].append(Evidence("input", -w.useless, ""))
            angle = np.concatenate([np.unwrap(np.arctan2(y, x)) for x, y in points])
            for k in range(len(self.names)):
                values = np.concatenate([r[:, k] for r in records])
                units = [unit * np.std(values) / np.std(angle) for unit in ANGLE.values()]
                is_angle = min(abs(ratio - 1) for ratio in units) < 2 * w.circle
                is_alike = abs(np.corrcoef(values, angle)[0, 1]) > 1 - w.circle / 6
                if k not in (i, j) and is_angle and is_alike:
                    text = f"of a circle on which '{self.names[k]}' is the angle"
                    self.own[i].append(Evidence("other", w.useless, text))

    def _add_quaternions(self, records: Sequence[Table]) -> None:
        """Evidence against four neighbours whose squares add up to 1: they are no coordinates."""
        squares = np.concatenate(records) ** 2
        moves = np.ptp(squares, axis=0) > 0
        for first in range(len(self.names) - 3):
            four = range(first, first + 4)
            deviation = np.abs(squares[:, four].sum(axis=1) - 1).max()
            if moves[four].all() and deviation < WEIGHTS.circle / 3:
                for i in four:
                    text = "of a quaternion, as four squares add up to 1"
                    self.own[i].append(Evidence("other", WEIGHTS.useless, text))

    def _add_errors(
        self, records: Sequence[Table], sums: Sequence[tuple[int, int, int | None]]
    ) -> None:
        """Evidence on control errors, on what is controlled, and on its set point.

        Of two columns the error is the one that is named so, or that a controller makes small. Of
        three positions, of which none is named a set point, the last is one too many.
        """
        w, readings = WEIGHTS, enumerate(self.readings)
        ends = np.concatenate([record[3 * len(record) // 4 :] for record in records])
        size = np.sqrt(np.mean(ends**2, axis=0))
        is_plain = [self.says(i, "position") and not r.qualifier for i, r in readings]
        for error, controlled, goal in [*sums, *((j, i, k) for i, j, k in sums)]:
            three = [i for i in (error, controlled, goal) if i is not None]
            if any({"sin", "cos"} & {*self.readings[i].words} for i in three):
                continue  # a pendulum near the top has a sine that its angle adds up with
            are_inputs = [self.says(i, "input") for i in three]
            if goal is not None and are_inputs[2] and any(are_inputs[:2]):
                text = f"a part of '{self.names[goal]}'"
                self.own[error].append(Evidence("other", w.useless, text))
                continue
            if len(three) > 2 and all(is_plain[i] for i in three):
                if error < controlled:
                    text = "the sum or difference of two other positions"
                    self.own[max(three)].append(Evidence("other", w.derived, text))
                continue
            names = [self.readings[i].quantity for i in (error, controlled)]
            is_small = size[error] <= w.small * size[controlled]
            is_error = names[1] != "error" and (names[0] == "error" or is_small)
            if not is_error or self.is_silent[controlled]:
                continue
            text = f"'{self.names[controlled]}' and it add up to a set point: a control error"
            self.own[error].append(Evidence("other", w.useless, text))
            text = f"less than its set point by '{self.names[error]}'"
            role: Role = "velocity" if self.says(controlled, "velocity") else "position"
            self.own[controlled].append(Evidence(role, w.useless, text))
            if goal is not None:
                text = f"the sum of '{self.names[controlled]}' and its error"
                self.own[goal].append(Evidence("set point", w.useless, text))

    def _add_copies(self) -> None:
        """Evidence against all copies but one: in a unit of motion, and of most points."""
        most = self._sum_points().max(axis=1)
        is_foreign = [reading.unit not in _MOTION_UNITS for reading in self.readings]
        ranks = [(is_foreign[i], -most[i], i) for i in range(len(self.names))]
        for i, j in np.argwhere(self.is_copy).tolist():
            if ranks[i] < ranks[j]:
                text = f"'{self.names[i]}' in another unit, or from another zero"
                self.own[j].append(Evidence("other", WEIGHTS.derived, text))

    def _add_distances(self, distances: Bool[np.ndarray, "c c"]) -> None:
        """Evidence against the distances that positions have travelled, as an odometer has them."""
        for i, j in np.argwhere(distances).tolist():
            if self.says(i, "position") and self.says(j, "position"):
                text = f"the distance that '{self.names[i]}' has travelled"
                self.own[j].append(Evidence("other", WEIGHTS.useless, text))
                self.own[j].append(Evidence("position", -WEIGHTS.useless, ""))

    def _add_tool(self) -> None:
        """Evidence against x, y and z beside numbered joints with velocities: of their tool."""
        w, family = WEIGHTS, np.array(self.family)
        is_joint = np.array([self.says(i, "position") for i in range(len(self.names))])
        is_joint &= (self.slope >= w.clear_slope).any(axis=1)
        counts = np.bincount(family[is_joint])
        if counts.max(initial=0) < FEWEST_JOINTS:
            return
        for i in np.flatnonzero(family != counts.argmax()).tolist():
            reading = self.readings[i]
            is_axis = reading.word.get("position", "") in ("x", "y", "z")
            if is_axis and not reading.stated(reading.quantities):
                text = "of the tool, as numbered joints are there"
                self.own[i].append(Evidence("other", w.useless, text))

    def _find_multiples(self, factors: Pairs) -> Bool[np.ndarray, "c c"]:
        """Marks inputs that repeat one another, by the factors of columns that do.

        Joints may move as one, and no torque repeats another one, but for pairs of motors.
        """
        is_input = np.array([self.says(i, "input") for i in range(len(self.names))])
        plain = [[w for w in r.words if not w.isdigit()] for r in self.readings]
        is_other = np.array([[a != b for a in plain] for b in plain])
        is_scaled = np.abs(np.abs(factors) - 1) > WEIGHTS.circle
        return (factors != 0) & is_input & (is_scaled | is_other)

    def _add_nameless(self, records: Sequence[Table]) -> None:
        """Evidence against numbers without a name as inputs, by the records in which they rest."""
        rests = np.mean([np.ptp(record, axis=0) == 0 for record in records], axis=0)
        for i, is_nameless in enumerate(self.is_nameless):
            if is_nameless:
                self.own[i].append(Evidence("input", -WEIGHTS.held * float(rests[i]), ""))

    def _add_commanded_rates(self) -> None:
        """Evidence on derivatives of set points, which drive nothing."""
        commands = np.array([r.qualifier == "command" for r in self.readings])
        columns = range(len(self.names))
        rates = [self.says(j, "velocity") or self.says(j, "acceleration") for j in columns]
        is_rate = np.outer(commands, commands & rates) & (self.slope >= WEIGHTS.clear_slope)
        for i, j in np.argwhere(is_rate).tolist():
            text = f"slope of the set point '{self.names[i]}'"
            self.own[j].append(Evidence("other", WEIGHTS.useless, text))

    def _follow_points(self, fit: Pairs, late: Pairs) -> Pairs:
        w = WEIGHTS
        points = np.minimum(w.follow, 1.5 - 0.5 * np.log(1.001 - np.minimum(fit, 1.0)))
        commands = np.array([[r.qualifier == "command"] for r in self.readings])
        is_one = (fit >= 0.5) & (commands | (late > 0))  # else it is a copy
        return np.where(is_one, points, np.where(commands, -w.no_follow / 3, -w.no_follow))


@np.errstate(all="ignore")  # constants repeat nothing
def _repeat_prices(records: Sequence[Table], fit: Pairs) -> Pairs:
    """Prices of using two columns that are proportional, or of which one follows the other."""
    some, most = WEIGHTS.copies
    share = np.atleast_2d(np.corrcoef(np.concatenate(records).T)) ** 2
    same = np.where(share > most, share, np.maximum(fit, fit.T))
    return WEIGHTS.copy * np.where(same > most, 1.5, np.where(same > some, 1.0, 0.0))


def _slope_points(slopes: Slopes, readings: Sequence[NameReading]) -> Pairs:
    """Points for each column j as the derivative of each column i, [i, j]."""
    w = WEIGHTS
    fit = np.where(slopes.correlation > 0, slopes.correlation, 0.0) ** 2
    points = np.minimum(w.derivative, 1.5 - np.log(1.001 - fit))
    is_per_sample = np.abs(slopes.factor / slopes.dt - 1) < w.per_sample
    points = np.where(is_per_sample & (slopes.dt != 1), points - w.increment, points)
    least, clear = w.slopes
    points = np.where(fit < clear, -0.25 * w.no_slope, points)
    points = np.where(fit < least, -w.no_slope, points)
    units = [reading.unit for reading in readings]
    sizes = np.array([(ANGLE | LENGTH).get(unit, np.nan) for unit in units])
    rates = np.array([(ANGULAR_SPEEDS | LINEAR_SPEEDS).get(unit, np.nan) for unit in units])
    deviation = np.abs(slopes.factor * rates / sizes[:, None] - 1)  # NaN where a unit is not known
    points -= w.other_unit * (deviation > w.same_unit)
    is_unknown = np.isnan(deviation)
    points += w.same_units * (is_unknown & (np.abs(slopes.factor - 1) < w.same_unit))
    is_rate = [not unit or "/" in unit or unit in ("rpm", "g") for unit in units]
    kinds = [reading.kind for reading in readings]
    is_other = [[None not in (a, b) and a != b for b in kinds] for a in kinds]
    points = np.where(is_rate, points, -w.no_slope)
    # too few samples to say anything
    points = np.where(slopes.factor == 0, -0.25 * w.no_slope, points)
    points = np.where(is_other, -2 * w.no_slope, points)  # none, whatever else speaks for it
    np.fill_diagonal(points, -w.no_slope)
    return points


def find_families(
    readings: Sequence[NameReading],
    are_apart: Bool[np.ndarray, "c c"],
    is_multiple: Bool[np.ndarray, "c c"],
) -> list[int]:
    """The number of the family of each column: names that differ by numbers, axes or members only.

    Args:
        readings: the meaning of the names.
        are_apart: which columns are derivatives or sums of one another. A family of such columns
            is none, and none but of positions is one to which all columns belong.
        is_multiple: which inputs repeat one another; the later one is of no family.
    """
    known = {w for words in (STRONG, WEAK, QUALIFIERS) for ws in words.values() for w in ws}
    known |= {"cos", "sin"}
    # short words are symbols, unless they say of which joint a position is, as `FL`
    places = {w for r in readings if r.quantity == "position" for w in r.object}
    groups: dict[tuple[str, ...], list[int]] = {}
    for i, reading in enumerate(readings):
        plain = [w for w in reading.words if not w.isdigit() and w not in ("x", "y", "z")]
        plain = [w for w in plain if w not in AXES] or plain
        which = [w for w in plain[1:] if len(w) == 1 and w in places]  # `motor angle A`
        named = [w for w in plain if w not in which]
        marks = [w for w in named if w in known or (len(w) <= 2 and w not in places)]
        # one letter may also say which, as in `current A` beside `current B`
        unit = reading.unit if reading.in_brackets or len(reading.unit) > 1 else ""
        qualifier = reading.qualifier or ""  # which a text beside the logs may say
        key = (*(marks or plain), "#" * len(which), unit, qualifier) if plain else (str(i),)
        groups.setdefault(key, []).append(i)
    families = [*range(len(readings))]
    for members in groups.values():
        are_all = len(members) == len(readings)
        is_motion = all(readings[i].quantity == "position" for i in members)
        if (is_motion or not are_all) and not are_apart[np.ix_(members, members)].any():
            for k, i in enumerate(members):
                if not is_multiple[i, members[:k]].any():
                    families[i] = members[0]
    return families


def find_blocks(
    names: Sequence[str], slope: Float[np.ndarray, "c c"], is_copy: Bool[np.ndarray, "c c"]
) -> list[dict[int, int]]:
    """Columns without names that come as a block of positions and one of their velocities.

    A third one is of as many columns, where there are no others.

    Two velocities have to be seen as many columns behind (or before) their positions, and more than
    at any other distance: joints that move as one have the velocities of one another. What is
    between two of a block, as a joint that hardly moves, belongs to it.

    Args:
        names: the columns.
        slope: points for each column as the derivative of each, [i, j].
        is_copy: which columns repeat one another; of blocks none repeats its partner.

    Returns:
        Of each block the places of its columns, by joint; none where there are none.
    """
    numbers = [n.removeprefix(NUMBERED) if n.startswith(NUMBERED) else "" for n in names]
    place = {int(number): i for i, number in enumerate(numbers) if number.isdecimal()}
    strong = [
        (a, b)
        for a, i in place.items()
        for b, j in place.items()
        if slope[i, j] >= WEIGHTS.derivative / 2
    ]
    counts = [*Counter(b - a for a, b in strong).most_common(2), (0, 1), (0, 1)]
    (distance, most), (_, next_most) = counts[:2]
    if most == next_most:
        return []
    pairs = [(a, b) for a, b in strong if b - a == distance]
    positions = {a for a, _ in pairs} - {b for _, b in pairs}  # of three blocks the first
    joints = range(min(positions), max(positions) + 1)
    partners = [(place[k], place[k + distance]) for k in joints if {k, k + distance} <= {*place}]
    if {b for _, b in pairs} & {*joints} or any(is_copy[pair] for pair in partners):
        return []
    blocks = [{k: place[k + d] for k in joints if k + d in place} for d in (0, distance)]
    others = sorted(place.keys() - {k + d for k in joints for d in (0, distance)})
    if len(others) == len(joints) == others[-1] - others[0] + 1:  # as torques behind both
        blocks.append({k: place[n] for k, n in zip(joints, others, strict=True)})
    return blocks


def find_joints(readings: Sequence[NameReading]) -> list[frozenset[str] | None]:
    """The words by which each name says at which of several joints it is, None without any.

    Those of a position: its number where no other has it, else all that it is the position of, as
    `FL0`.
    """
    numbers = [frozenset(w for w in r.object if w.isdigit()) for r in readings]
    positions = [i for i, r in enumerate(readings) if r.quantity == "position"]
    objects: dict[frozenset[str], set[frozenset[str]]] = {}
    for i in positions:
        objects.setdefault(numbers[i], set()).add(readings[i].object)
    places = {
        n if n and len(joints) == 1 else joint for n, joints in objects.items() for joint in joints
    }

    def find_joint(reading: NameReading) -> frozenset[str] | None:
        """The place of a position with most of the words of a name."""
        return max((p for p in places if p and p <= reading.object), key=len, default=None)

    return [find_joint(reading) for reading in readings]


def stage_of(reading: NameReading) -> Stage:
    """The stage of a drive of which a name speaks; a command or a voltage moves first."""
    strongest = max(INPUTS, key=lambda q: reading.quantities.get(q, 0.0))
    return "command" if reading.qualifier == "command" else _STAGE_OF.get(strongest, "command")
