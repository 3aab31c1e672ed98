"""From logs of a mechanical system to a model that simulates it.

The public names. JAX is loaded when a name that needs it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tustinnet.artifact.model_file import load_model, read_header, save
    from tustinnet.data.catalog import load
    from tustinnet.data.dataset import DataSet, from_arrays
    from tustinnet.data.experiment import Coordinate, Experiment, Input
    from tustinnet.data.inspection import inspect_experiment
    from tustinnet.data.loading import from_frame
    from tustinnet.errors import InputError
    from tustinnet.evaluation.free_run import evaluate, free_run, mean_rmse, rmse_ahead
    from tustinnet.identification.identify import identify
    from tustinnet.identification.result import Estimate, Identification
    from tustinnet.identification.search import Settings
    from tustinnet.models.hybrid import HybridModel
    from tustinnet.models.lagrangian import LagrangianModel, LagrangianSystem, Memory, Parameter
    from tustinnet.models.tustin import TustinNet
    from tustinnet.simulation.adaptive import discretise_adaptively
    from tustinnet.simulation.compiled_step import compiled_step
    from tustinnet.simulation.initial_state import initial_state
    from tustinnet.simulation.integrators import discretise
    from tustinnet.simulation.linearisation import Linearisation, linearize
    from tustinnet.simulation.numpy_step import numpy_step
    from tustinnet.simulation.rollout import rollout
    from tustinnet.simulation.substeps import choose_substeps
    from tustinnet.systems.registry import load_system
    from tustinnet.training.fit import FitResult, fit, fit_many
    from tustinnet.training.plan import Member
    from tustinnet.training.recipe import Recipe, read_recipe

_HOMES = {
    "Coordinate": "data.experiment",
    "DataSet": "data.dataset",
    "Estimate": "identification.result",
    "Experiment": "data.experiment",
    "FitResult": "training.fit",
    "HybridModel": "models.hybrid",
    "Identification": "identification.result",
    "Input": "data.experiment",
    "InputError": "errors",
    "LagrangianModel": "models.lagrangian",
    "LagrangianSystem": "models.lagrangian",
    "Linearisation": "simulation.linearisation",
    "Member": "training.plan",
    "Memory": "models.lagrangian",
    "Parameter": "models.lagrangian",
    "Recipe": "training.recipe",
    "Settings": "identification.search",
    "TustinNet": "models.tustin",
    "choose_substeps": "simulation.substeps",
    "discretise": "simulation.integrators",
    "discretise_adaptively": "simulation.adaptive",
    "evaluate": "evaluation.free_run",
    "fit": "training.fit",
    "fit_many": "training.fit",
    "free_run": "evaluation.free_run",
    "from_arrays": "data.dataset",
    "from_frame": "data.loading",
    "identify": "identification.identify",
    "initial_state": "simulation.initial_state",
    "inspect_experiment": "data.inspection",
    "linearize": "simulation.linearisation",
    "load": "data.catalog",
    "load_model": "artifact.model_file",
    "load_system": "systems.registry",
    "mean_rmse": "evaluation.free_run",
    "compiled_step": "simulation.compiled_step",
    "numpy_step": "simulation.numpy_step",
    "read_header": "artifact.model_file",
    "read_recipe": "training.recipe",
    "rmse_ahead": "evaluation.free_run",
    "rollout": "simulation.rollout",
    "save": "artifact.model_file",
}

__all__ = [
    "Coordinate",
    "DataSet",
    "Estimate",
    "Experiment",
    "FitResult",
    "HybridModel",
    "Identification",
    "Input",
    "InputError",
    "LagrangianModel",
    "LagrangianSystem",
    "Linearisation",
    "Member",
    "Memory",
    "Parameter",
    "Recipe",
    "Settings",
    "TustinNet",
    "choose_substeps",
    "compiled_step",
    "discretise",
    "discretise_adaptively",
    "evaluate",
    "fit",
    "fit_many",
    "free_run",
    "from_arrays",
    "from_frame",
    "identify",
    "initial_state",
    "inspect_experiment",
    "linearize",
    "load",
    "load_model",
    "load_system",
    "mean_rmse",
    "numpy_step",
    "read_header",
    "read_recipe",
    "rmse_ahead",
    "rollout",
    "save",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'tustinnet' has no attribute '{name}'")
    value = getattr(import_module(f"tustinnet.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
