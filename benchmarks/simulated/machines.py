"""The twelve machines: equations of motion as plain NumPy, sensors, controllers, runs.

A function makes each machine. With `effects=False` it leaves out what its system file in `systems/`
does not have either: dead zones, backlash, drag, friction that depends on the direction. The
parameters `truth` of that file then describe the motion; a test compares both.
"""

from collections.abc import Callable

import numpy as np

from simulated.measurement import (
    Actuator,
    Machine,
    Run,
    Sensor,
    StateFeedback,
    regulator_gain,
)
from simulated.signals import chirp, constant, moves, multisine, soft_start, steps, total

G = 9.81  # m/s^2


def dead_zone(u: np.ndarray, width: float) -> np.ndarray:
    """What is left of an input beyond plus and minus a width."""
    return u - np.clip(u, -width, width)


def chain_acceleration(
    q: np.ndarray, v: np.ndarray, torques: np.ndarray, coupling: np.ndarray, moments: np.ndarray
) -> np.ndarray:
    """The accelerations of joints in a chain of links in a vertical plane; 0 hangs down.

    Args:
        q: joint angles, relative to the link before, (n, R).
        v: their velocities.
        torques: torques in the joints, (n, R).
        coupling: inertia of each pair of links when they are parallel, (n, n) [kg m^2].
        moments: mass moment of each link with all behind it, (n,) [kg m].
    """
    angle, speed = np.cumsum(q, axis=0), np.cumsum(v, axis=0)
    difference = angle[:, None] - angle[None]
    mass = coupling[..., None] * np.cos(difference)
    centrifugal = np.sum(coupling[..., None] * np.sin(difference) * speed[None] ** 2, axis=1)
    gravity = G * moments[:, None] * np.sin(angle)
    on_links = torques - np.concatenate([torques[1:], np.zeros_like(torques[:1])])
    right = on_links - centrifugal - gravity
    turning = np.linalg.solve(np.moveaxis(mass, -1, 0), right.T[..., None])[..., 0].T
    return np.diff(turning, axis=0, prepend=0)


def double_pendulum(effects: bool = True) -> Machine:
    """A free double pendulum: no inputs, encoders in both joints, a clock that jitters."""
    p = {
        "inertia1": 0.021,
        "moment1": 0.11,
        "mass2": 0.25,
        "inertia2": 0.0055,
        "centre2": 0.13,
        "viscous1": 4e-3,
        "viscous2": 8e-4,
        "dry1": 6e-3,
        "dry2": 1.5e-3,
    }
    length, drag = 0.24, effects * np.array([[6e-4], [1.5e-4]])
    cross = p["mass2"] * length * p["centre2"]
    coupling = np.array([[p["inertia1"] + p["mass2"] * length**2, cross], [cross, p["inertia2"]]])
    moments = np.array([p["moment1"] + p["mass2"] * length, p["mass2"] * p["centre2"]])
    viscous = np.array([[p["viscous1"]], [p["viscous2"]]])
    dry = np.array([[p["dry1"]], [p["dry2"]]])

    def rate(t, x, u, warmth):
        q, v = x[:2], x[2:]
        torques = -viscous * v - dry * (1 - 0.3 * warmth) * np.tanh(v / 0.05) - drag * v * abs(v)
        return np.concatenate([v, chain_acceleration(q, v, torques, coupling, moments)])

    def runs(rng):
        def fall(name, largest):
            first, second = rng.uniform(0.4, 1, 2) * largest * rng.choice([-1, 1], 2)
            return Run(name, 12.0, (first, second / 2))

        return (
            [fall(f"fall{i}", 1.0 + 0.15 * i) for i in range(9)],
            [fall(f"drop{i}", 0.7 + 0.35 * i) for i in range(4)],
        )

    return Machine(
        name="double-pendulum",
        dt=0.01,
        substeps=10,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor(
                "upper",
                "angular",
                "upper_counts",
                "counts",
                counts=4096,
                wraps=True,
                eccentricity=effects * 0.003,
            ),
            Sensor("lower", "angular", "lower_counts", "counts", counts=2400, wraps=True),
        ),
        jitter=3e-4,
    )


def cart_pole(effects: bool = True) -> Machine:
    """A cart that balances a pole; references and a dither excite it."""
    p = {
        "cart": 0.62,
        "pole": 0.14,
        "length": 0.26,
        "inertia": 0.0042,
        "gain": 1.7,
        "viscous": 5.2,
        "dry": 0.5,
        "pivot": 6e-4,
    }
    m, ml = p["cart"] + p["pole"], p["pole"] * p["length"]
    about = p["inertia"] + ml * p["length"]

    def rate(t, x, u, warmth):
        _, angle, v, w = x
        pull = p["gain"] * dead_zone(u[0], 0.25 * effects)
        dry = p["dry"] * (1 - 0.4 * warmth + 0.2 * effects * np.sign(v)) * np.tanh(v / 0.01)
        force = pull - p["viscous"] * v - dry + ml * np.sin(angle) * w**2
        torque = ml * G * np.sin(angle) - p["pivot"] * w
        c = ml * np.cos(angle)
        free = m * about - c**2
        return np.stack(
            [v, w, (about * force - c * torque) / free, (m * torque - c * force) / free]
        )

    gain = regulator_gain(rate, 4, 0.01, (40, 20, 1, 1), 0.05)
    target = np.array([[1.0], [0.0]])

    def runs(rng):
        def balance(name, reference):
            dither = multisine(rng, 0.5, 8.0, 0.8)
            return Run(name, 15.0, (0.0, rng.uniform(-0.04, 0.04)), (reference, dither))

        fit = [balance(f"sines{i}", multisine(rng, 0.1, 1.0, 0.06, 10)) for i in range(4)]
        fit += [balance(f"moves{i}", moves(rng, 3.0, 0.2, 15, 0.8)) for i in range(4)]
        return fit, [
            balance("jumps", steps(rng, 2.5, 0.12, 15)),
            balance("slow", moves(rng, 5.0, 0.25, 15, 2.0)),
            balance("quiet", constant()),
        ]

    return Machine(
        name="cart-pole",
        dt=0.01,
        substeps=10,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor("cart", "linear", "cart_mm", "mm", step=0.0227),
            Sensor("pole", "angular", "pole_counts", "counts", counts=4096, wraps=True),
        ),
        actuators=(Actuator("voltage", "V"),),
        make_controller=lambda: StateFeedback(gain, 0.01, 10.0, 0.5, target),
        comparable=0.8,
    )


def unbalanced_disc(effects: bool = True) -> Machine:
    """A disc with a mass off its centre on a motor; the voltage acts a period late."""
    p = {"gravity": 110.0, "damping": 1.9, "dry": 3.0, "gain": 22.0}

    def rate(t, x, u, warmth):
        angle, v = x
        drive = p["gain"] * dead_zone(u[0], 0.12 * effects)
        rub = p["dry"] * (1 - 0.3 * warmth) * np.tanh(v / 0.1) * (1 + 0.2 * effects * np.sin(angle))
        return np.stack([v, drive - p["gravity"] * np.sin(angle) - p["damping"] * v - rub])

    def runs(rng):
        def run(name, signal, seconds=12.0):
            return Run(name, seconds, (rng.uniform(-0.5, 0.5),), (signal,))

        fit = [run(f"sines{i}", multisine(rng, 0.2, 3.0, 1.0 + 0.3 * i)) for i in range(5)]
        fit += [run(f"levels{i}", steps(rng, 0.6, 5.0, 12)) for i in range(4)]
        return fit, [
            run("sweep", chirp(0.3, 3.0, 3.0, 12)),
            run("slow", steps(rng, 1.5, 4.0, 12)),
            run("wide", multisine(rng, 0.1, 5.0, 2.0)),
        ]

    return Machine(
        name="unbalanced-disc",
        dt=0.02,
        substeps=20,
        states=2,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor(
                "disc",
                "angular",
                "disc_deg",
                "deg",
                step=0.15,
                wraps=True,
                eccentricity=effects * 0.004,
            ),
        ),
        actuators=(Actuator("voltage", "V", noise=effects * 0.01),),
        delay=int(effects),
        jitter=1e-4,
        comparable=3.0,
    )


def gantry_crane(effects: bool = True) -> Machine:
    """A crane's trolley under position control, and the angle of the load on its rope."""
    p = {
        "trolley": 4.2,
        "load": 1.4,
        "length": 0.72,
        "gain": 9.5,
        "viscous": 24.0,
        "dry": 5.0,
        "air": 0.02,
    }

    def rate(t, x, u, warmth):
        _, angle, v, w = x
        length = p["length"] * (1 + 0.02 * warmth)  # the load hangs a little lower or higher
        pull = p["gain"] * dead_zone(u[0], 0.3 * effects)
        dry = p["dry"] * (1 - 0.3 * warmth + 0.25 * effects * np.sign(v)) * np.tanh(v / 0.01)
        swing = p["load"] * length
        force = pull - p["viscous"] * v - dry + swing * np.sin(angle) * w**2
        torque = -swing * G * np.sin(angle) - (p["air"] + 0.03 * effects * abs(w)) * w
        m, about, c = p["trolley"] + p["load"], swing * length, swing * np.cos(angle)
        free = m * about - c**2
        return np.stack(
            [v, w, (about * force - c * torque) / free, (m * torque - c * force) / free]
        )

    gain = np.array([[28.0, 0.0, 6.0, 0.0]])

    def runs(rng):
        def run(name, reference, seconds=16.0):
            return Run(name, seconds, (0.0, rng.uniform(-0.08, 0.08)), (reference,))

        fit = [run(f"travel{i}", moves(rng, 4.0, 0.5, 16, 0.8 + 0.2 * i)) for i in range(5)]
        fit += [run(f"sines{i}", multisine(rng, 0.1, 1.2, 0.12, 12)) for i in range(3)]
        return fit, [
            run("jumps", steps(rng, 4.0, 0.3, 16)),
            run("sweep", chirp(0.1, 1.5, 0.2, 16)),
            run("shunting", moves(rng, 2.0, 0.3, 16, 1.0)),
        ]

    return Machine(
        name="gantry-crane",
        dt=0.02,
        substeps=20,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor("trolley", "linear", "trolley_mm", "mm", step=0.1),
            Sensor("load", "angular", "load_deg", "deg", step=0.05, noise=0.04 * effects),
        ),
        actuators=(Actuator("voltage", "V", noise=0.01 * effects),),
        make_controller=lambda: StateFeedback(gain, 0.02, 10.0, 0.6, np.array([[1.0], [0.0]])),
        jitter=1.5e-4,
    )


def two_mass_drive(effects: bool = True) -> Machine:
    """A motor that turns a load through an elastic shaft with backlash, under position control."""
    p = {
        "motor": 6e-4,
        "load": 1.1e-3,
        "stiffness": 0.9,
        "shaft": 1.5e-3,
        "viscous1": 1.2e-3,
        "viscous2": 8e-4,
        "dry1": 0.012,
        "dry2": 0.008,
    }

    def rate(t, x, u, warmth):
        motor, load, v, w = x
        twist = dead_zone(motor - load, 0.012 * effects)
        contact = np.where(twist == 0, 0.0, 1.0) if effects else 1.0
        shaft = p["stiffness"] * twist + p["shaft"] * (v - w) * contact
        ripple = 1 + 0.03 * effects * np.cos(6 * motor)
        on_motor = u[0] * ripple - shaft - p["viscous1"] * v - p["dry1"] * np.tanh(v / 0.2)
        on_load = shaft - p["viscous2"] * w - p["dry2"] * (1 - 0.4 * warmth) * np.tanh(w / 0.2)
        return np.stack([v, w, on_motor / p["motor"], on_load / p["load"]])

    gain = np.array([[0.12, 0.0, 0.008, 0.0]])

    def runs(rng):
        def run(name, reference, rms=0.03):
            return Run(name, 8.0, (), (reference, multisine(rng, 1.0, 15.0, rms)))

        fit = [run(f"moves{i}", moves(rng, 1.6, 3.0, 8, 0.6)) for i in range(4)]
        fit += [run(f"sines{i}", multisine(rng, 0.3, 3.0, 0.5, 15)) for i in range(4)]
        return fit, [
            run("jumps", steps(rng, 2.0, 1.5, 8)),
            run("sweep", chirp(0.5, 8.0, 0.5, 8)),
            run("slow", moves(rng, 2.5, 4.0, 8, 1.5), 0.015),
        ]

    return Machine(
        name="two-mass-drive",
        dt=0.005,
        substeps=10,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor("motor", "angular", "motor_counts", "counts", counts=4096, wraps=True),
            Sensor("load", "angular", "load_counts", "counts", counts=2400, wraps=True),
        ),
        actuators=(Actuator("torque", "N m", noise=0.001 * effects),),
        make_controller=lambda: StateFeedback(gain, 0.005, 0.4, 0.5, np.array([[1.0], [0.0]])),
        comparable=1.5,
    )


def duffing(effects: bool = True) -> Machine:
    """A fast mass on a spring that stiffens, driven by a multisine that moves between samples."""
    p = {"stiffness": 1.6e5, "cubic": 9e5, "damping": 45.0, "gain": 1.6e5}
    rating = 610.35

    def rate(t, x, u, warmth):
        q, v = x
        spring = p["stiffness"] * q * (1 - 0.01 * warmth) + p["cubic"] * q**3
        spring = spring + effects * 6e4 * q**2
        return np.stack([v, p["gain"] * u[0] - spring - p["damping"] * (1 + effects * abs(q)) * v])

    def runs(rng):
        def run(name, signal, seconds=3.0):
            return Run(name, seconds, (), (signal,))

        fit = [run(f"sines{i}", multisine(rng, 3, 150, 0.02 + 0.01 * i, 160)) for i in range(6)]
        return fit, [
            run("sweep", chirp(5, 120, 0.08, 3)),
            run("narrow", multisine(rng, 40, 90, 0.05, 60)),
            run("small", multisine(rng, 3, 150, 0.025, 160)),
        ]

    return Machine(
        name="duffing",
        dt=1 / rating,
        substeps=8,
        states=2,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor("deflection", "linear", "deflection_mm", "mm", step=0.05, noise=0.1 * effects),
        ),
        actuators=(Actuator("voltage", "V", noise=3e-4 * effects, hold="band-limited"),),
        comparable=0.5,
    )


def ball_on_beam(effects: bool = True) -> Machine:
    """A ball that a controller keeps on a beam by the motor in the beam's pivot."""
    p = {
        "ball": 0.11,
        "rolling": 1.4,
        "beam": 0.021,
        "gain": 0.16,
        "damping": 0.05,
        "friction": 0.012,
    }
    m = p["ball"]

    def rate(t, x, u, warmth):
        r, angle, v, w = x
        drive = p["gain"] * dead_zone(u[0], 0.2 * effects)
        rub = p["friction"] * v + effects * 0.004 * (1 - 0.4 * warmth) * np.tanh(v / 0.005)
        force = m * r * w**2 - m * G * np.sin(angle) - rub
        torque = drive - p["damping"] * w - 2 * m * r * v * w - m * G * r * np.cos(angle)
        return np.stack([v, w, force / (p["rolling"] * m), torque / (p["beam"] + m * r**2)])

    gain = regulator_gain(rate, 4, 0.02, (60, 5, 5, 0.2), 0.02)

    def runs(rng):
        def run(name, reference, rms=0.4):
            dither = multisine(rng, 0.3, 4.0, rms)
            return Run(name, 15.0, (rng.uniform(-0.05, 0.05),), (reference, dither))

        fit = [run(f"sines{i}", multisine(rng, 0.07, 0.5, 0.06, 8)) for i in range(4)]
        fit += [run(f"moves{i}", moves(rng, 4.0, 0.15, 15, 1.0)) for i in range(4)]
        return fit, [
            run("jumps", steps(rng, 4.0, 0.12, 15)),
            run("quiet", constant(), 0.6),
            run("slow", moves(rng, 5.0, 0.18, 15, 2.5)),
        ]

    return Machine(
        name="ball-on-beam",
        dt=0.02,
        substeps=20,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor("ball", "linear", "ball_mm", "mm", step=0.1, noise=0.5 * effects),
            Sensor("beam", "angular", "beam_counts", "counts", counts=4096),
        ),
        actuators=(Actuator("voltage", "V"),),
        make_controller=lambda: StateFeedback(gain, 0.02, 8.0, 0.4, np.array([[1.0], [0.0]])),
        comparable=0.8,
    )


def propeller_pendulum(effects: bool = True) -> Machine:
    """A pendulum with a propeller at its end, whose speed lags behind the command."""
    p = {"gravity": 21.0, "damping": 0.35, "thrust": 14.0}
    lag = 0.09 if effects else 2e-3  # s

    def rate(t, x, u, warmth):
        angle, v, spin = x
        thrust = p["thrust"] * (1 - 0.1 * warmth) * spin * abs(spin)  # the battery empties
        rub = p["damping"] * v + effects * (0.05 * v * abs(v) + 0.3 * np.tanh(v / 0.05))
        command = np.clip(u[0], -1, 1) if effects else u[0]
        return np.stack([v, thrust - p["gravity"] * np.sin(angle) - rub, (command - spin) / lag])

    def runs(rng):
        def run(name, signal, seconds=15.0):
            return Run(name, seconds, (rng.uniform(-0.4, 0.4),), (signal,))

        offset = constant(0.55)
        fit = [run(f"levels{i}", steps(rng, 1.5, 1.0, 15)) for i in range(4)]
        fit += [
            run(f"sines{i}", total(offset, multisine(rng, 0.1, 2.5, 0.3, 20))) for i in range(4)
        ]
        return fit, [
            run("sweep", total(offset, chirp(0.1, 2.0, 0.4, 15))),
            run("slow", steps(rng, 3.0, 0.9, 15)),
            run("two-sided", multisine(rng, 0.1, 2.5, 0.5, 20)),
        ]

    return Machine(
        name="propeller-pendulum",
        dt=0.02,
        substeps=20,
        states=3,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(Sensor("arm", "angular", "arm_deg", "deg", step=0.15, noise=0.05 * effects),),
        actuators=(Actuator("command", "1"),),
        jitter=1.5e-4,
    )


def positioning_axis(effects: bool = True) -> Machine:
    """A carriage on a screw in a position loop; what is logged is not yet saturated."""
    p = {
        "mass": 28.0,
        "viscous": 90.0,
        "level": 32.0,
        "breakaway": 46.0,
        "slowing": 0.02,
        "gain": 30.0,
    }

    def rate(t, x, u, warmth):
        q, v = x
        drive = np.clip(u[0], -6.0, 6.0) if effects else u[0]
        falling = np.exp(-((v / p["slowing"]) ** 2))
        dry = (p["level"] + (p["breakaway"] - p["level"]) * falling) * np.tanh(v / 0.002)
        dry = dry * (1 - 0.25 * warmth + 0.1 * effects * np.sign(v))
        cogging = effects * 4.0 * np.sin(2 * np.pi * q / 0.02)
        return np.stack([v, (p["gain"] * drive - p["viscous"] * v - dry + cogging) / p["mass"]])

    gain = np.array([[110.0, 12.0]])

    def runs(rng):
        def run(name, reference):
            return Run(name, 10.0, (), (reference,))

        fit = [run(f"moves{i}", moves(rng, 2.0, 0.12, 10, 0.5 + 0.2 * i)) for i in range(5)]
        fit += [run(f"sines{i}", multisine(rng, 0.2, 2.5, 0.035, 12)) for i in range(3)]
        return fit, [
            run("jumps", steps(rng, 2.5, 0.06, 10)),
            run("sweep", chirp(0.2, 3, 0.04, 10)),
            run("creep", moves(rng, 5.0, 0.15, 10, 4.0)),
        ]

    return Machine(
        name="positioning-axis",
        dt=0.005,
        substeps=10,
        states=2,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(Sensor("carriage", "linear", "carriage_mm", "mm", step=0.005),),
        actuators=(Actuator("control", "V"),),
        comparable=2.0,
        make_controller=lambda: StateFeedback(gain, 0.005, 10.0, 0.5, np.array([[1.0]])),
    )


def reaction_wheel(effects: bool = True) -> Machine:
    """A pendulum that hangs and swings by the reaction of a wheel, whose counter wraps."""
    p = {
        "pendulum": 0.0105,
        "wheel": 3.2e-4,
        "gravity": 0.58,
        "pivot": 9e-4,
        "bearing": 1.4e-4,
        "gain": 0.021,
        "dry": 2e-3,
    }

    def rate(t, x, u, warmth):
        angle, _, v, spin = x  # spin: of the wheel relative to the pendulum
        torque = p["gain"] * dead_zone(u[0], 0.3 * effects) - p["bearing"] * spin
        torque = torque - p["dry"] * (1 - 0.3 * warmth) * np.tanh(spin / 0.5)
        rub = p["pivot"] * v + effects * 1.5e-3 * np.tanh(v / 0.05)
        swing = (-p["gravity"] * np.sin(angle) - rub - torque) / p["pendulum"]
        return np.stack([v, spin, swing, torque / p["wheel"] - swing])

    def runs(rng):
        def run(name, signal, largest=1.0):
            return Run(name, 12.0, (rng.uniform(-largest, largest),), (signal,))

        fit = [run(f"levels{i}", steps(rng, 0.5, 1.2, 12)) for i in range(4)]
        fit += [run(f"sines{i}", multisine(rng, 0.2, 3.0, 0.5)) for i in range(4)]
        fit += [run(f"release{i}", constant(), 2.2) for i in range(2)]
        return fit, [
            run("sweep", chirp(0.3, 3.0, 0.8, 12)),
            run("slow", steps(rng, 1.5, 0.8, 12)),
            run("wide", multisine(rng, 0.2, 5.0, 0.6), 1.8),
        ]

    return Machine(
        name="reaction-wheel",
        dt=0.01,
        substeps=10,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor(
                "pendulum",
                "angular",
                "pendulum_counts",
                "counts",
                counts=4096,
                eccentricity=effects * 0.002,
            ),
            Sensor("wheel", "angular", "wheel_counts", "counts", counts=2400, wraps=True),
        ),
        actuators=(Actuator("current", "A", noise=0.01 * effects),),
        jitter=8e-5,
        comparable=3.0,
    )


def planar_arm(effects: bool = True) -> Machine:
    """An arm of four links in a vertical plane; every joint has a motor and a controller."""
    masses, lengths = np.array([2.2, 1.6, 1.1, 0.6]), np.array([0.30, 0.26, 0.22, 0.15])
    centres = 0.45 * lengths
    behind = np.array([masses[i + 1 :].sum() for i in range(4)])
    moments = masses * centres + behind * lengths
    coupling = np.diag(masses * lengths**2 / 10 + masses * centres**2 + behind * lengths**2)
    for i in range(4):
        for j in range(i):
            coupling[i, j] = coupling[j, i] = moments[i] * lengths[j]
    viscous, dry = np.array([[0.9], [0.7], [0.4], [0.2]]), np.array([[0.5], [0.4], [0.25], [0.1]])
    p = {f"mass{i + 1}": masses[i] for i in range(4)}
    p |= {f"viscous{i + 1}": viscous[i, 0] for i in range(4)}
    p |= {f"dry{i + 1}": dry[i, 0] for i in range(4)}

    def rate(t, x, u, warmth):
        q, v = x[:4], x[4:]
        limits = np.array([[22.0], [12.0], [6.0], [2.0]])
        drive = np.clip(u, -limits, limits) if effects else u
        rub = viscous * (1 - 0.2 * warmth) * v + dry * np.tanh(v / 0.05)
        rub = rub + effects * 0.2 * dry * np.sin(q + 1)
        return np.concatenate([v, chain_acceleration(q, v, drive - rub, coupling, moments)])

    gain = np.concatenate([np.diag([60.0, 35.0, 14.0, 4.0]), np.diag([6.0, 3.5, 1.2, 0.3])], axis=1)

    def runs(rng):
        sizes = (0.7, 0.8, 0.9, 1.0)

        def run(name, references):
            return Run(name, 10.0, (), tuple(soft_start(r) for r in references))

        fit = [run(f"moves{i}", [moves(rng, 2.0, a, 10, 0.9) for a in sizes]) for i in range(6)]
        fit += [
            run(f"sines{i}", [multisine(rng, 0.1, 1.0, a / 3, 8) for a in sizes]) for i in range(4)
        ]
        return fit, [
            run("jumps", [steps(rng, 2.5, a / 2, 10) for a in sizes]),
            run("slow", [moves(rng, 5.0, a, 10, 3.0) for a in sizes]),
            run("wave", [chirp(0.1, 0.9, a / 2, 10) for a in sizes]),
        ]

    return Machine(
        name="planar-arm",
        dt=0.01,
        substeps=10,
        states=8,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=tuple(
            Sensor(f"joint{i}", "angular", f"q{i}", "rad", step=2 * np.pi / 4096)
            for i in range(1, 5)
        ),
        actuators=tuple(Actuator(f"torque{i}", "N m", noise=0.01 * effects) for i in range(1, 5)),
        make_controller=lambda: StateFeedback(gain, 0.01, 30.0, 0.5, np.eye(4)),
        comparable=2.0,
    )


def flexible_beam(effects: bool = True) -> Machine:
    """A clamped beam with two modes; one sensor and one shaker near its middle."""
    p = {
        "mass": 0.4,
        "stiffness": 420.0,
        "damping": 0.25,
        "tip": 0.16,
        "bend": 260.0,
        "inner": 0.06,
    }

    def rate(t, x, u, warmth):
        q, v, tip, w = x
        bend = p["bend"] * (q - tip) + p["inner"] * (v - w)
        root = p["stiffness"] * q * (1 - 0.02 * warmth) + p["damping"] * v
        root = root + effects * (4e5 * q**3 + 0.02 * np.tanh(v / 0.01))
        drag = effects * 0.05 * w * abs(w)
        return np.stack([v, (u[0] - root - bend) / p["mass"], w, (bend - drag) / p["tip"]])

    def runs(rng):
        def run(name, signal, seconds=8.0):
            return Run(name, seconds, (), (signal,))

        fit = [run(f"sines{i}", multisine(rng, 0.5, 15.0, 0.8 + 0.4 * i)) for i in range(4)]
        fit += [run(f"levels{i}", steps(rng, 0.4, 3.0, 8)) for i in range(4)]
        return fit, [
            run("sweep", chirp(0.5, 15.0, 2.0, 8)),
            run("slow", steps(rng, 1.0, 3.5, 8)),
            run("small", multisine(rng, 0.5, 15.0, 0.6)),
        ]

    return Machine(
        name="flexible-beam",
        dt=0.005,
        substeps=10,
        states=4,
        rate=rate,
        runs=runs,
        truth=p,
        sensors=(
            Sensor("deflection", "linear", "deflection_mm", "mm", step=0.002, noise=0.01 * effects),
        ),
        actuators=(Actuator("force", "N", noise=0.005 * effects),),
    )


MACHINES: dict[str, Callable[[bool], Machine]] = {
    make().name: make
    for make in (
        double_pendulum,
        cart_pole,
        unbalanced_disc,
        gantry_crane,
        two_mass_drive,
        duffing,
        ball_on_beam,
        propeller_pendulum,
        positioning_axis,
        reaction_wheel,
        planar_arm,
        flexible_beam,
    )
}
