"""Model files as environments of Gymnasium; `tustinnet.gym` makes them known to it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax

from tustinnet.export.environment import ModelEnv, ModelVectorEnv, Rules
from tustinnet.export.source import make_source
from tustinnet.models.contract import Model
from tustinnet.simulate.range import KEY, Range
from tustinnet.store.header import read_header
from tustinnet.store.model_file import load_model
from tustinnet.systems.files import AnySystem


def environment(model: str | Path | Model, **options: Any) -> ModelEnv:
    """A model as an environment: `gymnasium.make("tustinnet.gym:TustinNet-v0", model=...)`.

    Args:
        model: a model file, or a model.
        options: `system`, the system or its file, of a model of a system of your own; `groups`, of
            a model with values by group those to take; `range`, where states and inputs lie, of a
            model that does not say it: `{"states": [[low, high], ...], "inputs": [[low, high],
            ...]}`, optionally with `recorded_states` to start from; and what `Rules` has: `reward`,
            `target`, `start`, `noise`, `margin`, `randomise`.

    Raises:
        InputError: see `load_model`, `make_source` and `Rules`; nobody says where states and inputs
            lie.
    """
    return ModelEnv(_rules(model, **options))


def environments(
    num_envs: int, model: str | Path | Model, max_episode_steps: int | None = None, **options: Any
) -> ModelVectorEnv:
    """Environments that step at once; the vector entry point of `tustinnet.gym:TustinNet-v0`.

    Args:
        num_envs: how many.
        model: as of `environment`.
        max_episode_steps: after how many steps episodes are cut, None for never.
        options: as of `environment`.

    Raises:
        InputError: as `environment`.
    """
    return ModelVectorEnv(_rules(model, **options), num_envs, max_episode_steps)


def _rules(
    model: str | Path | Model,
    *,
    system: AnySystem | None = None,
    groups: Mapping[str, str] | None = None,
    range: Mapping[str, Any] | None = None,
    **options: Any,
) -> Rules:
    # in double precision, whatever else JAX is used for
    with jax.enable_x64(True):
        header: Mapping[str, Any] = {}
        if not isinstance(model, Model):
            model, header = load_model(model, system), read_header(model)
        limits = Range.from_header(header if range is None else {KEY: range}, model)
        return Rules(make_source(model, limits, groups, header), **options)
