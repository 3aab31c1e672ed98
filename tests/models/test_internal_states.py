"""Internal states of every kind and together, against equations of motion written by hand."""

from dataclasses import replace
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import tustinnet as tn
from tustinnet.channels import Channels, PDController, PDLoop
from tustinnet.models.added import with_forces
from tustinnet.models.closed_loop import with_controller
from tustinnet.models.coordinates import rigid_system
from tustinnet.models.internal_states import Memory, UnmeasuredCoordinates
from tustinnet.models.sensors import with_sensor_errors

# a slider with a pendulum, whose motor drives it through a spring that may have no sensor
MASS, INERTIA, MOTOR, COUPLING = 2.0, 1.3, 0.4, 0.3
SPRING, WEIGHT, GEAR, RATIO = 4.0, 3.0, 9.0, 0.5
DAMPING = np.array([0.3, 0.2, 0.1])
CREEP, SHARE, FAN_LAG, LAG = 0.7, 0.4, 0.2, 0.15
MAXWELL, RELAXATION = 1.7, 2.5
KP, KD, KI, FILTER, DT, LIMIT = 6.0, 0.8, 4.0, 0.05, 0.02, 5.0


def kinetic(q, v, p):
    energy = MASS * v[0] ** 2 / 2 + INERTIA * v[1] ** 2 / 2
    energy = energy + COUPLING * jnp.cos(q[1]) * v[0] * v[1]
    return energy + sum(MOTOR * w**2 / 2 for w in v[2:])


def potential(q, p):
    energy = SPRING * q[0] ** 2 / 2 - WEIGHT * jnp.cos(q[1])
    return energy + sum(GEAR * (h - RATIO * q[1]) ** 2 / 2 for h in q[2:])


def on_all(q, *forces):
    return jnp.stack([*forces, 0.0 * q[0]][: len(q)])


PLAIN = tn.LagrangianSystem(
    name="slider",
    coordinates=(tn.Coordinate("x", "linear"), tn.Coordinate("angle", "angular")),
    inputs=(
        tn.Input("force", "N", "zero-order", (-LIMIT, LIMIT)),
        tn.Input("torque", "N m", "zero-order"),
    ),
    parameters=(),
    kinetic=kinetic,
    potential=potential,
    dissipation=lambda q, v, p: jnp.asarray(DAMPING[: len(v)]) * v,
    input_map=lambda q, v, u, p: on_all(q, u[0] * jnp.cos(q[1]), u[1] - 0.1 * u[0]),
)
MEMORY = Memory(
    ("creep", "fan"),
    lambda q, v, z, u, p: jnp.stack([v[0] - CREEP * z[0], (u[0] - z[1]) / FAN_LAG]),
    lambda q, v, z, p: on_all(q, -2.0 * z[0], z[1] * v[0]),
    lambda q, v, u, p: jnp.stack([SHARE * q[0], u[0] + q[-1]]),
)
HIDDEN = UnmeasuredCoordinates(
    ("motor",), lambda q, p: RATIO * q[1:], spread=lambda p: jnp.array([0.1, 0.2])
)
FORCES = {"force.lag": LAG, "force.initial_share": 0.9, "angle.maxwell": MAXWELL}
FORCES |= {"angle.relaxation": RELAXATION, "angle.turned": SHARE}
GAINS = {"angle.kp": KP, "angle.kd": KD, "angle.ki": KI}
# none, each alone, and with at most one missing
CASES = [case for case in product([False, True], repeat=4) if sum(case) != 2]
KINDS = [dict(zip("hmfc", case, strict=True)) for case in CASES]


def parameters(values):
    return tuple(tn.Parameter(name, "1", x, x, x, fixed=True) for name, x in values.items())


def make(kinds, *, is_sampled=False, delay=0):
    """A system: h with a hidden coordinate, m memory, f added forces, c a controller."""
    hold = "zero-order" if is_sampled else "first-order"
    system = replace(
        PLAIN, unmeasured=HIDDEN if kinds["h"] else None, memory=MEMORY if kinds["m"] else None
    )
    if kinds["f"]:
        system = with_forces(system, ("lag:force", "maxwell:angle"), parameters(FORCES))
    if kinds["c"]:
        loop = PDLoop(
            *("force", "angle", "wanted"), kp=KP, kd=KD, ki=KI, velocity_filter=FILTER, delay=delay
        )
        inputs = (tn.Input("wanted", "rad", hold), PLAIN.inputs[1])
        controller = PDController(PLAIN.inputs, (loop,))
        channels = Channels(PLAIN.coordinates, inputs, DT, controller)
        system = with_controller(system, channels, parameters(GAINS))
    return system


def model_of(system):
    return system.model({name: jnp.asarray(x) for name, x in system.nominal().items()})


class ByHand:
    """The equations of motion in NumPy, of states as the system has them."""

    def __init__(self, kinds):
        self.kinds = kinds

    def split(self, z):
        """The internal states of each kind."""
        sizes = {"h": 2, "m": 2, "f": 2, "c": 2}
        ends = np.cumsum([sizes[k] * self.kinds[k] for k in "hmfc"])[:-1]
        return np.split(z, ends)

    def forces(self, q, v):
        """Mass matrix, and forces without inputs and memory, of all coordinates."""
        coupled = COUPLING * np.cos(q[1])
        matrix = np.diag([MASS, INERTIA, MOTOR][: len(q)])
        matrix[0, 1] = matrix[1, 0] = coupled
        force = np.zeros(len(q))
        force[0] = COUPLING * np.sin(q[1]) * v[1] ** 2 - SPRING * q[0]
        force[1] = -WEIGHT * np.sin(q[1])
        if len(q) > 2:
            twist = q[2] - RATIO * q[1]
            force[1] += GEAR * RATIO * twist
            force[2] = -GEAR * twist
        return matrix, force - DAMPING[: len(q)] * v

    def plant(self, x, u):
        """The derivative of the state without the controller's."""
        q, v, (h, m, f, _) = x[:2], x[2:4], self.split(x[4:])
        q, v = np.append(q, h[:1]), np.append(v, h[1:])
        matrix, force = self.forces(q, v)
        rates = []
        given = u
        if self.kinds["f"]:
            rates += [(u[0] - f[0]) / LAG, v[1] - RELAXATION * f[1]]
            force[1] -= MAXWELL * f[1]
            given = np.array([f[0], u[1]])
        if self.kinds["m"]:
            rates = [v[0] - CREEP * m[0], (given[0] - m[1]) / FAN_LAG, *rates]
            force[:2] += [-2.0 * m[0], m[1] * v[0]]
        force[:2] += [given[0] * np.cos(q[1]), given[1] - 0.1 * given[0]]
        a = np.linalg.solve(matrix, force)
        return np.concatenate([v[:2], a[:2], v[2:], a[2:], rates])

    def derivative(self, x, w):
        """The derivative of the whole state; the controller computes all the time."""
        if not self.kinds["c"]:
            return self.plant(x, w)
        integral, speed = x[-2:]
        error = w[0] - x[1]
        u, growth = KP * error - KD * speed + integral, KI * error
        if (u >= LIMIT and growth > 0) or (u <= -LIMIT and growth < 0):
            growth = 0.0
        rate = self.plant(x[:-2], np.array([np.clip(u, -LIMIT, LIMIT), w[1]]))
        return np.concatenate([rate, [growth, (x[3] - speed) / FILTER]])


def name_of(kinds):
    return "".join(k for k, there in kinds.items() if there) or "none"


@pytest.mark.thorough
@pytest.mark.parametrize("kinds", KINDS, ids=name_of)
def test_the_derivative_is_that_by_hand(kinds):
    system, by_hand, rng = make(kinds), ByHand(kinds), np.random.default_rng(3)
    model, names = model_of(system), []
    names += ["motor", "motor_speed"] * kinds["h"] + ["creep", "fan"] * kinds["m"]
    names += ["lag:force", "maxwell:angle"] * kinds["f"]
    names += ["angle.integral", "angle.filtered_velocity"] * kinds["c"]
    assert system.internal == tuple(names)
    derivative = jax.jit(
        lambda x, w: model.derivative(x, w)
    )  # of hundreds of operations, each compiled otherwise
    for _ in range(3):
        x, w = rng.normal(size=model.state_size), 2 * rng.normal(size=2)
        found = derivative(jnp.asarray(x), jnp.asarray(w))
        np.testing.assert_allclose(found, by_hand.derivative(x, w), rtol=1e-11, atol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize("kinds", KINDS, ids=name_of)
def test_where_records_begin(kinds):
    system = make(kinds)
    model = model_of(system)
    q, v, w = np.array([0.3, -0.4]), np.array([0.7, 0.2]), np.array([0.5, 1.1])
    initial = jax.jit(lambda x, w: model.initial_internal(x, w))
    begun = np.asarray(initial(jnp.array([*q, *v]), jnp.asarray(w)))
    spread, searched, expected = [], [], []
    if kinds["h"]:
        expected += [RATIO * q[1], RATIO * v[1]]
        spread, searched = [0.1, 0.2], [True, True]
    loop: list[list] = [[], [], []]
    u = w[0]
    if kinds["c"]:
        integral = begun[-2]  # what holds the system, compared with no number here
        u = KP * (w[0] - q[1]) - KD * v[1] + integral
        loop = [[integral, v[1]], [KP, 1.0], [True, True]]
    if kinds["m"]:
        # it sees what the actuator has reached, and the last coordinate, which may be hidden
        reached = 0.9 * u if kinds["f"] else u
        expected += [SHARE * q[0], reached + (RATIO * q[1] if kinds["h"] else q[1])]
    if kinds["f"]:
        expected += [0.9 * u, SHARE * q[1]]
    plain = 2 * (kinds["m"] + kinds["f"])
    spread, searched = spread + [1.0] * plain, searched + [False] * plain
    expected, spread, searched = expected + loop[0], spread + loop[1], searched + loop[2]
    np.testing.assert_allclose(begun, expected, rtol=1e-12)
    np.testing.assert_allclose(model.internal_spread, spread)
    assert model.searched_internal.tolist() == searched
    assert system.states.has_initial == any(kinds.values())
    assert model.initial_needs_inputs == any(kinds.values())


@pytest.mark.thorough
@pytest.mark.parametrize("kinds", [k for k in KINDS if not k["c"]], ids=name_of)
def test_along_the_measured_motion_what_is_hidden_follows(kinds):
    """The rigid system has the forces by hand along the relation, d'Alembert's principle."""
    model, by_hand = model_of(rigid_system(make(kinds))), ByHand(kinds)
    q, v, u = np.array([0.3, -0.4]), np.array([0.7, 0.2]), np.array([0.5, 1.1])
    z = np.asarray(model.balanced_internal(jnp.asarray(q), jnp.asarray(v), jnp.asarray(u)))
    of_memory, of_forces = [0.0, u[0]] * kinds["m"], [u[0], 0.0] * kinds["f"]
    np.testing.assert_allclose(z, [*of_memory, *of_forces], rtol=1e-10, atol=1e-12)
    jacobian = np.array([[1, 0], [0, 1], [0, RATIO]]) if kinds["h"] else np.eye(2)
    matrix, force = by_hand.forces(jacobian @ q, jacobian @ v)
    force[:2] += [u[0] * np.cos(q[1]), u[1] - 0.1 * u[0]]
    if kinds["m"]:
        force[1] += u[0] * v[0]
    a = np.linalg.solve(jacobian.T @ matrix @ jacobian, jacobian.T @ force)
    found = model.derivative(jnp.array([*q, *v, *z]), jnp.asarray(u))[2:4]
    np.testing.assert_allclose(found, a, rtol=1e-10)


def test_a_memory_says_which_of_its_states_are_searched_for():
    memory = replace(MEMORY, spread=lambda p: jnp.array([0.3, 2.0]), searched=("fan",))
    model = model_of(replace(PLAIN, memory=memory))
    np.testing.assert_array_equal(model.internal_spread, [0.3, 2.0])
    assert model.searched_internal.tolist() == [False, True]
    with pytest.raises(tn.InputError, match="'spin' in `searched`; expected among creep, fan"):
        replace(MEMORY, searched=("spin",))


@pytest.mark.thorough
def test_sensor_errors_change_all_of_them():
    kinds = dict.fromkeys("hmf", True) | {"c": False}
    gain, bias, drive = 1.3, 0.2, 0.8
    values = {"x.gain": gain, "angle.bias": bias, "force.gain": drive}
    model, by_hand = model_of(with_sensor_errors(make(kinds), parameters(values))), ByHand(kinds)
    x, u = np.random.default_rng(3).normal(size=10), np.array([0.5, 1.1])
    expected = by_hand.plant(x, u * [drive, 1.0])
    scale = np.ones(10)
    scale[[0, 2]] = gain
    read = x * scale
    read[1] += bias
    found = model.derivative(jnp.asarray(read), jnp.asarray(u))
    np.testing.assert_allclose(found, expected * scale, rtol=1e-11)
    begun = model.initial_internal(jnp.asarray(read[:4]), jnp.asarray(u))
    angle = [RATIO * x[1], RATIO * x[3], SHARE * x[0], 0.9 * drive * u[0] + RATIO * x[1]]
    np.testing.assert_allclose(begun, [*angle, 0.9 * drive * u[0], SHARE * x[1]], rtol=1e-11)


@pytest.mark.thorough
def test_a_sampled_controller_holds_while_everything_else_moves():
    """Steps against those of Runge and Kutta by hand, under the law by hand, with a delay."""
    kinds = dict.fromkeys("hmfc", True)
    system = make(kinds, is_sampled=True, delay=1)
    model = tn.discretise(model_of(system), DT, 2, inputs=system.inputs)
    by_hand, rng = ByHand(kinds | {"c": False}), np.random.default_rng(5)
    x, integral, speed, coming = 0.3 * rng.normal(size=10), 0.4, 0.1, 1.5
    own, stopped = jnp.array([*x, integral, speed, coming]), 0
    for w in 2 * rng.normal(size=(8, 2)):
        error = w[0] - x[1]
        speed += (1 - np.exp(-DT / FILTER)) * (x[3] - speed)
        u, growth = KP * error - KD * speed + integral, KI * error
        is_stopped = abs(u) >= LIMIT and growth * u > 0
        stopped += is_stopped
        integral += 0.0 if is_stopped else DT * growth
        held, coming = np.array([coming, w[1]]), np.clip(u, -LIMIT, LIMIT)
        for _ in range(2):
            h = DT / 2
            a = by_hand.plant(x, held)
            b = by_hand.plant(x + h / 2 * a, held)
            c = by_hand.plant(x + h / 2 * b, held)
            x = x + h / 6 * (a + 2 * b + 2 * c + by_hand.plant(x + h * c, held))
        own = model.step(own, jnp.asarray(w))
        np.testing.assert_allclose(own, [*x, integral, speed, coming], rtol=1e-10, atol=1e-12)
    assert 0 < stopped < 8
