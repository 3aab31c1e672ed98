"""The programs that targets are tried on hold everything that a program may hold."""

from every_step import PROGRAMS, operations_in, stepping

from tustinnet.program.program import OPERATIONS


def test_every_kind_of_node_is_tried():
    found = set().union(*(operations_in(stepping(f).step) for f in PROGRAMS.values()))
    moving = {"input", "number", "table", "pick", "part", "join", "product", "loop"}
    assert found == {*OPERATIONS, *moving}
