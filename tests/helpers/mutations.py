"""Mutants of a module: its source with one small change each.

The changes: a comparison is inverted; a constant is multiplied by 10 or 0.1; + becomes −, and *
becomes /; `and` becomes `or`; a statement or a returned value is removed; an expression is set to
zero; a condition is negated.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

_FLIPPED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_SWAPPED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
_CHANGED = (
    ast.Compare, ast.BoolOp, ast.BinOp, ast.Constant, ast.AugAssign, ast.Expr, ast.If, ast.Return,
)  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One change of a module.

    Attributes:
        source: Source of the module.
        line: First line of the change.
        end: Last line of the change.
        inside: Whether the change is inside a function.
        what: Code before and after.
        index: Index of the changed node in the order of `ast.walk`.
        number: Number of the change among the changes of the node.
    """

    source: str
    line: int
    end: int
    inside: bool
    what: str
    index: int
    number: int

    @property
    def tree(self) -> ast.Module:
        """The syntax tree of the mutated module, with the line numbers of the source."""
        tree = ast.parse(self.source)
        twin = next(node for k, node in enumerate(ast.walk(tree)) if k == self.index)
        _change(tree, twin, self.number)
        return ast.fix_missing_locations(tree)

    @property
    def text(self) -> str:
        """The source of the mutated module."""
        return ast.unparse(self.tree)


def mutants(source: str) -> Iterator[Mutant]:
    """Yield all mutants of a module."""
    tree = ast.parse(source)
    skipped = {id(node) for node in _unseen(tree)}
    inside = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef)
        for statement in function.body
        for node in ast.walk(statement)
    }
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in skipped or not isinstance(node, _CHANGED):
            continue
        for number in range(3):
            twin = copy.deepcopy(node)
            alone = ast.Module([twin], [])  # type: ignore[list-item]
            before = ast.unparse(twin)
            after = _change(alone, twin, number)
            if after is None:
                break
            what = f"{_short(before)}  ->  {after}"
            end = node.test.end_lineno if isinstance(node, ast.If) else node.end_lineno
            yield Mutant(source, node.lineno, end or 0, id(node) in inside, what, index, number)


def _unseen(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes without effect on results: docstrings, annotations, imports, messages."""
    for node in ast.walk(tree):
        roots: list[ast.AST] = []
        if isinstance(node, (ast.Import, ast.ImportFrom, ast.Raise, ast.JoinedStr)):
            roots.append(node)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            roots.append(node)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            roots.append(node)
        if isinstance(node, (ast.AnnAssign, ast.arg)) and node.annotation is not None:
            roots.append(node.annotation)
        if isinstance(node, ast.FunctionDef):
            roots += [*node.decorator_list, *([node.returns] if node.returns else [])]
        for root in roots:
            yield from ast.walk(root)


def _change(tree: ast.AST, node: ast.AST, number: int) -> str | None:
    """Apply change `number` to a node of a tree; return its description, or None if it has none."""
    if isinstance(node, ast.Compare) and number == 0:
        node.ops[0] = _FLIPPED[type(node.ops[0])]()
        return _short(ast.unparse(node))
    if isinstance(node, ast.BoolOp) and number == 0:
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return _short(ast.unparse(node))
    if isinstance(node, ast.BinOp) and type(node.op) in _SWAPPED and number < 2:
        if number == 0:
            node.op = _SWAPPED[type(node.op)]()
            return _short(ast.unparse(node))
        return _replaced(tree, node, ast.BinOp(ast.Constant(0.0), ast.Mult(), node))
    if isinstance(node, ast.Constant) and type(node.value) is float and number < 2:
        node.value = (node.value or 1.0) * (10.0, 0.1)[number]
        return repr(node.value)
    if isinstance(node, (ast.Assign, ast.AugAssign, ast.Expr)) and number == 0:
        if isinstance(node, ast.Assign):  # removing an assignment would raise a NameError at once
            return None
        return _replaced(tree, node, ast.Pass())
    if isinstance(node, ast.If) and number == 0:
        node.test = ast.UnaryOp(ast.Not(), node.test)
        return f"if {_short(ast.unparse(node.test))}"
    if isinstance(node, ast.Return) and node.value is not None and number == 0:
        node.value = None
        return "return"
    return None


def _replaced(tree: ast.AST, node: ast.AST, replacement: ast.AST) -> str:
    """Replace a node in a tree; return the source of the replacement."""
    text = _short(ast.unparse(ast.fix_missing_locations(copy.deepcopy(replacement))))
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is node:
                setattr(parent, name, replacement)
                return text
            if isinstance(value, list) and any(item is node for item in value):
                value[[item is node for item in value].index(True)] = replacement
                return text
    raise AssertionError(text)


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) < 60 else f"{line[:56]} …"
