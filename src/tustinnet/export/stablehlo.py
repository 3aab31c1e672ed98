"""StableHLO: a step and a free run for programs with JAX and without this package."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import export
from jaxtyping import Array

from tustinnet.export.source import Source
from tustinnet.export.target import Files, Stepper, Target
from tustinnet.simulate.rollout import rollout

STEP, ROLLOUT = "step.bin", "rollout.bin"
PLATFORMS = "cpu", "cuda"
_FRAMES = "jax_traceback_in_locations_limit"


class StableHLO(Target):
    """Functions as JAX serializes them, in double precision."""

    name = "stablehlo"
    extra = "stablehlo", ("flatbuffers",)

    def files(self, source: Source) -> Files:
        """`step.bin` and `rollout.bin`."""
        n_x, n_w = source.n_x, source.n_w
        (steps,) = export.symbolic_shape("steps")
        layout = source.input_layout

        def run(x0: Array, u: Array) -> Array:
            step_inputs = u @ jnp.asarray(layout.matrix).T
            return rollout(source.model, x0, step_inputs.reshape(u.shape[0], *layout.shape))

        return {
            STEP: _serialized(source.function, (n_x,), (n_w,)),
            ROLLOUT: _serialized(run, (n_x,), (steps, n_w)),
        }

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by `step.bin`, compiled by JAX."""
        call = jax.jit(export.deserialize(bytearray((folder / STEP).read_bytes())).call)
        return lambda x, u: np.asarray(call(x, u))


def _serialized(function: Callable[..., Array], *shapes: tuple[Any, ...]) -> bytes:
    arguments = [jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes]
    with _without_locations():
        exported = export.export(jax.jit(function), platforms=PLATFORMS)(*arguments)
        return bytes(exported.serialize())


@contextmanager
def _without_locations() -> Iterator[None]:
    """Leaves out the files and lines of operations.

    They are paths of this machine, and the same model would give other bytes elsewhere.
    """
    frames = getattr(jax.config, _FRAMES)
    jax.config.update(_FRAMES, 0)
    try:
        yield
    finally:
        jax.config.update(_FRAMES, frames)


TARGET = StableHLO()
