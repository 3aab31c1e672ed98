"""Checkpoints: files with all that a training needs to go on as if it had never stopped.

Members that train together are in one file: what they compute depends, in the last bits, on who
trains beside them, so that a resumed run must have the same ones at the same moment.
"""

import dataclasses
import hashlib
import json
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import TypeAdapter

from tustinnet.data.experiment import Experiment
from tustinnet.errors import InputError, convert_errors
from tustinnet.families.family import family_of
from tustinnet.fitting.gradient.loop import ResumePoint
from tustinnet.fitting.gradient.plan import make_plan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.task import Member, Task
from tustinnet.models.contract import Model
from tustinnet.store.sealed import read_sealed, write_sealed

_KIND = "checkpoint"
_PROGRESS = TypeAdapter(Progress)
_INTERVAL = 5.0  # seconds between two checkpoints within a stage


class Checkpointer:
    """Writes checkpoints while training goes on: at most every 5 s, and when a stage changes.

    Args:
        path: the file.
        task: of which members train together.
    """

    def __init__(self, path: Path, task: Task) -> None:
        self._path = path
        self._fingerprints = {member.name: fingerprint(task, member) for member in task.members}
        self._written = time.monotonic()
        self._progress: tuple[Progress, ...] = ()
        self._unwritten: TrainingState | None = None

    def __call__(self, state: TrainingState, progress: tuple[Progress, ...]) -> None:
        """Takes the state after a compiled call."""
        before, now = ([(p.stage, p.outcome) for p in row] for row in (self._progress, progress))
        changed = self._progress and before != now
        self._progress, self._unwritten = progress, state
        if changed or time.monotonic() - self._written >= _INTERVAL:
            self.flush()

    def flush(self) -> None:
        """Writes the last state, where that was not done yet."""
        if self._unwritten is not None:
            header = {
                "kind": _KIND,
                "stage": max(p.stage for p in self._progress),
                "members": self._fingerprints,
                "progress": [dataclasses.asdict(p) for p in self._progress],
            }
            leaves = jax.tree.leaves(_with_plain_key(self._unwritten))
            arrays = {f"{i:04d}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
            write_sealed(self._path.parent, self._path.name, header, arrays)
            self._written, self._unwritten = time.monotonic(), None


def fingerprint(task: Task, member: Member) -> str:
    """A digest of the fit of a member: recipe, seed, records, physics and origin."""
    fold = task.folds[member.fold]
    digest = hashlib.sha256(task.recipe.model_dump_json().encode())
    digest.update(member.name.encode())
    for model in (fold.physics, fold.origin and fold.origin.model):
        if model is not None:
            feed_model(digest, model)
    for role, records in (("train", fold.roles.train), ("validation", fold.roles.validation)):
        for e in records:
            digest.update(f"{role} ".encode())
            feed_record(digest, e)
    return digest.hexdigest()


def model_digest(model: Model) -> str:
    """A SHA-256 of a model: structure, channels, arrays."""
    digest = hashlib.sha256()
    feed_model(digest, model)
    return digest.hexdigest()


def feed_model(digest: Any, model: Model) -> None:
    """Adds a model to a digest: structure, channels, arrays."""
    described, arrays = family_of(model).describe(model)
    digest.update(json.dumps([described, model.channels.as_header()]).encode())
    for name in sorted(arrays):
        digest.update(arrays[name].tobytes())


def feed_record(digest: Any, experiment: Experiment) -> None:
    """Adds a record to a digest: its name, its declaration, its samples."""
    e = experiment
    controller = e.channels.controller or ""
    digest.update(f"{e.name} {e.channels} {e.k_bar}{controller}".encode())
    for array in (e.t, e.q, e.u, e.v, e.outputs):
        digest.update(b"" if array is None else array.tobytes())


def read_checkpoint(path: Path, task: Task) -> tuple[tuple[Member, ...], ResumePoint | None]:
    """The members of a task that a checkpoint has, their state and progress; None of no member.

    Raises:
        InputError: damaged, or of another recipe, seed, rate or data set.
    """
    header, arrays = read_sealed(path, [_KIND])
    with convert_errors(
        path,
        "not a whole checkpoint",
        "a checkpoint written by tustinnet",
        "start anew with `overwrite=`",
    ):
        stored_members = list(header["members"].items())
        by_name = {member.name: member for member in task.members}
        rows = [row for row, (name, _) in enumerate(stored_members) if name in by_name]
        members = tuple(by_name[stored_members[row][0]] for row in rows)
        for member, row in zip(members, rows, strict=True):
            if stored_members[row][1] != fingerprint(task, member):
                raise InputError(
                    path,
                    "the checkpoint belongs to another recipe, seed, rate, data set or version",
                    "the same as when it was written",
                    "start anew with `overwrite=`, or in another folder",
                )
        if not members:
            return (), None
        fields = {field.name for field in dataclasses.fields(Progress)}
        contents = [header["progress"][row] for row in rows]
        if any(content.keys() != fields for content in contents):
            raise ValueError("a progress with other fields")
        progress = tuple(_PROGRESS.validate_python(content) for content in contents)
        template = _with_plain_key(make_plan(task.with_members(members)).begin(header["stage"]))
        leaves, structure = jax.tree.flatten(template)
        stored = [arrays[name] for name in sorted(arrays)]
        if [(a.shape, a.dtype) for a in leaves] != [
            ((len(rows), *a.shape[1:]), a.dtype) for a in stored
        ]:
            raise ValueError("arrays of other shapes than the training has")
        plain = jax.tree.unflatten(structure, [jnp.asarray(array[rows]) for array in stored])
    key = jax.random.wrap_key_data(plain.weights.key)
    return members, (plain._replace(weights=plain.weights._replace(key=key)), progress)


def _with_plain_key(state: TrainingState) -> Any:
    """A state with the key as plain numbers."""
    key = jax.random.key_data(state.weights.key)
    return state._replace(weights=state.weights._replace(key=key))
