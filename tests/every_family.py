"""A model of every family of the package, small and untrained."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from swinging import CART, CREEPING, DT, LAGGING, SWING, records, swing_model

import tustinnet as tn
from tustinnet.export.source import Source, make_source
from tustinnet.families.gru import random_gru
from tustinnet.families.linear import FAMILY as LINEAR
from tustinnet.families.linear import LinearHyper
from tustinnet.families.neural_ode import NeuralODE
from tustinnet.families.tustin_net import random_tustin_net
from tustinnet.models.blocks import Layers, Scaling, feature_count, random_network
from tustinnet.models.lagrangian import LagrangianSystem
from tustinnet.systems.qube_servo2 import SYSTEM, WITH_CABLE_FRICTION, WITH_MEMORY

CHANNELS = tn.Channels(SWING.coordinates, SWING.inputs, DT)


def scaling(memory: int = 0) -> Scaling:
    one = jnp.ones(1, jnp.float32)
    return Scaling(jnp.zeros(0), jnp.zeros(0), 5 * one, one, 3 * one, jnp.ones(memory, jnp.float32))


def network(seed: int, channels=CHANNELS, times=(), taps=(), hidden=(6, 5)) -> tn.TustinNet:
    return random_tustin_net(
        channels,
        scaling(len(times)),
        jax.random.key(seed),
        hidden=hidden,
        stem=4,
        relaxation_times=times,
        taps=taps,
    )


def physics(channels=CHANNELS, system=CREEPING, **values: float) -> tn.Model:
    return tn.discretise(swing_model(values, system), DT, inputs=channels.inputs)


def hybrid(seed: int, channels=CHANNELS, taps=(), **values: float) -> tn.HybridModel:
    known = physics(channels, CREEPING, **values)
    return tn.HybridModel(known, network(seed, channels, taps=taps))


def neural_ode(seed: int, channels=CHANNELS) -> tn.Model:
    layers = Layers(hidden=(4,))
    made = random_network(scaling(), jax.random.key(seed), feature_count(channels), 2, layers)
    return tn.discretise(NeuralODE(made, channels), DT, unrolled=True)


def every_family(channels=CHANNELS) -> list[tn.Model]:
    """Nine models of six families, some alike, none of those beside one another."""
    hyper = LinearHyper(kind="linear", internal=1)
    linear = LINEAR.one_step_model(hyper, records(), "auto")
    return [
        network(0, channels, times=(0.5,)),
        physics(channels),
        hybrid(1, channels, taps=(-1, 0, 1)),
        random_gru(channels, scaling(), jax.random.key(2), 3, 8),
        network(3, channels, times=(0.5,)),
        replace(linear, channels=channels),
        neural_ode(5, channels),
        hybrid(6, channels, taps=(-1, 0, 1), gravity=1.2),
        network(7, channels, taps=(0, 1)),
    ]


def nominal(system: LagrangianSystem, substeps: int) -> tn.Model:
    """Equations of motion with the nominal values."""
    values = {name: jnp.asarray(value) for name, value in system.nominal().items()}
    return tn.discretise(system.model(values), 0.01, substeps)


def pendulum_network(hidden: tuple[int, ...]) -> tn.TustinNet:
    """A network for the rotary pendulum."""
    of = nominal(SYSTEM, 1).channels
    one = jnp.ones(2, jnp.float32)
    units = Scaling(jnp.zeros(0), jnp.zeros(0), 5 * one, one[:1], 30 * one, jnp.zeros(0))
    return random_tustin_net(of, units, jax.random.key(0), hidden=hidden)


_FAMILIES = (
    "network memory",
    "physics",
    "hybrid",
    "gru",
    "network memory 2",
    "linear",
    "neural ode",
    "hybrid 2",
    "network taps",
)
# two structures twice, not beside one another; what one more member adds, its own case tries
_MEMBERS = ("network memory", "hybrid", "linear", "network memory 2", "network taps", "hybrid 2")
_OTHERS = {
    "committee": lambda: tn.committee([example(name) for name in _MEMBERS]),
    "qube": lambda: nominal(SYSTEM, 1),
    "qube memory": lambda: nominal(WITH_MEMORY, 4),
    "qube rubbing": lambda: nominal(WITH_CABLE_FRICTION, 2),
    "cart": lambda: nominal(CART, 3),
    "qube network": lambda: pendulum_network((100, 100)),
    "qube hybrid": lambda: tn.HybridModel(nominal(WITH_MEMORY, 2), pendulum_network((40, 40))),
    "actuator lag": lambda: physics(system=LAGGING),
    "hybrid lag": lambda: tn.HybridModel(physics(_with_hold("first-order"), LAGGING), network(1)),
    "first-order": lambda: physics(_with_hold("first-order")),
    "band-limited": lambda: hybrid(1, _with_hold("band-limited"), taps=(-1, 0, 1)),
}
# of two that are alike but for their weights, one
NAMES = (*(name for name in _FAMILIES if not name.endswith(" 2")), *_OTHERS)
_WITHOUT_LAYERS = ("physics", "qube", "qube memory", "qube rubbing", "cart")
_WITHOUT_LAYERS += ("actuator lag", "first-order")
LAYERED = tuple(name for name in NAMES if name not in _WITHOUT_LAYERS)


def _with_hold(hold: str) -> tn.Channels:
    return replace(CHANNELS, inputs=(replace(SWING.inputs[0], hold=hold),))


@cache
def example(name: str) -> tn.Model:
    """One of `NAMES`: of every family, and larger ones, as they leave the house."""
    if name in _OTHERS:
        return _OTHERS[name]()
    return _families()[_FAMILIES.index(name)]


@cache
def example_source(name: str) -> Source:
    """The source of the export of one of `NAMES`; its step is read once for all tests."""
    return make_source(example(name))


@cache
def step_and_jacobians(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By JAX, at the two samples of the source of one of `NAMES`: compiled once for all tests."""
    source = example_source(name)

    def one(x: jax.Array, u: jax.Array) -> tuple[jax.Array, ...]:
        return source.function(x, u), *jax.jacfwd(source.function, (0, 1))(x, u)

    states, inputs = source.samples(2)
    compiled = jax.jit(one)
    rows = [compiled(x, u) for x, u in zip(states, inputs, strict=True)]
    stepped, by_x, by_u = (np.stack(part) for part in zip(*rows, strict=True))
    return stepped, by_x, by_u


@cache
def _families() -> list[tn.Model]:
    return every_family()
