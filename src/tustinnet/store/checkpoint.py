"""Checkpoints: all that a training needs to go on as if it had never stopped.

Each member of those that train together has a file of its own.
"""

import dataclasses
import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import safetensors.numpy

from tustinnet.errors import InputError
from tustinnet.families.family import family_of
from tustinnet.fitting.gradient.plan import plan
from tustinnet.fitting.gradient.state import Progress, TrainingState
from tustinnet.fitting.task import Member, Task
from tustinnet.store.files import write_atomically
from tustinnet.store.model_file import FORMAT, KEY, read_file

_KIND = "checkpoint"
_INTERVAL = 5.0  # seconds between two checkpoints within a stage


class Checkpointer:
    """Writes checkpoints while training goes on: at most every 5 s, and when a stage changes.

    Args:
        paths: a file for each member.
        fingerprints: what they belong to.
    """

    def __init__(self, paths: Sequence[Path], fingerprints: Sequence[str]) -> None:
        self._files = list(zip(paths, fingerprints, strict=True))
        self._written = time.monotonic()
        self._told: tuple[Progress, ...] | None = None

    def __call__(self, state: TrainingState, progress: tuple[Progress, ...]) -> None:
        """Told after every compiled call."""
        before = self._told or progress
        due = time.monotonic() - self._written >= _INTERVAL
        for m, (path, belongs_to) in enumerate(self._files):
            if self._told and before[m].outcome:
                continue  # its last state is kept as it was
            changed = progress[m].outcome or progress[m].stage != before[m].stage
            if due or changed:
                write_checkpoint(path, member_of(state, m), progress[m], belongs_to)
        if due:
            self._written = time.monotonic()
        self._told = progress


def fingerprint(task: Task, member: Member) -> str:
    """What a checkpoint belongs to: the recipe, the member, its records and physics."""
    fold = task.folds[member.fold]
    digest = hashlib.sha256(task.recipe.model_dump_json().encode())
    digest.update(member.name.encode())
    if fold.physics is not None:
        described, arrays = family_of(fold.physics).describe(fold.physics)
        digest.update(json.dumps([described, fold.physics.channels.as_header()]).encode())
        for name in sorted(arrays):
            digest.update(arrays[name].tobytes())
    for role, records in (("train", fold.roles.train), ("validation", fold.roles.validation)):
        for e in records:
            digest.update(f"{role} {e.name} {e.channels} {e.k_bar}".encode())
            for array in (e.t, e.q, e.u, e.v):
                digest.update(b"" if array is None else array.tobytes())
    return digest.hexdigest()


def write_checkpoint(path: Path, state: TrainingState, progress: Progress, belongs_to: str) -> None:
    """Writes the checkpoint of one member, whole or not at all."""
    header = {
        "format": FORMAT,
        "kind": _KIND,
        "fingerprint": belongs_to,
        "progress": dataclasses.asdict(progress),
    }
    arrays = {f"{i:04d}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(_plain(state)))}
    # Python's JSON writes and reads infinities and every bit of a float
    write_atomically(path, safetensors.numpy.save(arrays, {KEY: json.dumps(header)}))


def read_checkpoint(path: Path, task: Task, member: Member) -> tuple[TrainingState, Progress]:
    """Reads the state of one member to resume from.

    Raises:
        InputError: damaged, or of another recipe, seed, rate or data set.
    """
    header, arrays = read_file(path, [_KIND])
    if header["fingerprint"] != fingerprint(task, member):
        raise InputError(
            path,
            "the checkpoint belongs to another recipe, seed, rate, data set or version",
            "the same as when it was written",
            "start anew with --overwrite, or in another folder",
        )
    content = header["progress"]
    progress = Progress(**{**content, "epochs": tuple(content["epochs"])})
    template = member_of(plan(task.of([member])).begin(progress.stage), 0)
    leaves = [jnp.asarray(arrays[name]) for name in sorted(arrays)]
    plain = jax.tree.unflatten(jax.tree.structure(_plain(template)), leaves)
    key = jax.random.wrap_key_data(plain.weights.key)
    return plain._replace(weights=plain.weights._replace(key=key)), progress


def member_of(state: TrainingState, m: int) -> TrainingState:
    """The state of one member, arrays without the axis of members."""
    return jax.tree.map(lambda array: array[m], state)


def together(states: Sequence[TrainingState]) -> TrainingState:
    """States of members as one."""
    return jax.tree.map(lambda *arrays: jnp.stack(arrays), *states)


def _plain(state: TrainingState) -> Any:
    """The same state with the key as plain numbers."""
    key = jax.random.key_data(state.weights.key)
    return state._replace(weights=state.weights._replace(key=key))
