"""What a run was asked, kept in its folder: it goes on only where the same is asked again."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError
from tustinnet.fitting.task import Task
from tustinnet.models.contract import Model
from tustinnet.store.checkpoint import feed_model, feed_record
from tustinnet.store.files import to_json, write_into
from tustinnet.store.model_file import read_header
from tustinnet.systems.files import SystemFile

QUESTION = "question.json"
_MOST = 3  # differences that are named of each part
_KINDS = {"recipe": "a run of a recipe", "plan": "a selection by a plan"}

Question = Mapping[str, Any]  # plain values: `recipe` or `plan`, `data`, `system`, ...


def question_of(task: Task, system: SystemFile | None) -> Question:
    """What a run of a recipe is asked; seeds may join later."""
    (fold,) = task.folds
    origin = None if fold.origin is None else fold.origin.model
    named = None if task.system is None else task.system.name
    return {
        "recipe": task.recipe.model_dump(mode="json"),
        "data": {
            "train": data_of(fold.roles.train), "validation": data_of(fold.roles.validation),
        },
        "system": named if system is None else system.sha256,
        "physics": None if fold.physics is None else _digest_of(fold.physics),
        "from": None if origin is None else _digest_of(origin),
    }  # fmt: skip


def data_of(records: Sequence[Experiment]) -> dict[str, str]:
    """Records by name, each with a SHA-256 of what is declared of it and of its samples."""
    found = {}
    for e in records:
        digest = hashlib.sha256()
        feed_record(digest, e)
        found[e.name] = digest.hexdigest()
    return found


def _digest_of(model: Model) -> str:
    digest = hashlib.sha256()
    feed_model(digest, model)
    return digest.hexdigest()


def write_question(folder: Path, question: Question) -> None:
    """Keeps what a run is asked in its folder."""
    write_into(folder, QUESTION, to_json(question))


def require_same(folder: Path, question: Question, model: str) -> None:
    """Raises unless what is asked is what the run in a folder was asked, if one is there.

    Args:
        folder: the run's folder.
        question: what is asked.
        model: the name of the model file of a finished run, which tells at least the recipe or
            the plan where the question was not kept.

    Raises:
        InputError: something differs, which is named.
    """
    kept = _kept(folder, question, model)
    if kept is None:
        return
    kind, before = _kind(question), _kind(kept)
    if kind != before:
        found = f"holds {_KINDS[before]}, not {_KINDS[kind]}"
    else:
        # as a file says it: what is no JSON has become something that is
        now = json.loads(to_json(question))
        differing = {key: list(_differing(kept[key], now[key])) for key in now if key in kept}
        told = [_told(key, paths) for key, paths in differing.items() if paths]
        if not told:
            return
        found = f"holds {_KINDS[before]} that was asked otherwise: another {', '.join(told)}"
    raise InputError(
        folder, found, "for --resume the same recipe or plan, data and system",
        "ask the same, choose another --out, or discard what is there by --overwrite",
    )  # fmt: skip


def _kind(question: Question) -> str:
    return next(kind for kind in _KINDS if kind in question)


def _kept(folder: Path, question: Question, model: str) -> Question | None:
    """What the folder says that its run was asked, None where it holds none or does not say.

    Of what it does not say it is taken to have been asked the same.
    """
    try:
        kept = json.loads((folder / QUESTION).read_text(encoding="utf-8"))
        if isinstance(kept, dict) and _kind(kept):
            return kept
    except (OSError, ValueError, TypeError, StopIteration):
        pass
    if not (folder / model).is_file():
        return None
    header = read_header(folder / model)
    if "selection" in header:
        known = {"name": header["selection"]["plan"]}  # and nothing else of the plan
        return {"plan": {**question.get("plan", {}), **known}}
    recipe = {key: of for key, of in header.get("recipe", {}).items() if key != "rates"}
    return {"recipe": recipe}


def _differing(before: Any, now: Any, path: str = "") -> Iterator[str]:
    """The places where two questions differ, as keys and numbers joined by dots."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in dict.fromkeys((*before, *now)):
            if key in before and key in now:
                yield from _differing(before[key], now[key], f"{path}{key}.")
            else:
                yield f"{path}{key}"
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for i, of in enumerate(zip(before, now, strict=True)):
            yield from _differing(*of, f"{path}{i}.")
    elif before != now:
        yield path.removesuffix(".")


def _told(key: str, paths: Sequence[str]) -> str:
    named = [path for path in paths if path]
    more = ", ..." if len(named) > _MOST else ""
    return f"{key} ({', '.join(named[:_MOST])}{more})" if named else key
