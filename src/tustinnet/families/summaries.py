"""Summaries of model files, as `show` prints them: from header and arrays alone, without JAX.

A function for each kind, named in the registry (`SUMMARIES`); other kinds have `Family.summarise`.
"""

from typing import Any

import numpy as np

from tustinnet.registry import FAMILIES, SUMMARIES

Header = dict[str, Any]
Arrays = dict[str, np.ndarray]
Lines = list[tuple[str, str]]  # words, and values

# keys of headers, and names of arrays
PHYSICS, CORRECTION = "physics", "correction"  # of a hybrid
MEMBERS, WEIGHT = "members", "weight"  # of a committee
VALUES = "values"  # of the parameters of a system
REST = "rest"  # the position at which the memory of a Tustin-Net rests


def summarise(header: Header, arrays: Arrays) -> Lines:
    """The lines of a model, or of a part of one; only kinds from outside are loaded for them."""
    kind = header["kind"]
    if kind in SUMMARIES:
        return SUMMARIES[kind](header, arrays)
    return FAMILIES[kind].summarise(header, arrays)


def tustin_net(header: Header, arrays: Arrays) -> Lines:
    """Layers, units and memory of a Tustin-Net."""
    structure = header["structure"]
    lines = _network(structure, arrays)
    if structure["relaxation_times"]:
        memory = "relaxing in " + ", ".join(f"{t:g} s" for t in structure["relaxation_times"])
        if structure["remembered"]:
            rest = ", ".join(f"{x:.3g}" for x in arrays[REST])
            memory += f"; begins with {structure['remembered']:g} of the way from ({rest})"
        lines.append(("memory", memory))
    return lines


def neural_ode(header: Header, arrays: Arrays) -> Lines:
    """Layers, units and integration of a neural ODE."""
    steps = ("integration", f"{header['substeps']} Runge-Kutta steps a period")
    return [*_network(header["structure"], arrays), steps]


def gru(header: Header, arrays: Arrays) -> Lines:
    """Size, warm-up and units of a GRU."""
    s = header["structure"]
    sizes = f"{s['hidden']} hidden units, warm-up of {s['warm_up']} samples"
    return [("network", sizes), _units(arrays)]


def linear(header: Header, arrays: Arrays) -> Lines:
    """Order and eigenvalues of a linear model."""
    n_x = len(arrays["offset"])
    by_state = arrays["change.weight"][:, :n_x] / arrays["unit"]
    values = np.linalg.eigvals(np.eye(n_x) + arrays["moved"][:, None] * by_state)
    size = ", ".join(f"{abs(v):.4f}" for v in sorted(values, key=abs, reverse=True))
    return [("order", f"{n_x} states"), ("eigenvalues", f"of size {size}")]


def euler_lagrange(header: Header, arrays: Arrays) -> Lines:
    """System and values of a grey box."""
    system = header["system"]
    name = f"{system['name']} ({system['file']})" if system["file"] else system["name"]
    values = dict(zip(header["parameters"], arrays[VALUES].tolist(), strict=True))
    forces = header.get("forces", ())
    return [
        ("system", f"{name}, {header['substeps']} Runge-Kutta steps a period"),
        *([("added forces", ", ".join(forces))] if forces else []),
        ("values", ", ".join(f"{name} {value:.4g}" for name, value in values.items())),
    ]


def hybrid(header: Header, arrays: Arrays) -> Lines:
    """The physics and the correction of a hybrid."""
    fades = ", fading at rest" if header["fades_at_rest"] else ""
    lines = []
    for name, remark in ((PHYSICS, ""), (CORRECTION, fades)):
        part = header[name]
        lines.append((name, part["kind"] + remark))
        lines += summarise(part, arrays_below(f"{name}.", arrays))
    return lines


def committee(header: Header, arrays: Arrays) -> Lines:
    """The weights of a committee, and the lines that members of one structure have in common."""
    kinds: dict[str, list[int]] = {}
    for i, part in enumerate(header[MEMBERS]):
        structure = {key: x for key, x in part.items() if key != WEIGHT}
        kinds.setdefault(repr(structure), []).append(i)
    lines = []
    for indices in kinds.values():
        parts = [header[MEMBERS][i] for i in indices]
        numbers = ", ".join(str(i + 1) for i in indices)
        weights = [f"{part[WEIGHT]:.4g}" for part in parts]
        weight = ", ".join(weights if len(set(weights)) > 1 else weights[:1])
        lines.append(("members", f"{parts[0]['kind']}: {numbers}; weight {weight}"))
        summaries = [
            summarise(part, arrays_below(f"{i + 1}.", arrays))
            for i, part in zip(indices, parts, strict=True)
        ]
        lines += [line for line in summaries[0] if all(line in other for other in summaries)]
    return lines


def arrays_below(prefix: str, arrays: Arrays) -> Arrays:
    """The arrays whose names begin with a prefix, without it."""
    return {n.removeprefix(prefix): a for n, a in arrays.items() if n.startswith(prefix)}


def _network(structure: dict[str, Any], arrays: Arrays) -> Lines:
    """Layers and units of a network."""
    bias = "with" if structure["output_bias"] else "without"
    layers = f"hidden {structure['hidden']}, {structure['activation']}, output {bias} bias"
    if structure["linear"]:
        layers += ", beside a linear map"
    if structure["odd"]:
        layers += ", odd"
    return [("network", layers), _units(arrays)]


def _units(arrays: Arrays) -> tuple[str, str]:
    """The units of a network."""
    names = ("position_offset", "position_scale", "velocity", "input", "acceleration")
    units = [f"{n} {[float(f'{v:.4g}') for v in arrays[f'scaling.{n}']]}" for n in names]
    return "scaling", ", ".join(units)
