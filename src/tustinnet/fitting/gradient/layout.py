"""The layout of members and windows on devices."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh

MEMBERS, WINDOWS = "members", "windows"  # the axes of a mesh


def lay_out_devices(members: int, batch: int, devices: Sequence[Any] | None = None) -> Mesh:
    """Shares members among devices, and the remaining devices among the windows of a batch.

    Members need nothing from one another, so that each device trains its own. The windows of a
    batch need the sum of their gradients after every step of the optimiser.

    JAX sees the cores of a processor as one device unless its configuration says otherwise before
    the first computation: `jax.config.update("jax_num_cpu_devices", cores)`; the command does that.

    Args:
        members: trainings that run together.
        batch: windows in a step of the optimiser.
        devices: those to use; by default all of the kind that JAX prefers.

    Returns:
        A mesh with the axes `members` and `windows`.
    """
    if devices is None:
        (preferred,) = jnp.zeros(()).devices()
        devices = jax.devices(preferred.platform)
    for_members = max(d for d in range(1, len(devices) + 1) if members % d == 0)
    # fewer than 8 windows of a batch are not worth a device
    for_windows = max(1, min(len(devices) // for_members, batch // 8))
    chosen = np.asarray(devices[: for_members * for_windows])
    return Mesh(chosen.reshape(for_members, for_windows), (MEMBERS, WINDOWS))
