"""Robots for tests: random chains, and a few that people have."""

import numpy as np

JOINT_KINDS = ("revolute", "continuous", "prismatic", "fixed")


def link_text(name: str, rng: np.random.Generator) -> str:
    """A link of the size of a forearm, its inertia that of points of mass."""
    points = rng.normal(size=(4, 3)) * [0.05, 0.1, 0.2]
    weights = rng.uniform(0.2, 1.0, 4)
    tensor = np.sum(
        [w * (r @ r * np.eye(3) - np.outer(r, r)) for w, r in zip(weights, points, strict=True)],
        axis=0,
    )
    xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)]
    return (
        f'<link name="{name}"><inertial><origin xyz="{numbers(rng.normal(size=3) * 0.2)}" '
        f'rpy="{numbers(rng.uniform(-3, 3, 3))}"/><mass value="{weights.sum()}"/>'
        f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial>'
        '<visual><geometry><mesh filename="package://nowhere/shape.stl"/></geometry></visual></link>'
    )


def random_urdf(seed: int, mimic: bool = False) -> str:
    """A random tree of up to 7 joints that move, with fixed joints in between."""
    rng = np.random.default_rng(seed)
    count, parts, moving, number = int(rng.integers(1, 8)), ['<link name="base"/>'], [], 0
    links = ["base"]
    while len(moving) < count:
        kind = str(rng.choice(JOINT_KINDS, p=[0.4, 0.2, 0.25, 0.15]))
        parent = links[-1] if rng.random() < 0.7 else str(rng.choice(links))
        name, joint = f"link{number}", f"joint{number}"
        number += 1
        parts.append(link_text(name, rng))
        follows = ""
        if mimic and kind != "fixed" and moving and rng.random() < 0.4:
            follows = (
                f'<mimic joint="{moving[0]}" multiplier="{rng.normal()}" offset="{rng.normal()}"/>'
            )
        right = np.pi / 2 * rng.integers(-1, 2, 3)
        rpy = right if rng.random() < 0.5 else rng.uniform(-3, 3, 3)
        axis = rng.normal(size=3) if rng.random() < 0.5 else np.eye(3)[rng.integers(3)]
        parts.append(
            f'<joint name="{joint}" type="{kind}">'
            f'<origin xyz="{numbers(rng.normal(size=3) * 0.3)}" '
            f'rpy="{numbers(rpy)}"/><parent link="{parent}"/><child link="{name}"/>'
            f'<axis xyz="{numbers(axis)}"/>{follows}'
            '<limit lower="-3" upper="3" effort="50" velocity="4"/></joint>'
        )
        links.append(name)
        if kind != "fixed" and not follows:
            moving.append(joint)
    return f'<robot name="random">{"".join(parts)}</robot>'


def numbers(values: np.ndarray) -> str:
    """Numbers as an attribute has them, exactly."""
    return " ".join(repr(float(x)) for x in values)
