"""Vector drawings after Figures 1 and 2 of the paper: the apparatus and the Tustin-Net."""

from typing import Literal

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, PathPatch, Polygon, Rectangle
from matplotlib.path import Path
from numpy.typing import ArrayLike

from tustinnet.report.drawing import COLOURS, INPUT, MEASURED, figure_style

Pair = tuple[float, float]

_PENDULUM, _TORQUE, _CABLE, _, _FAINT = COLOURS
_PALE, _SHADE, _NETWORK, _RULE = "#eef1f4", "#dbe1e7", "#dfe8f1", "#e0f0e6"
_THETA, _ALPHA = np.radians(62), np.radians(24)
_VIEW, _TILT = np.radians(26), np.radians(33)  # where the sketch is seen from
_BASE, _SHAFT, _REACH, _LENGTH, _CENTRE = 0.84, 0.36, 1.35, 1.5, 0.85  # lengths in the drawing
_SQUARE = ((1, -1), (1, 1), (-1, 1), (-1, -1), (1, -1))
_LOW, _ROW, _TOP = 0.95, 1.95, 2.65  # the scheme's rows, in inches


def mechanism_figure() -> Figure:
    """Figure 1: the rotary pendulum with its coordinates and forces, and two views of it.

    Both angles count counter-clockwise about their axes: `theta` about the motor's, which points
    up, from the centre line; `alpha` about the arm's, which points outwards, from the upright.
    """
    with figure_style():
        figure = Figure(figsize=(7.0, 4.0))
        sketch = _panel(figure, (0.0, 0.0, 4.4, 4.0), (-1.24, -1.38), 2.84)
        for draw in (_draw_base, _draw_arm, _draw_pendulum):
            draw(sketch)
        _draw_top_view(_panel(figure, (4.4, 2.05, 2.6, 1.95), (-0.68, -0.56), 2.6))
        _draw_side_view(_panel(figure, (4.4, 0.0, 2.6, 2.05), (-1.25, -0.44), 2.6))
        return figure


def architecture_figure() -> Figure:
    """Figure 2: the Tustin-Net's step, network below and trapezoidal rule above, and feedback."""
    with figure_style():
        figure = Figure(figsize=(7.5, 3.0))
        axes = _panel(figure, (0.0, 0.0, 7.5, 3.0), (0.0, 0.0), 7.5)
        for draw in (_draw_features, _draw_network, _draw_integration):
            draw(axes)
        return figure


def _draw_base(axes: Axes) -> None:
    """Draws the cube that holds the motor, and the shaft on it."""
    half, top, bottom = _BASE / 2, -_SHAFT, -_SHAFT - _BASE
    corners = [(half * x, half * y) for x, y in _SQUARE[:4]]
    faces = [([(*corner, top) for corner in corners], "white")]
    for (a, b), shade in ((corners[:2], _PALE), (corners[1:3], _SHADE)):
        faces.append(([(*a, top), (*b, top), (*b, bottom), (*a, bottom)], shade))
    near, full = _VIEW + np.linspace(-np.pi / 2, np.pi / 2, 40), np.linspace(0, 2 * np.pi, 80)
    wall = np.vstack([_ring(near, 0.1, top), _ring(near[::-1], 0.1)])
    for face, shade in (*faces, (wall, _SHADE), (_ring(full, 0.1), "white")):
        axes.add_patch(Polygon(_project(face), facecolor=shade, edgecolor=MEASURED, lw=0.9))
    _label(axes, _project((half, 0.0, (top + bottom) / 2)), "base with\nDC motor", 8)


def _draw_arm(axes: Axes) -> None:
    """Draws the motor's axis and torque, the centre line, the arm and the angle between the two."""
    end = _ring(_THETA, _REACH)
    _line(axes, _project([(0, 0, 0), (0, 0, 1.24)]), _FAINT, "-.")
    _line(axes, _project([(0, 0, 0), (1.5, 0, 0)]), _FAINT, "--")
    _line(axes, _project([end, 1.33 * end]), _FAINT, "-.")
    _arrow(axes, _project(_ring(np.linspace(0, _THETA - 0.08, 40), 0.76)))
    turn = _VIEW + np.linspace(-2.2, 2.6, 80)  # open at the back, where it would cross the axis
    _arrow(axes, _project(_ring(turn, 0.24, 0.5)), _TORQUE, 1.6)
    _rod(axes, _project([0 * end, end]), INPUT)
    _label(axes, _project(_ring(_THETA / 2, 0.91)), r"$\theta$", 11)
    _label(axes, (-0.31, 0.42), r"$\tau(U)$", 10, _TORQUE, "right")
    _label(axes, (0.25, 0.0), r"$L_r$", 10)
    _label(axes, (-0.9, -0.83), "centre line", 8, _FAINT)
    _label(axes, (0.0, 1.11), "motor axis", 8, _FAINT)
    _label(axes, (1.13, -0.78), "arm axis", 8, _FAINT, "left")


def _draw_pendulum(axes: Axes) -> None:
    """Draws the pendulum at the arm's end, its angle, gravity, and the cable back to the base."""
    hinge = _ring(_THETA, _REACH)
    foot, tip, centre = _project(hinge + np.outer((0, _LENGTH, _CENTRE), _lean(_ALPHA)))
    socket = _project((0.0, _BASE / 2, -_SHAFT - 0.62 * _BASE))
    bends = [foot, np.add(foot, (0.1, -0.55)), np.add(socket, (0.5, -0.2)), socket]
    cable = Path(bends, (Path.MOVETO, *3 * (Path.CURVE4,)))
    axes.add_patch(PathPatch(cable, fill=False, edgecolor=_CABLE, linewidth=1.6))
    _line(axes, _project([hinge, hinge + _LENGTH * _lean(0.0)]), _FAINT, "--")
    _arrow(axes, _project(hinge + 1.2 * _lean(np.linspace(0, _ALPHA - 0.05, 40))))
    _rod(axes, [foot, tip], _PENDULUM)
    for place, colour in ((foot, MEASURED), (centre, _PENDULUM), (socket, _CABLE)):
        _mark(axes, place, colour)
    _arrow(axes, [(1.25, 0.85), (1.25, 0.45)], width=1.4)
    _label(axes, (1.34, 0.65), "$g$", 11)
    _label(axes, _project(hinge + 1.34 * _lean(_ALPHA / 2)), r"$\alpha$", 11)
    _label(axes, (1.06, -1.14), "encoder cable\n(elastic force on the arm)", 8, _CABLE)


def _draw_top_view(axes: Axes) -> None:
    """Draws the angle of the arm, seen from above."""
    _box(axes, (0.0, 0.0), (_BASE, _BASE), face=_PALE)
    _draw_rod(axes, 0.0, _THETA, _REACH, INPUT, r"$\theta$", "$L_r$", _REACH)
    _label(axes, (1.35, -0.13), "centre line", 8, _FAINT, "right")
    _label(axes, (0.75, 1.12), "arm", 8, INPUT, "left")
    _label(axes, (1.8, -0.37), "view from above", 8, ha="right")


def _draw_side_view(axes: Axes) -> None:
    """Draws the angle of the pendulum, seen from the arm's end towards the motor."""
    _draw_rod(axes, np.pi / 2, _ALPHA, _LENGTH, _PENDULUM, r"$\alpha$", "$l_p$", _CENTRE)
    _mark(axes, (0, 0), MEASURED, INPUT, 9)  # the arm, seen end on
    _label(axes, (0.1, 1.4), "upright", 8, _FAINT, "left")
    _label(axes, (-0.7, 1.4), "pendulum", 8, _PENDULUM, "right")
    _label(axes, (-0.53, 0.9), "centre of mass", 8, _FAINT, "right")
    _label(axes, (0.12, 0.0), "hinge with encoder", 8, _FAINT, "left")
    _label(axes, (1.23, -0.26), "view from the arm's end", 8, ha="right")


def _draw_rod(
    axes: Axes,
    zero: float,
    turn: float,
    length: float,
    colour: str,
    angle_name: str,
    length_name: str,
    named_length: float,
) -> None:
    """Draws a rod at the angle `turn` from the direction `zero`, with its angle and a length."""
    along, normal = _ring(zero + turn)[:2], _ring(zero + turn + np.pi / 2)[:2]
    _line(axes, np.outer((0, length), _ring(zero)[:2]), _FAINT, "--")
    _arrow(axes, _ring(zero + np.linspace(0, turn - 0.07, 40), 0.7 * length)[:, :2])
    _rod(axes, np.outer((0, length), along), colour)
    _mark(axes, np.outer((0, named_length), along), MEASURED)
    for end in (0 * along, named_length * along):
        _line(axes, end + np.outer((0.08, 0.24), normal))
        _arrow(axes, [named_length * along / 2 + 0.18 * normal, end + 0.18 * normal], width=0.7)
    _label(axes, _ring(zero + turn / 2, 0.7 * length + 0.14)[:2], angle_name, 11)
    _label(axes, named_length * along / 2 + 0.31 * normal, length_name, 10)


def _draw_features(axes: Axes) -> None:
    """Draws state and input, and the features of them that the network gets."""
    cells = (r"$\sin q_k$", r"$\cos q_k$", "$v_k$", "$u_k$")
    rows = [_LOW + 0.32 * (1.5 - place) for place in range(len(cells))]
    for text, y in zip(cells, rows, strict=True):
        _box(axes, (1.12, y), (0.58, 0.32), text)
        _arrow(axes, [(0.3 if y == rows[-1] else 0.62, y), (0.83, y)])
    _line(axes, [(0.62, _ROW), (0.62, rows[2])])
    _mark(axes, [(0.62, y) for y in (_ROW, *rows[:2])], MEASURED, MEASURED, 3)
    _label(axes, (0.16, rows[-1]), "$u_k$")
    _label(axes, (1.12, _LOW - 0.78), "concatenated features", 8, _FAINT)


def _draw_network(axes: Axes) -> None:
    """Draws the layers of the network, and the step of the velocity by their output."""
    _line(axes, np.add((2.69, _LOW), np.multiply((1.11, 0.42), _SQUARE)), _FAINT, "--")
    layers = ((1.9, 0.4, r"$\phi_1$"), (2.82, 0.4, r"$\phi_M$"), (3.44, 0.48, "$W_{M+1}$"))
    for x, width, text in layers:
        _box(axes, (x, _LOW), (width, 0.46), text, _NETWORK)
    _box(axes, (4.16, _LOW), (0.3, 0.32), r"$\tau_s$")
    ends = ((1.41, 1.7), (2.1, 2.26), (2.46, 2.62), (3.02, 3.2), (3.68, 4.01), (4.31, 4.58))
    for begin, end in ends:
        _arrow(axes, [(begin, _LOW), (end, _LOW)])
    _arrow(axes, [(4.68, _ROW), (4.68, _LOW + 0.1)])
    _mark(axes, (4.68, _LOW), MEASURED, size=14)
    _label(axes, (4.68, _LOW), "$+$")
    _label(axes, (2.36, _LOW), r"$\cdots$", 11)
    _label(axes, (4.53, (_ROW + _LOW) / 2), "$v_k$")
    _label(axes, (2.69, _LOW - 0.54), r"network $f(\,\cdot\,;\Theta)$", 8, _FAINT)
    _label(axes, (4.42, _LOW - 0.54), "explicit step", 8, _FAINT)


def _draw_integration(axes: Axes) -> None:
    """Draws the trapezoidal rule of both velocities, and the feedback through the delay."""
    middle, rule = (_ROW + _LOW) / 2, r"$q_{k+1} = q_k + \tau_s\,\dfrac{v_k + v_{k+1}}{2}$"
    _box(axes, (5.78, _ROW), (1.68, 0.54), rule, _RULE)
    _box(axes, (7.1, middle), (0.06, _ROW - _LOW + 0.3), face=MEASURED)
    _box(axes, (3.75, _TOP), (0.4, 0.32), "$z^{-1}$")
    _arrow(axes, [(3.55, _TOP), (0.3, _TOP), (0.3, _ROW), (4.94, _ROW)])
    _arrow(axes, [(7.13, middle), (7.34, middle), (7.34, _TOP), (3.95, _TOP)])
    _arrow(axes, [(4.78, _LOW), (7.07, _LOW)])
    _arrow(axes, [(5.78, _LOW), (5.78, _ROW - 0.27)])
    _arrow(axes, [(6.62, _ROW), (7.07, _ROW)])
    _mark(axes, [(4.68, _ROW), (5.78, _LOW)], MEASURED, MEASURED, 3)
    _label(axes, (5.78, _ROW + 0.38), "trapezoidal rule", 8, _FAINT)
    _label(axes, (6.83, _LOW + 0.13), "$v_{k+1}$")
    _label(axes, (6.83, _ROW + 0.13), "$q_{k+1}$")
    _label(axes, (6.6, _TOP + 0.15), r"$x_{k+1} = [\,q_{k+1},\; v_{k+1}\,]$")
    _label(axes, (1.2, _TOP + 0.15), r"$x_k = [\,q_k,\; v_k\,], \quad v = \dot{q}$")


def _project(points: ArrayLike) -> Float[np.ndarray, "*n 2"]:
    """Projects points in space, x along the centre line and z upwards, onto the sketch."""
    x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
    towards = x * np.cos(_VIEW) + y * np.sin(_VIEW)
    up = z * np.cos(_TILT) - towards * np.sin(_TILT)
    return np.stack([y * np.cos(_VIEW) - x * np.sin(_VIEW), up], axis=-1)


def _ring(angle: ArrayLike, radius: float = 1, height: float = 0) -> Float[np.ndarray, "*n 3"]:
    """Points about the motor's axis, by their angle to the centre line."""
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.stack([x, y, np.full_like(x, height)], axis=-1)


def _lean(angle: ArrayLike) -> Float[np.ndarray, "*n 3"]:
    """The pendulum's direction: the upright turned by `angle` about the arm."""
    sine = np.sin(angle)
    return np.stack([sine * np.sin(_THETA), -sine * np.cos(_THETA), np.cos(angle)], axis=-1)


def _panel(figure: Figure, inches: tuple[float, ...], corner: Pair, width: float) -> Axes:
    """A blank panel, given by its place in inches, its lower left corner and its width in data."""
    axes = figure.add_axes(tuple(np.array(inches) / np.tile(figure.get_size_inches(), 2)))
    axes.set_axis_off()
    axes.set_xlim(corner[0], corner[0] + width)
    axes.set_ylim(corner[1], corner[1] + width * inches[3] / inches[2])
    return axes


def _line(axes: Axes, points: ArrayLike, colour: str = MEASURED, style: str = "-") -> None:
    axes.plot(*np.transpose(points), color=colour, linestyle=style, linewidth=0.9)


def _arrow(axes: Axes, points: ArrayLike, colour: str = MEASURED, width: float = 0.9) -> None:
    """Draws an arrow along any line."""
    arrow = FancyArrowPatch(path=Path(points), arrowstyle="-|>", color=colour, linewidth=width)
    axes.add_patch(arrow).set(mutation_scale=9, zorder=3)


def _rod(axes: Axes, ends: ArrayLike, colour: str) -> None:
    for width, shade in ((6.5, MEASURED), (5.0, colour)):  # the wider one stays as a dark edge
        axes.plot(*np.transpose(ends), color=shade, linewidth=width, solid_capstyle="round")


def _mark(axes: Axes, at: ArrayLike, edge: str, face: str = "white", size: float = 5) -> None:
    axes.plot(*np.transpose(at), "o", color=face, markeredgecolor=edge, markersize=size)


def _box(axes: Axes, centre: Pair, size: Pair, text: str = "", face: str = "white") -> None:
    corner = (centre[0] - size[0] / 2, centre[1] - size[1] / 2)
    axes.add_patch(Rectangle(corner, *size, facecolor=face, edgecolor=MEASURED, linewidth=0.9))
    _label(axes, centre, text)


def _label(
    axes: Axes,
    at: ArrayLike,
    text: str,
    size: float = 9,
    colour: str = MEASURED,
    ha: Literal["left", "center", "right"] = "center",
) -> None:
    x, y = np.asarray(at)
    axes.text(x, y, text, fontsize=size, color=colour, ha=ha, va="center", parse_math=True)
