"""Models as environments of Gymnasium."""

import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from documented import blocks
from every_family import CHANNELS, example, physics
from every_step import require_same_run
from gymnasium.utils.env_checker import check_env
from swinging import CREEPING, records

import tustinnet as tn
from tustinnet.export.environment import ModelEnv, ModelVectorEnv
from tustinnet.models.lagrangian import LagrangianSystem, Parameter
from tustinnet.models.physical_values import with_values
from tustinnet.simulate.range import KEY, recorded_range

ID = "tustinnet.gym:TustinNet-v0"
STATES = {"states": [[-3.0, 3.0], [-9.0, 9.0], [-4.0, 4.0]], "inputs": [[-5.0, 3.0]]}


def saved(folder: Path, name: str) -> Path:
    """A model file that says where its training records lie."""
    path = folder / "model.safetensors"
    model = example(name)
    tn.save(model, path, **{KEY: recorded_range(model, records()).as_header()})
    return path


def made(**options) -> ModelEnv:
    """An environment of a grey box that has one internal state."""
    given = {"model": example("physics"), "range": STATES, **options}
    found = gymnasium.make(ID, **given).unwrapped
    assert isinstance(found, ModelEnv)
    return found


def many(count: int, **options) -> ModelVectorEnv:
    given = {"model": example("physics"), "range": STATES, **options}
    found = gymnasium.make_vec(ID, count, **given)
    assert isinstance(found, ModelVectorEnv)
    return found


@pytest.mark.parametrize("name", ["network taps", "gru"])
def test_gymnasium_checks_it_without_a_warning(name, tmp_path):
    env = gymnasium.make(ID, model=saved(tmp_path, name), reward="swing-up")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    assert env.observation_space.shape == (example(name).state_size,)


def test_a_system_of_your_own_is_run_where_it_is_named(tmp_path):
    file = saved(tmp_path, "physics")
    with pytest.raises(tn.InputError, match="'creeping swing'"):
        gymnasium.make(ID, model=file)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(ID, model=file, system=CREEPING).unwrapped)


def test_an_episode_is_the_free_run_of_the_model():
    env, model = made(), example("physics")
    x0 = np.array([0.4, -0.3, 0.1])
    observed = [env.reset(seed=1, options={"x": x0})[0]]
    actions = np.random.default_rng(2).uniform(-1, 1, (30, 1))
    for action in actions:
        x, _, left, cut, _ = env.step(action)
        observed.append(x)
        assert (left, cut) == (False, False)
    inputs = -5.0 + (actions + 1) / 2 * 8.0
    expected = np.asarray(tn.rollout(model, x0, inputs))
    require_same_run(observed, expected)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["network taps", "first-order", "hybrid", "two", "late"])
def test_samples_seen_before_are_remembered_and_those_to_come_held(name):
    both = [example("network taps"), example("physics")]
    late = replace(CHANNELS, inputs=(replace(CHANNELS.inputs[0], delay=1.5 * CHANNELS.dt),))
    made_here = {"two": lambda: tn.committee(both), "late": lambda: physics(late)}
    model = made_here.get(name, lambda: example(name))().simplify()
    free = [[-9.0, 9.0]] * model.state_size
    env = made(model=model, range={"states": free, "inputs": [[-1, 1]]}, margin=100.0)
    x, actions = np.full(model.state_size, 0.1), np.array([0.5, -0.7, 0.2])
    env.reset(options={"x": x})
    for k, action in enumerate(actions):
        until = np.concatenate([actions[: k + 1], np.full(5, action)])  # as if it stayed
        record = tn.from_arrays(
            np.zeros(len(until)),
            until,
            dt=model.dt,
            coordinates=model.coordinates,
            inputs=model.inputs,
        )
        if name == "first-order":
            acting = np.array([[action], [0.0]])  # a straight line without a slope
        else:
            acting = tn.input_signal(model, record).u[k]
        x = np.asarray(model.step(jnp.asarray(x), jnp.asarray(acting)))
        np.testing.assert_allclose(env.step(np.array([action]))[0], x, rtol=1e-12, atol=1e-14)


def test_runs_of_the_same_seed_are_the_same_bit_for_bit():
    def run(env) -> list[np.ndarray]:
        env.action_space.seed(3)
        found = [env.reset(seed=3)[0]]
        for _ in range(40):
            found += [np.asarray(part) for part in env.step(env.action_space.sample())[:4]]
        return found

    for make in (made, lambda: many(5)):
        for first, again in zip(run(make()), run(make()), strict=True):
            assert first.tobytes() == again.tobytes()


def test_many_are_as_many_single_ones():
    envs, env = many(4), made()
    begun, _ = envs.reset(seed=0)
    generator = np.random.default_rng(1)
    running, alive = begun.copy(), np.ones(4, bool)
    assert envs.observation_space.contains(begun)
    for _ in range(10):
        actions = generator.uniform(-1, 1, (4, 1))
        found, rewards, left, cut, infos = envs.step(actions)
        assert (infos, cut.any()) == ({}, False)
        for i in np.flatnonzero(alive):
            env.reset(options={"x": running[i]})
            x, reward, ended, _, _ = env.step(actions[i])
            np.testing.assert_allclose(found[i], x, rtol=1e-12)
            assert (rewards[i], left[i]) == (pytest.approx(reward), ended)
        running, alive = found, alive & ~left


def test_those_that_end_start_anew_one_step_later():
    envs = many(3, start=[0.0, 0.0], noise=0.0, max_episode_steps=4)
    begun, _ = envs.reset(seed=0)
    still = np.zeros((3, 1))
    for _ in range(3):
        x, *_, cut, _ = envs.step(still)
        assert not cut.any()
    x, _, left, cut, _ = envs.step(still)
    assert (cut.all(), left.any()) == (True, False)
    assert not np.array_equal(x, begun)
    again, rewards, left, cut, _ = envs.step(still)
    np.testing.assert_array_equal(again, begun)
    assert not np.any([rewards, left, cut])
    assert not envs.step(still)[3].any()


def test_an_episode_ends_out_of_the_range_and_what_is_observed_stays_in():
    env = made(start=[2.9, 8.0], noise=0.0, margin=0.2)
    env.reset(seed=0)
    high = np.array([3.0 + 1.2, 9.0 + 3.6, 4.0 + 1.6])
    np.testing.assert_allclose(env.rules.bounds, np.stack([-high, high], axis=1))
    ends = []
    while not any(ends) and len(ends) < 60:
        x, _, left, _, _ = env.step(np.array([1.0]))
        assert x in env.observation_space
        ends.append(left and x[0] == env.rules.bounds[0, 1])
    assert ends[-1]


def test_a_model_that_leaves_all_numbers_ends_its_episode():
    env = made(model=physics(inertia=1e-300), start=[1.0, 0.0])
    before, _ = env.reset(seed=0)
    x, _, left, _, _ = env.step(np.array([0.3]))
    assert left
    assert x in env.observation_space
    assert np.isfinite(before).all()


def test_actions_stand_for_the_range_of_the_inputs_within_their_limits():
    limited = replace(CHANNELS, inputs=(tn.Input("voltage", "V", limits=(-2.0, 12.0)),))
    seen = []

    def noted(x, u, following) -> float:
        seen.append(u[0])
        return 0.5

    env = made(model=replace(physics(), channels=limited), reward=noted)
    env.reset(seed=0)
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)
    rewards = [env.step(np.array([action]))[1] for action in (-1.0, 0.0, 1.0, 7.0)]
    np.testing.assert_allclose(seen, [-2.0, 0.5, 3.0, 3.0])
    assert rewards == [0.5] * 4


def test_rewards_by_name():
    still = np.array([-1.0 + 2 * 5 / 8])  # 0 V
    held = made(start=[0.7, 0.0], noise=0.0)
    held.reset(seed=0)
    x, reward, *_ = held.step(still)
    assert reward == pytest.approx((1 + np.cos(x[0] - 0.7)) / 2, rel=1e-12)
    swung = made(reward="swing-up", target=[np.pi])
    swung.reset(options={"x": [0.2, 0.0]})
    x, reward, *_ = swung.step(still)
    assert reward == pytest.approx((1 + np.cos(x[0] - np.pi)) / 2, rel=1e-12)
    assert reward < 0.05
    cart, free = example("cart"), {"states": [[-2.0, 2.0]] * 4, "inputs": [[-1.0, 1.0]]}
    both = made(model=cart, range=free, target=[0.5, 0.1])
    both.reset(options={"x": [0.4, 0.3, 0.0, 0.0]})
    x, reward, *_ = both.step(np.zeros(1))
    near = (1 - ((x[0] - 0.5) / 4) ** 2) * (1 + np.cos(x[1] - 0.1)) / 2
    assert reward == pytest.approx(near, rel=1e-12)


def test_starts_lie_within_the_range_or_near_what_is_given():
    anywhere = np.concatenate([many(500).reset(seed=seed)[0] for seed in (0, 1)])
    np.testing.assert_allclose(anywhere[:, :2].min(0), [-3, -9], atol=0.1)
    np.testing.assert_allclose(anywhere[:, :2].max(0), [3, 9], atol=0.1)
    assert not anywhere[:, 2].any()  # internal states begin at 0, as along records
    near = many(500, start=[0.5, 1.0, -0.2], noise=0.05).reset(seed=0)[0]
    np.testing.assert_allclose(near.min(0), [0.5 - 0.3, 1.0 - 0.9, -0.2 - 0.4], atol=0.02)


RADIUS, STIFFNESS = 0.02, 1e5  # of the pulley [m], of the belt [N/m]
BELT = LagrangianSystem(
    name="belt drive",
    coordinates=(tn.Coordinate("motor", "angular"), tn.Coordinate("carriage", "linear")),
    inputs=(tn.Input("torque", "N m"),),
    parameters=(Parameter("inertia", "kg m^2", 1e-4, 1e-5, 1e-3),),
    kinetic=lambda q, v, p: p["inertia"] * v[0] ** 2 / 2 + v[1] ** 2 / 2,
    potential=lambda q, p: STIFFNESS * (q[1] - RADIUS * q[0]) ** 2 / 2,
    dissipation=lambda q, v, p: (
        jnp.stack([1e-3 * v[0], 5.0 * v[1]])
        + 20.0 * (v[1] - RADIUS * v[0]) * jnp.array([-RADIUS, 1.0])
    ),
    input_map=lambda q, v, u, p: jnp.stack([u[0], 0.0 * u[0]]),
)


def belt_force(x: np.ndarray) -> np.ndarray:
    """The force in the belt at states [N]."""
    return np.abs(STIFFNESS * (x[:, 1] - RADIUS * x[:, 0]))


@pytest.fixture(scope="module")
def belt_file(tmp_path_factory) -> Path:
    """The file of a motor that moves a carriage by a stiff belt, several turns far."""
    model = tn.discretise(BELT.model({"inertia": jnp.asarray(1e-4)}), 0.01, 40)
    runs = []
    for seed in (0, 1):
        u = np.repeat(np.random.default_rng(seed).uniform(-0.5, 0.5, 20), 20)
        q = np.asarray(tn.rollout(model, np.zeros(4), u[:, None]))[:-1, :2]
        runs.append(tn.from_arrays(q, u, dt=0.01, coordinates=BELT.coordinates, inputs=BELT.inputs))
    path = tmp_path_factory.mktemp("belt") / "model.safetensors"
    tn.save(model, path, **{KEY: recorded_range(model, runs).as_header()})
    return path


@pytest.mark.thorough
@pytest.mark.parametrize("start", [None, [5.0, 5.0 * RADIUS, 0.0, 0.0]])
def test_random_starts_do_not_stretch_a_stiff_belt(belt_file, start):
    envs = gymnasium.make_vec(ID, 300, model=belt_file, system=BELT, start=start).unwrapped
    assert isinstance(envs, ModelVectorEnv)
    rules = envs.rules
    recorded = rules.range.recorded_states
    assert recorded is not None
    assert rules.width[0] > 4 * np.pi
    largest = belt_force(recorded).max()
    x, _ = envs.reset(seed=0)
    assert belt_force(x).max() <= 1.001 * largest
    assert len(np.unique(x, axis=0)) > 100
    if start is None:
        assert np.isin(x, recorded).all()
    else:
        assert (np.abs(x - start) <= rules.noise * rules.width).all()
    ended = [envs.step(np.zeros((300, 1)))[2] for _ in range(3)]
    assert np.mean(np.any(ended, axis=0)) < 0.05
    # where no states are known, every coordinate is drawn by itself
    blind = {"states": rules.range.states, "inputs": rules.range.inputs}
    wild = gymnasium.make_vec(ID, 300, model=belt_file, system=BELT, start=start, range=blind)
    assert belt_force(wild.reset(seed=0)[0]).max() > 100 * largest


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"range": None}, "the range of the model's training records is unknown; .*give range="),
        ({"range": {"states": [[0, 1]], "inputs": []}}, "range: no range of the model"),
        ({"range": {**STATES, "recorded_states": []}}, "range: no range of the model"),
        ({"range": {**STATES, "recorded_states": [[0, np.nan]]}}, "range: no range of the model"),
        ({"range": {**STATES, "inputs": [[0, 0]]}}, "no input that the training records move"),
        ({"reward": "dance"}, "reward: 'dance'; expected a function, or one of hold, swing-up"),
        ({"target": [1, 2]}, "target: 2 numbers; expected 1 positions"),
        ({"start": [1.0]}, "start: 1 numbers; expected positions and velocities of 1"),
        ({"start": [7.0, 0.0]}, "start: angle = 7; expected -3.6 to 3.6"),
        ({"margin": 0.0}, "noise 0.01, margin 0.0"),
        ({"noise": -1.0}, "noise -1.0, margin 0.1"),
        ({"groups": {"load": "1kg"}}, "group 'load', which nothing"),
    ],
    ids=lambda part: next(iter(part)) if isinstance(part, dict) else "",
)
def test_what_cannot_be_asked_is_one_line(options, told):
    with pytest.raises(tn.InputError, match=told):
        made(**options)


@pytest.mark.parametrize("share", [True, 0.3])
def test_parameters_are_drawn_at_every_reset(share, identified):
    file = identified / "model.safetensors"
    estimates = tn.read_header(file)["identification"]["estimates"]
    free = [e["name"] for e in estimates if e["error"]]
    given = {
        "model": file,
        "system": identified / "system.py",
        "randomise": share,
        "start": [0.3, 0.0],
    }
    env = gymnasium.make(ID, **given).unwrapped
    assert isinstance(env, ModelEnv)
    drawn = [env.reset(seed=seed)[1] for seed in range(200)]
    nominal = env.rules.source.physical_values
    assert drawn[0].keys() == nominal.keys()
    assert drawn[0] == env.reset(seed=0)[1]
    for estimate in estimates:
        name, values = estimate["name"], np.array([d[estimate["name"]] for d in drawn])
        if share is True and name in free:
            assert np.std(values) == pytest.approx(estimate["error"], rel=0.3)
        elif share is not True:
            off = np.abs(values / nominal[name] - 1)
            assert 0.25 < off.max() < 0.3
    # what is simulated is the model with these values
    model = with_values(env.rules.source.model, {k: jnp.asarray(v) for k, v in drawn[7].items()})
    x, _ = env.reset(seed=7)
    following, *_ = env.step(np.array([0.5]))
    expected = model.step(jnp.asarray(x), jnp.asarray(env.rules.inputs_of([0.5])))
    np.testing.assert_allclose(following, expected, rtol=1e-12)
    own = env.rules.source.model.step(jnp.asarray(x), jnp.asarray(env.rules.inputs_of([0.5])))
    assert not np.allclose(following, own)


def test_many_have_parameters_of_their_own():
    envs = many(3, randomise=0.2, start=[0.5, 0.0, 0.0], noise=0.0)
    envs.reset(seed=1)
    first, *_ = envs.step(np.zeros((3, 1)))
    assert len({*first[:, 1].tolist()}) == 3


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"randomise": True}, "no errors of its parameters"),
        ({"randomise": 1.5}, "randomise: 1.5"),
        (
            {
                "randomise": 0.1,
                "model": example("network taps"),
                "range": {"states": [[-1.0, 1.0]] * 2, "inputs": [[-1.0, 1.0]]},
            },
            "without physical parameters",
        ),
    ],
    ids=("no errors", "more than all", "network"),
)
def test_parameters_that_nobody_knows_are_not_drawn(options, told):
    with pytest.raises(tn.InputError, match=told):
        made(**options)


def test_a_linear_system_has_nothing_to_swing_up():
    slide = tn.LagrangianSystem(
        name="slide",
        coordinates=(tn.Coordinate("x", "linear"),),
        inputs=(tn.Input("f", "N"),),
        parameters=(),
        kinetic=lambda q, v, p: v[0] ** 2 / 2,
        input_map=lambda q, v, u, p: u,
    )
    model = tn.discretise(slide.model({}), 0.01)
    free = {"states": [[-1, 1], [-1, 1]], "inputs": [[-1, 1]]}
    with pytest.raises(tn.InputError, match="'swing-up'; expected a model that has an angle"):
        made(model=model, range=free, reward="swing-up")


@pytest.mark.thorough
def test_it_computes_in_double_precision_where_jax_does_not(tmp_path):
    file = saved(tmp_path, "hybrid")
    program = f"""
import gymnasium, jax, numpy as np, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from swinging import CREEPING
env = gymnasium.make({ID!r}, model={str(file)!r}, system=CREEPING, max_episode_steps=3)
env.reset(seed=0, options={{"x": [0.3, 0.1, 0.05]}})
print(*env.step(np.array([0.4]))[0].tolist())
assert not jax.config.jax_enable_x64 and jax.numpy.ones(1).dtype == np.float32
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert jax.config.read("jax_enable_x64")
    env = gymnasium.make(ID, model=file, system=CREEPING).unwrapped
    env.reset(seed=0, options={"x": [0.3, 0.1, 0.05]})
    expected = env.step(np.array([0.4]))[0]
    np.testing.assert_allclose([float(x) for x in done.stdout.split()], expected, rtol=1e-13)


@pytest.mark.thorough
def test_the_pages_programs_run_as_they_stand(run_folder, monkeypatch):
    programs = blocks("Gymnasium", "python")
    monkeypatch.chdir(run_folder)
    known: dict = {}
    for program in programs:
        exec(compile(program, "export.md", "exec"), known)
    assert known["env"].observation_space.shape == known["state"].shape == (2,)
    np.testing.assert_allclose(known["env"].unwrapped.rules.bounds[0], [-3.84, 3.84])
    assert known["states"].shape == (256, 2)
