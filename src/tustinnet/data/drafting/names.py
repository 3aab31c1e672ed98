"""Words and units in the name of a column, English and German, and what they say about it."""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from tustinnet.channels import Kind
from tustinnet.data.units import ANGLE, LENGTH

Quantity = Literal[
    "time", "counter", "position", "velocity", "acceleration", "voltage", "duty", "control",
    "torque", "force", "current", "pressure", "error", "flag", "other",
]  # fmt: skip
Qualifier = Literal["command", "measured", "filtered", "model"]

INPUTS: tuple[Quantity, ...] = (
    "voltage", "duty", "control", "torque", "force", "current", "pressure",
)  # fmt: skip

_UMLAUTS = str.maketrans(
    {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue"}
)
_GREEK = str.maketrans(
    {"φ": "phi", "ϕ": "phi", "θ": "theta", "ϑ": "theta", "ψ": "psi", "ω": "omega", "α": "alpha",
     "β": "beta", "γ": "gamma", "τ": "tau", "Δ": "delta", "ẋ": "xdot", "\u0307": "dot"}
)  # fmt: skip
_BRACKETS = re.compile(r"[\[({<]([^\[\](){}<>]*)[\])}>]")
_BEHIND_STROKE = re.compile(r"^([^/]+?)\s*/\s*([^/]+)$")  # `phi / deg`, as DIN 1313 has it
_IN = re.compile(r"(?i)^(.+?)[\s_,]+in[\s_]+(\S+)$")  # `Winkel in Grad`

# units by their spelling in lower case; a unit's quantity follows from its table
_POSITION = {
    **{unit: unit for unit in (*ANGLE, *LENGTH)},
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("degree", "degrees", "grad", "grd", "°"), "deg"),
    **dict.fromkeys(("revs", "turns", "turn", "umdr", "umdrehungen", "revolutions"), "rev"),
    **dict.fromkeys(
        ("cnt", "cnts", "count", "counts", "tick", "ticks", "pulses", "inc", "incs", "ink",
         "inkr", "inkremente", "increments", "impulse", "steps", "lsb"), "counts"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    "\N{MICRO SIGN}m": "um", "\N{GREEK SMALL LETTER MU}m": "um",
}  # fmt: skip
_PER_SECOND = (
    "/s",
    "/sec",
    "_s",
    "_sec",
    "_per_s",
    "_per_sec",
    "_per_second",
    "ps",
    "*s^-1",
    "s-1",
)
_VELOCITY = {
    **{f"{name}{per}": f"{unit}/s" for name, unit in _POSITION.items() for per in _PER_SECOND},
    **dict.fromkeys(
        ("rpm", "1/min", "u/min", "min^-1", "min-1", "rev/min", "r/min", "rev_min", "u_min",
         "upm", "1_min"), "rpm"),
    **dict.fromkeys(("km/h", "kmh", "kph"), "km/h"),
    **dict.fromkeys(("rps", "hz_rev"), "rev/s"),
    "rads": "rad/s", "mps": "m/s", "dps": "deg/s",
}  # fmt: skip
_SQUARED = ("/s^2", "/s2", "/s/s", "/s**2", "_s2", "_per_s2", "ps2", "*s^-2")
_ACCELERATION = {
    **{f"{name}{per}": f"{unit}/s^2" for name, unit in _POSITION.items() for per in _SQUARED},
    "g": "g", "mg": "mg",
}  # fmt: skip
_INPUT_UNITS: dict[str, tuple[str, Quantity]] = {
    **dict.fromkeys(("v", "volt", "volts"), ("V", "voltage")), "mv": ("mV", "voltage"),
    **dict.fromkeys(("a", "amp", "amps", "ampere"), ("A", "current")), "ma": ("mA", "current"),
    **dict.fromkeys(("pct", "percent", "%", "prozent"), ("%", "duty")),
    **dict.fromkeys(("n", "newton", "newtons"), ("N", "force")), "kn": ("kN", "force"),
    **dict.fromkeys(("nm", "n*m", "n_m", "n m", "newtonmeter"), ("N m", "torque")),
    **dict.fromkeys(("mnm", "mn*m", "mn m"), ("mN m", "torque")),
    **dict.fromkeys(("ncm", "n*cm"), ("N cm", "torque")),
    "bar": ("bar", "pressure"), "pa": ("Pa", "pressure"), "psi": ("psi", "pressure"),
}  # fmt: skip
_TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek", "sekunden"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds", "millisekunden"), "ms"),
    **dict.fromkeys(("us", "usec", "micros", "microseconds", "mikrosekunden", "µs", "μs"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanos", "nanoseconds", "nanosekunden"), "ns"),
}
_OTHER_UNITS = {"degc", "°c", "c", "k", "hz", "w", "kg", "g/s", "l/min", "celsius", "db", "lux"}
_NO_UNITS = {"", "-", "1", "none", "au", "a.u", "bit", "raw"}

# words by what they mean; the weight is lower for words that also mean something else
_STRONG: dict[Quantity, str] = {
    "time": "time times zeit timestamp stamp clock millis micros uptime zeitstempel elapsed",
    "counter": "index idx frame seq sequence row zeile nr episode iteration iter sample samples "
    "task lfd",
    "position": "pos position positions angle angles winkel enc encoder encoders theta phi psi "
    "lage weg hub drehwinkel auslenkung deflection displacement height hoehe pitch roll yaw "
    "stellung poti potentiometer pot resolver geber drehgeber qpos elongation stroke azimuth "
    "elevation",
    "velocity": "vel velocity velocities speed omega gyro tacho tachometer dot qdot "
    "geschwindigkeit geschw drehzahl winkelgeschwindigkeit qvel rate punkt drehrate spd",
    "acceleration": "acc accel acceleration beschleunigung ddot qddot qacc accelerometer beschl",
    "voltage": "voltage spannung volt volts motorspannung ankerspannung",
    "duty": "pwm duty dutycycle tastgrad throttle gas",
    "control": "control input eingang stellgroesse stellwert stellsignal action ctrl actuation "
    "stell aktion",
    "torque": "torque torques tau moment drehmoment effort efforts motormoment trq",
    "force": "force forces kraft thrust schub antriebskraft",
    "current": "current currents strom motorstrom iq ankerstrom",
    "pressure": "pressure druck",
    "error": "error err fehler regelabweichung schleppfehler deviation regelfehler",
    "flag": "status flag flags enable enabled ena mode modus fault alarm valid limit endschalter "
    "freigabe button taster bit done ready trigger trig estop switch homed zustand armed",
    "other": "temp temperature temperatur bat batterie vbus vbat ubat vcc vdd cpu noise "
    "battery fric friction reibung humidity rssi checksum crc supply versorgung latency",
}
_WEAK: dict[Quantity, str] = {
    "time": "t sec secs ts date datetime datum uhrzeit clk",
    "counter": "k step n id count tick cycle zyklus",
    "position": "q x y z s alpha beta gamma distance abstand dist delta joint gelenk pole pendulum "
    "pendel cart wagen laser sensor arm link beam ball disc scheibe th ang observation obs state",
    "velocity": "w v n qd xd xp rpm",
    "acceleration": "a imu",
    "voltage": "u v",
    "control": "u in motor drive actuator antrieb aktor prop propeller ventil valve servo",
    "torque": "m",
    "force": "f",
    "current": "i",
    "pressure": "p",
    "error": "e",
    "flag": "en on state",
}
_QUALIFIERS: dict[Qualifier, str] = {
    "command": "cmd command commanded setpoint sp target desired des ref reference soll sollwert "
    "vorgabe goal con fuehrungsgroesse request req set demand planned commands",
    "measured": "meas measured act actual ist istwert mess messwert fb feedback raw roh m sensor",
    "filtered": "filt filtered filter smooth smoothed est estimated gefiltert lpf lp kf kalman",
    "model": "sim simulated model predicted pred",
}
_ANGULAR = {
    "angle",
    "angles",
    "winkel",
    "theta",
    "phi",
    "psi",
    "alpha",
    "beta",
    "gamma",
    "pitch",
    "roll",
    "yaw",
    "drehwinkel",
    "th",
    "ang",
    "pole",
    "pendulum",
    "pendel",
    "joint",
    "gelenk",
    "shoulder",
    "elbow",
    "wrist",
    "hip",
    "knee",
    "schulter",
    "ellbogen",
    "encoder",
    "enc",
    "disc",
    "scheibe",
    "link",
    "drehgeber",
    "resolver",
    "azimuth",
    "elevation",
    "omega",
    "gyro",
    "tacho",
    "drehzahl",
    "rpm",
    "winkelgeschwindigkeit",
    "wheel",
    "rad_",
    "rotor",
    "torque",
    "tau",
    "moment",
    "drehmoment",
}
_LINEAR = {
    "x",
    "y",
    "z",
    "weg",
    "hub",
    "lage",
    "cart",
    "wagen",
    "trolley",
    "katze",
    "slide",
    "schlitten",
    "carriage",
    "displacement",
    "height",
    "hoehe",
    "distance",
    "dist",
    "abstand",
    "auslenkung",
    "deflection",
    "laser",
    "ball",
    "kugel",
    "piston",
    "kolben",
    "stroke",
    "linear",
    "force",
    "kraft",
}
_SYMBOL = re.compile(
    r"(?P<before>d{0,2})(?P<symbol>theta|phi|psi|alpha|beta|gamma|th|q|x|y|z|s|pos|angle|ang)"
    r"(?P<behind>ddot|dot|pp|p|dd|d|punkt)?"
)
_CONTAINERS = {
    "states",
    "state",
    "joint",
    "joints",
    "observation",
    "msg",
    "data",
    "value",
    "log",
    "logs",
}
_WITHIN: dict[Quantity, set[str]] = {q: set(words.split()) for q, words in _STRONG.items()}
_PERHAPS: dict[Quantity, set[str]] = {q: set(words.split()) for q, words in _WEAK.items()}
_MARKS: dict[Qualifier, set[str]] = {q: set(words.split()) for q, words in _QUALIFIERS.items()}
_PURE = set().union(
    *(_WITHIN[q] for q in ("time", "velocity", "acceleration", *INPUTS, "error")),
    *_MARKS.values(),
    [
        "pos",
        "position",
        "positions",
        "angle",
        "angles",
        "winkel",
        "lage",
        "enc",
        "encoder",
        "u",
        "i",
        "f",
        "m",
        "w",
        "v",
        "n",
        "rpm",
    ],
)  # words that say which quantity, but not of what


@dataclass(frozen=True)
class NameReading:
    """The meaning of a column's name as far as its words say it.

    Attributes:
        words: its words in lower case, numbers included.
        unit: the unit in it as cards spell it, empty without one.
        in_brackets: whether the unit stands apart, as in `angle [deg]`.
        quantities: weight of each quantity that its words or its unit speak for.
        word: the word that speaks for each quantity.
        qualifier: whether it is a command, a measured or a filtered value, None if unsaid.
        kind: angular or linear, None if unsaid.
        object: the words that say of what it is the quantity.
    """

    words: tuple[str, ...]
    unit: str
    in_brackets: bool
    quantities: dict[Quantity, float]
    word: dict[Quantity, str]
    qualifier: Qualifier | None
    kind: Kind | None
    object: frozenset[str]

    @property
    def quantity(self) -> Quantity | None:
        """The quantity with the largest weight, None where no word says one."""
        return max(self.quantities, key=lambda q: self.quantities[q], default=None)


def read_name(name: str, file_unit: str = "") -> NameReading:
    """Reads the words and the unit in a column's name; a unit that the file says decides."""
    known = _look_up(file_unit) if file_unit else None
    if known is not None and known[0]:
        reading = read_name(f"{name} [{file_unit}]")
        if reading.unit == known[0]:
            return reading
    plain = unicodedata.normalize("NFC", name).translate(_GREEK).translate(_UMLAUTS)
    plain, unit, unit_quantity, in_brackets = _take_unit(plain)
    words = _split_words(plain)
    if not in_brackets:
        words, unit, unit_quantity = _take_ending(words)
    quantities, word = _read_quantities(words)
    if {"action", "actions"} & {*words}:  # of robot learning: what was commanded
        quantities["control"], word["control"] = 8.0, "action"
    if unit_quantity is not None:
        surely = in_brackets or unit_quantity in _SURE_UNITS
        quantities[unit_quantity] = max(quantities.get(unit_quantity, 0.0), 6.0 if surely else 5.0)
        word[unit_quantity] = f"[{unit}]"
    qualifiers: list[Qualifier] = [mark for mark, texts in _MARKS.items() if texts & {*words}]
    qualifier = qualifiers[0] if qualifiers else None
    if qualifier == "measured" and not _MARKS["measured"] - {"m", "sensor"} & {*words}:
        qualifier = None if words[-1:] != ["m"] or len(words) < 2 else qualifier
    return NameReading(
        tuple(words), unit, in_brackets, quantities, word, qualifier, _kind(words, unit),
        _object(words),
    )  # fmt: skip


_SURE_UNITS = ("velocity", "acceleration")


def _read_quantities(
    words: Sequence[str],
) -> tuple[dict[Quantity, float], dict[Quantity, str]]:
    """The weight of each quantity that words speak for, and the word that does so."""
    quantities: dict[Quantity, float] = {}
    word: dict[Quantity, str] = {}

    def add(quantity: Quantity, weight: float, because: str) -> None:
        if weight > quantities.get(quantity, 0.0):
            quantities[quantity], word[quantity] = weight, because

    for text in words:
        for table, weight in ((_WITHIN, 3.0), (_PERHAPS, 1.0)):
            for quantity, texts in table.items():
                if text in texts:
                    add(quantity, weight, text)
        symbol = _SYMBOL.fullmatch(text)
        if symbol and (symbol["before"] or symbol["behind"]):
            order = len(symbol["before"]) or _ORDERS.get(symbol["behind"], 1)
            surely = symbol["before"] or symbol["behind"] in ("dot", "ddot", "punkt")
            add("velocity" if order == 1 else "acceleration", 3.5 if surely else 1.5, text)
    if quantities.get("velocity", 0.0) >= 3 and quantities.get("position") == 3.0:
        quantities["velocity"] += 0.5  # `theta_dot`, `angle rate`: it is of that position
    if {"d", "dt"} <= {*words} or (words[:1] == ["d"] and "position" in quantities):
        add("velocity", 3.5, "d/dt")
    if {("dot", "dot"), ("d", "dot")} & {*pairwise(words)}:
        add("acceleration", 4.0, "dot dot")
    if quantities.get("error", 0.0) >= 3:
        quantities["error"] += 5.0  # `position error [mm]` is an error
    return quantities, word


_ORDERS = {"ddot": 2, "pp": 2, "dd": 2}  # of derivatives, by endings of symbols


def _kind(words: Sequence[str], unit: str) -> Kind | None:
    base = unit.split("/")[0]
    if base in ANGLE or unit in ("rpm", "N m", "mN m", "N cm"):
        return "angular"
    if base in LENGTH or unit in ("km/h", "g", "N", "kN"):
        return "linear"
    symbols = {m["symbol"] for w in words if (m := _SYMBOL.fullmatch(w))}
    found = {*words} | symbols
    angular, linear = bool(found & _ANGULAR), bool(found & _LINEAR)
    # `cart`, `x` decide against `joint` and `encoder`, which both kinds have
    if linear and found & _ANGULAR <= {"joint", "encoder", "enc", "gelenk", "geber"}:
        return "linear"
    return "angular" if angular else "linear" if linear else None


def _object(words: Sequence[str]) -> frozenset[str]:
    """The words that say of what a column is the quantity: `theta` of `theta_dot_ref`."""
    symbols = [m["symbol"] if (m := _SYMBOL.fullmatch(w)) else w for w in words]
    return frozenset(w for w in symbols if w not in _PURE and w not in _CONTAINERS and w != "d")


def _look_up(text: str) -> tuple[str, Quantity | None] | None:
    """The unit that a text spells and its quantity (None for no unit at all); None if unknown."""
    spelled = text.strip().lower().replace("²", "^2").replace("·", "*").replace("°/", "deg/")
    spelled = spelled.replace("⁻¹", "^-1").replace("\N{MICRO SIGN}", "u").rstrip(".")
    compact = spelled.replace(" ", "")
    for candidate in (spelled, compact):
        if candidate in _NO_UNITS:
            return "", None
        if candidate in _POSITION:
            return _POSITION[candidate], "position"
        if candidate in _VELOCITY:
            return _VELOCITY[candidate], "velocity"
        if candidate in _ACCELERATION:
            return _ACCELERATION[candidate], "acceleration"
        if candidate in _INPUT_UNITS:
            return _INPUT_UNITS[candidate]
        if candidate in _TIME_UNITS:
            return _TIME_UNITS[candidate], "time"
        if candidate in _OTHER_UNITS:
            return candidate, "other"
    return None


def unit_quantity(text: str) -> tuple[str, Quantity | None] | None:
    """The unit that a text spells, as cards have it, and its quantity; None if unknown."""
    return _look_up(text)


def _take_unit(name: str) -> tuple[str, str, Quantity | None, bool]:
    """A name without a unit that stands apart, the unit, its quantity, whether there is one."""
    for match in _BRACKETS.finditer(name):
        unit = _look_up(match[1])
        if unit is not None and match[1].strip() and not match[1].strip().isdigit():
            return f"{name[: match.start()]} {name[match.end() :]}", *unit, True
    for pattern in (_BEHIND_STROKE, _IN):
        match = pattern.match(name.strip())
        if match and (unit := _look_up(match[2])) is not None and unit[1] is not None:
            return match[1], *unit, True
    return name, "", None, False


def _split_words(name: str) -> list[str]:
    """Words in lower case: `motorCnt 1` has motor, cnt and 1; `q1` has q and 1."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    spaced = re.sub(r"(?<=[^\W\d_])(?=\d)", "_", spaced)  # `q1`, but `s2` of `rad_s2` below
    return [word for word in re.split(r"[\W_]+", spaced.lower()) if word]


def _take_ending(words: list[str]) -> tuple[list[str], str, Quantity | None]:
    """Words without the unit at their end, the unit, its quantity: `_rad_s`, `_mm`, `_deg1`."""
    number = words[-1:] if words and words[-1].isdigit() else []
    body = words[: len(words) - len(number)]
    for length in (4, 3, 2, 1):
        if len(body) < length + (length == 1):
            continue
        before, ending = body[:-length], body[-length:]
        texts = ["_".join(ending)]
        if number == ["2"] and ending[-1] == "s":  # `m_s2`: the power was split off
            texts.insert(0, "_".join(ending) + "2")
        for text in texts:
            unit = _look_up(text)
            if unit is None or not unit[0] or text in _NO_UNITS or not before:
                continue
            if length == 1 and not _is_unit(text, before):
                continue
            rest = [] if text.endswith("2") and number == ["2"] else number
            return [*before, *rest], *unit
    return words, "", None


def _is_unit(ending: str, before: Sequence[str]) -> bool:
    """Whether a last word is a unit: one letter may be a name's, as in `u_a`, `q_m`, `enc_a`."""
    if ending in ("in", "grad", "inc", "turn", "steps", "step", "impulse", "raw", "bit", "hz"):
        return ending == "grad"
    if len(ending) > 1:
        return True
    last = before[-1]
    if (last, ending) in (("u", "v"), ("i", "a"), ("f", "n"), ("t", "s"), ("x", "m"), ("y", "m")):
        return True  # a symbol and the unit of its quantity
    if ending in ("k", "c", "g", "w", "s"):
        return ending == "s" and last in _WITHIN["time"] | _PERHAPS["time"]
    spoken = {q for q, texts in _WITHIN.items() if last in texts}
    spoken |= {q for q, texts in _PERHAPS.items() if last in texts}
    if ending == "m":
        return not spoken or ("position" in spoken and last not in ("q", "theta", "phi"))
    is_position = bool(spoken & {"position"}) and not spoken & {*INPUTS}
    if ending in "anv" and is_position and last not in ("motor", "drive"):
        return last not in _WITHIN["position"] and len(last) > 1
    return len(last) > 1
