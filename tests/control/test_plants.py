"""Plants: encoders, saturation and delays about models, systems and FMUs."""

import jax.numpy as jnp
import numpy as np
import pytest
from every_family import example, example_source
from swinging import SWING

import tustinnet as tn
from tustinnet.control import plants
from tustinnet.control.plants import ModelPlant, load_plant, qube_twin, system_plant
from tustinnet.control.sampled_plant import PlantOptions
from tustinnet.control.stepped_model import SteppedModel
from tustinnet.errors import InputError
from tustinnet.export.fmu import FILES, Fmu
from tustinnet.systems.qube_servo2_twin import COUNT, TWIN_VALUES

DRIVE = np.sin(np.arange(40) / 5)[:, None]


def driven(plant, q: list[float], seed: int = 0) -> np.ndarray:
    plant.reset(np.array(q), seed)
    states = [plant.state]
    for u in DRIVE:
        plant.apply(u)
        states.append(plant.state)
    return np.stack(states)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["qube memory", "qube hybrid", "qube network", "gru"])
def test_a_model_is_its_rollout(name):
    model = example(name)
    q = [0.2] * model.channels.n_q
    states = driven(ModelPlant(model), q)
    expected = np.asarray(tn.rollout(model, states[0], DRIVE))
    np.testing.assert_allclose(states, expected, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("name", ["qube memory", "qube hybrid"])
def test_one_machine_code_serves_other_parameters(name):
    stepped = SteppedModel(example(name))
    heavy = {"pendulum_mass": 0.04}
    own, other = (driven(ModelPlant(stepped, values), [0.1, 3.0]) for values in ({}, heavy))
    assert np.abs(own - other).max() > 1e-3
    again = driven(ModelPlant(stepped), [0.1, 3.0])
    np.testing.assert_array_equal(again, own)
    with pytest.raises(InputError, match=r"parameter mass = 1\.0; expected finite values of arm"):
        ModelPlant(stepped, {"mass": 1.0})


def test_encoders_count_from_a_random_place():
    plant = ModelPlant(example("qube"), options=PlantOptions(counts=[0.1, 0.0]))
    offsets = set()
    for seed in range(3):
        plant.reset(np.array([0.33, 3.0]), seed)
        y = plant.measure()
        assert y[1] == 3.0
        assert abs(y[0] - 0.33) <= 0.05
        offsets.add(y[0] % 0.1)
        plant.reset(np.array([0.33, 3.0]), seed)
        np.testing.assert_array_equal(plant.measure(), y)
    assert len(offsets) == 3
    noisy = ModelPlant(example("qube"), options=PlantOptions(noise=0.01))
    noisy.reset(np.zeros(2), 0)
    read = np.stack([noisy.measure() for _ in range(500)])
    np.testing.assert_allclose(read.std(axis=0), 0.01, rtol=0.1)


def test_inputs_saturate_and_act_late():
    model = example("qube")
    late = ModelPlant(model, options=PlantOptions(delay=2, limits=[[-1.0, 0.5]]))
    late.reset(np.zeros(2), 0)
    applied = []
    for u in (3.0, -4.0, 0.2, 0.0, 0.0):
        late.apply(np.array([u]))
        applied.append(float(late.applied[0]))
    assert applied == [0.0, 0.0, 0.5, -1.0, 0.2]
    disturbed = ModelPlant(model, options=PlantOptions(disturbance=[0.0, 0.1]))
    assert np.abs(driven(disturbed, [0.0, 3.0]) - driven(ModelPlant(model), [0.0, 3.0])).max() > 0.1


def test_the_twin_is_that_of_the_demo():
    plant = qube_twin()
    assert plant.dt == 0.01
    np.testing.assert_array_equal(plant.channels.resolution, [COUNT, COUNT])
    values = {name: jnp.asarray(value) for name, value in TWIN_VALUES.items()}
    model = tn.discretise(tn.load_system("qube-servo2-memory").model(values), 0.01, 10)
    states = driven(plant, [0.1, 3.0])
    np.testing.assert_allclose(
        states, np.asarray(tn.rollout(model, states[0], DRIVE)), rtol=1e-9, atol=1e-11
    )
    heavier = qube_twin({"pendulum_mass": 0.03})
    assert np.abs(driven(heavier, [0.1, 3.0]) - states).max() > 1e-3


def test_a_plant_is_loaded_by_name_or_file(tmp_path):
    channels = example("qube").channels
    assert isinstance(load_plant("qube-servo2-twin", channels), ModelPlant)
    assert load_plant("qube-servo2", channels, {"arm_mass": 0.1}).dt == channels.dt
    file = tmp_path / "model.safetensors"
    tn.save(example("qube memory"), file)
    np.testing.assert_allclose(
        driven(load_plant(file, channels), [0.1, 3.0]),
        driven(ModelPlant(example("qube memory")), [0.1, 3.0]),
    )
    with pytest.raises(InputError, match=r"coordinates theta .* as in the model"):
        load_plant("qube-servo2-twin", example("physics").channels)
    with pytest.raises(InputError, match="no such system"):
        load_plant("nothing", channels)
    own = system_plant(SWING, 0.02, {"gravity": 0.0})
    assert np.abs(driven(own, [1.0])).max() < 1.3


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_is_the_model_that_it_was_made_of(version, tmp_path):
    pytest.importorskip("fmpy")
    source = example_source("qube hybrid")
    content = Fmu().files(source)[FILES[version]]
    assert isinstance(content, bytes)
    file = tmp_path / FILES[version]
    file.write_bytes(content)
    plant = load_plant(file, source.channels, options=PlantOptions(delay=1))
    own = ModelPlant(example("qube hybrid"), options=PlantOptions(delay=1))
    for _ in range(2):
        states = driven(own, [0.1, 3.0])[:, :4]
        np.testing.assert_allclose(driven(plant, [0.1, 3.0]), states, rtol=1e-8, atol=1e-10)
    with pytest.raises(InputError, match="no variable 'x'"):
        load_plant(file, example("cart").channels)
    file.write_bytes(content[:1000])
    with pytest.raises(InputError, match="no FMU that can be read"):
        load_plant(file, source.channels)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (PlantOptions(delay=-1), "a delay of -1 samples"),
        (PlantOptions(noise=-0.1), "noise -0.1; expected numbers from 0 on"),
        (PlantOptions(counts=[0.1]), "expected 2 finite numbers"),
        (PlantOptions(limits=[[1.0, 0.0]]), "of 1 inputs"),
    ],
)
def test_options_that_mean_nothing_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        ModelPlant(example("qube"), options=options)


def test_without_fmpy_an_fmu_is_refused(monkeypatch, tmp_path):
    monkeypatch.setattr("tustinnet.errors.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"tustinnet\[fmu\]"):
        plants.FmuPlant(tmp_path / "arm.fmu", example("qube").channels)
