"""The model for records of a group, as of one payload."""

from collections.abc import Mapping

import numpy as np

from tustinnet.data.dataset import from_arrays
from tustinnet.errors import InputError
from tustinnet.models.contract import Model


def model_for_groups(model: Model, groups: Mapping[str, str], where: str) -> Model:
    """The model of a record with these groups, all of which it needs.

    Args:
        model: the model.
        groups: the groups of a record, as `{"payload": "1kg"}`.
        where: what the record is called, for messages.

    Raises:
        InputError: groups that are missing, that the model does not have, or whose values it does
            not have.
    """

    def with_groups(some: Mapping[str, str]) -> Model:
        record = from_arrays(
            np.zeros((2, model.channels.n_q)),
            np.zeros((2, model.channels.n_u)),
            dt=model.dt,
            coordinates=model.coordinates,
            inputs=model.inputs,
            name=where,
            groups=some,
        )
        return model.for_record(record)

    chosen = with_groups(groups)
    for name in groups:
        try:
            with_groups({other: value for other, value in groups.items() if other != name})
        except InputError:
            continue
        raise InputError(
            where,
            f"group '{name}', which nothing in the model is per",
            "groups that its values are by",
            "leave it out",
        )
    return chosen
