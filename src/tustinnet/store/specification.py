"""The specification of a run, kept in its folder: a run is resumed only with the same one."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.fitting.task import Task
from tustinnet.store.checkpoint import feed_record, model_digest
from tustinnet.store.files import to_json, write_into
from tustinnet.store.model_file import read_header
from tustinnet.systems.files import SystemFile

SPECIFICATION = "question.json"
_MOST_DIFFERENCES = 3  # differences that are named of each part
_KINDS = {"recipe": "a run of a recipe", "plan": "a selection by a plan"}

Specification = Mapping[str, Any]  # plain values: `recipe` or `plan`, `data`, `system`, ...


def make_specification(task: Task, system: SystemFile | None) -> Specification:
    """The specification of a run of a recipe; seeds may join later."""
    (fold,) = task.folds
    name = None if task.system is None else task.system.name

    return {
        "recipe": task.recipe.model_dump(mode="json"),
        "data": {
            "train": record_digests(fold.roles.train),
            "validation": record_digests(fold.roles.validation),
        },
        "system": name if system is None else system.sha256,
        "physics": None if fold.physics is None else model_digest(fold.physics),
        "from": None if fold.origin is None else model_digest(fold.origin.model),
    }


def record_digests(records: Sequence[Experiment]) -> dict[str, str]:
    """Records by name, each with a SHA-256 of its declaration and of its samples."""
    digests = {}
    for e in records:
        digest = hashlib.sha256()
        feed_record(digest, e)
        digests[e.name] = digest.hexdigest()
    return digests


def write_specification(folder: Path, specification: Specification) -> None:
    """Writes the specification of a run into its folder."""
    write_into(folder, SPECIFICATION, to_json(specification))


def require_same_specification(folder: Path, specification: Specification, model: str) -> None:
    """Raises unless a specification is that of the run in a folder, if one is there.

    Args:
        folder: the run's folder.
        specification: the specification.
        model: the name of the model file of a finished run, which has at least the recipe or the
            plan where the specification was not kept.

    Raises:
        InputError: something differs, which is named.
    """
    kept = _read_specification(folder, specification, model)
    if kept is None:
        return
    kind, before = _kind(specification), _kind(kept)
    if kind != before:
        difference = f"holds {_KINDS[before]}, not {_KINDS[kind]}"
    else:
        # as a file says it: what is no JSON has become something that is
        now = json.loads(to_json(specification))
        parts = []
        for key in (key for key in now if key in kept):
            paths = list(_differing_paths(kept[key], now[key]))
            names = [path for path in paths if path]
            more = ", ..." if len(names) > _MOST_DIFFERENCES else ""
            if paths:
                parts.append(
                    f"{key} ({', '.join(names[:_MOST_DIFFERENCES])}{more})" if names else key
                )
        if not parts:
            return
        difference = f"holds {_KINDS[before]} with another {', '.join(parts)}"
    raise InputError(
        folder,
        difference,
        "for `resume=` the same recipe or plan, data and system",
        "use the same, choose another folder, or discard what is there by `overwrite=`",
    )


def _kind(specification: Specification) -> str:
    return next(kind for kind in _KINDS if kind in specification)


def _read_specification(
    folder: Path, specification: Specification, model: str
) -> Specification | None:
    """The specification of the run in a folder, None where it holds none or does not say.

    What it does not say is taken to be the same.
    """
    try:
        kept = json.loads((folder / SPECIFICATION).read_text(encoding="utf-8"))
        if isinstance(kept, dict) and _kind(kept):
            return kept
    except (OSError, ValueError, TypeError, StopIteration):
        pass
    if not (folder / model).is_file():
        return None
    header = read_header(folder / model)
    if "selection" in header:
        name = header["selection"]["plan"]  # and nothing else of the plan
        return {"plan": {**specification.get("plan", {}), "name": name}}
    return {"recipe": header.get("recipe", {})}


def _differing_paths(before: Any, now: Any, path: str = "") -> Iterator[str]:
    """The places where two specifications differ, as keys and numbers joined by dots."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys((*before, *now)):
            if key in before and key in now:
                yield from _differing_paths(before[key], now[key], f"{path}{key}.")
            else:
                yield f"{path}{key}"
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for i, (old, new) in enumerate(zip(before, now, strict=True)):
            yield from _differing_paths(old, new, f"{path}{i}.")
    elif before != now:
        yield path.removesuffix(".")
