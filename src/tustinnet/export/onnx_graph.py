"""Programs as ONNX models: a step, and free runs of any length, of batches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from onnx import GraphProto, ModelProto, TensorProto, ValueInfoProto
from onnx.checker import check_model
from onnx.helper import (
    make_graph,
    make_model,
    make_node,
    make_opsetid,
    make_tensor_value_info,
    set_model_props,
)

from tustinnet.export.onnx_terms import OPERATORS, Graph, ModelBuilder, Term
from tustinnet.program.program import Loop, Node, Program

OPSET = 17
_IR = 8  # the version of the format that came with it
_BATCH, _STEPS = "batch", "steps"  # sizes that are not fixed


@dataclass(frozen=True, eq=False)
class _Value:
    """The value of a program's node in a graph.

    Attributes:
        node: the node.
        term: the tensor, (batch, size).
        batched: False for constants, (1, size).
    """

    node: Node
    term: Term
    batched: bool


def step_model(program: Program, kind: type[np.floating], about: dict[str, str]) -> ModelProto:
    """A step, with its metadata: `x` (batch, n_x), `u` (batch, n_w) to `x_next` (batch, n_x)."""
    model = ModelBuilder(np.dtype(kind))
    return _make_model(model, _step(model, program), about)


def rollout_model(program: Program, kind: type[np.floating], about: dict[str, str]) -> ModelProto:
    """A free run of a step: `x0` (batch, n_x), `u` (steps, batch, n_w) to `x` (steps + 1, ...)."""
    model, (n_x, n_w) = ModelBuilder(np.dtype(kind)), program.inputs.values()
    step = _step(model, program)
    # the state that a step carries on is also its output
    step.node.append(make_node("Identity", ["x_next"], ["row"]))
    step.output.append(_tensor(model, "row", _BATCH, n_x))
    graph = Graph(model)
    names = [model.name(), model.name()]
    graph.nodes.append(make_node("Scan", ["x0", "u"], names, body=step, num_scan_inputs=1))
    first = graph.add("Unsqueeze", "x0", model.constant([0]))
    graph.nodes.append(make_node("Concat", [first.name, names[1]], ["x"], axis=0))
    inputs = [_tensor(model, "x0", _BATCH, n_x), _tensor(model, "u", _STEPS, _BATCH, n_w)]
    outputs = [_tensor(model, "x", None, _BATCH, n_x)]
    return _make_model(model, make_graph(graph.nodes, "rollout", inputs, outputs), about)


def _tensor(model: ModelBuilder, name: str, *shape: int | str | None) -> ValueInfoProto:
    return make_tensor_value_info(name, model.number, shape)


def _step(model: ModelBuilder, program: Program) -> GraphProto:
    graph, (n_x, n_w) = Graph(model), program.inputs.values()
    batch = graph.add("Slice", graph.add("Shape", "x").name, *map(model.constant, ([0], [1])))
    writer = _OnnxWriter(graph, batch.name)
    values = writer.program(program, {"x": "x", "u": "u"})
    graph.nodes.append(make_node("Identity", [writer.whole(values["x"]).name], ["x_next"]))
    inputs = [_tensor(model, "x", _BATCH, n_x), _tensor(model, "u", _BATCH, n_w)]
    return make_graph(graph.nodes, "step", inputs, [_tensor(model, "x_next", _BATCH, n_x)])


def _make_model(model: ModelBuilder, graph: GraphProto, about: dict[str, str]) -> ModelProto:
    graph.initializer.extend(model.constants.values())
    proto = make_model(
        graph, opset_imports=[make_opsetid("", OPSET)], ir_version=_IR, producer_name="tustinnet"
    )
    set_model_props(proto, about)
    check_model(proto, full_check=True)
    return proto


class _OnnxWriter:
    """A writer of programs into a graph."""

    def __init__(self, graph: Graph, batch: str) -> None:
        self._graph, self._batch = graph, batch

    def program(self, program: Program, inputs: dict[str, str]) -> dict[str, _Value]:
        """Writes a program, given the names of the tensors of its inputs; returns its outputs."""
        values: list[_Value] = []
        for node in program.nodes:
            args = [values[a] for a in node.args]
            batched = node.op in ("input", "join", "loop") or any(a.batched for a in args)
            values.append(_Value(node, self._term(node, args, program.tables, inputs), batched))
        return {name: values[i] for name, i in program.outputs.items()}

    def whole(self, value: _Value, *, truth: bool = False) -> Term:
        """A value for every member of the batch."""
        term = self._as(value, truth=truth)
        if value.batched:
            return term
        shape = self._graph.add("Concat", self._batch, self._constant([value.node.size]), axis=0)
        return self._graph.add("Expand", term.name, shape.name)

    def _term(
        self, node: Node, args: list[_Value], tables: Sequence[np.ndarray], inputs: dict[str, str]
    ) -> Term:
        match node.op:
            case "input":
                return Term(self._graph, inputs[node.data])
            case "number":
                return self._graph.number(node.data)
            case "table":
                return Term(self._graph, self._constant(tables[node.data][None]))
            case "product":
                vector = self._as(args[0], truth=False)
                return self._graph.add("MatMul", vector.name, self._constant(tables[node.data].T))
            case "pick" | "part":
                places = np.arange(node.data, node.data + node.size)
                return self._graph.add("Gather", args[0].term.name, self._constant(places), axis=1)
            case "join":
                return self._concat([self.whole(a, truth=node.truth).name for a in args])
            case "loop":
                return self._loop(node.data, [self.whole(a).name for a in args])
        terms = [self._as(a, truth=node.takes_truth(i)) for i, a in enumerate(args)]
        if node.op == "select" and node.truth:  # which `Where` does not choose from
            which, yes, no = terms
            return which.to("And", yes).to("Or", which.to("Not").to("And", no))
        return OPERATORS[node.op](*terms)

    def _loop(self, loop: Loop, args: list[str]) -> Term:
        """A loop; its body reads constants and tables from outside."""
        model, body, sizes = self._graph.model, Graph(self._graph.model), loop.carried_sizes
        constants, first_values, tables = loop.split(args)
        turn, going = model.name(), model.name()
        carried = [model.name() for _ in range(loop.carried)]
        # without a row for each collected vector yet
        inputs = dict(zip(loop.body.inputs, [*constants, *carried], strict=False))
        for name, rows in zip(loop.split(list(loop.body.inputs))[2], tables, strict=True):
            shape = self._constant([0, loop.length, loop.body.inputs[name]])  # 0: as it is
            table = self._graph.add("Reshape", rows, shape)
            inputs[name] = body.add("Gather", table.name, turn, axis=1).name
        inside = _OnnxWriter(body, self._batch)
        ends = [inside.whole(x).name for x in inside.program(loop.body, inputs).values()]
        # under new names: two may be one tensor, or stand outside of the body
        go_on, *ends = [body.add("Identity", name).name for name in (going, *ends)]

        def infos(going: str, names: list[str]) -> list[ValueInfoProto]:
            tensors = [
                _tensor(model, n, _BATCH, size) for n, size in zip(names, sizes, strict=True)
            ]
            return [make_tensor_value_info(going, TensorProto.BOOL, []), *tensors]

        of_turn = [make_tensor_value_info(turn, TensorProto.INT64, []), *infos(going, carried)]
        one_turn = make_graph(body.nodes, "turn", of_turn, infos(go_on, ends))
        starts = [model.constant(np.int64(loop.length)), model.constant(True), *first_values]
        results = [model.name() for _ in carried]
        self._graph.nodes.append(make_node("Loop", starts, results, body=one_turn))
        return self._concat(results)

    def _concat(self, parts: list[str]) -> Term:
        return self._graph.add("Concat", *parts, axis=1)

    def _as(self, value: _Value, *, truth: bool) -> Term:
        """A value as numbers, or as truths."""
        if value.node.truth == truth:
            return value.term
        if truth:
            return value.term.equals(0.0).to("Not")
        return value.term.cast(self._graph.model.number)

    def _constant(self, values: object) -> str:
        return self._graph.model.constant(values)
