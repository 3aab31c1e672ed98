"""JavaScript: one module without dependencies, for browsers and node."""

import json
import shutil
import subprocess
import weakref
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from textwrap import indent
from typing import Any

import numpy as np

from tustinnet.errors import InputError
from tustinnet.export.source import Source
from tustinnet.export.target import Files, NotRunnable, Stepper, Target, Vector
from tustinnet.export.words import INFIX, apply_form, called_functions, fill_template
from tustinnet.program.program import Loop, Node, Program

MODULE = "model.mjs"

# operations in JavaScript; all others are functions of `Math` of the same name
_FORMS = {**INFIX, "rem": "{} % {}", "pow": "power({}, {})", "eq": "{} === {}", "ne": "{} !== {}"}


class JavaScript(Target):
    """A module for browsers and node: `init`, `step`, names, ranges."""

    name = "js"

    def files(self, source: Source) -> Files:
        """The module `model.mjs`."""
        writer = _JavaScriptWriter()
        inputs = {"x": writer.vector(source.n_x), "u": writer.vector(source.n_w)}  # v0, v1
        body, outputs = writer.program(source.step, inputs)
        code = "\n".join(body) + writer.declarations
        ranges = source.range and {
            "states": source.range.states.tolist(),
            "inputs": source.range.inputs.tolist(),
        }
        text = fill_template(
            MODULE,
            states=_text(source.states),
            inputs=_text([i.name for i in source.channels.inputs]),
            period=_number(source.channels.dt),
            samples=_text(source.input_layout.offsets),
            range=_text(ranges),
            helpers="\n".join(called_functions("helpers.mjs", code)),
            vectors=writer.declarations,
            n_x=source.n_x,
            n_w=source.n_w,
            body=indent("\n".join(body), "  "),
            following=outputs["x"],
        )
        return {MODULE: text}

    def stepper(self, folder: Path, source: Source) -> Stepper:
        """A step by the module, run by node."""
        node = shutil.which("node")
        if node is None:
            raise NotRunnable("node is not installed")
        return _Node(node, folder / MODULE)


class _Node:
    """A process of node that steps the module, and that ends with this object."""

    def __init__(self, node: str, module: Path) -> None:
        self._process = subprocess.Popen(
            [
                node,
                "--input-type=module",
                "--eval",
                fill_template("steps.mjs"),
                str(module.resolve()),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            encoding="utf-8",
        )
        self._finalizer = weakref.finalize(self, _end, self._process)

    def __call__(self, x: Vector, u: Vector) -> Vector:
        """The next state; NaN stands for numbers that are not finite."""
        question, answers = self._process.stdin, self._process.stdout
        assert question is not None
        assert answers is not None
        try:
            question.write(json.dumps({"x": x.tolist(), "u": u.tolist()}) + "\n")
            question.flush()
        except BrokenPipeError:
            pass  # node has ended; its message is read below
        answer = answers.readline()
        if not answer:
            raise InputError("`to=` js", f"node ended: {_end(self._process)}", "a step")
        return np.array(json.loads(answer), np.float64)


def _end(process: subprocess.Popen[str]) -> str:
    """Ends a process and returns its error messages."""
    return process.communicate()[1]


class _JavaScriptWriter:
    """A writer of programs as statements of JavaScript. All vectors are global."""

    def __init__(self) -> None:
        self._declared: list[str] = []
        self._weights: list[np.ndarray] = []
        self._count = 0

    @property
    def declarations(self) -> str:
        """All vectors, the constant ones with their numbers."""
        if not self._weights:
            return "\n".join(self._declared)
        content = b64encode(np.concatenate(self._weights).astype("<f8").tobytes()).decode()
        return "\n".join([f'const weights = decoded("{content}");', *self._declared])

    def vector(self, size: int) -> str:
        """A new vector."""
        return self._declare(f"new Float64Array({size})")

    def program(self, program: Program, inputs: dict[str, str]) -> tuple[list[str], dict[str, str]]:
        """The statements of a program, and its outputs; both are named as in JavaScript."""
        lines: list[str] = []
        values: list[str] = []
        for node in program.nodes:
            args = [(program.nodes[a], values[a]) for a in node.args]
            if node.op == "input":
                values.append(inputs[node.data])
            else:
                values.append(self._value(node, args, program.tables, lines))
        return lines, {name: values[i] for name, i in program.outputs.items()}

    def _value(
        self,
        node: Node,
        args: list[tuple[Node, str]],
        tables: Sequence[np.ndarray],
        lines: list[str],
    ) -> str:
        match node.op:
            case "table":
                return self._constant(tables[node.data])
            case "product":
                matrix, name = self._constant(tables[node.data]), self.vector(node.size)
                lines.append(f"product({name}, {matrix}, {args[0][1]});")
                return name
            case "number":
                return _number(node.data)
            case "pick":
                item = f"{args[0][1]}[{node.data}]"
                return f"({item} !== 0)" if node.truth else item
            case "part":
                return self._declare(f"{args[0][1]}.subarray({node.data}, {node.data + node.size})")
            case "join":
                return self._join(args, node.size, lines)
            case "loop":
                return self._loop(node.data, [text for _, text in args], lines)
        operands = [_operand(*arg, truth=node.takes_truth(i)) for i, arg in enumerate(args)]
        text = apply_form(_FORMS.get(node.op), f"Math.{node.op}", operands)
        if node.is_single:
            name = self._name("s")
            lines.append(f"const {name} = {text};")
        else:
            name = self.vector(node.size)
            lines.append(f"for (let i = 0; i < {node.size}; i++) {name}[i] = {text};")
        return name

    def _constant(self, table: np.ndarray) -> str:
        first = sum(w.size for w in self._weights)
        self._weights.append(np.ravel(table).astype(np.float64))
        return self._declare(f"weights.subarray({first}, {first + table.size})")

    def _join(self, args: Sequence[tuple[Node, str]], size: int, lines: list[str]) -> str:
        name, first = self.vector(size), 0
        for node, text in args:
            lines.append(
                f"{name}[{first}] = {text};" if node.is_single else f"{name}.set({text}, {first});"
            )
            first += node.size
        return name

    def _loop(self, loop: Loop, args: list[str], lines: list[str]) -> str:
        """A loop; its carried state is one vector, replaced at the end of a turn as a whole."""
        size = sum(loop.carried_sizes)
        carried, following, turn = self.vector(size), self.vector(size), self._name("k")
        named = list(zip(loop.body.inputs, args, strict=True))
        constants, starts, tables = loop.split(named)
        inputs = dict(constants)
        ends = np.cumsum([0, *loop.carried_sizes]).tolist()
        for (name, start), low, high in zip(starts, ends[:-1], ends[1:], strict=True):
            lines.append(f"{carried}.set({start}, {low});")
            inputs[name] = self._declare(f"{carried}.subarray({low}, {high})")
        turns: list[str] = []
        for name, rows in tables:
            inputs[name] = self.vector(loop.body.inputs[name])
            turns.append(f"take({inputs[name]}, {rows}, {turn});")
        body, outputs = self.program(loop.body, inputs)
        turns += body
        turns += [
            f"{following}.set({text}, {low});"
            for text, low in zip(outputs.values(), ends[:-1], strict=True)
        ]
        turns.append(f"{carried}.set({following});")
        lines.append(f"for (let {turn} = 0; {turn} < {loop.length}; {turn}++) {{")
        lines += [f"  {line}" for line in turns]
        lines.append("}")
        return carried

    def _declare(self, value: str) -> str:
        name = self._name("v")
        self._declared.append(f"const {name} = {value};")
        return name

    def _name(self, kind: str) -> str:
        self._count += 1
        return f"{kind}{self._count - 1}"


def _operand(node: Node, text: str, *, truth: bool) -> str:
    """A number of a value; truths in vectors and loops are 0 and 1."""
    item = text if node.is_single else f"{text}[{'i' if node.size > 1 else '0'}]"
    is_boolean = node.truth and node.is_single
    if is_boolean == truth:
        return item
    return f"({item} !== 0)" if truth else f"(+{item})"


def _number(value: float | bool) -> str:
    """A constant, to the last bit."""
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(float(value)).replace("inf", "Infinity").replace("nan", "NaN")
    return f"({text})" if text.startswith("-") else text


def _text(value: Any) -> str:
    """Plain values as JSON in which no text ends a script or a line."""
    return json.dumps(value).replace("<", "\\u003c")


TARGET = JavaScript()
