"""Published results of the authors: Table 1, the scaling and the weights of their networks."""

from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from tustinnet.channels import Channels
from tustinnet.data.dataset import DataSet
from tustinnet.data.experiment import Experiment, VelocitySource
from tustinnet.errors import InputError
from tustinnet.families.tustin_net import TustinNet
from tustinnet.models.blocks import Affine, Network, Scaling, make_scaling

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
    """Loads a network of the authors as a Tustin-Net in float64.

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
    units = scaling_of_increments(scale, data.channels, np.float64)
    network = Network(layers[0], (layers[1], layers[2]), layers[3], units, "leaky_relu")
    return TustinNet(network, data.channels)


def published_scaling(
    experiments: Sequence[Experiment],
    velocity: VelocitySource = "file",
    relaxation_times: Sequence[float] = (),
) -> Scaling:
    """Scaling as in the paper's public code, from the stored velocity columns.

    One scale per coordinate, the mean over records of mean |v| / mean |q|, divides the velocity
    and multiplies the network's output, which is the velocity's increment per step. Inputs are
    not scaled. In a record in which a coordinate does not move its scale is 1.

    Args:
        experiments: the training records.
        velocity: always the stored columns, whatever the recipe says.
        relaxation_times: of internal states, for which it has no units.

    Raises:
        InputError: a linear coordinate.
    """
    channels = experiments[0].channels
    if not channels.angular.all() or relaxation_times:
        raise InputError(
            "scaling 'published'",
            "the published scaling is defined for angular coordinates without memory",
            "no linear coordinate",
            "use the recipe 'standard' or 'transfer'",
        )
    sizes = [
        (np.abs(e.velocities("file")).mean(axis=0), np.abs(e.q).mean(axis=0)) for e in experiments
    ]
    ratios = [np.divide(v, q, out=np.ones_like(v), where=(v > 0) & (q > 0)) for v, q in sizes]
    return scaling_of_increments(np.mean(ratios, axis=0), channels)


def scaling_of_increments(
    scale: np.ndarray, channels: Channels, dtype: type = np.float32
) -> Scaling:
    """Scaling of a network that maps `v / scale` to velocity increments per step over `scale`."""
    return make_scaling(
        position_offset=np.zeros(0),
        position_scale=np.ones(0),
        velocity=scale,
        input=np.ones(channels.n_u),
        acceleration=scale / channels.dt,
        memory=np.zeros(0),
        dtype=dtype,
    )
