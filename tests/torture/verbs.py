"""Every verb in this process: headers that were changed and sealed again, and odd arguments.

A verb may refuse in one line or do what it is asked. It never ends in a traceback, and it changes
no file that it was not told to write.
"""

import contextlib
import hashlib
import io
import itertools
import json
import os
import shutil
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any
from unittest import mock

import typer

import tustinnet as tn
from tustinnet.cli.init import FIGURE
from tustinnet.cli.main import app
from tustinnet.data.catalog import CARD_NAME
from tustinnet.data.readers import is_readable
from tustinnet.errors import InputError
from tustinnet.store.kept_system import CONFIG_VARIABLE

from . import oracle
from .mutations import change_header
from .report import Part

_SLOW = 60.0  # seconds that a verb may take on small records
_OUTPUTS = ("--out", "--figure", "--figures")
_COMPUTING = (
    "tustinnet.fits.in_folder.fit_task",
    "tustinnet.selection.jobs.fit_task",
    "tustinnet.selection.select.run_jobs",
    "tustinnet.systems.qube_servo2_twin.twin",
)
_COPY = "system.py"  # kept beside a model that is written
_DRAFTED = (CARD_NAME, FIGURE)  # into the folder of a fit, before it begins


class Fitting(BaseException):
    """A fit would begin; nothing is fitted here, where arguments are tried."""


@dataclass(frozen=True)
class Place:
    """The files that verbs are given.

    Attributes:
        root: the folder of all of them, watched for changes.
    """

    root: Path

    @property
    def out(self) -> Path:
        """Where verbs are told to write."""
        return self.root / "out"

    def model(self, name: str) -> Path:
        """One of the model files, see `prepare`."""
        return self.root / name / "model.safetensors"


MODELS = ("network", "grey", "committee", "bands", "grey-bands", "hybrid", "linear", "gru", "ode")


def prepare(material: Path, root: Path) -> Place:
    """Writes records and a model of every kind, some with bands, each in a folder."""
    place = Place(root)
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    os.environ[CONFIG_VARIABLE] = str(root.with_name("config"))
    shutil.copytree(material / "logs", root / "logs")
    for name in ("recipe.toml", "search.toml", "pendulum.py"):
        shutil.copy(material / name, root)
    sources = {
        "network": "run/model",
        "hybrid": "hybrid",
        "linear": "linear",
        "gru": "gru",
        "ode": "neural-ode",
    }
    for name, source in sources.items():
        place.model(name).parent.mkdir()
        shutil.copy(material / f"{source}.safetensors", place.model(name))
    logs, system = str(root / "logs"), str(root / "pendulum.py")
    made: list[list[object]] = [
        [
            "fit",
            logs,
            "--recipe",
            root / "search.toml",
            "--system",
            system,
            "--quiet",
            "--no-report",
            "--out",
            root / "grey",
        ],
    ]
    for arguments in made:
        code, _, err = call([str(a) for a in arguments])
        assert code == 0, err
    tn.save_committee([place.model("network"), place.model("linear")], place.model("committee"))
    validation = tn.load(logs).split("validation")
    for source, name, own in (("committee", "bands", None), ("grey", "grey-bands", system)):
        tn.calibrate(
            place.model(source), validation, place.model(name), start="derived-6", system=own
        )
    (root / "cwd").mkdir()
    (root / "bare").mkdir()  # records without a card
    for name in ("fall1.csv", "fall2.csv", "noise1.csv"):
        shutil.copy(root / "logs" / name, root / "bare")
    (root / "link.csv").symlink_to(root / "logs" / "fall1.csv")
    return place


def call(arguments: Sequence[str]) -> tuple[int, str, str]:
    """Exit code, output and messages of the command; 1 and the line of an `InputError`.

    Raises:
        Finding: it ended by any other exception, or NumPy warned.
    """
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(record=True) as warned,
    ):
        warnings.simplefilter("always")
        code = 0
        try:
            app(list(arguments))
        except InputError as error:
            code = 1
            err.write(f"error: {error}\n")
        except Fitting:
            pass
        except SystemExit as ended:
            code = int(ended.code or 0) if isinstance(ended.code, int | None) else 1
    noisy = [str(w.message) for w in warned if issubclass(w.category, RuntimeWarning)]
    oracle.require(not noisy, f"a warning: {noisy[:1]}")
    return code, out.getvalue(), err.getvalue()


def _files(root: Path) -> dict[Path, tuple[object, ...]]:
    """Every file below a folder, and what shows that it was written: its SHA-256, inode, time.

    Folders count, too, without what they hold.
    """
    found: dict[Path, tuple[object, ...]] = {}
    for folder, folders, names in os.walk(root):
        found |= {Path(folder, name): () for name in folders}
        for name in names:
            path = Path(folder, name)
            status = path.lstat()
            content = bytes(path.readlink()) if path.is_symlink() else path.read_bytes()
            digest = hashlib.sha256(content).digest()
            found[path] = (digest, status.st_ino, status.st_mtime_ns, status.st_mode)
    return found


def examine(place: Place, arguments: Sequence[str], named: Sequence[str]) -> tuple[str, str]:
    """What became of a command, see `oracle.judged`; what it wrote is removed.

    Args:
        place: the files.
        arguments: of the command.
        named: the paths of `arguments` that it is told to write.
    """
    before, begun, codes = _files(place.root), time.monotonic(), list[int]()

    def run() -> None:
        code, _, err = call(arguments)
        codes.append(code)
        if code == 1:
            lines = [line for line in err.splitlines() if line.startswith(("error: ", "Aborted"))]
            oracle.require(len(lines) == 1, f"{len(lines)} lines `error: ...` at exit code 1")
            oracle.require(lines[0].isprintable(), "a message with unprintable characters")
            oracle.require(len(lines[0]) <= 1510, "a message of more than 1500 characters")

    with contextlib.chdir(place.root / "cwd"):
        outcome, told = oracle.judged(run)
        allowed = [Path(name).resolve() for name in named if name]
    if outcome != "finding" and time.monotonic() - begun > _SLOW:
        outcome, told = "finding", f"took more than {_SLOW:.0f} s"
    after = _files(place.root)
    changed = [path for path, status in before.items() if after.get(path) != status]
    added = [path for path in after if path not in before]
    files = [path for path in added if not path.is_dir() or path.is_symlink()]
    expected = {path.parent / _COPY for path in allowed}.union(*(path.parents for path in allowed))
    stray = [
        p for p in added if p not in expected and not any(p.is_relative_to(a) for a in allowed)
    ]
    if changed:
        outcome, told = "finding", f"changed {changed[0].name}"
    elif stray:
        outcome, told = "finding", f"wrote {stray[0].relative_to(place.root)}"
    elif codes != [0] and any(path.name not in _DRAFTED for path in files):
        outcome, told = "finding", f"left {files[0].name} behind at exit code {codes}"
    elif any(p.parent == place.root / "logs" and is_readable(p) for p in files):
        outcome, told = "finding", f"wrote {files[0].name} among the records"
    for path in files:
        path.unlink()
    for path in sorted(set(added) - set(files), reverse=True):
        path.rmdir()
    return (outcome if codes != [1] or outcome == "finding" else "refused"), told


# --- headers that were changed and sealed again ---


def model_verbs(place: Place, model: Path, others: Sequence[Path]) -> list[list[object]]:
    """Every verb that reads a model file."""
    logs, out, other = place.root / "logs", place.out, others[0]
    system = ["--system", place.root / "pendulum.py"]
    is_grey = "grey" in str(model) or "hybrid" in str(model)
    own = system if is_grey else []
    return [
        ["show", model],
        ["show", model, "--json"],
        ["evaluate", model, logs, *own],
        ["evaluate", model, logs, "--band", "0.5", *own],
        ["evaluate", model, logs, "--ahead", "3", *own],
        ["simulate", model, logs, "--out", out, *own],
        ["simulate", model, logs, "--out", out, "--band", "0.6", "--whole-records", *own],
        ["evaluate", model, other, logs, *own],
        ["evaluate", model, logs, "--residuals", *own],
        ["export", model, "--to", "mat", "--out", out, *own],
        ["report", model, logs, "--out", out / "page.html", *own],
        ["fit", logs, "--from", model, "--out", out, *own],
        ["fit", logs, "--physics", model, "--out", out, *own],
    ]


class Headers:
    """Model files whose headers were changed and sealed again, through every verb.

    Args:
        place: the undamaged files.
        seed: of the campaign.
    """

    def __init__(self, place: Place, seed: int) -> None:
        self.place, self.seed, self.part = place, seed, Part("headers")

    def run(self, seconds: float, cases: int) -> Part:
        """Cases until the time is over or so many are done."""
        end, number = time.monotonic() + seconds, 0
        while number < cases and time.monotonic() < end:
            self.one(number)
            number += 1
        return self.part

    def one(self, number: int) -> None:
        """One file, through one verb."""
        random = Random(f"header {self.seed} {number}")
        source = self.place.model(random.choice(MODELS))
        content, told = change_header(source.read_bytes(), random)
        damaged = source.with_name("damaged.safetensors")
        damaged.write_bytes(content)
        others = [self.place.model(name) for name in ("network", "linear")]
        arguments = [str(a) for a in random.choice(model_verbs(self.place, damaged, others))]
        with nothing_is_fitted():
            outcome, words = examine(self.place, arguments, told_to_write(arguments))
        where = f"{arguments[0]} {source.parent.name} ({told})"
        self.part.count(
            outcome, words if outcome == "finding" else "", f"--header {number}, {where}"
        )
        if outcome == "finding":
            self.part.keep(content, source.parent.name)
        damaged.unlink()


# --- every verb, every option, values of every kind ---


def commands(place: Place) -> list[list[object]]:
    """Commands of every verb that do what they are asked, by what they cannot do without."""
    root, logs, out = place.root, place.root / "logs", place.out
    network, linear = place.model("network"), place.model("linear")
    return [
        ["demo", "--out", out],
        ["init", root / "bare"],
        ["inspect", logs],
        ["fit", logs, "--out", out, "--recipe", root / "recipe.toml"],
        ["fit", logs, "--out", out],
        ["fit", root / "bare", "--out", out],
        ["cross-validate", logs, "--out", out, "--recipe", root / "recipe.toml"],
        [
            "cross-validate",
            logs,
            "--records",
            "all",
            "--out",
            out,
            "--recipe",
            root / "recipe.toml",
        ],
        ["simulate", network, logs, "--out", out],
        ["evaluate", network, logs],
        ["evaluate", network, linear, logs],
        ["evaluate", network, logs, "--residuals"],
        ["export", network, "--to", "mat", "--out", out],
        [
            "control",
            network,
            "--at",
            "angle=0",
            "--limits",
            "torque=-1:1",
            "--starts",
            1,
            "--out",
            out,
        ],
        ["show", network],
        ["report", network, logs, "--out", out / "page.html"],
        ["reproduce", "--data", logs, "--out", out],
    ]


def untried_verbs(place: Place) -> set[str]:
    """The verbs of the command that `commands` lacks."""
    return set(_listed()) - {str(verb) for verb, *_ in commands(place)}


def _listed() -> dict[str, Any]:
    """The verbs of the command by name."""
    return typer.main.get_command(app).commands  # pyright: ignore[reportAttributeAccessIssue]


def told_to_write(arguments: Sequence[str]) -> list[str]:
    """The paths of a command that it is told to write; of `init` those in the folder of logs."""
    joined = [word.partition("=") for word in arguments]
    named = [value for option, _, value in joined if option in _OUTPUTS]
    named += [value for option, value in itertools.pairwise(arguments) if option in _OUTPUTS]
    if arguments[0] == "init":
        for log in (word for word in arguments[1:] if not word.startswith("--")):
            folder = log if os.path.isdir(log) else os.path.dirname(log)  # noqa: PTH112, PTH120
            named += [os.path.join(folder, name) for name in (CARD_NAME, FIGURE)]  # noqa: PTH118
    return named


def values(place: Place) -> list[str]:
    """Values of every kind: empty, numbers of all sizes, text, and paths to all kinds of things."""
    root = place.root
    paths = [
        root / "logs" / "fall1.csv",
        root / "logs" / "dataset.toml",
        root / "link.csv",
        root / "recipe.toml",
        root / "pendulum.py",
        place.model("network"),
        root / "logs" / ".." / "logs" / "fall1.csv",
        root / "logs",
        root,
        root / "none" / "none",
        root / "new.png",
        root / "new.html",
        root / "new.safetensors",
        root / "new.toml",
        "/dev/null",
        "/dev/full",
        "/proc/self/mem",
        "/",
    ]
    texts = [
        "",
        " ",
        ".",
        "..",
        "-",
        "--",
        "0",
        "1",
        "2",
        "-1",
        "0.5",
        "1e308",
        "1e-300",
        "nan",
        "inf",
        "-inf",
        "9" * 400,
        "x" * 5000,
        "x/" * 200,
        "\x1b[2J",
        "\udcff",
        "ä",
        "all",
        "train",
        "a=b",
        "a,b",
        "1,2",
        "[]",
        "{}",
        "file",
        "derived-6",
        "model-99999999",
        "derived-0",
        "*",
        "auto",
    ]
    return [*texts, *map(str, paths)]


def cases(place: Place) -> Iterator[list[str]]:
    """Every verb with each of its options at every value, and each of its arguments so."""
    listed = _listed()
    for plain in commands(place):
        base = [str(word) for word in plain]
        for parameter in listed[base[0]].params:
            if parameter.param_type_name == "option":
                yield from _with_option(base, parameter, place)
        for at in (i for i, word in enumerate(base) if i and not base[i - 1].startswith("--")):
            if not base[at].startswith("--"):
                for value in values(place):
                    yield [*base[:at], value, *base[at + 1 :]]


def _with_option(base: list[str], parameter: Any, place: Place) -> Iterator[list[str]]:
    """A command with an option at every value, instead of the one that it may have."""
    option = max(parameter.opts, key=len)
    if getattr(parameter, "is_flag", False):
        yield [*base, option]
        return
    at = base.index(option) if option in base else len(base)
    rest = base[:at] + base[at + 2 :]
    for value in values(place):
        if (option, value) != ("--cluster", "auto"):  # it would begin one
            yield [*rest, f"{option}={value}"]
        if option in _OUTPUTS:
            yield [*rest, f"{option}={value}", "--overwrite"]


class Interface:
    """Every verb with odd options and arguments.

    Args:
        place: the files.
        seed: of the campaign: the order of the cases.
    """

    def __init__(self, place: Place, seed: int) -> None:
        self.place, self.part = place, Part("verbs")
        self.cases = list(cases(place))
        Random(f"verbs {seed}").shuffle(self.cases)

    def run(self, seconds: float, cases: int) -> Part:
        """Cases until the time is over or so many are done; each is done once."""
        end = time.monotonic() + seconds
        for verb in untried_verbs(self.place):
            self.part.count("finding", f"{verb} is not tried", "--parts verbs")
        for number, arguments in enumerate(self.cases[:cases]):
            if time.monotonic() > end:
                left = len(self.cases) - number
                self.part.notes.append(f"{left} of {len(self.cases)} commands: no time left")
                break
            self.one(arguments)
        return self.part

    def one(self, arguments: list[str]) -> None:
        """One command."""
        with nothing_is_fitted():
            outcome, told = examine(self.place, arguments, told_to_write(arguments))
        short = json.dumps([word[:60] for word in arguments]).replace(str(self.place.root), "")
        self.part.count(outcome, told, short)


@contextlib.contextmanager
def nothing_is_fitted() -> Iterator[None]:
    """Within the context, fits end where they would begin."""

    def begin(*_: object, **__: object) -> None:
        raise Fitting

    with contextlib.ExitStack() as stack:
        for name in _COMPUTING:
            stack.enter_context(mock.patch(name, begin))
        yield
