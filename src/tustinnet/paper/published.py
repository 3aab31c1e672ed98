"""What the authors published: Table 1 and the weights of their networks."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from tustinnet.data.dataset import DataSet
from tustinnet.errors import InputError
from tustinnet.models.network import Affine
from tustinnet.models.tustin import TustinNet, scaling_of_increments

# Table 1 of the paper, RMSE in rad on its records #1..#8, the `test` split of the published data
TABLE_1 = {
    "Euler-Lagrange": (0.142, 0.107, 0.311, 0.067, 0.141, 0.161, 0.139, 0.299),
    "Tustin-Net (standard training)": (0.531, 0.228, 0.614, 0.184, 0.072, 0.123, 0.157, 0.179),
    "Tustin-Net (Algorithm 1)": (0.075, 0.153, 0.111, 0.094, 0.103, 0.142, 0.168, 0.177),
}

WEIGHTS_FOLDER = "authors_weights"
AUTHORS_ROWS = {
    "authors-pretrained": "session1",
    "authors-transfer": "session2",
    "authors-standard": "standard",
}
_LAYERS = ("fc1", "fc2", "fc3", "fc4")


def load_authors_weights(path: Path, data: DataSet) -> TustinNet:
    """A network of the authors as a Tustin-Net in float64.

    Their network is affine fc1, affine fc2, leaky ReLU, affine fc3, leaky ReLU, affine fc4, with
    velocities divided by `velocity_scale` and outputs, velocity increments per step, multiplied
    by it. fc1 becomes the stem.

    Args:
        path: an .npz file with `fcN.weight`, `fcN.bias` and `velocity_scale`.
        data: the records, for coordinates, inputs and period.

    Raises:
        InputError: the file is missing or is not such a file.
    """
    if not path.is_file():
        raise InputError(path, "no such file", "the authors' stored weights (.npz)")
    try:
        with np.load(path, allow_pickle=False) as stored:
            layers = [
                Affine(
                    jnp.asarray(stored[f"{name}.weight"], jnp.float64),
                    jnp.asarray(stored[f"{name}.bias"], jnp.float64),
                )
                for name in _LAYERS
            ]
            scale = np.asarray(stored["velocity_scale"], np.float64)
    except (KeyError, ValueError, OSError) as error:
        raise InputError(path, f"not the authors' weights ({error})", "fc1..fc4") from error
    return TustinNet(
        stem=layers[0],
        hidden=(layers[1], layers[2]),
        output=layers[3],
        scaling=scaling_of_increments(scale, data[0], jnp.float64),
        activation="leaky_relu",
        coordinates=data.coordinates,
        inputs=data.inputs,
        dt=data.dt,
    )
