"""Lifetimes of vectors: when they are computed and when they are read for the last time."""

from dataclasses import dataclass

from tustinnet.program.program import OPERATIONS, Node, Program

_VIEWS = ("part", "pick")  # they are read out of the vector that they are taken from


@dataclass(frozen=True)
class Lifetimes:
    """Lifetimes of a program's vectors, for targets that use memory again.

    Attributes:
        root: for each node, the one with which it is computed: for a vector that is only used,
            number by number, in the loop that computes another vector, that one; else itself.
        last: for each node, the last one that reads it; for outputs one beyond all.
    """

    root: tuple[int, ...]
    last: tuple[int, ...]


def is_elementwise(node: Node) -> bool:
    """Whether a node is a vector that is computed number by number."""
    return node.op in OPERATIONS and node.size > 1


def lifetimes(program: Program) -> Lifetimes:
    """Lifetimes of the vectors of a program."""
    nodes, ends = program.nodes, set(program.outputs.values())
    users: list[list[int]] = [[] for _ in nodes]
    for i, node in enumerate(nodes):
        for a in node.args:
            users[a].append(i)
    root = list(range(len(nodes)))
    last = [len(nodes) if i in ends else i for i in root]
    for i in reversed(range(len(nodes))):
        roots = {root[user] for user in users[i]}
        loops = all(is_elementwise(nodes[user]) for user in users[i])
        if is_elementwise(nodes[i]) and i not in ends and loops and len(roots) == 1:
            root[i] = roots.pop()
        read = last[i] if nodes[i].op in _VIEWS else root[i]
        for a in nodes[i].args:
            last[a] = max(last[a], read)
    return Lifetimes(tuple(root), tuple(last))
