"""Which conditions of the package decide about security, and how each can be broken.

A condition is the test of an `if` or `while` that leads to a refusal (`raise`), to a problem
(`yield`, or a call that adds one), or out of the block (`return`, `continue`, `break`); the
filter of a comprehension; what a predicate returns; and a `raise` that stands under no `if`. Its
mutants, by kind:

    always, never     the condition is True, or False
    without-N         the Nth operand of an `and` or `or` in it is left out
    boundary-N        the Nth `<` in it is `<=`, the Nth `>=` is `>`, and so on
    reverse-N         the Nth `==`, `in` or `is` within it is `!=`, `not in`, `is not`, or the
                      other way round; where it is the whole, that is never and always
    quantifier-N      the Nth `any` in it is `all`, or the other way round
    removed           the `raise` is left out

The value of a limit is not mutated: it is a choice. That there is a limit, and where its
boundary lies, are the mutants of its comparison. Text for people is not mutated either.
"""

import ast
import copy
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOMS = (
    "credentials", "smime", "certificates", "handshake", "enrolment", "plugin", "access",
    "policy", "approvals", "server",
)  # fmt: skip
PARTS = {
    "server": (
        "admission", "deciding", "identifying", "proxy_header", "receipt_taking", "requester",
        "token_lines", "waiting",
    )
}  # fmt: skip
"""Of these rooms only these modules, which decide who is admitted, and whose limits count."""
PACKAGE = "pqsec_pki"

FOR_PEOPLE = {"__str__", "__repr__", "describe"}
"""Functions that decide nothing."""
NOT_DECIDING = {"build", "notes", "__main__"}
"""Modules of those rooms that decide nothing: the compiler's command, the log, the options."""

BOUNDARIES = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
REVERSES = {
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is,
}  # fmt: skip
QUANTIFIERS = {"any": "all", "all": "any"}


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change to one condition."""

    module: str
    """room/module"""
    function: str
    condition: str
    """Its source, in one line."""
    kind: str
    number: int
    """Which of the same conditions in the same function."""
    lines: tuple[int, int]
    """First and last line of what is replaced, from 1."""
    columns: tuple[int, int]
    """Its first and its last but one octet, in those lines."""
    replacement: str

    @property
    def room(self) -> str:
        """Its room."""
        return self.module.partition("/")[0]

    @property
    def path(self) -> str:
        """Its file in the checkout."""
        return f"{PACKAGE}/{self.module}.py"

    @property
    def id(self) -> str:
        """The same as long as the condition is, wherever in the function it stands."""
        text = f"{self.condition} {self.number}" if self.number else self.condition
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        return f"{self.module}:{self.function}:{digest}:{self.kind}"

    def applied(self, source: bytes) -> bytes:
        """The module's `source` with this change."""
        lines = source.splitlines(keepends=True)
        (first, last), (start, end) = self.lines, self.columns
        before = b"".join(lines[: first - 1]) + lines[first - 1][:start]
        after = lines[last - 1][end:] + b"".join(lines[last:])
        return before + self.replacement.encode() + after


def mutants(root: Path, rooms: tuple[str, ...] = ROOMS) -> list[Mutant]:
    """All of those rooms of the checkout in `root`, in order."""
    return [
        each
        for room in rooms
        for path in sorted((root / PACKAGE / room).glob("*.py"))
        if path.stem not in NOT_DECIDING and path.stem in PARTS.get(room, {path.stem})
        for each in _Module(f"{room}/{path.stem}").mutants(ast.parse(path.read_bytes()))
    ]


class _Module:
    def __init__(self, name: str) -> None:
        self._name = name
        self._seen: Counter[tuple[str, str]] = Counter()

    def mutants(self, tree: ast.Module) -> Iterator[Mutant]:
        for function, node in _within(tree, ""):
            if function.rpartition(".")[2] in FOR_PEOPLE:
                continue
            for condition in _conditions(node):
                yield from self._of(function, condition, _changes(condition))
            if isinstance(node, ast.Raise):
                yield from self._of(function, node, [("removed", ast.Pass())])

    def _of(self, function: str, node: ast.expr | ast.stmt, changes) -> Iterator[Mutant]:
        text = ast.unparse(node)
        number = self._seen[function, text]
        self._seen[function, text] += 1
        for kind, changed in changes:
            new = ast.unparse(changed)
            yield Mutant(
                self._name, function, text, kind, number,
                (node.lineno, node.end_lineno), (node.col_offset, node.end_col_offset),
                new if isinstance(changed, ast.stmt) else f"({new})",
            )  # fmt: skip


def _within(node: ast.AST, function: str, *, guarded: bool = False):
    """Each node below, with the function that it is in. Of `raise`, those under no `if`."""
    for child in ast.iter_child_nodes(node):
        inner = function
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            inner = f"{function}.{child.name}".strip(".")
        if isinstance(child, ast.Raise):
            if child.exc is not None and not guarded:
                yield inner, child
            continue  # what it says is for people
        yield inner, child
        alone = isinstance(node, ast.If) and len(node.body) == 1
        yield from _within(child, inner, guarded=isinstance(child, ast.If) or (guarded and alone))


def _conditions(node: ast.AST) -> Iterator[ast.expr]:
    if isinstance(node, ast.If | ast.While) and _decides(node):
        yield node.test
    elif isinstance(node, ast.comprehension):
        yield from node.ifs
    elif isinstance(node, ast.Return) and node.value is not None and _is_predicate(node.value):
        yield node.value


def _decides(node: ast.If | ast.While) -> bool:
    if ast.unparse(node.test) in {"TYPE_CHECKING", "True"}:
        return False
    leaving = (ast.Raise, ast.Return, ast.Continue, ast.Break)
    return any(
        isinstance(each, leaving)
        or (isinstance(each, ast.Expr) and isinstance(each.value, ast.Yield | ast.YieldFrom))
        or (isinstance(each, ast.Expr) and isinstance(each.value, ast.Call))
        for each in (*node.body, *node.orelse)
    )


def _is_predicate(value: ast.expr) -> bool:
    if isinstance(value, ast.BoolOp):  # `x or default` gives a value, and tells nothing
        return any(_is_predicate(each) for each in value.values)
    if isinstance(value, ast.UnaryOp):
        return isinstance(value.op, ast.Not)
    quantified = isinstance(value, ast.Call) and getattr(value.func, "id", "") in QUANTIFIERS
    return quantified or isinstance(value, ast.Compare)


def _changes(condition: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    yield "always", ast.Constant(value=True)
    yield "never", ast.Constant(value=False)
    counted: Counter[str] = Counter()
    for at, node in enumerate(ast.walk(condition)):
        for kind, change in _node_changes(node, whole=node is condition):
            counted[kind] += 1
            changed = copy.deepcopy(condition)
            target = list(ast.walk(changed))[at]
            yield f"{kind}-{counted[kind]}", _replaced(changed, target, change(target))


def _node_changes(node: ast.AST, *, whole: bool):
    """Kinds, and what makes of the node another."""
    if isinstance(node, ast.BoolOp):
        for index in range(len(node.values)):
            yield "without", lambda old, index=index: _without(old, index)
    elif isinstance(node, ast.Compare):
        for index, operator in enumerate(node.ops):
            if type(operator) in BOUNDARIES:
                new = BOUNDARIES[type(operator)]
                yield "boundary", lambda old, index=index, new=new: _compared(old, index, new)
            elif type(operator) in REVERSES and not whole:
                new = REVERSES[type(operator)]
                yield "reverse", lambda old, index=index, new=new: _compared(old, index, new)
    elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in QUANTIFIERS:
        new = QUANTIFIERS[node.func.id]
        yield (
            "quantifier",
            lambda old: ast.Call(ast.Name(new, ast.Load()), old.args, old.keywords),
        )


def _without(old: ast.BoolOp, index: int) -> ast.expr:
    kept = [each for number, each in enumerate(old.values) if number != index]
    return kept[0] if len(kept) == 1 else ast.BoolOp(old.op, kept)


def _compared(old: ast.Compare, index: int, new: type[ast.cmpop]) -> ast.expr:
    operators = [new() if at == index else each for at, each in enumerate(old.ops)]
    return ast.Compare(old.left, operators, old.comparators)


def _replaced(root: ast.expr, old: ast.AST, new: ast.expr) -> ast.expr:
    class Replacer(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST:
            return new if node is old else self.generic_visit(node)

    return Replacer().visit(root)
