"""House rules that no linter knows: what the source may say, and where."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import tustinnet
from tustinnet.registry import FAMILIES

SOURCE = Path(tustinnet.__file__).parent
MODULES = sorted(p.relative_to(SOURCE).as_posix() for p in SOURCE.rglob("*.py"))


@cache
def tree_of(module: str) -> ast.Module:
    return ast.parse((SOURCE / module).read_text(encoding="utf-8"), module)


def modules_outside(*places: str) -> list[str]:
    """Modules that are none of some files and in none of some folders."""
    return [m for m in MODULES if not any(m == p or m.startswith(f"{p}/") for p in places)]


# --- the families are known by their names alone ---


def classes_of_families() -> set[str]:
    places = [m for m in MODULES if m.startswith("families/")]
    nodes = [node for m in places for node in ast.walk(tree_of(m))]
    return {node.name for node in nodes if isinstance(node, ast.ClassDef)}


WAYS_OF_FITTING = {"TrainedFamily", "SolvedFamily", "IdentifiedFamily"}  # each has a type of recipe


def names_in(node: ast.AST) -> set[str]:
    """The names that an expression says, `a.B` as `B`, too."""
    found = {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}
    return found | {n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute)}


def asking_for_class(tree: ast.AST, classes: set[str]) -> Iterator[ast.expr | ast.pattern]:
    """Where something is asked whether it is of one of some classes, or what its class is."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Name(id="isinstance" | "issubclass"), args=[_, asked]):
                if names_in(asked) & classes:
                    yield node
            case ast.MatchClass(cls=asked) if names_in(asked) & classes:
                yield node
            case ast.Compare(left=left, comparators=others):
                if any(names_in(side) & classes for side in (left, *others)):
                    yield node


def decisions_by_text(tree: ast.AST, texts: set[str]) -> Iterator[ast.expr | ast.pattern]:
    """Where one of some texts is compared with, matched, or a key of a mapping."""

    def says(node: ast.AST | None) -> bool:
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            return any(says(item) for item in node.elts)
        return isinstance(node, ast.Constant) and node.value in texts

    for node in ast.walk(tree):
        match node:
            case ast.Compare(left=left, comparators=others) if any(map(says, (left, *others))):
                yield node
            case ast.MatchValue(value=value) if says(value):
                yield node
            case ast.Dict(keys=keys) if any(map(says, keys)):
                yield node
            case ast.Subscript(value=ast.Name(id="Literal")):
                pass  # a type
            case ast.Subscript(slice=key) if says(key):
                yield node


EVERYDAY_WORDS = {"linear"}  # also a kind of coordinate
FREE_OF_FAMILIES = modules_outside("families", "registry.py", "models", "reproduce", "old_names.py")


def test_nothing_is_decided_by_the_kind_of_a_model():
    kinds, all_classes = set(FAMILIES.places) - EVERYDAY_WORDS, classes_of_families()
    places = []
    for module in FREE_OF_FAMILIES:
        classes = all_classes - (WAYS_OF_FITTING if module == "fitting/recipe.py" else set())
        tree = tree_of(module)
        found = [*asking_for_class(tree, classes), *decisions_by_text(tree, kinds)]
        places += [f"{module}:{node.lineno}" for node in found]
    assert not places, "a family answers by a method or a flag, see families/family.py"


def test_linear_is_only_asked_of_coordinates():
    for module in FREE_OF_FAMILIES:
        for node in decisions_by_text(tree_of(module), EVERYDAY_WORDS):
            assert isinstance(node, ast.Compare), f"{module}:{node.lineno}"
            assert "kind" in names_in(node.left), f"{module}:{node.lineno}"


# --- where things stand in a state is said once ---

# where both numbers of a state's parts are wanted, not places in a state, and why
SIZES = {
    "channels.py": "it says the layout",
    "models/contract.py": "`state_size` counts the state",
    "models/blocks.py": "`feature_count` counts the features of a network",
    "families/gru.py": "how many outputs a network has",
    "families/neural_ode.py": "how many outputs a network has",
    "families/linear.py": "the size of the measured part in a matrix",
}
NOT_STATES = {"signs"}  # one of each coordinate and each input


def counts_coordinates(node: ast.AST | None) -> bool:
    """Whether an index is `n_q`, or a sum or multiple of it."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Add):
        return counts_coordinates(node.left) or counts_coordinates(node.right)
    match node:
        case ast.Name(id="n_q") | ast.Attribute(attr="n_q"):
            return True
    return False


def slices_by_hand(tree: ast.AST) -> Iterator[ast.expr]:
    """`x[:n_q]`, `x[n_q:]`, `x[n_q : 2 * n_q]`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and not names_in(node.value) & NOT_STATES:
            for part in ast.walk(node.slice):
                ends = (part.lower, part.upper) if isinstance(part, ast.Slice) else ()
                if any(map(counts_coordinates, ends)):
                    yield node


def doubled(tree: ast.AST) -> Iterator[ast.expr]:
    """`2 * n_q`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
            sides = (node.left, node.right)
            twice = any(isinstance(s, ast.Constant) and s.value == 2 for s in sides)
            if twice and counts_coordinates(node):
                yield node


def test_a_state_is_taken_apart_by_its_channels():
    places = []
    for module in modules_outside("channels.py"):
        found = [*slices_by_hand(tree_of(module))]
        if module not in SIZES:
            found += doubled(tree_of(module))
        places += [f"{module}:{node.lineno}" for node in found]
    assert not places, "channels.position, .velocity, .measured, .internal say it"


# --- time is run through in two places ---

LOOPS = {"scan", "fori_loop", "while_loop"}
LOOPS_OVER_TIME = {
    "simulate/rollout.py": "the rollout",
    "engine/by_jax.py": "states, and their derivatives, of what no machine code is made for",
}
OTHER_LOOPS = {
    "fitting/inverse_dynamics/along.py": "internal states that follow a measured motion",
    "models/integrate.py": "the parts of a period, and the stages of a Runge-Kutta step",
    "simulate/state_fits.py": "the turns of the search for a start",
    "fitting/gradient/epoch.py": "epochs, and the steps of the optimiser in one",
}


def test_time_is_run_through_in_two_places():
    modules_with_loops = {
        module
        for module in MODULES
        for node in ast.walk(tree_of(module))
        if (isinstance(node, ast.Attribute) and node.attr in LOOPS and "lax" in names_in(node))
        or (isinstance(node, ast.ImportFrom) and {a.name for a in node.names} & LOOPS)
    }
    assert modules_with_loops == {*LOOPS_OVER_TIME, *OTHER_LOOPS}, "others use simulate.rollout"


# --- no module imports itself through others ---


def imports_of(module: str) -> set[str]:
    """The modules of the package that a module imports, anywhere but for types alone."""
    tree, found = tree_of(module), set()
    for_types = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in names_in(block.test)
        for node in ast.walk(block)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and id(node) not in for_types:
            home = node.module.removeprefix("tustinnet").lstrip(".").replace(".", "/")
            places = [f"{home}/{alias.name}.py".lstrip("/") for alias in node.names]
            found |= {place if place in MODULES else f"{home}.py" for place in places}
    return (found & set(MODULES)) - {module}


def test_no_module_imports_itself_through_others():
    remaining = {module: imports_of(module) for module in MODULES}
    while free := {module for module, imports in remaining.items() if not imports}:
        remaining = {m: imports - free for m, imports in remaining.items() if m not in free}
    assert not remaining, "each of these imports another of them"


# --- the command's files import at their top ---


def hidden_imports(tree: ast.Module) -> Iterator[ast.stmt]:
    """Imports in functions, in classes and under conditions, as those for types alone."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom) and node not in tree.body:
            yield node


def test_the_command_imports_at_the_top():
    modules = [m for m in MODULES if m.startswith("cli/")]
    places = [f"{m}:{node.lineno}" for m in modules for node in hidden_imports(tree_of(m))]
    assert not places, "take the module from its room, which loads it when it is used"


# --- the checks find what they are for ---


def test_the_checks_find_what_they_are_for():
    source = """
if isinstance(m, TustinNet) or type(m) is TustinNet or kind == "gru" or kind in ("hybrid", "x"):
    of = {"gru": 1}
    of["gru"]
match kind:
    case "gru": pass
match m:
    case TustinNet(): pass
position, velocity, both = x[..., :n_q], x[c.n_q : 2 * c.n_q], x[: 2 * n_q]
"""
    tree = ast.parse(source)
    assert len(list(asking_for_class(tree, {"TustinNet"}))) == 3
    assert len(list(decisions_by_text(tree, {"gru", "hybrid"}))) == 5
    assert len(list(slices_by_hand(tree))) == 3
    assert len(list(doubled(tree))) == 2
    assert {"TustinNet", "HybridModel"} <= classes_of_families()
    hidden = "import a\ndef f():\n    import b\nif TYPE_CHECKING:\n    from c import d"
    assert len(list(hidden_imports(ast.parse(hidden)))) == 2
