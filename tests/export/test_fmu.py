"""FMUs made of a model, taken by fmpy as any simulator would take them."""

import io
import shutil
import subprocess
import zipfile
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave
from fmpy.model_description import read_build_description
from fmpy.validation import validate_fmu
from held_swings import KD, KP, held_swings
from swinging import CREEPING, DT, SWING, swing_model

import tustinnet as tn
from tustinnet.export.check import check_export
from tustinnet.export.fmu import FILES, TARGET
from tustinnet.export.source import Source, make_source
from tustinnet.export.target import NotRunnable
from tustinnet.models.closed_loop import with_controller
from tustinnet.program.numbers import run

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")

fmpy = import_module("fmpy")  # its types allow None where a model description has none
HOSTILE = 'a<b&"c'
VERSIONS = (2, 3)
# differential equations, integrated in such small steps that the steps do not matter
EXACT = {f"exact {name}": name for name in ("physics", "first-order", "neural ode")}
# models whose inputs act late: hold and delay [periods]
LATE = {"late": ("zero-order", 2.5), "late lines": ("first-order", 1.25)}


@cache
def source(name: str) -> Source:
    if name == "free":  # of no inputs
        system = replace(SWING, inputs=(), input_map=lambda q, v, u, p: 0.0 * v)
        return make_source(tn.discretise(swing_model(system=system), DT))
    if name == "hostile":
        angle = replace(SWING.coordinates[0], name=HOSTILE)
        voltage = tn.Input(f"der_{HOSTILE}", "<V>")
        system = replace(SWING, coordinates=(angle,), inputs=(voltage,))
        return make_source(tn.discretise(swing_model(system=system), DT))
    if name in LATE:
        inputs = (replace(SWING.inputs[0], hold=LATE[name][0], delay=LATE[name][1] * DT),)
        return make_source(tn.discretise(swing_model(system=CREEPING), DT, inputs=inputs))
    if name in EXACT:
        return make_source(replace(example(EXACT[name]), substeps=8))
    return make_source(example(name))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folders with both FMUs of a model, by name."""

    @cache
    def write(name: str) -> Path:
        folder = tmp_path_factory.mktemp("fmu")
        for file, content in TARGET.files(source(name)).items():
            assert isinstance(content, bytes)
            (folder / file).write_bytes(content)
        return folder

    return write


def inputs(of: Source, samples: int) -> np.ndarray:
    return np.sin(np.arange(samples)[:, None] / 10 + np.arange(of.channels.n_u))


def start(of: Source) -> np.ndarray:
    return np.r_[np.full(of.channels.n_q, 0.1), np.zeros(of.n_x - of.channels.n_q)]


def simulated(file: Path, of: Source, u: np.ndarray, every: int = 1) -> np.ndarray:
    """The states at the communication points, as `fmpy.simulate_fmu` gives them."""
    times = np.arange(len(u)) * of.channels.dt
    names = [i.name for i in of.channels.inputs]
    signals = np.zeros(len(u), [(name, float) for name in ("time", *names)])
    for i, name in enumerate(("time", *names)):
        signals[name] = np.c_[times, u][:, i]
    found = fmpy.simulate_fmu(
        str(file),
        start_values=dict(zip(of.states, start(of), strict=True)),
        output=of.states,
        input=signals if names else None,
        stop_time=times[-1],
        output_interval=every * of.channels.dt,
    )
    return np.stack([found[name] for name in of.states], axis=1)


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", ["qube network", "qube hybrid", "actuator lag", "free"])
def test_a_simulation_is_the_rollout(name, version, written):
    of = source(name)
    u = inputs(of, 501)
    expected = np.asarray(tn.rollout(of.model, start(of), u[:-1]))
    found = simulated(written(name) / FILES[version], of, u)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", LATE)
def test_inputs_that_act_late_do_so(name, version, written):
    of = source(name)
    u = inputs(of, 101) + 1.0  # not 0 at the beginning, before which it was the same
    expected = np.asarray(tn.rollout(of.model, start(of), tn.input_signal(of.model, run_of(of, u))))
    found = simulated(written(name) / FILES[version], of, u)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def run_of(of: Source, u: np.ndarray) -> tn.Experiment:
    """A record of inputs."""
    channels = of.channels
    return tn.from_arrays(
        np.zeros((len(u), channels.n_q)),
        u,
        dt=channels.dt,
        coordinates=channels.coordinates,
        inputs=channels.inputs,
        name="run",
    )


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", ["qube hybrid", "hybrid", "gru", "free", "hostile"])
def test_an_importer_finds_nothing_wrong(name, version, written):
    file = written(name) / FILES[version]
    assert validate_fmu(str(file)) == []
    read = fmpy.read_model_description(str(file))
    of = source(name)
    units = {v.name: v.unit for v in read.modelVariables if v.causality == "output"}
    assert units == {n: unit or None for n, unit in zip(of.states, of.units, strict=True)}
    kinds = [v.name for v in read.modelVariables if v.causality == "input"]
    named = [i.name for i in of.channels.inputs]
    # the input of the hostile one is called as a velocity already
    assert kinds == ([f"{n}_2" for n in named] if name == "hostile" else named)
    assert float(read.defaultExperiment.stepSize) == of.channels.dt
    if version == 3:
        assert float(read.coSimulation.fixedInternalStepSize) == of.channels.dt
        (configuration,) = read_build_description(str(file))
        files = configuration.sourceFileSets[0].sourceFiles
        assert files == ["model.c", "fmu.c", "fmi3.c"]


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
def test_a_communication_step_of_several_periods_holds_the_input(version, written):
    of = source("qube network")
    u = inputs(of, 41)
    held = np.repeat(u[::4], 4, axis=0)[:40]
    expected = np.asarray(tn.rollout(of.model, start(of), held))[::4]
    found = simulated(written("qube network") / FILES[version], of, u, every=4)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


class Instance:
    """An FMU of either version, with the messages that it logs."""

    def __init__(self, folder: Path, of: Source, version: int, token: str | None = None) -> None:
        self.said: list[str] = []
        self.of = of
        unzipped = folder / f"unzipped{version}"
        if not unzipped.is_dir():
            fmpy.extract(str(folder / FILES[version]), str(unzipped))
        read = fmpy.read_model_description(str(unzipped))
        self.fmu: Any = (FMU2Slave if version == 2 else FMU3Slave)(
            guid=token or read.guid,
            unzipDirectory=str(unzipped),
            modelIdentifier="model",
            instanceName="one",
        )
        self.version = version
        if version == 2:
            callbacks = fmi2CallbackFunctions()
            callbacks.logger = fmi2CallbackLoggerTYPE(self._heard)
            self.fmu.instantiate(callbacks=callbacks)
        else:
            self.fmu.instantiate(logMessage=self._heard)

    def _heard(self, *told) -> None:
        self.said.append(" ".join(str(part) for part in told))

    def begin(self, x0: np.ndarray) -> "Instance":
        if self.version == 2:
            self.fmu.setupExperiment()
        self._set(range(self.of.n_x), x0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def _set(self, references, values) -> None:
        setter = self.fmu.setReal if self.version == 2 else self.fmu.setFloat64
        setter(list(references), [float(v) for v in values])

    def x(self) -> np.ndarray:
        getter = self.fmu.getReal if self.version == 2 else self.fmu.getFloat64
        return np.array(getter(list(range(self.of.n_x))))

    def step(self, u: np.ndarray, *, slope: np.ndarray | None = None, periods: float = 1.0):
        references = range(self.of.n_x, self.of.n_x + self.of.channels.n_u)
        self._set(references, u)
        if slope is not None:
            self.fmu.setRealInputDerivatives(list(references), [1] * len(slope), list(slope))
        size = periods * self.of.channels.dt
        self.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=size)
        return self.x()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["first-order", "hybrid"])
def test_what_an_importer_tells_of_later_inputs_is_used(name, written):
    of, u = source(name), inputs(source(name), 60)
    expected = np.asarray(tn.rollout(of.model, start(of), tn.input_signal(of.model, run_of(of, u))))
    instance = Instance(written(name), of, 2).begin(start(of))
    for k in range(59):
        found = instance.step(u[k], slope=(u[k + 1] - u[k]) / of.channels.dt)
        np.testing.assert_allclose(found, expected[k + 1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("version", VERSIONS)
def test_otherwise_later_inputs_are_held_and_earlier_ones_remembered(version, written):
    of, u = source("hybrid"), inputs(source("hybrid"), 20)
    assert of.input_layout.offsets == (0, 1, -1)
    instance, x = Instance(written("hybrid"), of, version).begin(start(of)), start(of)
    for k in range(20):
        x = run(of.step, x=x, u=np.concatenate([u[k], u[k], u[max(k - 1, 0)]]))["x"]
        np.testing.assert_allclose(instance.step(u[k]), x, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("periods", [1.0, 0.7])
def test_states_are_taken_put_back_written_down_and_reset(version, periods, written):
    of = source("hybrid")
    u = inputs(of, 20)
    one, two = (Instance(written("hybrid"), of, version).begin(start(of)) for _ in range(2))
    course = [one.step(v, periods=periods) for v in u]
    for v in u[:10]:
        two.step(v, periods=periods)
    kept = two.fmu.getFMUState()
    np.testing.assert_array_equal(two.step(u[10], periods=periods), course[10])
    words = two.fmu.serializeFMUState(kept)
    two.step(5 * u[3])
    two.fmu.setFMUState(kept)  # with the inputs of the past
    np.testing.assert_array_equal(two.step(u[10], periods=periods), course[10])
    two.fmu.freeFMUState(kept)

    three = Instance(written("hybrid"), of, version).begin(0 * start(of))
    three.fmu.setFMUState(three.fmu.deserializeFMUState(words))
    np.testing.assert_array_equal(three.step(u[10], periods=periods), course[10])
    three.fmu.reset()
    np.testing.assert_array_equal(three.x(), 0 * start(of))
    three.begin(start(of))
    np.testing.assert_array_equal([three.step(v, periods=periods) for v in u], course)
    for instance in (one, two, three):
        instance.fmu.terminate()
        instance.fmu.freeInstance()


LENGTHS = [0.3, 1.0, 1.7, 10.0]  # of communication steps [periods]
TENTHS = 10  # of a period


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("periods", LENGTHS)
@pytest.mark.parametrize("name", EXACT)
def test_equations_are_integrated_over_steps_of_any_length(name, periods, version, written):
    of, u = source(name), inputs(source(name), 10)
    assert of.integrates
    fine = tn.discretise(of.model.continuous, of.channels.dt / TENTHS)  # pyright: ignore[reportAttributeAccessIssue]
    turns = round(TENTHS * periods)
    expected = np.asarray(tn.rollout(fine, start(of), np.repeat(u, turns, axis=0)))[::turns]
    instance = Instance(written(name), of, version).begin(start(of))
    found = [instance.step(v, periods=periods) for v in u]
    np.testing.assert_allclose(found, expected[1:], rtol=0, atol=1e-8)


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("periods", LENGTHS)
@pytest.mark.parametrize("name", ["network memory", "qube hybrid", "late"])
def test_after_whole_periods_means_of_the_inputs_have_acted(name, periods, version, written):
    of, u = source(name), inputs(source(name), 10)
    u[:4] = u[0]  # over the first period, before which it was the same
    turns = round(TENTHS * periods)
    means = np.repeat(u, turns, axis=0).reshape(-1, TENTHS, of.channels.n_u).mean(axis=1)
    last = means[-1:]  # the end of the record is the end of the last period
    signal = tn.input_signal(of.model, run_of(of, np.concatenate([means, last])))
    expected = np.asarray(tn.rollout(of.model, start(of), signal))[-1]
    instance = Instance(written(name), of, version).begin(start(of))
    *_, found = (instance.step(v, periods=periods) for v in u)
    # equations are integrated in other steps
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6 if of.integrates else 1e-9)


def test_a_controller_in_the_loop_computes_at_its_own_samples(tmp_path):
    (record,) = held_swings(1)
    gains = tuple(
        tn.Parameter(f"angle.{name}", "1", value, value, value, fixed=True)
        for name, value in (("kp", KP), ("kd", KD))
    )
    closed = with_controller(SWING, record.channels, gains)
    model = closed.model({name: jnp.asarray(x) for name, x in closed.nominal().items()})
    of = make_source(tn.discretise(model, DT, inputs=record.inputs))
    assert not of.integrates
    for file, content in TARGET.files(of).items():
        assert isinstance(content, bytes)
        (tmp_path / file).write_bytes(content)
    x0, w = np.array([3.4, 0.3]), np.array([3.5, 0.1, 0.2])
    whole = Instance(tmp_path, of, 3).begin(x0).step(w)
    parts = Instance(tmp_path, of, 3).begin(x0)
    found = [parts.step(w, periods=0.25) for _ in range(4)]
    np.testing.assert_allclose(found[-1], whole, rtol=1e-12)


def test_between_the_samples_of_a_network_the_acceleration_is_constant(written):
    of = source("network memory")
    n_q, dt, x0 = of.channels.n_q, of.channels.dt, start(of)
    end = Instance(written("network memory"), of, 3).begin(x0).step(np.ones(1))
    found = Instance(written("network memory"), of, 3).begin(x0).step(np.ones(1), periods=0.3)
    v, rise = x0[n_q : 2 * n_q], (end - x0)[n_q : 2 * n_q]
    position = x0[:n_q] + dt * (0.3 * v + 0.3**2 / 2 * rise)
    np.testing.assert_allclose(found[: 2 * n_q], np.r_[position, v + 0.3 * rise], rtol=1e-12)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("periods", [0.0, -1.0, np.nan, np.inf])
def test_a_step_that_takes_no_time_is_refused(version, periods, written):
    of = source("qube network")
    instance = Instance(written("qube network"), of, version).begin(start(of))
    with pytest.raises(FMICallException):
        instance.step(np.ones(1), periods=periods)
    (told,) = instance.said
    assert "the communication step is no positive number" in told
    np.testing.assert_array_equal(instance.x(), start(of))  # nothing has happened


@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_not_there_is_refused_with_a_message(version, written):
    of = source("qube network")
    instance = Instance(written("qube network"), of, version)
    with pytest.raises(FMICallException):
        instance.step(np.ones(1))  # before it is initialised
    instance.begin(start(of))
    for references in ([0], [99]):  # a state, later; a variable that there is not
        with pytest.raises(FMICallException):
            instance._set(references, [1.0])
    assert ["initialisation" in told for told in instance.said] == [True, True, False]
    with pytest.raises(Exception, match="instantiate"):
        Instance(written("qube network"), of, version, token="{another}")


@pytest.mark.parametrize("version", VERSIONS)
def test_parameters_are_read_by_name_and_cannot_be_set(version, written):
    of = source("qube hybrid")
    read = fmpy.read_model_description(str(written("qube hybrid") / FILES[version]))
    known = {v.name: v for v in read.modelVariables if v.variability == "constant"}
    assert {n: (v.unit, float(v.start)) for n, v in known.items()} == {
        name: (unit or None, value) for name, unit, value in of.parameters
    }
    assert known["hub_mass"].unit == "kg"
    instance = Instance(written("qube hybrid"), of, version).begin(start(of))
    getter = instance.fmu.getReal if version == 2 else instance.fmu.getFloat64
    references = [v.valueReference for v in known.values()]
    assert list(getter(references)) == [value for _, _, value in of.parameters]
    with pytest.raises(FMICallException):
        instance._set(references[:1], [1.0])
    assert "constants of the model" in instance.said[-1]
    with pytest.raises(FMICallException):
        getter([max(references) + 1])


def test_the_same_model_gives_the_same_bytes(written):
    again = TARGET.files(make_source(example("hybrid")))
    for name, content in again.items():
        assert content == (written("hybrid") / name).read_bytes()
    token = {
        name: told(content).get("guid") or told(content).get("instantiationToken")
        for name, content in again.items()
    }
    other = TARGET.files(source("first-order"))["model-fmi2.fmu"]
    assert len(set(token.values())) == 1
    assert told(other).get("guid") not in token.values()


def told(content: bytes | str) -> Xml.Element:
    assert isinstance(content, bytes)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return Xml.fromstring(archive.read("modelDescription.xml"))


@pytest.mark.thorough
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", ["qube hybrid", "first-order"])
def test_it_is_built_again_from_its_own_sources(name, version, written, tmp_path):
    of = source(name)
    fmpy.extract(str(written(name) / FILES[version]), str(tmp_path / "fmu"))
    sources = tmp_path / "fmu/sources"
    (library,) = (tmp_path / "fmu/binaries").glob("*/model.so")
    library.unlink()
    flags = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Werror -O1 -shared -fPIC"
    files = sorted(p.name for p in sources.glob("*.c"))
    subprocess.run(
        ["gcc", *flags.split(), *files, "-lm", "-o", str(library)], cwd=sources, check=True
    )
    u = inputs(of, 101)
    found, shipped = (
        simulated(file, of, u) for file in (tmp_path / "fmu", written(name) / FILES[version])
    )
    np.testing.assert_allclose(found, shipped, rtol=1e-9, atol=1e-9)


def test_the_binary_steps_as_the_model(written):
    of = source("hybrid")
    assert check_export(of, TARGET, TARGET.stepper(written("hybrid"), of)).difference < 1e-13


def test_without_a_compiler_it_has_sources_only(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    (done,) = tn.export_model(example("linear"), "fmu", tmp_path / "out")
    assert "no no-such-compiler here" in done.checked.note
    for name in FILES.values():
        with zipfile.ZipFile(tmp_path / "out" / name) as archive:
            assert not [n for n in archive.namelist() if n.startswith("binaries")]
            assert "sources/model.c" in archive.namelist()
        assert validate_fmu(str(tmp_path / "out" / name)) == []


@pytest.mark.parametrize("name", ["time", "der_time"])
def test_no_two_variables_have_the_name_of_a_channel_that_is_called_time(name, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)  # sources only
    angle = replace(SWING.coordinates[0], name="time")
    voltage = tn.Input(name, "V") if name != "time" else replace(SWING.inputs[0], name="u")
    for system in (
        replace(SWING, coordinates=(angle,), inputs=(voltage,)),
        replace(SWING, inputs=(tn.Input("time", "V"),)),
    ):
        files = TARGET.files(make_source(tn.discretise(swing_model(system=system), DT)))
        for content in files.values():
            assert isinstance(content, bytes)
            description = zipfile.ZipFile(io.BytesIO(content)).read("modelDescription.xml").decode()
            variables = Xml.fromstring(description).find("ModelVariables")
            assert variables is not None
            names = [v.get("name") for v in variables]
            assert len(set(names)) == len(names)
            assert "time_2" in names
            assert "'time' is called 'time_2' here." in description


def test_elsewhere_it_has_sources_only(tmp_path, monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    for name, content in TARGET.files(source("free")).items():
        assert isinstance(content, bytes)
        (tmp_path / name).write_bytes(content)
    with pytest.raises(NotRunnable, match="binaries are made on Linux on x86-64"):
        TARGET.stepper(tmp_path, source("free"))
