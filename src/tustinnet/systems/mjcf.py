"""Robots from files in MuJoCo's format (MJCF), compiled by MuJoCo.

Defaults, orientations in a dozen notations and inertias of shapes are MuJoCo's to resolve. Meshes,
textures and whatever else is only seen or touched is taken out before, so no file of them is read.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from tustinnet.data.reading_process import call
from tustinnet.errors import InputError, convert_errors, require_package
from tustinnet.lazy_package import LateModule
from tustinnet.systems.robot import (
    Lead,
    LinkInertia,
    Mimic,
    Remarks,
    Robot,
    RobotActuator,
    RobotJoint,
    RobotLink,
    parse_xml,
    require_few_joints,
    without_rounding,
)

mujoco = LateModule("mujoco")  # no types are known
_EXPECTED = "a robot in MuJoCo's format (MJCF)"
_SECONDS = 20.0  # to compile a file; a humanoid with its hands takes a tenth of one
_MEMORY = 2**30  # bytes, for it
_WORLD = 0  # the body that everything stands on
# sections of a file that no equation of motion needs, and that may name files
_UNUSED = (
    "meshes",
    "hfields",
    "skins",
    "flexes",
    "materials",
    "textures",
    "sensors",
    "keys",
    "pairs",
    "excludes",
    "cameras",
    "lights",
)
_READS_FILES = ("include", "model", "attach", "flexcomp", "plugin")
# numbers of a compiled model that stand for forces without equations here, by what they are
_UNSUPPORTED = {
    "body_gravcomp": "gravity compensation",
    "dof_dampingpoly": "damping that is not linear",
    "jnt_stiffnesspoly": "springs that are not linear",
    "actuator_damping": "damping of actuators beside that of joints",
    "actuator_armature": "armatures of actuators beside those of joints",
    "actuator_delay": "delays of actuators, which a data card has at its inputs",
}
# of an actuator's gain and bias, by MuJoCo's numbers
_FIXED_GAIN, _NO_BIAS, _AFFINE_BIAS = 0, 0, 1
# what MuJoCo says of a moving body without inertia, and its name
_MASSLESS = re.compile(r"mass and inertia of moving bodies.*Element name '([^']*)'", re.DOTALL)
_ADD_INERTIA = 'add <inertial pos="..." mass="..." fullinertia="..."/>'
_AT_JOINTS = (0, 1)  # transmissions: at a joint, and at one in its parent's frame


def include_files(text: str, where: object, read: Callable[[str], str]) -> str:
    """The text of a file with what it includes in the place of <include file="..."/>.

    Args:
        text: the text.
        where: the file, for messages.
        read: gives the text of an included file by its name.

    Raises:
        InputError: no XML, a file that cannot be read, or one that is included twice.
    """
    root, included = parse_xml(text, where, _EXPECTED), set[str]()
    if root.find(".//include") is None:
        return text
    while True:
        parents = {child: parent for parent in root.iter() for child in parent}
        include = root.find(".//include")
        if include is None:
            return ET.tostring(root, "unicode")
        name = include.get("file", "")
        if not name or name in included:
            raise InputError(
                where, f"includes '{name}'" + (" twice" if name else ""), "each file once"
            )
        included.add(name)
        content = parse_xml(read(name), name, _EXPECTED)
        parent = parents[include]
        place = list(parent).index(include)
        parent[place : place + 1] = list(content)


def read_mjcf(text: str, path: Path) -> Robot:
    """The robot of a file in MuJoCo's format, compiled in a process of its own.

    A few characters of such a file may stand for gigabytes of shapes.

    Args:
        text: the file's text, without includes.
        path: the file, for messages.

    Raises:
        InputError: MuJoCo is not installed or refuses the file, or takes too long or too much
            memory; joints, actuators or forces without equations here; a body whose inertia is that
            of a mesh.
    """
    require_package("mujoco", "robots", path)
    modules = (__name__, "mujoco")
    plain, _ = call(
        path, f"{__name__}:compile_mjcf", [text], seconds=_SECONDS, modules=modules, memory=_MEMORY
    )
    return TypeAdapter(Robot).validate_python(plain)


def compile_mjcf(where: Path, text: str) -> tuple[dict[str, Any], list[np.ndarray]]:
    """The robot of a file in MuJoCo's format as plain values, and no columns of numbers.

    Args:
        where: the file, for messages.
        text: the file's text, without includes.

    Raises:
        InputError: see `read_mjcf`.
    """
    root = parse_xml(text, where, _EXPECTED)
    if root.tag != "mujoco":
        raise InputError(
            where,
            f"the root element <{root.tag}>",
            "<mujoco>",
            "a URDF file has the ending .urdf" if root.tag == "robot" else "is it a MJCF file?",
        )
    for tag in _READS_FILES:
        if root.find(f".//{tag}") is not None:
            raise InputError(
                where,
                f"<{tag}>, which stands for other files",
                _EXPECTED,
                "write its content into the file",
            )
    spec, model = _compile(text, where)
    has_shape = {body.name for body in spec.bodies if body.geoms}
    return asdict(_robot_of(model, has_shape, where)), []


def joint_forces(
    text: str, where: object, lead: Lead
) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """A function of positions and velocities of coordinates: what MuJoCo makes of a file.

    It gives the mass matrix, and the forces of gravity, motion, dampers and springs [N m or N];
    without actuators, dry friction and contacts.

    Args:
        text: the text of a file that has been read.
        where: the file, for messages.
        lead: the motion of its joints by the coordinates.

    Raises:
        InputError: MuJoCo refuses it.
    """
    _, model = _compile(text, where)
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    joints = [model.joint(name) for name in lead.joints]
    positions, places = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]

    def forces(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        data.qpos[positions], data.qvel[places] = lead.ratios @ q + lead.offsets, lead.ratios @ v
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        mass = lead.ratios.T @ full[np.ix_(places, places)] @ lead.ratios
        return mass, lead.ratios.T @ (data.qfrc_passive - data.qfrc_bias)[places]

    return forces


def _compile(text: str, where: object) -> tuple[Any, Any]:
    """The specification of a text without what is only seen or touched, and its compiled model.

    Raises:
        InputError: MuJoCo refuses it.
    """
    with convert_errors(where, "MuJoCo refuses it", _EXPECTED):
        spec = mujoco.MjSpec.from_string(text)
    _remove_seen(spec, where)
    with convert_errors(where, "MuJoCo refuses it", _EXPECTED):
        try:
            return spec, spec.compile()
        except ValueError as error:
            if (massless := _MASSLESS.search(str(error))) is None:
                raise
            raise InputError(
                f"{where}, body '{massless[1]}'",
                "moves and has no inertia",
                "mass, centre and inertia",
                f"{_ADD_INERTIA}, or shapes (<geom>)",
            ) from None


def _remove_seen(spec: Any, where: object) -> None:
    """Takes out what is only seen or touched; shapes stay where inertias are computed of them.

    Raises:
        InputError: an inertia would be computed of a mesh.
    """
    by_shape = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    shapes = {mujoco.mjtGeom.mjGEOM_MESH, mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF}
    groups = range(spec.compiler.inertiagrouprange[0], spec.compiler.inertiagrouprange[1] + 1)
    for body in spec.bodies:
        needs_shapes = _moves(body) and (by_shape or not body.explicitinertial)
        for shown in (*body.geoms, *body.sites):
            shown.material = ""
        for geom in list(body.geoms):
            if geom.type not in shapes and not geom.meshname:
                continue
            has_mass = geom.mass != 0 and geom.density != 0 and geom.group in groups
            if needs_shapes and has_mass:
                raise InputError(
                    f"{where}, body '{body.name}'",
                    "no <inertial>: its inertia would be that of a mesh, which is not read",
                    "mass, centre and inertia",
                    _ADD_INERTIA,
                )
            spec.delete(geom)
    for name in _UNUSED:
        for element in list(getattr(spec, name, ())):
            spec.delete(element)


def _moves(body: Any) -> bool:
    while body is not None and body.id != _WORLD:
        if body.joints:
            return True
        body = body.parent
    return False


def _robot_of(model: Any, has_shape: set[str], where: object) -> Robot:
    """The description of a compiled model."""
    _require_supported(model, where)
    require_few_joints(model.njnt, where)
    links, joints, remarks = [], [], Remarks()
    for i in range(model.nbody):
        body = model.body(i)
        is_frame = body.name not in has_shape
        links.append(RobotLink(body.name, _inertia_of(model, i), is_frame))
        if i == _WORLD:
            continue
        parent = model.body(model.body_parentid[i]).name
        rotation, position = _matrix(model.body_quat[i]), model.body_pos[i].copy()
        first, count = int(model.body_jntadr[i]), int(model.body_jntnum[i])
        if count and model.jnt_type[first] == mujoco.mjtJoint.mjJNT_FREE:
            remarks["stands where the file has it, and does not move freely"].append(body.name)
            count = 0
        if not count:
            joints.append(
                RobotJoint(
                    body.name,
                    "fixed",
                    parent,
                    body.name,
                    rotation,
                    position,
                    np.zeros(3),
                    np.zeros(3),
                )
            )
        for k in range(first, first + count):
            is_last = k == first + count - 1
            child = body.name if is_last else f"{body.name}@{model.joint(k).name}"
            if not is_last:
                links.append(RobotLink(child, None, is_frame=True))
            joints.append(_joint_of(model, k, parent, child, rotation, position, where))
            # further joints of a body begin where the one before ends
            parent, rotation, position = child, np.eye(3), np.zeros(3)
    has_gravity = not _is_disabled(model, "GRAVITY")
    x, y, z = (float(g) * has_gravity for g in model.opt.gravity)
    # the names of a compiled model begin with its own
    name = bytes(model.names).split(b"\0", 1)[0].decode(errors="replace")
    return Robot(
        name or "robot",
        tuple(links),
        tuple(joints),
        _actuators_of(model, where),
        (x, y, z),
        remarks.sentences(),
    )


def _is_disabled(model: Any, name: str) -> bool:
    """Whether a file switches off a kind of force, by <flag>."""
    return bool(model.opt.disableflags & getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))


def _require_supported(model: Any, where: object) -> None:
    """Raises for constraints and forces that a file may have and the equations here have not."""
    for name, what in _UNSUPPORTED.items():
        if np.any(getattr(model, name, 0)):
            raise InputError(where, what, "forces that are linear, and gravity", "leave it out")
    if model.opt.density or model.opt.viscosity:
        raise InputError(where, "a fluid around the robot", "none", "leave density, viscosity out")
    for tendon in range(model.ntendon):
        if model.tendon_stiffness[tendon] or model.tendon_damping[tendon]:
            name = model.tendon(tendon).name
            raise InputError(where, f"a spring or damper in the tendon '{name}'", "at joints")
    for i in range(model.neq):
        kind = mujoco.mjtEq(model.eq_type[i])
        if not model.eq_active0[i] or kind == mujoco.mjtEq.mjEQ_JOINT:
            continue
        is_loop = kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD)
        name, called = model.equality(i).name, kind.name.removeprefix("mjEQ_").lower()
        which = f"'{name}'" if name else f"number {i + 1}, without a name"
        what = f"the equality constraint {which} ({called})"
        raise InputError(
            where,
            f"a loop: {what}" if is_loop else what,
            "a tree, of joints that follow others at most",
            "write a closed chain down: docs/how-to/add-a-system.md"
            if is_loop
            else "write it as one of joints, or leave it out",
        )


def _joint_of(
    model: Any,
    k: int,
    parent: str,
    child: str,
    rotation: np.ndarray,
    position: np.ndarray,
    where: object,
) -> RobotJoint:
    """The joint of index k."""
    name, kind = model.joint(k).name, mujoco.mjtJoint(model.jnt_type[k])
    place = f"{where}, joint '{name}'"
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        raise InputError(
            place, "a ball joint", "joints of the types hinge and slide", "write it as three hinges"
        )
    if not name:
        raise InputError(f"{where}, body '{child}'", "a joint without a name", "a name")
    dof, zero = int(model.jnt_dofadr[k]), float(model.qpos0[model.jnt_qposadr[k]])
    has_damper, has_spring, has_friction = (
        not _is_disabled(model, name) for name in ("DAMPER", "SPRING", "FRICTIONLOSS")
    )
    return RobotJoint(
        name,
        "angular" if kind == mujoco.mjtJoint.mjJNT_HINGE else "linear",
        parent,
        child,
        rotation,
        position,
        without_rounding(model.jnt_axis[k]),
        model.jnt_pos[k].copy(),
        zero=zero,
        mimic=_mimic_of(model, k, place),
        armature=float(model.dof_armature[dof]),
        viscous=float(np.ravel(model.dof_damping[dof])[0]) * has_damper,
        coulomb=float(model.dof_frictionloss[dof]) * has_friction,
        stiffness=float(np.ravel(model.jnt_stiffness[k])[0]) * has_spring,
        spring_rest=float(model.qpos_spring[model.jnt_qposadr[k]]),
        actuator_range=_limits_of(model.jnt_actfrclimited[k], model.jnt_actfrcrange[k]),
        range=_range_of(model.jnt_limited[k], model.jnt_range[k]),
    )


def _mimic_of(model: Any, k: int, place: str) -> Mimic | None:
    """The joint that a joint follows by an equality constraint."""
    for i in np.flatnonzero(model.eq_active0 & (model.eq_obj1id == k)):
        other, (constant, slope, *higher) = int(model.eq_obj2id[i]), model.eq_data[i, :5].tolist()
        if other < 0 or any(higher):
            raise InputError(
                place,
                f"the equality constraint '{model.equality(i).name}'",
                "that it follows another joint at a fixed ratio",
                "lock it, or leave it out",
            )
        own, leading = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (k, other))
        return Mimic(model.joint(other).name, slope, own + constant - slope * leading)
    return None


def _actuators_of(model: Any, where: object) -> tuple[RobotActuator, ...]:
    """The actuators, of which each must be at a joint and linear."""
    actuators, has_input_range = [], not _is_disabled(model, "CLAMPCTRL")
    for i in range(model.nu):
        name, joint = model.actuator(i).name, int(model.actuator_trnid[i, 0])
        place = f"{where}, actuator '{name or i}'"
        if model.actuator_trntype[i] not in _AT_JOINTS:
            raise InputError(place, "not at a joint", 'joint="..."', "leave it out")
        integrates = bool(model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_INTEGRATOR)
        if (
            (model.actuator_dyntype[i] and not integrates)
            or model.actuator_gaintype[i] != _FIXED_GAIN
            or model.actuator_biastype[i] not in (_NO_BIAS, _AFFINE_BIAS)
        ):
            raise InputError(
                place,
                "states of its own, or forces that are not linear",
                "a motor, or a servo without a lag",
                'write it as a motor and add a lag: [model] forces = ["lag"]',
            )
        has_bias = model.actuator_biastype[i] != _NO_BIAS
        bias, by_position, by_speed = (has_bias * model.actuator_biasprm[i, :3]).tolist()
        joint_name = model.joint(joint).name
        actuators.append(
            RobotActuator(
                name or joint_name,
                joint_name,
                float(model.actuator_gear[i, 0]),
                float(model.actuator_gainprm[i, 0]),
                -by_position,
                -by_speed,
                bias,
                _limits_of(
                    has_input_range and model.actuator_ctrllimited[i], model.actuator_ctrlrange[i]
                ),
                _limits_of(model.actuator_forcelimited[i], model.actuator_forcerange[i]),
                integrates,
                _limits_of(model.actuator_actlimited[i], model.actuator_actrange[i]),
            )
        )
        if integrates and actuators[-1].goal != "kp":
            raise InputError(
                place,
                "it integrates its input, which is no goal of a position",
                "a gain that is that of its feedback of the position",
                "write it as <intvelocity>",
            )
    return tuple(actuators)


def _limits_of(is_limited: Any, ends: Any) -> tuple[float, float] | None:
    """The limits of a force or an input, None without."""
    return (float(ends[0]), float(ends[1])) if is_limited else None


def _range_of(is_limited: Any, ends: Any) -> tuple[float, float] | None:
    """The ends of a range, None where it does not hold; MuJoCo ignores ends that are exchanged."""
    low, high = float(ends[0]), float(ends[1])
    return (low, high) if low > high or (is_limited and low < high) else None


def _inertia_of(model: Any, i: int) -> LinkInertia | None:
    mass = float(model.body_mass[i])
    if not mass:
        return None
    rotation = _matrix(model.body_iquat[i])
    tensor = rotation @ np.diag(model.body_inertia[i]) @ rotation.T
    return LinkInertia(mass, model.body_ipos[i].copy(), tensor)


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, quaternion)
    return without_rounding(rotation.reshape(3, 3))
