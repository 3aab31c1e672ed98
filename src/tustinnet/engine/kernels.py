"""Loops over time as machine code: free runs, and free runs with their derivatives.

Lanes are runs of any lengths: a run that has ended stands still until the longest beside it ends.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tustinnet.engine.emission import Constants, Emission
from tustinnet.engine.equations import Equations, Formula, ResidualFormula
from tustinnet.engine.text import Function, Module
from tustinnet.program.adjoints import ADJOINT
from tustinnet.program.program import Program

# columns of the table of lanes: the run, its steps, its first row of inputs, its first row of
# results, how many of its first samples are measured; a lane without a run has -1 steps
LANE = ("run", "steps", "first", "result", "measured")


RUN = (
    "i64 %begin, i64 %end, ptr %lanes, ptr %constants, i64 %substeps, i64 %order, ptr %drive, "
    "ptr %periods, ptr %start, ptr %parameters, ptr %measured, i64 %n_measured, ptr %states"
)
COMPARE = (
    "i64 %begin, i64 %end, ptr %lanes, ptr %constants, i64 %substeps, i64 %order, ptr %drive, "
    "ptr %periods, ptr %start, ptr %parameters, ptr %seeds, i64 %n_d, i64 %n_by_p, ptr %target, "
    "ptr %weight, ptr %work, ptr %errors, ptr %products, ptr %gradient, ptr %cost"
)
BACKWARD = (
    "i64 %begin, i64 %end, ptr %lanes, ptr %constants, ptr %drive, ptr %parameters, ptr %states, "
    "ptr %seeds, i64 %span, i64 %length, ptr %layers, ptr %by_p, ptr %by_start"
)
DYNAMICS = (
    "ptr noalias %constants, ptr noalias %x, ptr noalias %u, ptr noalias %p, "
    "ptr noalias %out, ptr noalias %by_x, ptr noalias %by_p"
)
DYNAMIC, SAMPLE = "dynamics", "sample"  # names of procedures
MAP = "i64 %count, ptr %constants, ptr %in, ptr %out"
STEP = "ptr %constants, ptr %x, ptr %u, ptr %out"
MOST_ORDER = 8  # coefficients of the polynomials that inputs follow between samples


def write_run(
    module: Module,
    constants: Constants,
    equations: Equations,
    at_samples: Equations | None = None,
) -> None:
    """Writes the function `run`, free runs: the states at all samples.

    Args:
        module: the module.
        constants: numbers that its code reads from memory.
        equations: what is simulated.
        at_samples: a step, of the same sizes, that is done at each sample before the integration
            to the next one; None without.
    """
    for name, own in _procedures(equations, at_samples):
        with module.procedure(name, DYNAMICS) as f:
            inputs = {"x": "%x", "u": "%u", "p": "%p", "c": f.at("%p", own.n_p)}
            emission = Emission(f, own.program, inputs, constants, "%constants")
            emission.store(emission.values()["x"], "%out")
    with (
        module.procedure("run", RUN, is_internal=False) as f,
        f.loop("%begin", "%end") as group,
    ):
        s = _Simulation(f, equations, group, has_sample_steps=at_samples is not None)
        with f.loop(0, s.ends) as k:
            s.now(k)
            s.keep(k, [f.load(s.x, i) for i in range(equations.n_x)], "%states")
            s.put_back(k)
            with f.when(f.value(f"icmp slt i64 {k}, {s.longest}")):
                s.advance(k)


def _procedures(equations: Equations, at_samples: Equations | None) -> list[tuple[str, Equations]]:
    """The procedures of a simulation by name."""
    return [(DYNAMIC, equations), *([] if at_samples is None else [(SAMPLE, at_samples)])]


def write_backward(module: Module, constants: Constants, equations: Equations) -> None:
    """Writes the function `backward`: adjoints of states, parameters and layers of a model.

    Inputs of a layer and adjoints of its outputs are kept at every step: the gradient of its
    weights is one product of both. The model is discrete.
    """
    n_x, n_u, n_p = equations.n_x, equations.n_u, equations.n_p
    outputs = layer_outputs(equations)
    sizes = [output_size(equations.adjoints.program, name) for name in outputs]
    arguments = (
        "ptr noalias %constants, ptr noalias %x, ptr noalias %u, ptr noalias %p, "
        "ptr noalias %adjoint, ptr noalias %by_p, i64 %span, i64 %place, ptr noalias %layers"
    )
    with module.procedure("adjoints", arguments) as f:
        inputs = {"x": "%x", "u": "%u", "p": "%p", "c": f.at("%p", n_p), ADJOINT: "%adjoint"}
        emission = Emission(f, equations.adjoints.program, inputs, constants, "%constants")
        values = emission.values()
        for name, row in zip(outputs, np.cumsum([0, *sizes]).tolist(), strict=False):
            for number, i in emission.each_number(values[name]):
                begin = f.whole("mul", f.whole("add", i, row), "%span")
                f.store(number, "%layers", f.whole("add", begin, "%place"), aligned=False)
        for number, i in emission.each_number(values["by_p"]):
            f.store(f.apply("fadd", f.load("%by_p", i), number), "%by_p", i)
        # all has been read before the adjoint is replaced
        emission.store(values["by_x"], "%adjoint")
    with (
        module.procedure("backward", BACKWARD, is_internal=False) as f,
        f.loop("%begin", "%end") as group,
    ):
        s = _Lanes(f, group)
        x, u, p = f.memory(n_x), f.memory(n_u), f.memory(n_p + equations.n_c)
        adjoint, by_p = f.memory(n_x), f.memory(n_p)
        lanes = range(module.lanes)
        _gather(f, [s.column(lane, "run") for lane in lanes], n_p + equations.n_c, "%parameters", p)
        zero = module.number(0.0)
        for memory, size in ((adjoint, n_x), (by_p, n_p)):
            with f.loop(0, size) as i:
                f.store(zero, memory, i)
        begin = f.whole("mul", group, "%length")
        with f.loop(0, s.ends) as back:
            k = f.whole("sub", s.longest, back)
            s.now(k)
            states = s.rows("result")
            for i in range(n_x):
                seed = s.where(
                    s.active,
                    _beside(f, [f.whole("mul", r, n_x) for r in states], i, "%seeds"),
                    zero,
                )
                f.store(f.apply("fadd", f.load(adjoint, i), seed), adjoint, i)
            with f.when(f.value(f"icmp sgt i64 {k}, 0")):
                before = f.whole("sub", k, 1)
                s.now(before)
                _gather(f, s.rows("result"), n_x, "%states", x)
                _gather(f, s.rows("first"), n_u, "%drive", u)
                place = f.whole("add", begin, before)
                f.call_procedure(
                    "adjoints",
                    arguments,
                    constants="%constants",
                    x=x,
                    u=u,
                    p=p,
                    adjoint=adjoint,
                    by_p=by_p,
                    span="%span",
                    place=place,
                    layers="%layers",
                )
        s.hand_over(by_p, n_p, "%by_p")
        s.hand_over(adjoint, n_x, "%by_start")


def layer_outputs(equations: Equations) -> list[str]:
    """Names of the outputs of the program in reverse that are kept for layers, in this order."""
    places = range(len(equations.adjoints.layers))
    return [name for i in places for name in (f"in_{i}", f"out_{i}")]


def write_compare(
    module: Module,
    constants: Constants,
    equations: Equations,
    residual: ResidualFormula,
    at_samples: Equations | None = None,
) -> None:
    """Writes the function `compare`, free runs with derivatives: products of these and residuals.

    Args:
        module: the module.
        constants: numbers that its code reads from memory.
        equations: what is simulated.
        residual: how errors count.
        at_samples: see `write_run`.
    """
    structures = {
        name: _write_derivatives(module, own, constants, name)
        for name, own in _procedures(equations, at_samples)
    }
    with (
        module.procedure("compare", COMPARE, is_internal=False) as f,
        f.loop("%begin", "%end") as group,
    ):
        s = _Sensitivities(f, equations, structures, residual, constants, group)
        with f.loop(0, s.ends) as k:
            s.now(k)
            s.compare(k)
            with f.when(f.value(f"icmp slt i64 {k}, {s.longest}")):
                s.advance(k)
        s.hand_products_over()


def write_map(module: Module, constants: Constants, formula: Formula, *, derivatives: bool) -> None:
    """Writes the function `map`: a formula at many points, or its derivatives, by rows."""
    program, lanes = formula.derivatives if derivatives else formula.program, module.lanes
    with module.procedure("map", MAP, is_internal=False) as f:
        x = f.memory(formula.size)
        rounds = f.whole("sdiv", f.whole("add", "%count", lanes - 1), lanes)
        last = f.whole("sub", "%count", 1)
        with f.loop(0, rounds) as turn:
            rows = []
            for lane in range(lanes):
                row = f.whole("add", f.whole("mul", turn, lanes), lane)
                beyond = f.value(f"icmp sgt i64 {row}, {last}")
                rows.append(f.value(f"select i1 {beyond}, i64 {last}, i64 {row}"))
            _gather(f, rows, formula.size, "%in", x)
            emission = Emission(f, program, {"x": x}, constants, "%constants")
            values = [emission.as_number(number) for number in emission.outputs()["value"]]
            for lane, row in enumerate(rows):
                _store_row(f, lane, values, "%out", row)


def write_step(
    module: Module, constants: Constants, equations: Equations, *, linearised: bool
) -> None:
    """Writes the function `step`: one step of a discrete model without parameters.

    Args:
        module: the module, of one lane.
        constants: numbers that its code reads from memory.
        equations: the model.
        linearised: whether the derivatives by the state and by the inputs follow the next state.
    """
    program = equations.linearised if linearised else equations.program
    with module.procedure("step", STEP, is_internal=False) as f:
        inputs = {"x": "%x", "u": "%u", "p": "%x", "c": "%x"}  # of the last two there are none
        emission = Emission(f, program, inputs, constants, "%constants")
        values, begin = emission.values(), 0
        for name in ("x", "a", "b") if linearised else ("x",):
            emission.store(values[name], f.at("%out", begin))
            begin += output_size(program, name)


def output_size(program: Program, name: str) -> int:
    """The size of an output of a program."""
    return program.nodes[program.outputs[name]].size


@dataclass(frozen=True)
class _Structure:
    """Structure of the derivatives of equations: which of them are not 0.

    Attributes:
        copies: for each row, the number of the state that it copies, or None.
        by_x: for each row, the numbers of the state that it depends on.
        by_p: which rows depend on the parameters.
    """

    copies: tuple[int | None, ...]
    by_x: tuple[tuple[int, ...], ...]
    by_p: tuple[int, ...]


def _write_derivatives(
    module: Module, equations: Equations, constants: Constants, name: str
) -> _Structure:
    """Writes the equations with their derivatives, and returns the structure of these.

    Derivatives are computed in reverse, a row in each turn of a loop, which takes as long as to
    write them all out forwards and half as long to compile. Nodes that do not depend on the row are
    computed before the loop.
    """
    n_x, n_p, program = equations.n_x, equations.n_p, equations.derivatives
    # velocities stand in the state: their rows are known, as are those of zeros
    copies = equations.program.copies("x", "x")
    depends = equations.program.dependencies("x")
    rows = [i for i, j in enumerate(copies) if j is None and depends[i]]
    zero, one = module.number(0.0), module.number(1.0)
    with module.procedure(name, DYNAMICS) as f:
        adjoint = f.memory(n_x)
        inputs = {"x": "%x", "u": "%u", "p": "%p", "c": f.at("%p", n_p), ADJOINT: adjoint}
        emission = Emission(f, program, inputs, constants, "%constants")
        in_loop = program.nodes_depending_on(ADJOINT)
        emission.compute(i for i in range(len(program.nodes)) if i not in in_loop)
        with f.loop(min(rows, default=0), max(rows, default=-1) + 1) as row:
            with f.loop(0, n_x) as i:
                f.store(zero, adjoint, i)
            f.store(one, adjoint, row)
            values = emission.values()
            begin = f.whole("mul", row, n_x)
            for number, i in emission.each_number(values["by_x"]):
                f.store(number, "%by_x", f.whole("add", f.whole("mul", i, 1), begin))
            for number, i in emission.each_number(values["by_p"]):
                f.store(number, "%by_p", f.whole("add", f.whole("mul", i, n_x), row))
        emission.store(values["x"], "%out")
    return _Structure(
        tuple(copies),
        tuple(tuple(j for j in range(n_x) if ("x", j) in inputs) for inputs in depends),
        tuple(i for i, inputs in enumerate(depends) if any(name == "p" for name, _ in inputs)),
    )


def _gather(f: Function, rows: Sequence[str], size: int, source: str, into: str) -> None:
    """Loads a row of an array for each lane, side by side."""
    bases = [f.whole("mul", row, size) for row in rows]
    with f.loop(0, size) as i:
        f.store(_beside(f, bases, i, source), into, i)


def _beside(f: Function, bases: Sequence[str], offset: str | int, source: str) -> str:
    """A number of an array for each lane, from places with an offset."""
    return f.together([f.load_number(source, f.whole("add", base, offset)) for base in bases])


def _store_row(f: Function, lane: int, values: Sequence[str], into: str, row: str) -> None:
    """Stores the numbers of a lane in a row of an array."""
    base = f.whole("mul", row, len(values))
    for i, value in enumerate(values):
        f.store_number(f.lane(value, lane), into, f.whole("add", base, i))


class _Lanes:
    """A group of lanes, while their loop over time is written."""

    def __init__(self, f: Function, group: str) -> None:
        self.f = f
        lanes = f.module.lanes
        first = f.whole("mul", group, lanes * len(LANE))
        self._columns: dict[tuple[int, str], str] = {}
        for lane in range(lanes):
            for i, name in enumerate(LANE):
                address = f.at("%lanes", f.whole("add", first, lane * len(LANE) + i), "i64")
                self._columns[lane, name] = f.value(f"load i64, ptr {address}")
        self.longest = self.column(0, "steps")
        for lane in range(1, lanes):
            steps = self.column(lane, "steps")
            more = f.value(f"icmp sgt i64 {steps}, {self.longest}")
            self.longest = f.value(f"select i1 {more}, i64 {steps}, i64 {self.longest}")
        self.ends = f.whole("add", self.longest, 1)
        self.active: list[str] = []
        self._samples: list[str] = []

    def column(self, lane: int, name: str) -> str:
        """A column of the table of lanes for a lane."""
        return self._columns[lane, name]

    def now(self, k: str) -> None:
        """Writes, for sample k, which lanes are still running, and the sample at which each is."""
        f = self.f
        self.active, self._samples = [], []
        for lane in range(f.module.lanes):
            steps = self.column(lane, "steps")
            active = f.value(f"icmp sle i64 {k}, {steps}")
            sample = f.value(f"select i1 {active}, i64 {k}, i64 {steps}")
            is_idle = f.value(f"icmp slt i64 {sample}, 0")
            self._samples.append(f.value(f"select i1 {is_idle}, i64 0, i64 {sample}"))
            self.active.append(active)

    def rows(self, name: str) -> list[str]:
        """The present row of every lane in an array in which it begins at its row of that name."""
        columns = [self.column(lane, name) for lane in range(self.f.module.lanes)]
        return [self.f.whole("add", c, k) for c, k in zip(columns, self._samples, strict=True)]

    def hand_over(self, source: str, size: str | int, into: str) -> None:
        """Stores the numbers of every lane that has a run in the row of that run."""
        f = self.f
        for lane in range(f.module.lanes):
            with f.when(f.value(f"icmp sge i64 {self.column(lane, 'steps')}, 0")):
                base = f.whole("mul", self.column(lane, "run"), size)
                with f.loop(0, size) as i:
                    number = f.lane(f.load(source, i), lane)
                    f.store_number(number, into, f.whole("add", base, i))

    def where(self, truths: list[str], a: str, b: str) -> str:
        """One or the other number, chosen for every lane."""
        f, n = self.f, self.f.module.n
        return f.together(
            [
                f.value(f"select i1 {truth}, {n} {f.lane(a, lane)}, {n} {f.lane(b, lane)}")
                for lane, truth in enumerate(truths)
            ]
        )


class _Simulation(_Lanes):
    """The loop over time of a group of lanes, while it is written."""

    def __init__(
        self, f: Function, equations: Equations, group: str, *, has_sample_steps: bool = False
    ) -> None:
        super().__init__(f, group)
        self.equations, self._has_sample_steps = equations, has_sample_steps
        n_x, lanes = equations.n_x, f.module.lanes
        n_p = equations.n_p + equations.n_c
        self.x, self.p = f.memory(n_x), f.memory(n_p)
        self.u, self.slope = f.memory(equations.n_u), f.memory(n_x)
        self.by_x, self.by_p = f.memory(0), f.memory(0)
        self._ahead, self._total = f.memory(n_x), f.memory(n_x)
        self._pieces = f.memory(equations.n_u * (MOST_ORDER if equations.continuous else 1))
        runs = [self.column(lane, "run") for lane in range(lanes)]
        _gather(f, runs, n_x, "%start", self.x)
        _gather(f, runs, n_p, "%parameters", self.p)

    def keep(self, k: str, values: Sequence[str], into: str) -> None:
        """Stores results at sample k of the lanes that are running in their rows of an array."""
        for lane, active in enumerate(self.active):
            with self.f.when(active):
                row = self.f.whole("add", self.column(lane, "result"), k)
                _store_row(self.f, lane, values, into, row)

    def beside(self, size: int, offset: str | int, source: str) -> str:
        """A number of the present row of an array for each lane."""
        rows = [self.f.whole("mul", row, size) for row in self.rows("first")]
        return _beside(self.f, rows, offset, source)

    def put_back(self, k: str) -> None:
        """Writes that measured positions and velocities take the place of the simulated ones."""
        f, n_x = self.f, self.equations.n_x
        with f.when(f.value("icmp sgt i64 %n_measured, 0")):
            truths = [
                f.value(f"icmp slt i64 {k}, {self.column(lane, 'measured')}")
                for lane in range(f.module.lanes)
            ]
            bases = [f.whole("mul", row, "%n_measured") for row in self.rows("first")]
            for i in range(n_x):
                with f.when(f.value(f"icmp sgt i64 %n_measured, {i}")):
                    simulated = f.load(self.x, i)
                    measured = _beside(f, bases, i, "%measured")
                    f.store(self.where(truths, measured, simulated), self.x, i)

    def dynamics(self, x: str, out: str, name: str = DYNAMIC) -> None:
        """Writes a call of the equations at a state."""
        self.f.call_procedure(
            name,
            DYNAMICS,
            constants="%constants",
            x=x,
            u=self.u,
            p=self.p,
            out=out,
            by_x=self.by_x,
            by_p=self.by_p,
        )

    def advance(self, k: str) -> None:
        """Writes the step from a sample to the next."""
        if self.equations.continuous:
            if self._has_sample_steps:
                self._step(k, SAMPLE)
            self._integrate(k)
        else:
            self._step(k, DYNAMIC)

    def _step(self, k: str, name: str) -> None:
        """Writes a discrete step, with the inputs at the sample."""
        f, n_u = self.f, self.equations.n_u
        # of polynomials, their first coefficients
        width = f.whole("mul", "%order", n_u) if self.equations.continuous else n_u
        bases = [f.whole("mul", row, width) for row in self.rows("first")]
        for i in range(n_u):
            f.store(_beside(f, bases, i, "%drive"), self.u, i)
        self.dynamics(self.x, self._ahead, name)
        running = self._running(k)
        for i in range(self.equations.n_x):
            f.store(self.where(running, f.load(self._ahead, i), f.load(self.x, i)), self.x, i)
        self.step_tangents(running, name)

    def step_tangents(self, running: list[str], name: str) -> None:
        """Writes the step for derivatives; here there are none."""

    def _running(self, k: str) -> list[str]:
        return [
            self.f.value(f"icmp slt i64 {k}, {self.column(lane, 'steps')}")
            for lane in range(self.f.module.lanes)
        ]

    def _integrate(self, k: str) -> None:
        f, n_x, n_u = self.f, self.equations.n_x, self.equations.n_u
        m = f.module
        parts = f.value(f"sitofp i64 %substeps to {m.n}")
        share = f.everywhere(f.value(f"fdiv {m.n} 1.0, {parts}"))
        zero = m.number(0.0)
        h = f.apply(
            "fmul", share, self.where(self._running(k), self.beside(1, 0, "%periods"), zero)
        )
        half, sixth = f.apply("fmul", h, m.number(0.5)), f.apply("fmul", h, m.number(1 / 6))
        width = f.whole("mul", "%order", n_u)
        bases = [f.whole("mul", row, width) for row in self.rows("first")]
        with f.loop(0, width) as j:
            f.store(_beside(f, bases, j, "%drive"), self._pieces, j)
        with f.loop(0, "%substeps") as i:
            number = f.value(f"sitofp i64 {i} to {m.n}")
            for stage, (reach, scale) in enumerate(
                ((0.0, half), (0.5, half), (0.5, h), (1.0, sixth))
            ):
                if stage != 2:  # the third stage is at the time of the second
                    later = f.value(f"fadd {m.n} {number}, {reach!r}")
                    self._inputs_at(f.everywhere(f.value(f"fdiv {m.n} {later}, {parts}")))
                self.dynamics(self.x if stage == 0 else self._ahead, self.slope)
                for j in range(n_x):
                    self._update(
                        stage, scale, f.load(self.slope, j), (self.x, self._ahead, self._total), j
                    )
                self.stage_tangents(stage, scale)

    def _update(
        self, stage: int, scale: str, slope: str, memory: tuple[str, str, str], j: str | int
    ) -> None:
        """Writes a stage of the method for a number of the state, or of a derivative of it."""
        f, (x, ahead, total) = self.f, memory
        if stage == 3:
            mean = f.apply("fadd", f.load(total, j), slope)
            f.store(f.fma(scale, mean, f.load(x, j)), x, j)
            return
        twice = self.f.module.number(2.0)
        f.store(slope if stage == 0 else f.fma(twice, slope, f.load(total, j)), total, j)
        f.store(f.fma(scale, slope, f.load(x, j)), ahead, j)

    def stage_tangents(self, stage: int, scale: str) -> None:
        """Writes the stage for derivatives; here there are none."""

    def _inputs_at(self, part: str) -> None:
        """Writes the inputs at a part of the period: on the polynomials that they follow."""
        f, n_u = self.f, self.equations.n_u
        last = f.whole("mul", f.whole("sub", "%order", 1), n_u)
        for i in range(n_u):
            f.store(f.load(self._pieces, f.whole("add", last, i)), self.u, i)
        with f.loop(1, "%order") as o:
            below = f.whole("sub", last, f.whole("mul", o, n_u))
            for i in range(n_u):
                value = f.load(self._pieces, f.whole("add", below, i))
                f.store(f.fma(part, f.load(self.u, i), value), self.u, i)


class _Sensitivities(_Simulation):
    """A simulation that carries derivatives along several directions with it.

    The first directions are those of parameters, if any; along all others the equations do not
    depend on the direction, only the state does.
    """

    def __init__(
        self,
        f: Function,
        equations: Equations,
        structures: Mapping[str, _Structure],
        residual: ResidualFormula,
        constants: Constants,
        group: str,
    ) -> None:
        super().__init__(f, equations, group, has_sample_steps=SAMPLE in structures)
        n_x = equations.n_x
        self._structures, self._residual, self._constants = structures, residual, constants
        self.by_x = f.memory(n_x * n_x)
        self.by_p = f.memory(equations.n_p * n_x)
        self._n_y = residual.n_y
        size = f.whole("mul", "%n_d", n_x)
        squares = f.whole("mul", "%n_d", "%n_d")
        self._dx = "%work"
        self._dahead = f.at("%work", size)
        self._dtotal = f.at(self._dahead, size)
        self._products = f.at(self._dtotal, size)
        self._gradient = f.at(self._products, squares)
        self._cost = f.at(self._gradient, "%n_d")
        self._error = f.memory(self._n_y)
        zero = f.module.number(0.0)
        count = f.whole("add", f.whole("add", squares, "%n_d"), 1)
        with f.loop(0, count) as i:
            f.store(zero, self._products, i)
        runs = [self.column(lane, "run") for lane in range(f.module.lanes)]
        bases = [f.whole("mul", run, size) for run in runs]
        with f.loop(0, size) as i:
            f.store(_beside(f, bases, i, "%seeds"), self._dx, i)

    def compare(self, k: str) -> None:
        """Writes the errors at a sample, and the terms that they add to the products."""
        f, m, n_x, n_y = self.f, self.f.module, self.equations.n_x, self._n_y
        zero = m.number(0.0)
        weights, errors, is_counted = [], [], []
        for i in range(n_y):
            error = f.apply("fsub", f.load(self.x, i), self.beside(n_y, i, "%target"))
            weight = self.where(self.active, self.beside(n_y, i, "%weight"), zero)
            is_counted.append(f.compare("ogt", weight, zero))
            f.store(error, self._error, i)
            weights.append(weight)
            errors.append(f.select(is_counted[i], error, zero))
        self.keep(k, errors, "%errors")
        emission = Emission(
            f, self._residual.program, {"error": self._error}, self._constants, "%constants"
        )
        outputs = emission.outputs()
        residuals, derivatives = [], []
        for i, weight in enumerate(weights):
            value, derivative = outputs["value"][i], outputs["slope"][i * (n_y + 1)]
            residual = f.apply("fmul", emission.as_number(value), weight)
            residuals.append(f.select(is_counted[i], residual, zero))
            derivatives.append(f.apply("fmul", emission.as_number(derivative), weight))
        cost = f.load(self._cost)
        for residual in residuals:
            cost = f.fma(residual, residual, cost)
        f.store(cost, self._cost)
        with f.loop(0, "%n_d") as a:
            base = f.whole("mul", a, n_x)
            row = f.whole("mul", a, "%n_d")
            dx = [f.load(self._dx, f.whole("add", base, i)) for i in range(n_y)]
            scaled = [f.apply("fmul", x, s) for x, s in zip(dx, derivatives, strict=True)]
            total = f.load(self._gradient, a)
            for x, residual in zip(scaled, residuals, strict=True):
                total = f.fma(x, residual, total)
            f.store(total, self._gradient, a)
            twice = [f.apply("fmul", x, s) for x, s in zip(scaled, derivatives, strict=True)]
            with f.loop(0, f.whole("add", a, 1)) as c:
                other = f.whole("mul", c, n_x)
                place = f.whole("add", row, c)
                total = f.load(self._products, place)
                for i, x in enumerate(twice):
                    total = f.fma(x, f.load(self._dx, f.whole("add", other, i)), total)
                f.store(total, self._products, place)

    def _directional_derivative(
        self, source: str, d: str, name: str, *, by_parameter: bool
    ) -> list[str]:
        """The derivative of a procedure of the equations along a direction."""
        f, n_x = self.f, self.equations.n_x
        base = f.whole("mul", d, n_x)
        y = [f.load(source, f.whole("add", base, j)) for j in range(n_x)]
        rows, structure = [], self._structures[name]
        for i, (copy, columns) in enumerate(zip(structure.copies, structure.by_x, strict=True)):
            if copy is not None:
                rows.append(y[copy])
                continue
            total: str | None = None
            if by_parameter and i in structure.by_p:
                total = f.load(self.by_p, f.whole("add", base, i))
            for j in columns:
                term = f.apply("fmul", f.load(self.by_x, i * n_x + j), y[j])
                total = term if total is None else f.apply("fadd", total, term)
            rows.append(f.module.number(0.0) if total is None else total)
        return rows

    def _each_direction(self) -> Iterator[tuple[str, bool]]:
        """Each direction, and whether it is that of a parameter, in a loop that is written.

        Code that is written for it is the body; there are two loops where there are parameters.
        """
        if self.equations.n_p:
            with self.f.loop(0, "%n_by_p") as d:
                yield d, True
        with self.f.loop("%n_by_p", "%n_d") as d:
            yield d, False

    def stage_tangents(self, stage: int, scale: str) -> None:
        """Writes a stage of the method for all derivatives."""
        source = self._dx if stage == 0 else self._dahead
        memory = self._dx, self._dahead, self._dtotal
        for d, by_parameter in self._each_direction():
            slopes = self._directional_derivative(source, d, DYNAMIC, by_parameter=by_parameter)
            base = self.f.whole("mul", d, self.equations.n_x)
            for j, slope in enumerate(slopes):
                self._update(stage, scale, slope, memory, self.f.whole("add", base, j))

    def step_tangents(self, running: list[str], name: str) -> None:
        """Writes a discrete step for all derivatives."""
        f = self.f
        for d, by_parameter in self._each_direction():
            ahead = self._directional_derivative(self._dx, d, name, by_parameter=by_parameter)
            base = f.whole("mul", d, self.equations.n_x)
            for j, value in enumerate(ahead):
                place = f.whole("add", base, j)
                f.store(self.where(running, value, f.load(self._dx, place)), self._dx, place)

    def hand_products_over(self) -> None:
        """Stores the products of every lane in the rows of its run."""
        self.hand_over(self._products, self.f.whole("mul", "%n_d", "%n_d"), "%products")
        self.hand_over(self._gradient, "%n_d", "%gradient")
        self.hand_over(self._cost, 1, "%cost")
