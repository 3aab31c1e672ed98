"""FMUs as plants, run by fmpy."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from tustinnet.channels import Channels
from tustinnet.control.sampled_plant import USUAL, PlantOptions, SampledPlant
from tustinnet.errors import InputError, convert_errors, require_package

Vector = Float[np.ndarray, " _"]


class FmuPlant(SampledPlant):
    """An FMU for co-simulation, of FMI 2.0 or 3.0, as a plant; it needs the package fmpy.

    It has an input for each input and an output for each coordinate, of their names. Outputs of
    the names `der_COORDINATE` are its velocities; without them the true velocities are unknown.

    Args:
        file: the FMU.
        channels: the coordinates, inputs and sampling period.
        values: start values of its parameters.
        options: of its encoders and inputs.

    Raises:
        InputError: fmpy is not installed; no FMU for co-simulation; inputs, outputs or parameters
            that it does not have.
    """

    def __init__(
        self,
        file: str | Path,
        channels: Channels,
        values: Mapping[str, float] | None = None,
        options: PlantOptions = USUAL,
    ) -> None:
        super().__init__(channels, options, f"plant {file}")
        require_package("fmpy", "fmu", f"plant {file}")
        if self._disturbance.any():
            raise InputError(f"plant {file}", "a disturbance of velocities", "none, of an FMU")
        import fmpy

        expected = "an FMU for co-simulation, of FMI 2.0 or 3.0"
        with convert_errors(file, "no FMU that can be read", expected):
            description: Any = fmpy.read_model_description(str(file))
        version = str(description.fmiVersion)[:1]
        if description.coSimulation is None or version not in "23":
            raise InputError(file, f"FMI {description.fmiVersion}, no co-simulation", expected)
        references = {v.name: v.valueReference for v in description.modelVariables}
        names = [c.name for c in channels.coordinates]
        self._values = dict(values or {})
        for name in (*names, *(i.name for i in channels.inputs), *self._values):
            if name not in references:
                raise InputError(file, f"no variable '{name}'", f"those of {', '.join(references)}")
        velocities = [f"der_{name}" for name in names]
        if not references.keys() >= set(velocities):
            velocities = []
        self._references, self._names = references, names
        self._outputs = [references[name] for name in (*names, *velocities)]
        self._inputs = [references[i.name] for i in channels.inputs]
        self._is_fmi3 = version == "3"
        self._folder = tempfile.TemporaryDirectory()
        with convert_errors(file, "an FMU that cannot be started", expected):
            folder = fmpy.extract(str(file), self._folder.name)
            self._slave: Any = fmpy.instantiate_fmu(folder, description, "CoSimulation")
        self._is_running = False

    def restart(self, q: Vector) -> Vector:
        """Starts it anew, with positions as start values."""
        if self._is_running:
            self._slave.reset()
        starts = {**dict(zip(self._names, q.tolist(), strict=True)), **self._values}
        if self._is_fmi3:
            self._slave.enterInitializationMode(startTime=0.0)
        else:
            self._slave.setupExperiment(startTime=0.0)
        with convert_errors(
            self._where, "a start that cannot be set", f"start values of {', '.join(starts)}"
        ):
            for name, value in starts.items():
                self._write([self._references[name]], [value])
        if not self._is_fmi3:
            self._slave.enterInitializationMode()
        self._slave.exitInitializationMode()
        self._is_running, self._time = True, 0.0
        state = self._read()
        if np.abs(state[: len(q)] - q).max(initial=0.0) > 1e-9:
            raise InputError(
                self._where, "outputs that are not their start values", f"{q} at the start"
            )
        return state

    def advance(self, u: Vector) -> Vector:
        """The state a period later."""
        self._write(self._inputs, u.tolist())
        self._slave.doStep(currentCommunicationPoint=self._time, communicationStepSize=self.dt)
        self._time += self.dt
        return self._read()

    def _write(self, references: list[int], values: list[float]) -> None:
        if self._is_fmi3:
            self._slave.setFloat64(references, values)
        else:
            self._slave.setReal(references, values)

    def _read(self) -> Vector:
        read = self._slave.getFloat64 if self._is_fmi3 else self._slave.getReal
        return np.array(read(self._outputs), float)

    def __del__(self) -> None:
        if slave := vars(self).get("_slave"):
            if self._is_running:
                slave.terminate()
            slave.freeInstance()
            self._folder.cleanup()
