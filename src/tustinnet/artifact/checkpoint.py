"""Checkpoints: all that a training needs to go on as if it had never stopped."""

import dataclasses
import hashlib
import json
import time
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import safetensors.numpy

from tustinnet.artifact.files import write_atomically
from tustinnet.artifact.model_file import FORMAT, KEY, read_file
from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.training.fit import Plan
from tustinnet.training.plateau import Plateau
from tustinnet.training.recipe import Recipe
from tustinnet.training.state import Progress, Weights

_KIND = "checkpoint"
_INTERVAL = 5.0  # seconds between two checkpoints within a stage


class Checkpointer:
    """Writes checkpoints while training goes on: at most every 5 s, and when a stage changes."""

    def __init__(self, path: Path, fingerprint: str) -> None:
        self.path, self.fingerprint = path, fingerprint
        self._written = time.monotonic()
        self._stage = 0

    def __call__(self, weights: Weights, progress: Progress) -> None:
        """Told after every epoch."""
        due = time.monotonic() - self._written >= _INTERVAL
        if due or progress.outcome or progress.stage != self._stage:
            write_checkpoint(self.path, weights, progress, self.fingerprint)
            self._written, self._stage = time.monotonic(), progress.stage


def fingerprint(data: DataSet, recipe: Recipe, seed: int) -> str:
    """What a checkpoint belongs to: the recipe, the seed and the records."""
    digest = hashlib.sha256(recipe.model_dump_json().encode())
    digest.update(str(seed).encode())
    for e in data:
        digest.update(f"{e.name} {e.split} {e.dt} {e.coordinates} {e.inputs} {e.k_bar}".encode())
        for array in (e.t, e.q, e.u, e.v):
            digest.update(b"" if array is None else array.tobytes())
    return digest.hexdigest()


def write_checkpoint(path: Path, weights: Weights, progress: Progress, belongs_to: str) -> None:
    """Writes a checkpoint, whole or not at all."""
    header = {
        "format": FORMAT,
        "kind": _KIND,
        "fingerprint": belongs_to,
        "progress": dataclasses.asdict(progress),
    }
    arrays = {f"{i:04d}": np.asarray(leaf) for i, leaf in enumerate(_plain_leaves(weights))}
    # Python's JSON writes and reads infinities and every bit of a float
    write_atomically(path, safetensors.numpy.save(arrays, {KEY: json.dumps(header)}))


def read_checkpoint(path: Path, plan: Plan, belongs_to: str) -> tuple[Weights, Progress]:
    """Reads the state to resume from.

    Raises:
        InputError: damaged, or of another recipe, seed or data set.
    """
    header, arrays = read_file(path, [_KIND])
    if header["fingerprint"] != belongs_to:
        raise InputError(
            path,
            "the checkpoint belongs to another recipe, seed or data set",
            "the same as when it was written",
            "start anew with --overwrite, or in another folder",
        )
    content = header["progress"]
    progress = Progress(**{**content, "plateau": Plateau(**content["plateau"])})
    template = plan.template(progress.stage)
    leaves = [jnp.asarray(arrays[name]) for name in sorted(arrays)]
    return _with_leaves(template, leaves), progress


def _plain_leaves(weights: Weights) -> list[jax.Array]:
    arrays = eqx.filter(weights, eqx.is_array)
    return jax.tree.leaves(arrays._replace(key=jax.random.key_data(weights.key)))


def _with_leaves(template: Weights, leaves: list[jax.Array]) -> Weights:
    arrays, static = eqx.partition(template, eqx.is_array)
    plain = arrays._replace(key=jax.random.key_data(template.key))
    filled = jax.tree.unflatten(jax.tree.structure(plain), leaves)
    return eqx.combine(filled._replace(key=jax.random.wrap_key_data(filled.key)), static)
