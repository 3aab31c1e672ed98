"""The model of records that are made with something, as a payload: its values by group."""

from collections.abc import Mapping

import numpy as np

from tustinnet.data.dataset import from_arrays
from tustinnet.errors import InputError
from tustinnet.models.contract import Model


def model_for_groups(model: Model, groups: Mapping[str, str], where: str) -> Model:
    """The model of a record with these groups, all of which it needs.

    Args:
        model: the model.
        groups: what a record would be made with, as `{"payload": "1kg"}`.
        where: what the record is called, for messages.

    Raises:
        InputError: groups that are missing, that the model does not have, or whose values it does
            not know.
    """

    def chosen(given: Mapping[str, str]) -> Model:
        record = from_arrays(
            np.zeros((2, model.channels.n_q)), np.zeros((2, model.channels.n_u)), dt=model.dt,
            coordinates=model.coordinates, inputs=model.inputs, name=where, groups=given,
        )  # fmt: skip
        return model.for_record(record)

    def answers(given: Mapping[str, str]) -> bool:
        try:
            chosen(given)
        except InputError:
            return False
        return True

    found = chosen(groups)
    for name in groups:
        if answers({other: value for other, value in groups.items() if other != name}):
            raise InputError(
                where, f"group '{name}', which nothing in the model is per",
                "groups that its values are by", "leave it out",
            )  # fmt: skip
    return found
