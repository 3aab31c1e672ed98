"""The double pendulum of double_pendulum.py with encoder zeros of every record.

The encoders were set to zero where dry friction had stopped the pendulum, up to some hundredths
of a radian from hanging. Two internal states that never change hold where true zero is: they are 0
while parameters are identified, and a start such as model-250 finds them from the first second:

    tustinnet fit FOLDER --card examples/double_pendulum_dfki.toml \
        --system examples/double_pendulum_zeros.py --out my-pendulum
    tustinnet evaluate my-pendulum/model.safetensors FOLDER --split validation \
        --card examples/double_pendulum_dfki.toml \
        --system examples/double_pendulum_zeros.py --start model-250
"""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp

import tustinnet as tn

KNOWN = tn.load_system(Path(__file__).with_name("double_pendulum.py"))


def unmoved(q, v, z, p):
    """Rate of the zeros: none."""
    return jnp.zeros_like(z)


def gravity_beside(q, v, z, p):
    """What gravity does at the true angles q + z rather than at the measured q [N m]."""
    assert KNOWN.potential is not None
    slope = jax.grad(KNOWN.potential)
    return slope(q, p) - slope(q + z, p)


SYSTEM = replace(
    KNOWN,
    name="double-pendulum-zeros",
    memory=tn.Memory(names=("shoulder_zero", "elbow_zero"), rate=unmoved, force=gravity_beside),
)
