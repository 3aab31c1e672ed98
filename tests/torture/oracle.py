"""What must hold, whatever was done: each rule is written once.

A `Finding` says which one does not.
"""

import csv
import json
import math
import re
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import safetensors.numpy

import tustinnet
import tustinnet as tn
from tustinnet.channels import HasChannels
from tustinnet.store.files import PART
from tustinnet.store.run_folder import SCORES
from tustinnet.store.sealed import KEY, SEAL

from .mutations import parts

_SOURCE = Path(tustinnet.__file__).parent
_LONGEST = 1500  # characters of a message
# in texts: seconds, the last column of tables, the digest of a model whose header has seconds
_SECONDS = re.compile(rb"\d+(\.\d+)? s\b|\| \d+ \|$|<td>[0-9a-f]{12}</td>", re.MULTILINE)
# what differs from run to run
_OF_THE_RUN = {SEAL, "versions", "seconds", "seconds_by_part", "train_seconds", "time"}


class Finding(Exception):
    """Something that must not be."""


class Skipped(Exception):
    """This machine does not allow what a fault needs."""


def require(holds: bool, told: str) -> None:
    """Raises a `Finding` where a rule is broken."""
    if not holds:
        raise Finding(told)


def judged(action: Callable[[], object]) -> tuple[str, str]:
    """What became of an action: `accepted`, `refused` or `finding`, and the words for it.

    Refused is only what raises an `InputError` of one printable line that is not too long.
    """
    try:
        action()
    except tn.InputError as error:
        text = str(error)
        if len(text) > _LONGEST:
            return "finding", f"a message of more than {_LONGEST} characters"
        if not text.isprintable():
            return "finding", "a message with unprintable characters"
        return "refused", text
    except Finding as finding:
        return "finding", str(finding)
    except (KeyboardInterrupt, Skipped):
        raise
    except BaseException as error:
        words = re.sub(r"['\"\[].*|\d+", "..", str(error)[:80], flags=re.DOTALL)
        return "finding", f"{type(error).__name__} {_place(error)}: {words!r}"
    return "accepted", ""


def _place(error: BaseException) -> str:
    """The innermost function of the package that an error passed."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if _is_own(f.filename)]
    if not frames:
        return "outside the package"
    return f"in {Path(frames[-1].filename).relative_to(_SOURCE).as_posix()}:{frames[-1].name}"


def _is_own(file: str) -> bool:
    return Path(file).is_relative_to(_SOURCE)


# --- records ---


def require_sound(e: tn.Experiment, folder: Path) -> None:
    """A record that was accepted: finite, in order, from inside the folder, with a safe name."""
    arrays = [a for a in (e.t, e.q, e.u, e.v) if a is not None]
    require(all(np.isfinite(a).all() for a in arrays), "accepted numbers that are not finite")
    require(bool((np.diff(e.t) > 0).all()), "accepted times that are not increasing")
    require(math.isfinite(e.dt) and e.dt > 0, "accepted a period that is none")
    names = [e.name, *(c.name for c in e.coordinates), *(i.name for i in e.inputs)]
    require(all(map(str.isprintable, names)), "accepted a name with unprintable characters")
    written = (folder / f"{e.name}.csv").resolve()
    require(written.parent == folder.resolve(), "accepted a name that leads out of the folder")
    source = (folder / (e.source or "")).resolve()
    require(source.is_relative_to(folder.resolve()), "read a file outside the folder")


def require_same_samples(found: tn.Experiment, clean: tn.Experiment) -> None:
    """The samples of the undamaged file, bit for bit."""
    for what in ("t", "q", "u"):
        same = np.array_equal(getattr(found, what), getattr(clean, what))
        require(same, "silently other samples than the undamaged file's")


def require_same_size(found: tn.Experiment, clean: tn.Experiment) -> None:
    """As many samples and channels as the undamaged file, or it is told that there are not."""
    same = found.q.shape == clean.q.shape and found.u.shape == clean.u.shape
    told = tn.inspect_experiment(found).suspicious or found.notes != clean.notes
    require(same or bool(told), "silently another number of samples")


def require_as_csv_reads(e: tn.Experiment, content: bytes) -> None:
    """The samples that Python's own reader finds in a file with the columns time, angle, torque."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")  # in which 0xA0 is a space
    lines = re.split("\r\n|\r|\n", text)
    kept = [line for line in lines if line.strip() and not line.startswith("#")]
    require(len(kept) == len(e) + 1, "another number of samples than the file has lines")
    names, *rows = csv.reader(kept)
    columns = [name.strip() for name in names]
    try:
        table = {
            name: np.array([_number(row[columns.index(name)]) for row in rows])
            for name in ("time", "angle", "torque")
        }
    except (ValueError, IndexError, csv.Error):
        raise Finding("accepted cells that Python does not read as numbers") from None
    turns = (e.q[:, 0] - np.deg2rad(table["angle"])) / (2 * np.pi)
    require(np.array_equal(e.t, table["time"]), "other times than Python reads")
    require(np.array_equal(e.u[:, 0], table["torque"]), "other inputs than Python reads")
    size = 1 + np.abs(table["angle"]).max()
    whole = bool((np.abs(turns - np.round(turns)) < 1e-9 * size).all())
    require(whole, "other positions than Python reads")


def _number(cell: str) -> float:
    """A cell as Python reads it; exponents of Fortran are read, too."""
    return float(re.sub("[dD]", "e", cell))


# --- files of the package ---


def require_same_model(found: HasChannels, clean: HasChannels) -> None:
    """The arrays of the undamaged model, bit for bit, and a step that is finite."""
    here, there = _leaves(found), _leaves(clean)
    require(here == there, "accepted a model with other arrays")
    assert isinstance(found, tn.Model)
    x, u = jnp.full(found.state_size, 0.1), jnp.zeros(found.channels.n_u)
    require(bool(np.isfinite(found.step(x, u)).all()), "accepted a model whose step is not finite")


def _leaves(tree: Any) -> list[bytes]:
    return [np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree)]


def require_same_state(found: Any, clean: Any, content: bytes) -> None:
    """The state of the undamaged checkpoint, and the progress that the file itself tells."""
    (state, (progress,)), (clean_state, (clean_progress,)) = found, clean
    plain = [
        s._replace(weights=s.weights._replace(key=jax.random.key_data(s.weights.key)))
        for s in (state, clean_state)
    ]
    require(_leaves(plain[0]) == _leaves(plain[1]), "accepted a checkpoint with other arrays")
    header = json.loads((parts(content) or ({}, b""))[0]["__metadata__"][KEY])
    told, kinds = asdict(progress), asdict(clean_progress)
    (says,) = header["progress"]
    says |= {"epochs": tuple(says["epochs"])}
    same = all(says.get(key, told[key]) == told[key] for key in told)
    require(same or "nan" in str(told), "a checkpoint whose progress is not as it says")
    sound = all(type(told[key]) is type(kinds[key]) for key in kinds)
    require(sound, "accepted a checkpoint with progress of other types")


def require_finite(content: Any) -> None:
    """No number in a declaration that is not finite."""
    if isinstance(content, dict):
        content = list(content.values())
    if isinstance(content, list | tuple):
        for part in content:
            require_finite(part)
    elif isinstance(content, float):
        require(math.isfinite(content), "accepted a number that is not finite")


def require_log(text: str, clean: str | None = None) -> None:
    """Every epoch once and in order, or those of another log."""
    epochs = epochs_of(text)
    require(len(set(epochs)) == len(epochs), "a log with doubled epochs")
    if clean is not None:
        require(epochs == epochs_of(clean), "a log with missing or misplaced epochs")


def epochs_of(log: str) -> list[tuple[str, int]]:
    """Stage and epoch of every line."""
    try:
        lines = [json.loads(line) for line in log.splitlines()]
        return [(line["stage"], line["epoch"]) for line in lines]
    except (ValueError, TypeError, KeyError):
        raise Finding("a log with a line that is none") from None


# --- run folders ---


def require_same_run(place: Path, clean: Path) -> None:
    """The same files; models and logs the same, apart from times and versions."""
    require(not list(leftovers(place)), "temporary files are left")
    here, there = (sorted(_files(p)) for p in (place, clean))
    require(here == there, f"other files: {sorted(set(here) ^ set(there))[:4]}")
    for name in there:
        found, expected = place / name, clean / name
        if name.endswith("checkpoint.safetensors"):
            continue  # has seconds among its arrays
        if name.endswith(".safetensors"):
            same = _plain_model(found) == _plain_model(expected)
            require(same, f"{name} differs")
        elif name.endswith("log.jsonl"):
            if b'"epoch"' in expected.read_bytes():
                require_log(found.read_text(), expected.read_text())
            require(_plain_log(found) == _plain_log(expected), f"{name} differs")
        else:
            require(_plain(place, name) == _plain(clean, name), f"{name} differs")


def require_old_or_new(place: Path, *known: Path) -> None:
    """Every file of a killed command is that of one of the known folders, or grows.

    Logs grow line by line, trained weights epoch by epoch, and jobs are judged again.
    """
    for name in _files(place):
        if name.endswith((".jsonl", ".safetensors", PART)):
            continue
        versions = [_plain(folder, name) for folder in known if (folder / name).is_file()]
        is_known = _plain(place, name) in versions or name.endswith(SCORES)
        require(is_known, f"{name} is neither old nor new")


def require_readable(place: Path) -> None:
    """Every file that a killed run has left under its own name is whole."""
    for path in place.rglob("*.safetensors"):
        try:
            safetensors.numpy.load(path.read_bytes())
        except safetensors.SafetensorError:
            raise Finding(f"a broken {path.name} is left") from None
        except FileNotFoundError:
            continue  # replaced just now


def leftovers(place: Path) -> Iterator[Path]:
    """Temporary files."""
    return (p for p in place.rglob(".*") if p.is_file())


def _files(place: Path) -> Iterable[str]:
    return (p.relative_to(place).as_posix() for p in place.rglob("*") if p.is_file())


def _plain(folder: Path, name: str) -> Any:
    """What a file holds, without times, versions and the folder's own path."""
    path = folder / name
    content = path.read_bytes().replace(str(folder).encode(), b"OUT")
    if path.suffix == ".json":
        try:
            return _lasting(json.loads(content))
        except ValueError:
            raise Finding(f"{path.name} is no JSON") from None
    if path.suffix in (".md", ".html"):
        return _SECONDS.sub(b"", content)
    return content


def _plain_model(path: Path) -> Any:
    content = path.read_bytes()
    with safetensors.safe_open(path, framework="numpy") as file:
        header = json.loads((file.metadata() or {})[KEY])
    arrays = {name: array.tobytes() for name, array in safetensors.numpy.load(content).items()}
    return arrays, _lasting(header)


def _plain_log(path: Path) -> list[Any]:
    return [_lasting(json.loads(line)) for line in path.read_text().splitlines()]


def _lasting(content: Any) -> Any:
    if isinstance(content, dict):
        return {k: _lasting(v) for k, v in content.items() if k not in _OF_THE_RUN}
    return [_lasting(part) for part in content] if isinstance(content, list) else content
