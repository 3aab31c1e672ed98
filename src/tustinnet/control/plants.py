"""Plants: models, systems with their own parameters, the twin of the demo, FMUs."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.control.fmu_plant import FmuPlant
from tustinnet.control.sampled_plant import USUAL, PlantOptions, SampledPlant
from tustinnet.control.stepped_model import SteppedModel
from tustinnet.models.contract import Model
from tustinnet.models.integrate import discretise
from tustinnet.models.physical_values import equations_in
from tustinnet.store.model_file import ENDINGS as MODEL_ENDINGS
from tustinnet.store.model_file import load_model, read_system_name
from tustinnet.store.run_folder import find_rivals
from tustinnet.systems.files import AnySystem
from tustinnet.systems.loading import load_system
from tustinnet.systems.qube_servo2 import WITH_MEMORY
from tustinnet.systems.qube_servo2_twin import COUNT, TWIN_NAME, TWIN_VALUES

Vector = Float[np.ndarray, " _"]


class ModelPlant(SampledPlant):
    """A model as a plant.

    Args:
        model: the model, or one that is compiled already and may serve many plants.
        values: values of its physical parameters, where they are others than the model's.
        options: of its encoders and inputs.

    Raises:
        InputError: a continuous model, parameters that it does not have; see `SampledPlant`.
    """

    def __init__(
        self,
        model: Model | SteppedModel,
        values: Mapping[str, float] | None = None,
        options: PlantOptions = USUAL,
    ) -> None:
        self._stepped = model if isinstance(model, SteppedModel) else SteppedModel(model)
        self.model = self._stepped.model
        super().__init__(self.model.channels, options, f"a plant ({type(self.model).__name__})")
        self._values = self._stepped.vector(values or {})
        self._history = self._stepped.history()

    def restart(self, q: Vector) -> Vector:
        """The state at rest at positions, internal states as the model expects."""
        self._history.reset()
        return self._stepped.start(q, np.zeros(len(q)), self._values)

    def advance(self, u: Vector) -> Vector:
        """The state a period later."""
        return self._stepped.step(self.state, self._history.add(u), self._values)


def system_plant(
    system: AnySystem,
    dt: float,
    values: Mapping[str, float] | None = None,
    options: PlantOptions = USUAL,
    substeps: int = 10,
) -> ModelPlant:
    """A Lagrangian system as a plant, with its own parameters.

    Args:
        system: the system, the name of a packaged one, or a system file, which is run.
        dt: sampling period [s].
        values: values of its parameters, nominal where there are none.
        options: of its encoders and inputs.
        substeps: integration steps in a period.

    Raises:
        InputError: no such system, or parameters that it does not have.
    """
    loaded = load_system(system)
    nominal = {name: jnp.asarray(value, jnp.float64) for name, value in loaded.nominal().items()}
    return ModelPlant(discretise(loaded.model(nominal), dt, substeps), values, options)


def qube_twin(
    values: Mapping[str, float] = TWIN_VALUES, options: PlantOptions = USUAL
) -> ModelPlant:
    """The twin of the Qube-Servo 2 as a plant, sampled at 100 Hz through its encoders.

    Args:
        values: values of its parameters, those of the demo's twin where there are none.
        options: of its encoders and inputs.
    """
    coordinates = tuple(replace(c, resolution=COUNT) for c in WITH_MEMORY.coordinates)
    twin = replace(WITH_MEMORY, coordinates=coordinates)
    return system_plant(twin, 0.01, {**TWIN_VALUES, **values}, options)


def load_rivals(
    model: str | Path, system: AnySystem | None = None, *, as_good: bool = False
) -> list[Model]:
    """The other candidates with equations of motion of the selection that chose a model.

    A network may hold nothing else than itself: forces of physics say what inputs do elsewhere. And
    what follows the records about as well says what they do not tell, as a lag of the inputs.

    Args:
        model: the file of the chosen model.
        system: the system of the candidates, where one was given; None for the copies that are
            kept with them.
        as_good: whether only those are taken that are at most twice as far off as the model.

    Returns:
        Those that follow the records better than a trivial predictor, or, if they are to be
        `as_good`, about as well as the model; none of a model that is from no selection.
    """
    loaded = [
        load_model(path, system if read_system_name(path) else None)
        for path in find_rivals(Path(model), as_good=as_good)
    ]
    return [one for one in loaded if equations_in(one) is not None]


def load_plant(
    which: str | Path,
    channels: Channels,
    values: Mapping[str, float] | None = None,
    options: PlantOptions = USUAL,
    system: AnySystem | None = None,
) -> SampledPlant:
    """A plant by name or from a file, which must have the channels of a model.

    Args:
        which: a model file, a system file or the name of a packaged system (nominal values), an
            FMU, or `qube-servo2-twin`.
        channels: of the model that the controller was made with.
        values: values of the plant's parameters that are others.
        options: of its encoders and inputs.
        system: the system of a model file that needs one.

    Raises:
        InputError: no such file or name, a plant with other channels, parameters that it does not
            have.
    """
    path = Path(which)
    plant: SampledPlant
    if path.suffix == ".fmu":
        plant = FmuPlant(path, channels, values, options)
    elif path.suffix in MODEL_ENDINGS:
        plant = ModelPlant(load_model(path, system), values, options)
    elif str(which) == TWIN_NAME:
        plant = qube_twin(values or {}, options)
    else:
        plant = system_plant(str(which), channels.dt, values, options)
    channels.require_same(plant.channels, f"plant {which}", "the model")
    return plant
