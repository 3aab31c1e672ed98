"""Programs run with NumPy, the reference for all targets."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from tustinnet.program.program import OPERATIONS, Loop, Node, Program

Vector = Float[np.ndarray, " _"] | Bool[np.ndarray, " _"]


def run(program: Program, **inputs: np.ndarray) -> dict[str, Vector]:
    """Outputs of a program by name, computed with NumPy.

    Args:
        program: the program.
        inputs: the vectors and matrices that it is given, by their names.
    """
    values: list[Any] = []
    with np.errstate(all="ignore"):  # once: for each operation it would take longer than that
        for node in program.nodes:
            values.append(_value(program, node, [values[a] for a in node.args], inputs))
    return {name: _numbers(values[i]) for name, i in program.outputs.items()}


def _value(program: Program, node: Node, args: list[Any], inputs: dict[str, np.ndarray]) -> Any:
    match node.op:
        case "input":
            return np.asarray(inputs[node.data], np.float64)
        case "number":
            return node.data
        case "table":
            return program.tables[node.data]
        case "pick":
            return args[0][node.data]
        case "part":
            return args[0][node.data : node.data + node.size]
        case "join":
            return np.concatenate([np.atleast_1d(a) for a in args])
        case "product":
            return program.tables[node.data] @ args[0]
        case "layer":
            matrix = np.asarray(inputs[node.data.name], np.float64)
            return (matrix.T if node.data.is_transposed else matrix) @ _numbers(args[0])
        case "loop":
            return _run_loop(node.data, [_numbers(a) for a in args])
    return OPERATIONS[node.op].apply(*args)


def _numbers(value: Any) -> Vector:
    """A value as a vector of numbers, truths as 0 and 1."""
    return np.atleast_1d(np.asarray(value, np.float64))


def _run_loop(loop: Loop, args: list[Vector]) -> Vector:
    constants, state, collected = loop.split(args)
    rows = [vector.reshape(loop.length, -1) for vector in collected]
    for i in range(loop.length):
        now = [*constants, *state, *(row[i] for row in rows)]
        state = list(run(loop.body, **dict(zip(loop.body.inputs, now, strict=True))).values())
    return np.concatenate(state)
